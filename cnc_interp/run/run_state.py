"""The state of a run and the events that change it: run id, state, table of transitions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, IntEnum

from cnc_interp.core import StreamError


@dataclass(frozen=True)
class RunId:
    program_id: str = ''  #: Id of the run, which never changes; '' for no run.
    attempt: int = 0  #: How often the run was restarted after a node was lost.
    plan: int = 0  #: Number of the plan in the attempt. Blocks and segments always have plan 0.

    def __bool__(self) -> bool:
        return bool(self.program_id)

    def __str__(self) -> str:
        attempt = f' (attempt {self.attempt})' if self.attempt else ''
        plan = f', plan {self.plan}' if self.plan else ''
        return f'{self.program_id}{attempt}{plan}'

    def same_attempt(self, other: RunId) -> bool:
        """Return whether both are the same attempt at the same run; plans may differ."""
        return (self.program_id, self.attempt) == (other.program_id, other.attempt)

    def continues(self, other: RunId) -> bool:
        """Return whether this is a later attempt or a later plan of the same run as ``other``."""
        later = (self.attempt, self.plan) > (other.attempt, other.plan)
        return self.program_id == other.program_id and later

    def next_attempt(self) -> RunId:
        return RunId(self.program_id, self.attempt + 1)


NO_RUN = RunId()


class State(Enum):
    INACTIVE = 'inactive'  # drives off
    IDLE = 'idle'  # drives on, at rest, no program
    RUNNING = 'running'  # follows setpoints
    PAUSED = 'paused'  # at rest on the path while the feed override is 0
    FILLING = 'filling'  # at rest on the path until the buffer is full
    HOLDING = 'holding'  # slows down to a feed hold
    HELD = 'held'  # at rest on the path until cycle_start
    STARVING = 'starving'  # setpoints are late: follows the stop tail
    STARVED = 'starved'  # at rest on the path until setpoints come
    STOPPING = 'stopping'  # emergency stop or rejected stream: slows down on the path
    FAULT = 'fault'  # at rest until reset
    JOGGING = 'jogging'  # moves by hand, without a program
    AWAY = 'away'  # moves by hand away from a hold


class Event(Enum):
    ACTIVATE = 'activate'
    DEACTIVATE = 'deactivate'
    BEGIN = 'begin'  # another run begins
    REPLAN = 'replan'  # another plan of the run begins where the machine rests
    START = 'start'  # enough setpoints are buffered
    FINISH = 'finish'  # the end of the program is reached
    PAUSE = 'pause'  # the setpoints end at rest, for a feed override of 0
    WAIT = 'wait'  # the setpoints end at rest, for a program stop or a single block
    FILL = 'fill'  # the approach has ended and the buffer is not full
    STARVE = 'starve'  # the next setpoints are late
    REST = 'rest'  # the stop tail was followed to its end
    HOLD = 'hold'  # operator: feed_hold
    RESUME = 'resume'  # operator: cycle_start
    RESET = 'reset'  # operator: reset
    STOP = 'stop'  # operator: emergency_stop; or no further setpoints can be executed
    REFUSE = 'refuse'  # a setpoint message was rejected: no further ones of this run come
    FAIL = 'fail'  # the drives rejected a setpoint or reported a fault
    JOG = 'jog'  # operator: a motion by hand begins


class Reason(IntEnum):
    """Why the machine is in its state; values as in ``MachineState``."""

    NONE = 0
    FEED_HOLD = 1
    PROGRAM_STOP = 2
    OPTIONAL_STOP = 3
    SINGLE_BLOCK = 4
    OVERRIDE = 5
    STARVED = 6
    EMERGENCY_STOP = 7
    SETPOINT_REFUSED = 8
    DRIVE_FAULT = 9
    STREAM_REFUSED = 10
    APPROACH = 11
    AWAY = 12
    FUNCTION = 13
    PROBE = 14


class WaitsFor(IntEnum):
    """What the resting machine waits for; values as in ``MachineState``."""

    NOTHING = 0
    SETPOINTS = 1
    CYCLE_START = 2
    OVERRIDE = 3
    NEW_PLAN = 4
    RESET = 5
    INPUT = 6


#: Reason -> text for the operator; ``{}`` stands for the detail.
TEXTS = {
    Reason.NONE: '',
    Reason.FEED_HOLD: 'feed hold: press cycle start to continue',
    Reason.PROGRAM_STOP: 'program stop: press cycle start to continue',
    Reason.OPTIONAL_STOP: 'optional stop: press cycle start to continue',
    Reason.SINGLE_BLOCK: 'single block: press cycle start to continue',
    Reason.OVERRIDE: 'feed override is 0; raise it to continue',
    Reason.STARVED: (
        'no setpoints after {}: stopped on the path; continues when they come. If a node was '
        'lost, start it again, then press cycle start'
    ),
    Reason.EMERGENCY_STOP: 'emergency stop; press reset to continue',
    Reason.SETPOINT_REFUSED: '{}',
    Reason.DRIVE_FAULT: 'fault of a drive: {}; press reset to continue',
    Reason.STREAM_REFUSED: '{}',
    Reason.APPROACH: (
        'the approach is ready: retract along the tool, position, plunge; press cycle '
        'start to move'
    ),
    Reason.AWAY: (
        'the axes were moved away by hand; press cycle start to go back (retract along the tool, '
        'position, plunge) and on'
    ),
    Reason.FUNCTION: '{}',
    Reason.PROBE: 'the probe has answered',
}

_ACTIVE = tuple(state for state in State if state is not State.INACTIVE)
_ON_PATH_AT_REST = (State.PAUSED, State.FILLING, State.HELD, State.STARVED)
#: States in which the axes rest.
AT_REST = frozenset({State.INACTIVE, State.IDLE, *_ON_PATH_AT_REST, State.FAULT})
#: States in which the machine starts as soon as enough setpoints are buffered.
SELF_STARTING = frozenset({State.IDLE, State.PAUSED, State.FILLING, State.STARVED})
#: States in which cycle_start is accepted.
RESUMABLE = frozenset({State.HOLDING, State.HELD, State.STARVING, State.STARVED})


def _to(state: State, *before: State) -> dict[State, State]:
    return dict.fromkeys(before, state)


def _stays(*states: State) -> dict[State, State]:
    return {state: state for state in states}


S, _RESTS = State, _ON_PATH_AT_REST
#: Event -> state before it -> state after it.
_AFTER: dict[Event, dict[State, State]] = {
    Event.ACTIVATE: _to(S.IDLE, S.INACTIVE),
    Event.DEACTIVATE: _to(S.INACTIVE, S.IDLE, S.FAULT),
    Event.BEGIN: _to(S.IDLE, S.IDLE, *_RESTS),
    Event.REPLAN: _stays(S.IDLE, *_RESTS),
    Event.START: _to(S.RUNNING, S.IDLE, *_RESTS),
    Event.FINISH: _to(S.IDLE, S.RUNNING, S.JOGGING, *_RESTS) | _to(S.HELD, S.AWAY),
    Event.PAUSE: _to(S.PAUSED, S.RUNNING),
    Event.WAIT: _to(S.HELD, S.IDLE, S.RUNNING, *_RESTS),
    Event.FILL: _to(S.FILLING, S.IDLE, S.RUNNING, *_RESTS),
    Event.STARVE: _to(S.STARVING, S.RUNNING) | _stays(S.JOGGING, S.AWAY),
    Event.REST: _to(S.HELD, S.HOLDING, S.AWAY)
    | _to(S.STARVED, S.STARVING)
    | _to(S.FAULT, S.STOPPING)
    | _to(S.IDLE, S.JOGGING),
    Event.HOLD: _to(S.HOLDING, S.RUNNING, S.HOLDING, S.STARVING)
    | _to(S.HELD, *_RESTS)
    | _stays(S.JOGGING, S.AWAY),
    Event.RESUME: _stays(S.RUNNING, S.HOLDING, S.STARVING, *_RESTS),
    Event.RESET: _to(S.IDLE, S.IDLE, S.FAULT, *_RESTS),
    Event.STOP: {s: S.FAULT if s in AT_REST else S.STOPPING for s in _ACTIVE},
    Event.REFUSE: {s: S.FAULT if s in _RESTS else s for s in S},
    Event.FAIL: _to(S.FAULT, *_ACTIVE),
    Event.JOG: _to(S.JOGGING, S.IDLE) | _to(S.AWAY, S.HELD),
}
TRANSITIONS = {(s, event): to for event, rows in _AFTER.items() for s, to in rows.items()}
_REFUSALS = {
    Event.HOLD: 'nothing to hold: no program is moving',
    Event.RESUME: 'nothing to continue: no program is on hold',
    Event.RESET: 'the machine is still moving; reset when it rests',
}


@dataclass(frozen=True)
class RunState:
    state: State = State.INACTIVE  #: What the machine is doing.
    reason: Reason = Reason.NONE  #: Why it is in this state.
    detail: str = ''  #: Detail in the text of the reason: a count or a refusal.
    #: Whether a stop tail has ended the plan; a new plan must begin where the machine rests.
    plan_over: bool = False
    #: Whether cycle_start was given before enough setpoints were buffered.
    start_wanted: bool = False
    completed: bool = False  #: Whether the run was executed to its end.
    refusal: str = ''  #: Why no more setpoints of this run will arrive; '' if they may.

    @property
    def resting(self) -> bool:
        return self.state in AT_REST

    @property
    def by_hand(self) -> bool:
        return self.state in (State.JOGGING, State.AWAY)

    @property
    def leaves_plan(self) -> bool:
        held = self.by_hand and self.reason is Reason.FEED_HOLD
        return held or self.state in (State.HOLDING, State.STOPPING)

    @property
    def may_start(self) -> bool:
        """Whether the machine will move as soon as enough setpoints are buffered."""
        return self.state in SELF_STARTING or (self.state is State.HELD and self.start_wanted)

    @property
    def may_resume(self) -> bool:
        return self.state in RESUMABLE

    @property
    def waits_for(self) -> WaitsFor:
        if self.state is State.FAULT:
            return WaitsFor.RESET
        if self.state is State.PAUSED:
            return WaitsFor.OVERRIDE
        if self.state is State.FILLING:
            answers = self.reason is Reason.FUNCTION
            return WaitsFor.INPUT if answers else WaitsFor.SETPOINTS
        if self.state is State.HELD and not self.start_wanted:
            return WaitsFor.CYCLE_START
        if self.state in (State.HELD, State.STARVED):
            return WaitsFor.NEW_PLAN if self.plan_over else WaitsFor.SETPOINTS
        return WaitsFor.NOTHING

    @property
    def text(self) -> str:
        if self.state is State.FILLING and self.reason is not Reason.FUNCTION:
            return 'setpoints are being planned; motion continues by itself'
        if self.state is State.IDLE or self.by_hand:
            return ''
        return TEXTS[self.reason].format(self.detail)

    def after(self, event: Event, reason: Reason = Reason.NONE, detail: str = '') -> RunState:
        """Return the state after an event; raises StreamError if the event is not allowed."""
        following = TRANSITIONS.get((self.state, event))
        if following is None or (event is Event.JOG and self.start_wanted):
            raise StreamError(self._refused(event))
        if event is Event.JOG:
            return RunState(following, Reason.AWAY if following is State.AWAY else Reason.NONE)
        if event in (Event.ACTIVATE, Event.DEACTIVATE, Event.BEGIN, Event.RESET):
            return RunState(following)
        if self.state is State.AWAY and following is State.HELD:
            return self._rests_away()
        if self.state is State.JOGGING and following is State.IDLE:
            return RunState(following, self.reason)
        if self.state is State.JOGGING and event is Event.REFUSE:
            return self  # setpoints of another sender do not concern the machine
        if event is Event.RESUME:
            return replace(self, start_wanted=self.may_resume)
        if event is Event.REPLAN:
            return replace(self, plan_over=False, refusal='')
        if event is Event.REFUSE:
            told = replace(self, refusal=detail)
            return told._refused_at_rest() if self.state in _ON_PATH_AT_REST else told
        if event is Event.REST:
            rests = replace(self, state=following, plan_over=True)
            stopped = following is State.FAULT  # the reason of the stop remains
            return rests if stopped or not self.refusal else rests._refused_at_rest()
        if event is Event.HOLD and self.state in (State.HOLDING, State.HELD):
            return replace(self, start_wanted=False)
        return replace(
            self,
            state=following,
            reason=reason,
            detail=detail,
            start_wanted=False,
            plan_over=self.plan_over or following is State.FAULT,
            completed=self.completed or event is Event.FINISH,
        )

    def _rests_away(self) -> RunState:
        """Return the hold that continues after a motion by hand; the axes are off the path."""
        reason = Reason.FEED_HOLD if self.reason is Reason.FEED_HOLD else Reason.AWAY
        rests = replace(self, state=State.HELD, reason=reason, plan_over=True)
        return rests._refused_at_rest() if self.refusal else rests

    def _refused_at_rest(self) -> RunState:
        return replace(
            self,
            state=State.FAULT,
            reason=Reason.STREAM_REFUSED,
            detail=self.refusal,
            plan_over=True,
            start_wanted=False,
        )

    def _refused(self, event: Event) -> str:
        if self.state is State.INACTIVE:
            return f'{event.value} is not possible: the drives are off; activate machine_node'
        if event is Event.RESUME and self.by_hand:
            return 'the axes are moved by hand; press cycle start when they rest'
        if event is Event.JOG and self.start_wanted:
            return 'cycle start was pressed; feed hold takes it back'
        text = _REFUSALS.get(event, f'{event.value} is not possible while {self.state.value}')
        return f'{text} ({self.text})' if self.text else text
