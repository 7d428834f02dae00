"""Make a HAL file in which cnc_interp replaces LinuxCNC's motion controller."""

import re
from collections.abc import Sequence

from cnc_interp.convert.hal_board import Inputs, Loads, Row, connected, rows_of
from cnc_interp.convert.linuxcnc_wiring import PINS, Wiring
from cnc_interp.core import InterpError
from cnc_interp.machine.hal_pins import (
    NO_SIGNALS,
    POWER,
    SAMPLER,
    STREAMER,
    columns_of,
    gates,
    pins_of,
    raw_pins_of,
    seen,
    sent,
)
from cnc_interp.machine_model.signals import (
    COUNTS,
    STEP,
    Signals,
    handwheel_input,
    home_input,
    index_signals,
    limit_inputs,
    square_output,
)

#: Modules of the motion controller, by name or as the INI file names them.
MOTION = re.compile(r'motmod|tpmod|homemod|[\w-]+kins|\[(KINS|EMCMOT|TRAJ)\].*')
THREADS = re.compile(r'motmod|\[EMCMOT\]\(?EMCMOT\)?')  #: Module that makes the threads.
#: Pins of LinuxCNC programs that do not run together with cnc_interp.
ABSENT = re.compile(r'(joint|axis|axisui|halui|iocontrol|motion|spindle|tp|ini|[\w-]+kins)\.\S+')
#: Pins that request the power of a joint.
ENABLE = re.compile(r'joint\.\d+\.amp-enable-out|motion\.motion-enabled|halui\.machine\.is-on')
#: Input that is on if the emergency stop is released, pin that requests this, and the reset.
RELEASED, LOOP = 'iocontrol.0.emc-enable-in', 'iocontrol.0.user-enable-out'
RESET = 'iocontrol.0.user-request-enable'
STOP = 'cnc-released'  #: Signal that replaces that of the emergency stop.
OURS = 'cnc.'  #: Pins that begin with this are outputs and inputs of the machine file, by name.
NUMBER = 'iocontrol.0.tool-prep-number'  #: Number of the tool, an integer pin in LinuxCNC.
SPINDLE_FAULT = 'spindle.0.amp-fault-in'
#: Functions that replace those of the motion controller.
HANDLER, CONTROLLER = 'motion-command-handler', 'motion-controller'
FEEDBACK = 'process_wsums', SAMPLER
RESET_DELAY, POWER_DELAY = (
    0.05,
    0.1,
)  #: Delays from the power request to the reset, and to the power [s].


ERROR, SLOW = 1.0, 1.0  #: Usual largest following error, and velocity of a motor alone [mm, mm/s].


def hal_file(
    text: str, axes: Sequence[str], wiring: Wiring, signals: Signals = NO_SIGNALS
) -> tuple[str, list[str]]:
    """Replace LinuxCNC's motion controller by cnc_interp in the text of all HAL files.

    Returns the new file, and the lines that connect pins that no longer exist. Raises InterpError
    if an axis would not move.
    """
    moving = [axis for axis in axes if axis not in wiring.locked]
    if set(wiring.joints) != set(moving) or max(map(wiring.joints.count, moving)) > 2:
        raise InterpError(
            f'--joints {wiring.joints}: name each axis of the machine once, or twice if it has '
            f'two motors, in the order of the joints of LinuxCNC (axes: {" ".join(moving)})'
        )
    rows = rows_of(text)
    final = connected(rows)
    made = _Conversion(axes, wiring, signals, rows, final)
    for k in range(len(rows)):
        made.take(k)
    return made.finished()


