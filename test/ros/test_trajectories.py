"""Drives behind a trajectory controller: it executes what was played, a fixed time later."""

import os
import signal
import time

import numpy as np
import pytest

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp_msgs.msg import MachineState
from controller_stand_in import StandIn
from nodes_under_test import DOMAIN, PATIENCE
from operated import PROGRAM, Bench, T, path_of

from cnc_interp.client.session import nodes_file
from cnc_interp.core import InterpError
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.processes.node_processes import Children

pytestmark = pytest.mark.thorough

#: Long, because the machine node may wait for a busy computer.
DELAY = 2.0


@pytest.fixture(scope='module')
def robot():
    with StandIn(DOMAIN) as robot:
        yield robot


@pytest.fixture(scope='module')
def bench(robot):
    bench = Bench({'machine_node': robot.parameters(DELAY)})
    yield bench
    bench.close()


def rests_at(commanded, place):
    """Whether the last commands are one place: the controller is later than the machine."""
    return len(commanded) >= 3 and not (commanded[-3:] != place).any()


@pytest.fixture
def run(robot, bench):
    """The program on the way, when the record of the robot begins; at rest again at the end."""
    bench.until_state(MachineState.IDLE)
    bench.spin_until(lambda: rests_at(robot.commanded()[2], bench.state.commanded_positions))
    handle = bench.begin()
    bench.until_at(0.05)
    yield handle
    bench.watching = True
    if bench.state.state == MachineState.FAULT:
        assert bench.press('reset').success
    bench.until_state(MachineState.IDLE)
    assert robot.refusals == []


def cubic(p, v, k, u):
    """Between rows k and k + 1 of setpoints, at shares u of a period."""
    step, slope = p[k + 1] - p[k], T * v[k]
    bend = T * (v[k] + v[k + 1]) - 2.0 * step
    return p[k] + u * (slope + u * (step - slope - bend + u * bend))


def place_of(x, p, v, first, last):
    """Where a position lies among setpoints, in rows, and how far off it is [m, rad]."""
    near = first + int(np.abs(p[first:last] - x).max(axis=1).argmin())
    best = (np.inf, near)
    for k in {max(near - 1, 0), min(near, len(p) - 2)}:
        low, high = 0.0, 1.0
        for _ in range(60):
            shares = np.linspace(low, high, 5)
            sums = [np.sum((cubic(p, v, k, u) - x) ** 2) for u in shares]
            at = int(np.argmin(sums))
            low, high = shares[max(at - 1, 0)], shares[min(at + 1, 4)]
        off = np.abs(cubic(p, v, k, low) - x).max()
        best = min(best, (off, k + low))
    return best[1], best[0]


def prove(robot, bench):
    """All that was commanded is what was executed, proven, at the same times but for rests."""
    bench.recorded()
    told = [m for m in bench.executed if m.program_id == bench.state.program_id]
    p, v = (
        np.concatenate([np.reshape(getattr(m, name), (-1, 5)) for m in told])
        for name in ('positions', 'velocities')
    )
    found = [robot.commanded()]

    def complete():
        found.append(robot.commanded())
        return rests_at(found[-1][2], p[-1])

    bench.spin_until(complete)
    times, between, x = (np.concatenate(parts) for parts in zip(*found, strict=True))
    moving = np.flatnonzero(np.diff(x, axis=0).any(axis=1))
    first, last = moving[0] + 1, moving[-1] + 1
    assert between[first : last + 1].all()  # never on a way of the controller's own
    places = [0.0]
    for k in range(first, last + 1):
        low, reach = int(places[-1]), 20 + int((times[k] - times[k - 1]) / T)
        place, off = place_of(x[k], p, v, max(low - 20, 0), min(low + reach, len(p)))
        assert off < 1e-7, (place, off)
        places.append(place)
    speeds, elapsed = np.abs(v).max(axis=1), np.diff(times[first : last + 1]) / T
    for begin, end, rows in zip(places[1:], places[2:], elapsed, strict=False):
        low, high = sorted((int(begin), int(end)))
        if speeds[low : high + 2].min() > 2e-3:  # at rest the place is not known
            assert abs(end - begin - rows) < 0.1, (begin, end, rows)
    return len(places)


def test_without_a_robot_the_node_says_so():
    parameters = {'machine_node': StandIn(DOMAIN).parameters(DELAY)}
    with (
        Children('/no_robot', DOMAIN, parameters, nodes_file()) as children,
        pytest.raises(InterpError, match='is the joint_state_broadcaster active'),
    ):
        deadline = time.monotonic() + PATIENCE
        while time.monotonic() < deadline:
            children.check()
            time.sleep(0.1)


def test_the_controller_executes_every_setpoint(robot, bench, run):
    bench.finish(run)
    assert prove(robot, bench) > 500
    assert bench.state.largest_following_error[0] > 1e-6  # the axes lag, and this is seen


def test_hold_and_killed_planner_stop_on_the_path_and_go_on(robot, bench, run):
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
    prove(robot, bench)


def test_emergency_stop(robot, bench, run):
    assert bench.press('emergency_stop').success
    bench.until_state(MachineState.FAULT)
    bench.result_of(run)
    prove(robot, bench)


@pytest.mark.parametrize(
    ('breaks', 'mends', 'text'),
    [
        ({'stuck': 'slide_x'}, {'stuck': None}, 'X: following error over 1 mm'),
        ({'stall': True}, {'stall': False}, 'is the joint_state_broadcaster active?'),
        ({'speed': 70.0}, {'speed': 100.0}, 'executes trajectories at 70% of their speed'),
    ],
)
def test_what_the_robot_does_otherwise_stops_on_the_path(robot, bench, run, breaks, mends, text):
    robot.tell(**breaks)
    bench.until_state(MachineState.FAULT)
    assert text in bench.state.message
    assert bench.state.path_position > 0.05
    bench.result_of(run)
    if 'stuck' not in breaks:
        answer = bench.press('reset')
        assert not answer.success and text in answer.message
    robot.tell(**mends)
    prove(robot, bench)
    assert bench.press('reset').success
    bench.finish(bench.begin())


def test_a_killed_machine_node_leaves_the_axes_at_rest_on_the_path(robot, bench, run):
    bench.kill('machine_node')
    seen = []

    def at_rest():
        seen.extend(robot.commanded()[2])
        return len(seen) > 1000 and not np.diff(seen[-800:], axis=0).any()

    bench.spin_until(at_rest)
    path = path_of(PROGRAM)
    on_path = evaluate(path, np.linspace(0.0, path.s[-1], 100_000))[0]
    assert np.abs(on_path - seen[-1]).max(axis=1).min() < 2e-5
    bench.children.revive()
    bench.result_of(run)


def test_the_robot_comes_to_rest_when_the_node_ends(robot, bench):
    bench.watching = False
    os.kill(bench.children.nodes['machine_node'].process.pid, signal.SIGTERM)
    bench.spin_until(lambda: bench.children.nodes['machine_node'].process.exitcode == 0)
