"""The two ends of a stream as ROS topics: window, refusals, acknowledgements."""

from __future__ import annotations

import math
import re
import time
import zlib
from collections import Counter
from collections.abc import Callable
from typing import Any

from cnc_interp_msgs.msg import SetpointChunk, StreamStatus
from rclpy._rclpy_pybind11 import RCLError
from rclpy.serialization import deserialize_message, serialize_message

from cnc_interp.core.errors import StreamError
from cnc_interp.nodes.diagnostics import ERROR, OK, WARN, Diagnostics
from cnc_interp.nodes.qos import STATUS, STREAM
from cnc_interp.run.run_id import RunId
from cnc_interp.wire.run_id_messages import run_id_of
from cnc_interp.wire.window_protocol import WindowedReceiver, WindowedSender

#: Time between acknowledgements when nothing happens [s].
HEARTBEAT = 0.1
#: Bytes of a checksum.
CHECKSUM = 4
#: What differs between refusals of one kind: numbers and names with numbers in them.
NUMBER = re.compile(r'\S*\d\S*')


class TooLateError(StreamError):
    """A sound message of a stream that the receiver has left already."""


def numbers_of(message: Any) -> tuple[RunId, int, int]:
    """
    Return the run of a message, the number of its first item and how many it has.

    Every plan of a run is a stream of its own: it is numbered from 0 and acknowledged alone.
    """
    if isinstance(message, SetpointChunk):
        return run_id_of(message), message.first_sample, len(message.sequences)
    return run_id_of(message), message.sequence, 1


def sealed(message: Any) -> bytes:
    """Serialise a message whose last field is a checksum of all before it."""
    message.checksum = 0
    data = serialize_message(message)
    return bytes(data[:-CHECKSUM]) + zlib.crc32(data[:-CHECKSUM]).to_bytes(CHECKSUM, 'little')


def opened(data: bytes, kind: Any) -> Any:
    """
    Read a message and compare its checksum, where one is given.

    Raises
    ------
    StreamError
        If the message was spoilt on its way.

    """
    given = int.from_bytes(data[-CHECKSUM:], 'little')
    if given and given != zlib.crc32(data[:-CHECKSUM]):
        raise StreamError('a message was spoilt on its way (checksum); it is sent again')
    try:
        return deserialize_message(data, kind)
    except Exception as fault:
        raise StreamError(f'a message cannot be read ({fault}); it is sent again') from None


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
        Raises StreamError for a message that is not sound, TooLateError when its stream was left.
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
        self._refused: Counter[str] = Counter()  # by kind
        self._named = (OK, '')
        self.buffered_time = math.nan
        self._status = node.create_publisher(StreamStatus, 'stream_status', STATUS)
        self._kind, self._gap = kind, False
        self._subscription = node.create_subscription(
            kind, receiver.stream, self._receive, STREAM, raw=True
        )
        self._timer = node.create_timer(status_period, self._tick)
        diagnostics.say(receiver.stream, OK, 'no message refused')

    def _receive(self, data: bytes) -> None:
        """Let a message in, or name why not."""
        receiver = self.receiver
        try:
            message = opened(data, self._kind)
        except StreamError as fault:
            self._ask_again(f'{receiver.stream}: {fault}')
            return
        run_id, first, count = numbers_of(message)
        try:
            receiver.expect(run_id, first)
        except StreamError as fault:
            mine = run_id == receiver.run_id
            if mine and first > receiver.next_number and receiver.active:
                self._ask_again(str(fault))
                return
            known = receiver.refusal if mine else ''
            self._name(ERROR if known else WARN, known or str(fault))
            return
        try:
            self._check(message)
        except TooLateError as fault:
            receiver.close(str(fault))
            self._name(WARN, str(fault))
            return
        except StreamError as fault:
            self.refuse(run_id, str(fault))
            return
        if receiver.run_id != run_id:
            self._refused.clear()
            self._diagnostics.say(receiver.stream, OK, 'no message refused')
        receiver.take(run_id, count, message.end_of_program)
        self._gap = False
        self._on_message(message)

    def _ask_again(self, reason: str) -> None:
        """Something is missing: have it sent again."""
        self._name(WARN, reason)
        if not self._gap:
            self._gap = True
            self.tell()

    def refuse(self, run_id: RunId, reason: str) -> None:
        """Let nothing more of a program in, and tell its sender why."""
        self.receiver.refuse(run_id, reason)
        self._name(ERROR, reason)
        self.tell()
        self._on_refusal()

    def _name(self, level: bytes, reason: str) -> None:
        """
        Put a refusal into the diagnostics.

        All are counted, but of each kind the 1st, 2nd, 4th, 8th ... are named: to name each of a
        burst would keep from receiving.
        """
        kind = NUMBER.sub('#', reason)
        self._refused[kind] += 1
        if self._refused[kind].bit_count() == 1:
            self._named = level, reason
        self._diagnostics.say(self.receiver.stream, *self._named, refused=self._refused.total())

    def _tick(self) -> None:
        """Acknowledge when there is news, else now and then."""
        receiver = self.receiver
        news = (receiver.run_id, receiver.next_number, receiver.limit, receiver.refusal)
        if news != self._told or time.monotonic() - self._told_at > HEARTBEAT:
            self.tell()

    def tell(self) -> None:
        """Publish how far the stream has come and how far it may go."""
        receiver = self.receiver
        self._told = (receiver.run_id, receiver.next_number, receiver.limit, receiver.refusal)
        self._told_at = time.monotonic()
        run_id = receiver.run_id
        self._status.publish(
            StreamStatus(
                program_id=run_id.program_id,
                attempt=run_id.attempt,
                plan=run_id.plan,
                gap=self._gap,
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
        self.paused = False
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
        self.sender.acknowledge(
            run_id_of(status), status.next_sequence, status.window_limit, now, status.gap
        )
        self.pump()

    @property
    def refusal(self) -> str:
        """Why the receiver refused this program; empty while it did not."""
        peer = self.peer
        if peer is None or run_id_of(peer) != self.sender.run_id:
            return ''
        return str(peer.refusal)

    def pump(self) -> None:
        """Send what may be sent."""
        if not self.sender.run_id or self.refusal or self.paused:
            return
        items = self.sender.due(time.monotonic())
        for done, item in enumerate(items):
            try:
                self._publisher.publish(sealed(self._encode(item.item, item.first)))
            except RCLError:  # the line is busy: the rest goes with the next call
                self.sender.take_back(len(items) - done)
                return
