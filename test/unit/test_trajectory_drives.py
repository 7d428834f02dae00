"""Drives behind a trajectory controller: the motion it executes is the one that was played."""

import numpy as np
import pytest
from tiers import few_of

pytest.importorskip('rclpy', reason='needs ROS 2; run the tests with ./cnc test')

from builtin_interfaces.msg import Time
from controller_model import SECOND, ControllerModel
from test_drives_port import MACHINE, START, TARGET, T, chunks

from cnc_interp.core import InterpError, StreamError
from cnc_interp.machine.drive_kinds import joints_of
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.trajectory_drives import (
    JointReport,
    TrajectoryDrives,
)
from cnc_interp.nodes.controller_link import joint_report, joint_trajectory
from cnc_interp.run.run_state import Reason, RunId, State

PERIOD = round(T * SECOND)
#: Delays of the controller [s].
SHORT, LONG = 0.1, 1.5
JOINTS = ['C', 'A', 'Z', 'Y', 'X']  # of the controller, in an order of its own


class Bench:
    """Machine and controller under one clock that this class turns; the controller is exact."""

    name = 'controller'

    def __init__(self, delay=SHORT, **tolerances):
        self.delay = delay
        self.time, self.waits, self.silent = 1_000 * SECOND + 321_987, True, False
        self.model = ControllerModel(JOINTS, START[::-1], **tolerances)
        self.axes, self.stuck = START.copy(), np.zeros(5, dtype=bool)
        self.share = 1.0
        self.commanded, self.played, self.sent, self.reports = [], [], [], []
        self.drives = TrajectoryDrives(
            MACHINE, T, self, delay, np.where(MACHINE.is_linear, 1e-3, 0.02), 1.0
        )
        self.playback = Playback(MACHINE, T, self.drives, 50)
        self.playback.switch_on()
        self.waits = False

    # What the drives see of the controller.

    def now(self):
        return self.time

    def listens(self):
        return True

    def speed(self):
        return self.share

    def send(self, trajectory):
        message = joint_trajectory(trajectory, MACHINE.axis_names)
        self.sent.append(trajectory)
        assert self.model.take(message, self.time) == ''

    def take_reports(self):
        if self.waits:
            self.turn(10 * PERIOD)
        reports, self.reports = self.reports, []
        return reports

    def close(self):
        pass

    def turn(self, by=PERIOD):
        """Let time pass; the controller commands its axes and reports them."""
        self.time += by
        wanted = self.model.update(self.time, self.axes[::-1])[0][::-1]
        self.axes = np.where(self.stuck, self.axes, wanted)
        self.commanded.append(wanted)
        if not self.silent:
            self.reports.append(JointReport(self.time, self.axes, np.zeros(5)))

    def step(self, count=1):
        for _ in range(count):
            self.turn()
            self.playback.step()
            self.played.append(self.playback.axes.setpoints[-1].copy())

    def load(self):
        self.playback.begin(RunId('p'))
        for chunk in chunks():
            self.playback.push(chunk)

    def lag(self):
        """Largest difference of what was commanded from what was played before [m, rad]."""
        periods = round(self.delay / T)
        commanded = np.array(self.commanded[-len(self.played) :])
        return np.abs(commanded[periods:] - np.array(self.played)[:-periods]).max()


@pytest.mark.parametrize('delay', few_of(2, [SHORT, LONG]))
def test_the_controller_executes_the_setpoints_a_fixed_time_later(delay):
    bench = Bench(delay)
    bench.load()
    bench.step(1300 + round(delay / T))
    assert bench.playback.state.completed
    assert np.array_equal(bench.axes, TARGET)
    assert bench.lag() < 2e-8
    assert bench.playback.figures.largest_following_error.max() < 2e-8
    count = len(bench.sent)
    bench.step(300)
    assert len(bench.sent) == count  # nothing is sent at rest
    for trajectory in bench.sent:
        assert (np.diff(trajectory.times) > 0).all() and trajectory.times[0] == 0
        assert not trajectory.rows.velocity[-1].any()


def test_a_hold_comes_to_the_controller_as_it_was_played():
    bench = Bench()
    bench.load()
    bench.step(300)
    bench.playback.hold()
    bench.step(600)
    assert bench.playback.state.state is State.HELD
    assert np.array_equal(bench.axes, bench.played[-1]) and bench.lag() < 2e-8


