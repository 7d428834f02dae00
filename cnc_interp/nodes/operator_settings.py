"""What the operator has set for the planner: overrides, single block, optional stop."""

from __future__ import annotations

from typing import Any

from cnc_interp_msgs.msg import G1Block, MachineState, PathSegment
from std_srvs.srv import SetBool

from cnc_interp.run.chunk import Wait
from cnc_interp.run.motion_plan import OperatorSettings


class OperatorInputs:
    """Inputs of the operator with their values; overrides and single block from the machine."""

    def __init__(self, node: Any):
        self.settings, self._optional_stop = OperatorSettings(), False
        node.create_service(SetBool, 'optional_stop', self._set_optional_stop)

    def see(self, state: MachineState) -> bool:
        """Store the settings that the machine reports; return whether they have changed."""
        before = self.settings
        self.settings = OperatorSettings(
            state.feed_override, state.single_block, state.rapid_override
        )
        return self.settings != before

    def _set_optional_stop(self, request: Any, response: Any) -> Any:
        """Answer the service ``optional_stop``."""
        self._optional_stop = request.data
        response.success, response.message = True, f'optional stop: {request.data}'
        return response

    def pauses_after(self, segments: list[PathSegment]) -> dict[int, Wait]:
        """Return the blocks after which cycle_start is waited for, and why (M0, M1)."""
        waits = {G1Block.STOP: Wait.PROGRAM_STOP}
        if self._optional_stop:
            waits[G1Block.OPTIONAL_STOP] = Wait.OPTIONAL_STOP
        return {
            int(segment.last_block): waits[segment.program_stop]
            for segment in segments
            if segment.program_stop in waits
        }
