"""Convert blocks to smooth segments: linear blocks in the look-ahead, native splines by spans.

Lines and splines meet at the programmed poses. The look-ahead sees a stop at such a pose. If the
spline continues the line smoothly, this stop is removed from the segments afterwards.
"""

from dataclasses import replace

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import POSES, Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.corner_curve import Style
from cnc_interp.smoothing.dense.path_rows import settled
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.native.joining import Jets, line_between
from cnc_interp.smoothing.native.spline_run import SplineRun
from cnc_interp.smoothing.pace import Pacer
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.smoothing.stop_choice import Choice
from cnc_interp.smoothing.upright import Upright


class PathSmoother:
    """Smooth a stream of blocks. The result does not depend on how the stream is divided.

    ``choice`` selects one of the proposed alternatives; without it, every corner is rounded.
    """

    def __init__(self, settings: Settings, machine: MachineTraits, choice: Choice | None = None):
        self._settings, self._machine, self._choice = settings, machine, choice
        self._style = Style.of(settings)
        self.stops: list[int] = []  # program rows of corners at which a stop is faster
        self._pacer = Pacer(machine.pace, settings) if machine.pace else None
        self._upright = Upright(machine, settings.flank_height)
        self._lookahead = LookAhead(settings, machine, choice, stops=self.stops)
        self._run: SplineRun | None = None
        self._recent: Blocks | None = None  # the last two linear blocks
        self._waiting: PathSegments | None = None  # lines before a spline
        self._row = 0  # program row of the next block
        self._before: Blocks | None = None  # the last two rows
        self._start: FloatArray | None = None  # rotary words of the start pose

    def push(self, blocks: Blocks) -> PathSegments:
        """Add blocks, the start pose first; return the segments that later blocks cannot change.

        Raises BlockError if a tool axis reverses, or control points do not form a curve.
        """
        if self._pacer is not None:
            blocks = self._pacer.push(blocks)
        return self._push(blocks)

    def _push(self, blocks: Blocks) -> PathSegments:
        if self._row == 0 and self._run is None and len(blocks):
            self._start = blocks.rotary[0]
        before = blocks[:0] if self._before is None else self._before
        rows = settled(blocks, before, self._style.height)
        blocks = rows[len(before) :]
        self._before = rows[-2:]
        return self._joined(self._taken(self._upright.push(blocks)))

    def whole(self, blocks: Blocks) -> PathSegments:
        """Return the segments of a whole path of lines, as ``push`` and ``finish`` do."""
        self._start = blocks.rotary[0]
        rows = self._upright.push(settled(blocks, blocks[:0], self._style.height))
        last = self._upright.finish()
        rows = rows if last is None else Blocks.concatenate([rows, last])
        return self._joined([self._lookahead.whole(rows)])

    def _taken(self, blocks: Blocks) -> list[PathSegments | None]:
        found: list[PathSegments | None] = []
        spline = blocks.on_spline
        ends = spline & blocks.exact_stop  # a spline ends in this row
        cuts = np.flatnonzero((spline[1:] != spline[:-1]) | ends[:-1]) + 1
        for first, last in zip([0, *cuts], [*cuts, len(blocks)], strict=True):
            if first < last:
                take = self._curve if spline[first] else self._linear
                found += take(blocks[first:last])
        return found

    def finish(self) -> PathSegments:
        if self._pacer is not None and (rest := self._pacer.finish()) is not None:
            return PathSegments.concatenate([self._push(rest), self._finish()])
        return self._finish()

    def _finish(self) -> PathSegments:
        last = self._upright.finish()
        found = [] if last is None else self._taken(last)
        found += self._end_run(None) if self._run else [self._lookahead.finish()]
        return self._joined(found)

    def _linear(self, blocks: Blocks) -> list[PathSegments | None]:
        found: list[PathSegments | None] = []
        if self._run is not None:
            pose = self._run.last_row
            found += self._end_run(line_between(pose, blocks[:1], at_end=False))
        found.append(self._lookahead.push(blocks))
        known = [] if self._recent is None else [self._recent]
        self._recent = Blocks.concatenate([*known, blocks[-2:]])[-2:]
        self._row += len(blocks)
        return found

    def _curve(self, rows: Blocks) -> list[PathSegments | None]:
        found: list[PathSegments | None] = []
        if self._run is None:
            recent = self._recent if self._recent is not None else rows[:1]
            before = None
            if len(recent) > 1 and not recent.exact_stop[-1]:
                before = line_between(recent[:1], recent[1:], at_end=True)
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
        """Return the waiting lines; if the path continues smoothly, the last line has no stop."""
        lines, self._waiting = self._waiting, None
        if lines is None or not len(lines) or not flows:
            return lines
        stop = lines.stop.copy()
        stop[-1] = False
        return replace(lines, stop=stop)

    def _end_run(self, after: Jets | None) -> list[PathSegments | None]:
        run = self._run
        assert run is not None
        rest = run.finish(after)
        self._run = None
        pose = replace(run.last_row, top=np.full((1, 3), np.nan), knot_interval=np.full(1, np.nan))
        self._lookahead = LookAhead(
            self._settings,
            self._machine,
            self._choice,
            self._row - 1,
            after is not None,
            self.stops,
        )
        self._lookahead.push(pose)
        self._recent = pose
        return [rest]

    def _joined(self, found: list[PathSegments | None]) -> PathSegments:
        parts = [part for part in found if part is not None and len(part)]
        if not parts:
            return PathSegments.none()
        segments = self._upright.counted(PathSegments.concatenate(parts))
        if self._start is not None and segments.interpolation[0] == POSES:
            # A spline has no rotary words. Those of the start pose choose branch and turns.
            rotary = segments.rotary.copy()
            rotary[0, 0] = self._start
            segments = replace(segments, rotary=rotary)
        self._start = None
        return segments
