"""The machine's buffer and the approach: moves played period by period."""

from functools import cache

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from limit_use import limit_use
from tiers import few_of

from cnc_interp.core import Refusal, StreamError, TravelError
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine.axis_motion import refuse_setpoints
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.course import SLICE, sliced
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.overrides import OperatorSettings
from cnc_interp.run.run_state import Reason, RunId, State
from cnc_interp.run.setpoints import Chunk, Interpolator, Setpoints, Wait
from cnc_interp.run.start_place import approach
from cnc_interp.wire.machine_messages import executed_setpoints
from cnc_interp.wire.run_messages import run_id_of

T = 0.001
P, P1, Q = RunId('p'), RunId('p', plan=1), RunId('q')
MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
HOME = np.zeros(5)
LIMITS = (MACHINE.max_velocity, MACHINE.max_acceleration, MACHINE.max_jerk)
POSES = [
    [0.1, -0.05, 0.02, 0.3, -2.0],
    [1e-6, 0.0, 0.0, 0.0, 0.0],
    [0.0, 0.0, 0.0, 0.0, 8.0],
    [-0.5, 0.5, -0.5, 2.0, 1.0],
]


def playback(full=50):
    drives = SimulatedDrives(MACHINE, T, HOME)
    play = Playback(MACHINE, T, drives, full)
    play.switch_on()
    return play


def chunks_to(target, wait=Wait.END, start=HOME):
    """The chunks of a straight move."""
    return list(_chunks(tuple(target), wait, tuple(start)))


@cache
def _chunks(target, wait, start):
    stream = MotionStream(MACHINE, T)
    stream.push(approach(TRANSFORM, 0.03, np.array(start, float), np.array(target)))
    stream.end_leg(wait)
    chunks = []
    plan = stream.current
    while plan.can_plan or plan.can_sample:
        chunks += plan.sample() if plan.can_sample else plan.plan() or []
    return chunks


def test_a_plan_takes_other_settings_until_something_is_planned():
    """A program started at an override of 0 never began: there was nothing to revise."""
    stream = MotionStream(MACHINE, T, settings=OperatorSettings(0.0))
    stream.push(approach(TRANSFORM, 0.03, HOME, np.array(POSES[0])))
    stream.end_leg(Wait.END)
    plan = stream.current
    assert not plan.can_plan
    plan.follow(OperatorSettings(0.5))
    plan.plan()
    plan.follow(OperatorSettings(1.0))
    assert plan.settings.override == 0.5, 'what is planned is revised'


def samples_to(target):
    return Setpoints.concatenate([chunk.samples for chunk in chunks_to(target)])


def feed(play, chunks):
    for chunk in chunks:
        play.push(chunk)


def setpoint_after_step(play):
    play.step()
    return play.feedback.setpoint[-1]


def state_after_step(play):
    play.step()
    return play.state.state


def step_until(play, done, most=20_000):
    """Step; returns the setpoints of the drives."""
    heard = []
    while not done():
        assert len(heard) < most, 'never came'
        heard.append(setpoint_after_step(play))
    return np.array(heard)


@pytest.mark.parametrize('target', few_of(3, POSES))
def test_approach_holds_all_limits_and_ends_at_rest(target):
    samples = samples_to(target)
    assert np.array_equal(samples.position[-1], target)
    assert not samples.velocity[-1].any() and not samples.acceleration[-1].any()
    assert limit_use(samples.position, LIMITS) <= 1.001
    assert (samples.block == 0).all() and samples.s[-1] == 0.0
    straight = samples.position @ np.array(target) / (np.array(target) @ np.array(target))
    assert np.abs(samples.position - straight[:, None] * target).max() < 1e-12


def test_no_approach_where_the_machine_stands():
    assert approach(TRANSFORM, 0.03, HOME, HOME) is None


def test_approach_outside_the_travel_is_refused():
    with pytest.raises(TravelError, match='axis X'):
        approach(TRANSFORM, 0.03, HOME, np.array([0.6, 0.0, 0.0, 0.0, 0.0]))


