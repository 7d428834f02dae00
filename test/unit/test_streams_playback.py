"""The machine's buffer and the approach: closed-form moves played period by period."""

import numpy as np
import pytest

pytest.importorskip('ruckig', reason='needs ruckig; run the tests with ./cnc test')

from cnc_interp.errors import StreamError, TravelError
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.interpolator import Interpolator, Setpoints
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.machine import Machine
from cnc_interp.machine import Event, SimulatedMachine, State
from cnc_interp.nodes.approach import approach
from cnc_interp.nodes.planning import SLICE, part_of, sliced
from cnc_interp.nodes.playback import Playback

T = 0.001
MACHINE = Machine.load('xyzac')
HOME = np.zeros(5)
LIMITS = (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk)
POSES = [
    [0.1, -0.05, 0.02, 0.3, -2.0],
    [1e-6, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 40.0],
    [-0.5, 0.5, -0.5, 2.0, 1.0],
]


def playback(start_count=50):
    machine = SimulatedMachine(MACHINE, T, HOME)
    machine.handle(Event.ACTIVATE)
    return Playback(machine, start_count)


def move(target, block=1):
    samples = approach(MACHINE, T, HOME, np.array(target))
    return Setpoints(
        samples.time, samples.position, samples.velocity, samples.acceleration, samples.jerk,
        np.full(len(samples), block), np.linspace(0.0, 0.1, len(samples)),
    )  # fmt: skip


@pytest.mark.parametrize('target', POSES)
def test_approach_holds_all_limits_and_ends_at_rest(target):
    samples = approach(MACHINE, T, HOME, np.array(target))
    assert np.array_equal(samples.position[-1], target)
    assert not samples.velocity[-1].any() and not samples.acceleration[-1].any()
    held = np.concatenate([np.zeros((3, 5)), samples.position, np.tile(target, (3, 1))])
    for order, limit in enumerate(LIMITS, start=1):
        use = np.abs(np.diff(held, order, axis=0)).max(axis=0) / T**order / limit
        assert use.max() <= 1.001
    assert (samples.block == 0).all()


def test_approach_takes_as_long_as_its_slowest_axis_alone():
    alone = approach(MACHINE, T, HOME, np.array([0.0, 0.0, 0.3, 0.0, 0.0]))
    together = approach(MACHINE, T, HOME, np.array([0.01, 0.0, 0.3, 0.1, 0.1]))
    assert len(together) == len(alone)


def test_no_approach_where_the_machine_stands():
    assert len(approach(MACHINE, T, HOME, HOME)) == 0


def test_approach_outside_the_travel_is_refused():
    with pytest.raises(TravelError, match='axis X'):
        approach(MACHINE, T, HOME, np.array([0.6, 0.0, 0.0, 0.0, 0.0]))


def test_waits_for_enough_then_plays_everything_in_order():
    play, samples = playback(50), move([0.02, 0.0, 0.0, 0.1, 0.0])
    play.begin('p')
    play.push(part_of(samples, 0, 40), [1] * 40, False)
    for _ in range(5):
        assert play.step().state is State.IDLE
    play.push(part_of(samples, 40, len(samples)), [1] * (len(samples) - 40), True)
    heard = []
    for _ in range(len(samples)):
        heard.append(play.step().setpoint)
    assert np.array_equal(heard, samples.position)
    assert play.machine.state is State.RUNNING and not play.completed
    play.step()
    assert play.machine.state is State.IDLE and play.completed
    assert play.played == len(samples) and play.starvations == 0


def test_a_short_program_starts_without_a_full_buffer():
    play, samples = playback(10_000), move([1e-6, 0.0, 0.0, 0.0, 0.0])
    play.begin('p')
    play.push(samples, [1] * len(samples), True)
    assert play.step().state is State.RUNNING


def test_starving_in_motion_holds_the_last_setpoint_and_ends_the_run():
    play, samples = playback(50), move([0.1, 0.0, 0.0, 0.0, 0.0])
    play.begin('p')
    play.push(part_of(samples, 0, 100), [1] * 100, False)
    for _ in range(100):
        play.step()
    for _ in range(200):
        feedback = play.step()
        assert feedback.state is State.STARVED
        assert np.array_equal(feedback.setpoint, samples.position[99])
    assert 'no setpoints after 100' in play.lost and play.starvations == 1
    play.push(part_of(samples, 100, 200), [1] * 100, False)
    assert play.step().state is State.STARVED  # going on at full speed would be a jump
    play.begin('q')
    assert play.machine.state is State.IDLE and play.lost == ''


