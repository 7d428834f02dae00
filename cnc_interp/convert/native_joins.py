"""Native curves joined by parametrization splines [B2013, section 2.6], for ``convert``.

Both curves of a program stay as they are. Only the tool axis slides along the top curve, so that
it continues the line or curve beside it. ``smoothing/native/linking.py`` has the mathematics.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from cnc_interp.core.arrays import IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import DEG, MM, UM
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.native.cubic_curves import Portion
from cnc_interp.smoothing.native.joining import Jets, joins_gently, line_between, same_jets
from cnc_interp.smoothing.native.linking import Linked, linked
from cnc_interp.smoothing.orientation import norm

PROBES = 501  #: Points at which the slide of the tool axis is measured.


def portions(blocks: Blocks) -> list[tuple[int, int]]:
    """Return first row and last row (exclusive) of each native curve and of the lines between."""
    spline = blocks.on_spline
    changes = (spline[1:] != spline[:-1]) | (spline & blocks.exact_stop)[:-1]
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(blocks)]))


@dataclass
class Joins:
    """Joins the native curves of a program, and says what it did."""

    height: float  #: Flank height [m].
    tolerance: float  #: Largest distance of the written top curves from the joined ones [m].
    septic: bool  #: Whether the third derivative of the tool axis is considered, too.
    count: int = 0
    before: float = 0.0  # largest jumps of the orientation rate at the joins [rad/m]
    after: float = 0.0
    slide: float = 0.0  # largest change of the tool axis at flank height [m]

    def joined(self, blocks: Blocks) -> Blocks:
        """Return blocks in which every curve continues its neighbours."""
        parts = []
        for first, last in portions(blocks):
            rows = blocks[first:last]
            parts.append(self._curve(blocks, first, last) if blocks.on_spline[first] else rows)
        return Blocks.concatenate(parts)

    def notes(self) -> list[str]:
        """Return one line for the user."""
        before, after = self.before / DEG * MM, self.after / DEG * MM
        return [
            f'{self.count} curves joined by a parametrization spline: jumps of the orientation '
            f'rate up to {before:.2g} deg/mm before, {after:.2g} deg/mm after; the tool axis '
            f'slides by up to {self.slide / UM:.3g} um at flank height'
        ]

    def _curve(self, blocks: Blocks, first: int, last: int) -> Blocks:
        rows = blocks[first:last]
        interval = rows.knot_interval
        # Two intervals of 0 in a row let the curve pass through a control point: a join.
        cuts = [
            i for i in range(2, len(rows) - 1) if interval[i - 1] == 0.0 and interval[i] == 0.0
        ]
        ends = list(zip([0, *cuts], [*cuts, len(rows) - 1], strict=True))
        given = [self._portion(rows, a, b) for a, b in ends]
        parts = []
        for k, ((a, b), portion) in enumerate(zip(ends, given, strict=True)):
            before = given[k - 1].jets(at_end=True) if k else _line_before(blocks, first)
            after = _line_after(blocks, last) if k == len(given) - 1 else None
            made = self._linked(portion, before, after, int(rows.line_number[a]))
            source = np.arange(a, b + 1)
            if made is not None:
                portion, source = made.written, a + made.source
            kept = slice(1 if k else 0, None)
            parts.append(_rows(rows, source[kept], portion, kept))
        return Blocks.concatenate(parts)

    @staticmethod
    def _portion(rows: Blocks, a: int, b: int) -> Portion:
        interval = rows.knot_interval[a : b + 1].copy()
        interval[0] = 0.0
        return Portion(rows.tip[a : b + 1], rows.top[a : b + 1], interval)

    def _linked(
        self, portion: Portion, before: Jets | None, after: Jets | None, line: int
    ) -> Linked | None:
        """Join one portion; None if nothing is to be done or its own knots are repeated."""
        if (portion.knot_interval[1:-2] == 0.0).any():
            return None
        sides = self._open(portion, before, False), self._open(portion, after, True)
        if sides == (None, None):
            return None
        try:
            made = linked(portion, *sides, self.height, self.tolerance, self.septic)
        except InterpError as problem:
            raise InterpError(f'line {line}: {problem}') from None
        self.count += 1
        for jets, at_end in zip(sides, (False, True), strict=True):
            if jets is not None:
                self.before = max(self.before, _rate_jump(jets, portion.jets(at_end)))
                self.after = max(self.after, _rate_jump(jets, made.written.jets(at_end)))
        u = np.linspace(0.0, float(portion.knots[-1]), PROBES)
        both = portion.curve(u)
        tool = both[:, 3:] - both[:, :3]
        slides = self.height * norm(made.poses(u)[1] - tool / norm(tool)[:, None])
        self.slide = max(self.slide, float(slides.max()))
        return made

    def _open(self, portion: Portion, jets: Jets | None, at_end: bool) -> Jets | None:
        """Return the jets of a neighbour that the portion does not continue yet."""
        if jets is None:
            return None
        own = portion.jets(at_end)
        return jets if joins_gently(own, jets) and not same_jets(own, jets, self.height) else None


def _rate_jump(jets: Jets, other: Jets) -> float:
    """Return the jump of the orientation rate between two paths [rad/m]."""
    return float(norm(jets.axis[1] - other.axis[1])[0])


def _line_before(blocks: Blocks, first: int) -> Jets | None:
    """Return the jets of the line that leads to row ``first``; None without one."""
    if first < 2 or blocks.exact_stop[first - 1] or blocks.on_spline[first - 1]:
        return None
    return line_between(blocks[first - 2 : first - 1], blocks[first - 1 : first], at_end=True)


def _line_after(blocks: Blocks, last: int) -> Jets | None:
    """Return the jets of the line that begins at the end of a curve; None without one."""
    if last >= len(blocks) or blocks.exact_stop[last - 1] or blocks.on_spline[last]:
        return None
    return line_between(blocks[last - 1 : last], blocks[last : last + 1], at_end=False)


def _rows(rows: Blocks, source: IntArray, portion: Portion, kept: slice) -> Blocks:
    """Return the control points of a portion; all else comes from the rows ``source``."""
    columns = {name: values[source] for name, values in rows.columns().items()}
    tool = portion.top - portion.bottom
    columns['tip'], columns['top'] = portion.bottom[kept], portion.top[kept]
    columns['axis'] = (tool / norm(tool)[:, None])[kept]
    columns['knot_interval'] = portion.knot_interval[kept]
    return Blocks(**columns)
