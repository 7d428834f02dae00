"""A HAL file for this machine, made of the HAL files of a LinuxCNC configuration."""

import math
import re
from collections.abc import Sequence

from cnc_interp.core import InterpError
from cnc_interp.machine_model.signals import LOST_MACHINE, Signals, home_input, index_signals

NO_SIGNALS = Signals()
STREAMER, SAMPLER = 'streamer.0', 'sampler.0'
MOST = 21  #: Columns of a stream of HAL.
BITS = 16  #: In a column: as many as ``weighted_sum`` of HAL adds up.
#: Modules of the motion controller, by name or as the INI file names them.
MOTION = re.compile(r'motmod|tpmod|homemod|\w+kins|\[(KINS|EMCMOT|TRAJ)\].*')
#: Pins of programs that do not run beside cnc_interp.
ABSENT = re.compile(r'(joint|axis|axisui|halui|iocontrol|motion|spindle)\.\S+')
ENABLE = re.compile(r'joint\.\d+\.amp-enable-out')  #: What asks for the power of a joint.
#: The input that tells that the emergency stop is released, and what is looped to it without one.
RELEASED, LOOP = 'iocontrol.0.emc-enable-in', 'iocontrol.0.user-enable-out'
#: Signals that take the place of those of each joint, and of the emergency stop.
POWER, STOP = 'cnc-power', 'cnc-released'

#: Pins of LinuxCNC whose signals outputs and inputs of these names take over.
PINS = {
    'spindle_speed': 'spindle.0.speed-out-abs',
    'spindle_forward': 'spindle.0.forward',
    'spindle_reverse': 'spindle.0.reverse',
    'spindle_at_speed': 'spindle.0.at-speed',
    'spindle_angle': 'spindle.0.revs',
    'coolant_flood': 'iocontrol.0.coolant-flood',
    'coolant_mist': 'iocontrol.0.coolant-mist',
    'tool_change': 'iocontrol.0.tool-change',
    'tool_changed': 'iocontrol.0.tool-changed',
    'probe': 'motion.probe-input',
}

LOADED = """loadrt threads {threads}
loadrt streamer depth=1000 cfg={columns[0]}
loadrt sampler depth=4000 cfg={columns[1]}
loadrt bitslice names={slices} personality={sizes}
loadrt weighted_sum wsum_sizes={sums}"""
#: What else is loaded, by module; HAL loads each module once.
NAMES = {
    'timedelay': ['stream-late'],
    'not': ['power-unwanted'],
    'and2': ['drive-tripped'],
    'or2': ['power-lost', 'power-off'],
    'estop_latch': ['power-given'],
}
#: Functions that take the place of those of the motion controller, with those of ``INDEXED``.
HANDLER, CONTROLLER = 'motion-command-handler', 'motion-controller'
LAST = 'drive-tripped', 'power-lost', 'power-off', 'power-given'
MODULES = {
    'edge': ('found', 'asks'),
    'tristate_bit': ('ask',),
    'sum2': ('jump',),
    'mux2': ('off',),
    'offset': ('index',),
}
IN_ORDER = 'found', 'jump', 'off', 'index.update-feedback', 'index.update-output', 'asks', 'ask'
#: At its index pulse an encoder counts anew from 0. So ``index`` takes the jump off its position,
#: and adds it to the command, in that period: the machine sees a position that goes on.
INDEXED = """
setp {x}-asks.in-edge 0
setp {x}-ask.in 1
setp {x}-jump.gain1 -1
net cnc-{x}-asked {asked} => {x}-asks.in
net cnc-{x}-ask {x}-asks.out => {x}-ask.enable
net cnc-{x}-found {x}-found.out => {x}-off.sel
net cnc-{x}-jump {x}-jump.out => {x}-off.in1
net cnc-{x}-off {x}-off.out => {x}-off.in0 {x}-index.offset {offset}
net cnc-{x}-cmd {command} => {x}-index.in
net cnc-{x}-fb {x}-index.fb-out => {x}-jump.in1 {position}"""


