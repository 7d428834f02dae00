"""The latest messages of the other nodes, and the time since they were received."""

import math
import time
from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import MachineState, StreamStatus

from cnc_interp.core import Refusal, StreamError
from cnc_interp.nodes.node_main import OK, WARN, Diagnostics
from cnc_interp.nodes.qos import STATE
from cnc_interp.nodes.seals import RECEIVERS, hear
from cnc_interp.nodes.streams import hear_statuses
from cnc_interp.run.run_phase import MachineReport
from cnc_interp.run.run_state import RunId
from cnc_interp.wire.message_checks import check_state
from cnc_interp.wire.run_messages import ends, machine_report, run_id_of
from cnc_interp.wire.window_protocol import Silence

#: Values of ``waits_for`` with which the machine continues without cycle_start.
STARTS_BY_ITSELF = (
    MachineState.WAITS_FOR_SETPOINTS,
    MachineState.WAITS_FOR_OVERRIDE,
    MachineState.WAITS_FOR_INPUT,
)


def watch_machine(
    node: Any,
    take: Callable[[MachineState], None],
    axis_count: int | None = None,
    diagnostics: Diagnostics | None = None,
    tell: Callable[[str], object] = str,
) -> None:
    """Call ``take`` with each state of the machine; drop invalid states and report why."""

    def see(state: MachineState) -> None:
        try:
            check_state(state, axis_count)
        except StreamError as problem:
            if diagnostics is not None:
                diagnostics.say('machine_state', WARN, f'{problem}; the message is ignored')
            return
        take(state)

    hear(node, MachineState, 'machine_state', see, STATE, diagnostics, tell)


class Peers:
    def __init__(
        self, node: Any, axis_count: int | None = None, diagnostics: Diagnostics | None = None
    ):
        self.state: MachineState | None = None
        self._state_seen = -math.inf
        self._status: dict[str, StreamStatus] = {}
        self._seen: dict[str, float] = {}
        self.foreign: set[str] = set()  #: Topics with ignored messages, and their senders.
        hear_statuses(node, self._see_status, '', diagnostics, self.foreign.add)
        watch_machine(node, self._see_state, axis_count, diagnostics, self.foreign.add)

    def _see_status(self, status: StreamStatus) -> None:
        if status.refusal_kind == Refusal.FOREIGN:
            self.foreign.add(str(status.refusal))
            return
        self._status[status.stream] = status
        self._seen[status.stream] = time.monotonic()

    def _see_state(self, state: MachineState) -> None:
        self.state = state
        self._state_seen = time.monotonic()

    @property
    def heard(self) -> float:
        """Monotonic time of the last message of any other node [s]."""
        return max(self._state_seen, *self._seen.values(), -math.inf)

    def trust(self, now: float) -> None:
        """Treat all known nodes as heard at time ``now`` [s], because this node was suspended."""
        self._seen = dict.fromkeys(self._seen, now)
        self._state_seen = now

    @property
    def machine(self) -> MachineReport | None:
        return None if self.state is None else machine_report(self.state)

    @property
    def period(self) -> float:
        """Interpolation period of the machine [s]; 0 while it is unknown."""
        return float(self.state.interpolation_period) if self.state is not None else 0.0

    @property
    def at_rest(self) -> bool:
        """Whether the machine rests and will not move without the operator."""
        return (
            self.state is not None
            and self.state.resting
            and self.state.waits_for not in STARTS_BY_ITSELF
        )

    @property
    def all_heard(self) -> bool:
        """Whether every other node has been heard; one that has not may still be starting."""
        return self.state is not None and self._seen.keys() >= RECEIVERS.keys()

    def missing(self, now: float, timeout: float) -> str:
        for stream, node in RECEIVERS.items():
            if now - self._seen.get(stream, -math.inf) > timeout:
                return node
        return '' if now - self._state_seen <= timeout else 'machine_node'

    def refusal(self, run_id: RunId) -> tuple[Refusal, str]:
        """Return why a run was rejected; of several nodes, that nearest to the machine decides."""
        for stream in reversed(RECEIVERS):
            status = self._status.get(stream)
            # A plan that joins too late does not end the run.
            if status is None or status.refusal_kind in (Refusal.NONE, Refusal.TOO_LATE):
                continue
            if self.knows(stream, run_id) or ends(status, run_id):
                return Refusal(status.refusal_kind), str(status.refusal)
        return Refusal.NONE, ''

    def told(self, stream: str, run_id: RunId) -> StreamStatus:
        """Return the last status of a run that the receiver of a stream has sent."""
        return self._status[stream] if self.knows(stream, run_id) else StreamStatus()

    def knows(self, stream: str, run_id: RunId) -> bool:
        status = self._status.get(stream)
        return status is not None and run_id_of(status).same_attempt(run_id)


class SenderWatch:
    """Reports the sender of a stream as lost, until the sender is heard again."""

    def __init__(
        self,
        node: Any,
        diagnostics: Diagnostics,
        stream: str,
        sender: str,
        timeout: float,
        heartbeat: str = '',
    ):
        self._diagnostics, self._stream, self._sender = diagnostics, stream, sender
        self._timeout = timeout
        self._silence, self._lost, self._part = Silence(), False, f'sender of {stream}'
        if heartbeat:
            hear_statuses(node, lambda _: self.hear(), heartbeat)

    def hear(self) -> None:
        self._silence.hear(time.monotonic())
        if self._lost:
            self._lost = False
            self._diagnostics.say(self._part, OK, f'{self._sender} is there again')

    def look(self, waits: bool) -> None:
        """Report the sender as lost if it is silent too long while this node ``waits`` for it."""
        silence = self._silence.waited(waits, time.monotonic())
        if silence > self._timeout and not self._lost:
            self._lost = True
            text = f'no {self._stream} for {silence:.0f} s; {self._sender} is lost, start it again'
            self._diagnostics.say(self._part, WARN, text)
