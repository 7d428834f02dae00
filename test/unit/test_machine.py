"""The simulated drives against closed forms; setpoints that the axes refuse."""

from __future__ import annotations

import numpy as np
import pytest
from plan_directories import stroke
from scipy.integrate import solve_ivp

from cnc_interp.core.errors import StreamError
from cnc_interp.core.units import DEG, MM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.axis_motion import AxisMotion, SetpointRefusedError
from cnc_interp.machine.drive_model import DriveModel
from cnc_interp.machine.simulated import SimulatedDrives, simulate

MACHINE = Machine.load('xyzac')
PERIOD = 1e-3
HOME = np.zeros(5)


def axes_with(model=None, period=PERIOD, position=HOME):
    return AxisMotion(MACHINE, period, SimulatedDrives(model or DriveModel(), period, position))


def five_axis_move():
    """A sound motion of all axes, each on its own profile."""
    x = stroke(80 * MM, 0.2, 2.0, 5.0)
    parts = [x, 0.5 * x, -0.3 * x, 5 * x, -8 * x]
    return np.stack([p[0] for p in parts], axis=1), np.stack([p[1] for p in parts], axis=1)


@pytest.mark.parametrize('period', [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('feed_forward', [0.0, 0.4, 1.0])
def test_following_error_on_a_ramp(period, feed_forward):
    drives = DriveModel(position_gain=40.0, feed_forward=feed_forward, time_constant=3e-3)
    speed = 0.1
    time = np.arange(int(1.0 / period)) * period
    setpoints = np.zeros((len(time), 5))
    setpoints[:, 0] = speed * time
    rate = np.zeros_like(setpoints)
    rate[:, 0] = speed
    run = simulate(MACHINE, period, setpoints, rate, drives)
    lag = (1 - feed_forward) * speed / 40.0
    assert run.following_error[-1, 0] == pytest.approx(lag, abs=1e-12)
    assert run.velocity[-1, 0] == pytest.approx(speed)
    assert np.all(run.following_error[:, 1:] == 0.0)
    assert run.contour_error[-1] < 1e-12
    assert run.tip_lag[-1] == pytest.approx(lag, abs=1e-12)


def test_following_error_under_constant_acceleration():
    drives = DriveModel(position_gain=50.0, feed_forward=1.0, time_constant=4e-3)
    time = np.arange(2000) * PERIOD
    setpoints, rate = np.zeros((2000, 5)), np.zeros((2000, 5))
    setpoints[:, 2], rate[:, 2] = 0.5 * 0.1 * time**2, 0.1 * time
    run = simulate(MACHINE, PERIOD, setpoints, rate, drives)
    # Chords of the parabola lie a T^2 / 12 inside it on average.
    expected = 4e-3 * 0.1 / 50.0
    assert run.following_error[-1, 2] == pytest.approx(expected, abs=0.1 * PERIOD**2 / 8)


@pytest.mark.parametrize('period', [1e-4, 3e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('gain', [5.0, 50.0, 500.0])
@pytest.mark.parametrize('lag', [2e-4, 2e-3, 2e-2])
def test_stable_and_settling_at_any_period(period, gain, lag):
    transition, held, _ = DriveModel(gain, 0.5, lag).discretise(period)
    assert np.abs(np.linalg.eigvals(transition)).max() < 1.0
    # At rest on a constant setpoint: x = r, v = 0.
    rest = np.linalg.solve(np.eye(2) - transition, held @ np.array([1.0, 0.0]))
    assert rest == pytest.approx([1.0, 0.0], abs=1e-9)


def test_a_step_of_the_setpoint_against_an_integrator():
    drives = DriveModel(position_gain=60.0, feed_forward=0.7, time_constant=5e-3)
    rng = np.random.default_rng(1)
    r = np.cumsum(rng.normal(scale=1e-5, size=30))
    f = rng.normal(scale=0.05, size=30)
    r[0] = f[0] = 0.0
    setpoints, rate = np.zeros((30, 5)), np.zeros((30, 5))
    setpoints[:, 1], rate[:, 1] = r, f
    run = simulate(MACHINE, 2e-3, setpoints, rate, drives)
    time = np.arange(30) * 2e-3

    def slope(t, z):
        command = 60.0 * (np.interp(t, time, r) - z[0]) + 0.7 * np.interp(t, time, f)
        return [z[1], (command - z[1]) / 5e-3]

    exact = solve_ivp(slope, (0, time[-1]), [0.0, 0.0], t_eval=time, rtol=1e-10, atol=1e-14,
                      max_step=1e-4)  # fmt: skip
    assert run.position[:, 1] == pytest.approx(exact.y[0], abs=1e-10)
    assert run.velocity[:, 1] == pytest.approx(exact.y[1], abs=1e-8)


def test_stepping_and_simulating_agree_to_the_last_bit():
    setpoints, rate = five_axis_move()
    model = DriveModel(30.0, 0.8, 4e-3)
    machine = axes_with(model)
    run = simulate(MACHINE, PERIOD, setpoints, rate, model)
    for i in range(len(setpoints)):
        feedback = machine.follow(setpoints[i], rate[i])
        assert np.array_equal(feedback.position, run.position[i])
        assert np.array_equal(feedback.velocity, run.velocity[i])
        assert np.array_equal(feedback.following_error, run.following_error[i])
        assert np.array_equal(feedback.tip, run.tip[i])
        assert np.array_equal(feedback.axis, run.axis[i])
        assert feedback.tip_lag == run.tip_lag[i]
        assert feedback.contour_error == run.contour_error[i]
    assert np.array_equal(machine.largest_use, run.largest_use)
    tip, axis = Transform.of(MACHINE).forward(feedback.position[None, :])
    assert np.array_equal(tip[0], feedback.tip) and np.array_equal(axis[0], feedback.axis)


def test_it_comes_to_rest_at_the_last_setpoint():
    setpoints, rate = five_axis_move()
    machine = axes_with(DriveModel(30.0, 0.0, 4e-3))
    for row, speed in zip(setpoints, rate, strict=True):
        machine.follow(row, speed)
    for _ in range(2000):
        feedback = machine.rest()
    assert feedback.position == pytest.approx(setpoints[-1], abs=1e-12)
    assert feedback.contour_error < 1e-12


def test_use_of_limits_counts_the_start_from_rest():
    machine = axes_with()
    machine.follow(np.array([1e-9, 0, 0, 0, 0]), HOME)
    # A jump of d from rest: d/T, d/T^2, d/T^3.
    limits = [MACHINE.max_velocity[0], MACHINE.max_acceleration[0], MACHINE.max_jerk[0]]
    expected = [1e-9 / PERIOD**k / limits[k - 1] for k in (1, 2, 3)]
    assert machine.largest_use[:, 0] == pytest.approx(expected)
    assert np.all(machine.largest_use[:, 1:] == 0.0)


def test_contour_error_on_a_circle_is_its_shrinking():
    # Without feed-forward a circle shrinks to R |G(i w)|.
    drives = DriveModel(position_gain=40.0, feed_forward=0.0, time_constant=3e-3)
    radius, omega = 20 * MM, 4.0
    time = np.arange(6000) * PERIOD
    setpoints = np.zeros((6000, 5))
    setpoints[:, 0] = radius * np.cos(omega * time)
    setpoints[:, 1] = radius * np.sin(omega * time)
    run = simulate(MACHINE, PERIOD, setpoints, model=drives)
    s = 1j * omega
    gain = abs(40.0 / (3e-3 * s**2 + s + 40.0))
    assert run.contour_error[-1] == pytest.approx(abs(1 - gain) * radius, rel=1e-3)
    assert run.tip_lag[-1] > 5 * run.contour_error[-1]


@pytest.mark.parametrize(
    ('setpoint', 'words'),
    [
        ([0.0, 0.0, 0.0, 2.2, 0.0], 'soft limit: A to 2.2'),
        ([-0.6, 0.0, 0.0, 0.0, 0.0], 'soft limit: X to -0.6'),
        ([0.0, 0.01, 0.0, 0.0, 0.0], 'Y asked to jump'),
        ([0.0, 0.0, np.nan, 0.0, 0.0], '5 finite numbers'),
        ([0.0, 0.0, 0.0], '5 finite numbers'),
    ],
)
def test_a_setpoint_that_cannot_be_is_refused(setpoint, words):
    machine = axes_with()
    with pytest.raises(SetpointRefusedError, match=words):
        machine.follow(np.array(setpoint), np.zeros(len(setpoint)))
    assert np.array_equal(machine.rest().position, HOME)
    machine.follow(HOME, HOME)


def test_a_bad_velocity_is_refused():
    with pytest.raises(SetpointRefusedError, match='velocity must be 5 finite numbers'):
        axes_with().follow(HOME, np.full(5, np.inf))


def test_endless_axes_turn_on():
    machine = axes_with(position=np.array([0, 0, 0, 0, 100 * 360 * DEG]))
    assert machine.largest_use.max() == 0.0


def test_an_axis_outside_its_travel_is_not_taken_over():
    with pytest.raises(StreamError, match=r'soft limit: X to 0\.6'):
        axes_with(position=np.array([0.6, 0.0, 0.0, 0.0, 0.0]))


@pytest.mark.parametrize(
    'wrong', [{'position_gain': 0.0}, {'time_constant': -1.0}, {'feed_forward': 1.1}]
)
def test_drives_that_cannot_be_are_refused(wrong):
    with pytest.raises(StreamError, match=next(iter(wrong))):
        DriveModel(**wrong)


def test_feedrate_is_the_speed_of_the_tip_in_the_workpiece_not_of_the_axes():
    """The C axis turns and X Y carry the tool along: in the workpiece nothing moves."""
    turn, rate = 0.5 * np.arange(800) * PERIOD, 0.5
    q = np.zeros((800, 5))
    q[:, 4] = turn
    transform = Transform.of(MACHINE)
    q[:, :3] = transform.linear(np.tile([0.0, 0.0, 0.02], (800, 1)), q[:, 3:])
    velocity = np.gradient(q, PERIOD, axis=0)
    still = axes_with(DriveModel(feed_forward=1.0), position=q[0])
    for position, speed in zip(q, velocity, strict=True):
        feedback = still.follow(position, speed)
    assert np.abs(feedback.velocity[:2]).max() > 0.02
    assert feedback.feedrate < 1e-4
    alone = axes_with(position=np.array([*q[0, :3], 0.0, 0.0]))
    for angle in turn:
        feedback = alone.follow(np.array([*q[0, :3], 0.0, angle]), np.array([0, 0, 0, 0, rate]))
    arm = np.linalg.norm(MACHINE.offsets[0, :2])
    assert feedback.feedrate == pytest.approx(rate * arm, rel=1e-3)


def test_recent_use_holds_every_peak_once():
    machine = axes_with()
    positions, velocities = five_axis_move()
    taken = []
    for i, (position, velocity) in enumerate(zip(positions, velocities, strict=True)):
        machine.follow(position, velocity)
        if i % 50 == 49:
            taken.append(machine.take_recent_use())
    taken.append(machine.take_recent_use())
    assert np.array_equal(np.max(taken, axis=0), machine.largest_use)
    assert np.ptp([use.max() for use in taken]) > 0.05
    assert not machine.take_recent_use().any()
