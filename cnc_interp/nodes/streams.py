"""Both ends of a stream on a ROS topic: checksum, window, checks, refusals, resending."""

import math
import time
import zlib
from collections import Counter
from collections.abc import Callable
from functools import partial
from typing import Any

from cnc_interp_msgs.msg import SetpointChunk, StreamStatus
from rclpy._rclpy_pybind11 import RCLError
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from cnc_interp.core import Refusal, StreamError
from cnc_interp.nodes.node_main import ERROR, OK, WARN, Diagnostics
from cnc_interp.nodes.qos import STATUS, STREAM
from cnc_interp.nodes.seals import Ear, Heard, SealedPublisher, hear
from cnc_interp.run.run_state import RunId
from cnc_interp.wire.run_messages import ends, run_id_of
from cnc_interp.wire.seals import SIZE
from cnc_interp.wire.window_protocol import WindowedReceiver, WindowedSender

CHECKSUM = 4  #: Length of a checksum [bytes].


def sealed(message: Any) -> bytes:
    """Return a serialised message; its last field is a checksum of the preceding bytes."""
    message.checksum = 0
    data = serialize_message(message)
    return bytes(data[:-CHECKSUM]) + zlib.crc32(data[:-CHECKSUM]).to_bytes(CHECKSUM, 'little')


def is_spoilt(data: bytes) -> bool:
    """Return whether the checksum of a serialised message does not match its content."""
    given = int.from_bytes(data[-CHECKSUM:], 'little')
    return given != 0 and given != zlib.crc32(data[:-CHECKSUM])


def opened(data: bytes, kind: Any) -> Any:
    """Return a message from its bytes; StreamError if it has a checksum that does not match."""
    if hasattr(kind, 'checksum') and is_spoilt(data):
        text = 'a message was damaged in transit (checksum); it is resent'
        raise StreamError(text, Refusal.SPOILT)
    try:
        return deserialize_message(data, kind)
    except Exception as fault:
        text = f'a message cannot be read ({fault}); it is sent again'
        raise StreamError(text, Refusal.SPOILT) from None


HEARTBEAT = 0.1  #: Time between acknowledgements if nothing has changed [s].
SILENT = 1.0  #: A receiver counts as silent after this time without a message [s].
STATUS_PERIOD = 0.01  #: Shortest time between two acknowledgements [s].
#: Valid refusals of a receiver; a message with another one is from a foreign node.
REFUSALS = frozenset(Refusal)


def hear_statuses(
    node: Any,
    take: Callable[[StreamStatus], None],
    stream: str = '',
    diagnostics: Diagnostics | None = None,
    tell: Callable[[str], object] = str,
) -> Ear:
    """Call ``take`` with each valid status of the receiver of ``stream``, by default of all."""

    def see(status: StreamStatus) -> None:
        if status.stream == (stream or status.stream) and status.refusal_kind in REFUSALS:
            take(status)

    return hear(node, StreamStatus, 'stream_status', see, STATUS, diagnostics, tell, stream)


def numbers_of(message: Any) -> tuple[RunId, int, int, bool]:
    """Return run, first item number and number of items, and whether the message begins a plan."""
    if isinstance(message, SetpointChunk):
        first, count = message.first_sample, len(message.sequences)
        return run_id_of(message), first, count, first == 0 or message.joins
    return run_id_of(message), message.sequence, 1, message.sequence == 0


