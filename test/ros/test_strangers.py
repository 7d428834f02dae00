"""A thousand forged messages on the topics of the nodes: none is taken, and each is counted."""

import uuid
from collections import Counter

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.msg import (
    G1Block,
    G1BlockBatch,
    MachineState,
    PathSegment,
    PathSegmentBatch,
    SetpointChunk,
    StreamStatus,
)
from nodes_under_test import DOMAIN
from rclpy.executors import SingleThreadedExecutor

from cnc_interp.core import StreamError
from cnc_interp.nodes import qos
from cnc_interp.nodes.node_main import Diagnostics
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.seals import SealedPublisher
from cnc_interp.nodes.streams import Inlet, Outlet, sealed
from cnc_interp.processes.this_host import stay_on_this_host
from cnc_interp.run.run_state import RunId
from cnc_interp.wire.path_messages import blocks_of
from cnc_interp.wire.window_protocol import WindowedReceiver

#: Messages of each stream, and forged ones on each topic.
COUNT, FORGED = 60, 200
RUN = RunId('a' * 32)
TURN = 0.01  # [s]


def chunk(_, first):
    return SetpointChunk(**vars(RUN), first_sample=first, sequences=[first], line_numbers=[1])


#: Each stream: topic, its type, the topic of the senders, and how a message is made.
STREAMS = {
    'blocks': ('block_batches', G1BlockBatch, lambda _, k: batch(k)),
    'segments': ('segments', PathSegmentBatch, lambda _, k: segments(k)),
    'setpoints': ('setpoints', SetpointChunk, chunk),
}


def segments(k):
    return PathSegmentBatch(segments=[PathSegment(program_id=RUN.program_id, sequence=k)])


def batch(k):
    return G1BlockBatch(blocks=[G1Block(program_id=RUN.program_id, sequence=k, feedrate=1.0)])


class Cell:
    """Senders and receivers of all streams, a listener, and a stranger, in one process."""

    def __init__(self):
        stay_on_this_host()
        self.context, space = rclpy.Context(), f'/test_{uuid.uuid4().hex[:8]}'
        rclpy.init(context=self.context, domain_id=DOMAIN)
        self.executor = SingleThreadedExecutor(context=self.context)
        names = ('program_node', 'lookahead_node', 'feedrate_node', 'machine_node', 'stranger')
        self.nodes = {
            name: rclpy.create_node(name, namespace=space, context=self.context) for name in names
        }
        for node in self.nodes.values():
            self.executor.add_node(node)
        ends = zip(STREAMS.items(), names, names[1:], strict=False)
        self.outlets, self.inlets, self.taken = {}, {}, {}
        for (stream, (topic, kind, make)), sender, receiver in ends:
            self.outlets[stream] = Outlet(self.nodes[sender], stream, kind, 0.5, make, topic)
            node, self.taken[stream] = self.nodes[receiver], []
            kinds = {'blocks': G1Block, topic: kind} if stream == 'blocks' else {topic: kind}
            self.inlets[stream] = Inlet(
                node,
                WindowedReceiver(stream, 16),
                kinds,
                self.check,
                self.take(stream),
                lambda: None,
                Diagnostics(node),
                gate=parts_of,
            )
        self.states = SealedPublisher(
            self.nodes['machine_node'], MachineState, 'machine_state', qos.STATE
        )
        self.peers = Peers(self.nodes['program_node'])

    def check(self, message):
        if getattr(message, 'line_number', 0) == 666:
            raise StreamError('forged')  # would end the run

    def take(self, stream):
        def take(message):
            self.taken[stream].append(message)
            self.inlets[stream].receiver.consume(1)

        return take

    def turn(self):
        for outlet in self.outlets.values():
            outlet.pump()
        for inlet in self.inlets.values():
            inlet.tick()
        for _ in range(20):
            self.executor.spin_once(timeout_sec=TURN / 20)

    def turn_until(self, done, turns=20_000):
        while not done():
            turns -= 1
            assert turns, 'waited too long'
            self.turn()

    def close(self):
        self.executor.shutdown()
        for node in self.nodes.values():
            node.destroy_node()
        rclpy.shutdown(context=self.context)


def parts_of(message):
    if isinstance(message, SetpointChunk):
        return [message]
    return message.segments if isinstance(message, PathSegmentBatch) else blocks_of(message)


@pytest.fixture
def cell():
    cell = Cell()
    yield cell
    cell.close()


def forge(kind, number):
    """Make the message with a number that the receiver waits for, for this run."""
    if kind is SetpointChunk:
        return SetpointChunk(
            **vars(RUN), first_sample=number, sequences=[number], line_numbers=[666]
        )
    one = {'program_id': RUN.program_id, 'sequence': number, 'line_number': 666}
    if kind is PathSegmentBatch:
        return PathSegmentBatch(segments=[PathSegment(**one)])
    return G1Block(**one) if kind is G1Block else G1BlockBatch(blocks=[G1Block(**one)])