def test_nothing_moves_before_the_buffer_is_full_then_everything_is_played_in_order():
    play, chunks = playback(50), chunks_to([0.02, 0.0, 0.0, 0.1, 0.0])
    play.begin(P)
    feed(play, chunks[:4])
    for _ in range(5):
        assert state_after_step(play) is State.IDLE
    feed(play, chunks[4:])
    heard = step_until(play, lambda: play.state.completed)
    assert np.array_equal(heard[:-1], np.concatenate([c.samples.position for c in chunks]))
    assert play.state.state is State.IDLE and play.figures.starvations == 0
    assert play.plans.played == len(heard) - 1


def test_looking_takes_over_some_periods_at_once_and_the_end_of_motion_at_once():
    each, some = playback(40), playback(40)
    chunks = chunks_to([0.02, 0.0, 0.0, 0.1, 0.0])
    for play in (each, some):
        play.begin(P)
        feed(play, chunks)
        play.read()
    late = []
    while not some.state.completed:
        each.step()
        some.cycle.step()
        some.look()
        late.append(each.plans.played - some.plans.played)
    assert max(late) == 9 and late[-1] == 0 and each.state == some.state
    assert len(some.executed) < len(each.executed) / 4
    assert some.plans.played == each.plans.played
    for name in ('largest_following_error', 'largest_contour_error'):
        np.testing.assert_array_equal(getattr(some.figures, name), getattr(each.figures, name))
    np.testing.assert_array_equal(some.axes.largest_use, each.axes.largest_use)


def program_on_the_spot(count):
    """Setpoints of block 1 where the approach has ended."""
    still, ones = np.zeros((count, 5)), np.ones(count, dtype=int)
    position = np.tile([0.02, 0.0, 0.0, 0.1, 0.0], (count, 1))
    rows = Setpoints(np.arange(count) * T, position, still, still, still, ones, np.zeros(count))
    return Chunk(rows, rows[:0], Wait.NOTHING)


@pytest.mark.parametrize('there', [0, 49])
def test_the_program_begins_after_its_approach_only_with_a_full_buffer(there):
    play = playback(50)
    play.begin(P)
    feed(play, chunks_to([0.02, 0.0, 0.0, 0.1, 0.0], Wait.NOTHING))
    feed(play, [program_on_the_spot(there)] if there else [])
    step_until(play, lambda: play.plans.played and play.state.resting)
    for _ in range(50):
        assert state_after_step(play) is State.FILLING
    assert (play.figures.starvations, play.last.block, play.state.plan_over) == (0, 0, False)
    assert play.state.reason is Reason.NONE and 'by itself' in play.state.text
    feed(play, [program_on_the_spot(50 - there)])
    play.read()
    assert state_after_step(play) is State.RUNNING and play.last.block == 1


def test_a_short_program_starts_without_a_full_buffer():
    play = playback(10_000)
    play.begin(P)
    feed(play, chunks_to([1e-6, 0.0, 0.0, 0.0, 0.0]))
    assert state_after_step(play) is State.RUNNING


@pytest.mark.parametrize('given', few_of(5, [6, 15, 60, 16, 40]))
def test_starving_follows_the_tail_to_rest_and_goes_on_with_another_plan(given):
    target = [0.4, 0.0, 0.0, 0.2, 0.0]
    play, chunks = playback(50), chunks_to(target)
    play.begin(P)
    feed(play, chunks[:given])
    heard = step_until(play, lambda: play.state.plan_over)
    assert play.state.state is State.STARVED and play.figures.starvations == 1
    assert f'no setpoints after {10 * given}' in play.state.text
    assert limit_use(heard, LIMITS) <= 1.001
    assert np.array_equal(heard[-1], chunks[given - 1].tail.position[-1])
    play.make_room(P1)
    play.begin_plan(P1)
    feed(play, chunks_to(target, start=heard[-1]))
    more = step_until(play, lambda: play.state.completed)
    assert limit_use(np.concatenate([heard, more]), LIMITS) <= 1.001
    assert np.array_equal(more[-1], target)


@pytest.mark.parametrize('at', few_of(4, [63, 7, 10, 1, 200, 700]))
def test_hold_leaves_within_a_chunk_and_waits_for_cycle_start(at):
    target = [0.4, 0.1, 0.0, 0.2, 0.0]
    play, chunks = playback(50), chunks_to(target)
    play.begin(P)
    feed(play, chunks)
    before = np.array([setpoint_after_step(play) for _ in range(at)])
    play.hold()
    assert play.state.state is State.HOLDING and not play.state.resting
    heard = np.concatenate([before, step_until(play, lambda: play.state.resting)])
    of = (at - 1) // 10
    assert len(heard) - at <= 11 + len(chunks[of].tail)
    assert limit_use(heard, LIMITS) <= 1.001 and play.state.plan_over
    play.begin_plan(P1)
    feed(play, chunks_to(target, start=heard[-1]))
    for _ in range(50):
        assert state_after_step(play) is State.HELD
    play.start()
    more = step_until(play, lambda: play.state.completed)
    assert limit_use(np.concatenate([heard, more]), LIMITS) <= 1.001


