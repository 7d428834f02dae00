"""Outputs and inputs of a machine: program functions, switching off at stops, and interlocks.

A machine with an output ``SPEED`` also has ``STATES``. Program words set states like outputs. The
cycle (``machine/spindle.py``) and the feed planner use them; the drives do not receive them.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from math import inf, isfinite
from pathlib import Path
from typing import Any, NamedTuple

from cnc_interp.core import MINUTE, MM, MachineError
from cnc_interp.core.small_files import UnreadableError, config_directory, is_number, read_yaml
from cnc_interp.machine_model.demands import demand

#: Program letters whose value an output may get: speed S, tool T, and words of the same block.
LETTERS = ('S', 'T', 'P', 'Q', 'R')
#: Events that switch outputs off: emergency stop, fault, operator's reset, missing setpoints, and
#: the end of the machine node. After that end, HAL switches them off.
EMERGENCY, FAULT, RESET, LOST_PLANNER, LOST_MACHINE = STOPS = (
    'emergency_stop',
    'fault',
    'reset',
    'lost_planner',
    'lost_machine',
)
ALWAYS, NEVER = 'always', 'never'  #: Entries that stand for all ``STOPS``, or none.
OPERATOR = 'operator'  #: Entry that waits for the operator's cycle start instead of an input.
AFTER = ('M2', 'M5', 'M9', 'M30')  #: Words that act after the motion of their block.
#: Functions before a probing line: G38.2 and G38.3 end when the probe comes on, G38.4 and G38.5
#: when it goes off.
TOWARD, AWAY = 'G38.2', 'G38.4'
#: Input of the probe; and an output: 1 while the machine waits for the probe to come on, 2 while
#: it waits for the probe to go off. The machine resets this output itself.
PROBE, ARMED = 'probe', 'probe_armed'
SINCE = 'probe_since'  #: Input: time from the last contact to the end of that period [s].
#: Program words that stop, call or return; they cannot be functions.
NO_FUNCTIONS = ('M0', 'M1', 'M17', 'M60', 'M98', 'M99')
HOME = 'home_'  #: Prefix of inputs of reference switches, as home_x.
#: Values of ``Step.wait`` without an input. ``TIMED``: rest for the value of the step [s].
NO_WAIT, ASK, TIMED = 0, -(1 << 30), -(1 << 29)
BY_SPEED = 'mm_per_min', 'share'  #: Keys of the table of an output that follows the tip speed.
DWELL = 'dwell'  #: State: duration of a dwell, G4 [s].
#: LinuxCNC word for a numbered output -> equivalent word, and letter of the output number.
NUMBERED: Mapping[str, tuple[str, str]] = {
    'M62': ('M64', 'P'),
    'M63': ('M65', 'P'),
    'M64': ('M64', 'P'),
    'M65': ('M65', 'P'),
    'M67': ('M68', 'E'),
    'M68': ('M68', 'E'),
}
INPUT_WAIT = 'input_wait'  #: State: time after which M66 asks the operator [s].
TOOL = 'tool'  #: State: tool that the operator must put in, if no function changes tools.
MOST_TOOL = 1e6  #: Largest tool number in a program.
#: Spindle outputs [rev/min, 0 or 1], and inputs. ``ANGLE`` [rev] increases with ``FORWARD``.
SPEED, FORWARD, REVERSE = 'spindle_speed', 'spindle_forward', 'spindle_reverse'
ANGLE, AT_SPEED = 'spindle_angle', 'spindle_at_speed'
TURNING = 'spindle_turning'  #: Condition: the spindle turns, according to its encoder.
#: Inputs of a handwheel: counts, travel per count, and prefix of the inputs that select axes.
COUNTS, STEP, WHEEL = 'handwheel', 'handwheel_step', 'handwheel_'
#: Numeric inputs, with their units.
NUMBERS: Mapping[str, str] = {ANGLE: 'rev', SINCE: 's', COUNTS: '', STEP: ''}
POWER_FAILS = 'power_fails'  #: Input: on a mains failure, while power remains for a stop.
FIXED = 'fixed'  #: Value supplied for M50 and M51: 1 with P0, else 0.
PER_TURN, FEED_FIXED, SPINDLE_FIXED = 'feed_per_turn', 'feed_fixed', 'spindle_fixed'
SURFACE = ('surface_zero', 'surface_limit', 'surface_speed')
THREAD = ('thread_x', 'thread_y', 'thread_z', 'thread_turns')
#: State -> unit. Feed per turn (G95); disabled overrides (M49); G96: X of the centre, D and S; a
#: line in step with the spindle: travel of each axis per turn, and turns (< 0: there and back).
STATES: Mapping[str, str] = {
    **dict.fromkeys((PER_TURN, FEED_FIXED, SPINDLE_FIXED), ''),
    **dict(zip(SURFACE, ('mm', 'rev/min', 'm/min'), strict=True)),
    **dict.fromkeys(THREAD[:3], 'mm'),
    THREAD[3]: '',
    DWELL: 's',
}
#: Word -> states that it sets; the program reader supplies a value that is given as a name.
OF_STATES: Mapping[str, Mapping[str, float | str]] = {
    'G94': {PER_TURN: 0.0},
    'G95': {PER_TURN: 1.0},
    'G96': {name: name for name in SURFACE},
    'G97': {SURFACE[2]: 0.0},
    'M48': {FEED_FIXED: 0.0, SPINDLE_FIXED: 0.0},
    'M49': {FEED_FIXED: 1.0, SPINDLE_FIXED: 1.0},
    'M50': {FEED_FIXED: FIXED},
    'M51': {SPINDLE_FIXED: FIXED},
}
#: Further words with an encoder: the axes rest before both, and between them follow the spindle.
FOLLOWS, FREE = 'G33', 'G33 ends'
LONGEST_START = 20.0  #: Longest wait for the spindle speed before a thread [s].


def home_input(axis: str) -> str:
    return f'{HOME}{axis.lower()}'


def numbered_word(code: str, values: Mapping[str, float]) -> str:
    """Return the word of a numbered output or input: ``M64 P3`` for M62 P3; '' if wrong."""
    word, letter = NUMBERED.get(code, (code, 'P'))
    number, mode = values.get(letter, -1.0), values.get('L', 0.0)
    if number < 0.0 or number != int(number) or (code == 'M66' and mode not in (3.0, 4.0)):
        return ''
    return f'{word} {letter}{int(number)}' + (f' L{int(mode)}' if code == 'M66' else '')


def limit_inputs(axis: str) -> tuple[str, str]:
    """Return the names of the inputs of an axis's lower and upper limit switch."""
    return f'limit_{axis.lower()}_low', f'limit_{axis.lower()}_high'