def test_a_thousand_forged_messages_are_ignored_and_their_sender_is_named(cell):
    """A block with the next number, published on blocks, was executed 6.8 mm off the path."""
    stranger, random = cell.nodes['stranger'], np.random.default_rng(54)
    forgers = {'blocks': (stranger.create_publisher(G1Block, 'blocks', qos.STREAM), G1Block)}
    for topic, kind, _ in STREAMS.values():
        forgers[topic] = (stranger.create_publisher(kind, topic, qos.STREAM), kind)
    status = stranger.create_publisher(StreamStatus, 'stream_status', qos.STATUS)
    state = stranger.create_publisher(MachineState, 'machine_state', qos.STATE)
    heard = {}
    for topic, kind, _ in STREAMS.values():
        heard[topic] = []
        stranger.create_subscription(kind, topic, heard[topic].append, qos.STREAM, raw=True)
    publishers = [status, state, *(publisher for publisher, _ in forgers.values())]
    cell.turn_until(lambda: all(p.get_subscription_count() for p in publishers))
    cell.turn_until(lambda: all(o.heard > 0.0 for o in cell.outlets.values()))
    for outlet in cell.outlets.values():
        outlet.sender.begin(RUN)
        outlet.sender.put(None)
    cell.turn_until(lambda: all(cell.taken.values()))
    stream_of = {'blocks': 'blocks', **{topic: s for s, (topic, *_) in STREAMS.items()}}
    sent = Counter()
    idle = MachineState(interpolation_period=1e-3, feed_override=1.0)
    idle.rapid_override = idle.spindle_override = 1.0
    for k in range(FORGED):
        for topic, (publisher, kind) in forgers.items():
            number = cell.inlets[stream_of[topic]].receiver.next_number
            publisher.publish(sealed(forge(kind, number)))
            sent[topic] += 1
            if heard.get(topic) and random.random() < 0.2:  # a sound seal, heard before
                publisher.publish(heard[topic][int(random.integers(len(heard[topic])))])
        stream = str(random.choice(list(STREAMS)))
        lie = StreamStatus(**vars(RUN), stream=stream, next_sequence=COUNT, refusal_kind=4)
        status.publish(lie)
        state.publish(MachineState(program_id=RUN.program_id, completed=True))
        sent['stream_status'] += 1
        sent['machine_state'] += 1
        cell.states.publish(idle)
        if k % 3 == 0 and k // 3 < COUNT - 1:
            for outlet in cell.outlets.values():
                outlet.sender.put(None)
        cell.turn()
    assert sent.total() >= 1000
    cell.turn_until(lambda: all(len(taken) >= COUNT for taken in cell.taken.values()))
    cell.turn_until(lambda: all(o.sender.all_acknowledged for o in cell.outlets.values()))
    ears = [ear for inlet in cell.inlets.values() for ear in inlet._ears.items()]
    cell.turn_until(lambda: all(ear.ignored.total() >= sent[topic] for topic, ear in ears))
    for stream, taken in cell.taken.items():
        numbers = [getattr(m, 'sequence', getattr(m, 'first_sample', 0)) for m in taken]
        assert numbers == list(range(COUNT)), stream
        assert not any(getattr(m, 'line_number', 0) == 666 for m in taken)
        assert not cell.inlets[stream].receiver.refused
    for topic, ear in ears:
        assert set(ear.ignored) == {'stranger'}, (topic, ear.ignored)
    assert not cell.peers.state.completed
    for topic in sent:
        assert f'{topic} from stranger' in cell.peers.foreign, (topic, cell.peers.foreign)


def test_a_second_node_of_the_same_name_and_key_is_ignored_while_the_first_one_speaks(cell):
    told = []
    second = rclpy.create_node(
        'machine_node',
        namespace=cell.nodes['stranger'].get_namespace(),
        context=cell.context,
    )
    other = SealedPublisher(second, MachineState, 'machine_state', qos.STATE)
    cell.turn_until(lambda: other._publisher.get_subscription_count() > 0)
    state = MachineState(interpolation_period=1e-3, feed_override=1.0)
    state.rapid_override = state.spindle_override = 1.0
    for k in range(30):
        state.samples = k
        cell.states.publish(state)
        cell.turn()
        told.append(cell.peers.state.samples if cell.peers.state else 0)
        state.samples = 1000
        other.publish(state)
        cell.turn()
    assert max(told) <= 29 and cell.peers.state.samples < 1000
    assert 'machine_state from a second machine_node' in cell.peers.foreign
    second.destroy_node()