@pytest.mark.parametrize(
    ('wait', 'reason'),
    [
        (Wait.PROGRAM_STOP, Reason.PROGRAM_STOP),
        (Wait.OPTIONAL_STOP, Reason.OPTIONAL_STOP),
        (Wait.SINGLE_BLOCK, Reason.SINGLE_BLOCK),
    ],
)
def test_a_stop_of_the_program_waits_for_cycle_start_and_goes_on_in_the_same_plan(wait, reason):
    play = playback(20)
    play.single_block = wait is Wait.SINGLE_BLOCK
    play.begin(P)
    feed(play, chunks_to([0.01, 0.0, 0.0, 0.0, 0.0], wait))
    step_until(play, lambda: play.state.resting and play.plans.played > 0)
    assert play.state.state is State.HELD and not play.state.plan_over
    assert play.state.reason is reason
    feed(play, chunks_to([0.02, 0.0, 0.0, 0.0, 0.0], start=[0.01, 0, 0, 0, 0]))
    for _ in range(50):
        assert state_after_step(play) is State.HELD
    play.start()
    assert step_until(play, lambda: play.state.completed)[-1][0] == 0.02


def test_a_rest_that_was_planned_for_single_block_is_passed_when_it_is_off():
    play = playback(20)
    play.begin(P)
    feed(play, chunks_to([0.01, 0.0, 0.0, 0.0, 0.0], Wait.SINGLE_BLOCK))
    feed(play, chunks_to([0.02, 0.0, 0.0, 0.0, 0.0], start=[0.01, 0, 0, 0, 0]))
    heard = step_until(play, lambda: play.state.completed)
    assert (
        heard[-1][0] == 0.02
        and limit_use(heard, LIMITS) <= 1.001
        and play.figures.starvations == 0
    )


def test_an_override_of_zero_rests_without_starving():
    play = playback(20)
    play.begin(P)
    feed(play, chunks_to([0.01, 0.0, 0.0, 0.0, 0.0], Wait.OVERRIDE))
    step_until(play, lambda: play.state.resting and play.plans.played > 0)
    for _ in range(50):
        assert state_after_step(play) is State.PAUSED
    first, *others = chunks_to([0.02, 0.0, 0.0, 0.0, 0.0], start=[0.01, 0, 0, 0, 0])
    feed(play, [first])
    for _ in range(50):
        assert state_after_step(play) is State.PAUSED
    feed(play, others)
    step_until(play, lambda: play.state.completed)
    assert play.figures.starvations == 0


@pytest.mark.parametrize('first', few_of(3, ['running', 'holding', 'starved', 'waiting']))
def test_emergency_stop_ends_in_fault_on_the_path_and_reset_clears_it(first):
    play, chunks = playback(50), chunks_to([0.2, 0.1, 0.0, 0.2, 0.0])
    play.begin(P)
    feed(play, chunks[:30] if first == 'starved' else chunks)
    heard = [setpoint_after_step(play) for _ in range(305 if first == 'starved' else 300)]
    if first in ('holding', 'waiting'):
        play.hold()
    if first == 'waiting':
        heard += list(step_until(play, lambda: play.state.resting))
    play.stop()
    if not play.state.resting:
        assert play.state.state is State.STOPPING
        with pytest.raises(StreamError, match='still moving'):
            play.reset()
        heard += list(step_until(play, lambda: play.state.resting))
    assert play.state.state is State.FAULT and 'emergency stop' in play.state.text
    assert limit_use(np.array(heard), LIMITS) <= 1.001
    with pytest.raises(StreamError, match='emergency stop'):
        play.start()
    play.reset()
    assert play.state.state is State.IDLE