class _Conversion:
    def __init__(
        self,
        axes: Sequence[str],
        wiring: Wiring,
        signals: Signals,
        rows: list[Row],
        final: dict[str, int],
    ):
        self.rows, self.final, self.wiring, self.n = rows, final, wiring, len(axes)
        self.loads, self.columns = Loads(rows, wiring.resolve), columns_of(len(axes), signals)
        self.board = self.loads.board
        self.pins: dict[str, set[str]] = {}  #: Pins of each signal.
        for pin, k in final.items():
            self.pins.setdefault(rows[k].words[1], set()).add(pin)
        self.stop = next(
            (
                name
                for name, pins in self.pins.items()
                if RELEASED in pins and pins - {RELEASED, LOOP} and LOOP not in pins
            ),
            '',
        )
        self.made: list[str] = []
        self.left_out: list[str] = []
        self.signals: set[str] = set()  #: Signals found so far.
        self.placed: set[str] = set()  #: Our pins in lines of the configuration.
        self.needed = {HANDLER, CONTROLLER}
        self._wire(axes, signals)
        self.loads.merge()
        self.threads: dict[str, str] = {}

    def _wire(self, axes: Sequence[str], signals: Signals) -> None:
        """Add the instances of cnc_interp, and note which of their pins replace LinuxCNC's."""
        board, n = self.board, self.n
        outputs, inputs = pins_of(n, signals)
        board.functions.append(STREAMER)
        for k in range(self.columns[0].count('u')):
            board.add('bitslice', f'bits-{k}')
            board.connect(f'{STREAMER}.pin.{self.columns[0].index("u") + k}', f'bits-{k}.in')
        for k in range(self.columns[1].count('s')):
            board.connect(f'wsum.{k}.sum', f'{SAMPLER}.pin.{self.columns[1].index("s") + k}')
        self.place = {
            pin: (outputs | inputs)[name] for name, pin in PINS.items() if name in outputs | inputs
        }
        faults = [f'fault-{k}' for k in range(n)]
        self._power(faults, signals)
        for i, letter in enumerate(axes):
            joints = [k for k, each in enumerate(self.wiring.joints) if each == letter]
            self._axis(i, letter, joints, outputs, inputs)
        self._spindle(outputs)
        self._handwheel(axes, inputs)
        self.place |= {f'{OURS}{name}': pin for name, pin in (outputs | inputs).items()}
        self.place = {pin: board.pin(ours) for pin, ours in self.place.items()}
        self.ours = {each for pins in self.place.values() for each in pins.split()}

    def _power(self, faults: list[str], signals: Signals) -> None:
        """Connect the power output: on if requested, no fault, stream not empty, E-stop released.

        Without power, gated outputs are off until cnc_interp requests power again.
        """
        board, n, wanted = self.board, self.n, sent(0)
        board.connect(wanted, name='cnc-enable')
        board.connect(f'{STREAMER}.empty', seen(n + 1), name='cnc-empty')
        late = board.add(
            'timedelay',
            'stream-late',
            {'in': f'{STREAMER}.empty', 'on-delay': 0.1, 'off-delay': 0},
        )
        unwanted = board.add('not', 'power-unwanted', {'in': wanted})
        if SPINDLE_FAULT in self.final:
            faults.append('fault-spindle')
            self.place[SPINDLE_FAULT] = 'fault-spindle.in1'
        before: Inputs = {}
        for fault in faults:
            before = {'in0': board.add('or2', fault, before)}
        tripped = board.add('and2', 'drive-tripped', before)
        lost = board.add('or2', 'power-lost', {'in0': late, 'in1': tripped})
        off = board.add('or2', 'power-off', {'in0': unwanted, 'in1': lost})
        asked = wanted
        if self.stop and {LOOP, RESET} & set(self.final):
            # The chain of the emergency stop closes first; then the power is given.
            delay: Inputs = {'in': wanted, 'off-delay': 0}
            asked = board.add('timedelay', 'power-asked', delay | {'on-delay': POWER_DELAY})
            if RESET in self.final:
                delay |= {'on-delay': RESET_DELAY}
                self.place[RESET] = board.add('timedelay', 'estop-asked', delay)
                board.connect(self.place[RESET])
        self.place[LOOP] = wanted
        board.add('estop_latch', 'power-given', {'reset': asked, 'fault-in': off})
        readers = seen(n), 'drive-tripped.in1'
        board.connect('power-given.ok-out', *readers, name=POWER)
        raw = raw_pins_of(n, signals)[0]
        for name, gate, module in gates(signals):
            value, power = ('in1', 'sel') if module == 'mux2' else ('in0', 'in1')
            board.add(module, gate, {value: raw[name], power: 'power-given.ok-out'})

    def _axis(
        self,
        i: int,
        letter: str,
        joints: list[int],
        outputs: dict[str, str],
        inputs: dict[str, str],
    ) -> None:
        board, n, x, place = self.board, self.n, letter.lower(), self.place
        command, velocity = f'{STREAMER}.pin.{i}', f'{STREAMER}.pin.{n + i}'
        actual = f'{SAMPLER}.pin.{n + i}'
        board.connect(command, f'{SAMPLER}.pin.{i}', name=f'cnc-{x}-cmd')
        if not joints:
            board.connect(command, actual)
            return
        unit, back = self.wiring.units.get(letter, 1.0), ''
        if unit != 1.0:
            command = board.add('scale', f'{x}-to-hal', {'in': command, 'gain': 1.0 / unit})
            if any(f'joint.{k}.vel-cmd' in self.final for k in joints):
                gain: Inputs = {'in': velocity, 'gain': 1.0 / unit}
                velocity = board.add('scale', f'{x}-speed-to-hal', gain)
            back, actual = actual, f'{x}-from-hal.in'
        index = outputs.get(index_signals(letter)[0])
        if index:
            place[f'joint.{joints[0]}.index-enable'] = (
                f'{x}-ask.out {x}-found.in {inputs[index_signals(letter)[1]]}'
            )
            offset = inputs[index_signals(letter)[2]]
            command, actual = self._index(x, index, command, actual, offset, unit)
        home = home_input(letter)
        if len(joints) == 2:
            square = outputs.get(square_output(letter), '')
            self._gantry(x, i, joints, command, actual, square, inputs.get(home, ''))
        else:
            board.connect(command)
            of = f'joint.{joints[0]}.'
            place |= {
                f'{of}motor-pos-cmd': command,
                f'{of}motor-pos-fb': actual,
                f'{of}amp-fault-in': f'{seen(i)} fault-{i}.in1',
            }
            if home in inputs:
                place[f'{of}home-sw-in'] = inputs[home]
        place |= {f'joint.{k}.vel-cmd': velocity for k in joints}
        for limit, way in zip(limit_inputs(letter), ('neg', 'pos'), strict=True):
            self._limit(limit, [f'joint.{k}.{way}-lim-sw-in' for k in joints], inputs)
        self.needed |= {f'joint.{k}.motor-pos-{way}' for k in joints for way in ('cmd', 'fb')}
        if back:
            board.connect(board.add('scale', f'{x}-from-hal', {'gain': unit}), back)

    def _limit(self, name: str, pins: list[str], inputs: dict[str, str]) -> None:
        """Connect the limit switches of all motors of an axis at one end of its travel."""
        given = [pin for pin in pins if pin in self.final]
        if name not in inputs or not given:
            return
        self.place[given[0]] = inputs[name]
        if len(given) == 2:
            self.place |= {pin: f'{name}.in{k}' for k, pin in enumerate(given)}
            self.board.connect(self.board.add('or2', name), inputs[name])

    def _index(
        self, x: str, asked: str, command: str, actual: str, offset: str, unit: float
    ) -> tuple[str, str]:
        """Zero an axis at its index pulse; return the pins of its command and actual position.

        At its index pulse an encoder restarts at 0. In that period ``index`` removes the jump from
        the position and adds it to the command, so that the machine sees a continuous position.
        """
        board = self.board
        off = f'{x}-off.out'
        board.add('edge', f'{x}-found')
        jump = board.add('sum2', f'{x}-jump', {'in1': f'{x}-index.fb-out', 'gain1': -1})
        board.add('mux2', f'{x}-off', {'sel': f'{x}-found.out', 'in1': jump, 'in0': off})
        board.add('offset', f'{x}-index', {'offset': off, 'in': command})
        board.functions[-1:] = [f'{x}-index.update-feedback', f'{x}-index.update-output']
        board.add('edge', f'{x}-asks', {'in': asked, 'in-edge': 0})
        board.names[asked] = f'cnc-{x}-asked'
        board.add('tristate_bit', f'{x}-ask', {'in': 1, 'enable': f'{x}-asks.out'})
        board.connect(f'{x}-index.fb-out', actual)
        if unit != 1.0:
            board.connect(board.add('scale', f'{x}-jump-to-us', {'in': off, 'gain': unit}), offset)
        else:
            board.connect(off, offset)
        return f'{x}-index.out', f'{x}-index.fb-in {x}-jump.in0'

    def _gantry(
        self,
        x: str,
        i: int,
        joints: list[int],
        command: str,
        actual: str,
        square: str,
        home: str,
    ) -> None:
        """Drive two motors of one axis; each one stops at its switch while ``square`` is on.

        The command of a motor is offset by the distance that it missed while stopped. Without
        power, the second motor's command follows its own position, so that nothing jumps at
        power-on.
        """
        board, place, power = self.board, self.place, 'power-given.ok-out'
        switches = [f'joint.{k}.home-sw-in' for k in joints]
        asked: Inputs = {'in-0': square} if square else {}
        unit, inputs = self.wiring.units.get(x.upper(), 1.0), dict[str, list[str]]()
        for m, (k, hold) in enumerate(zip(joints, (0xFFFF2000, 0xFFFF08FF), strict=True), 1):
            aim, motor, begins = command, f'{x}{m}-motor.out', ''
            skew = self.wiring.switches.get(joints[0], 0.0) - self.wiring.switches.get(k, 0.0)
            if skew and square:
                # At the beginning the motor takes over the skew; it is added again at the end.
                begins = board.add('edge', f'{x}{m}-begins', {'in': square, 'in-edge': 0})
                skewed = board.add('mux2', f'{x}{m}-skews', {'sel': square, 'in0': skew})
                slowly: Inputs = {'in': skewed, 'load': square, 'maxv': SLOW / unit}
                skewed = board.add('limit2', f'{x}{m}-skew', slowly)
                aim = board.add('sum2', f'{x}{m}-aim', {'in0': command, 'in1': skewed})
            held = motor
            if m == 2:
                held = board.add('mux2', f'{x}{m}-held', {'sel': power, 'in1': motor})
            stopped: Inputs = {'in0': held, 'in1': aim, 'gain1': -1}
            stopped = {'in0': f'{x}{m}-off.out', 'in1': board.add('sum2', f'{x}{m}-wish', stopped)}
            holds = asked | {'in-3': power, 'function': hold}
            holds |= {'in-4': begins} if begins else {}
            stopped['sel'] = board.add('lut5', f'{x}{m}-hold', holds)
            off = board.add('mux2', f'{x}{m}-off', stopped)
            board.add('sum2', f'{x}{m}-motor', {'in0': aim, 'in1': off})
            of = f'joint.{k}.'
            place[f'{of}motor-pos-cmd'] = motor
            place[f'{of}amp-fault-in'] = f'{x}-fault.in-{m - 1}'
            for j, name in enumerate(switches, 1):
                inputs.setdefault(name, []).append(f'{x}{m}-hold.in-{j}')
        board.add('sum2', f'{x}-place', {'in1': f'{x}1-off.out', 'gain1': -1})
        board.connect(f'{x}-place.out', actual)
        most = self.wiring.errors.get(joints[1], ERROR / unit)
        board.add('near', f'{x}2-near', {'in1': f'{x}2-motor.out', 'difference': most})
        fault: Inputs = {'in-2': f'{x}2-near.out', 'function': 0xEF}
        board.connect(board.add('lut5', f'{x}-fault', fault), seen(i), f'fault-{i}.in1')
        place[f'joint.{joints[0]}.motor-pos-fb'] = f'{x}-place.in0'
        place[f'joint.{joints[1]}.motor-pos-fb'] = f'{x}2-held.in0 {x}2-near.in2'
        if home:
            board.connect(board.add('lut5', f'{x}-home', asked | {'function': 0xE8}), home)
            given = [name for name in switches if name in self.final]
            for name in given:
                place[name] = ' '.join([*inputs[name], f'{x}-home.in-{switches.index(name) + 1}'])
            if len(given) == 1:  # one switch for both
                place[given[0]] = f'{x}-home.in-1 {x}-home.in-2'

    def _handwheel(self, axes: Sequence[str], inputs: dict[str, str]) -> None:
        """Connect the one handwheel whose counts and steps all axes share."""
        board, place = self.board, self.place
        each = [(a, f'axis.{a.lower()}.jog') for a in axes]
        each += [(a, f'joint.{k}.jog') for k, a in enumerate(self.wiring.joints)]
        inch = {self.wiring.units.get(a, 1.0) for a in axes if a in 'XYZ'} - {1.0}
        for name, key, module, given in (
            (COUNTS, 'counts', 'conv_s32_float', {}),
            (STEP, 'scale', 'scale', {'gain': max(inch, default=1.0)}),
        ):
            pins = [f'{pin}-{key}' for _, pin in each if f'{pin}-{key}' in self.final]
            shared = {self.rows[self.final[pin]].words[1] for pin in pins}
            if name in inputs and len(shared) == 1:
                place |= dict.fromkeys(pins, f'{name}.in')
                board.connect(board.add(module, name, given), inputs[name])
        for axis, pin in each:
            if handwheel_input(axis) in inputs:
                place[f'{pin}-enable'] = inputs[handwheel_input(axis)]

    def _spindle(self, outputs: dict[str, str]) -> None:
        """Derive further spindle pins of LinuxCNC, besides speed and direction, if connected."""
        board, place, final = self.board, self.place, self.final
        if 'tool_number' in outputs and NUMBER in final:
            number = {'in': outputs['tool_number']}
            place[NUMBER] = board.add('conv_float_s32', 'tool-number', number)
            board.connect(place[NUMBER])
        if not {'spindle_forward', 'spindle_speed'} <= set(outputs):
            return
        forward, speed = outputs['spindle_forward'], outputs['spindle_speed']
        reverse = outputs.get('spindle_reverse', 0)

        def derived(pin: str, module: str, inputs: Inputs, needed_by: str = '') -> str:
            name, of = f'spindle-{pin}', f'spindle.0.{pin}'
            if of in final or any(f'spindle.0.{each}' in final for each in needed_by.split()):
                place[of] = board.add(module, name, inputs)
                board.connect(place[of])
            return f'{name}.out'

        both: Inputs = {'in0': forward, 'in1': reverse}
        turns = derived('on', 'or2', both, 'brake speed-out-abs speed-out-rps-abs')
        derived('brake', 'not', {'in': turns})
        size = derived('speed-out-abs', 'mux2', {'sel': turns, 'in1': speed}, 'speed-out-rps-abs')
        derived('speed-out-rps-abs', 'scale', {'in': size, 'gain': 1.0 / 60.0})
        if {'spindle.0.speed-out', 'spindle.0.speed-out-rps'} & set(final):
            back = board.add('scale', 'spindle-back', {'in': speed, 'gain': -1})
            signed: Inputs = {'sel0': forward, 'sel1': reverse, 'in1': speed, 'in2': back}
            speed = derived('speed-out', 'mux4', signed, 'speed-out-rps')
            derived('speed-out-rps', 'scale', {'in': speed, 'gain': 1.0 / 60.0})

    def take(self, k: int) -> None:
        """Convert a line of the configuration."""
        row = self.rows[k]
        words = row.words
        first = words[:1] if len(words) > 1 else []
        if first == ['net']:
            self._net(k, row)
        elif first == ['loadrt'] and MOTION.fullmatch(' '.join(words[1:2])):
            if THREADS.fullmatch(words[1]):
                self._motion_threads(row.given)
        elif first == ['loadrt'] and ' '.join(words[1:2]) in self.loads.merged:
            self.made.append(f'# {row.line}')
        elif first == ['addf'] and words[1:2] == [HANDLER]:
            self._call(HANDLER, self.board.functions, words)
        elif first == ['addf'] and words[1:2] == [CONTROLLER]:
            self._call(CONTROLLER, FEEDBACK, words)
        elif first in (['unlinkp'], ['delsig']) or words[:2] == ['addf', FEEDBACK[0]]:
            self.made.append(f'# {row.line}')  # it has been counted
        elif first in (['newsig'], ['sets']) and self._is_ours(words[0], words[1]):
            self.made.append(f'# {row.line}')
        elif any(map(ABSENT.fullmatch, words)):
            self.made.append(f'# {row.line}')
            self.left_out.append(row.line.strip())
        else:
            self.made.append(row.line)

    def _call(self, name: str, functions: Sequence[str], words: list[str]) -> None:
        self.needed.discard(name)
        self.made += [' '.join(['addf', each, *words[2:3]]) for each in functions]

    def _motion_threads(self, given: dict[str, str]) -> None:
        periods = {
            'base-thread': given.get('base_period_nsec', '0'),
            'servo-thread': given.get('servo_period_nsec', '1000000'),
        }
        resolve = self.wiring.resolve
        self.threads |= {
            name: period for name, period in periods.items() if resolve(period) not in ('', '0')
        }

    def _is_ours(self, word: str, signal: str) -> bool:
        """Return whether the signal of a line is renamed, or has no pins left."""
        if word == 'newsig':
            self.signals.add(signal)
        return self._new_name(signal) != signal or signal not in self.signals

    def _new_name(self, signal: str) -> str:
        """Return the new name of a signal; most keep their own."""
        if any(map(ENABLE.fullmatch, self.pins.get(signal, ()))):
            return POWER
        return STOP if signal and signal == self.stop else signal

    def _net(self, k: int, row: Row) -> None:
        signal, pins = row.words[1], [pin for pin in row.words[2:] if self.final.get(pin) == k]
        self.needed -= set(pins)
        looped = {LOOP, RELEASED} if self.pins.get(signal, set()) <= {LOOP, RELEASED} else set()
        placed = [
            each
            for pin in pins
            if pin not in looped
            for each in self.place.get(pin, pin).split()
            if each not in self.placed
        ]
        kept = [pin for pin in placed if not ABSENT.fullmatch(pin)]
        lost = {
            pin
            for pin in pins
            if ABSENT.fullmatch(pin)
            and pin not in self.place
            and not ENABLE.fullmatch(pin)
            and pin != RELEASED
        }
        for pin in kept:
            kept = [*kept, *self.board.nets.get(pin, ())] if pin in self.board.nets else kept
        self.placed |= {pin for pin in kept if pin in self.board.nets or pin in self.ours}
        if lost:
            self.left_out.append(row.line.strip())
        self.signals |= {signal} if kept or not row.words[2:] else set()
        words = ['net', self._new_name(signal), *dict.fromkeys(kept)]
        self.made.append(' '.join(words) if kept or not row.words[2:] else f'# {row.line}')

    def finished(self) -> tuple[str, list[str]]:
        """Return the text of the file, and the omitted lines."""
        if self.needed:
            raise InterpError(
                f'no HAL file names {min(self.needed)}; give all files of the configuration'
            )
        end = self.board.lines(self.placed)
        if self.stop:
            end.append(f'net {STOP} => power-given.ok-in')
        else:
            self.left_out.append('no contact lets the emergency stop switch the power off')
            end.append('setp power-given.ok-in 1')
        head = self.loads.lines(self.columns, self.threads)
        lines = [*head, *self.made, *self.board.settings, *end, '', 'start']
        return '\n'.join(lines) + '\n', self.left_out