def handwheel_input(axis: str) -> str:
    return f'{WHEEL}{axis.lower()}'


def square_output(axis: str) -> str:
    """Return the output that makes each motor of a gantry axis stop at its own switch."""
    return f'square_{axis.lower()}'


def index_signals(axis: str) -> tuple[str, str, str]:
    """Return the output that requests an index pulse, and its inputs: waiting, and offset."""
    return tuple(f'index{what}_{axis.lower()}' for what in ('', '_waits', '_offset'))  # type: ignore[return-value]


@dataclass(frozen=True)
class Signal:
    name: str
    is_number: bool = False  #: Whether the value is a number; otherwise it is 0 or 1.
    unit: str = ''  #: Unit, for display.
    low: float = 0.0  #: Smallest and largest value.
    high: float = 1.0
    #: Simulated input: it is on while the first of these outputs is not 0, if none of the outputs
    #: has changed during the last ``after`` seconds.
    follows: tuple[int, ...] = ()
    after: float = 0.0
    #: Output that follows the tip speed: speeds [m/s], shares of the commanded value there [-],
    #: interpolated linearly, and the number of the output that must be on, or -1.
    speeds: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    only_with: int = -1
    ramp: float = inf  #: Acceleration of a simulated spindle, see ``ANGLE`` [rev/s2].

    def fault_of(self, value: float) -> str:
        if not isfinite(value):
            return f'{self.name} cannot be {value}'
        if not self.is_number and value not in (0.0, 1.0):
            return f'{self.name} is on or off, not {value:g}'
        if not self.low <= value <= self.high:
            unit = f' {self.unit}' if self.unit else ''
            return f'{self.name} {value:g} is outside {self.low:g} ... {self.high:g}{unit}'
        return ''


