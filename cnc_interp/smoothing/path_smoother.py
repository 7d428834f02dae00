"""
Any blocks in, smooth segments out: linear blocks by the look-ahead, native splines span by span.

Lines and curves meet at the poses that the program names. A line is given to the look-ahead as if
the tool rested there; where line and curve go on into each other, which the curve sees to, that
rest is taken back.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.corners.corner import Style
from cnc_interp.smoothing.emission import no_segments
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.native.joining import Jets, line_jets
from cnc_interp.smoothing.native.spline_run import SplineRun
from cnc_interp.smoothing.orientation import norm, rotations_between
from cnc_interp.smoothing.segments import PathSegments

#: A tip that moves less than this stands still [m].
STANDSTILL = 1e-9


class PathSmoother:
    """
    Smooth a stream of blocks, the same however they arrive.

    Parameters
    ----------
    settings : Settings
        The user's choices.
    machine : MachineTraits
        What smoothing must know of the machine.

    """

    def __init__(self, settings: Settings, machine: MachineTraits):
        self.settings, self.machine = settings, machine
        self._style = Style.of(settings)
        self._lookahead = LookAhead(settings, machine)
        self._run: SplineRun | None = None
        self._recent: Blocks | None = None  # the last two linear blocks
        self._waiting: PathSegments | None = None  # until it is known whether the tool rests
        self._row = 0  # row in the program of the next block
        self._start: FloatArray | None = None  # words of the start pose, until they are sent

    def push(self, blocks: Blocks) -> PathSegments:
        """
        Take further blocks and return the segments that are final.

        Raises
        ------
        BlockError
            If a block's tool axis reverses, or a curve is none.

        """
        found: list[PathSegments | None] = []
        if self._row == 0 and self._run is None and len(blocks):
            self._start = blocks.rotary[0]
        spline = blocks.on_spline
        ends = spline & blocks.exact_stop  # a curve ends there
        cuts = np.flatnonzero((spline[1:] != spline[:-1]) | ends[:-1]) + 1
        for first, last in zip([0, *cuts], [*cuts, len(blocks)], strict=True):
            if first < last:
                take = self._curve if spline[first] else self._linear
                found += take(blocks[first:last])
        return self._joined(found)

    def finish(self) -> PathSegments:
        """Return the remaining segments; the tool rests at the end."""
        return self._joined(self._end_run(None) if self._run else [self._lookahead.finish()])

    def _linear(self, blocks: Blocks) -> list[PathSegments | None]:
        """Take linear blocks; they end a curve."""
        found: list[PathSegments | None] = []
        if self._run is not None:
            pose = self._run.last_row
            found += self._end_run(_line_at(pose, blocks[:1], at_end=False))
        found.append(self._lookahead.push(blocks))
        known = [] if self._recent is None else [self._recent]
        self._recent = Blocks.concatenate([*known, blocks[-2:]])[-2:]
        self._row += len(blocks)
        return found

    def _curve(self, rows: Blocks) -> list[PathSegments | None]:
        """Take control points; the first of a curve end the lines before."""
        found: list[PathSegments | None] = []
        if self._run is None:
            recent = self._recent if self._recent is not None else rows[:1]
            before = None
            if len(recent) > 1 and not recent.exact_stop[-1]:
                before = _line_at(recent[:1], recent[1:], at_end=True)
            self._waiting = self._lookahead.finish(joined=before is not None)
            self._run = SplineRun(self._row, recent[-1:], before, self._style)
        run = self._run
        made = run.push(rows)
        if run.flows is not None:
            found.append(self._released(run.flows))
        found.append(made)
        self._row += len(rows)
        if rows.exact_stop[-1]:
            found += self._end_run(None)
        return found

    def _released(self, flows: bool) -> PathSegments | None:
        """Return the lines that waited, without the rest at their end where the path flows on."""
        lines, self._waiting = self._waiting, None
        if lines is None or not len(lines) or not flows:
            return lines
        stop = lines.stop.copy()
        stop[-1] = False
        return replace(lines, stop=stop)

    def _end_run(self, after: Jets | None) -> list[PathSegments | None]:
        """Finish the curve; the look-ahead goes on from its last pose."""
        run = self._run
        assert run is not None
        rest = run.finish(after)
        self._run = None
        pose = replace(run.last_row, top=np.full((1, 3), np.nan), knot_interval=np.full(1, np.nan))
        self._lookahead = LookAhead(
            self.settings, self.machine, self._row - 1, joined=after is not None
        )
        self._lookahead.push(pose)
        self._recent = pose
        return [rest]

    def _joined(self, found: list[PathSegments | None]) -> PathSegments:
        parts = [part for part in found if part is not None and len(part)]
        if not parts:
            return no_segments(self._style)
        segments = PathSegments.concatenate(parts)
        if self._start is not None:
            # A curve has no rotary words, but those of the start pose say branch and turns.
            rotary = segments.rotary.copy()
            rotary[0, 0] = self._start
            segments, self._start = replace(segments, rotary=rotary), None
        return segments


def _line_at(start: Blocks, end: Blocks, at_end: bool) -> Jets | None:
    """Return the jets of the block between two rows at one of its ends; None at rest."""
    step = end.tip - start.tip
    length = norm(step)[:, None]
    if length[0, 0] < STANDSTILL:
        return None
    rate = rotations_between(start.axis, end.axis) / length
    row = end if at_end else start
    return line_jets(row.tip, step / length, row.axis, rate)
