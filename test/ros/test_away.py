"""Jog away from a hold and back to the path, over the real nodes; stops at every moment of it."""

import json
import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from cnc_interp_msgs.srv import MoveAxes
from limit_use import limit_use
from operated import LIMITS, PROGRAM, TRANSFORM, Bench, path_of

from cnc_interp.client.bag import Bag
from cnc_interp.client.recorder import Recorder
from cnc_interp.client.replay import compute_again
from cnc_interp.kinematics.axis_path import evaluate

Result = RunProgram.Result


@pytest.fixture(scope='module')
def bench():
    running = Bench({'feedrate_node': {'plunge_feed': 0.004}})  # a way back of some seconds
    yield running
    running.close()


@pytest.fixture(autouse=True)
def at_rest(bench):
    """Let nothing of a test that failed run on."""
    yield
    if bench.state.state in (MachineState.HELD, MachineState.FAULT):
        bench.press('reset')


def begin_to_move(bench, **request):
    """Ask for a motion by hand, and wait until it has begun."""
    answer = bench.mover.call_async(MoveAxes.Request(**request))
    bench.spin_until(answer.done)
    assert answer.result().success, answer.result().message
    bench.until_state(MachineState.JOGGING)


def away(bench, **request):
    """Move axes by hand in a hold; returns the state at rest after it."""
    begin_to_move(bench, **request)
    bench.until_state(MachineState.HELD)
    return bench.next_state()


def held_at(bench, length):
    bench.until_at(length)
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.HELD)
    return bench.next_state()


def told(bench):
    """Positions, path lengths and blocks of everything the drives were told in this run."""
    bench.spin_until(lambda: bench.peers.at_rest)
    state = bench.next_state()

    def mine():
        return [m for m in bench.executed if m.program_id == state.program_id]

    bench.spin_until(lambda: sum(len(m.sequences) for m in mine()) >= state.samples)
    q = np.concatenate([np.reshape(m.positions, (-1, 5)) for m in mine()])
    s = np.concatenate([m.path_positions for m in mine()])
    block = np.concatenate([m.sequences for m in mine()])
    assert limit_use(q, LIMITS) <= 1.001
    path = path_of(bench.text)
    mine_of_program = block > 0
    s, places = s[mine_of_program], evaluate(path, s[mine_of_program])[0]
    assert np.abs(q[mine_of_program] - places).max(initial=0.0) < 1e-9
    assert (np.diff(s) >= -1e-12).all()
    return q, s, block