def test_what_cannot_begin_is_refused():
    play, chunks = playback(50), chunks_to([0.2, 0.0, 0.0, 0.0, 0.0])
    play.begin(P)
    feed(play, chunks)
    for _ in range(100):
        play.step()
    with pytest.raises(StreamError, match='while the machine moves'):
        play.make_room(Q)
    play.hold()
    step_until(play, lambda: play.state.resting)
    with pytest.raises(StreamError, match='plan 0 cannot follow plan 0'):
        play.make_room(P)
    with pytest.raises(StreamError, match='p is on hold'):
        play.make_room(Q)
    play.make_room(P1)
    play.make_room(P.next_attempt())
    with pytest.raises(StreamError, match='began before machine_node was started') as told:
        playback(50).make_room(P1)
    assert told.value.kind is Refusal.PLAN_OVER


@cache
def _long_move_and_stop(number):
    """Chunks of a long move, and chunks that stop earlier."""
    stream, chunks = MotionStream(MACHINE, T), []
    stream.push(approach(TRANSFORM, 0.03, HOME, np.array([0.4, 0.1, 0.0, 0.2, 0.0])))
    stream.end_leg(Wait.END)
    plan = stream.current
    while plan.can_plan or plan.can_sample:
        chunks += plan.sample() if plan.can_sample else plan.plan() or []
    revision, stop = stream.revision(number - 1, OperatorSettings(0.0)), []
    while revision.can_sample:
        stop += revision.sample()
    return tuple(chunks), tuple(stop)


def moving_with_a_stop_from(number):
    """A machine that has played 100 setpoints of a long move, and chunks that stop earlier."""
    chunks, stop = _long_move_and_stop(number)
    play = playback(50)
    play.begin(P)
    feed(play, chunks)
    heard = [setpoint_after_step(play) for _ in range(100)]
    return play, np.concatenate([c.samples.position for c in chunks]), stop, heard


def join(play, number, chunks):
    first, *others = chunks
    play.join(P1, number, first)
    feed(play, others)


@pytest.mark.parametrize(
    ('number', 'ask'), few_of(7, [110, 115, 121, 130, 399], ['nothing', 'hold'])
)
def test_a_plan_joins_in_motion_in_place_of_what_is_buffered(number, ask):
    play, old, stop, heard = moving_with_a_stop_from(number)
    join(play, number, stop)
    assert play.plans.run_id == P1 and play.figures.starvations == 0
    if ask == 'hold':
        play.hold()
    heard = np.array(heard + list(step_until(play, lambda: play.state.resting)))
    assert limit_use(heard, LIMITS) <= 1.001
    if ask == 'hold':
        assert play.state.state is State.HELD and play.state.plan_over
        return
    new = np.concatenate([chunk.samples.position for chunk in stop])
    assert np.array_equal(heard[: number + len(new)], np.concatenate([old[:number], new]))
    assert play.state.state is State.PAUSED and play.plans.played_of_plan == number + len(new)
    told = [message for message, _ in executed_setpoints(play, T)]
    assert [(run_id_of(m), m.first_sample) for m in told] == [(P, 0), (P1, number)]


def test_a_plan_that_joins_and_does_not_go_on_starves_within_limits():
    play, _, stop, heard = moving_with_a_stop_from(150)
    join(play, 150, stop[:1])
    heard = np.array(heard + list(step_until(play, lambda: play.state.resting)))
    assert play.state.state is State.STARVED and play.figures.starvations == 1
    assert limit_use(heard, LIMITS) <= 1.001
    assert np.array_equal(heard[-1], stop[0].tail.position[-1])


@pytest.mark.parametrize('number', few_of(3, [50, 100, 105]))
def test_where_the_machine_has_passed_nothing_joins_and_it_goes_on(number):
    play, old, stop, heard = moving_with_a_stop_from(number)
    with pytest.raises(StreamError, match='join') as refused:
        join(play, number, stop)
    assert refused.value.kind is Refusal.TOO_LATE and play.plans.run_id == P
    heard += list(step_until(play, lambda: play.state.completed))
    assert np.array_equal(np.array(heard)[: len(old)], old)


def test_the_setpoints_before_a_plan_that_joins_are_those_it_comes_after():
    play, old, _, _ = moving_with_a_stop_from(150)
    for number in (121, 130, 131, 399):
        assert np.array_equal(play.before_join(P1, number), old[number - 3 : number])
    with pytest.raises(StreamError, match='join'):  # setpoints before it are missing
        play.before_join(P1, len(old) + 1)


