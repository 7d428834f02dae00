"""Native curves joined by parametrization splines [B2013, 2.6, Fig. 4], for ``convert``.

Two portions, pairs of cubic B-splines with one knot vector, may meet with G2 continuity although
the rate of the tool axis jumps. Both curves are kept here, and the axis slides along the top
curve: u_top = f(u_bottom). The paper finds f at each end by Newton's method. The limit of small
steps has a closed form (``connection.matching_slopes``): derivatives of f with which o_s, o_ss and
o_sss continue along the top curve, or jump least. In contrast, ``joining.py`` removes every
jump, but changes the curves.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.convert.native_splines import PROBES, Portion, clamped
from cnc_interp.core import DEG, MM, UM, FloatArray, IntArray, InterpError, norm
from cnc_interp.core.bspline import start_derivatives
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.connection import matching_slopes
from cnc_interp.smoothing.native.joining import (
    Jets,
    by_parameter,
    joins_gently,
    line_between,
    same_jets,
)

if TYPE_CHECKING:
    from scipy.interpolate import BPoly, BSpline


MOST_PIECES = 256  #: Most pieces of one knot interval of the written top curve.


@dataclass(frozen=True)
class Linked:
    portion: Portion  #: The given curves.
    parametrization: BPoly  #: u_top = f(u_bottom) on [0, last knot], in the unit of the knots.
    #: The same path with u_top = u_bottom, for controls that have one parameter: the bottom curve
    #: is the given one, the top curve follows top(f(u)) with more knots.
    written: Portion
    #: (m,): Row of ``portion`` in whose knot interval each row of ``written`` lies.
    source: IntArray
    deviation: float  #: Largest distance of ``written`` from top(f(u)), at flank height [m].

    def poses(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        curve = self.portion.curve
        tip = curve(u)[:, :3]
        tool = curve(self.parametrization(u))[:, 3:] - tip
        return tip, tool / norm(tool)[:, None]


def linked(
    portion: Portion,
    before: Jets | None,
    after: Jets | None,
    height: float,
    tolerance: float = 1e-8,
    septic: bool = False,
) -> Linked:
    """Join a portion with the paths before and after it; InterpError if f cannot increase."""
    from scipy.interpolate import BPoly

    length = float(portion.knots[-1])
    free = np.array([1.0, 0.0, 0.0])
    first = free if before is None else _slopes(portion, before, at_end=False)
    last = free if after is None else _slopes(portion, after.backwards(), at_end=True)
    last = last * np.array([1.0, -1.0, 1.0])
    orders = 3 if septic else 2
    f = BPoly.from_derivatives([0.0, length], [[0.0, *first[:orders]], [length, *last[:orders]]])
    if np.diff(f.c[:, 0]).min() <= 0.0:
        raise InterpError(
            'no increasing parametrization joins these portions: the tool axis turns too '
            'differently on both sides; move the control points of the top curve'
        )
    return _written(portion, f, height, tolerance)


def _slopes(portion: Portion, jets: Jets, at_end: bool) -> FloatArray:
    """Return f', f'' and f''' at one end, seen inward, in the unit of the knots."""
    bottom, top, span = portion.end_span(at_end)
    p = start_derivatives(bottom)
    rho = norm(top[:, 0] - bottom[:, 0])[:, None]
    o = by_parameter(jets, p)
    found = matching_slopes(p, start_derivatives(top), jets.axis[0], o, rho)
    return np.asarray(np.array([float(x[0]) for x in found]) / span ** np.arange(3.0))


def _written(portion: Portion, f: BPoly, height: float, tolerance: float) -> Linked:
    """Interpolate top(f(u)) by cubic splines on finer knots until the tolerance holds."""
    curve, breaks = portion.curve, np.unique(portion.knots)
    ends = breaks[[0, -1]]
    rate = curve(ends, 1)
    rate[:, 3:] = curve(f(ends), 1)[:, 3:] * f(ends, 1)[:, None]
    pieces = 2
    while pieces <= MOST_PIECES:
        share = np.arange(pieces) / pieces
        sites = np.append((breaks[:-1, None] + share * np.diff(breaks)[:, None]).ravel(), ends[1])
        spline = clamped(sites, _both(curve, f, sites), rate)
        step = np.diff(sites)
        probes = (sites[:-1, None] + step[:, None] * (np.arange(PROBES) + 0.5) / PROBES).ravel()
        deviation = _distance(spline(probes), _both(curve, f, probes), height)
        if deviation <= tolerance:
            interval = np.concatenate([[0.0], step, [0.0, 0.0]])
            made = Portion(spline.c[:, :3].copy(), spline.c[:, 3:].copy(), interval)
            own = np.flatnonzero(portion.knot_interval > 0.0)
            last = len(portion.bottom) - 1
            source = np.concatenate([[0], np.repeat(own, pieces), [last - 1, last]])
            return Linked(portion, f, made, source, deviation)
        pieces *= 2
    raise InterpError(
        f'no cubic spline follows this parametrization within {tolerance * 1e6:g} um; '
        'allow a larger deviation (--fit-tolerance)'
    )


def _both(curve: BSpline, f: BPoly, u: FloatArray) -> FloatArray:
    """Return the tip at u and the second point at f(u), shape (k, 6) [m]."""
    u_top = f(u).clip(0.0, curve.t[-1])
    return np.hstack([curve(u)[:, :3], curve(u_top)[:, 3:]])


def _distance(found: FloatArray, wanted: FloatArray, height: float) -> float:
    """Return the largest distance between two paths, of tips or points at flank height [m]."""
    ends = []
    for both in (found, wanted):
        tool = both[:, 3:] - both[:, :3]
        ends.append(both[:, :3] + height * tool / norm(tool)[:, None])
    return float(max(norm(found[:, :3] - wanted[:, :3]).max(), norm(ends[0] - ends[1]).max()))


SLIDE_POINTS = 501  #: Points at which the slide of the tool axis is measured.


def portions(blocks: Blocks) -> list[tuple[int, int]]:
    spline = blocks.on_spline
    changes = (spline[1:] != spline[:-1]) | (spline & blocks.exact_stop)[:-1]
    return list(pairwise([0, *(np.flatnonzero(changes) + 1).tolist(), len(blocks)]))


@dataclass
class Joins:
    height: float  #: Flank height [m].
    tolerance: float  #: Largest distance of the written top curves from the joined ones [m].
    septic: bool  #: Whether the third derivative of the tool axis is considered, too.
    count: int = 0
    before: float = 0.0  # largest jumps of the orientation rate at the joins [rad/m]
    after: float = 0.0
    slide: float = 0.0  # largest change of the tool axis at flank height [m]

    def joined(self, blocks: Blocks) -> Blocks:
        parts = []
        for first, last in portions(blocks):
            rows = blocks[first:last]
            parts.append(self._curve(blocks, first, last) if blocks.on_spline[first] else rows)
        return Blocks.concatenate(parts)

    def notes(self) -> list[str]:
        before, after = self.before / DEG * MM, self.after / DEG * MM
        return [
            f'{self.count} curves joined by a parametrization spline: jumps of the orientation '
            f'rate up to {before:.2g} deg/mm before, {after:.2g} deg/mm after; the tool axis '
            f'slides by up to {self.slide / UM:.3g} um at flank height'
        ]

    def _curve(self, blocks: Blocks, first: int, last: int) -> Blocks:
        rows = blocks[first:last]
        interval = rows.knot_interval
        # Two intervals of 0 in a row make the curve pass through a control point: a join.
        cuts = [i for i in range(2, len(rows) - 1) if interval[i - 1] == interval[i] == 0.0]
        ends = list(zip([0, *cuts], [*cuts, len(rows) - 1], strict=True))
        given = [self._portion(rows, a, b) for a, b in ends]
        parts = []
        for k, ((a, b), portion) in enumerate(zip(ends, given, strict=True)):
            before = given[k - 1].jets(at_end=True) if k else _line(blocks, first - 1, True)
            after = _line(blocks, last, False) if k == len(given) - 1 else None
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
        """Join one portion; None if no join is needed or its own knots are repeated."""
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
        u = np.linspace(0.0, float(portion.knots[-1]), SLIDE_POINTS)
        both = portion.curve(u)
        tool = both[:, 3:] - both[:, :3]
        slides = self.height * norm(made.poses(u)[1] - tool / norm(tool)[:, None])
        self.slide = max(self.slide, float(slides.max()))
        return made

    def _open(self, portion: Portion, jets: Jets | None, at_end: bool) -> Jets | None:
        """Return the jets of a neighbour that meets the portion with a jump; else None."""
        if jets is None:
            return None
        own = portion.jets(at_end)
        return jets if joins_gently(own, jets) and not same_jets(own, jets, self.height) else None


def _rate_jump(jets: Jets, other: Jets) -> float:
    """Return the jump of the orientation rate between two paths [rad/m]."""
    return float(norm(jets.axis[1] - other.axis[1])[0])


def _line(blocks: Blocks, row: int, before: bool) -> Jets | None:
    """Return the jets of a line at its joint with a curve; None without line or joint."""
    if not 0 < row < len(blocks) or blocks.on_spline[row]:
        return None
    if blocks.exact_stop[row if before else row - 1]:
        return None
    return line_between(blocks[row - 1 : row], blocks[row : row + 1], at_end=before)


def _rows(rows: Blocks, source: IntArray, portion: Portion, kept: slice) -> Blocks:
    columns = {name: values[source] for name, values in rows.columns().items()}
    tool = portion.top - portion.bottom
    columns['tip'], columns['top'] = portion.bottom[kept], portion.top[kept]
    columns['axis'] = (tool / norm(tool)[:, None])[kept]
    columns['knot_interval'] = portion.knot_interval[kept]
    return Blocks(**columns)