@dataclass(frozen=True)
class Step:
    """One output change of a function, and the condition that is awaited at rest after it."""

    word: str  #: Program word of the function, or one of ``STOPS``.
    output: int  #: Number of the output.
    value: float | str  #: Value of the output; a letter means the value of that word.
    #: Awaited condition: k if condition k - 1 must come on, -k if it must go off, or ``NO_WAIT``,
    #: ``ASK``, ``TIMED``. Conditions are numbered: inputs, ``TURNING``, outputs.
    wait: int = NO_WAIT
    limit: float = inf  #: Longest wait [s].
    delay: float = 0.0  #: Least time until the input is read or the next step follows [s].
    ends: bool = False  #: Whether it ends a line in step with the spindle.
    #: Whether the step can break an interlock; it is then executed at rest.
    guarded: bool = False

    @property
    def rests(self) -> bool:
        return self.wait != NO_WAIT or self.ends or self.guarded


class SpindleSignals(NamedTuple):
    """Numbers of the signals of a spindle; -1 for a missing signal."""

    #: Outputs ``SPEED``, ``FORWARD``, ``REVERSE``. Without ``SPEED`` there is no spindle.
    speed: int = -1
    forward: int = -1
    reverse: int = -1
    angle: int = -1  #: Input ``ANGLE``.
    states: int = -1  #: Output that is the first of ``STATES``.


@dataclass(frozen=True)
class Signals:
    outputs: tuple[Signal, ...] = ()
    inputs: tuple[Signal, ...] = ()
    #: Steps of all functions; the steps of each function are consecutive.
    steps: tuple[Step, ...] = ()
    words: Mapping[str, range] = field(default_factory=dict)  #: Program word -> its steps.
    after: frozenset[str] = frozenset()  #: Words that act after the motion of their block.
    wired: int = 0  #: Number of outputs that the drives receive; ``STATES`` follow them.
    #: Word of ``STOPS`` -> numbers of the outputs that it switches off.
    off: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    #: Number of an output -> conditions required while it is on; k and -k as ``Step.wait``.
    interlocks: Mapping[int, tuple[int, ...]] = field(default_factory=dict)

    @property
    def wires(self) -> tuple[Signal, ...]:
        return self.outputs[: self.wired]

    @property
    def spindle(self) -> SpindleSignals:
        names = [signal.name for signal in self.outputs]
        speed, forward, reverse = (
            names.index(name) if name in names else -1 for name in (SPEED, FORWARD, REVERSE)
        )
        if speed < 0:
            return SpindleSignals()
        return SpindleSignals(speed, forward, reverse, self.input(ANGLE), self.wired)

    @property
    def changed_by_hand(self) -> bool:
        """Whether the operator changes the tool at M6."""
        return bool(self.outputs) and self.outputs[-1].name == TOOL

    def is_change(self, step: Step) -> bool:
        """Return whether ``step`` waits until the operator has changed the tool."""
        return self.changed_by_hand and step.output == len(self.outputs) - 1

    def input(self, name: str) -> int:
        """Return the number of an input; -1 if the machine does not have it."""
        return next((k for k, signal in enumerate(self.inputs) if signal.name == name), -1)

    @property
    def probe(self) -> tuple[int, int] | None:
        """Numbers of output ``ARMED`` and input ``PROBE``; None without a probe."""
        places = [
            [signal.name for signal in signals].index(name)
            for signals, name in ((self.outputs, ARMED), (self.inputs, PROBE))
            if any(signal.name == name for signal in signals)
        ]
        return (places[0], places[1]) if len(places) == 2 else None

    def waited(self, step: Step) -> str:
        if step.wait in (ASK, TIMED):
            return OPERATOR if step.wait == ASK else 'its time'
        return ('not ' if step.wait < 0 else '') + self._conditions[abs(step.wait) - 1]

    @property
    def _conditions(self) -> list[str]:
        return [*(each.name for each in self.inputs), TURNING, *(each.name for each in self.wires)]

    def breach(self, output: int, value: float, conditions: Sequence[float]) -> str:
        """Return a text with the interlock that an output value would break; '' if allowed."""
        first, after = len(self.inputs) + 1, list(conditions)
        after[first + output] = value
        for k, wanted in self.interlocks.items():
            concerned = k == output or first + output + 1 in map(abs, wanted)
            broken = next((c for c in wanted if bool(after[abs(c) - 1]) is not (c > 0)), 0)
            if concerned and broken and after[first + k]:
                told = f'{self._conditions[abs(broken) - 1]} is {"off" if broken > 0 else "on"}'
                name = self.outputs[k].name
                return f'{self.text(output, value)} is refused: {name} must not be on while {told}'
        return ''

    def letters(self, words: Iterable[str]) -> set[str]:
        numbers = (number for word in words for number in self.words.get(word, ()))
        values = (self.steps[number].value for number in numbers)
        return {value for value in values if isinstance(value, str)}

    def uses(self, letter: str) -> bool:
        return letter in self.words or letter in self.letters(self.words)

    def text(self, output: int, value: float) -> str:
        signal = self.outputs[output]
        if not signal.is_number:
            return f'{signal.name} {"on" if value else "off"}'
        return f'{signal.name} {value:g} {signal.unit}'.rstrip()


