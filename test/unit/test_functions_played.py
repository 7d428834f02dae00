"""Functions on their way through planner and machine: period, order, holds, stops, answers."""

from collections import deque
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip('cnc_interp_msgs', reason='needs ROS 2; run the tests with ./cnc test')

from cnc_interp.core import MM, StreamError
from cnc_interp.core.small_files import config_directory, read_yaml
from cnc_interp.machine.playback import LOST, Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine.switching import Act
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import STOPS, Step, signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.run.overrides import OperatorSettings
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


def milling():
    return read_yaml(config_directory() / 'signals' / 'milling.yaml')


def by_hand():
    """Return the milling machine with a door, and with inputs that the test sets."""
    given = milling()
    given['inputs'] |= {'tool_changed': None, 'spindle_at_speed': None, 'door_closed': None}
    given['interlocks'] |= {'spindle_forward': ['door_closed', 'not tool_change']}
    given['interlocks'] |= {'coolant_flood': 'door_closed'}
    return replace(MACHINE, signals=signals({'signals': given}))


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
        while play.plans.buffer.count < 150 and not (
            play.plans.is_left(play.state) or play.state.completed
        ):
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
            number = play.plans.played_of_plan + 30
            if number >= play.plans.buffer.next_number:
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
def test_a_stop_switches_off_at_once_and_nothing_comes_on_after(stop):
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
        'switched_off': {'clamp': 'never', 'lamp': 'always'},
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
    assert 'press cycle start when that is done' in bench.play.state.text
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
    with pytest.raises(StreamError, match='must be at a rest of the path'):
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
        setattr(spoilt[3], name, value)
        with pytest.raises(StreamError, match=told):
            check_functions('blocks', spoilt, MACHINE.signals)


CHANGING = 'S100 M3\nG0 X0 Y0 Z0\nG1 X2 F3000\nT2 M6\nX4\nT5 M6\nX6\nM30\n'
BY_HAND = by_hand()
INPUTS = [signal.name for signal in BY_HAND.signals.inputs]


class Operated(Bench):
    """The milling machine; inputs are set, and outputs read, by their names."""

    def __init__(self, text, **inputs):
        super().__init__(text, BY_HAND)
        self.tell(door_closed=1, **inputs)

    def tell(self, **inputs):
        for name, value in inputs.items():
            self.drives.inputs[INPUTS.index(name)] = value

    def on(self, name):
        return self.drives.outputs[NAMES.index(name)]

    def until(self, wanted, most=20_000):
        for _ in range(most):
            if wanted():
                return
            self.step()
        raise AssertionError(f'not reached: {self.play.state}')

    def let_pass(self, seconds):
        for _ in range(round(seconds / T)):
            self.step()

    def acts(self, word):
        steps = [BY_HAND.signals.steps[k] for k in BY_HAND.signals.words[word]]
        return [Act(step, float(step.value)) for step in steps]

    def give_up(self):
        self.feed = lambda: None
        self.play.reset()


def changing():
    """Return the machine while it waits for its tool changer."""
    bench = Operated(CHANGING, spindle_at_speed=1)
    bench.until(lambda: bench.on('tool_change'))
    bench.let_pass(0.2)
    assert bench.play.state.reason is Reason.FUNCTION and bench.on('tool_change')
    return bench


def test_a_reset_while_a_tool_change_waits_drops_the_request():
    """The next M3 turned the spindle while the drawbar was open."""
    bench = changing()
    bench.play.hold()
    bench.let_pass(0.05)
    bench.give_up()
    assert not bench.on('tool_change') and not bench.play.switching.busy
    bench.play.switch(bench.acts('M3'))
    bench.let_pass(0.2)
    assert bench.on('spindle_forward') and not bench.on('tool_change')


def test_a_tool_change_waits_until_the_answer_of_the_one_before_has_gone():
    """The next M6 took the old answer and counted the tool as changed."""
    bench = changing()
    bench.tell(tool_changed=1)
    bench.until(lambda: not bench.on('tool_change'))
    bench.let_pass(1.0)  # the changer keeps its answer
    assert 'waits for not tool_changed' in bench.play.state.text
    bench.tell(tool_changed=0)
    bench.until(lambda: bench.play.state.state is State.RUNNING)
    bench.tell(tool_changed=1)  # an answer that nobody has asked for
    bench.until(lambda: bench.play.state.reason is Reason.FUNCTION)
    bench.let_pass(1.0)
    assert not bench.on('tool_change') and bench.on('tool_number') == 2
    bench.tell(tool_changed=0)
    bench.until(lambda: bench.on('tool_change'))
    assert bench.on('tool_number') == 5


