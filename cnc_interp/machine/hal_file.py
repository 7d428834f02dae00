"""A HAL file for this machine, made of the HAL files of a LinuxCNC configuration."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cnc_interp.core.errors import InterpError
from cnc_interp.machine_model.signals import Signals, home_input

NO_SIGNALS = Signals()
MOST = 21  #: Columns of a stream of HAL.
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
    'spindle_speed': 'spindle.0.speed-out-abs', 'spindle_forward': 'spindle.0.forward',
    'spindle_reverse': 'spindle.0.reverse', 'spindle_at_speed': 'spindle.0.at-speed',
    'spindle_angle': 'spindle.0.revs',
    'coolant_flood': 'iocontrol.0.coolant-flood', 'coolant_mist': 'iocontrol.0.coolant-mist',
    'tool_change': 'iocontrol.0.tool-change', 'tool_changed': 'iocontrol.0.tool-changed',
    'probe': 'motion.probe-input',
}  # fmt: skip

LOADED = """loadrt threads {threads}
loadrt streamer depth=1000 cfg={stream}
loadrt sampler depth=4000 cfg={samples}
loadrt not names=stream-alive
loadrt and2 names=power-wanted,power-given
loadrt timedelay names=stream-late"""


def columns_of(n: int, signals: Signals) -> tuple[str, str]:
    """Return the columns of ``streamer`` and ``sampler`` for n axes, as their cfg names them.

    InterpError where HAL has fewer.
    """
    outputs, inputs = (
        ''.join('f' if signal.is_number else 'b' for signal in declared)
        for declared in (signals.wires, signals.inputs)
    )
    stream, samples = 'f' * 2 * n + 'b' + outputs, 'f' * 2 * n + 'b' * (n + 2) + inputs
    for what, columns in (('streamer', stream), ('sampler', samples)):
        if len(columns) > MOST:
            raise InterpError(
                f"{what} of LinuxCNC's HAL has at most {MOST} columns, this machine needs "
                f'{len(columns)}: name fewer signals in its file'
            )
    return stream, samples


#: Functions that take the place of those of the motion controller.
REPLACED = {
    'motion-command-handler': (
        'streamer.0', 'stream-late', 'stream-alive', 'power-wanted', 'power-given',
    ),
    'motion-controller': ('sampler.0',),
}  # fmt: skip
POWERED = """
# Power: cnc_interp asks for it; the emergency stop and a stream that stays empty take it away.
net cnc-enable streamer.0.pin.{wanted} => power-wanted.in0
net cnc-empty streamer.0.empty => sampler.0.pin.{empty} stream-late.in
setp stream-late.on-delay 0.1
setp stream-late.off-delay 0
net cnc-late stream-late.out => stream-alive.in
net cnc-alive stream-alive.out => power-wanted.in1
net cnc-wanted power-wanted.out => power-given.in0
net cnc-power power-given.out => sampler.0.pin.{power}
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
    place, needed = _places(axes, joints, signals), {'motion-command-handler', 'motion-controller'}
    needed |= {pin for pin in place if 'motor-pos' in pin}
    commented = [line.partition('#') for line in text.replace('\\\n', ' ').splitlines()]
    rows = [(line + mark + note, line.split()) for line, mark, note in commented]
    nets: dict[str, set[str]] = {}
    for _, words in rows:
        if words[:1] == ['net']:
            nets.setdefault(' '.join(words[1:2]), set()).update(_pins(words))
    renamed = {name: new for name, pins in nets.items() if (new := _new_name(pins))}
    made, left_out = [], []
    for line, words in rows:
        needed -= set(words)
        if words[:1] == ['loadrt'] and MOTION.fullmatch(' '.join(words[1:2])):
            made += _loaded(words, columns_of(len(axes), signals))
        elif words[:1] == ['addf'] and ' '.join(words[1:2]) in REPLACED:
            made += [' '.join(['addf', name, *words[2:3]]) for name in REPLACED[words[1]]]
        elif words[:1] == ['net']:
            pins = [place.get(pin, pin) for pin in _pins(words)]
            kept = [pin for pin in pins if not ABSENT.fullmatch(pin)]
            expected = {RELEASED} if kept else {RELEASED, LOOP}
            lost = {pin for pin in pins if not ENABLE.fullmatch(pin)} - {*kept, *expected}
            left_out += [line.strip()] if lost else []
            made.append(' '.join(['net', renamed.get(words[1], words[1]), *kept]) if kept else
                        f'# {line}')  # fmt: skip
        elif any(map(ABSENT.fullmatch, words)):
            made.append(f'# {line}')
            left_out.append(line.strip())
        else:
            made.append(line)
    if needed:
        raise InterpError(f'no HAL file names {min(needed)}; give all files of the configuration')
    n, stop = len(axes), f'net {STOP} => power-given.in1'
    if STOP not in renamed.values():
        left_out.append('there is no contact by which the emergency stop takes the power away')
        stop = 'setp power-given.in1 1'
    made.append(POWERED.format(wanted=2 * n, power=3 * n, empty=3 * n + 1, stop=stop))
    return '\n'.join(made) + '\n', left_out


def _places(axes: Sequence[str], joints: str, signals: Signals) -> dict[str, str]:
    found: dict[str, str] = {}
    ways = (('streamer.0', 2 * len(axes) + 1, signals.wires),
            ('sampler.0', 3 * len(axes) + 2, signals.inputs))  # fmt: skip
    for name, first, declared in ways:
        for k, signal in enumerate(declared):
            if signal.name in PINS:
                found[PINS[signal.name]] = f'{name}.pin.{first + k}'
    for joint, letter in enumerate(joints):
        i, n = axes.index(letter), len(axes)
        found |= {
            f'joint.{joint}.motor-pos-cmd': f'streamer.0.pin.{i} sampler.0.pin.{i}',
            f'joint.{joint}.vel-cmd': f'streamer.0.pin.{n + i}',
            f'joint.{joint}.motor-pos-fb': f'sampler.0.pin.{n + i}',
            f'joint.{joint}.amp-fault-in': f'sampler.0.pin.{2 * n + i}',
        } | {
            f'joint.{joint}.home-sw-in': f'sampler.0.pin.{3 * n + 2 + k}'
            for k, signal in enumerate(signals.inputs) if signal.name == home_input(letter)
        }  # fmt: skip
    return found


def _pins(words: Sequence[str]) -> list[str]:
    return [word for word in words[2:] if '=' not in word]


def _new_name(pins: set[str]) -> str:
    """Return the new name of a signal; empty where it keeps its own."""
    if any(map(ENABLE.fullmatch, pins)):
        return POWER
    return STOP if RELEASED in pins and pins - {RELEASED, LOOP} else ''


def _loaded(words: Sequence[str], columns: tuple[str, str]) -> list[str]:
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
    return [LOADED.format(threads=threads, stream=columns[0], samples=columns[1])]
