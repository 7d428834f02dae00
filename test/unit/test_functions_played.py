"""Functions on their way through planner and machine: period, order, holds, stops, answers."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.core import MM, StreamError
from cnc_interp.machine.playback import LOST, Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine.switching import Act
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Step, signals
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.run.motion_plan import OperatorSettings
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.run.run_state import Reason, RunId, State
from cnc_interp.run.setpoints import Wait
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import (
    check_functions,
    function_messages,
    functions_from,
)

T = 1e-3
CHOICES = Settings(flank_height=0.03, retract=0.0, plunge_feed=16.0)
MACHINE = replace(Machine.load('xyz'), signals=signals({'signals': 'milling'}))
NAMES = [signal.name for signal in MACHINE.signals.wires]
ANSWERED = 'G21 G90\nT3 M6\nS5000 M3\nM8\nG0 X0 Y0 Z0\nG1 X10 F3000\nM9 X20\nM5\nX30\nM30\n'
#: One function without an answer in each of many short blocks.
MANY = (
    'G0 X0 Y0 Z0\n'
    + ''.join(f'S{100 + k} G1 X{0.5 * k} Y{k % 2} F6000\n' for k in range(1, 25))
    + 'M30\n'
)


class Bench:
    """A planner and a machine, period by period; what was set in which one."""

    def __init__(self, text, machine=MACHINE):
        stream = ProgramStream(Source.of_text(text, 'p.ngc'), Transform.of(machine), Settings())
        self.blocks = Blocks.concatenate(list(stream))
        self.functions, self.machine = stream.functions, machine
        self.drives = SimulatedDrives(machine, T, np.zeros(3))
        self.play = Playback(machine, T, self.drives, 100)
        self.play.switch_on()
        self.plans, self.waiting = 0, deque()
        self.outputs = self.drives.outputs.copy()
        self.settings = OperatorSettings()
        self.begin_planner(np.zeros(3), 0.0)
        self.play.begin(RunId('p'))
        self.set, self.blocks_played, self.periods = [], [], 0

    def begin_planner(self, stands, place, done=0):
        transform = Transform.of(self.machine)
        self.planner = RunPlanner(transform, CHOICES, 0.01, stands, place, self.settings)
        self.planner.stream.functions.done = done
        pauses = {
            int(row): Wait.PROGRAM_STOP for row in np.flatnonzero(self.blocks.program_stop == 1)
        }
        self.planner.push(segments_of(self.blocks, transform, Settings()), pauses, self.functions)
        self.planner.finish()
        self.waiting.clear()

    def feed(self):
        play, plan = self.play, self.planner.stream.current
        while play.buffer.count < 150 and not play.left and not play.state.completed:
            while not self.waiting and (plan.can_plan or plan.can_sample):
                self.waiting.extend(self.planner.work(plan, True, -np.inf))
            if not self.waiting:
                return
            chunk = self.waiting.popleft()
            play.push(chunk)

    def step(self):
        play = self.play
        if play.state.plan_over and play.state.state in (State.HELD, State.STARVED):
            self.plans += 1
            place = 0.0 if play.last is None else play.last.s
            self.planner.stream.functions.told(play.switching.functions)
            self.planner.resume(place, play.axes.setpoints[-1], self.settings)
            self.waiting.clear()
            play.begin_plan(RunId('p', plan=self.plans))
        self.feed()
        before, play = self.outputs, self.play
        play.step()
        self.outputs, self.periods = self.drives.outputs.copy(), self.periods + 1
        moved = play.executed[-1].rows if play.executed else None
        self.blocks_played.append(-1 if moved is None else int(moved.block[-1]))
        for k in np.flatnonzero(self.drives.outputs != before):
            self.set.append((self.blocks_played[-1], NAMES[k], self.drives.outputs[k]))

    def run(self, most=60_000):
        for _ in range(most):
            self.step()
            if self.play.state.completed:
                return
        raise AssertionError(f'not executed: {self.play.state}')

    def told(self):
        """Return number and setpoint of the functions that were executed."""
        return [(act.number, sample) for _, act, sample in self.play.switching.switched]

    def prove(self):
        """Demand that all came out, once, in order, with the first setpoint of their block."""
        told = self.told()
        assert [number for number, _ in told] == list(range(len(self.functions)))
        block = np.concatenate([e.rows.block for e in self.play.executed])
        wanted = np.searchsorted(np.maximum.accumulate(block), self.functions.block)
        assert [sample for _, sample in told] == wanted.tolist()


@pytest.mark.parametrize('holds', [False, True])
def test_the_path_rests_for_the_time_of_a_dwell(holds):
    bench, rests = Bench('G0 X0 Y0 Z0\nG1 X2 F3000\nG4 P0.3\nX4\nM2'), 0
    while not bench.play.state.completed:
        bench.step()
        rests += bench.play.state.reason is Reason.FUNCTION
        if holds and rests == 100:
            bench.play.hold()
            holds = False
        elif bench.play.state.state is State.HELD:
            bench.play.start()
        assert bench.periods < 5000
    assert 298 <= rests <= 302
    assert bench.play.axes.setpoints[-1][0] == pytest.approx(4 * MM, abs=1e-9)


@pytest.mark.parametrize('foreign', [0, 1000])
def test_functions_come_with_the_first_setpoint_of_their_block(foreign):
    """Also where another node says that all of them are done."""
    bench = Bench(MANY)
    bench.planner.stream.functions.told(foreign)
    bench.run()
    bench.prove()
    # The output has the value in the very period, as a drive sees it.
    speeds = [(block, value) for block, name, value in bench.set if name == 'spindle_speed']
    assert speeds == [(k, 100.0 + k) for k in range(1, 25)]


def test_answers_are_waited_for_at_rest_and_in_order():
    bench = Bench(ANSWERED)
    bench.run()
    bench.prove()
    changes = [name for _, name, _ in bench.set]
    assert changes[:5] == [
        'tool_number',
        'tool_change',
        'tool_change',
        'spindle_speed',
        'spindle_forward',
    ]
    # Tool change and spindle need their time before anything moves; coolant does not.
    still = bench.blocks_played.index(next(b for b in bench.blocks_played if b >= 0))
    assert still * T > 0.8 + 0.6
    assert [x[0] for x in bench.set if x[1] == 'coolant_flood'] == [1, 3]


@pytest.mark.parametrize('every', [211])
def test_holds_neither_lose_nor_double_nor_hasten_a_function(every):
    bench = Bench(MANY)
    while not bench.play.state.completed:
        bench.step()
        if bench.periods % every == 0 and bench.play.state.state is State.RUNNING:
            bench.play.hold()
        if bench.play.state.state is State.HELD:
            bench.play.start()
        assert bench.periods < 60_000
    assert bench.plans > 1
    bench.prove()


def test_a_revision_of_the_override_keeps_the_functions():
    bench = Bench(MANY)
    joined = 0
    while not bench.play.state.completed:
        bench.step()
        play = bench.play
        if bench.periods % 90 == 50 and play.state.state is State.RUNNING:
            bench.settings = OperatorSettings(0.4 + 0.1 * (joined % 8))
            number = play.played_of_plan + 30
            if number >= play.buffer.next_number:
                continue
            revision = bench.planner.revise(number, bench.settings)
            if revision is None:
                continue
            chunk, *others = revision.chunks
            bench.planner.stream.adopt(revision.plan)
            bench.plans += 1
            run_id = RunId('p', plan=bench.plans)
            play.join(run_id, number + 1, chunk)
            bench.waiting = deque(others)
            joined += 1
    assert joined > 3
    bench.prove()


def test_a_planner_that_is_killed_loses_no_function_and_what_it_left_on_goes_off():
    bench = Bench(MANY.replace('S101', 'M8 S101').replace('S116', 'M3 S116', 1))
    while bench.play.switching.functions < 12:
        bench.step()
    feed, bench.feed = bench.feed, lambda: None  # no setpoints come any more
    while bench.play.state.state is not State.STARVED:
        bench.play.step()
    flood = NAMES.index('coolant_flood')
    assert bench.drives.outputs[flood] == 1.0
    for _ in range(round(LOST / T) + 50):
        bench.play.step()
    assert bench.drives.outputs[flood] == 0.0
    play = bench.play
    bench.begin_planner(play.axes.setpoints[-1], play.last.s, play.switching.functions)
    play.begin_plan(RunId('p', attempt=1))
    bench.feed = feed
    while bench.play.state.state is not State.RUNNING:
        bench.step()
    assert bench.drives.outputs[flood] == 1.0
    bench.run()
    bench.prove()


@pytest.mark.parametrize('stop', ['stop', 'fail'])
def test_a_stop_switches_off_in_the_order_of_the_file_and_nothing_comes_on_after(stop):
    bench = Bench('G0 X0 Y0 Z0\nM3 S100\nM8\nG1 X100 F3000\nX101\nM7\nX200\nM30')
    while not (bench.play.state.state is State.RUNNING and bench.drives.outputs[3]):
        bench.step()
    for _ in range(5):
        bench.step()
    bench.set.clear()
    if stop == 'stop':
        bench.play.stop()
    else:
        bench.play.refuse('a message was spoilt')
        bench.feed = lambda: None
    assert stop == 'fail' or bench.drives.outputs[1] == 0.0
    for _ in range(3000):
        before = bench.drives.outputs.copy()
        bench.play.step()
        if bench.play.state.state is State.FAULT:
            break
        if stop == 'stop':
            assert not (bench.drives.outputs > before).any()
    assert bench.play.state.state is State.FAULT
    for _ in range(5):
        bench.play.step()
    assert not bench.drives.outputs[1:5].any()
    bench.play.reset()
    bench.play.step()
    assert bench.play.state.state is State.IDLE and not bench.drives.outputs[1:5].any()


def deaf(limit=0.3):
    """Return a machine whose changer never answers."""
    table = {
        'outputs': {'clamp': None, 'lamp': None},
        'inputs': {'clamped': None},
        'functions': {
            'M100': [{'clamp': 1, 'wait_for': 'clamped', 'limit_s': limit}, {'lamp': 1}],
            'M101': {'lamp': 0, 'wait_for': 'operator'},
            'emergency_stop': {'clamp': 0},
        },
    }
    return replace(MACHINE, signals=signals({'signals': table}))


@pytest.mark.parametrize('ends', ['goes on', 'answered', 'given up'])
def test_an_answer_that_does_not_come_is_an_alarm_and_the_operator_decides(ends):
    bench = Bench('G0 X0\nG1 X5 F3000\nM100\nX10\nM2', deaf())
    while bench.play.state.state is not State.HELD:
        bench.step()
    play, rest = bench.play, bench.play.axes.setpoints[-1].copy()
    assert play.state.reason is Reason.FUNCTION and rest[0] == pytest.approx(5e-3)
    assert 'clamped has not come within 0.3 s' in play.state.text
    for _ in range(100):
        bench.step()
    assert (play.axes.setpoints[-1] == rest).all() and bench.drives.outputs[1] == 0.0
    if ends == 'given up':
        play.reset()
        assert play.state.state is State.IDLE and not play.switching.busy
        return
    bench.drives.inputs[0] = ends == 'answered'
    play.start()
    bench.run()
    bench.prove()
    assert bench.drives.outputs.tolist() == [1.0, 1.0]


def test_the_operator_answers_by_cycle_start():
    bench = Bench('G0 X0\nG1 X5 F3000\nM101\nX10\nM2', deaf())
    while bench.play.state.state is not State.HELD:
        bench.step()
    assert 'cycle_start when that is done' in bench.play.state.text
    bench.play.start()
    bench.run()
    bench.prove()


def test_what_stands_before_a_program_stop_acts_before_it_waits():
    bench = Bench('G0 X0\nM8\nG1 X5 F3000\nM9\nM0\nM7\nX10\nM30')
    while bench.play.state.state is not State.HELD:
        bench.step()
    for _ in range(20):
        bench.step()
    on = dict(zip(NAMES, bench.drives.outputs, strict=True))
    assert bench.play.state.reason is Reason.PROGRAM_STOP
    assert not on['coolant_flood'] and not on['coolant_mist']
    bench.play.start()
    while bench.play.state.state is not State.RUNNING:
        bench.step()
    bench.step()
    assert bench.drives.outputs[NAMES.index('coolant_mist')] == 1.0
    bench.run()
    bench.prove()


def test_outputs_are_switched_by_hand_at_rest_only():
    bench = Bench(MANY)
    act = Act(Step('', 3, 1.0), 1.0)
    while not bench.play.executed:
        bench.step()
    with pytest.raises(StreamError, match='at rest without a program'):
        bench.play.switch([act])
    bench.run()
    bench.play.switch([act])
    bench.play.step()
    assert bench.drives.outputs[3] == 1.0 and bench.play.state.state is State.IDLE


def test_functions_that_cannot_be_are_refused():
    bench = Bench(ANSWERED)
    plan, found = bench.planner.stream.current, []
    while plan.can_plan or plan.can_sample:
        found += bench.planner.work(plan, True, -np.inf)
    first = next(chunk for chunk in found if len(chunk.functions))
    with pytest.raises(StreamError, match='functions 0 to 4 are missing'):
        bench.play.push(replace(first, first_function=5))
    inside = next(c for c in found if c.samples.block[-1] > c.samples.block[0])
    late = replace(first.functions, block=np.full(len(first.functions), inside.samples.block[-1]))
    with pytest.raises(StreamError, match='must stand where the path rests'):
        bench.play.push(replace(inside, functions=late, first_function=0))


def test_functions_survive_the_wire_and_unsound_ones_are_refused():
    bench = Bench(ANSWERED)
    messages = function_messages(bench.functions, 3, MACHINE.signals)
    check_functions('blocks', messages, MACHINE.signals)
    again = functions_from(messages)
    for name, column in bench.functions.columns().items():
        assert (getattr(again, name) == column).all() and getattr(
            again, name
        ).dtype == column.dtype
    for name, value, told in (
        ('output', 'laser', "sets 'laser', which the machine file does not"),
        ('step', 1000, 'which the machine file does not'),
        ('value', float('nan'), 'cannot be nan'),
        ('value', 1e9, 'is outside'),
        ('number', 9, 'does not follow'),
        ('sequence', 99, 'does not follow'),
    ):
        spoilt = function_messages(bench.functions, 3, MACHINE.signals)
        setattr(spoilt[2], name, value)
        with pytest.raises(StreamError, match=told):
            check_functions('blocks', spoilt, MACHINE.signals)


@pytest.mark.thorough
def test_of_ten_thousand_functions_none_is_lost_doubled_or_early_whatever_the_operator_does():
    """A function in each block of a millisecond, with holds, overrides and lost planners."""
    places = (0.2 * min(k % 2000, 2000 - k % 2000) for k in range(1, 10_001))
    lines = (f'S{100 + k} G1 X{x:.1f} F12000\n' for k, x in enumerate(places))
    bench, held, joined, lost = Bench('G0 X0 Y0 Z0\n' + ''.join(lines) + 'M30\n'), 0, 0, 0
    play, feed = bench.play, bench.feed
    while not play.state.completed:
        bench.step()
        running, turn = play.state.state is State.RUNNING, bench.periods % 4000
        if running and turn % 501 == 500:
            play.hold()
            held += 1
        elif running and turn % 501 == 250:
            number = play.played_of_plan + 40
            settings = OperatorSettings(0.5 + 0.1 * (joined % 7))
            revision = bench.planner.revise(number, settings)
            if revision is not None and number < play.buffer.next_number:
                chunk, *others = revision.chunks
                bench.planner.stream.adopt(revision.plan)
                bench.plans, bench.settings, joined = bench.plans + 1, settings, joined + 1
                play.join(RunId('p', play.run_id.attempt, bench.plans), number + 1, chunk)
                bench.waiting = deque(others)
        elif running and turn == 3900:
            bench.feed, lost = lambda: None, lost + 1
        if play.state.state is State.HELD:
            play.start()
        if bench.feed is not feed and play.state.state is State.STARVED:
            bench.begin_planner(play.axes.setpoints[-1], play.last.s, play.switching.functions)
            bench.feed, bench.plans = feed, 0
            play.begin_plan(RunId('p', play.run_id.attempt + 1))
    assert min(held, joined, lost) > 3, (held, joined, lost)
    assert bench.functions.block[:10_000].tolist() == list(range(1, 10_001))
    bench.prove()