def columns_of(n: int, signals: Signals) -> tuple[str, str]:
    """Return the columns of ``streamer`` and ``sampler`` for n axes, as their cfg names them.

    InterpError where HAL has fewer.
    """
    found = []
    for what, declared, bits, letter in (
        ('streamer', signals.wires, 1, 'u'),
        ('sampler', signals.inputs, n + 2, 's'),
    ):
        numbers = sum(signal.is_number for signal in declared)
        packed = math.ceil((bits + len(declared) - numbers) / BITS)
        found.append('f' * (2 * n + numbers) + letter * packed)
        if len(found[-1]) > MOST:
            raise InterpError(
                f"{what} of LinuxCNC's HAL has at most {MOST} columns, this machine needs "
                f'{len(found[-1])}: name fewer signals in its file'
            )
    return found[0], found[1]


def sent(bit: int) -> str:
    """Return the pin of a bit of ``streamer``: power, then those of ``signals``."""
    return f'bits-{bit // BITS}.out-{bit % BITS:02d}'


def seen(bit: int) -> str:
    """Return the pin of a bit of ``sampler``: faults, power, empty, then those of ``signals``."""
    return f'wsum.{bit // BITS}.bit.{bit % BITS}.in'


def pins_of(n: int, signals: Signals) -> tuple[dict[str, str], dict[str, str]]:
    """Return the pins of outputs and inputs by name.

    Numbers have columns after the velocities. What the end of the machine node switches off comes
    through a gate.
    """
    outputs, inputs = raw_pins_of(n, signals)
    return outputs | {name: f'{gate}.out' for name, gate, _ in gates(signals)}, inputs


def gates(signals: Signals) -> list[tuple[str, str, str]]:
    """Return name, gate and module of each output that is off while the axes have no power."""
    return [
        (signal.name, f'on-{signal.name}', 'mux2' if signal.is_number else 'and2')
        for signal in (signals.outputs[k] for k in signals.off.get(LOST_MACHINE, ()))
    ]


def gate_lines(n: int, signals: Signals) -> list[str]:
    raw, lines = raw_pins_of(n, signals)[0], []
    for name, gate, module in gates(signals):
        value, power = ('in1', 'sel') if module == 'mux2' else ('in0', 'in1')
        lines += [f'net cnc-{gate} {raw[name]} => {gate}.{value}']
        lines += [f'net {POWER} => {gate}.{power}']
    return lines


def raw_pins_of(n: int, signals: Signals) -> tuple[dict[str, str], dict[str, str]]:
    """Return the pins as ``pins_of``, but before the gates."""
    outputs, inputs = dict[str, str](), dict[str, str]()
    for pins, declared, name, bit, pin in (
        (outputs, signals.wires, STREAMER, 1, sent),
        (inputs, signals.inputs, SAMPLER, n + 2, seen),
    ):
        number = 2 * n
        for signal in declared:
            pins[signal.name] = f'{name}.pin.{number}' if signal.is_number else pin(bit)
            number, bit = number + signal.is_number, bit + (not signal.is_number)
    return outputs, inputs


POWERED = """
# Power: cnc_interp asks for it. The emergency stop, a fault of an amplifier and a stream that
# stays empty take it away, until cnc_interp asks anew. Outputs with a gate are off without it.
net cnc-enable {wanted} => power-unwanted.in power-given.reset
net cnc-unwanted power-unwanted.out => power-off.in0
net cnc-empty streamer.0.empty => {empty} stream-late.in
setp stream-late.on-delay 0.1
setp stream-late.off-delay 0
net cnc-late stream-late.out => power-lost.in0
net cnc-fault {fault} => drive-tripped.in0
net cnc-tripped drive-tripped.out => power-lost.in1
net cnc-lost power-lost.out => power-off.in1
net cnc-off power-off.out => power-given.fault-in
net cnc-power power-given.ok-out => {power} drive-tripped.in1
{stop}

start"""


