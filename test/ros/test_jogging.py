"""Motion by hand over the real nodes: beats, moves, a joystick, the command line, refusals."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import Jog, MachineState
from cnc_interp_msgs.srv import MoveAxes
from limit_use import limit_use
from operated import LIMITS, TRANSFORM
from sensor_msgs.msg import Joy

from cnc_interp.commands.cli import main
from cnc_interp.nodes import qos


@pytest.fixture(scope='module')
def bench(shared_nodes):
    running = shared_nodes
    running.beats = running.node.create_publisher(Jog, 'jog', qos.BEATS)
    running.before = 0
    running.joy = running.node.create_publisher(Joy, 'joy', 10)
    running.spin_until(running.beats.get_subscription_count)
    return running


def move(bench, **request):
    bench.states.clear()
    answer = bench.mover.call_async(MoveAxes.Request(**request))
    bench.spin_until(answer.done)
    return answer.result()


def until_it_has_moved(bench):
    """See a motion that was asked for, also one that was over before the answer came."""
    bench.spin_until(lambda: any(s.state == MachineState.JOGGING for s in bench.states))


def until_idle(bench):
    """Where the machine rests; what it does from then on can be proven."""
    bench.spin_until(lambda: bench.next_state().state == MachineState.IDLE)
    if bench.state.program_id == 'jog':
        bench.before = bench.state.attempt
    return np.array(bench.state.commanded_positions)


def proven(bench, start):
    """Prove that all motion by hand since a rest kept the limits; returns where it ended."""
    before, end = bench.before, until_idle(bench)
    state = bench.state

    def told():
        return [m for m in bench.executed if m.program_id == 'jog' and m.attempt > before]

    def last():
        return sum(len(m.sequences) for m in told() if m.attempt == state.attempt)

    assert state.attempt > before
    bench.spin_until(lambda: last() >= state.samples)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in told()])
    assert np.array_equal(q[-1], end)
    assert limit_use(q, LIMITS, start) <= 1.001
    return end


def test_beats_move_axes_and_their_end_stops_them(bench):
    start = until_idle(bench)

    def beat():
        bench.beats.publish(Jog(axes=['X', 'C'], shares=[0.2, -0.1]))
        bench.spin_for(0.05)
        return bench.state.state == MachineState.JOGGING

    bench.spin_until(beat)
    for _ in range(10):
        beat()
    end = proven(bench, start)
    assert end[0] > start[0] and end[4] < start[4] and np.array_equal(end[1:4], start[1:4])


def test_a_move_arrives_and_a_hold_ends_one(bench):
    start = until_idle(bench)
    asked = {'axes': ['Y', 'A'], 'values': [0.02, 0.1], 'relative': True}
    answer = move(bench, **asked)
    assert answer.success, answer.message
    until_it_has_moved(bench)
    end = proven(bench, start)
    assert end == pytest.approx(start + [0, 0.02, 0, 0.1, 0], abs=1e-9)
    assert list(answer.positions) == pytest.approx(end, abs=1e-9)
    assert move(bench, axes=['X'], values=[0.45], speed=0.05).success
    until_it_has_moved(bench)
    assert bench.press('feed_hold').success
    assert proven(bench, end)[0] < 0.45


def test_a_pose_of_the_tool_is_reached(bench):
    start = until_idle(bench)
    tip = TRANSFORM.forward(start[None])[0][0]
    wanted, axis = [0.02, np.nan, -0.01], np.array([0.1, 0.2, 1.0])
    answer = move(bench, tip=wanted, axis=axis.tolist())
    assert answer.success, answer.message
    until_it_has_moved(bench)
    end = proven(bench, start)
    assert list(answer.positions) == pytest.approx(end, abs=1e-9)
    reached, turned = (found[0] for found in TRANSFORM.forward(end[None]))
    assert reached == pytest.approx([0.02, tip[1], -0.01], abs=1e-9)
    assert turned == pytest.approx(axis / np.linalg.norm(axis), abs=1e-9)
    for request, words in (
        ({'tip': [0.0, 0.0]}, 'three values'),
        ({'tip': [9.0, 0.0, 0.0]}, 'its travel is'),
        ({'tip': [0.0] * 3, 'axes': ['X'], 'values': [0.0]}, 'either'),
        ({'axis': [0.0, 0.0, -1.0]}, 'no rotary position'),
    ):
        answer = move(bench, **request)
        assert not answer.success and words in answer.message


def test_what_is_refused_is_told(bench):
    until_idle(bench)
    answer = move(bench, axes=['X'], values=[2.0])
    assert not answer.success and 'its travel is' in answer.message
    assert bench.press('emergency_stop').success
    answer = move(bench, axes=['X'], values=[0.0])
    assert not answer.success and 'emergency stop; press reset' in answer.message
    bench.beats.publish(Jog(axes=['X'], shares=[0.1]))
    told = ('machine_node: jog', answer.message)
    bench.spin_until(lambda: told in bench.diagnostics)
    assert bench.press('reset').success
    until_idle(bench)


@pytest.mark.thorough
def test_a_program_and_motion_by_hand_exclude_each_other(bench):
    until_idle(bench)
    assert move(bench, axes=['C'], values=[1.0], relative=True, speed=0.2).success
    handle = bench.begin()
    bench.until_at(0.005)
    answer = move(bench, axes=['X'], values=[0.0])
    assert not answer.success and 'while running' in answer.message
    bench.finish(handle)


def test_a_joystick_moves_axes_while_its_button_is_pressed(bench):
    start = until_idle(bench)
    command = [sys.executable, '-m', 'cnc_interp.nodes', 'joy_jog_node', '--ros-args']
    command += ['-r', f'__ns:={bench.namespace}', '-p', 'axis.Z:=1', '-p', 'scale.Z:=-0.3']
    node = subprocess.Popen(command, env=os.environ | {'ROS_DOMAIN_ID': str(bench.domain)})
    try:
        bench.spin_until(lambda: bench.joy.get_subscription_count() > 0)

        def hold_stick(pressed):
            bench.joy.publish(Joy(axes=[0.9, 0.8], buttons=[0, 0, 0, 0, int(pressed)]))
            bench.spin_for(0.05)
            return bench.state.state == MachineState.JOGGING

        assert not any(hold_stick(False) for _ in range(10))
        bench.spin_until(lambda: hold_stick(True))
        hold_stick(False)
    finally:
        node.terminate()
        assert node.wait(30.0) == 0
    end = until_idle(bench)
    assert end[2] < start[2] and np.array_equal(np.delete(end, 2), np.delete(start, 2))


def test_each_count_of_a_handwheel_on_joy_is_a_step_while_the_button_is_pressed(bench):
    start = until_idle(bench)
    command = [sys.executable, '-m', 'cnc_interp.nodes', 'joy_jog_node', '--ros-args']
    command += ['-r', f'__ns:={bench.namespace}', '-p', 'wheel.Y:=0', '-p', 'step:=0.7']
    node = subprocess.Popen(command, env=os.environ | {'ROS_DOMAIN_ID': str(bench.domain)})
    try:
        bench.spin_until(lambda: bench.joy.get_subscription_count() > 0)
        counts, pressed = 100.0, True

        def turn(by):
            nonlocal counts
            counts += by
            bench.joy.publish(Joy(axes=[counts], buttons=[0, 0, 0, 0, int(pressed)]))
            bench.spin_for(0.05)
            return bench.state.state == MachineState.JOGGING

        # The first count that is heard only shows where the wheel stands.
        bench.spin_until(lambda: turn(1.0))
        bench.spin_until(lambda: turn(-1.0) and bench.state.positions[1] < start[1] - 2e-3)
        pressed = False
        for _ in range(10):
            turn(10.0)
    finally:
        node.terminate()
        assert node.wait(30.0) == 0
    end = until_idle(bench)
    steps = (end[1] - start[1]) / 0.7e-3
    assert steps < -2.0 and steps == pytest.approx(round(steps), abs=1e-6)
    assert np.array_equal(np.delete(end, 1), np.delete(start, 1))


def test_the_command_line_moves_and_refuses_in_one_line(bench, capfd):
    def cnc_interp(*words):
        place = ['--namespace', bench.namespace, '--domain', str(bench.domain)]
        return main(['jog', *words, *place]), capfd.readouterr()

    start = until_idle(bench)
    code, said = cnc_interp('X', '-10', 'A', '2.5', '--json')
    assert code == 0, said
    end = json.loads(said.out)['position']
    assert end['X'] == pytest.approx(start[0] - 0.01, abs=1e-9)
    assert end['A'] == pytest.approx(start[3] + np.radians(2.5), abs=1e-9)
    code, said = cnc_interp('--pose', 'Z', '5', 'K', '2', '--json')
    assert code == 0, said
    place = np.array([list(json.loads(said.out)['position'].values())])
    tip, axis = (found[0] for found in TRANSFORM.forward(place))
    assert tip[2] == pytest.approx(5e-3, abs=1e-9)
    assert axis == pytest.approx([0.0, 0.0, 1.0], abs=1e-9)
    code, said = cnc_interp('--pose', 'A', '5')
    assert code == 2 and 'a pose has X Y Z' in said.err
    code, said = cnc_interp('X', '5000')
    assert code == 2 and said.err.count('\n') == 1
    assert 'X would go to' in said.err
