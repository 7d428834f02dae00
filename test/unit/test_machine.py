"""The simulated drives against closed forms; setpoints that the axes refuse."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import numpy as np
import pytest
from plan_directories import stroke
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from cnc_interp.core import DEG, MM, StreamError
from cnc_interp.drives.drive_model import discretise, exponential
from cnc_interp.machine.axis_motion import AxisMotion
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.cycle_kernels import ALARM_SHIFT, REFUSED, REST
from cnc_interp.machine.simulated_drives import SimulatedDrives, simulate
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

MACHINE = Machine.load('xyzac')
PERIOD = 1e-3
HOME = np.zeros(5)


def driven(*values, **named):
    """The machine with one kind of drive on all axes."""
    return replace(MACHINE, drives=dict.fromkeys(range(5), AxisDrive(*values, **named)))


def chunk_of(positions, velocities):
    """Setpoints of a program; the machine waits after them."""
    k, zeros = len(positions), np.zeros_like(positions)
    ones = np.ones(k, dtype=int)
    parts = [
        Setpoints(
            np.arange(n) * PERIOD,
            positions[:n],
            velocities[:n],
            zeros[:n],
            zeros[:n],
            ones[:n],
            np.zeros(n),
        )
        for n in (k, 0)
    ]
    return Chunk(*parts, Wait.PROGRAM_STOP)


class Axes(AxisMotion):
    """Simulated drives in the cycle of the machine, and the measurement of what they did."""

    def __init__(self, machine=MACHINE, period=PERIOD, position=HOME):
        drives = SimulatedDrives(machine, period, np.asarray(position, dtype=float))
        super().__init__(machine, period, drives.lag, drives.position)
        self.cycle = Cycle(period, *self.bounds, 4, drives.step, drives.memory)
        self.cycle.place(drives.position)

    def follow(self, positions, velocities):
        """Follow setpoints; returns what was measured and what happened at the first one."""
        positions, velocities = np.atleast_2d(positions), np.atleast_2d(velocities)
        self.cycle.start(self.cycle.push(chunk_of(positions, velocities)))
        for _ in positions:
            self.cycle.step()
        played = self.cycle.read()
        wanted = np.tile(self.setpoints[-1], (len(positions), 1))
        if not played.events[0]:
            wanted = positions
        self.cycle.step()  # the wait after it: the drives settle for one period
        self.rested = self.cycle.read()
        return self.measure(wanted, played.position, played.velocity), played.events[0]

    def rest(self, periods):
        for _ in range(periods):
            self.cycle.step()
        played = self.cycle.read()
        assert not played.source.any()
        wanted = np.tile(self.setpoints[-1], (periods, 1))
        return self.measure(wanted, played.position, played.velocity)


def five_axis_move():
    """A sound motion of all axes, each on its own profile."""
    x = stroke(80 * MM, 0.2, 2.0, 5.0)
    parts = [x, 0.5 * x, -0.3 * x, 5 * x, -8 * x]
    return np.stack([p[0] for p in parts], axis=1), np.stack([p[1] for p in parts], axis=1)


@pytest.mark.parametrize('period', [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('feed_forward', [0.0, 0.4, 1.0])
def test_following_error_on_a_ramp(period, feed_forward):
    machine = driven(position_gain=40.0, feed_forward=feed_forward, time_constant=3e-3)
    speed = 0.1
    time = np.arange(int(1.0 / period)) * period
    setpoints = np.zeros((len(time), 5))
    setpoints[:, 0] = speed * time
    rate = np.zeros_like(setpoints)
    rate[:, 0] = speed
    run = simulate(machine, period, setpoints, rate)
    lag = (1 - feed_forward) * speed / 40.0
    assert run.following_error[-1, 0] == pytest.approx(lag, abs=1e-12)
    assert run.velocity[-1, 0] == pytest.approx(speed)
    assert np.all(run.following_error[:, 1:] == 0.0)
    assert run.contour_error[-1] < 1e-12


def test_following_error_under_constant_acceleration():
    machine = driven(position_gain=50.0, feed_forward=1.0, time_constant=4e-3)
    time = np.arange(2000) * PERIOD
    setpoints, rate = np.zeros((2000, 5)), np.zeros((2000, 5))
    setpoints[:, 2], rate[:, 2] = 0.5 * 0.1 * time**2, 0.1 * time
    run = simulate(machine, PERIOD, setpoints, rate)
    # Chords of the parabola lie a T^2 / 12 inside it on average.
    expected = 4e-3 * 0.1 / 50.0
    assert run.following_error[-1, 2] == pytest.approx(expected, abs=0.1 * PERIOD**2 / 8)


@pytest.mark.parametrize('period', [1e-4, 3e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('gain', [5.0, 50.0, 500.0])
@pytest.mark.parametrize('lag', [2e-4, 2e-3, 2e-2])
def test_stable_and_settling_at_any_period(period, gain, lag):
    transition, held, _ = discretise(AxisDrive(gain, 0.5, lag), 0.0, period)
    assert np.abs(np.linalg.eigvals(transition)).max() < 1.0
    # At rest on a constant setpoint: x = r, v = 0.
    rest = np.linalg.solve(np.eye(2) - transition, held @ np.array([1.0, 0.0]))
    assert rest == pytest.approx([1.0, 0.0], abs=1e-9)


@pytest.mark.parametrize('size', [0.0, 1e-6, 1e-2, 1.0, 40.0])
def test_the_exponential_of_a_matrix_is_that_of_scipy(size):
    matrix = np.random.default_rng(2).uniform(-size, size, (6, 6))
    exact = expm(matrix)
    assert np.abs(exponential(matrix) - exact).max() < 1e-12 * np.abs(exact).max()


def test_a_step_of_the_setpoint_against_an_integrator():
    machine = driven(position_gain=60.0, feed_forward=0.7, time_constant=5e-3)
    rng = np.random.default_rng(1)
    r = np.cumsum(rng.normal(scale=1e-5, size=30))
    f = rng.normal(scale=0.05, size=30)
    r[0] = f[0] = 0.0
    setpoints, rate = np.zeros((30, 5)), np.zeros((30, 5))
    setpoints[:, 1], rate[:, 1] = r, f
    run = simulate(machine, 2e-3, setpoints, rate)
    time = np.arange(30) * 2e-3

    def slope(t, z):
        command = 60.0 * (np.interp(t, time, r) - z[0]) + 0.7 * np.interp(t, time, f)
        return [z[1], (command - z[1]) / 5e-3]

    exact = solve_ivp(
        slope, (0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-14, max_step=1e-4
    )
    assert run.position[:, 1] == pytest.approx(exact.y[0], abs=1e-10)
    assert run.velocity[:, 1] == pytest.approx(exact.y[1], abs=1e-8)


def test_cycle_and_simulation_agree_to_the_last_bit():
    setpoints, rate = five_axis_move()
    machine = driven(30.0, 0.8, 4e-3)
    axes = Axes(machine)
    run = simulate(machine, PERIOD, setpoints, rate)
    cycle = axes.cycle
    cycle.start(cycle.push(chunk_of(setpoints, rate)))
    first = 0
    for count in (1, 7, len(setpoints) - 8):  # however many periods are taken over together
        for _ in range(count):
            cycle.step()
        played, part = cycle.read(), slice(first, first + count)
        found = axes.measure(setpoints[part], played.position, played.velocity)
        for name in (
            'position',
            'velocity',
            'following_error',
            'tip',
            'axis',
            'contour_error',
            'feedrate',
        ):
            assert np.array_equal(getattr(found, name), getattr(run, name)[part]), name
        first += count
    assert np.array_equal(axes.largest_use, run.largest_use)
    tip, axis = Transform.of(MACHINE).forward(run.position)
    assert np.array_equal(tip, run.tip) and np.array_equal(axis, run.axis)


def test_it_comes_to_rest_at_the_last_setpoint():
    setpoints, rate = five_axis_move()
    axes = Axes(driven(30.0, 0.0, 4e-3))
    axes.follow(setpoints, rate)
    feedback = axes.rest(2000)
    assert feedback.position[-1] == pytest.approx(setpoints[-1], abs=1e-12)
    assert feedback.contour_error[-1] < 1e-12


def test_use_of_limits_counts_the_start_from_rest():
    axes = Axes()
    axes.follow(np.array([1e-9, 0, 0, 0, 0]), HOME)
    # A jump of d from rest: d/T, d/T^2, d/T^3.
    limits = [MACHINE.max_velocity[0], MACHINE.max_acceleration[0], MACHINE.max_jerk[0]]
    expected = [1e-9 / PERIOD**k / limits[k - 1] for k in (1, 2, 3)]
    assert axes.largest_use[:, 0] == pytest.approx(expected)
    assert np.all(axes.largest_use[:, 1:] == 0.0)


def test_contour_error_on_a_circle_is_its_shrinking():
    # Without feed-forward a circle shrinks to R |G(i w)|.
    machine = driven(position_gain=40.0, feed_forward=0.0, time_constant=3e-3)
    radius, omega = 20 * MM, 4.0
    time = np.arange(6000) * PERIOD
    setpoints = np.zeros((6000, 5))
    setpoints[:, 0] = radius * np.cos(omega * time)
    setpoints[:, 1] = radius * np.sin(omega * time)
    run = simulate(machine, PERIOD, setpoints)
    s = 1j * omega
    gain = abs(40.0 / (3e-3 * s**2 + s + 40.0))
    assert run.contour_error[-1] == pytest.approx(abs(1 - gain) * radius, rel=1e-3)
    tip_lag = np.linalg.norm(
        np.diff(
            Transform.of(machine).forward(np.stack([setpoints[-1], run.position[-1]]))[0], axis=0
        )
    )
    assert tip_lag > 5 * run.contour_error[-1]


@pytest.mark.parametrize(
    ('setpoint', 'words'),
    [
        ([0.0, 0.0, 0.0, 2.2, 0.0], 'soft limit: A to 2.2'),
        ([-0.6, 0.0, 0.0, 0.0, 0.0], 'soft limit: X to -0.6'),
        ([0.0, 0.01, 0.0, 0.0, 0.0], 'Y asked to jump'),
        ([0.0, 0.0, np.nan, 0.0, 0.0], '5 finite numbers'),
    ],
)
def test_a_setpoint_that_cannot_be_is_refused_by_the_cycle(setpoint, words):
    axes = Axes()
    assert words in axes.fault_of(np.array(setpoint), HOME)
    feedback, event = axes.follow(np.array(setpoint), HOME)
    assert event == REFUSED and np.array_equal(feedback.position[-1], HOME)
    assert axes.rested.source[-1] == REST
    feedback, event = axes.follow(HOME, HOME)
    assert not event and axes.fault_of(HOME, HOME) == ''


def test_a_bad_velocity_is_refused():
    axes, wrong = Axes(), np.full(5, np.inf)
    assert '5 finite numbers' in axes.fault_of(HOME, wrong)
    assert axes.follow(HOME, wrong)[1] == REFUSED


def test_endless_axes_turn_on():
    axes = Axes(position=np.array([0, 0, 0, 0, 100 * 360 * DEG]))
    assert axes.largest_use.max() == 0.0


def test_an_axis_outside_its_travel_is_not_taken_over():
    with pytest.raises(StreamError, match=r'soft limit: X to 0\.6'):
        Axes(position=np.array([0.6, 0.0, 0.0, 0.0, 0.0]))


def test_feedrate_is_the_speed_of_the_tip_in_the_workpiece_not_of_the_axes():
    """The C axis turns and X Y carry the tool along: in the workpiece nothing moves."""
    turn, rate = 0.5 * np.arange(800) * PERIOD, 0.5
    q = np.zeros((800, 5))
    q[:, 4] = turn
    transform = Transform.of(MACHINE)
    q[:, :3] = transform.linear(np.tile([0.0, 0.0, 0.02], (800, 1)), q[:, 3:])
    velocity = np.gradient(q, PERIOD, axis=0)
    still = Axes(position=q[0])
    feedback, _ = still.follow(q, velocity)
    assert np.abs(feedback.velocity[:, :2]).max() > 0.02
    assert feedback.feedrate[-1] < 1e-4
    alone = Axes(position=np.array([*q[0, :3], 0.0, 0.0]))
    turns = np.tile([*q[0, :3], 0.0, 0.0], (800, 1))
    turns[:, 4] = turn
    feedback, _ = alone.follow(turns, np.tile([0, 0, 0, 0, rate], (800, 1)))
    arm = np.linalg.norm(MACHINE.offsets[0, :2])
    assert feedback.feedrate[-1] == pytest.approx(rate * arm, rel=1e-3)


def test_recent_use_holds_every_peak_once():
    positions, velocities = five_axis_move()
    axes = AxisMotion(MACHINE, PERIOD, 0.01, positions[0])
    taken = []
    for first in range(0, len(positions), 50):
        part = slice(first, first + 50)
        axes.measure(positions[part], positions[part], velocities[part])
        taken.append(axes.take_recent_use())
    assert np.array_equal(np.max(taken, axis=0), axes.largest_use)
    assert np.ptp([use.max() for use in taken]) > 0.05
    assert not axes.take_recent_use().any()


def test_an_alarm_of_the_drives_at_rest_is_told_when_it_comes():
    answers, told = iter([0, -7, -7, 0, -7]), []
    step = ctypes.CFUNCTYPE(ctypes.c_int64, *[ctypes.c_int64] * 4)(lambda *_: next(answers))
    address = ctypes.cast(step, ctypes.c_void_p).value
    cycle = Cycle(PERIOD, *Axes().bounds, 4, address, np.zeros(1))
    cycle.place(HOME)
    for _ in range(5):
        cycle.step()
        told += (cycle.read().events >> ALARM_SHIFT).tolist()
    assert told == [0, 7, 0, 0, 7]