class Inlet:
    def __init__(
        self,
        node: Any,
        receiver: WindowedReceiver,
        kinds: dict[str, Any],
        check: Callable[[Any], None],
        on_message: Callable[[Any], None],
        on_refusal: Callable[[], None],
        diagnostics: Diagnostics,
        gate: Callable[[Any], list[Any]] = lambda message: [message],
    ):
        self.receiver = receiver
        self.buffered_time = math.nan
        self._check, self._on_message, self._on_refusal = check, on_message, on_refusal
        self._gate = gate
        self._diagnostics, self._logger = diagnostics, node.get_logger()
        self._told: tuple[Any, ...] = ()
        self._told_at = -math.inf
        self._refused: Counter[Refusal] = Counter()
        self._named = (OK, '')
        self._status = SealedPublisher(node, StreamStatus, 'stream_status', STATUS)
        self._gap = False
        self._early: dict[int, Any] = {}  # messages after a gap, by their first number
        self._foreign: set[str] = set()  # senders ignored in this run
        self._topic = ''  # on which the run comes
        self._ears = {
            topic: Ear(
                node,
                Heard(kind, topic, STREAM),
                partial(self._receive, kind, topic),
                diagnostics,
                self._tell_foreign,
                partial(self._is_spoilt, kind),
            )
            for topic, kind in kinds.items()
        }
        diagnostics.say(receiver.stream, OK, 'no message refused')

    def _tell_foreign(self, sender: str) -> None:
        if sender not in self._foreign:
            self._foreign.add(sender)
            self._publish(self.receiver.run_id, refusal_kind=Refusal.FOREIGN, refusal=sender)

    def _is_spoilt(self, kind: Any, data: bytes) -> bool:
        """Return whether a message has a wrong checksum; if so, request it again."""
        for message in (data, data[:-SIZE]):
            try:
                opened(message, kind)
                return False
            except StreamError as fault:
                kind_of, reason = fault.kind, f'{self.receiver.stream}: {fault}'
        self._ask_again(kind_of, reason)
        return True

    def _receive(self, kind: Any, topic: str, data: bytes) -> None:
        try:
            message = opened(data, kind)
        except StreamError as fault:
            self._ask_again(fault.kind, f'{self.receiver.stream}: {fault}')
            return
        receiver = self.receiver
        for passed in self._gate(message):
            program = receiver.run_id.program_id
            run_id, _, _, begins = numbers_of(passed)
            new = begins and run_id.program_id != program and topic == self._topic
            if new and receiver.gives_way(topic):
                receiver.make_way(run_id)
            if program == run_id.program_id and topic != self._topic:
                self._ears[topic].ignore(f'belongs to the run that is sent on {self._topic}')
                return
            self._enter(passed)
            if receiver.run_id.program_id != program:
                self._topic = topic
            while (early := self._early.pop(receiver.next_number, None)) is not None:
                self._enter(early)

    def _enter(self, message: Any) -> None:
        receiver = self.receiver
        run_id, first, count, begins = numbers_of(message)
        try:
            receiver.expect(run_id, first, begins)
        except StreamError as fault:
            mine = run_id == receiver.run_id
            if mine and fault.kind is Refusal.GAP and first < receiver.limit:
                self._early[first] = message
            self._pass_over(fault, mine)
            return
        try:
            self._check(message)
        except StreamError as fault:
            if fault.kind is Refusal.PLAN_OVER:
                receiver.close(str(fault))
            elif fault.kind is Refusal.TOO_LATE:  # the stream continues with the plan before
                self._name(WARN, fault.kind, str(fault))
                self._publish(run_id, refusal_kind=fault.kind, refusal=str(fault))
            else:
                self.refuse(run_id, fault.kind, str(fault))
            return
        if receiver.run_id != run_id:
            self._refused.clear()
            self._diagnostics.say(receiver.stream, OK, 'no message refused')
        begun = receiver.run_id != run_id
        if begun:
            self._early.clear()
            self._foreign.clear()
        receiver.take(run_id, first, count, message.end_of_program)
        self._gap = False
        self._on_message(message)
        if begun:
            self.tell()  # the sender may continue

    def _pass_over(self, fault: StreamError, mine: bool) -> None:
        receiver = self.receiver
        if fault.kind is Refusal.PLAN_OVER:
            self._logger.debug(str(fault))
        elif mine and fault.kind is Refusal.GAP:
            self._ask_again(fault.kind, str(fault))
        elif mine and receiver.refused:
            self._name(ERROR, receiver.refused, receiver.refusal_text)
        else:
            harmless = mine and fault.kind is Refusal.REPEAT  # the sender made sure
            self._name(OK if harmless else WARN, fault.kind, str(fault))

    def _ask_again(self, kind: Refusal, reason: str) -> None:
        self._name(WARN, kind, reason)
        if not self._gap:
            self._gap = True
            self.tell()

    def refuse(self, run_id: RunId, kind: Refusal, reason: str) -> None:
        self.receiver.refuse(run_id, kind, reason)
        self._name(OK if kind is Refusal.PROBED else ERROR, kind, reason, always=True)
        self.tell()
        self._on_refusal()

    def _name(self, level: bytes, kind: Refusal, reason: str, always: bool = False) -> None:
        """Report a refusal in the diagnostics: the 1st, 2nd, 4th ... of a kind, or ``always``."""
        self._refused[kind] += 1
        if always or self._refused[kind].bit_count() == 1:
            self._named = level, reason
        self._diagnostics.say(self.receiver.stream, *self._named, refused=self._refused.total())

    def _news(self) -> tuple[Any, ...]:
        receiver = self.receiver
        return receiver.run_id, receiver.next_number, receiver.limit, receiver.refused

    def tick(self) -> None:
        silent = time.monotonic() - self._told_at
        if silent > HEARTBEAT or (silent > STATUS_PERIOD and self._news() != self._told):
            self.tell()

    def tell(self) -> None:
        receiver, run_id = self.receiver, self.receiver.run_id
        self._told, self._told_at = self._news(), time.monotonic()
        missing = self._gap or max(self._early, default=-1) > receiver.next_number
        self._publish(
            run_id,
            gap=missing,
            next_sequence=receiver.next_number,
            window_limit=receiver.limit,
            buffered_time=self.buffered_time,
            refusal_kind=receiver.refused,
            refusal=receiver.refusal_text,
        )

    def _publish(self, run_id: RunId, **told: Any) -> None:
        self._status.publish(StreamStatus(stream=self.receiver.stream, **vars(run_id), **told))


