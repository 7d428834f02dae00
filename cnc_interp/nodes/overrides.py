"""
The feed override and the rapid override that count.

The machine node alone listens to their topics and tells the values in ``machine_state``. So all
others have the same values, and those that start late have them with the first message. A second
listener could be found first by ``ros2 topic pub --once``, which ends 0.1 s after one is found.
"""

from __future__ import annotations

from typing import Any

from std_msgs.msg import Float64

from cnc_interp.nodes.diagnostics import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import OVERRIDE

#: Smallest and largest value of each override, by its topic [-].
RANGES = {'feed_override': (0.0, 1.5), 'rapid_override': (0.01, 1.0)}


class Override:
    """Receives an override of the operator."""

    def __init__(self, node: Any, diagnostics: Diagnostics, topic: str):
        self.value = 1.0
        self._diagnostics, self._topic = diagnostics, topic
        node.create_subscription(Float64, topic, self._take, OVERRIDE)

    def _take(self, message: Float64) -> None:
        """Accept a value within the range and refuse any other."""
        value, (least, most) = float(message.data), RANGES[self._topic]
        sound = least <= value <= most
        if sound:
            self.value = value
        wrong = f'{value:g} refused: it must lie between {least:g} and {most:g}'
        self._diagnostics.say(self._topic, OK if sound else WARN, f'{value:g}' if sound else wrong)


class Overrides:
    """Both overrides, as ``Override``."""

    def __init__(self, node: Any, diagnostics: Diagnostics):
        self.feed = Override(node, diagnostics, 'feed_override')
        self.rapid = Override(node, diagnostics, 'rapid_override')