def test_between_the_check_and_the_beginning_of_a_plan_nothing_starts():
    play, move = playback(50), chunks_to([0.02, 0.0, 0.0, 0.1, 0.0])
    play.begin(P)
    feed(play, move[:4])  # not enough to start with
    play.make_room(P.next_attempt())
    for _ in range(100):
        assert np.array_equal(setpoint_after_step(play), HOME)
    play.begin_plan(P.next_attempt())
    feed(play, move)
    heard = step_until(play, lambda: play.state.completed)
    assert limit_use(heard, LIMITS) <= 1.001
    assert np.array_equal(heard[-1], [0.02, 0.0, 0.0, 0.1, 0.0])


def test_after_a_reset_nothing_more_of_the_run_moves_the_machine():
    play = playback(50)
    play.begin(P)
    feed(play, chunks_to([0.2, 0.0, 0.0, 0.0, 0.0]))
    for _ in range(100):
        play.step()
    play.hold()
    step_until(play, lambda: play.state.resting)
    played = play.plans.played
    play.reset()
    ((told, _),) = executed_setpoints(play, T)  # what was executed before is still told
    assert (run_id_of(told), told.first_sample, len(told.sequences)) == (P, 0, played)
    for late in (P1, P.next_attempt()):  # they were on their way
        with pytest.raises(StreamError, match='given up by reset'):
            play.make_room(late)
    play.make_room(Q)


def test_the_end_of_the_program_is_told_with_its_last_setpoint():
    play = playback(50)
    play.begin(P)
    move = chunks_to([0.02, 0.0, 0.0, 0.0, 0.0])
    feed(play, move)
    count = sum(len(chunk.samples) for chunk in move)
    ends = {}
    while play.plans.played < count:
        play.step()
        for message, _ in executed_setpoints(play, T):
            ends[message.first_sample] = message.end_of_program
    assert not play.state.completed  # the cycle rests only in the next period
    assert ends == {k: k == count - 1 for k in range(count)}


def test_figures_of_the_program_leave_the_approach_out():
    play = playback(1)
    fast = chunks_to([0.1, 0.0, 0.0, 0.0, 0.0], Wait.NOTHING)
    count = sum(len(chunk.samples) for chunk in fast)
    still = np.zeros((20, 5))
    position = np.tile(fast[-1].samples.position[-1], (20, 1))
    ones = np.ones(20, dtype=int)
    rest = Setpoints(np.arange(20) * T, position, still, still, still, ones, np.zeros(20))
    play.begin(P)
    feed(play, [*fast, Chunk(rest, rest[:0], Wait.END)])
    step_until(play, lambda: play.state.completed)
    assert (play.figures.approach_samples, play.plans.played) == (count, count + 20)
    assert play.axes.largest_use[0].max() < 1e-9


@pytest.mark.parametrize(
    ('row', 'value', 'words'),
    [
        (40, 0.6, 'soft limit: X to 0.6'),
        (40, 1e-7, 'X asked for .* times its largest jerk'),
        (40, 1e-3, 'X asked for .* times its largest'),
        (-1, 1e-7, 'X asked for .* times its largest'),
    ],
)
def test_setpoints_that_cannot_be_are_refused_before_they_are_executed(row, value, words):
    positions = samples_to([0.1, 0.0, 0.0, 0.0, 0.0]).position.copy()
    before = np.zeros((3, 5))
    refuse_setpoints(MACHINE, T, before, positions)
    positions[row, 0] += value
    with pytest.raises(StreamError, match=words):
        refuse_setpoints(MACHINE, T, before, positions)


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


def test_the_way_to_rest_is_what_is_played_when_nothing_else_comes():
    play, chunks = playback(50), chunks_to([0.4, 0.1, 0.0, 0.2, 0.0])
    play.begin(P)
    assert not len(play.plans.way_to_rest(play.state.resting))
    feed(play, chunks[:40])
    for _ in range(203):
        play.step()
    stop = play.plans.way_to_rest(play.state.resting)
    assert len(stop) == 7 + len(chunks[20].tail)
    assert np.abs(stop.velocity[-1]).max() < 1e-6
    play.hold()
    heard = step_until(play, lambda: play.state.resting)
    assert np.array_equal(heard[: len(stop)], stop.position)
