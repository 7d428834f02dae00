"""MachineState -> State and MachineReport: what others read from the machine's messages."""

from __future__ import annotations

import numpy as np
from cnc_interp_msgs.msg import MachineState

from cnc_interp.run.machine_report import MachineReport
from cnc_interp.run.run_state import State
from cnc_interp.wire.run_messages import run_id_of

#: The number of each state in ``MachineState``.
NUMBERS = {
    State.INACTIVE: MachineState.INACTIVE,
    State.IDLE: MachineState.IDLE,
    State.RUNNING: MachineState.RUNNING,
    State.PAUSED: MachineState.RUNNING,
    State.FILLING: MachineState.RUNNING,
    State.HOLDING: MachineState.HOLDING,
    State.HELD: MachineState.HELD,
    State.STARVING: MachineState.STARVED,
    State.STARVED: MachineState.STARVED,
    State.STOPPING: MachineState.STOPPING,
    State.FAULT: MachineState.FAULT,
    State.JOGGING: MachineState.JOGGING,
    State.AWAY: MachineState.JOGGING,
}


def state_of(message: MachineState) -> State:
    """Return the state of the machine; an unknown number counts as motion."""
    if message.state == MachineState.STARVED:
        return State.STARVED if message.resting else State.STARVING
    if message.state == MachineState.RUNNING and message.resting:
        fills = message.waits_for == MachineState.WAITS_FOR_SETPOINTS
        return State.FILLING if fills else State.PAUSED
    if message.state == MachineState.JOGGING:
        return State.AWAY if len(message.resume_positions) else State.JOGGING
    found = (state for state, number in NUMBERS.items() if number == message.state)
    return next(found, State.RUNNING)


def machine_report(message: MachineState) -> MachineReport:
    """Read a message of the machine."""
    stamp = message.header.stamp
    return MachineReport(
        run_id=run_id_of(message),
        state=state_of(message),
        plan_over=message.plan_over,
        start_wanted=message.start_wanted,
        completed=message.completed,
        path_position=message.path_position,
        stands=np.array(message.commanded_positions),
        time=stamp.sec + 1e-9 * stamp.nanosec,
        message=message.message,
        must_home=tuple(message.must_home),
        away=len(message.resume_positions) > 0,
    )
