"""What the operator asks of the planner: feed override, single block, optional stop."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import G1Block, PathSegment
from std_msgs.msg import Float64
from std_srvs.srv import SetBool

from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import OVERRIDE
from cnc_interp.run.motion_plan import OperatorSettings

#: Largest feed override.
MOST = 1.5


class Wishes:
    """
    The last wish of each kind; they count for all that is planned from now on.

    Parameters
    ----------
    node : Node
        The node.
    diagnostics : Diagnostics
        Where a wrong override is named.
    on_change : callable
        Told when the override has changed: it counts for what is planned already, too.

    """

    def __init__(self, node: Any, diagnostics: Diagnostics, on_change: Callable[[], None]):
        self.override, self.single_block, self.optional_stop = 1.0, False, False
        self._diagnostics, self._on_change = diagnostics, on_change
        node.create_subscription(Float64, 'feed_override', self._see_override, OVERRIDE)
        for name in ('single_block', 'optional_stop'):
            node.create_service(SetBool, name, self._setting(name))

    def _see_override(self, message: Float64) -> None:
        """Take the override, 0 to 1.5."""
        value = float(message.data)
        sound = 0.0 <= value <= MOST
        if sound:
            self.override = value
            self._on_change()
        said = f'{value:g}' if sound else f'{value:g} refused: it must lie between 0 and {MOST}'
        self._diagnostics.say('feed_override', OK if sound else WARN, said)

    def _setting(self, name: str) -> Callable[[Any, Any], Any]:
        """Make the service of a switch."""

        def serve(request: Any, response: Any) -> Any:
            setattr(self, name, request.data)
            response.success, response.message = True, f'{name.replace("_", " ")}: {request.data}'
            return response

        return serve

    @property
    def settings(self) -> OperatorSettings:
        """The settings that a plan depends on."""
        return OperatorSettings(self.override, self.single_block)

    def pauses_behind(self, segment: PathSegment) -> bool:
        """Tell whether the operator is waited for behind a segment (M0, M1)."""
        return segment.program_stop == G1Block.STOP or (
            segment.program_stop == G1Block.OPTIONAL_STOP and self.optional_stop
        )
