"""The planning of successive runs. It has no ROS calls, no clock and no threads.

``step`` returns the next task. The caller executes it and hands the result to ``finish``.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, IntEnum
from typing import TYPE_CHECKING, Any, Protocol

from cnc_interp.core import FloatArray, InterpError, Refusal
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.motion_plan import MotionPlan
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_phase import LEFT, MachineReport
from cnc_interp.run.run_planner import Revision, RunPlanner
from cnc_interp.run.run_state import NO_RUN, RunId
from cnc_interp.run.setpoints import Chunk, Wait
from cnc_interp.smoothing.segments import PathSegments

if TYPE_CHECKING:
    from cnc_interp_msgs.msg import PathSegment

    from cnc_interp.nodes.streams import Outlet


class Port(Protocol):
    """The functions that the session needs from its node."""

    outlet: Outlet

    def make_planner(
        self, first: PathSegment, stands: FloatArray, place: float, settings: OperatorSettings
    ) -> RunPlanner: ...

    def read(
        self, segments: list[PathSegment]
    ) -> tuple[PathSegments, dict[int, Wait], Functions]: ...

    def consumed(self, count: int) -> None: ...

    def refuse(self, kind: Refusal, reason: str) -> None: ...


@dataclass(frozen=True)
class Received:
    run_id: RunId = NO_RUN  #: Plan that the machine receives.
    executed: float = -math.inf  #: Estimate: number of the setpoint to be executed next.
    turned_away: bool = False  #: Whether the last plan came too late to join.


@dataclass(frozen=True)
class PlanningTask:
    work: Callable[[], Any]
    then: Callable[[Any, float], None]


class Activity(Enum):
    NONE = 'no run'
    WAITING = 'waits for the machine to rest'
    PLANNING = 'plans ahead'
    REVISING = 'replans with new settings while the old plan continues'
    JOINING = 'has sent a plan that joins the previous one'
    RESUMING = 'replans from rest'
    ENDED = 'the run is over'


class Change(Enum):
    BEGIN = 'the first segment of a run arrived'
    PLACE = 'the machine reported where it rests'
    REVISE = 'the operator changed a setting'
    JOIN = 'the plan with new settings can still join in time'
    RESUME = 'the machine stopped and needs a new plan'
    DONE = 'the plan is finished'
    END = 'the run was executed, rejected or given up'


A, S = Activity, Change
TABLE: dict[tuple[Activity, Change], Activity] = {
    (A.WAITING, S.PLACE): A.PLANNING,
    (A.PLANNING, S.REVISE): A.REVISING,
    (A.REVISING, S.DONE): A.PLANNING,
    (A.REVISING, S.JOIN): A.JOINING,
    (A.JOINING, S.DONE): A.PLANNING,
    (A.PLANNING, S.RESUME): A.RESUMING,
    (A.RESUMING, S.DONE): A.PLANNING,
    **{(activity, S.BEGIN): A.WAITING for activity in A},
    **{(activity, S.END): A.ENDED for activity in A if activity is not A.NONE},
}


class PathEnd(IntEnum):
    OPEN = 0  # further segments come
    KNOWN = 1  # the last segment is there
    PLANNED = 2  # it is planned, down to rest
    QUEUED = 3  # its last setpoint is handed to the sender


SEGMENTS_PER_TASK = 64  #: Largest number of segments in one task.
#: Motion that is sampled before it can be sent; later planned motion is not sampled yet [s].
SAMPLED_AHEAD = 0.6
REVISE_AGAIN = 0.02  #: Time between the end of a revision and the next one [s].
#: A revision begins once this much motion is sent ahead, because it interrupts the sampling of the
#: current plan; or after the second time if less motion is ahead [s].
REFILLED, REFILLING = 0.8, 0.5
#: Time from the start of a revision to its join: the first value, and the largest one [s].
LEAD, LONGEST_LEAD = 0.065, 0.4
LONGER = 1.3  #: Time allowed for a revision over the time of the last one [-].
MARGIN = 0.03  #: A revision is late if its join is less than this ahead [s].


@dataclass(frozen=True)
class Kept:
    """The old plan, which stays in effect until the new one has joined."""

    run_id: RunId
    joins_at: int
    plan: MotionPlan
    path_end: PathEnd


class PlanningSession:
    """Plans one run after another; ``port``: node that reads segments and sends setpoints."""

    def __init__(self, port: Port, period: float, plan_ahead: float):
        self._port, self._period, self._plan_ahead = port, period, plan_ahead
        self.settings = OperatorSettings()
        self.activity = Activity.NONE
        self.run_id, self.path_end = NO_RUN, PathEnd.OPEN
        self.planner: RunPlanner | None = None
        self.task: PlanningTask | None = None
        self.ready = 0.0  # motion planned and not sent [s]
        self.wants_segments = False
        self.sent_before = 0  # setpoints, in earlier plans of the run
        self._continue_at = math.nan
        self._segments: deque[Any] = deque()
        self._machine: MachineReport | None = None  # since the run began
        self.executing = False  # the machine has begun the run and has not completed it
        self._received = Received()
        self._kept: Kept | None = None  # until the machine has answered
        self._asked_at = self._revised_at = -math.inf
        self._lead = LEAD
        self._plans = 0
        self.joins_at = 0  # number of the first setpoint of a plan that joins; 0 of any other

    def _change(self, step: Change) -> None:
        self.activity = TABLE[self.activity, step]

    def begin(self, run_id: RunId, continue_at: float) -> None:
        self._change(Change.BEGIN)
        self.run_id, self.path_end, self._continue_at = run_id, PathEnd.OPEN, continue_at
        self.planner, self.task, self._machine, self.executing = None, None, None, False
        self.sent_before = self.joins_at = self._plans = 0
        self._kept, self._lead = None, LEAD
        self._segments.clear()
        self._port.outlet.sender.begin(run_id)

    def take(self, segment: Any, last: bool) -> None:
        self._segments.append(segment)
        if last:
            self.end_path()

    def end_path(self) -> None:
        self.path_end = max(self.path_end, PathEnd.KNOWN)

    def see_machine(self, report: MachineReport) -> None:
        self._machine = report
        if self.run_id and report.run_id.same_attempt(self.run_id):
            self.executing = not report.completed
        if self.planner is not None and report.run_id.program_id == self.run_id.program_id:
            self.planner.stream.functions.told(report.functions)

    def give_up(self, kind: Refusal, reason: str) -> None:
        """End the run with a refusal; messages that were lost are not sent again."""
        if self.activity not in (Activity.NONE, Activity.ENDED):
            self._end()
            self._port.outlet.sender.begin(NO_RUN)
            self._port.refuse(kind, reason)

    def _end(self) -> None:
        self._change(Change.END)
        self._segments.clear()
        self.task, self.wants_segments = None, False

    def step(self, now: float, received: Received) -> PlanningTask | None:
        """Return the next task; None if there is none, or while one runs. ``now`` [s]: steady."""
        self._received = received
        if self.activity is Activity.JOINING:
            self._see_join()
        if self.task is not None:
            return None
        report = self._machine
        left = report is not None and not report.run_id.same_attempt(self.run_id)
        if self.executing and left:
            self.give_up(Refusal.GIVEN_UP, LEFT)
        if self.activity is Activity.WAITING:
            self._find_place()
        if self.activity in (Activity.PLANNING, Activity.JOINING) and self.planner is not None:
            self.task = self._next_task(self.planner, now)
        return self.task

    def _find_place(self) -> None:
        report = self._machine
        if not self._segments or report is None or not report.takes(self.run_id):
            return
        goes_on = self.run_id.attempt > 0 and report.run_id.program_id == self.run_id.program_id
        # The machine may have executed more since the rest of the program was requested. On the
        # approach it has executed nothing.
        place = self._continue_at
        if goes_on and report.path_position > 0.0:
            place = report.path_position
        first = self._segments[0]
        self.planner = self._port.make_planner(first, report.stands, place, self.settings)
        if report.run_id.program_id == self.run_id.program_id:
            self.planner.stream.functions.done = report.functions
        self._change(Change.PLACE)

    def _next_task(self, planner: RunPlanner, now: float) -> PlanningTask | None:
        report = self._machine
        if self.activity is Activity.JOINING:
            return self._plan_ahead_task(planner, report)
        if report is not None and report.left(self.run_id):
            return self._resume(planner, report)
        planner.stream.current.follow(self.settings)
        if self._must_revise(planner, now):
            return self._revise(planner, now)
        return self._plan_ahead_task(planner, report)

    def _resume(self, planner: RunPlanner, report: MachineReport) -> PlanningTask:
        self._change(Change.RESUME)
        sender, settings = self._port.outlet.sender, self.settings
        self.sent_before += sender.sent
        self._begin_plan(0)
        sender.begin(self.run_id)
        s, stands = report.path_position, report.stands
        return PlanningTask(
            lambda: planner.resume(s, stands, settings), lambda _, __: self._change(Change.DONE)
        )

    def _begin_plan(self, joins_at: int) -> None:
        self._plans += 1
        self.run_id, self.joins_at = replace(self.run_id, plan=self._plans), joins_at
        self.path_end = min(self.path_end, PathEnd.PLANNED)

    def _must_revise(self, planner: RunPlanner, now: float) -> bool:
        followed = planner.stream.current.settings
        if self.settings == followed or self._received.run_id != self.run_id:
            return False
        sent, queued = self._port.outlet.sender.sent, self.path_end is PathEnd.QUEUED
        refilled = queued or (sent - self._received.executed) * self._period > REFILLED
        return (
            sent > self.joins_at
            and not (queued and self._is_last(self._join_after()))
            and now - self._revised_at > REVISE_AGAIN
            and (refilled or now - self._asked_at > REFILLING)
        )

    def _is_last(self, number: int) -> bool:
        return number == self._port.outlet.sender.next_number - 1

    def _join_after(self) -> int:
        ahead = self._received.executed + self._lead / self._period
        return min(max(math.ceil(ahead), self.joins_at), self._port.outlet.sender.sent - 1)

    def _revise(self, planner: RunPlanner, now: float) -> PlanningTask:
        self._change(Change.REVISE)
        number, settings, self._asked_at = self._join_after(), self.settings, now
        return PlanningTask(lambda: planner.revise(number, settings), self._revised)

    def _revised(self, revision: Revision | None, now: float) -> None:
        """Send a revised plan if it can join in time; drop it if it is late."""
        planner = self.planner
        if revision is not None and self._is_late(revision.number):
            self._lead = self._lead_like_last(now)
            self._change(Change.DONE)
            return
        self._revised_at = now
        if revision is None or planner is None:
            self._change(Change.DONE)
            return
        self._lead = max(0.5 * self._lead, self._lead_like_last(now))
        self._change(Change.JOIN)
        before = planner.stream.adopt(revision.plan)
        self._kept = Kept(self.run_id, self.joins_at, before, self.path_end)
        self._begin_plan(revision.number + 1)
        self._port.outlet.join(self.run_id, self.joins_at)
        self._put(revision.chunks)

    def _lead_like_last(self, now: float) -> float:
        needed = LONGER * (now - self._asked_at) + MARGIN
        return min(max(needed, LEAD), LONGEST_LEAD)

    def _is_late(self, number: int) -> bool:
        """Return whether a plan would join too late at setpoint ``number``."""
        ahead = (number - self._received.executed) * self._period
        return ahead < MARGIN and not self._is_last(number)

    def _see_join(self) -> None:
        """End a join once the machine has answered; if it was too late, restore the old plan."""
        kept, planner = self._kept, self.planner
        if self._received.turned_away and kept is not None and planner is not None:
            planner.stream.adopt(kept.plan)
            self.run_id, self.joins_at = kept.run_id, kept.joins_at
            # The last segment may have come meanwhile.
            self.path_end = max(kept.path_end, min(self.path_end, PathEnd.KNOWN))
            self._port.outlet.take_back()
            self.task = None
            self._lead = min(2.0 * self._lead, LONGEST_LEAD)
        elif self._received.run_id != self.run_id:
            return
        self._kept = None
        self._change(Change.DONE)

    def _plan_ahead_task(
        self, planner: RunPlanner, report: MachineReport | None
    ) -> PlanningTask | None:
        plan = planner.stream.current  # even if another plan is current when this is done
        unsent = self._port.outlet.sender.unsent * self._period
        sample = unsent < SAMPLED_AHEAD and plan.can_sample
        self.ready = unsent + plan.planned
        ahead = self.ready < self._plan_ahead
        wants = ahead and not plan.has_path
        self.wants_segments = wants and not self._segments
        if sample or (ahead and plan.can_plan):
            mine = report is not None and report.run_id.same_attempt(self.run_id)
            known = report is not None and mine and not report.away
            executed = report.path_position if report is not None and known else -math.inf
            return PlanningTask(lambda: planner.work(plan, sample, executed), self._put)
        if self.activity is Activity.JOINING:
            return None  # more path is added when it is known which plan remains
        if wants and self._segments:
            count = min(SEGMENTS_PER_TASK, len(self._segments))
            read = self._port.read([self._segments.popleft() for _ in range(count)])
            consumed = self._port.consumed
            return PlanningTask(lambda: planner.push(*read), lambda _, __: consumed(count))
        if self.path_end is PathEnd.KNOWN and not self._segments:
            self.path_end = PathEnd.PLANNED
            return PlanningTask(planner.finish, lambda _, __: None)
        if self.path_end is PathEnd.QUEUED and report is not None and report.completed:
            self._end()
        return None

    def _put(self, chunks: list[Chunk], _now: float = 0.0) -> None:
        for chunk in chunks:
            self._port.outlet.sender.put(chunk, len(chunk.samples))
            if chunk.wait is Wait.END:
                self.path_end = PathEnd.QUEUED

    def finish(self, task: PlanningTask, outcome: Callable[[], Any], now: float) -> None:
        """Process the result of a task of the current run; an InterpError rejects the run."""
        if task is not self.task:
            return
        self.task = None
        try:
            task.then(outcome(), now)
        except InterpError as problem:
            self._end()
            self._port.refuse(Refusal.BAD_PATH, str(problem))