def hal_file(
    text: str, axes: Sequence[str], joints: str, signals: Signals = NO_SIGNALS
) -> tuple[str, list[str]]:
    """Put cnc_interp in the place of LinuxCNC's motion controller, in the text of all HAL files.

    ``joints``: letter of the axis of each joint, as ``XYZ``. Returns the new file, and the lines
    that connect what is not there any more. Raises InterpError where an axis would not move.
    """
    if sorted(joints) != sorted(axes):
        raise InterpError(
            f'--joints {joints}: name each axis of the machine once, in the order of the joints '
            f'of LinuxCNC (axes: {" ".join(axes)}); an axis with two motors cannot be converted'
        )
    place, needed = _places(axes, joints, signals), {HANDLER, CONTROLLER}
    faults = [f'fault-{k}' for k in range(len(axes))]
    columns, indexed = columns_of(len(axes), signals), _indexed(axes, signals)
    functions = {
        HANDLER: [
            STREAMER,
            *(f'bits-{k}' for k in range(columns[0].count('u'))),
            *('stream-late', 'power-unwanted', *faults, *LAST),
            *(gate for _, gate, _ in gates(signals)),
        ],
        CONTROLLER: ['process_wsums', SAMPLER],
    }
    functions[HANDLER] += [f'{x}-{name}' for x in indexed for name in IN_ORDER]
    needed |= {pin for pin in place if 'motor-pos' in pin}
    commented = [line.partition('#') for line in text.replace('\\\n', ' ').splitlines()]
    rows = [(line + mark + note, line.split()) for line, mark, note in commented]
    nets: dict[str, set[str]] = {}
    for _, words in rows:
        if words[:1] == ['net']:
            nets.setdefault(' '.join(words[1:2]), set()).update(_pins(words))
    renamed = {name: new for name, pins in nets.items() if (new := _new_name(pins))}
    made, left_out = [], []
    names = {module: list(each) for module, each in NAMES.items()}
    names['or2'] += faults
    for _, gate, module in gates(signals):
        names.setdefault(module, []).append(gate)
    for module, each in MODULES.items() if indexed else ():
        names.setdefault(module, []).extend(f'{x}-{name}' for x in indexed for name in each)
    given = {words[1] for _, words in rows if words[:1] == ['loadrt'] and len(words) > 1}
    for line, words in rows:
        needed -= set(words)
        if words[:1] == ['loadrt'] and MOTION.fullmatch(' '.join(words[1:2])):
            made += _loaded(words, columns, {k: names[k] for k in names if k not in given})
        elif words[:1] == ['loadrt'] and ' '.join(words[1:2]) in names:
            made.append(_loads(words[1], [*_instances(words), *names[words[1]]]))
        elif words[:1] == ['addf'] and ' '.join(words[1:2]) in functions:
            made += [' '.join(['addf', name, *words[2:3]]) for name in functions[words[1]]]
        elif words[:1] == ['net']:
            pins = [place.get(pin, pin) for pin in _pins(words)]
            kept = [pin for pin in pins if not ABSENT.fullmatch(pin)]
            expected = {RELEASED} if kept else {RELEASED, LOOP}
            lost = {pin for pin in pins if not ENABLE.fullmatch(pin)} - {*kept, *expected}
            left_out += [line.strip()] if lost else []
            made.append(
                ' '.join(['net', renamed.get(words[1], words[1]), *kept]) if kept else f'# {line}'
            )
        elif any(map(ABSENT.fullmatch, words)):
            made.append(f'# {line}')
            left_out.append(line.strip())
        else:
            made.append(line)
    if needed:
        raise InterpError(f'no HAL file names {min(needed)}; give all files of the configuration')
    n, stop = len(axes), f'net {STOP} => power-given.ok-in'
    if STOP not in renamed.values():
        left_out.append('there is no contact by which the emergency stop takes the power away')
        stop = 'setp power-given.ok-in 1'
    outputs, inputs = pins_of(n, signals)
    for k, x in enumerate(name.lower() for name in axes):
        if x in indexed:
            asked, _, offset = index_signals(x)
            made.append(
                INDEXED.format(
                    x=x,
                    asked=outputs[asked],
                    offset=inputs[offset],
                    command=f'{STREAMER}.pin.{k} {SAMPLER}.pin.{k}',
                    position=f'{SAMPLER}.pin.{n + k}',
                )
            )
    sends, sees = columns[0].index('u'), columns[1].index('s')
    made += [
        f'net cnc-sent-{k} {STREAMER}.pin.{sends + k} => bits-{k}.in'
        for k in range(len(columns[0]) - sends)
    ]
    made += [
        f'net cnc-seen-{k} wsum.{k}.sum => {SAMPLER}.pin.{sees + k}'
        for k in range(len(columns[1]) - sees)
    ]
    made += [f'net cnc-fault-{k} {faults[k]}.out => {faults[k + 1]}.in0' for k in range(n - 1)]
    made += gate_lines(n, signals)
    places = {'power': seen(n), 'empty': seen(n + 1), 'fault': f'{faults[-1]}.out'}
    made.append(POWERED.format(wanted=sent(0), stop=stop, **places))
    return '\n'.join(made) + '\n', left_out