def test_no_tool_is_changed_while_the_spindle_turns():
    bench = Operated('S3000 M3\nG0 X0 Y0 Z0\nG1 X2 F3000\nT2 M6\nX4\nM30\n', spindle_at_speed=1)
    bench.until(lambda: bench.play.state.state is State.RUNNING)
    turning = []
    while not bench.on('tool_change'):
        bench.step()
        turning.append(bench.drives.memory[10])  # of the simulated spindle [rev/s]
        assert len(turning) < 9000
    assert max(turning) > 5.0 and abs(turning[-1]) < 0.1


def test_axes_are_not_moved_by_hand_while_the_changer_works():
    bench = changing()
    bench.play.hold()
    bench.let_pass(0.05)
    assert bench.play.state.state is State.HELD
    with pytest.raises(StreamError, match='tool_change on: waits for tool_changed; wait for it'):
        bench.play.check_jog()


def test_an_interlock_stops_a_program_until_the_operator_has_seen_to_it():
    bench = Operated(CHANGING, spindle_at_speed=1)
    bench.tell(door_closed=0)
    bench.until(lambda: bench.play.state.state is State.HELD)
    told = 'spindle_forward on is refused: spindle_forward must not be on while door_closed is off'
    assert bench.play.state.text.startswith(told)
    bench.play.start()  # without having seen to it
    bench.let_pass(0.5)
    assert bench.play.state.state is State.HELD and not bench.on('spindle_forward')
    bench.tell(door_closed=1)
    bench.let_pass(0.5)  # a door that is closed starts nothing
    assert not bench.on('spindle_forward')
    bench.play.start()
    bench.until(lambda: bench.on('spindle_forward'))


def test_an_interlock_holds_for_keys_and_services_too():
    bench = Operated(CHANGING, spindle_at_speed=1)
    bench.give_up()
    request = Act(Step('', NAMES.index('tool_change'), 1.0), 1.0)
    bench.play.switch([request])
    bench.let_pass(0.1)
    for word in ('M3', 'M4'):
        with pytest.raises(StreamError, match='must not be on while tool_change is on'):
            bench.play.switch(bench.acts(word))
    assert not bench.on('spindle_forward') and not bench.on('spindle_reverse')
    bench.play.reset()
    bench.play.switch(bench.acts('M3'))
    bench.let_pass(0.2)
    both = Act(Step('', NAMES.index('spindle_reverse'), 1.0), 1.0)
    with pytest.raises(StreamError, match='must not be on while spindle_forward is on'):
        bench.play.switch([both])
    bench.tell(door_closed=0)
    bench.play.switch(bench.acts('M5'))  # what switches off is never refused
    bench.let_pass(0.1)
    assert not bench.on('spindle_forward')


def test_an_output_with_an_interlock_is_set_at_rest_only():
    bench = Operated('G0 X0 Y0 Z0\nG1 X2 F3000\nM8 X4\nX6\nM30\n')
    bench.until(lambda: bench.play.state.state is State.RUNNING)
    bench.tell(door_closed=0)
    bench.until(lambda: bench.play.state.state is State.HELD)
    assert bench.play.axes.setpoints[-1][0] == pytest.approx(2 * MM, abs=1e-9)
    assert not bench.on('coolant_flood')
    bench.tell(door_closed=1)
    bench.play.start()
    bench.run()
    assert (2, 'coolant_flood', 1.0) in bench.set or bench.on('coolant_flood') == 0.0
    bench.prove()


