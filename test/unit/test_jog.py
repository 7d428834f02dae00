"""Motion by hand: limits by differences, travel, late beats, holds, and what refuses it."""

from dataclasses import replace

import numpy as np
import pytest
from tiers import examples, few_of

from cnc_interp.core import StreamError
from cnc_interp.machine.cycle_kernels import RECORDED
from cnc_interp.machine.jog import AHEAD, GIVEN_UP, LATE, PIECE, Jog
from cnc_interp.machine.jog_motion import JogMotion
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine.slides import Slides
from cnc_interp.machine.tool_slide import along_tool
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.run.run_state import Reason, RunId, State
from cnc_interp.run.setpoints import Wait

T = 0.001
MM = 1e-3
XYZAC = Machine.load('xyzac')
ARMS = [Machine.load(name) for name in ('ur10e', 'm710ic_50', 'ur10e_cell')]
MACHINES = [XYZAC, Machine.load('head_head'), Machine.load('vmc'), ARMS[0]]


def use_of(machine, q):
    """Largest use of each limit, by differences; the axes rest after the last row."""
    q = np.concatenate([q, q[-1:].repeat(3, 0)])
    return [
        (np.abs(np.diff(q, order, axis=0)).max(axis=0) / T**order / limit).max()
        for order, limit in enumerate(machine.limits.by_order, start=1)
    ]


def beyond(machine, q):
    """How far positions lie outside the travel [m, rad]."""
    return max((machine.travel[:, 0] - q).max(), (q - machine.travel[:, 1]).max())


@pytest.mark.parametrize('machine', MACHINES, ids=lambda m: m.name)
@pytest.mark.parametrize('seed', range(examples(1, 60)))
def test_random_motions_and_all_their_stops_keep_limits_and_travel(machine, seed):
    rng = np.random.default_rng(seed)
    low, high = np.clip(machine.travel, -3.0, 3.0).T
    start = np.where(rng.random(len(low)) < 0.3, low, rng.uniform(low, high))
    motion = JogMotion(Slides.of_axes(machine), T, start)
    done = start[None].repeat(3, 0)
    for _ in range(150):
        kind = rng.random()
        if kind < 0.3:
            shares = rng.choice([-1.0, 0.0, 1.0], len(low)) * rng.random(len(low))
            motion.run(shares * machine.max_velocity)
        elif kind < 0.4:
            motion.go(rng.uniform(low, high), rng.uniform(0.01, 1.0))
        elif kind < 0.45:
            motion.stop()
        if not motion.over:
            chunk = motion.piece(int(rng.integers(1, 60)))
            stopped = [done[-3:], chunk.samples.position, chunk.tail.position]
            stopped = np.concatenate(stopped)
            assert max(use_of(machine, stopped)) <= 1.001
            assert beyond(machine, stopped) <= 1e-9
            done = np.concatenate([done, chunk.samples.position])
    assert np.ptp(done, axis=0).min() > 0.01, 'all axes have moved'


@pytest.mark.parametrize(('machine', 'sense'), few_of(5, MACHINES, [-1.0, 1.0]))
def test_it_rests_on_the_border_and_uses_the_limits(machine, sense):
    borders = machine.travel[:, int(sense > 0.0)]
    ends = np.isfinite(borders)
    start = np.where(ends, borders - sense * np.minimum(np.ptp(machine.travel, axis=1), 3.0), 0.0)
    motion = JogMotion(Slides.of_axes(machine), T, start)
    motion.run(sense * machine.max_velocity)
    rows = [start[None].repeat(3, 0)]
    while np.abs(rows[-1][-1] - borders)[ends].max() > 1e-9:
        assert len(rows) < 1000, 'it never came there'
        rows.append(motion.piece(20).samples.position)
    q = np.concatenate(rows)
    assert beyond(machine, q) <= 1e-9
    speeds = (np.abs(np.diff(q, axis=0)).max(axis=0) / T) / machine.max_velocity
    assert speeds == pytest.approx(np.ones(len(speeds)), abs=1e-6)


