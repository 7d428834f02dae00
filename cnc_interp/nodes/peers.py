"""What the other nodes say, kept for the one that watches over the run."""

from __future__ import annotations

import math
import time
from typing import Any

from cnc_interp_msgs.msg import MachineState, StreamStatus

from cnc_interp.nodes.qos import STATE, STATUS

#: Each stream with the node that receives it.
RECEIVERS = {
    'blocks': 'lookahead_node',
    'segments': 'feedrate_node',
    'setpoints': 'machine_node',
}


class Peers:
    """
    The last word of every other node and when it came.

    Parameters
    ----------
    node : Node
        The node that listens.

    """

    def __init__(self, node: Any):
        self.state: MachineState | None = None
        self._state_seen = -math.inf
        self._status: dict[str, StreamStatus] = {}
        self._seen: dict[str, float] = {}
        node.create_subscription(StreamStatus, 'stream_status', self._see_status, STATUS)
        node.create_subscription(MachineState, 'machine_state', self._see_state, STATE)

    def _see_status(self, status: StreamStatus) -> None:
        self._status[status.stream] = status
        self._seen[status.stream] = time.monotonic()

    def _see_state(self, state: MachineState) -> None:
        self.state = state
        self._state_seen = time.monotonic()

    def trust(self, now: float) -> None:
        """Forget how long the others were silent: this node was not listening."""
        self._seen = dict.fromkeys(self._seen, now)
        self._state_seen = now

    @property
    def period(self) -> float:
        """Interpolation period of the machine [s]; 0 while it is unknown."""
        return float(self.state.interpolation_period) if self.state is not None else 0.0

    @property
    def at_rest(self) -> bool:
        """Tell whether the machine stands still until somebody does something."""
        state = self.state
        return state is not None and (
            state.state in (MachineState.IDLE, MachineState.HELD, MachineState.FAULT)
            or (state.state == MachineState.STARVED and state.plan_over)
        )

    def missing(self, now: float, timeout: float) -> str:
        """Name the first node that has been silent for longer than the timeout."""
        for stream, node in RECEIVERS.items():
            if now - self._seen.get(stream, -math.inf) > timeout:
                return node
        return '' if now - self._state_seen <= timeout else 'machine_node'

    def refusal(self, program_id: str) -> str:
        """Return why a program was refused, by the first node of the chain that did."""
        for stream in reversed(RECEIVERS):
            status = self._status.get(stream)
            if status is not None and status.program_id == program_id and status.refusal:
                return str(status.refusal)
        return ''

    def knows(self, stream: str, program_id: str) -> bool:
        """Tell whether the receiver of a stream is on a program."""
        status = self._status.get(stream)
        return status is not None and status.program_id == program_id