def signals(
    content: Mapping[str, Any],
    index: Iterable[str] = (),
    switches: Iterable[str] = (),
    squared: Iterable[str] = (),
) -> Signals:
    """Read ``signals`` of a machine file: a mapping, or the name of a file in config/signals.

    Axes with reference ``switches`` get an input for each, even if it is not declared. Axes with
    an ``index`` pulse also get ``index_signals``, and ``squared`` axes get ``square_output``.
    """
    given = content.get('signals')
    if given is None:
        return _with_tool_change(Signals())
    if isinstance(given, str):
        file = Path(config_directory() / 'signals' / f'{given}.yaml')
        try:
            given = read_yaml(file)
        except (OSError, UnreadableError):
            names = ', '.join(sorted(path.stem for path in file.parent.glob('*.yaml')))
            raise MachineError(f'no signals {given!r}; choose {names}', 'signals') from None
    known = 'outputs', 'inputs', 'functions', 'after', 'switched_off', 'interlocks'
    demand(
        isinstance(given, dict) and set(given) <= set(known),
        f'may hold {", ".join(known)}',
        'signals',
    )
    outputs = tuple(_signals(given, 'outputs', ()))
    inputs = tuple(_signals(given, 'inputs', [signal.name for signal in outputs]))
    known_inputs = [signal.name for signal in inputs]
    inputs += tuple(Signal(name) for name in map(home_input, switches) if name not in known_inputs)
    outputs += tuple(Signal(square_output(axis)) for axis in squared)
    for axis in index:
        if home_input(axis) in [signal.name for signal in inputs]:
            asked, waits, offset = index_signals(axis)
            outputs += (Signal(asked),)
            inputs += Signal(waits), Signal(offset, True, low=-1e12, high=1e12)
    steps: list[Step] = []
    words: dict[str, range] = {}
    for word, listed in _mapping(given, 'functions').items():
        where, first = f'signals.functions.{word}', len(steps)
        code = word[1:].isdigit() and word[0] == 'M' and word == f'M{int(word[1:])}'
        others = ('S', 'T', TOWARD, AWAY, *STOPS[:-1])
        demand(
            word not in NO_FUNCTIONS and (code or word in others),
            f'write an M code as M8, or one of {", ".join(others)}',
            where,
        )
        each = listed if isinstance(listed, list) else [listed]
        steps += [_step(word, values, where, outputs, inputs) for values in each]
        words[word] = range(first, len(steps))
        _refuse_old_answers(steps[first:], outputs, inputs, where)
    wired, rules = len(outputs), _interlocks(given, outputs, inputs)
    steps = [replace(step, guarded=_may_break(step, rules, len(inputs) + 1)) for step in steps]
    if SPEED in [signal.name for signal in outputs]:
        outputs += tuple(Signal(name, True, unit, -1e9, 1e9) for name, unit in STATES.items())
        _add_states(outputs, inputs, steps, words)
    outputs = _add_numbered(outputs, inputs, steps, words)
    after = given.get('after', [word for word in AFTER if word in words])
    demand(
        isinstance(after, list) and set(after) <= set(words) - set(STOPS),
        'must list words of functions',
        'signals.after',
    )
    off = _switched_off(given, outputs[:wired])
    found = Signals(outputs, inputs, tuple(steps), words, frozenset(after), wired, off, rules)
    for word, armed in ((TOWARD, 1.0), (AWAY, 2.0)):
        last = steps[words[word][-1]] if words.get(word) else None
        demand(
            not last or (found.probe and (last.output, last.value) == (found.probe[0], armed)),
            f'must end with {ARMED}: {armed:g}, and {PROBE} must be an input',
            f'signals.functions.{word}',
        )
    return _with_tool_change(found)