def test_a_move_brings_all_axes_to_the_target_at_the_same_time():
    target = np.array([0.2, -0.01, 0.05, 0.3, -1.0])
    motion = JogMotion(Slides.of_axes(XYZAC), T, np.zeros(5))
    motion.go(target, 0.5)
    rows = []
    while not motion.over:
        rows.append(motion.piece(10))
    assert rows[-1].wait is Wait.END and not len(rows[-1].tail)
    q = np.concatenate([np.zeros((3, 5)), *(chunk.samples.position for chunk in rows)])
    assert np.abs(q[-1] - target).max() <= 1e-9 and max(use_of(XYZAC, q)) <= 1.001
    moved = np.abs(np.diff(q, axis=0)) > 1e-12
    last = [np.flatnonzero(column)[-1] for column in moved.T]
    assert np.ptp(last) <= 0.02 / T


@pytest.mark.parametrize('name', ['xyzac', 'head_head', 'vmc'])
def test_along_the_tool_the_tip_moves_on_the_tool_axis(name):
    machine = Machine.load(name)
    transform = Transform.of(machine)
    stands = np.array([0.05, 0.02, -0.1, 0.4, 0.7, *np.zeros(5)])[: len(machine.axis_names)]
    slides = along_tool(machine, stands)
    q = slides.positions(np.array([[0.0], [0.03]]))
    tip, axis = transform.forward(q)
    assert tip[1] - tip[0] == pytest.approx(0.03 * axis[0], abs=1e-12)
    assert np.array_equal(q[0, 3:], q[1, 3:])
    motion = JogMotion(slides, T, np.zeros(1))
    motion.run(slides.limits.max_velocity)
    rows = [stands[None].repeat(3, 0)]
    while not motion.over and len(rows) < 1000:
        chunk = motion.piece(20)
        rows.append(chunk.samples.position)
    q = np.concatenate(rows)
    assert max(use_of(machine, q)) <= 1.001 and -1e-9 <= beyond(machine, q) <= 1e-9
    tip, axis = transform.forward(q)
    way = tip - tip[0]
    assert np.abs(way - np.outer(way @ axis[0], axis[0])).max() < 1e-10


@pytest.mark.parametrize('machine', ARMS, ids=lambda m: m.name)
def test_the_tool_of_an_arm_moves_on_its_axis_and_no_joint_exceeds_a_limit(machine):
    random, stands = np.random.default_rng(3), machine.arm.home
    slides = along_tool(machine, stands)
    motion = JogMotion(slides, T, slides.coordinates(stands))
    low, high = slides.limits.travel[0]
    assert low < -0.1 and high > 0.1
    rows = [stands[None].repeat(3, 0)]
    for k in range(150):
        if k % 12 == 0:
            motion.run(random.choice([-1.0, 1.0]) * slides.limits.max_velocity)
        if k % 30 == 29:
            motion.go(np.array([random.uniform(low, high)]), 1.0)
        if not motion.over:
            chunk = motion.piece(20)
            stopped = np.concatenate([rows[-1][-3:], chunk.samples.position, chunk.tail.position])
            assert max(use_of(machine, stopped)) <= 1.001
            rows.append(chunk.samples.position)
    q = np.concatenate(rows)
    assert beyond(machine, q) <= 0.0
    tip, axis = Transform.of(machine).forward(q)
    way = tip - tip[0]
    assert np.ptp(way @ axis[0]) > 0.1
    assert np.abs(way - np.outer(way @ axis[0], axis[0])).max() < 1e-9
    assert np.abs(axis - axis[0]).max() < 1e-9
    with pytest.raises(StreamError, match='the arm can move its tool from'):
        slides.positions(np.array([[high + 0.1]]))


