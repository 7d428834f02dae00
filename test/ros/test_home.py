"""Homing over the real nodes: before it no program starts, after it all do."""

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import Home, MoveAxes
from operated import Bench, Result

from cnc_interp.commands.cli import main
from cnc_interp.machine_model.machine import find_machine_file
from cnc_interp.nodes.parameters import NODES
from cnc_interp.nodes.qos import STATE

HOMING = """
homing:
  switches: {X: -20.0, Z: 15.0}
  order: [[Z], [X]]
  required: true
"""


@pytest.fixture(scope='module')
def bench(tmp_path_factory):
    file = tmp_path_factory.mktemp('machine') / 'homed.yaml'
    file.write_text(find_machine_file('xyzac').read_text() + HOMING)
    given = {'machine': f"'{file}'"}
    takes = [n for n, declared in NODES.items() if any(p.name == 'machine' for p in declared)]
    running = Bench({node: dict(given) for node in takes})
    running.home = running.node.create_client(Home, 'home')
    running.spin_until(running.home.service_is_ready)
    yield running
    running.close()


def ask(bench, client, request):
    answer = client.call_async(request)
    bench.spin_until(answer.done)
    return answer.result()


def test_no_program_starts_before_homing_and_a_hold_ends_it(bench):
    state = bench.next_state()
    assert list(state.must_home) == ['X', 'Z']
    assert list(state.homed) == [False, True, False, True, True]
    for goal in ({'text': 'G0 X0\nG1 X10 F500'}, {'text': 'G91', 'mdi': True}):
        result = bench.run(**goal)
        assert result.code == Result.REFUSED and 'X Z must be homed' in result.message
    assert bench.next_state().state == MachineState.IDLE
    assert not ask(bench, bench.home, Home.Request(axes=['C'])).success
    assert ask(bench, bench.home, Home.Request(axes=['X'])).success
    bench.until_state(MachineState.JOGGING)
    refused = ask(bench, bench.mover, MoveAxes.Request(axes=['Y'], values=[0.0]))
    assert not refused.success and 'being homed' in refused.message
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.IDLE)
    assert list(bench.next_state().must_home) == ['X', 'Z']


@pytest.mark.thorough
def test_homing_is_told_until_all_groups_are_homed(bench):
    heard = bench.listen('machine_state', MachineState, STATE)
    assert ask(bench, bench.home, Home.Request()).success

    def after_motion():
        states = [state.state for state in heard]
        begun = (
            states.index(MachineState.JOGGING) if MachineState.JOGGING in states else len(states)
        )
        return [state for state in heard[begun:] if state.state == MachineState.IDLE]

    bench.spin_until(after_motion)
    assert all(after_motion()[0].homed) and not after_motion()[0].must_home


def test_after_homing_from_the_command_line_programs_start(bench, capfd):
    command = ['home', '--namespace', bench.namespace, '--domain', str(bench.domain)]
    assert main([*command, 'Y']) == 2
    assert 'no reference switch' in capfd.readouterr().err
    assert main(command) == 0
    assert capfd.readouterr().out == 'homed\n'
    state = bench.next_state()
    assert all(state.homed) and not state.must_home and state.state == MachineState.IDLE
    assert -0.020 < state.positions[0] < -0.018 and 0.013 < state.positions[2] < 0.015
    result = bench.run(text='G91 G1 X2 F500', mdi=True)
    assert result.code == Result.SUCCEEDED, result.message
