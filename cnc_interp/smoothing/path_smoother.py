"""Blocks to smooth segments: linear blocks through the look-ahead, native splines span by span.

Lines and splines meet at the programmed poses. The look-ahead sees a stop at such a pose. If the
spline continues the line smoothly, this stop is removed from the segments afterwards.
"""

from dataclasses import replace

import numpy as np

from cnc_interp.core import UM, BoolArray, FloatArray, cross, norm
from cnc_interp.machine_model.machine_entries import BlockPace
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import POSES, Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.corner_curve import Style
from cnc_interp.smoothing.dense.path_rows import settled
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.native.joining import Jets, line_between
from cnc_interp.smoothing.native.spline_run import SplineRun
from cnc_interp.smoothing.segments import SPLINE, PathSegments
from cnc_interp.smoothing.stop_choice import Choice

#: Part of the orientation tolerance that may be used [-], and the most at flank height [m].
SHARE, MOST = 0.05, 0.5 * UM
WANDER = 0.8  #: Part of the orientation tolerance that may be used at both ends of a block [-].


class Upright:
    """Put tool axes on the pole. The result does not depend on how the blocks arrive."""

    def __init__(self, machine: MachineTraits, height: float):
        self._pole = None if machine.pole is None else np.asarray(machine.pole)
        self._height = height
        self._moved = 0.0  # how far the last tool axis was moved, at flank height [m]
        self._away = np.inf  # how far the last tool axis is from the pole, likewise
        self._row = 0
        #: What is used of tolerances, and these, by program row [m].
        self._used: dict[int, tuple[float, float]] = {}
        self._waiting: Blocks | None = None  # a block that may be the last one

    def push(self, blocks: Blocks) -> Blocks:
        """Return blocks whose tool axes are on the pole where they were nearly.

        The last row may come with the next call. The start pose, exact stops, rows that name
        rotary positions, rows whose rotary axes run linearly, control points, and rows before a
        spline keep their tool axes.
        """
        if self._pole is None or not len(blocks):
            return blocks
        if self._waiting is not None:
            blocks, self._waiting = Blocks.concatenate([self._waiting, blocks]), None
        sine = np.minimum(norm(cross(blocks.axis, self._pole[None])), 1.0)
        away = self._height * 2.0 * np.sin(0.5 * np.arcsin(sine))
        most = np.minimum(SHARE * _least(blocks.orientation_tolerance), MOST)
        tolerance = WANDER * blocks.orientation_tolerance
        pair = np.maximum(away, np.r_[self._away, away[:-1]]) <= tolerance  # of both ends
        wanders = (away <= _least(tolerance)) & (pair | np.r_[pair[1:], True])
        near = (away > 0.0) & ((away <= most) | wanders)
        near &= np.isnan(blocks.rotary).all(axis=1) & (blocks.interpolation == POSES)
        near &= ~blocks.exact_stop & ~blocks.on_spline
        near[:-1] &= ~blocks.on_spline[1:]
        near[0] &= self._row > 0
        if near[-1]:
            self._waiting = blocks[-1:]
            blocks, near, away = blocks[:-1], near[:-1], away[:-1]
        self._away = float(away[-1]) if len(away) else self._away
        return self._moved_to_pole(blocks, near, np.where(near, away, 0.0))

    def finish(self) -> Blocks | None:
        """Return the row that still waits; the program ends there, and its tool axis stays."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return None
        return self._moved_to_pole(waiting, np.zeros(1, dtype=np.bool_), np.zeros(1))

    def counted(self, segments: PathSegments) -> PathSegments:
        """Return segments whose deviation counts from the program; they follow each other.

        A span of a curve may reach a little into the blocks beside those that it names.
        """
        if not self._used or not len(segments):
            return segments
        deviation, room = segments.deviation.copy(), segments.room.copy()
        for k, (first, last) in enumerate(segments.block.tolist()):
            more = int(segments.kind[k] == SPLINE)
            near = range(first - more, last + more + 1)
            rows = [self._used[row] for row in near if row in self._used]
            own = deviation[k, 1]
            for used, tolerance in rows:
                deviation[k, 1] = max(deviation[k, 1], min(own + used, tolerance))
                room[k] = max(min(room[k], tolerance - used - own), 0.0)
        self._used = {k: row for k, row in self._used.items() if k >= segments.block[-1, 0] - 1}
        return replace(segments, deviation=deviation, room=room)

    def _moved_to_pole(self, blocks: Blocks, near: BoolArray, moved: FloatArray) -> Blocks:
        """Put tool axes on the pole and take from the tolerances on both sides what that takes."""
        used = np.maximum(moved, np.r_[self._moved, moved[:-1]][: len(moved)])
        if len(moved):
            self._moved = float(moved[-1])
        for k in np.flatnonzero(used).tolist():
            self._used[self._row + k] = used[k], blocks.orientation_tolerance[k]
        self._row += len(blocks)
        if self._pole is None or not used.any():
            return blocks
        sense = np.where(blocks.axis @ self._pole < 0.0, -1.0, 1.0)
        return replace(
            blocks,
            axis=np.where(near[:, None], sense[:, None] * self._pole, blocks.axis),
            orientation_tolerance=blocks.orientation_tolerance - used,
        )


def _least(tolerance: FloatArray) -> FloatArray:
    """Return the smaller tolerance of both blocks at each tool axis; the last has one."""
    return np.minimum(tolerance, np.append(tolerance[1:], np.inf))


KEPT = 3  #: Rows that a pacer keeps: the next one, and those before it.


def pace_limits(
    pace: BlockPace, length: FloatArray, turn: FloatArray, feed: FloatArray
) -> FloatArray:
    """Return the largest mean speeds; ``turn`` (n, 2): at both vertices [rad].

    A control changes the velocity at a vertex between two blocks by at most ``jump``, so the speed
    there is v = jump / (2 sin(turn / 2)). On the block between two vertices the speed rises and
    falls again with the jerk J. With x the square root of the rise over J, a block of length L
    takes 4 x: ``2 J x^3 + 4 v x = L``. Its mean speed L / (4 x) limits its feed, and L over the
    time that the control needs for a block. Sharper turns are corners, which the planner slows
    down for itself.
    """
    with np.errstate(divide='ignore'):
        v = np.minimum(pace.jump / (2.0 * np.sin(0.5 * turn)), feed[:, None]).mean(axis=1)
    bump = length / (4.0 * rise_root(v, length, pace.jerk))
    return np.asarray(np.minimum(bump, length / pace.block_time))


def rise_root(v: FloatArray, length: FloatArray, jerk: float) -> FloatArray:
    """Return the real root of x^3 + p x = q, with p = 2 v / J and q = L / (2 J), by sinh."""
    p, q = 2.0 * np.maximum(v, 1e-9) / jerk, 0.5 * length / jerk
    a = np.sqrt(p / 3.0)
    return np.asarray(2.0 * a * np.sinh(np.arcsinh(0.5 * q / a**3) / 3.0))


class Pacer:
    """Give blocks the feed that the control reaches; the last row waits for the next one."""

    def __init__(self, pace: BlockPace, settings: Settings):
        self._pace, self._longest = pace, settings.longest_block
        self._sharp = settings.corner_angle
        self._kept: Blocks | None = None
        self._sent = 0  # rows of those kept that have been returned

    def push(self, blocks: Blocks) -> Blocks:
        rows = blocks if self._kept is None else Blocks.concatenate([self._kept, blocks])
        paced = self._paced(rows)[self._sent : max(self._sent, len(rows) - 1)]
        self._kept = rows[-KEPT:]
        self._sent = len(self._kept) - 1
        return paced

    def finish(self) -> Blocks | None:
        return None if self._kept is None else self._kept[self._sent :]

    def _paced(self, rows: Blocks) -> Blocks:
        if self._pace.stops_at_rapids:
            ends = rows.rapid.copy()
            ends[:-1] |= rows.rapid[1:]
            rows = replace(rows, exact_stop=rows.exact_stop | ends)
        if len(rows) < 4:
            return rows
        step = np.diff(rows.tip, axis=0)
        length = np.linalg.norm(step, axis=1)
        unit = step / np.maximum(length, 1e-12)[:, None]
        half_chord = 0.5 * np.linalg.norm(np.diff(unit, axis=0), axis=1)
        turn = 2.0 * np.arcsin(np.minimum(half_chord, 1.0))
        turn[(turn > self._sharp) | rows.exact_stop[1:-1]] = 0.0
        own = slice(2, -1)
        line = rows.line_number
        # Pieces of one line are an arc, not blocks.
        alone = (line[2:-1] != line[1:-2]) & (line[2:-1] != line[3:])
        slow = alone & (length[1:-1] < self._longest) & (length[1:-1] > 1e-9)
        slow &= ~rows.rapid[own] & ~rows.on_spline[own]
        slow &= np.isfinite(rows.feedrate[own])
        k, feed = np.flatnonzero(slow), rows.feedrate.copy()
        both = np.column_stack([turn[k], turn[k + 1]])
        feed[k + 2] = np.minimum(
            feed[k + 2], pace_limits(self._pace, length[k + 1], both, feed[k + 2])
        )
        return replace(rows, feedrate=feed)


class PathSmoother:
    """Smooth a stream of blocks. The result does not depend on how the stream is divided.

    Without a ``choice`` between the ways that it proposes, every corner is rounded.
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
        self._last: Blocks | None = None  # the last row
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
        blocks = settled(blocks, self._last, self._style.height)
        self._last = blocks[-1:] if len(blocks) else self._last
        return self._joined(self._taken(self._upright.push(blocks)))

    def whole(self, blocks: Blocks) -> PathSegments:
        """Return the segments of a whole path of lines, as ``push`` and ``finish`` do."""
        self._start = blocks.rotary[0]
        rows = self._upright.push(settled(blocks, None, self._style.height))
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
        """Return the lines that wait; the last one has no stop any more if the path goes on."""
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
