"""The two ends of a stream as ROS topics: window, refusals, acknowledgements."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import SetpointChunk, StreamStatus
from rclpy._rclpy_pybind11 import RCLError

from cnc_interp.errors import StreamError
from cnc_interp.nodes.diagnostics import ERROR, OK, WARN, Diagnostics
from cnc_interp.nodes.qos import STATUS, STREAM
from cnc_interp.nodes.streams import WindowedReceiver, WindowedSender

#: Time between acknowledgements when nothing happens [s].
HEARTBEAT = 0.1


def numbers_of(message: Any) -> tuple[int, int]:
    """Return the number of a message's first item and how many it has."""
    if isinstance(message, SetpointChunk):
        return message.first_sample, len(message.sequences)
    return message.sequence, 1


class Inlet:
    """
    The receiving end of a stream.

    Parameters
    ----------
    node : Node
        The node.
    receiver : WindowedReceiver
        Its bookkeeping.
    kind : type
        Message type.
    check : callable
        Raises StreamError for a message that is not sound.
    on_message : callable
        Takes a sound message, in order.
    on_refusal : callable
        Told when the program is refused for an unsound message.
    diagnostics : Diagnostics
        Where refusals are named.
    status_period : float
        Time between acknowledgements while a program is received [s].

    """

    def __init__(
        self,
        node: Any,
        receiver: WindowedReceiver,
        kind: Any,
        check: Callable[[Any], None],
        on_message: Callable[[Any], None],
        on_refusal: Callable[[], None],
        diagnostics: Diagnostics,
        status_period: float = 0.02,
    ):
        self.receiver = receiver
        self._check, self._on_message, self._on_refusal = check, on_message, on_refusal
        self._diagnostics = diagnostics
        self._told: tuple[Any, ...] = ()
        self._told_at = -math.inf
        self._refused = 0
        self.buffered_time = math.nan
        self._status = node.create_publisher(StreamStatus, 'stream_status', STATUS)
        self._subscription = node.create_subscription(kind, receiver.stream, self._receive, STREAM)
        self._timer = node.create_timer(status_period, self._tick)
        diagnostics.say(receiver.stream, OK, 'no message refused')

    def _receive(self, message: Any) -> None:
        """Let a message in, or name why not."""
        first, count = numbers_of(message)
        receiver = self.receiver
        try:
            receiver.expect(message.program_id, first)
        except StreamError as fault:
            known = receiver.refusal if message.program_id == receiver.program_id else ''
            self._name(ERROR if known else WARN, known or str(fault))
            return
        try:
            self._check(message)
        except StreamError as fault:
            self.refuse(message.program_id, str(fault))
            return
        if receiver.program_id != message.program_id:
            self._refused = 0
            self._diagnostics.say(receiver.stream, OK, 'no message refused')
        receiver.take(message.program_id, count, message.end_of_program)
        self._on_message(message)

    def refuse(self, program_id: str, reason: str) -> None:
        """Let nothing more of a program in, and tell its sender why."""
        self.receiver.refuse(program_id, reason)
        self._name(ERROR, reason)
        self.tell()
        self._on_refusal()

    def _name(self, level: bytes, reason: str) -> None:
        """Put a refusal into the diagnostics."""
        self._refused += 1
        self._diagnostics.say(self.receiver.stream, level, reason, refused=self._refused)

    def _tick(self) -> None:
        """Acknowledge when there is news, else now and then."""
        receiver = self.receiver
        news = (receiver.program_id, receiver.next_number, receiver.limit, receiver.refusal)
        if news != self._told or time.monotonic() - self._told_at > HEARTBEAT:
            self.tell()

    def tell(self) -> None:
        """Publish how far the stream has come and how far it may go."""
        receiver = self.receiver
        self._told = (receiver.program_id, receiver.next_number, receiver.limit, receiver.refusal)
        self._told_at = time.monotonic()
        self._status.publish(
            StreamStatus(
                program_id=receiver.program_id,
                stream=receiver.stream,
                next_sequence=receiver.next_number,
                window_limit=receiver.limit,
                buffered_time=self.buffered_time,
                refusal=receiver.refusal,
            )
        )


class Outlet:
    """
    The sending end of a stream.

    Parameters
    ----------
    node : Node
        The node.
    stream : str
        Name of the topic.
    kind : type
        Message type.
    resend_after : float
        Time without acknowledgement after which sending starts again [s].
    encode : callable
        Makes the message of a queued item and its number.

    """

    def __init__(
        self,
        node: Any,
        stream: str,
        kind: Any,
        resend_after: float,
        encode: Callable[[Any, int], Any],
    ):
        self.sender: WindowedSender[Any] = WindowedSender(resend_after)
        self.stream = stream
        self.peer: StreamStatus | None = None
        self.peer_seen = -math.inf
        self._encode = encode
        self._publisher = node.create_publisher(kind, stream, STREAM)
        self._subscription = node.create_subscription(
            StreamStatus, 'stream_status', self._acknowledge, STATUS
        )

    def _acknowledge(self, status: StreamStatus) -> None:
        """Move the window on and use it."""
        if status.stream != self.stream:
            return
        now = time.monotonic()
        self.peer, self.peer_seen = status, now
        self.sender.acknowledge(status.program_id, status.next_sequence, status.window_limit, now)
        self.pump()

    @property
    def refusal(self) -> str:
        """Why the receiver refused this program; empty while it did not."""
        mine = self.peer is not None and self.peer.program_id == self.sender.program_id
        return str(self.peer.refusal) if mine and self.peer is not None else ''

    def pump(self) -> None:
        """Send what may be sent."""
        if not self.sender.program_id or self.refusal:
            return
        items = self.sender.due(time.monotonic())
        for done, item in enumerate(items):
            try:
                self._publisher.publish(self._encode(item.item, item.first))
            except RCLError:  # the line is busy: the rest goes with the next call
                self.sender.take_back(len(items) - done)
                return