@pytest.mark.parametrize('door', [1, 0])
def test_what_was_switched_on_by_hand_comes_back_after_a_lost_planner(door):
    """The program went on with a spindle that stood."""
    bench = Operated('G0 X0 Y0 Z0\nG1 X60 F3000\nX80\nM30\n', spindle_at_speed=1)
    play, feed = bench.play, bench.feed
    bench.give_up()
    play.switch(bench.acts('M3'))
    bench.let_pass(0.2)
    play.begin(RunId('p'))
    bench.feed = feed
    bench.until(lambda: play.state.state is State.RUNNING)
    bench.feed = lambda: None
    bench.let_pass(LOST + 1.0)
    assert not bench.on('spindle_forward')
    bench.tell(door_closed=door)
    bench.begin_planner(play.axes.setpoints[-1], play.last.s, play.switching.functions)
    play.begin_plan(RunId('p', attempt=1))
    bench.feed = feed
    if not door:
        bench.until(lambda: play.state.state is State.HELD)
        bench.tell(door_closed=1)
        bench.let_pass(0.5)  # a door that is closed starts nothing
        assert play.state.state is State.HELD and not bench.on('spindle_forward')
        play.start()
    bench.until(lambda: play.state.state is State.RUNNING)
    assert bench.on('spindle_forward')


def test_a_planner_that_is_lost_at_a_rest_switches_off_as_well():
    """Only what starved in motion counted: spindle and coolant ran on for ever."""
    bench = Operated('M7\nG0 X0 Y0 Z0\nG1 X2 F3000\nG4 P0.1\nX4\nM30\n')
    plan, chunks = bench.planner.stream.current, []
    while not any(chunk.rests for chunk in chunks):
        chunks += bench.planner.work(plan, True, -np.inf)
    for chunk in chunks[: next(k for k, c in enumerate(chunks) if c.rests) + 1]:
        bench.play.push(chunk)
    bench.feed = lambda: None
    bench.until(lambda: bench.play.state.state is State.FILLING and bench.play.last)
    assert bench.on('coolant_mist')
    bench.let_pass(LOST + 0.1)
    assert not bench.on('coolant_mist')


OFF = {
    'never': 'never',
    'always': 'always',
    **{stop: [stop] for stop in STOPS},
}
TABLE = {
    'outputs': dict.fromkeys(OFF),
    'switched_off': OFF,
    'functions': {f'M{100 + k}': {name: 1} for k, name in enumerate(OFF)},
}


@pytest.mark.parametrize('stop', STOPS)
def test_each_stop_switches_off_what_the_table_says_and_nothing_else(stop):
    machine = replace(MACHINE, signals=signals({'signals': TABLE}))
    words = ''.join(f'M{100 + k}\n' for k in range(len(OFF)))
    bench = Bench(f'{words}G0 X0 Y0 Z0\nG1 X5 F3000\nX200\nM30', machine)
    play, outputs = bench.play, bench.drives.outputs
    while not (play.state.state is State.RUNNING and outputs.all() and play.plans.played > 100):
        bench.step()
    bench.feed = lambda: None
    if stop == 'emergency_stop':
        play.stop()
    elif stop == 'fault':
        play.refuse('a message was spoilt')
    elif stop == 'reset':
        play.hold()
    elif stop == 'lost_machine':
        play.close()
    for _ in range(round((LOST + 3.0) / T) if stop == 'lost_planner' else 1500):
        bench.play.step()
    if stop == 'reset':
        assert outputs.all()  # a hold switches nothing off
        play.reset()
    off = {name for name, value in zip(OFF, outputs, strict=True) if not value}
    assert off == {'always', stop}


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
            number = play.plans.played_of_plan + 40
            settings = OperatorSettings(0.5 + 0.1 * (joined % 7))
            revision = bench.planner.revise(number, settings)
            if revision is not None and number < play.plans.buffer.next_number:
                chunk, *others = revision.chunks
                bench.planner.stream.adopt(revision.plan)
                bench.plans, bench.settings, joined = bench.plans + 1, settings, joined + 1
                play.join(RunId('p', play.plans.run_id.attempt, bench.plans), number + 1, chunk)
                bench.waiting = deque(others)
        elif running and turn == 3900:
            bench.feed, lost = lambda: None, lost + 1
        if play.state.state is State.HELD:
            play.start()
        if bench.feed is not feed and play.state.state is State.STARVED:
            bench.begin_planner(play.axes.setpoints[-1], play.last.s, play.switching.functions)
            bench.feed, bench.plans = feed, 0
            play.begin_plan(RunId('p', play.plans.run_id.attempt + 1))
    assert min(held, joined, lost) > 3, (held, joined, lost)
    assert bench.functions.block[:10_000].tolist() == list(range(1, 10_001))
    bench.prove()