def test_starving_at_rest_goes_on_when_setpoints_come():
    play, there = playback(5), move([0.01, 0.0, 0.0, 0.0, 0.0])
    play.begin('p')
    play.push(there, [1] * len(there), False)
    for _ in range(len(there) + 100):
        play.step()
    assert play.machine.state is State.STARVED and play.lost == ''
    back = part_of(there, 0, len(there))
    mirrored = Setpoints(
        back.time, back.position[::-1].copy(), -back.velocity[::-1], back.acceleration[::-1],
        back.jerk, back.block + 1, back.s,
    )  # fmt: skip
    play.push(mirrored, [2] * len(there), True)
    while not play.completed:
        play.step()
    assert play.starvations == 1 and play.last.block == 2


def test_figures_of_the_program_leave_the_approach_out():
    play = playback(1)
    fast = approach(MACHINE, T, HOME, np.array([0.1, 0.0, 0.0, 0.0, 0.0]))
    play.begin('p')
    play.push(fast, [0] * len(fast), False)
    still = np.zeros((20, 5))
    position = np.tile(fast.position[-1], (20, 1))
    rest = Setpoints(
        np.arange(20) * T, position, still, still, still, np.ones(20, dtype=int), np.zeros(20)
    )
    play.push(rest, [3] * 20, True)
    while not play.completed:
        play.step()
    assert (play.approach_samples, play.played) == (len(fast), len(fast) + 20)
    assert play.machine.largest_use[0].max() < 1e-9


def test_soft_limit_stops_the_machine_with_the_reason():
    play = playback(1)
    outside = np.array([[0.5001, 0.0, 0.0, 0.0, 0.0]])
    still = np.zeros((1, 5))
    play.machine.place(np.array([0.4999, 0.0, 0.0, 0.0, 0.0]))
    play.begin('p')
    one = Setpoints(np.zeros(1), outside, still, still, still, np.ones(1, dtype=int), np.zeros(1))
    play.push(one, [7], True)
    feedback = play.step()
    assert feedback.state is State.FAULT
    assert 'X' in play.machine.message and feedback.setpoint[0] == 0.4999
    with pytest.raises(StreamError):
        play.machine.step(outside[0], still[0])


def slow_line():
    """A stroke of 20 mm at 0.5 mm/s: one row of the law lasts most of 40 s."""
    path = AxisPath(
        s=np.array([0.0, 0.02]),
        cell_left=np.array([[[0.0]], [[1.0]], [[0.0]], [[0.0]]]),
        cell_right=np.array([[[0.02]], [[1.0]], [[0.0]], [[0.0]]]),
        tip=np.array([[0.0, 0, 0], [0.02, 0, 0]]),
        axis=np.tile([0.0, 0, 1], (2, 1)),
        cell_feed=np.array([0.0005]),
        cell_block=np.array([1]),
        stop=np.array([True, True]),
    )
    v, j = 0.0005, 5.0
    ramp = np.sqrt(v / j)
    duration = np.array([ramp, ramp, 0.02 / v - 2 * ramp, ramp, ramp])
    jerk = np.array([j, -j, 0.0, -j, j])
    time = np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    s, speed, pull = np.zeros(5), np.zeros(5), np.zeros(5)
    for k in range(4):
        dt = duration[k]
        s[k + 1] = s[k] + speed[k] * dt + pull[k] * dt**2 / 2 + jerk[k] * dt**3 / 6
        speed[k + 1] = speed[k] + pull[k] * dt + jerk[k] * dt**2 / 2
        pull[k + 1] = pull[k] + jerk[k] * dt
    law = MotionLaw(time, duration, s, speed, pull, jerk, np.zeros(5, dtype=np.int64))
    return PlannedPiece(path, law)


def test_stretches_are_short_and_give_the_same_setpoints():
    piece = slow_line()
    whole = Interpolator(T).push(piece)
    stretches, interpolator = sliced(piece), Interpolator(T)
    parts = [interpolator.push(stretch) for stretch in stretches]
    assert max(len(part) for part in parts) <= 2 * SLICE / T + 1
    joined = Setpoints.concatenate(parts)
    assert np.array_equal(joined.time, whole.time)
    assert np.abs(joined.position - whole.position).max() < 1e-15
    assert np.abs(joined.velocity - whole.velocity).max() < 1e-15