def test_a_distance_that_just_reaches_the_acceleration_is_no_obstacle():
    # ruckig 0.19 finds no motion over 2 A^3 / J^2 from many places.
    random, machine = np.random.default_rng(4), ARMS[0]
    distance = 2.0 * machine.max_acceleration**3 / machine.max_jerk**2
    for _ in range(100):
        start = random.uniform(-2.0, 2.0, 6)
        motion = JogMotion(Slides.of_axes(machine), T, start)
        motion.go(start + distance, 1.0)
        rows = [start[None].repeat(3, 0)]
        while not motion.over:
            rows.append(motion.piece(500).samples.position)
        q = np.concatenate(rows)
        assert np.abs(q[-1] - start - distance).max() < 1e-9
        assert max(use_of(machine, q)) <= 1.001


# With the machine -------------------------------------------------------------------------------


class Bench:
    """A machine that is operated by hand, period by period."""

    def __init__(self, machine=XYZAC, position=None):
        position = np.zeros(len(machine.axis_names)) if position is None else position
        self.machine = machine
        drives = SimulatedDrives(machine, T, position)
        self.play = Playback(machine, T, drives, 1000)
        self.play.switch_on()
        self.jog = Jog(self.play)
        self.now, self.override, self.works = 0.0, 1.0, True
        self.heard = [position] * 3

    @property
    def state(self):
        return self.play.state.state

    @property
    def q(self):
        return np.array(self.heard)

    def beat(self, tool=0.0, **shares):
        return self.jog.beat(shares, tool, self.now)

    def move(self, relative=True, tool=0.0, speed=0.0, **values):
        return self.jog.move(values, relative, tool, speed)

    def run(self, time, **shares):
        """Let time pass, with a beat every 50 ms if shares are given; read as a node does."""
        cycle = self.play.cycle
        memory, control = cycle._memory, cycle._control
        for k in range(round(time / T)):
            if shares and k % 50 == 0:
                self.beat(**shares)
            if k % 5 == 0:
                if self.works:
                    self.jog.work(self.now, self.override)
                self.play.read()
            cycle.step()
            row = (control[RECORDED] - 1) % len(memory.records)
            self.heard.append(memory.measured[row, 3].copy())  # the setpoint
            self.now += T
        self.play.read()

    def rest(self):
        for _ in range(1000):
            self.run(0.005)
            if self.play.state.resting:
                self.run(0.02)
                break
        assert self.play.state.resting
        assert max(use_of(self.machine, self.q)) <= 1.001
        assert beyond(self.machine, self.q) <= 1e-9
        assert np.array_equal(self.q[-1], self.q[-2])


def test_a_jog_lives_on_beats_and_stops_by_itself():
    bench = Bench()
    bench.run(1.0, X=0.2, C=-0.5)
    assert bench.state is State.JOGGING
    speed = np.diff(bench.q[-2:], axis=0)[0] / T / XYZAC.max_velocity
    assert speed == pytest.approx([0.2, 0, 0, 0, -0.5], abs=1e-6)
    late = len(bench.heard)
    bench.run(LATE + AHEAD + 2 * PIECE)
    acceleration = np.diff(bench.q[-3:], 2, axis=0)[0]
    assert acceleration[0] < 0.0 < acceleration[4], 'it has begun to stop'
    bench.rest()
    stop = len(bench.heard) - late
    assert bench.state is State.IDLE and stop * T < 1.2
    assert bench.play.figures.starvations == 0


def test_the_silence_that_ends_the_motion_of_a_held_key_is_told():
    bench = Bench()
    bench.run(0.5, X=0.2)
    bench.run(0.35)  # the browser is busy
    assert bench.beat(X=0.2) == pytest.approx(0.4, abs=0.01)
    assert bench.beat(X=0.2) == 0.0
    bench.run(0.3)
    assert bench.beat() == pytest.approx(0.3, abs=0.01), 'the key is let go after it'
    bench.rest()
    assert bench.beat(X=0.2) == 0.0, 'it was let go before'
    bench.run(GIVEN_UP + 0.1)
    assert bench.beat(X=0.2) == 0.0, 'a new press, where nobody tells of the end of one'


