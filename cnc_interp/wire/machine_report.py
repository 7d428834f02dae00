"""MachineState -> MachineReport: what the planning reads from the machine's messages."""

from __future__ import annotations

import numpy as np
from cnc_interp_msgs.msg import MachineState

from cnc_interp.run.machine_report import MachineReport, Resting
from cnc_interp.wire.run_id_messages import run_id_of

#: Where the machine rests, if it does.
RESTING = {
    MachineState.INACTIVE: Resting.IDLE,  # it says itself that it cannot take setpoints
    MachineState.IDLE: Resting.IDLE,
    MachineState.HELD: Resting.HELD,
    MachineState.STARVED: Resting.STARVED,
}


def machine_report(state: MachineState) -> MachineReport:
    """Read a message of the machine."""
    return MachineReport(
        run_id=run_id_of(state),
        resting=RESTING.get(state.state, Resting.MOVING) if state.resting else Resting.MOVING,
        plan_over=state.plan_over,
        start_wanted=state.start_wanted,
        completed=state.completed,
        path_position=state.path_position,
        stands=np.array(state.commanded_positions),
    )
