"""Rows of the run history over real nodes: what the operator did is what the row says."""

import hashlib

import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState
from operated import PROGRAM
from std_msgs.msg import Float64

from cnc_interp.run.run_history import RunHistory

Result = RunProgram.Result


@pytest.fixture
def bench(shared_nodes):
    shared_nodes.tidy()
    return shared_nodes


def rows_of(name):
    found = [row for row in RunHistory('').latest(500) if row['program'] == name]
    return found[::-1]


def start_moving(bench, **goal):
    bench.loaded.clear()
    handle = bench.start(text=PROGRAM, **goal)

    def moves():
        state, loaded = bench.peers.state, bench.loaded
        return loaded and state.program_id == loaded[-1].program_id and state.path_position > 0.01

    bench.spin_until(moves)
    return handle


def until(bench, state):
    bench.spin_until(lambda: bench.peers.state.state == state)


@pytest.mark.thorough
def test_a_run_that_was_held_and_one_that_was_stopped_are_rows(bench):
    # Slowly, so that it does not end before a busy computer presses the key.
    bench.override.publish(Float64(data=0.1))
    bench.spin_until(lambda: bench.peers.state.feed_override == 0.1)
    handle = start_moving(bench, program='held.ngc', operator_name='Ada', predicted_time=12.5)
    bench.press('feed_hold')
    until(bench, MachineState.HELD)
    bench.override.publish(Float64(data=1.0))
    bench.spin_for(0.5)
    bench.press('cycle_start')
    result = bench.result_of(handle)
    assert result.code == Result.SUCCEEDED
    (row,) = rows_of('held.ngc')
    assert row['operator'] == 'Ada' and row['outcome'] == 'succeeded'
    assert row['machine'] == 'xyzac' and float(row['predicted_s']) == 12.5
    assert row['sha256'] == hashlib.sha256(PROGRAM.encode()).hexdigest()
    assert (row['holds'], row['alarms']) == ('1', '0')
    motion = result.approach_time + result.cycle_time
    assert float(row['motion_s']) == pytest.approx(motion, abs=1e-3)
    assert float(row['held_s']) > 0.0
    # The machine moves or is held; planning before the first motion comes in addition.
    assert float(row['actual_s']) > motion + 0.5

    handle = start_moving(bench, program='stopped.ngc')
    bench.press('emergency_stop')
    assert bench.result_of(handle).code == Result.STOPPED
    (row,) = rows_of('stopped.ngc')
    assert (row['outcome'], row['alarms'], row['holds']) == ('stopped', '1', '0')
    assert row['predicted_s'] == '' and 'emergency stop' in row['message']


def test_a_refused_program_is_a_row_and_lines_by_hand_are_not(bench):
    before = len(RunHistory('').latest(500))
    assert bench.run(text='G1 X5 F', program='bad.ngc').code != Result.SUCCEEDED
    assert bench.run(text='M5', mdi=True).code == Result.SUCCEEDED
    (row,) = rows_of('bad.ngc')
    assert row['outcome'] == 'bad_program' and float(row['motion_s']) == 0.0
    assert len(RunHistory('').latest(500)) == before + 1
