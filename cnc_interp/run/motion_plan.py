"""One plan of the motion along the rest of a course: legs planned, sampled and cut into chunks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.limits import AxisLimits
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.stop_law import cut_between, grid_place, stop_law
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.run.chunk import Chunk, ChunkCutter, Wait
from cnc_interp.run.course import Course, LegEnd, slowed
from cnc_interp.run.interpolator import Interpolator, Setpoints
from cnc_interp.run.leg import STILL, Leg

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit


STOP_EVERY = 0.005
"""Time between setpoints at which a stop is looked for [s]."""

HASTE, HASTY_EVERY = 0.3, 0.02
"""Begin of a plan that joins in motion, and the time between stops in it [s]: it must be early."""


class StopSearch:
    """Find stops at the setpoints of one plan."""

    def __init__(
        self, course: Course, table: FloatArray, period: float, joins_at: int | None = None
    ):
        self._course, self._table, self._period = course, table, period
        self._every = max(1, round(STOP_EVERY / period))
        self._hasty_every = self._every * round(HASTY_EVERY / STOP_EVERY)
        self._hasty_until = 0 if joins_at is None else joins_at + round(HASTE / period)

    def stops(
        self, leg: Leg, piece: PlannedPiece, numbers: range
    ) -> Iterator[tuple[int, Setpoints]]:
        """
        Look for stops at the setpoints of a slice of the motion.

        Parameters
        ----------
        leg : Leg
            The leg that the slice belongs to.
        piece : PlannedPiece
            The slice.
        numbers : range
            Numbers of its setpoints in the stream.

        Yields
        ------
        tuple of int and Setpoints
            Number of a setpoint, and the setpoints after it down to rest.

        """
        ahead: AxisPath | None = None
        first = -(-(numbers.start + 1) // self._every) * self._every - 1
        for number in range(first, numbers.stop, self._every):
            if number < self._hasty_until and (number + 1) % self._hasty_every:
                continue
            state = leg.state_at(number, piece)
            if state[1] <= 0.0:
                continue
            if ahead is None:
                ahead = self._course.ahead(float(piece.law.s[0]))
            stop = stop_law(ahead, state, self._table, 0.0)
            if stop is not None:
                yield number, self._sampled(stop)

    def _sampled(self, stop: PlannedPiece) -> Setpoints:
        """Sample a stop: the setpoints after its first state, the last one at rest."""
        interpolator = Interpolator(self._period, 1)
        return Setpoints.concatenate([interpolator.push(stop), interpolator.finish()])


WAY_DOWN_EVERY = 0.005
"""Time between the setpoints from which a revision looks for a stop [s]."""

WAY_DOWN_LEEWAY = 6e-3
"""Part of every limit that this stop leaves free, so that a law beside it exists [-]."""


@dataclass(frozen=True)
class OperatorSettings:
    """The settings of the operator that a plan depends on."""

    #: Factor on the programmed feed, 0 to 1.5 [-]; 0 stops on the path and waits.
    override: float = 1.0
    single_block: bool = False  #: Rest at the end of each source line until cycle_start.
    rapid: float = 1.0  #: Factor on the speed of rapids, up to 1 [-].


@dataclass(frozen=True)
class PlanContext:
    """The data that all plans of one run share."""

    limits: AxisLimits  #: Limits of the axes.
    table: FloatArray  #: (7, n_axes, m): The same limits as ``limit_table`` returns them.
    period: float  #: Interpolation period [s].
    chunk_size: int  #: Most setpoints in a chunk.
    #: Returns the source line of a block; single block stops where it changes.
    line_of: Callable[[int], int]
    course: Course = field(default_factory=Course)  #: The path of the run.
    #: Blocks after which cycle_start is waited for, and why (M0, M1); grows with the path.
    pause_blocks: dict[int, Wait] = field(default_factory=dict)
    tool: ToolLimit | None = None  #: Limit on the error that the drives leave at the tool.


class MotionPlan:
    """One plan of a run, from one setpoint on."""

    def __init__(
        self,
        context: PlanContext,
        settings: OperatorSettings,
        todo: deque[AxisPath | LegEnd],
        number: int = 0,
        leg: Leg | None = None,
        way_down: PlannedPiece | None = None,
        before: MotionPlan | None = None,
        rests: Setpoints | None = None,
    ):
        self.settings = settings
        self._context, self._todo, self._way_down = context, todo, way_down
        self._legs: deque[Leg] = deque([] if leg is None else [leg])
        stays = () if before is None else before._history
        self._history: deque[tuple[Leg, PlannedPiece]] = deque(stays)
        self._cutter = ChunkCutter(context.chunk_size, number)
        joins_at = None if leg is None else number
        self._search = StopSearch(context.course, context.table, context.period, joins_at)
        self._last = rests  # the last setpoint
        self._block_before = -1

    def extend(self, items: Iterable[AxisPath | LegEnd]) -> None:
        """Add further items of the course."""
        self._todo.extend(items)

    def release(self, s: float) -> None:
        """Drop the motion before a place on the path [m]."""
        while len(self._history) > 1 and self._history[1][1].law.s[0] < s:
            self._history.popleft()

    @property
    def planned(self) -> float:
        """Motion planned but not sampled [s]."""
        return sum(leg.planned for leg in self._legs)

    @property
    def has_path(self) -> bool:
        """Tell whether there is path that is not planned."""
        return bool(self._todo)

    @property
    def can_plan(self) -> bool:
        """Tell whether there is path to plan."""
        return self.has_path and self.settings.override > 0.0

    @property
    def can_sample(self) -> bool:
        """Tell whether there is motion to sample."""
        return bool(self._legs) and (bool(self._legs[0].slices) or self._legs[0].wait is not None)

    def plan(self) -> None:
        """
        Plan one portion of the path.

        Raises
        ------
        PlanningError
            If there is no law within the limits.

        """
        item = self._todo.popleft()
        if isinstance(item, AxisPath):
            item = self._until_pause(item)
        if isinstance(item, LegEnd):
            self._open_leg().finish(item.wait)
            return
        self._block_before = int(item.cell_block[-1])
        self._open_leg().push(slowed(item, self._scaled, self._way_down))

    def _scaled(self, path: AxisPath) -> FloatArray:
        """Return the feed of each cell of a part under the overrides, shape (N - 1,) [m/s]."""
        settings = self.settings
        feed: FloatArray = path.cell_feed * settings.override
        rapids = np.isinf(path.cell_feed)
        # No line of the program commands the ways by block 0: they follow the feed override, too.
        ways = np.where(path.cell_block[rapids] == 0, min(1.0, settings.override), 1.0)
        share = settings.rapid * ways
        if (share < 1.0).any():
            # |q_s| v <= V: the fastest axis runs at a share of its largest velocity.
            ends = path.cell_left[1, rapids], path.cell_right[1, rapids]
            use = np.abs(ends).max(axis=0) / self._context.limits.max_velocity
            feed[rapids] = np.where(share < 1.0, share / use.max(axis=1), np.inf)
        return feed

    def _open_leg(self) -> Leg:
        """Return the leg that is being planned."""
        if not self._legs or self._legs[-1].wait is not None:
            context = self._context
            self._legs.append(Leg(context.limits, context.period, tool=context.tool))
        return self._legs[-1]

    def _until_pause(self, part: AxisPath) -> AxisPath | LegEnd:
        """Cut a part where the machine waits for cycle_start. The rest is planned later."""
        found = self._pause(part)
        if found is None:
            return part
        pause, wait = found
        if pause == 0:
            self._todo.appendleft(part)
            self._block_before = int(part.cell_block[0])
            return LegEnd(wait)
        self._todo.appendleft(cut(part, pause, len(part.s) - 1))
        return cut(part, 0, pause)

    def _pause(self, part: AxisPath) -> tuple[int, Wait] | None:
        """Return the first grid point where the machine must wait for cycle_start, and why."""
        before = np.concatenate([[self._block_before], part.cell_block[:-1]])
        changes = np.flatnonzero((before != part.cell_block) & (before >= 0))
        undivided = -math.inf  # no leg is cut before this place: the motion cannot stop earlier
        if self._way_down is not None:
            undivided = float(self._way_down.path.s[-1]) * (1 + 1e-12) + 1e-9
        line_of = self._context.line_of
        for k in changes.tolist():
            if part.s[k] < undivided:
                continue
            block, following = int(before[k]), int(part.cell_block[k])
            moves = k > 0 or (bool(self._legs) and self._legs[-1].wait is None)
            single = self.settings.single_block and line_of(block) != line_of(following)
            wait = self._context.pause_blocks.get(block, Wait.SINGLE_BLOCK if single else None)
            if moves and wait is not None:
                return int(k), wait
        return None

    def sample(self) -> list[Chunk]:
        """Sample a slice of the motion and return the chunks that are complete with it."""
        leg, cutter = self._legs[0], self._cutter
        if leg.number_of_zero is None:
            leg.number_of_zero = cutter.next_number - leg.interpolator.next_number
        if leg.slices:
            piece = leg.slices.popleft()
            self._history.append((leg, piece))
            first = cutter.next_number
            self._append(leg.interpolator.push(piece))
            for number, stop in self._search.stops(leg, piece, range(first, cutter.next_number)):
                cutter.add_stop(number, stop)
        else:
            assert leg.wait is not None
            self._legs.popleft()
            last = leg.last_sample() if leg.moves else self._last
            if leg.wait is Wait.APPROACH:
                last = self._context.course.first_rest()
            if last is not None and (leg.moves or leg.wait in (Wait.END, Wait.APPROACH)):
                self._append(last)
                cutter.end_leg(leg.wait)
        return cutter.cut()

    def _append(self, samples: Setpoints) -> None:
        """Store sampled setpoints."""
        self._cutter.take(samples)
        if len(samples):
            self._last = samples[-1:]

    def state_at(self, number: int) -> tuple[Leg, tuple[float, float, float]] | None:
        """
        Return the state of motion at a setpoint that was handed out.

        Parameters
        ----------
        number : int
            Number of the setpoint.

        Returns
        -------
        tuple of Leg and (s, s_dot, s_ddot), or None
            The leg and its state [m, m/s, m/s2]; None where the setpoint is forgotten.

        """
        for leg, piece in reversed(self._history):
            assert leg.number_of_zero is not None
            time = (number - leg.number_of_zero) * self._context.period
            if time >= piece.law.time[0] - 1e-9:
                return leg, leg.state_at(number, piece)
        return None

    def way_down(self, number: int) -> PlannedPiece | None:
        """Return a path to rest: as planned until a setpoint with a known stop, then the stop."""
        found = self.state_at(number)
        if found is None:
            return None
        leg, table = found[0], self._context.table
        assert leg.number_of_zero is not None
        begin = (number - leg.number_of_zero) * self._context.period
        ahead = self._context.course.ahead(found[1][0])
        driven: list[PlannedPiece] = []
        sampled = [piece for of_leg, piece in self._history if of_leg is leg]
        for piece in [*sampled, *leg.slices]:
            first, last = max(begin, float(piece.law.time[0])), piece.law.end_time
            for time in np.arange(first, last, WAY_DOWN_EVERY):
                s, v, a, _ = (float(x[0]) for x in piece.law.evaluate(np.array([time])))
                stop = stop_law(ahead, (s, v, a), table, float(time), WAY_DOWN_LEEWAY)
                if stop is not None:
                    rest = [between(piece, first, float(time))] if time > first else []
                    return PlannedPiece.join([*driven, *rest, stop])
            if last > first:
                driven.append(between(piece, first, last))
        if driven and driven[-1].law.evaluate(np.array([last]))[1][0] < STILL:
            return PlannedPiece.join(driven)
        return None


def between(piece: PlannedPiece, begin: float, end: float) -> PlannedPiece:
    """Cut a law and its path at two times on its clock [s]."""
    law = piece.law
    first, last = law.piece_at(np.array([begin, end])).tolist()
    last -= law.time[last] == end and last > first
    rows = np.arange(first, last + 1)
    times = np.maximum(law.time[rows], begin)
    s, v, a, j = law.evaluate(times, rows)
    ends = np.append(times[1:], end)
    until = float(law.evaluate(np.array([end]), rows[-1:])[0][0])
    places = grid_place(piece.path, float(s[0])), grid_place(piece.path, until)
    path = cut_between(piece.path, *places, np.array(places))
    start = int(np.searchsorted(piece.path.s, places[0], side='right')) - 1
    cells = np.maximum(law.cell[rows] - start, 0)
    return PlannedPiece(path, MotionLaw(times, ends - times, s, v, a, j, cells))
