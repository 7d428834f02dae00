"""Topics between the nodes: messages are sealed, and messages without a seal are ignored."""

import time
from collections import Counter
from collections.abc import Callable, Collection
from functools import partial
from typing import Any, NamedTuple

from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message, serialize_message

from cnc_interp.nodes.node_main import WARN, Diagnostics
from cnc_interp.wire.seals import SECOND, WAITS, KnownSender, Place, Seal, opened_seal

UNKNOWN = '_NODE_NAME_UNKNOWN_'  #: Node name in ROS before discovery is complete.
#: Stream -> the node that receives it.
RECEIVERS = {'blocks': 'lookahead_node', 'segments': 'feedrate_node', 'setpoints': 'machine_node'}
#: Sealed topic -> the nodes that publish it. On ``blocks`` any node may publish, but only one.
OWNERS: dict[str, tuple[str, ...]] = {
    'blocks': (),
    'block_batches': ('program_node',),
    'segments': ('lookahead_node',),
    'setpoints': ('feedrate_node',),
    'stream_status': tuple(RECEIVERS.values()),
    'machine_state': ('machine_node',),
    'probe_contact': ('machine_node',),
    'executed_setpoints': ('machine_node',),
    'axis_feedback': ('machine_node',),
    'followed_spindle': ('machine_node',),
    'loaded_program': ('program_node',),
}
#: Topics whose messages contain consecutive numbers.
STREAMS = ('blocks', 'block_batches', 'segments', 'setpoints', 'executed_setpoints')
UNSEALED = 'has no seal of these nodes'


def publishers_of(node: Any, topic: str, owners: Collection[str] = ()) -> str:
    """Return the names of nodes that publish on a topic, without its rightful ``owners``."""
    names = [info.node_name for info in node.get_publishers_info_by_topic(topic)]
    found = {name for name in names if name not in (*owners, UNKNOWN)}
    found = found or {f'a second {name}' for name in owners if names.count(name) > 1}
    return ', '.join(sorted(found)) or 'a node that has ended, or that has another key'


def place_of(node: Any, topic: str) -> Place:
    return Place.of(f'{node.get_namespace()} {topic}')


class SealedPublisher:
    def __init__(self, node: Any, kind: Any, topic: str, profile: QoSProfile):
        self._publisher = node.create_publisher(kind, topic, profile)
        self._seal = Seal(place_of(node, topic))

    def publish(self, message: Any) -> None:
        """Seal and publish a message; it may already be serialised."""
        data = message if isinstance(message, bytes) else serialize_message(message)
        self._publisher.publish(self._seal.on(bytes(data)))


class Heard(NamedTuple):
    """A topic to subscribe to: message type, name, and quality of service."""

    kind: Any
    topic: str
    profile: QoSProfile
    about: bytes = b''  #: Messages without these bytes are skipped.


class Ear:
    """Subscribes to one topic; messages without a valid seal are ignored, counted and reported.

    ``tell`` is called with the suspected sender of an ignored message. ``spoilt`` returns whether
    a message was damaged in transit. ``read`` converts the bytes to the argument of ``take``.
    """

    def __init__(
        self,
        node: Any,
        heard: Heard,
        take: Callable[[Any], None],
        diagnostics: Diagnostics | None = None,
        tell: Callable[[str], object] = str,
        spoilt: Callable[[bytes], bool] = lambda data: False,
        read: Callable[[bytes], Any] = bytes,
    ):
        self._tell, self._spoilt, self._read = tell, spoilt, read
        self._node, self._take, self._diagnostics = node, take, diagnostics
        self._kind, self._topic, profile, self._about = heard
        self._place = place_of(node, self._topic)
        self._senders: dict[str, KnownSender] = {}
        self.ignored: Counter[str] = Counter()  #: Suspected sender -> ignored messages.
        self.subscription = node.create_subscription(
            self._kind, self._topic, self._hear, profile, raw=True
        )

    def _hear(self, data: bytes) -> None:
        if self._about not in data:
            return
        found = opened_seal(self._place, data)
        fault = UNSEALED
        if found is not None:
            message, sender, number = found
            content = self._read(message)
            known = self._known(content)
            fault = known.fault(sender, number, time.monotonic())
            if fault == WAITS:
                return
            if known.waiting and not fault:
                self.ignore(SECOND, known.waiting)
                known.waiting = 0
        elif not OWNERS[self._topic]:
            content, fault = self._read(data), self._company()
        elif self._spoilt(data):
            return
        if fault:
            self.ignore(fault)
        else:
            self._take(content)

    def _known(self, content: Any) -> KnownSender:
        of = ''
        if self._topic == 'stream_status':  # three nodes publish there
            is_read = isinstance(content, self._kind)
            of = (content if is_read else deserialize_message(content, self._kind)).stream
        return self._senders.setdefault(of, KnownSender(self._topic in STREAMS))

    def _company(self) -> str:
        alone = self.subscription.get_publisher_count() <= 1
        return '' if alone else 'has no seal, and is not from the only publisher'

    def ignore(self, fault: str, messages: int = 1) -> None:
        who = publishers_of(self._node, self._topic, OWNERS[self._topic])
        self.ignored[who] += messages
        self._tell(f'{self._topic} from {who}')
        if self._diagnostics is not None:
            text = f'a message on {self._topic} {fault} and is ignored; its publisher: {who}'
            told = dict(self.ignored)
            self._diagnostics.say(f'foreign {self._topic}', WARN, text, **told)


def hear(
    node: Any,
    kind: Any,
    topic: str,
    take: Callable[[Any], None],
    profile: QoSProfile,
    diagnostics: Diagnostics | None = None,
    tell: Callable[[str], object] = str,
    about: str = '',
) -> Ear:
    """Call ``take`` with each message of the topic's owner that contains the text ``about``."""
    read = partial(deserialize_message, message_type=kind)
    heard = Heard(kind, topic, profile, about.encode())
    return Ear(node, heard, take, diagnostics, tell, read=read)