def _with_tool_change(found: Signals) -> Signals:
    """Add M6, which stops the spindle and waits for the operator, unless M6 is a function."""
    if 'M6' in found.words:
        return found
    stops = [replace(found.steps[k], word='M6') for k in found.words.get('M5', ())]
    change = Step('M6', len(found.outputs), 'T', ASK)
    first = len(found.steps)
    return replace(
        found,
        outputs=(*found.outputs, Signal(TOOL, True, high=MOST_TOOL)),
        steps=(*found.steps, *stops, change),
        words={**found.words, 'M6': range(first, first + len(stops) + 1)},
    )


def _refuse_old_answers(
    steps: list[Step], outputs: tuple[Signal, ...], inputs: tuple[Signal, ...], where: str
) -> None:
    """Reject a function whose awaited input may still be on from an earlier request."""
    for k, step in enumerate(steps):
        begins, ends = (
            any(s.output == step.output and s.wait == -step.wait for s in part)
            for part in (steps[:k], steps[k + 1 :])
        )
        if 0 < step.wait <= len(inputs) and ends and not begins:
            name, answer = outputs[step.output].name, inputs[step.wait - 1].name
            text = f'would accept an old answer of {answer}; begin with'
            raise MachineError(f'{text} {{{name}: 0, wait_for: not {answer}}}', where)


def _switched_off(
    given: Mapping[str, Any], outputs: tuple[Signal, ...]
) -> dict[str, tuple[int, ...]]:
    """Read the table ``switched_off``: word of ``STOPS`` -> outputs that it switches off.

    Numeric outputs without a row keep their value at a stop. Every on/off output needs a row:
    a forgotten row could open a clamp, or let a spindle turn.
    """
    rows = _mapping(given, 'switched_off')
    for name in rows:
        demand(
            name in [signal.name for signal in outputs],
            'must name outputs',
            f'signals.switched_off.{name}',
        )
    found, named = dict[str, tuple[int, ...]](), _mapping(given, 'outputs')
    for k, signal in enumerate(outputs):
        where = f'signals.switched_off.{signal.name}'
        demand(
            signal.name in rows or signal.name not in named or signal.is_number,
            f'is missing: write {ALWAYS}, {NEVER} (as for a clamp), or a list of '
            f'{", ".join(STOPS)}',
            where,
        )
        stops = rows.get(signal.name, NEVER if signal.is_number else ALWAYS)
        if stops in (ALWAYS, NEVER):
            stops = [*STOPS] if stops == ALWAYS else []
        demand(
            isinstance(stops, list) and all(stop in STOPS for stop in stops),
            f'must be {ALWAYS}, {NEVER}, or a list of {", ".join(STOPS)}',
            where,
        )
        if stops and (fault := signal.fault_of(0.0)):
            raise MachineError(fault, where)
        found |= {stop: (*found.get(stop, ()), k) for stop in stops}
    return found


def _interlocks(
    given: Mapping[str, Any], outputs: tuple[Signal, ...], inputs: tuple[Signal, ...]
) -> dict[int, tuple[int, ...]]:
    names = [signal.name for signal in outputs]
    bits = [signal.name for signal in inputs if not signal.is_number]
    turning = [TURNING] if ANGLE in [signal.name for signal in inputs] else []
    known, places = [*bits, *turning, *names], [*(s.name for s in inputs), TURNING, *names]
    found = {}
    for name, listed in _mapping(given, 'interlocks').items():
        where, conditions = f'signals.interlocks.{name}', listed
        demand(name in names, 'must name an output', where)
        conditions = listed if isinstance(listed, list) else [listed]
        plain = [str(each).removeprefix('not ') for each in conditions]
        demand(
            set(plain) <= {*known} - {name},
            f'must list what holds while it is on: {", ".join(known)}, or "not" and a name',
            where,
        )
        numbers = [places.index(each) + 1 for each in plain]
        found[names.index(name)] = tuple(
            number if each == condition else -number
            for number, each, condition in zip(numbers, plain, conditions, strict=True)
        )
    return found