def test_a_motion_that_has_come_to_rest_unseen_leaves_nothing_behind():
    """A node that was not served for a while filled the buffer at rest, and no key went."""
    bench = Bench()
    bench.run(0.5, X=0.2)
    for _ in range(2000):
        bench.play.cycle.step()
    late, taken = bench.jog._piece(bench.jog._motion), []
    while bench.state is State.JOGGING:
        taken.append(bench.play.push(late))
    assert bench.state is State.IDLE and not taken[-1]
    assert bench.play.plans.buffer.count == 0
    bench.play.check_jog()


def test_motion_begins_and_ends_soon_after_the_command():
    bench = Bench()
    bench.run(0.02)
    first = len(bench.heard)
    bench.run(0.6, Z=0.3)
    began = np.flatnonzero(np.abs(np.diff(bench.q[first:, 2])) > 1e-12)[0] * T
    assert began <= 0.01
    first = len(bench.heard)
    bench.beat(Z=0.0)
    bench.rest()
    slower = np.flatnonzero(np.diff(bench.q[first:, 2], 2) < -1e-12)[0] * T
    assert slower <= AHEAD + PIECE + 0.005


def test_no_beat_no_setpoint_thread_and_it_still_stops_on_its_tail():
    bench = Bench()
    bench.run(0.6, X=1.0, Y=-1.0)
    bench.works = False
    bench.rest()
    assert bench.play.figures.starvations == 1 and bench.state is State.IDLE
    assert bench.play.state.text == ''


@pytest.mark.parametrize('press', few_of(2, ['hold', 'stop']))
def test_a_hold_and_an_emergency_stop_end_it_at_once_and_keys_must_be_let_go(press):
    bench = Bench()
    bench.run(0.5, X=0.5)
    first = len(bench.heard)
    getattr(bench.play, press)()
    bench.run(0.1, X=0.5) if press == 'hold' else bench.run(0.1)
    slower = np.flatnonzero(np.diff(bench.q[first - 3 :, 0], 2) < -1e-12)[0] * T
    assert slower <= PIECE + 0.005
    if press == 'hold':
        bench.run(2.0, X=0.5)
        assert bench.state is State.IDLE and bench.play.state.reason is Reason.FEED_HOLD
        assert not bench.play.state.text
        still = bench.q[-1]
        bench.run(LATE + 0.1)
        bench.run(0.3, X=0.5)
        assert bench.q[-1, 0] > still[0], 'a new key press moves again'
    else:
        bench.rest()
        assert bench.state is State.FAULT
        with pytest.raises(StreamError, match='emergency stop; press reset'):
            bench.beat(X=0.5)
        bench.play.reset()
    bench.rest()
    assert bench.state is State.IDLE


def test_steps_add_up_and_a_hold_gives_them_up():
    bench = Bench()
    for _ in range(3):
        bench.move(X=1 * MM, A=0.01)
        bench.run(0.05)
    bench.rest()
    assert bench.q[-1] == pytest.approx([3 * MM, 0, 0, 0.03, 0], abs=1e-9)
    place = bench.move(relative=False, X=0.1, C=7.0)
    assert place == pytest.approx([0.1, 0, 0, 0.03, 7.0])
    bench.run(0.3)
    bench.play.hold()
    bench.rest()
    bench.run(0.5)
    assert bench.state is State.IDLE and 3 * MM < bench.q[-1, 0] < 0.1


def test_the_override_scales_it_and_zero_stops_it():
    bench = Bench(position=np.array([-0.45, 0.0, 0.0, 0.0, 0.0]))
    bench.override = 0.5
    bench.run(1.0, X=0.4)
    assert np.diff(bench.q[-2:, 0])[0] / T == pytest.approx(0.2 * XYZAC.max_velocity[0])
    bench.override = 1.5
    bench.run(1.0, X=0.9)
    assert np.diff(bench.q[-2:, 0])[0] / T == pytest.approx(XYZAC.max_velocity[0], rel=1e-6)
    bench.override = 0.0
    bench.rest()
    with pytest.raises(StreamError, match='override'):
        bench.move(X=1 * MM)


