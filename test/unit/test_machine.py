"""The simulated machine: drives against closed forms, the state table, refusals."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from plan_directories import stroke
from scipy.integrate import solve_ivp

from cnc_interp.core.errors import StreamError
from cnc_interp.core.units import DEG, MM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.drive_model import Drives
from cnc_interp.machine.simulated import SimulatedMachine
from cnc_interp.machine.states import TRANSITIONS, Event, State

MACHINE = Machine.load('xyzac')
PERIOD = 1e-3
HOME = np.zeros(5)
STATE_WORDS = {state.value for state in State}


def running(drives=None, period=PERIOD, position=HOME):
    machine = SimulatedMachine(MACHINE, period, position, drives)
    machine.handle(Event.ACTIVATE)
    machine.handle(Event.START)
    return machine


def five_axis_move():
    """A sound motion of all axes, each on its own profile."""
    x = stroke(80 * MM, 0.2, 2.0, 5.0)
    parts = [x, 0.5 * x, -0.3 * x, 5 * x, -8 * x]
    return np.stack([p[0] for p in parts], axis=1), np.stack([p[1] for p in parts], axis=1)


@pytest.mark.parametrize('period', [1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('feed_forward', [0.0, 0.4, 1.0])
def test_following_error_on_a_ramp(period, feed_forward):
    drives = Drives(position_gain=40.0, feed_forward=feed_forward, time_constant=3e-3)
    speed = 0.1
    time = np.arange(int(1.0 / period)) * period
    setpoints = np.zeros((len(time), 5))
    setpoints[:, 0] = speed * time
    rate = np.zeros_like(setpoints)
    rate[:, 0] = speed
    run = SimulatedMachine(MACHINE, period, HOME, drives).simulate(setpoints, rate)
    lag = (1 - feed_forward) * speed / 40.0
    assert run.following_error[-1, 0] == pytest.approx(lag, abs=1e-12)
    assert run.velocity[-1, 0] == pytest.approx(speed)
    assert np.all(run.following_error[:, 1:] == 0.0)
    assert run.contour_error[-1] < 1e-12
    assert run.tip_lag[-1] == pytest.approx(lag, abs=1e-12)


def test_following_error_under_constant_acceleration():
    drives = Drives(position_gain=50.0, feed_forward=1.0, time_constant=4e-3)
    time = np.arange(2000) * PERIOD
    setpoints, rate = np.zeros((2000, 5)), np.zeros((2000, 5))
    setpoints[:, 2], rate[:, 2] = 0.5 * 0.1 * time**2, 0.1 * time
    run = SimulatedMachine(MACHINE, PERIOD, HOME, drives).simulate(setpoints, rate)
    # Chords of the parabola lie a T^2 / 12 inside it on average.
    expected = 4e-3 * 0.1 / 50.0
    assert run.following_error[-1, 2] == pytest.approx(expected, abs=0.1 * PERIOD**2 / 8)


@pytest.mark.parametrize('period', [1e-4, 3e-4, 1e-3, 1e-2])
@pytest.mark.parametrize('gain', [5.0, 50.0, 500.0])
@pytest.mark.parametrize('lag', [2e-4, 2e-3, 2e-2])
def test_stable_and_settling_at_any_period(period, gain, lag):
    transition, held, _ = Drives(gain, 0.5, lag).discretise(period)
    assert np.abs(np.linalg.eigvals(transition)).max() < 1.0
    # At rest on a constant setpoint: x = r, v = 0.
    rest = np.linalg.solve(np.eye(2) - transition, held @ np.array([1.0, 0.0]))
    assert rest == pytest.approx([1.0, 0.0], abs=1e-9)


def test_a_step_of_the_setpoint_against_an_integrator():
    drives = Drives(position_gain=60.0, feed_forward=0.7, time_constant=5e-3)
    rng = np.random.default_rng(1)
    r = np.cumsum(rng.normal(scale=1e-5, size=30))
    f = rng.normal(scale=0.05, size=30)
    r[0] = f[0] = 0.0
    setpoints, rate = np.zeros((30, 5)), np.zeros((30, 5))
    setpoints[:, 1], rate[:, 1] = r, f
    run = SimulatedMachine(MACHINE, 2e-3, HOME, drives).simulate(setpoints, rate)
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
    machine = running(Drives(30.0, 0.8, 4e-3))
    run = SimulatedMachine(MACHINE, PERIOD, HOME, machine.drives).simulate(setpoints, rate)
    for i in range(len(setpoints)):
        feedback = machine.step(setpoints[i], rate[i])
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
    machine = running(Drives(30.0, 0.0, 4e-3))
    for row, speed in zip(setpoints, rate, strict=True):
        machine.step(row, speed)
    machine.handle(Event.FINISH)
    for _ in range(2000):
        feedback = machine.rest()
    assert feedback.state is State.IDLE
    assert feedback.position == pytest.approx(setpoints[-1], abs=1e-12)
    assert feedback.contour_error < 1e-12


def test_use_of_limits_counts_the_start_from_rest():
    machine = running()
    machine.step(np.array([1e-9, 0, 0, 0, 0]), HOME)
    # A jump of d from rest: d/T, d/T^2, d/T^3.
    limits = [MACHINE.max_velocity[0], MACHINE.max_acceleration[0], MACHINE.max_jerk[0]]
    expected = [1e-9 / PERIOD**k / limits[k - 1] for k in (1, 2, 3)]
    assert machine.largest_use[:, 0] == pytest.approx(expected)
    assert np.all(machine.largest_use[:, 1:] == 0.0)


def test_contour_error_on_a_circle_is_its_shrinking():
    # Without feed-forward a circle shrinks to R |G(i w)|.
    drives = Drives(position_gain=40.0, feed_forward=0.0, time_constant=3e-3)
    radius, omega = 20 * MM, 4.0
    time = np.arange(6000) * PERIOD
    setpoints = np.zeros((6000, 5))
    setpoints[:, 0] = radius * np.cos(omega * time)
    setpoints[:, 1] = radius * np.sin(omega * time)
    run = SimulatedMachine(MACHINE, PERIOD, HOME, drives).simulate(setpoints)
    s = 1j * omega
    gain = abs(40.0 / (3e-3 * s**2 + s + 40.0))
    assert run.contour_error[-1] == pytest.approx(abs(1 - gain) * radius, rel=1e-3)
    assert run.tip_lag[-1] > 5 * run.contour_error[-1]


@pytest.mark.parametrize(('state', 'event'), list(product(State, Event)))
def test_every_pair_of_state_and_event(state, event):
    machine = SimulatedMachine(MACHINE, PERIOD, HOME)
    machine.state = state
    refusal = f'{event.value} is not possible while {state.value}'
    if (state, event) in TRANSITIONS:
        assert machine.handle(event) is TRANSITIONS[state, event]
        assert bool(machine.message) is (event is Event.FAIL)
    else:
        with pytest.raises(StreamError, match=refusal):
            machine.handle(event)
        assert machine.state is state


def test_the_table_in_the_docs_is_that_of_the_code():
    """A row for each state, a column for each event but the switching of the drives."""
    text = (Path(__file__).parents[2] / 'docs' / 'operate' / 'operation.md').read_text(
        encoding='utf-8'
    )
    rows = [
        [cell.strip() for cell in line.strip('|').split('|')]
        for line in text.splitlines()
        if line.startswith('| state |') or line.split(':')[0].strip('| ') in STATE_WORDS
    ]
    events = [Event(word) for word in rows[0][1:]]
    told = {
        (State(row[0].split(':')[0]), event): State(cell)
        for row in rows[1:]
        for event, cell in zip(events, row[1:], strict=True)
        if cell
    }
    assert len(rows) == 1 + len(State)
    switching = {Event.ACTIVATE, Event.DEACTIVATE}
    assert {*events} | switching == set(Event)
    assert told == {pair: to for pair, to in TRANSITIONS.items() if pair[1] not in switching}
    assert {pair: to for pair, to in TRANSITIONS.items() if pair[1] in switching} == {
        (State.INACTIVE, Event.ACTIVATE): State.IDLE,
        (State.IDLE, Event.DEACTIVATE): State.INACTIVE,
        (State.FAULT, Event.DEACTIVATE): State.INACTIVE,
    }


def test_the_table_by_its_meaning():
    reached = {State.INACTIVE}
    for _ in State:
        reached |= {after for (before, _), after in TRANSITIONS.items() if before in reached}
    assert reached == set(State)
    # A fault is left by reset or switching off only; drives that are off do not start.
    assert {e for s, e in TRANSITIONS if s is State.FAULT} == {
        Event.RESET, Event.DEACTIVATE, Event.FAIL, Event.STOP,
    }  # fmt: skip
    assert {e for s, e in TRANSITIONS if s is State.INACTIVE} == {Event.ACTIVATE}
    # Whatever moves can fail, and nothing that moves can be switched off.
    for state in (State.RUNNING, State.HOLDING, State.STARVED, State.STOPPING):
        assert TRANSITIONS[state, Event.STOP] is State.STOPPING
        assert TRANSITIONS[state, Event.FAIL] is State.FAULT
        assert (state, Event.DEACTIVATE) not in TRANSITIONS


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
    machine = running()
    feedback = machine.step(np.array(setpoint), np.zeros(len(setpoint)))
    assert feedback.state is State.FAULT
    assert words in feedback.message
    assert np.array_equal(feedback.position, HOME)
    with pytest.raises(StreamError, match='setpoint while fault'):
        machine.step(HOME, HOME)
    machine.handle(Event.RESET)
    machine.handle(Event.START)
    assert machine.step(HOME, HOME).message == ''


def test_a_bad_velocity_is_refused():
    assert running().step(HOME, np.full(5, np.inf)).state is State.FAULT


def test_endless_axes_turn_on():
    machine = SimulatedMachine(MACHINE, PERIOD, np.array([0, 0, 0, 0, 100 * 360 * DEG]))
    assert machine.largest_use.max() == 0.0


def test_setpoints_before_the_start_are_refused():
    machine = SimulatedMachine(MACHINE, PERIOD, HOME)
    with pytest.raises(StreamError, match='setpoint while inactive'):
        machine.step(HOME, HOME)
    machine.handle(Event.ACTIVATE)
    with pytest.raises(StreamError, match='setpoint while idle'):
        machine.step(HOME, HOME)


def test_hold_and_starvation_follow_their_stop():
    for event, state in ((Event.HOLD, State.HOLDING), (Event.STARVE, State.STARVED)):
        machine = running()
        assert machine.handle(event, 'no setpoints for 100 ms') is state
        assert machine.step(HOME, HOME).state is state
        assert machine.handle(Event.RESUME) is State.RUNNING


@pytest.mark.parametrize(
    'wrong', [{'position_gain': 0.0}, {'time_constant': -1.0}, {'feed_forward': 1.1}]
)
def test_drives_that_cannot_be_are_refused(wrong):
    with pytest.raises(StreamError, match=next(iter(wrong))):
        Drives(**wrong)


def test_feedrate_is_the_speed_of_the_tip_in_the_workpiece_not_of_the_axes():
    """The C axis turns and X Y carry the tool along: in the workpiece nothing moves."""
    turn, rate = 0.5 * np.arange(800) * PERIOD, 0.5
    q = np.zeros((800, 5))
    q[:, 4] = turn
    transform = Transform.of(MACHINE)
    q[:, :3] = transform.linear(np.tile([0.0, 0.0, 0.02], (800, 1)), q[:, 3:])
    velocity = np.gradient(q, PERIOD, axis=0)
    still = running(Drives(feed_forward=1.0), position=q[0])
    for position, speed in zip(q, velocity, strict=True):
        feedback = still.step(position, speed)
    assert np.abs(feedback.velocity[:2]).max() > 0.02
    assert feedback.feedrate < 1e-4
    alone = running(position=np.array([*q[0, :3], 0.0, 0.0]))
    for angle in turn:
        feedback = alone.step(np.array([*q[0, :3], 0.0, angle]), np.array([0, 0, 0, 0, rate]))
    arm = np.linalg.norm(MACHINE.offsets[0, :2])
    assert feedback.feedrate == pytest.approx(rate * arm, rel=1e-3)


def test_recent_use_holds_every_peak_once():
    machine = running()
    positions, velocities = five_axis_move()
    taken = []
    for i, (position, velocity) in enumerate(zip(positions, velocities, strict=True)):
        machine.step(position, velocity)
        if i % 50 == 49:
            taken.append(machine.take_recent_use())
    taken.append(machine.take_recent_use())
    assert np.array_equal(np.max(taken, axis=0), machine.largest_use)
    assert np.ptp([use.max() for use in taken]) > 0.05
    assert not machine.take_recent_use().any()