class Outlet:
    def __init__(
        self,
        node: Any,
        stream: str,
        kind: Any,
        resend_after: float,
        encode: Callable[[Any, int], Any],
        topic: str = '',
        profile: QoSProfile = STREAM,
    ):
        self.sender: WindowedSender[Any] = WindowedSender(resend_after)
        self.stream = stream
        self.peer: StreamStatus | None = None
        self.heard = -math.inf  # when, by the monotonic clock [s]
        self._speaks_since = math.inf  # without a silence of ``SILENT``
        self.turned_away = False  # the plan that was to join came too late
        self._before = self.sender
        self._encode = encode
        self._publisher = SealedPublisher(node, kind, topic or stream, profile)
        hear_statuses(node, self._acknowledge, stream)

    def _acknowledge(self, status: StreamStatus) -> None:
        if status.refusal_kind == Refusal.FOREIGN:
            return
        if status.refusal_kind == Refusal.TOO_LATE:
            self.turned_away = run_id_of(status) == self.sender.run_id
            return
        now = time.monotonic()
        if now - self.heard > SILENT:
            self._speaks_since = now
        self.peer, self.heard = status, now
        run_id = run_id_of(status)
        told = run_id, status.next_sequence, status.window_limit, self.heard, status.gap
        self.sender.acknowledge(*told)
        if self._before.run_id == run_id:  # valid until the new plan has joined
            self._before.acknowledge(*told)
            self.sender.open(status.window_limit)
        self.pump()

    @property
    def unheard(self) -> float:
        """Time for which the receiver has reported, but acknowledged no item in its window [s]."""
        now, peer = time.monotonic(), self.peer
        closed = peer is not None and peer.window_limit <= peer.next_sequence
        closed = closed and run_id_of(peer) == self.sender.run_id
        speaks = now - self.heard < SILENT and not closed
        return now - max(self._speaks_since, self.sender.unanswered_since) if speaks else 0.0

    def join(self, run_id: RunId, first: int) -> None:
        """Begin a plan that joins the current one at item ``first``; see also ``take_back``."""
        self._before, self.sender = self.sender, WindowedSender(self.sender.resend_after)
        self.sender.begin(run_id, first, self._before.limit)

    def take_back(self) -> None:
        self.sender, self.turned_away = self._before, False

    @property
    def refused(self) -> Refusal:
        peer = self.peer
        if peer is None or not ends(peer, self.sender.run_id):
            return Refusal.NONE
        return Refusal(peer.refusal_kind)

    @property
    def refusal_text(self) -> str:
        return '' if self.peer is None else str(self.peer.refusal)

    def publish(self, message: Any) -> None:
        self._publisher.publish(sealed(message))

    def pump(self) -> None:
        if not self.sender.run_id or self.refused:
            return
        items = self.sender.due(time.monotonic())
        for done, item in enumerate(items):
            try:
                self.publish(self._encode(item.item, item.first))
            except RCLError:  # publishing failed: the rest is sent at the next call
                self.sender.take_back(len(items) - done)
                return
