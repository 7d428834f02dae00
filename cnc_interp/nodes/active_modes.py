"""Topic ``active_modes``: the modal state of the block that the machine executes."""

from __future__ import annotations

from typing import Any

from cnc_interp_msgs.msg import MachineState, ModalState

from cnc_interp.nodes.program_check import Prepared
from cnc_interp.nodes.qos import LOADED
from cnc_interp.wire.run_messages import modal_state


class ActiveModesTopic:
    """Tells the modal state of a run where it changes."""

    def __init__(self, node: Any):
        self._publisher = node.create_publisher(ModalState, 'active_modes', LOADED)
        self._told = ('', -1)

    def tell(self, program: Prepared, state: MachineState) -> None:
        """Publish the modal state of the block that is executed, if it is another one."""
        change = program.modes.change_before(state.sequence)
        told = (str(state.program_id), change)
        if told == self._told:
            return
        self._told = told
        if (modes := program.modes.after(change)) is None:
            self._publisher.publish(ModalState(program_id=state.program_id))
        else:
            self._publisher.publish(modal_state(modes, state.program_id))
