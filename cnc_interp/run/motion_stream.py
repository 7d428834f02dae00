"""
The stream of one run: path in, chunks of setpoints with their stop tails out.

The stream keeps the path and the plan that counts now. ``revision`` makes a second plan that goes
on after a setpoint which was handed out. ``adopt`` puts it in the place of the first; a revision
that nobody adopts is dropped. ``resume`` begins a plan from rest anywhere on the path.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import TYPE_CHECKING

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import PlanningError
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.course import finely
from cnc_interp.run.leg import Leg
from cnc_interp.run.motion_plan import MotionPlan, OperatorSettings, PlanContext

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit

#: No revision begins within this time before rest [s]. It waits, because the jerk stage cannot
#: resolve the path of a few periods.
BRIEF = 0.01


class MotionStream:
    """
    Path in, chunks out.

    Parameters
    ----------
    limits : AxisLimits
        Limits of the axes.
    period : float
        Interpolation period [s].
    chunk_size : int
        Most setpoints in a chunk.
    line_of : callable
        Returns the source line of a block; single block stops where it changes.
    settings : OperatorSettings
        The settings that the first plan follows.
    tool : ToolLimit, optional
        Limit on the error that the drives leave at the tool.

    """

    def __init__(
        self,
        limits: AxisLimits,
        period: float,
        chunk_size: int = 10,
        line_of: Callable[[int], int] = int,
        settings: OperatorSettings | None = None,
        tool: ToolLimit | None = None,
    ):
        table = limit_table(limits)
        self._context = PlanContext(limits, table, period, chunk_size, line_of, tool=tool)
        self._course = self._context.course
        self._plan = MotionPlan(self._context, settings or OperatorSettings(), deque())

    def push(self, path: AxisPath) -> None:
        """Add the next part of the path; nothing is planned yet."""
        self._plan.extend(self._course.push(path))

    def pause_after(self, blocks: dict[int, Wait]) -> None:
        """Add blocks after which the machine waits for cycle_start, with the reason."""
        self._context.pause_blocks.update(blocks)

    def end_leg(self, wait: Wait) -> None:
        """End the motion at rest at the end of the path pushed so far."""
        self._plan.extend([self._course.end_leg(wait)])

    def release(self, s: float) -> None:
        """Drop the path before a place that was executed [m]."""
        self._course.release(s)
        self._plan.release(s)

    @property
    def current(self) -> MotionPlan:
        """The plan that counts now."""
        return self._plan

    @property
    def settings(self) -> OperatorSettings:
        """The settings that the current plan follows."""
        return self._plan.settings

    @property
    def first_block(self) -> int:
        """The first block of the path that is kept; 0 before there is any."""
        return self._course.first_block

    @property
    def planned(self) -> float:
        """Motion planned but not sampled [s]."""
        return self._plan.planned

    def position_at(self, s: float) -> FloatArray | None:
        """Return the axis positions at a place [m] on the path; None if it was dropped."""
        rest = self._course.rest_at(s)
        return None if rest is None else rest.position[0]

    @property
    def has_path(self) -> bool:
        """Tell whether there is path that is not planned."""
        return self._plan.has_path

    @property
    def can_plan(self) -> bool:
        """Tell whether there is path to plan."""
        return self._plan.can_plan

    @property
    def can_sample(self) -> bool:
        """Tell whether there is motion to sample."""
        return self._plan.can_sample

    def plan(self) -> None:
        """
        Plan one portion of the path.

        Raises
        ------
        PlanningError
            If there is no law within the limits.

        """
        self._plan.plan()

    def sample(self) -> list[Chunk]:
        """Sample a slice of the motion and return the chunks that are complete with it."""
        return self._plan.sample()

    def state_at(self, number: int) -> tuple[Leg, tuple[float, float, float]] | None:
        """Return leg and (s, s_dot, s_ddot) at a setpoint; None where it is forgotten."""
        return self._plan.state_at(number)

    def revision(self, number: int, settings: OperatorSettings) -> MotionPlan | None:
        """
        Plan with other settings from a setpoint that was handed out; the current plan stays.

        Parameters
        ----------
        number : int
            Number of the last setpoint that is executed as it is.
        settings : OperatorSettings
            The settings that the revision follows.

        Returns
        -------
        MotionPlan or None
            The revision, to be adopted or dropped before the stream takes anything else. None
            where no stop is known from there, or rest is near: ask again at a later setpoint.

        """
        found = self._plan.state_at(number)
        if found is None:
            return None
        leg, (s, v, a) = found
        if v <= 0.0:
            todo = finely(self._course.after(s))
            rest = self._course.rest_at(s)
            return MotionPlan(
                self._context, settings, todo, number + 1, before=self._plan, rests=rest
            )
        stop, rests = self._plan.way_down(number), settings.override <= 0.0
        if stop is None or (float(stop.law.duration.sum()) < BRIEF and not rests):
            return None
        assert leg.number_of_zero is not None
        begun, period = number - leg.number_of_zero + 1, self._context.period
        if not rests:
            new = Leg(self._context.limits, period, begun, (v, a), self._context.tool)
            todo = finely(self._course.after(s))
            plan = MotionPlan(self._context, settings, todo, number + 1, new, stop, self._plan)
            with suppress(PlanningError):
                while plan.can_plan and not plan.can_sample:
                    plan.plan()
                if not new.planner.stuck:
                    return plan
        # Stop; then go on from rest, where no law with the new feed was found from the motion.
        new = Leg(self._context.limits, period, begun, (v, a))
        new.drive(stop, Wait.OVERRIDE if rests else Wait.NOTHING)
        todo = finely(self._course.after(float(stop.path.s[-1])))
        return MotionPlan(self._context, settings, todo, number + 1, new, before=self._plan)

    def adopt(self, revision: MotionPlan) -> MotionPlan:
        """Replace the current plan by a revision, and return the replaced plan."""
        before, self._plan = self._plan, revision
        return before

    def resume(self, s: float, settings: OperatorSettings, way: AxisPath | None = None) -> None:
        """
        Plan anew from rest; setpoints are numbered from 0 again.

        Parameters
        ----------
        s : float
            The place on the path [m].
        settings : OperatorSettings
            The settings that the plan follows.
        way : AxisPath, optional
            The way to this place, where the machine stands beside the path; s below 0 [m].

        """
        if way is not None:
            self._course.lead(way, s)
            s = float(way.s[0])
        todo = self._course.after(s)
        rest = self._course.rest_at(s)
        self._plan = MotionPlan(self._context, settings, todo, rests=rest)