def _may_break(step: Step, interlocks: Mapping[int, tuple[int, ...]], first: int) -> bool:
    """Return whether a step can break an interlock; ``first``: condition of the first output."""
    number, demands = first + step.output + 1, [c for each in interlocks.values() for c in each]
    on, off = step.value != 0.0, step.value == 0.0 or isinstance(step.value, str)
    return (on and (step.output in interlocks or -number in demands)) or (
        off and number in demands
    )


def _add_states(
    outputs: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    steps: list[Step],
    words: dict[str, range],
) -> None:
    names, known = ([signal.name for signal in signals] for signals in (outputs, inputs))
    found = dict(OF_STATES)
    if ANGLE in known and {FORWARD, REVERSE} <= set(names):
        found |= {FOLLOWS: {name: name for name in THREAD}, FREE: {THREAD[3]: 0.0}}
    found['G4'] = {DWELL: DWELL}
    wait = known.index(AT_SPEED) + 1 if AT_SPEED in known else NO_WAIT
    for word, values in found.items():
        if word not in words:
            first = len(steps)
            steps += [Step(word, names.index(name), value) for name, value in values.items()]
            words[word] = range(first, len(steps))
    k = words['G4'][0]
    steps[k] = replace(steps[k], wait=TIMED)
    if FOLLOWS in words:
        k = words[FOLLOWS][-1]
        steps[k] = replace(steps[k], wait=wait, limit=LONGEST_START, ends=True)
        k = words[FREE][0]
        steps[k] = replace(steps[k], ends=True)


def _add_numbered(
    outputs: tuple[Signal, ...],
    inputs: tuple[Signal, ...],
    steps: list[Step],
    words: dict[str, range],
) -> tuple[Signal, ...]:
    """Add words that set outputs like ``digital_out_3``, and words that await inputs (M66)."""

    def add(word: str, *given: Any, **waits: Any) -> None:
        words[word] = range(len(steps), len(steps) + 1)
        steps.append(Step(word, *given, **waits))

    for k, name in enumerate(signal.name for signal in outputs):
        kind, _, number = name.rpartition('_')
        if number.isdigit() and kind == 'digital_out':
            add(f'M64 P{number}', k, 1.0)
            add(f'M65 P{number}', k, 0.0)
        elif number.isdigit() and kind == 'analog_out':
            add(f'M68 E{number}', k, 'Q')
    waits = [(k, each.name.rpartition('_')) for k, each in enumerate(inputs, 1)]
    for k, number in ((k, number) for k, (kind, _, number) in waits if kind == 'digital_in'):
        add(f'M66 P{number} L3', len(outputs), 'Q', wait=k)
        add(f'M66 P{number} L4', len(outputs), 'Q', wait=-k)
    state = Signal(INPUT_WAIT, True, 's', high=1e6)
    return (*outputs, state) if any(word[:3] == 'M66' for word in words) else outputs


def _mapping(given: Mapping[str, Any], section: str) -> dict[str, Any]:
    found = given.get(section) or {}
    demand(
        isinstance(found, dict) and all(isinstance(k, str) and k for k in found),
        'must be a mapping of names',
        f'signals.{section}',
    )
    return found


def _signals(given: Mapping[str, Any], section: str, outputs: Any) -> Iterator[Signal]:
    for name, values in _mapping(given, section).items():
        where, values = f'signals.{section}.{name}', values or {}
        known = {'unit', 'range', 'by_speed'} if section == 'outputs' else {'follows', 'after_s'}
        number = section == 'inputs' and name in NUMBERS
        known = {'ramp_rpm_per_s'} if number else known
        taken = name == OPERATOR or name in STATES
        demand(
            isinstance(values, dict) and set(values) <= known and not taken,
            f'may have {" and ".join(sorted(known))}',
            where,
        )
        follows = values.get('follows', [])
        follows = follows if isinstance(follows, list) else [follows]
        demand(set(follows) <= set(outputs), 'must name outputs', f'{where}.follows')
        low, high = _range(values['range'], where) if 'range' in values else (0.0, 1.0)
        if number:
            ramp = values.get('ramp_rpm_per_s', inf)
            demand(
                ramp is inf or (is_number(ramp) and ramp > 0.0),
                'must be above 0',
                f'{where}.ramp_rpm_per_s',
            )
            yield Signal(name, True, NUMBERS[name], -1e12, 1e12, ramp=ramp / 60.0)
            continue
        yield Signal(
            name,
            'range' in values,
            str(values.get('unit', '')),
            low,
            high,
            tuple(outputs.index(each) for each in follows),
            _time(values, 'after_s', where, 0.0),
            **_by_speed(values, where, list(_mapping(given, section))),
        )