@pytest.mark.thorough
def test_jogged_away_twice_it_comes_back_and_the_bag_is_proven(bench, tmp_path):
    listener = rclpy.create_node('recorder', namespace=bench.namespace, context=bench.context)
    bench.executor.add_node(listener)
    recorder = Recorder(listener, tmp_path / 'bag')
    bench.spin_until(recorder.ready)
    handle = bench.begin()
    rest = held_at(bench, 0.03)
    place = np.array(rest.commanded_positions)
    assert not len(rest.resume_positions)
    state = away(bench, axes=['Z', 'X'], values=[0.03, 0.02], relative=True)
    assert (state.reason, state.program_id) == (MachineState.REASON_AWAY, rest.program_id)
    assert state.path_position == rest.path_position and state.line_number == rest.line_number
    assert np.array_equal(state.resume_positions, place) and 'to go back' in state.message
    state = away(bench, axes=['C', 'A', 'Y'], values=[1.0, -0.2, 0.05], relative=True)
    assert np.array_equal(state.resume_positions, place)
    assert not np.allclose(state.commanded_positions, place, atol=1e-3)
    assert bench.press('cycle_start').success
    result = bench.result_of(handle)
    assert (result.code, result.message) == (Result.SUCCEEDED, 'executed to the end')
    bench.spin_until(lambda: bench.state.completed)
    assert not len(bench.state.resume_positions)
    q, s, block = told(bench)
    assert s[-1] == pytest.approx(path_of(PROGRAM).s[-1], abs=1e-12)
    outside = np.flatnonzero(block == 0)
    outside = outside[outside > np.argmax(block > 0)]  # by hand and back
    assert np.ptp(outside) == len(outside) - 1
    # The last of the way is a plunge along the tool, and it ends at rest where the hold was.
    tip, axis = TRANSFORM.forward(q[outside[-200:]])
    assert np.abs(q[outside[-1]] - place).max() < 1e-9
    assert np.linalg.norm(np.cross(tip - tip[-1], axis[-1]), axis=1).max() < 1e-9
    assert np.ptp((tip - tip[-1]) @ axis[-1]) > 1e-4
    bench.spin_until(recorder.complete)
    bench.executor.remove_node(listener)
    listener.destroy_node()
    recorder.close()
    done = subprocess.run(
        [sys.executable, '-m', 'cnc_interp', 'check', str(tmp_path / 'bag'), '--json'],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert json.loads(done.stdout)['samples'] == len(s)
    assert 'beside program' in json.loads(done.stdout)['beside']
    with Bag(tmp_path / 'bag') as bag:
        assert all(plan.same == plan.recorded for plan in compute_again(bag))


@pytest.mark.thorough
def test_held_on_the_way_back_it_goes_back_from_there(bench):
    handle = bench.begin()
    held_at(bench, 0.03)
    state = away(bench, axes=['X', 'C'], values=[0.1, 1.5], relative=True)
    stood = np.array(state.commanded_positions)
    for _ in range(2):
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: not np.allclose(bench.state.commanded_positions, stood))
        assert bench.press('feed_hold').success
        bench.until_state(MachineState.HELD)
        assert bench.next_state().path_position == state.path_position
        stood = np.array(bench.state.commanded_positions)
    away(bench, tool=0.005)
    assert bench.press('cycle_start').success
    assert bench.result_of(handle).code == Result.SUCCEEDED
    assert told(bench)[1][-1] == pytest.approx(path_of(PROGRAM).s[-1], abs=1e-12)


@pytest.mark.thorough
@pytest.mark.parametrize('when', ['away', 'jogging', 'back'])
@pytest.mark.parametrize('how', ['emergency_stop', 'cancel'])
def test_it_stops_at_every_moment(bench, when, how):
    handle = bench.begin()
    held_at(bench, 0.02)
    request = {'axes': ['X', 'Z'], 'values': [0.1, 0.05], 'relative': True, 'speed': 0.2}
    begin_to_move(bench, **request)
    if when != 'jogging':
        bench.until_state(MachineState.HELD)
    if when == 'back':
        stood = np.array(bench.next_state().commanded_positions)
        assert bench.press('cycle_start').success
        bench.spin_until(lambda: not np.allclose(bench.state.commanded_positions, stood))
    if how == 'cancel':
        handle.cancel_goal_async()
    else:
        assert bench.press('emergency_stop').success
    result = bench.result_of(handle)
    assert result.code == (Result.CANCELED if how == 'cancel' else Result.STOPPED)
    if how == 'cancel':
        bench.until_state(MachineState.IDLE)
    else:
        bench.until_state(MachineState.FAULT)
        told(bench)
        assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
    assert not len(bench.next_state().resume_positions)


@pytest.mark.thorough
def test_cycle_start_waits_for_the_hand_and_a_jog_for_cycle_start(bench):
    handle = bench.begin()
    held_at(bench, 0.02)
    begin_to_move(bench, axes=['X'], values=[0.05], relative=True, speed=0.01)
    answer = bench.press('cycle_start')
    assert not answer.success and 'moved by hand' in answer.message
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.HELD)
    assert bench.next_state().reason == MachineState.REASON_FEED_HOLD
    assert bench.press('cycle_start').success
    bench.until_at(0.03)
    assert bench.result_of(handle).code == Result.SUCCEEDED
    told(bench)