def test_a_lost_machine_node_leaves_the_axes_on_the_path():
    bench = Bench()
    bench.load()
    bench.step(300)
    ends = bench.sent[-1].rows.position[-1]
    for _ in range(2000):
        bench.turn()
    assert np.array_equal(bench.axes, ends)
    way = (ends - START) / (TARGET - START).max()  # a line in the axes
    line = (TARGET - START) / (TARGET - START).max()
    assert np.abs(way - line * (way @ line) / (line @ line)).max() < 1e-9


def test_late_setpoints_end_the_motion_where_the_last_trajectory_ends():
    bench = Bench()
    bench.load()
    bench.step(300)
    ends = bench.sent[-1].rows.position[-1]
    for _ in range(90):
        bench.turn()  # nobody reads the cycle meanwhile, or its process stands still
    bench.step(5)
    playback = bench.playback
    assert (playback.state.state, playback.state.reason) == (State.FAULT, Reason.DRIVE_FAULT)
    assert 'ms too late for the controller' in playback.state.text
    bench.step(2000)
    assert np.array_equal(bench.axes, ends)
    bench.waits = True
    playback.reset()
    bench.waits = False
    assert np.array_equal(playback.axes.setpoints[-1], ends)
    bench.step(300)
    assert playback.state.state is State.IDLE and np.array_equal(bench.axes, ends)


@pytest.mark.parametrize('of_its_own', few_of(2, [False, True]))
def test_an_axis_that_does_not_follow_stops_the_others_on_the_path(of_its_own):
    bench = Bench(tolerance=5e-4 if of_its_own else np.inf)
    bench.load()
    bench.step(300)
    bench.stuck[0] = True
    bench.step(900)
    playback = bench.playback
    assert (playback.state.state, playback.state.reason) == (State.FAULT, Reason.DRIVE_FAULT)
    assert 'following error over' in playback.state.text
    if not of_its_own:  # else it has held all axes at once
        assert 'X: following error over 1 mm' in playback.state.text
        assert np.array_equal(bench.axes[1:], bench.played[-1][1:])
    bench.stuck[0] = False
    bench.waits = True
    playback.reset()
    bench.waits = False
    bench.step(50)
    assert playback.state.state is State.IDLE


def test_a_silent_controller_stops_the_machine_on_its_path():
    bench = Bench()
    bench.load()
    bench.step(300)
    bench.silent = True
    bench.step(1500)
    text = bench.playback.state.text
    assert bench.playback.state.state is State.FAULT and 'controller is silent' in text
    assert np.array_equal(bench.axes, bench.played[-1]) and bench.lag() < 2e-8


def test_a_robot_that_scales_its_speed_stops_the_machine_on_its_path():
    bench = Bench()
    bench.load()
    bench.step(300)
    bench.share = 0.5
    bench.step(900)
    playback = bench.playback
    assert (playback.state.state, playback.state.reason) == (State.FAULT, Reason.DRIVE_FAULT)
    assert 'executes trajectories at 50% of their speed' in playback.state.text
    assert np.array_equal(bench.axes, bench.played[-1]) and bench.lag() < 2e-8
    bench.waits = True
    with pytest.raises(StreamError, match='at 50% of their speed'):
        playback.reset()
    bench.share = 1.0
    playback.reset()
    bench.waits = False
    bench.step(50)
    assert playback.state.state is State.IDLE


def test_joints_are_found_by_name_and_a_missing_one_is_no_report():
    from sensor_msgs.msg import JointState

    message = JointState(name=['c', 'a', 'b'], position=[3.0, 1.0, 2.0])
    message.header.stamp = Time(sec=2, nanosec=5)
    report = joint_report(message, ['a', 'b', 'c'])
    assert report.stamp == 2 * SECOND + 5 and report.position.tolist() == [1.0, 2.0, 3.0]
    assert not report.velocity.any()
    assert joint_report(message, ['a', 'd']) is None
    message.position[0] = np.nan
    assert joint_report(message, ['a', 'b', 'c']) is None


def test_joints_are_those_of_the_axes_or_named_one_by_one():
    assert joints_of([''], MACHINE) == list('XYZAC')
    assert joints_of(list('abcde'), MACHINE) == list('abcde')
    with pytest.raises(InterpError, match='one joint for each of X Y Z A C'):
        joints_of(list('aabcd'), MACHINE)