def _indexed(axes: Sequence[str], signals: Signals) -> list[str]:
    outputs = {signal.name for signal in signals.wires}
    return [name.lower() for name in axes if index_signals(name)[0] in outputs]


def _places(axes: Sequence[str], joints: str, signals: Signals) -> dict[str, str]:
    n, (outputs, inputs) = len(axes), pins_of(len(axes), signals)
    pins = outputs | inputs
    found = {pin: pins[name] for name, pin in PINS.items() if name in pins}
    for joint, letter in enumerate(joints):
        i, x, of = axes.index(letter), letter.lower(), f'joint.{joint}.'
        found |= {
            f'{of}motor-pos-cmd': f'{STREAMER}.pin.{i} {SAMPLER}.pin.{i}',
            f'{of}vel-cmd': f'{STREAMER}.pin.{n + i}',
            f'{of}motor-pos-fb': f'{SAMPLER}.pin.{n + i}',
            f'{of}amp-fault-in': f'{seen(i)} fault-{i}.in1',
        }
        if home_input(letter) in inputs:
            found[f'{of}home-sw-in'] = inputs[home_input(letter)]
        if x in _indexed(axes, signals):
            waits = inputs[index_signals(letter)[1]]
            found |= {
                f'{of}motor-pos-cmd': f'{x}-index.out',
                f'{of}motor-pos-fb': f'{x}-index.fb-in {x}-jump.in0',
                f'{of}index-enable': f'{x}-ask.out {x}-found.in {waits}',
            }
    return found


def _pins(words: Sequence[str]) -> list[str]:
    return [word for word in words[2:] if '=' not in word]


def _new_name(pins: set[str]) -> str:
    """Return the new name of a signal; empty where it keeps its own."""
    if any(map(ENABLE.fullmatch, pins)):
        return POWER
    return STOP if RELEASED in pins and pins - {RELEASED, LOOP} else ''


def _loaded(
    words: Sequence[str], columns: tuple[str, str], names: dict[str, list[str]]
) -> list[str]:
    """Return what is loaded in the place of a module: its threads are those of ``motmod``."""
    given = dict(word.split('=', 1) for word in words if '=' in word)
    if 'servo_period_nsec' not in given:
        return []
    periods = {'servo-thread': given['servo_period_nsec']}
    if given.get('base_period_nsec', '0') != '0':
        periods = {'base-thread': given['base_period_nsec']} | periods
    threads = ' '.join(
        f'name{k}={name} period{k}={x}' for k, (name, x) in enumerate(periods.items(), 1)
    )
    packed = columns[0].count('u'), columns[1].count('s')
    slices = ','.join(f'bits-{k}' for k in range(packed[0]))
    sizes, sums = (','.join([str(BITS)] * count) for count in packed)
    text = LOADED.format(threads=threads, columns=columns, slices=slices, sizes=sizes, sums=sums)
    return [text, *(_loads(*each) for each in names.items())]


def _loads(module: str, names: Sequence[str]) -> str:
    return f'loadrt {module} names={",".join(names)}'


def _instances(words: Sequence[str]) -> list[str]:
    """Return the names that a line of ``loadrt`` gives: without names they are numbered."""
    given = dict(word.split('=', 1) for word in words if '=' in word)
    numbered = [f'{words[1].replace("_", "-")}.{k}' for k in range(int(given.get('count', '1')))]
    return given['names'].split(',') if 'names' in given else numbered
