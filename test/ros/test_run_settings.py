"""The settings of a goal count for its run: they reach the look-ahead, and the bag has them."""

from dataclasses import replace

import pytest
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, StreamStatus
from diagnostic_msgs.msg import DiagnosticArray, KeyValue
from nodes_under_test import NodesUnderTest
from whole_plans import plan_program

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorded_run import recorded_run
from cnc_interp.client.recorder import Recorder
from cnc_interp.client.replay import compute_again
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.nodes.peers import second_publisher
from cnc_interp.nodes.qos import DIAGNOSTICS, STATE, STATUS
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings, texts_of

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


@pytest.mark.thorough
def test_states_that_no_machine_has_are_ignored_and_told(nodes):
    """An inconsistent machine_state ended feedrate_node in 2 of 3 trials."""
    node, nan, told = nodes.node, float('nan'), []
    heard = node.create_subscription(
        DiagnosticArray, '/diagnostics', lambda m: told.extend(m.status), DIAGNOSTICS
    )
    goal = nodes.start(text=PROGRAM)
    forger = node.create_publisher(MachineState, 'machine_state', STATE)
    forged = [
        MachineState(),
        MachineState(interpolation_period=0.001, commanded_positions=[nan] * 5),
        MachineState(interpolation_period=0.0, commanded_positions=[0.0] * 5, path_position=nan),
        MachineState(state=200, plan_over=True, commanded_positions=[1e300], path_position=-1e300),
    ]
    for _ in range(20):
        for message in forged:
            forger.publish(message)
    result = nodes.result_of(goal)
    # It went on to its end; who publishes beside a node may have forged that.
    assert result.code == Result.STREAM_LOST, result.message
    stranger = f'machine_state is published by {node.get_name()} too'
    assert f'executed to the end, but {stranger}' in result.message
    nodes.spin_until(lambda: any('machine_state' in status.name for status in told))
    # No program begins beside it.
    result = nodes.result_of(nodes.start(text=PROGRAM))
    assert result.code == Result.BUSY and result.samples == 0
    assert stranger in result.message
    node.destroy_subscription(heard)
    node.destroy_publisher(forger)
    nodes.spin_until(lambda: node.count_publishers('machine_state') == 1)


@pytest.mark.thorough
def test_an_acknowledgement_that_no_receiver_gives_is_ignored(nodes):
    """A refusal of an unknown kind ended feedrate_node."""
    node = nodes.node
    goal = nodes.start(text=PROGRAM)
    nodes.spin_until(lambda: not nodes.peers.state.completed)
    forger = node.create_publisher(StreamStatus, 'stream_status', STATUS)
    nodes.spin_until(lambda: forger.get_subscription_count() >= 4)
    run, wanted = nodes.peers.state.program_id, goal.get_result_async()
    while not wanted.done():
        for stream in ('blocks', 'segments', 'setpoints'):
            forger.publish(StreamStatus(program_id=run, stream=stream, refusal_kind=100))
        nodes.spin_for(0.002)
    nodes.children.check()
    result = wanted.result().result
    stranger = f'stream_status is published by {node.get_name()} too'
    assert f'executed to the end, but {stranger}' in result.message, result.message
    node.destroy_publisher(forger)
    nodes.spin_until(lambda: second_publisher(node) == '')


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