def _by_speed(values: Mapping[str, Any], where: str, outputs: list[str]) -> dict[str, Any]:
    if 'by_speed' not in values:
        return {}
    table, where = values['by_speed'], f'{where}.by_speed'
    demand(
        'range' in values and isinstance(table, dict) and set(table) <= {*BY_SPEED, 'with'},
        f'may hold {", ".join(BY_SPEED)} and with, for an output with a range',
        where,
    )
    speeds, shares = (table.get(key) for key in BY_SPEED)
    lists = all(isinstance(each, list) and all(map(is_number, each)) for each in (speeds, shares))
    demand(
        lists and len(speeds) == len(shares) > 1 and all(0.0 <= share <= 1.0 for share in shares),
        'give as many speeds as shares from 0 to 1, at least two',
        where,
    )
    rises = all(low < high for low, high in pairwise(speeds))
    demand(speeds[0] >= 0.0 and rises, 'must be increasing speeds', f'{where}.{BY_SPEED[0]}')
    only = table.get('with')
    demand(only is None or only in outputs, 'must name an output', f'{where}.with')
    return {
        'speeds': tuple(speed * MM / MINUTE for speed in speeds),
        'shares': tuple(map(float, shares)),
        'only_with': -1 if only is None else outputs.index(only),
    }


def _range(given: Any, where: str) -> tuple[float, float]:
    two = isinstance(given, list) and len(given) == 2 and all(map(is_number, given))
    demand(two and given[0] < given[1], 'must be [lowest, highest]', f'{where}.range')
    return float(given[0]), float(given[1])


def _time(values: Mapping[str, Any], key: str, where: str, default: float) -> float:
    value = values.get(key, default)
    demand(
        value is default or (is_number(value) and 0.0 < value <= 3600.0),
        f'must be a time in s, not {value!r}',
        f'{where}.{key}',
    )
    return float(value)


def _step(
    word: str, values: Any, where: str, outputs: tuple[Signal, ...], inputs: tuple[Signal, ...]
) -> Step:
    options = ('wait_for', 'limit_s', 'delay_s')
    names = [key for key in values if key not in options] if isinstance(values, dict) else []
    known = [signal.name for signal in outputs]
    demand(
        len(names) == 1 and names[0] in known,
        f'each step sets one output: {", ".join(known)}',
        where,
    )
    output, value = known.index(names[0]), values[names[0]]
    value = int(value) if isinstance(value, bool) else value
    if value not in LETTERS or word in STOPS:
        demand(is_number(value), f'write a number, or {", ".join(LETTERS)}', f'{where}.{names[0]}')
        value = float(value)
        if fault := outputs[output].fault_of(value):
            raise MachineError(fault, f'{where}.{names[0]}')
    return Step(word, output, value, *_wait(word, values, where, inputs))


def _wait(
    word: str, values: Mapping[str, Any], where: str, inputs: tuple[Signal, ...]
) -> tuple[int, float, float]:
    delay, limit = _time(values, 'delay_s', where, 0.0), _time(values, 'limit_s', where, inf)
    wanted = values.get('wait_for')
    if wanted is None:
        demand('limit_s' not in values, 'belongs to wait_for', f'{where}.limit_s')
        return NO_WAIT, limit, delay
    demand(word not in STOPS, 'a stop cannot wait; write delay_s', f'{where}.wait_for')
    if wanted == OPERATOR:
        return ASK, limit, delay
    names = [signal.name for signal in inputs]
    names += [TURNING] if ANGLE in names else []
    name = str(wanted).removeprefix('not ')
    demand(
        name in names,
        f'must name an input: {", ".join(names)}; or {OPERATOR}',
        f'{where}.wait_for',
    )
    number = names.index(name) + 1
    return (number if name == wanted else -number), limit, delay
