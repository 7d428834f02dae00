"""
The feed override that counts.

The machine node alone listens to ``feed_override`` and tells the value in ``machine_state``. So
all others have the same value, and those that start late have it with the first message. A second
listener could be found first by ``ros2 topic pub --once``, which ends 0.1 s after one is found.
"""

from __future__ import annotations

from typing import Any

from std_msgs.msg import Float64

from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import OVERRIDE

#: Largest feed override [-].
MOST = 1.5


class FeedOverride:
    """
    Receives the feed override of the operator.

    Parameters
    ----------
    node : Node
        The node that listens.
    diagnostics : Diagnostics
        Where an override out of range is named.

    """

    def __init__(self, node: Any, diagnostics: Diagnostics):
        self.value = 1.0
        self._diagnostics = diagnostics
        node.create_subscription(Float64, 'feed_override', self._take, OVERRIDE)

    def _take(self, message: Float64) -> None:
        """Accept a value from 0 to ``MOST`` and refuse any other."""
        value = float(message.data)
        sound = 0.0 <= value <= MOST
        if sound:
            self.value = value
        said = f'{value:g}' if sound else f'{value:g} refused: it must lie between 0 and {MOST}'
        self._diagnostics.say('feed_override', OK if sound else WARN, said)
