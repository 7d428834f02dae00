"""MachineState -> MachineReport: what the sending side reads from the machine's messages."""

from __future__ import annotations

import numpy as np
from cnc_interp_msgs.msg import MachineState

from cnc_interp.run.machine_report import MachineReport, Motion
from cnc_interp.wire.run_id_messages import run_id_of

MOTION = {
    MachineState.IDLE: Motion.IDLE,
    MachineState.RUNNING: Motion.MOVING,
    MachineState.HOLDING: Motion.MOVING,
    MachineState.HELD: Motion.HELD,
    MachineState.STOPPING: Motion.STOPPING,
    MachineState.FAULT: Motion.FAULT,
    MachineState.INACTIVE: Motion.INACTIVE,
}


def machine_report(state: MachineState) -> MachineReport:
    """Read a message of the machine; STARVED is told from the first late setpoint on."""
    starved = Motion.STARVED if state.plan_over else Motion.MOVING
    stamp = state.header.stamp
    return MachineReport(
        run_id=run_id_of(state),
        motion=MOTION.get(state.state, starved),
        plan_over=state.plan_over,
        start_wanted=state.start_wanted,
        completed=state.completed,
        path_position=state.path_position,
        stands=np.array(state.commanded_positions),
        time=stamp.sec + 1e-9 * stamp.nanosec,
        message=state.message,
    )
