"""A relay between the nodes that drops, repeats, reorders and corrupts some messages."""

import threading

import rclpy
from cnc_interp_msgs.msg import G1Block, G1BlockBatch, PathSegmentBatch, SetpointChunk
from rclpy.executors import SingleThreadedExecutor

from cnc_interp.nodes import qos

KINDS = ('dropped', 'duplicated', 'reordered', 'corrupted')
STREAMS = {
    'block_batches': G1BlockBatch,
    'segments': PathSegmentBatch,
    'setpoints': SetpointChunk,
    'blocks': G1Block,
}
#: Each stream with its sender; what it sends goes through the relay.
SENDERS = {
    'block_batches': 'program_node',
    'segments': 'lookahead_node',
    'setpoints': 'feedrate_node',
}
SENT = 'sent/'

#: ROS arguments of the nodes for which the relay stands in between.
ARGUMENTS = {node: ['-r', f'{stream}:={SENT}{stream}'] for stream, node in SENDERS.items()}


class Relay:
    """
    Stands between the nodes of a namespace.

    Parameters
    ----------
    namespace, domain
        Where the nodes are.
    random : numpy.random.Generator
        Chooses the faults.
    share : float
        Share of the messages that get one.
    streams : sequence of str
        Streams that go through the relay.

    """

    def __init__(self, namespace, domain, random, share, streams=tuple(SENDERS)):
        self.random, self.share = random, share
        self.counts = dict.fromkeys(KINDS, 0)
        self.passed = 0
        self._late = {}
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node('relay', namespace=namespace, context=self._context)
        self._publishers = {}
        for stream in streams:
            kind = STREAMS[stream]
            self._publishers[stream] = self._node.create_publisher(kind, stream, qos.STREAM)
            self._node.create_subscription(
                kind,
                f'{SENT}{stream}',
                lambda data, name=stream: self._pass(name, data),
                qos.STREAM,
                raw=True,
            )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()

    @property
    def faults(self):
        return sum(self.counts.values())

    def heard_by(self, count):
        """Tell whether so many subscribers hear each stream."""
        return all(p.get_subscription_count() >= count for p in self._publishers.values())

    def _pass(self, stream, data):
        publish = self._publishers[stream].publish
        late = self._late.pop(stream, None)
        if late is None and self.random.random() < self.share:
            kind = KINDS[int(self.random.integers(len(KINDS)))]
            self.counts[kind] += 1
            if kind == 'reordered':
                self._late[stream] = data
            elif kind == 'duplicated':
                publish(data)
                publish(data)
            elif kind == 'corrupted':
                publish(self._spoilt(data))
        else:
            self.passed += 1
            publish(data)
        if late is not None:
            publish(late)

    def _spoilt(self, data):
        """Flip one bit after the encapsulation header."""
        spoilt = bytearray(data)
        spoilt[int(self.random.integers(4, len(data)))] ^= 1 << int(self.random.integers(8))
        return bytes(spoilt)

    def close(self):
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
