"""LinuxCNC's HAL as drives: what its pins had is what the nodes sent, also in a stop."""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

sys.path.append(str(Path(__file__).parents[2] / 'benchmarks'))

import hal_session
from cnc_interp_msgs.msg import MachineState
from nodes_under_test import DOMAIN, PATIENCE
from operated import Bench, path_of

from cnc_interp.client.session import nodes_file
from cnc_interp.core import InterpError
from cnc_interp.processes.node_processes import Children

pytestmark = pytest.mark.thorough

#: Deep, because a busy computer without real-time kernel stalls HAL's thread.
PARAMETERS = {'machine_node': {'drives': 'hal', 'hal_depth': 300}}


@pytest.fixture(scope='module')
def hal():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    with hal_session.Session() as session:
        yield session


@pytest.fixture(scope='module')
def bench(hal):
    bench = Bench(PARAMETERS)
    yield bench
    bench.close()


def changes(rows):
    return np.flatnonzero(np.diff(rows, axis=0).any(axis=1)) + 1


def at_rest(rows):
    return len(rows) > 20 and not len(changes(rows))


def until_at_rest(hal, bench, column):
    """Wait until the last periods are equal, in however small parts they are read."""
    rows = np.zeros((0, 5))

    def rests():
        nonlocal rows
        rows = np.concatenate([rows, hal.periods()[column]])[-50:]
        return at_rest(rows)

    bench.spin_until(rests)


def recover(bench):
    """Make ready, also after a test that failed."""
    bench.watching = True
    if bench.state.state == MachineState.FAULT:
        assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)


@pytest.fixture
def run(hal, bench):
    """The program on the way, when HAL's record begins."""
    recover(bench)
    hal.forget()
    until_at_rest(hal, bench, 0)
    handle = bench.begin()
    bench.until_at(0.05)
    return handle


def test_without_a_session_the_node_says_so():
    reason = hal_session.why_not()
    if reason:
        pytest.skip(reason)
    with (
        Children('/no_hal', DOMAIN, PARAMETERS, nodes_file()) as children,
        pytest.raises(InterpError, match='no HAL session runs here; start one: halrun'),
    ):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            children.check()
            time.sleep(0.1)


def prove(hal, bench, cut=False):
    """All that was executed, proven, was at HAL's pins in this order, a row in each period."""
    positions, _ = bench.proven(bench.heard_whole(), path_of(bench.text), cut)
    wanted, seen, empty = positions / hal_session.UNITS, np.zeros((0, 5)), np.zeros(0, dtype=bool)
    moved = changes(wanted)

    def complete():
        nonlocal seen, empty
        more, _, gaps, *_ = hal.periods()
        seen, empty = np.concatenate([seen, more]), np.concatenate([empty, gaps])
        return len(changes(seen)) >= len(moved)

    bench.spin_until(complete)
    at = changes(seen)[: len(moved)]  # without power the command follows the axes
    assert np.array_equal(seen[at], wanted[moved])
    assert not empty[at[0] : at[-1]].any()
    # HAL shows a setpoint for longer than it was planned where the machine rests, nowhere else.
    longer = np.diff(at) > np.diff(moved)
    assert (np.diff(at) >= np.diff(moved)).all()
    steps = np.abs(seen[at[1:]] - seen[at[1:] - 1])[longer]
    assert steps.max(initial=0.0) < 1e-4
    return len(steps)


def test_hal_plays_every_setpoint_bit_for_bit(hal, bench, run):
    bench.finish(run)
    assert prove(hal, bench) <= 1  # rests: after the approach
    assert bench.state.largest_following_error[0] > 1e-5  # the axes lag, and this is seen


def test_hold_and_killed_planner_stop_on_the_path_and_go_on(hal, bench, run):
    assert bench.press('feed_hold').success
    bench.until_state(MachineState.HELD)
    assert bench.press('cycle_start').success
    bench.spin_until(lambda: bench.state.state == MachineState.RUNNING)
    bench.until_at(0.1)
    bench.kill('feedrate_node')
    bench.until_state(MachineState.STARVED)
    bench.children.revive()
    bench.spin_until(lambda: any('was restarted' in text for _, text in bench.diagnostics))
    assert bench.press('cycle_start').success
    bench.finish(run)
    prove(hal, bench)


def test_emergency_stop(hal, bench, run):
    assert bench.press('emergency_stop').success
    bench.until_state(MachineState.FAULT)
    bench.result_of(run)
    prove(hal, bench)


@pytest.mark.parametrize(
    ('breaks', 'mends', 'text'),
    [
        ('sets a-fault 1', 'sets a-fault 0', 'A: the amplifier reports a fault'),
        ('sets estop-released 0', 'sets estop-released 1', 'the drives have no power'),
        ('setp c-axis.gain 0.001', 'setp c-axis.gain 0.5', 'C: following error over 1.1459'),
    ],
)
def test_what_the_drives_report_stops_the_axes(hal, bench, run, breaks, mends, text):
    hal.tell(*breaks.split())
    bench.until_state(MachineState.FAULT)
    assert text in bench.state.message
    assert bench.state.path_position > 0.05
    bench.result_of(run)
    prove(hal, bench, cut='gain' not in breaks)  # without power nothing follows a stop tail
    bench.spin_until(lambda: 'FALSE' in hal.tell('getp', 'bits-0.out-00'))
    if 'gain' not in breaks:
        answer = bench.press('reset')
        assert not answer.success and text in answer.message
    hal.tell(*mends.split())
    until_at_rest(hal, bench, 1)
    assert bench.press('reset').success
    bench.finish(bench.begin())


def test_the_power_is_taken_when_the_node_ends(hal, bench):
    recover(bench)
    assert 'TRUE' in hal.tell('getp', 'bits-0.out-00')
    bench.watching = False
    os.kill(bench.children.nodes['machine_node'].process.pid, signal.SIGTERM)
    bench.spin_until(lambda: bench.children.nodes['machine_node'].process.exitcode == 0)
    bench.spin_until(lambda: 'FALSE' in hal.tell('getp', 'bits-0.out-00'))
