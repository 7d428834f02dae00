"""The run as its sender sees it: phases, outcome, and the reports of the machine."""

import math
from dataclasses import dataclass
from enum import Enum, IntEnum

from cnc_interp.core import FloatArray, Refusal
from cnc_interp.run.run_state import SELF_STARTING, RunId, State


class Phase(Enum):
    QUEUED = 'waits for earlier programs'
    CHECKING = 'is read and checked'
    WAITING = 'waits until all nodes answer and the machine rests'
    OFFERED = 'blocks are sent; look-ahead and planner have not accepted the run yet'
    STREAMING = 'blocks are sent and executed'
    LOST = 'a node has forgotten the run; cycle start is needed'
    ENDED = 'has its result'


class PhaseChange(Enum):
    TURN = 'the earlier programs have ended'
    CHECKED = 'the check has passed'
    STALE = 'offsets or tools were changed after the check'
    START = 'all nodes answer and the machine rests'
    TAKEN = 'look-ahead and planner have accepted the run'
    LOSE = 'a node was restarted'
    BEGIN_AGAIN = 'the program is sent again'
    READ_ON = 'a probe has answered; the lines after it are read'
    END = 'the run has a result'


P, S = Phase, PhaseChange
TABLE: dict[tuple[Phase, PhaseChange], Phase] = {
    (P.QUEUED, S.TURN): P.CHECKING,
    (P.CHECKING, S.CHECKED): P.WAITING,
    (P.WAITING, S.STALE): P.CHECKING,
    (P.WAITING, S.START): P.OFFERED,
    (P.OFFERED, S.TAKEN): P.STREAMING,
    (P.OFFERED, S.LOSE): P.LOST,
    (P.STREAMING, S.LOSE): P.LOST,
    (P.LOST, S.LOSE): P.LOST,
    (P.LOST, S.BEGIN_AGAIN): P.OFFERED,
    (P.OFFERED, S.READ_ON): P.CHECKING,
    (P.STREAMING, S.READ_ON): P.CHECKING,
    **{(phase, S.END): P.ENDED for phase in P},
}
SENDING = (Phase.OFFERED, Phase.STREAMING, Phase.LOST)  #: Phases in which blocks are sent.


class Code(IntEnum):
    """Result code of a run; the values are those of the action ``RunProgram``."""

    SUCCEEDED = 0
    BAD_PROGRAM = 1
    REFUSED = 2
    STREAM_LOST = 3
    STOPPED = 4
    CANCELED = 5
    BUSY = 6
    NOT_STARTED = 7


@dataclass(frozen=True)
class Outcome:
    code: Code  #: Result code.
    message: str  #: What happened and what to do, for the operator.


def refused(kind: Refusal, reason: str, moved: bool) -> Outcome:
    if kind is Refusal.BAD_PATH:
        return Outcome(Code.REFUSED, reason)
    stopped = moved or kind in (Refusal.GIVEN_UP, Refusal.MACHINE_FAULT)
    return Outcome(Code.STOPPED if stopped else Code.REFUSED, reason)


SETTLED = 0.1  #: A machine that rests for this time after cycle_start lacks setpoints [s].
#: A machine that has not started after this time gets no more setpoints [s].
FILLED = 0.5
#: Text about a run that the machine does not know any more.
LEFT = 'the machine was reset, or machine_node started again; run the program again'


@dataclass(frozen=True)
class MachineReport:
    run_id: RunId  #: Run that the machine executes or executed last.
    state: State  #: State of the machine.
    plan_over: bool  #: Whether a stop tail has ended the plan, so that another must follow.
    #: Whether cycle_start was requested before enough setpoints were buffered.
    start_wanted: bool
    completed: bool  #: Whether the run was executed to its end.
    path_position: float  #: Path position reached [m].
    stands: FloatArray  #: (n_axes,): Commanded axis positions [m, rad].
    time: float  #: Time of the report, by the clock of the machine [s].
    message: str  #: Text about the state of the machine, for the operator.
    must_home: tuple[str, ...] = ()  #: Axes to be homed before a program may start.
    #: Whether the axes were jogged away during a hold and are not back on the path yet.
    away: bool = False
    functions: int = 0  #: Number of functions executed in the run so far.
    probed: bool = False  #: Whether the probe has ended the run.

    @property
    def rests_on_path(self) -> bool:
        return self.state in (State.HELD, State.STARVED)

    @property
    def is_free(self) -> bool:
        return self.state is State.IDLE or (self.state is State.STARVED and self.plan_over)

    @property
    def moves(self) -> bool:
        if self.state is State.HELD:
            return self.start_wanted and not self.plan_over
        return not (self.is_free or self.state in (State.INACTIVE, State.FAULT))

    def takes(self, run_id: RunId) -> bool:
        if self.state is State.HELD:
            # With cycle_start and enough setpoints of the old plan it would have left the hold.
            return run_id.attempt > 0 and (self.plan_over or self.start_wanted)
        waits = self.state in (State.FILLING, State.PAUSED, State.STARVED)
        if waits and run_id.attempt > 0:  # a node was lost meanwhile
            return True
        # A machine whose drives are off rejects the plan itself.
        return self.is_free or self.state is State.INACTIVE

    def left(self, run_id: RunId) -> bool:
        return self.run_id == run_id and self.plan_over and self.rests_on_path


class LossRecovery:
    """Decides, after a node was restarted, when the program must be sent again.

    If the machine has buffered setpoints, it starts at once on cycle_start. The rest of the
    program is sent when the machine rests again.
    """

    def __init__(self) -> None:
        self.node = ''  # the node that has forgotten the run
        self._restarted = False  # the machine continued with its buffered setpoints
        self._wants_since, self._waits = math.inf, -math.inf  # by the machine's clock [s]
        self._report: MachineReport | None = None

    def see(self, report: MachineReport) -> None:
        """Process a report of the machine; it executes this run or is free for it."""
        before, self._report = self._report, report
        held = before is not None and before.state is State.HELD
        if self.node and held and report.moves and report.state is not State.HELD:
            self._restarted = True
        wants = report.start_wanted or (self._restarted and report.state is State.STARVED)
        wants = (wants and report.rests_on_path) or (bool(self.node) and self._starts_by_itself)
        self._wants_since = min(self._wants_since, report.time) if wants else math.inf
        self._waits = report.time - self._wants_since

    @property
    def _starts_by_itself(self) -> bool:
        """Whether the machine will move as soon as it has setpoints, without cycle_start."""
        report = self._report
        return report is not None and report.state in SELF_STARTING - {State.STARVED}

    @property
    def is_due(self) -> bool:
        """Whether the program must be sent again now."""
        report = self._report
        fills = report is not None and report.state is State.STARVED and not report.plan_over
        least = FILLED if fills or self._starts_by_itself else SETTLED
        return bool(self.node) and self._waits >= least

    def begin_again(self) -> None:
        self.node, self._restarted = '', False
        self._wants_since, self._waits = math.inf, -math.inf
