"""The settings of a goal count for its run: they reach the look-ahead, and the bag has them."""

import math
from collections import Counter, deque
from dataclasses import replace
from functools import partial

import pytest
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import (
    G1BlockBatch,
    MachineState,
    PathSegmentBatch,
    SetpointChunk,
    StreamStatus,
)
from diagnostic_msgs.msg import KeyValue
from nodes_under_test import NodesUnderTest
from whole_plans import plan_program

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import recorded_run
from cnc_interp.client.recorder import Recorder
from cnc_interp.client.replay import compute_again
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import qos
from cnc_interp.nodes.seals import place_of
from cnc_interp.nodes.streams import opened, sealed
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings, texts_of
from cnc_interp.wire.seals import SIZE, opened_seal

Result = RunProgram.Result
PROGRAM = 'G21 G90 G94\nG0 X0 Y0 Z0\nG1 X6 F2000\nY6\nX0 Y8\nM30\n'
#: Parameters of the nodes, and the choices of the goal, which differ from them.
OWN, CHOSEN = {'corner_ratio': 3.0}, {'corner_ratio': '1.5', 'contour_tolerance': '0.1 mm'}
MACHINE = Machine.load('xyzac')


@pytest.fixture(scope='module')
def nodes():
    parameters = {'program_node': OWN, 'lookahead_node': OWN}
    running = NodesUnderTest(parameters)
    yield running
    running.close()


def pairs(texts):
    return [KeyValue(key=key, value=value) for key, value in texts.items()]


def test_a_wrong_choice_is_refused_by_name_before_anything_moves(nodes):
    for texts, name in (({'corner_radius': '1'}, 'corner_radius'), ({'top': 'up'}, 'top')):
        result = nodes.result_of(nodes.start(text=PROGRAM, settings=pairs(texts)))
        assert result.code == Result.REFUSED and result.message.startswith(f'{name}: ')
        assert result.samples == 0 and not nodes.loaded


#: What the nodes say to each other while a program runs.
FOLLOWED = {
    'block_batches': (G1BlockBatch, qos.STREAM),
    'segments': (PathSegmentBatch, qos.STREAM),
    'setpoints': (SetpointChunk, qos.STREAM),
    'stream_status': (StreamStatus, qos.STATUS),
    'machine_state': (MachineState, qos.STATE),
}
FORGED = [
    MachineState(),
    MachineState(interpolation_period=0.001, commanded_positions=[math.nan] * 5),
    MachineState(state=200, plan_over=True, commanded_positions=[1e300], path_position=-1e300),
]


def test_what_other_nodes_say_is_ignored_and_they_are_named(nodes):
    """A block of another node was executed: 6.8 mm beside the path, and *proven*."""
    node, said, forgers = nodes.node, {}, {}
    for topic, (kind, profile) in FOLLOWED.items():
        said[topic] = deque(maxlen=1)
        node.create_subscription(kind, topic, partial(keep, node, topic, said), profile, raw=True)
        forgers[topic] = node.create_publisher(kind, topic, profile)
    nodes.be_known()
    goal = nodes.start(text=PROGRAM)
    nodes.spin_until(lambda: not nodes.peers.state.completed)
    wanted, sent = goal.get_result_async(), Counter()
    while not wanted.done():
        for topic in [topic for topic in forgers if said[topic]]:
            again = bytes(said[topic][0])
            forgers[topic].publish(again)  # with a sound seal, but heard before
            message = opened(again[:-SIZE], FOLLOWED[topic][0])
            forge(message)
            forgers[topic].publish(sealed(message) if hasattr(message, 'checksum') else message)
            sent[topic] += 2
            if topic == 'block_batches':
                nodes.blocks.publish(sealed(message.blocks[0]))
        for message in FORGED:
            forgers['machine_state'].publish(message)
        nodes.spin_for(0.05)
    nodes.children.check()
    result = wanted.result().result
    assert result.code == Result.SUCCEEDED and 'executed to the end' in result.message
    for topic in (*FOLLOWED, 'blocks'):
        assert f'{topic} from {node.get_name()}' in result.message, (topic, sent, result.message)
    for forger in forgers.values():
        node.destroy_publisher(forger)


def keep(node, topic, said, data):
    """Keep what a node of the run said, and not what was forged after it."""
    if opened_seal(place_of(node, topic), data) is not None:
        said[topic].append(data)


def forge(message):
    """Make the next message of a stream, with another place; or the same state, over."""
    if isinstance(message, G1BlockBatch):
        for block in message.blocks:
            block.sequence += len(message.blocks)
            block.tip = block.tip + 1e-3
    elif isinstance(message, PathSegmentBatch):
        for segment in message.segments:
            segment.sequence += len(message.segments)
            segment.bottom.control_points[0] += 1e-3
    elif isinstance(message, SetpointChunk):
        message.first_sample += len(message.sequences)
    elif isinstance(message, StreamStatus):
        message.next_sequence, message.refusal_kind = 0, StreamStatus.GIVEN_UP
    else:
        message.completed = message.plan_over = True


def test_the_choices_of_a_goal_are_those_of_its_run_and_of_its_bag(nodes, tmp_path):
    recorder = Recorder(nodes.node, tmp_path / 'bag')
    nodes.spin_until(recorder.ready)
    result = nodes.result_of(nodes.start(text=PROGRAM, settings=pairs(CHOSEN)))
    assert result.code == Result.SUCCEEDED, result.message
    nodes.spin_until(lambda: bool(nodes.loaded))
    nodes.spin_until(recorder.complete)
    recorder.close()
    wanted = Settings(corner_ratio=1.5, contour_tolerance=1e-4)
    assert {pair.key: pair.value for pair in nodes.loaded[-1].settings} == texts_of(wanted)
    program = read_text(PROGRAM, '<text>', Transform.of(MACHINE), wanted)
    length = plan_program(program, MACHINE, wanted).setpoints.s[-1]
    own = plan_program(program, MACHINE, replace(wanted, **OWN)).setpoints.s[-1]
    assert result.path_length == pytest.approx(length, abs=1e-9)
    assert abs(own - length) > 1e-6, 'the parameters of the nodes give another path'
    with Bag(tmp_path / 'bag') as bag:
        assert recorded_run(bag).settings == wanted
        assert all(plan.same == plan.recorded for plan in compute_again(bag))