def test_along_the_tool_after_axes_it_first_comes_to_rest():
    machine = Machine.load('head_head')
    bench = Bench(machine, np.array([0.0, 0.0, 0.0, 0.5, 0.3]))
    bench.run(0.4, X=0.3)
    bench.run(3.0, tool=0.3)
    bench.rest()
    q = bench.q
    tip, axis = Transform.of(machine).forward(q)
    rests = np.flatnonzero(~np.diff(q, axis=0).any(axis=1))
    way = tip[-1] - tip[rests[rests > 450][0]]
    assert way @ axis[-1] > 0.01
    assert np.linalg.norm(way - (way @ axis[-1]) * axis[-1]) < 1e-10
    bench.move(tool=-5 * MM)
    before = tip[-1]
    bench.rest()
    after = Transform.of(machine).forward(bench.q[-1:])[0][0]
    assert after - before == pytest.approx(-5 * MM * axis[-1], abs=1e-9)


@pytest.mark.parametrize(
    ('values', 'words'),
    [
        ({'Q': 1.0}, "no axis 'Q'"),
        ({'X': 0.6}, 'X would go to 600.000 mm; its travel is -500.000 to 500.000'),
        ({'A': -2.2}, 'A would go to -126.0507 deg'),
        ({'tool': 0.6}, 'Z would go to'),
        ({'X': 0.1, 'tool': 0.1}, 'either axes or along the tool'),
        ({'X': float('nan')}, 'not finite'),
        ({}, 'name an axis'),
        ({'X': 0.1, 'speed': 2.0}, 'speed'),
    ],
)
def test_moves_that_are_refused_say_why(values, words):
    bench = Bench()
    with pytest.raises(StreamError, match=words):
        bench.move(**values)
    bench.run(0.1)
    assert bench.state is State.IDLE and not bench.q.any()


def test_it_is_refused_with_drives_off_and_beside_a_program():
    bench = Bench()
    bench.run(0.2, X=0.1)
    with pytest.raises(StreamError, match='while the machine moves'):
        bench.play.make_room(RunId('p'))
    with pytest.raises(StreamError, match='release the key first'):
        bench.move(Y=1 * MM)
    bench.rest()
    motion = JogMotion(Slides.of_axes(XYZAC), T, bench.q[-1])
    motion.go(bench.q[-1] + 0.01, 1.0)
    chunk = motion.piece(100)
    bench.play.make_room(RunId('p'))
    bench.play.begin_plan(RunId('p'))
    bench.play.push(chunk)
    with pytest.raises(StreamError, match='about to start'):
        bench.beat(X=0.1)
    bench.play.reset()
    bench.play.switch_off()
    with pytest.raises(StreamError, match='drives are off'):
        bench.beat(X=0.1)


def test_at_the_border_a_held_key_moves_nothing_and_the_way_back_is_free():
    bench = Bench(position=np.array([0.49, 0.0, 0.0, 0.0, 0.0]))
    bench.run(1.5, X=1.0)
    assert bench.state is State.IDLE and bench.q[-1, 0] == pytest.approx(0.5, abs=1e-9)
    bench.run(0.5, X=-0.2)
    assert bench.q[-1, 0] < 0.499
    bench.rest()


@pytest.mark.parametrize('seed', range(examples(1, 60)))
def test_random_keys_lost_beats_holds_and_overrides(seed):
    rng = np.random.default_rng(seed)
    bench = Bench(position=np.array([0.45, -0.45, 0.4, 1.9, 0.0]))
    for _ in range(15):
        kind, wait = rng.random(), float(rng.uniform(0.01, 0.5))
        if kind < 0.6:
            shares = rng.choice([-1.0, 0.0, 1.0], 5) * rng.random()
            shares = dict(zip('XYZAC', shares, strict=True))
            with_refusal(lambda shares=shares, wait=wait: bench.run(wait, **shares))
        elif kind < 0.75:
            values = dict(zip('XYZAC', rng.uniform(-0.05, 0.05, 5), strict=True))
            with_refusal(lambda values=values: bench.move(**values))
        elif kind < 0.8:
            with_refusal(bench.play.hold)
        elif kind < 0.85:
            bench.override = float(rng.choice([0.0, 0.3, 1.0, 1.5]))
        elif kind < 0.9:
            with_refusal(lambda wait=wait: bench.run(wait, tool=0.5))
        bench.works = rng.random() < 0.95
        bench.run(wait)
    bench.works = True
    bench.rest()
    assert bench.state is State.IDLE
    assert np.ptp(bench.q, axis=0).max() > 0.01


