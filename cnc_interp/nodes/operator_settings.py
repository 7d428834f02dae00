"""What the operator has set for the planner: feed override, single block, optional stop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from cnc_interp_msgs.msg import G1Block, PathSegment
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import OVERRIDE
from cnc_interp.run.motion_plan import OperatorSettings

#: Largest feed override [-].
MOST = 1.5


class OperatorInputs:
    """
    Inputs of the operator (feed override, single block, optional stop) and their current values.

    Parameters
    ----------
    node : Node
        The node.
    diagnostics : Diagnostics
        Where a wrong override is named.
    on_override : callable
        Called when the override was set: it counts for what is planned already, too.

    """

    def __init__(self, node: Any, diagnostics: Diagnostics, on_override: Callable[[], None]):
        self.settings, self._optional_stop = OperatorSettings(), False
        self._diagnostics, self._on_override = diagnostics, on_override
        node.create_subscription(Float64, 'feed_override', self._set_override, OVERRIDE)
        node.create_service(SetBool, 'single_block', self._set_single_block)
        node.create_service(SetBool, 'optional_stop', self._set_optional_stop)

    def _set_override(self, message: Float64) -> None:
        """Take the override, 0 to 1.5."""
        value = float(message.data)
        sound = 0.0 <= value <= MOST
        if sound:
            self.settings = replace(self.settings, override=value)
            self._on_override()
        said = f'{value:g}' if sound else f'{value:g} refused: it must lie between 0 and {MOST}'
        self._diagnostics.say('feed_override', OK if sound else WARN, said)

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

    def pauses_after(self, segment: PathSegment) -> bool:
        """Tell whether cycle_start is waited for after a segment (M0, M1)."""
        return segment.program_stop == G1Block.STOP or (
            segment.program_stop == G1Block.OPTIONAL_STOP and self._optional_stop
        )
