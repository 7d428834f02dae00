"""The states of the machine and what leads from one to another; what is not here is refused."""

from __future__ import annotations

from enum import Enum

from cnc_interp.core.errors import StreamError


class State(Enum):
    """What the machine is doing."""

    INACTIVE = 'inactive'  # drives off
    IDLE = 'idle'  # drives on, at rest, no program
    RUNNING = 'running'  # following setpoints
    HOLDING = 'holding'  # feed hold or program stop: at rest on the path, or on the way to it
    STARVED = 'starved'  # setpoints did not come in time: at rest on the path, or on the way
    STOPPING = 'stopping'  # emergency stop or fault: on the way to rest on the path
    FAULT = 'fault'  # at rest after an emergency stop, or a setpoint was refused


class Event(Enum):
    """What changes the state."""

    ACTIVATE = 'activate'
    DEACTIVATE = 'deactivate'
    START = 'start'
    FINISH = 'finish'
    HOLD = 'hold'
    STARVE = 'starve'
    RESUME = 'resume'
    RESET = 'reset'
    STOP = 'stop'
    FAIL = 'fail'


# docs/operate/operation.md has this table in words; a test compares the two.
TRANSITIONS: dict[tuple[State, Event], State] = {
    (State.INACTIVE, Event.ACTIVATE): State.IDLE,
    (State.IDLE, Event.DEACTIVATE): State.INACTIVE,
    (State.IDLE, Event.START): State.RUNNING,
    (State.IDLE, Event.RESET): State.IDLE,
    (State.IDLE, Event.STOP): State.STOPPING,
    (State.IDLE, Event.FAIL): State.FAULT,
    (State.RUNNING, Event.FINISH): State.IDLE,
    (State.RUNNING, Event.HOLD): State.HOLDING,
    (State.RUNNING, Event.STARVE): State.STARVED,
    (State.RUNNING, Event.STOP): State.STOPPING,
    (State.RUNNING, Event.FAIL): State.FAULT,
    (State.HOLDING, Event.HOLD): State.HOLDING,
    (State.HOLDING, Event.RESUME): State.RUNNING,
    (State.HOLDING, Event.RESET): State.IDLE,
    (State.HOLDING, Event.STOP): State.STOPPING,
    (State.HOLDING, Event.FAIL): State.FAULT,
    (State.STARVED, Event.HOLD): State.HOLDING,
    (State.STARVED, Event.RESUME): State.RUNNING,
    (State.STARVED, Event.RESET): State.IDLE,
    (State.STARVED, Event.STOP): State.STOPPING,
    (State.STARVED, Event.FAIL): State.FAULT,
    (State.STOPPING, Event.STOP): State.STOPPING,
    (State.STOPPING, Event.FAIL): State.FAULT,
    (State.FAULT, Event.RESET): State.IDLE,
    (State.FAULT, Event.DEACTIVATE): State.INACTIVE,
    (State.FAULT, Event.STOP): State.FAULT,
    (State.FAULT, Event.FAIL): State.FAULT,
}

# Setpoints are followed in these states; in all but RUNNING they are those of a stop.
FOLLOWING = frozenset({State.RUNNING, State.HOLDING, State.STARVED, State.STOPPING})


def state_after(state: State, event: Event) -> State:
    """
    Look up which state follows an event.

    Raises
    ------
    StreamError
        If the event is not possible in this state; names those that are.

    """
    following = TRANSITIONS.get((state, event))
    if following is None:
        possible = ', '.join(e.value for s, e in TRANSITIONS if s is state)
        raise StreamError(
            f'{event.value} is not possible while {state.value}; possible: {possible}'
        )
    return following
