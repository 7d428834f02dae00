"""The motion of one run: plans along its path are sampled and cut into chunks."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import FloatArray, PlanningError
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.machine_model.machine import Machine, limits_of
from cnc_interp.run.chunk_cutter import (
    NO_SIGNALS,
    ChunkCutter,
    FunctionQueue,
    StopSearch,
    way_down,
)
from cnc_interp.run.course import Course, Leg, feed_under, finely, slowed
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit
    from cnc_interp.machine_model.signals import Signals

#: If a stop takes less time than this, a revision does not join in motion: the jerk stage cannot
#: plan a path of a few periods [s]. The motion stops, and the revision continues from rest.
BRIEF = 0.01


class MotionPlan:
    def __init__(
        self,
        stream: MotionStream,
        settings: OperatorSettings,
        todo: deque[AxisPath | Wait],
        number: int = 0,
        leg: Leg | None = None,
        way_down: PlannedPiece | None = None,
        before: MotionPlan | None = None,
        rests: Setpoints | None = None,
    ):
        self.settings = settings
        self._stream, self._todo, self._way_down = stream, todo, way_down
        self._legs: deque[Leg] = deque([] if leg is None else [leg])
        stays = () if before is None else before._history
        self._history: deque[tuple[Leg, PlannedPiece]] = deque(stays)
        self._cutter = ChunkCutter(stream.chunk_size, number, stream.functions)
        joins_at = None if leg is None else number
        table = stream.limits.table
        self._search = StopSearch(stream.course, table, stream.period, joins_at)
        self._last = rests  # the last setpoint
        self._block_before = -1

    def follow(self, settings: OperatorSettings) -> None:
        if not self._legs and not self._history:
            self.settings = settings

    def extend(self, items: Iterable[AxisPath | Wait]) -> None:
        self._todo.extend(items)

    def release(self, s: float) -> float:
        """Drop the motion before path position ``s`` [m]; return where the rest begins [m]."""
        while len(self._history) > 1 and self._history[1][1].law.s[0] < s:
            self._history.popleft()
        return float(self._history[0][1].law.s[0]) if self._history else -math.inf

    @property
    def planned(self) -> float:
        return sum(leg.planned for leg in self._legs)

    @property
    def has_path(self) -> bool:
        return bool(self._todo)

    @property
    def can_plan(self) -> bool:
        return self.has_path and self.settings.override > 0.0

    @property
    def can_sample(self) -> bool:
        return bool(self._legs) and (bool(self._legs[0].slices) or self._legs[0].wait is not None)

    def plan(self) -> None:
        item = self._todo.popleft()
        if isinstance(item, AxisPath):
            item = self._until_pause(item)
        if isinstance(item, Wait):
            self._open_leg().finish(item)
            return
        self._block_before = int(item.cell_block[-1])
        leg = self._open_leg(self._stream.tool_on(item))
        leg.push(slowed(item, self._scaled, self._way_down))

    def _scaled(self, path: AxisPath) -> FloatArray:
        """Return the feed of each cell of a part with the overrides, shape (N - 1,) [m/s]."""
        settings = self.settings
        share = self._stream.functions.feed_share(
            path.cell_block, settings.override, settings.spindle
        )
        # Approaches (block 0) are no lines of the program, but follow the feed override, too.
        ways = np.where(path.cell_block == 0, min(1.0, settings.override), 1.0)
        return feed_under(path, self._stream.limits, share, settings.rapid * ways)

    def _open_leg(self, tool: ToolLimit | None = None) -> Leg:
        if not self._legs or self._legs[-1].wait is not None:
            self._legs.append(Leg(self._stream.limits, self._stream.period, tool=tool))
        return self._legs[-1]

    def _until_pause(self, part: AxisPath) -> AxisPath | Wait:
        """Return the part up to the next wait for cycle_start, or this wait; queue the rest."""
        found = self._pause(part)
        if found is None:
            return part
        pause, wait = found
        if pause == 0:
            self._todo.appendleft(part)
            self._block_before = int(part.cell_block[0])
            return wait
        self._todo.appendleft(cut(part, pause, len(part.s) - 1))
        return cut(part, 0, pause)

    def _pause(self, part: AxisPath) -> tuple[int, Wait] | None:
        before = np.concatenate([[self._block_before], part.cell_block[:-1]])
        changes = np.flatnonzero((before != part.cell_block) & (before >= 0))
        undivided = -math.inf  # no leg is cut before this place: the motion cannot stop earlier
        if self._way_down is not None:
            undivided = float(self._way_down.path.s[-1]) * (1 + 1e-12) + 1e-9
        line_of = self._stream.line_of
        for k in changes.tolist():
            if part.s[k] < undivided:
                continue
            block, following = int(before[k]), int(part.cell_block[k])
            moves = k > 0 or (bool(self._legs) and self._legs[-1].wait is None)
            single = self.settings.single_block and line_of(block) != line_of(following)
            wait = self._stream.pause_blocks.get(block)
            if single and wait in (None, Wait.FUNCTION):
                wait = Wait.SINGLE_BLOCK
            if moves and wait is not None:
                return int(k), wait
        return None

    def sample(self) -> list[Chunk]:
        leg, cutter = self._legs[0], self._cutter
        if not leg.sampled:
            zero = cutter.next_number - leg.interpolator.next_number
            leg.number_of_zero, leg.sampled = zero, True
        if leg.slices:
            piece = leg.slices.popleft()
            self._history.append((leg, piece))
            first = cutter.next_number
            self._append(leg.interpolator.push(piece))
            numbers = range(first, cutter.next_number)
            cutter.stops.extend(self._search.stops(leg, piece, numbers))
        else:
            assert leg.wait is not None
            self._legs.popleft()
            last = leg.interpolator.finish() if leg.moves else self._last
            if leg.wait is Wait.APPROACH:
                last = self._stream.course.first_rest()
            if last is not None and (leg.moves or leg.wait in (Wait.END, Wait.APPROACH)):
                self._append(last)
                cutter.end_leg(leg.wait)
        return cutter.cut()

    def _append(self, samples: Setpoints) -> None:
        self._cutter.take(samples)
        if len(samples):
            self._last = samples[-1:]

    def state_at(self, number: int) -> tuple[Leg, tuple[float, float, float]] | None:
        """Return leg and (s, s_dot, s_ddot) at setpoint ``number``; None if it was dropped."""
        for leg, piece in reversed(self._history):
            time = (number - leg.number_of_zero) * self._stream.period
            if time >= piece.law.time[0] - 1e-9:
                return leg, leg.state_at(number, piece)
        return None

    def way_down(self, number: int) -> PlannedPiece | None:
        found = self.state_at(number)
        if found is None:
            return None
        leg, state = found
        begin = (number - leg.number_of_zero) * self._stream.period
        sampled = [piece for of_leg, piece in self._history if of_leg is leg]
        ahead = self._stream.course.ahead(state[0])
        return way_down([*sampled, *leg.slices], begin, ahead, self._stream.limits.table)


class MotionStream:
    """The path of one run, and the current plan along it, which makes chunks of setpoints."""

    def __init__(
        self,
        limits: Machine | Limits,
        period: float,
        chunk_size: int = 10,
        line_of: Callable[[int], int] = int,
        settings: OperatorSettings | None = None,
        tool: ToolLimit | None = None,
        signals: Signals = NO_SIGNALS,
    ):
        self.limits = limits_of(limits)
        self.period, self.chunk_size, self.tool = period, chunk_size, tool
        self.line_of = line_of  #: Function block -> source line. Single block stops between lines.
        self.course, self.functions = Course(), FunctionQueue(signals)
        #: Block -> wait after it, for M0, M1 and functions.
        self.pause_blocks: dict[int, Wait] = {}
        self.current = MotionPlan(self, settings or OperatorSettings(), deque())

    def tool_on(self, path: AxisPath) -> ToolLimit | None:
        return self.tool if path.cell_block[0] > 0 else None

    def push(self, path: AxisPath) -> None:
        self.current.extend(self.course.push(path))

    def end_leg(self, wait: Wait) -> None:
        self.course.items.append(wait)
        self.current.extend([wait])

    def release(self, s: float) -> None:
        """Drop motion that the machine has executed up to ``s`` [m] and that is not needed."""
        self.course.release(min(s, self.current.release(s)))

    def revision(self, number: int, settings: OperatorSettings) -> MotionPlan | None:
        """Return a plan that joins after setpoint ``number``; None if no stop is known there."""
        found = self.current.state_at(number)
        if found is None:
            return None
        leg, (s, v, a) = found
        if v <= 0.0:
            todo = finely(self.course.after(s))
            rest = self.course.rest_at(s)
            before, first = self.current, number + 1
            return MotionPlan(self, settings, todo, first, before=before, rests=rest)
        stop, rests = self.current.way_down(number), settings.override <= 0.0
        if stop is None:
            return None
        begun, period = number - leg.number_of_zero + 1, self.period
        if not rests and float(stop.law.duration.sum()) >= BRIEF:
            tool = self.tool_on(stop.path)
            new = Leg(self.limits, period, begun, (v, a), tool)
            todo = finely(self.course.after(s))
            plan = MotionPlan(self, settings, todo, number + 1, new, stop, self.current)
            with suppress(PlanningError):
                while plan.can_plan and not plan.can_sample:
                    plan.plan()
                if not new.planner.stuck:
                    return plan
        # No law with the new feed continues the current motion: stop, then continue from rest.
        new = Leg(self.limits, period, begun, (v, a))
        new.drive(stop, Wait.OVERRIDE if rests else Wait.NOTHING)
        todo = finely(self.course.after(float(stop.path.s[-1])))
        return MotionPlan(self, settings, todo, number + 1, new, before=self.current)

    def adopt(self, revision: MotionPlan) -> MotionPlan:
        before, self.current = self.current, revision
        return before

    def resume(self, s: float, settings: OperatorSettings, way: AxisPath | None = None) -> None:
        """Replan from rest at ``s`` [m]; numbers begin at 0. ``way``: path to s, with s < 0."""
        if way is not None:
            self.course.lead(way, s)
            s = float(way.s[0])
        todo = self.course.after(s)
        self.current = MotionPlan(self, settings, todo, rests=self.course.rest_at(s))
