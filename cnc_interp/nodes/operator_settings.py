"""What the operator has set for the planner: feed override, single block, optional stop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from cnc_interp_msgs.msg import G1Block, PathSegment
from std_srvs.srv import SetBool

from cnc_interp.run.chunk import Wait
from cnc_interp.run.motion_plan import OperatorSettings


class OperatorInputs:
    """
    Inputs of the operator (feed override, single block, optional stop) and their current values.

    Parameters
    ----------
    node : Node
        The node that offers the services.

    """

    def __init__(self, node: Any):
        self.settings, self._optional_stop = OperatorSettings(), False
        node.create_service(SetBool, 'single_block', self._set_single_block)
        node.create_service(SetBool, 'optional_stop', self._set_optional_stop)

    def see_override(self, value: float) -> bool:
        """Take the feed override [-] that the machine tells; tell whether it has changed."""
        changed = value != self.settings.override
        if changed:
            self.settings = replace(self.settings, override=value)
        return changed

    def _set_single_block(self, request: Any, response: Any) -> Any:
        """Answer the service ``single_block``."""
        self.settings = replace(self.settings, single_block=request.data)
        response.success, response.message = True, f'single block: {request.data}'
        return response

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