def with_refusal(act):
    """Do something that may be refused in one line."""
    try:
        act()
    except StreamError as problem:
        assert '\n' not in str(problem)


# Away from a hold -------------------------------------------------------------------------------


def held_bench():
    """A machine in a feed hold of run `p`, its next plan in the buffer."""
    bench = Bench()
    again(bench, 0)
    bench.run(0.1)
    bench.play.hold()
    bench.rest()
    again(bench, 1)
    bench.run(0.1)
    assert bench.state is State.HELD
    return bench


def again(bench, plan):
    """Give the machine the next plan, from where it stands."""
    motion = JogMotion(Slides.of_axes(XYZAC), T, bench.q[-1])
    motion.go(np.full(5, 0.01), 1.0)
    bench.play.make_room(RunId('p', plan=plan))
    bench.play.begin_plan(RunId('p', plan=plan))
    while not motion.over:
        chunk = motion.piece(10)
        block = np.ones_like(chunk.samples.block)
        samples = replace(chunk.samples, block=block, s=0.5 + chunk.samples.s)
        bench.play.push(replace(chunk, samples=samples))


def test_away_from_a_hold_the_run_stays_and_goes_on_with_another_plan():
    bench = held_bench()
    play, place = bench.play, bench.q[-1]
    last, played = play.last, play.plans.played
    bench.run(0.5, X=0.2, C=-0.1)
    assert bench.state is State.AWAY and play.plans.run_id == RunId('p', plan=1)
    assert play.plans.is_void(play.plans.run_id, None, play.state)
    with pytest.raises(StreamError, match='moved by hand'):
        play.start()
    bench.rest()
    assert bench.state is State.HELD and play.state.reason is Reason.AWAY
    assert np.array_equal(play.plans.away, place) and not np.array_equal(bench.q[-1], place)
    assert play.last == last and play.plans.played > played and not play.state.completed
    plans = play.plans
    assert not plans.played_of_plan and plans.is_void(plans.run_id, None, play.state)
    elsewhere = 'the axes do not stand there any more'
    assert plans.is_void(RunId('p', plan=2), place, play.state), elsewhere
    assert plans.run_id == RunId('p', plan=2)
    assert not play.plans.is_void(RunId('p', plan=3), bench.q[-1], play.state)
    again(bench, 3)
    play.start()
    bench.rest()
    assert play.state.completed and not len(play.plans.away)
    assert not any(executed.ends for executed in list(play.executed)[:-1])


def test_what_begins_while_the_axes_are_away_is_left_at_once():
    bench = held_bench()
    bench.run(0.3, X=0.2)
    other, mine = RunId('q'), RunId('p', attempt=1)
    assert not bench.play.plans.is_void(other, bench.q[-1], bench.play.state)
    assert bench.play.plans.is_void(mine, bench.q[-1], bench.play.state)
    assert bench.play.plans.run_id == mine
    with pytest.raises(StreamError, match='cannot join'):
        bench.play.before_join(RunId('p', attempt=1, plan=1), 10)
    bench.rest()
    assert bench.play.state.plan_over


@pytest.mark.parametrize('press', few_of(2, ['hold', 'stop']))
def test_a_hold_and_an_emergency_stop_end_it_and_reset_forgets_the_place(press):
    bench = held_bench()
    bench.run(0.5, X=0.5)
    getattr(bench.play, press)()
    bench.rest()
    assert bench.state is (State.HELD if press == 'hold' else State.FAULT)
    assert len(bench.play.plans.away)
    bench.play.reset()
    assert bench.state is State.IDLE and not len(bench.play.plans.away)
