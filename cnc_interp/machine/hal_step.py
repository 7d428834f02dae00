"""One compiled period of drives in LinuxCNC's HAL: write a row to the FIFO and read samples.

``streamer`` takes one row per period from a FIFO, and ``sampler`` writes a row of pins to another
one. Rows are counted on both sides, so each sample is compared with the row that HAL played.
The number of rows in the FIFO shows how fast HAL's clock runs. In motion the clock of the machine
is shifted slightly until the wanted number waits; at rest a row is repeated or left out.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, types

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import cfunc, njit
from cnc_interp.core.native import NANOSECONDS, call_c, pointer, publish, time_now
from cnc_interp.machine.hal_pins import BITS

#: Words of the memory: addresses of HAL's functions and streams, ...
WRITE, READ, DEPTH, OVERRUNS, STREAM, SAMPLES = range(6)
#: ... words that Python writes: wanted rows in the FIFO, period [ns], power; ...
WANTED, PERIOD, POWER = range(6, 9)
#: ... and words that the step writes: whether rows are counted, rows pushed and played, power
#: before and as the drives confirm it, the alarm, underruns in motion, fewest rows in the FIFO in
#: motion, periods with too many (> 0) or too few rows at rest, time since the last sample [ns],
#: samples lost before the count, whether there was a sample at all, whether one confirmed the
#: power, the time at which samples were looked for last [ns], and the memory of a ``timespec``.
COUNTED, PUSHED, PLAYED, POWER_BEFORE, POWERED, ALARM, UNDERRUNS = range(9, 16)
LEAST, UNEVEN, SILENT, LOST, SEEN, CONFIRMED, LOOKED, TIME = range(16, 24)
#: 1 to make the next step renumber the axes; the step resets it.
SHIFT_ASKED = 25
#: Numbers of outputs and inputs, which Python writes before all others, and the input of ``ANGLE``
#: or -1.
OUTPUTS, INPUTS, TURNS, WORDS = 26, 27, 28, 29
#: Power: off; axes held in place; following setpoints; on until HAL has played the last setpoint.
OFF, HOLD, FOLLOW, LEAVE = 0, 1, 2, 3
KEPT = 8192  #: Rows kept for comparison; more than are ever in transit from push to sample.
#: Columns of a kept row after setpoints and values of HAL: power is on, axes move; and the angle
#: of the spindle in its sample.
FLAGS, ANGLE = 2, 3
LATER = 2  #: The angle belongs to a row this many rows before the last row surely played.
#: Numbers of alarms, of faults, and of alarms of an axis, to which its number is added.
SWITCHED_OFF, EMPTY, CHANGED, UNSEEN = 1, 2, 3, 4
FULL, STOPPED = 11, 12
BEHIND, AMPLIFIER = 100, 200
#: HAL's thread counts as stopped after this time without a sample [ns].
LONGEST_SILENCE = 500_000_000
#: Shift of the clock per row too many or too few, and largest shift [periods].
SHIFT, LARGEST_SHIFT = 2e-4, 1e-3
#: Without power, rows follow the axes: each by this share of its distance, divided by the rows in
#: the FIFO. With a larger share, a move of unpowered axes would circulate in the FIFO for ever.
FOLLOWS = 0.1
PATIENCE = 20  #: Periods at rest with a wrong number of rows before a row is added or left out.


class Block(NamedTuple):
    """The memory of the step in parts; ``n`` axes."""

    words: IntArray  #: (WORDS,): Addresses and counts.
    units: FloatArray  #: (n,): HAL's unit of each axis [m or rad].
    limits: FloatArray  #: (n,): Largest following error [m, rad].
    held: FloatArray  #: (n,): Positions at which the axes are held after power-on [m, rad].
    actual: FloatArray  #: (2, n): Position in the last two samples [m, rad].
    offset: FloatArray  #: (n,): Position of the axes at HAL's zero [m, rad].
    shift: FloatArray  #: (n,): Value that the next shift adds to positions and offset [m, rad].
    home: FloatArray  #: (n,): Number of the input watched for each axis; -1 if none.
    released: FloatArray  #: (n,): Position of each axis when that input last went off [m, rad].
    #: (KEPT, 2n + ANGLE): Pushed rows: setpoint [m, rad], in HAL's units, flags, angle.
    kept: FloatArray
    #: (2n + 1 + m,): A row of the stream: positions, velocities, outputs that are numbers; then
    #: bits, ``BITS`` in a column: power, other outputs.
    row: FloatArray
    #: (3n + 2 + k,): A row of the sampler: positions commanded and actual, inputs that are
    #: numbers; then bits: amplifier faults, power is on, FIFO was empty, other inputs.
    sample: FloatArray
    number: FloatArray  #: (1,): Number of the sample, written by HAL.
    outputs: FloatArray  #: (m,): Values of the outputs.
    #: (m + k,): Whether an output or an input is a number; otherwise it is a bit.
    is_number: FloatArray
    inputs: FloatArray  #: (k,): The inputs in the last sample.


def block_size(n: int, outputs: int, inputs: int) -> int:
    signals = 3 * (outputs + inputs)
    return WORDS + 9 * n + KEPT * (2 * n + ANGLE) + (2 * n + 1) + (3 * n + 2) + 1 + signals


@njit(cache=True, nogil=True)
def block_at(address: int, n: int) -> Block:
    """Return the parts of the memory that begins at an address."""
    columns, at = 2 * n + ANGLE, address + 8 * WORDS
    words = carray(pointer(np.uintp(address)), (WORDS,)).view(np.int64)
    m, k = words[OUTPUTS], words[INPUTS]
    rows = at + 8 * 9 * n
    row = rows + 8 * KEPT * columns
    sample = row + 8 * (2 * n + 1 + m)
    number = sample + 8 * (3 * n + 2 + k)
    return Block(
        words,
        carray(pointer(np.uintp(at)), (n,)),
        carray(pointer(np.uintp(at + 8 * n)), (n,)),
        carray(pointer(np.uintp(at + 16 * n)), (n,)),
        carray(pointer(np.uintp(at + 24 * n)), (2, n)),
        carray(pointer(np.uintp(at + 40 * n)), (n,)),
        carray(pointer(np.uintp(at + 48 * n)), (n,)),
        carray(pointer(np.uintp(at + 56 * n)), (n,)),
        carray(pointer(np.uintp(at + 64 * n)), (n,)),
        carray(pointer(np.uintp(rows)), (KEPT, columns)),
        carray(pointer(np.uintp(row)), (2 * n + 1 + m,)),
        carray(pointer(np.uintp(sample)), (3 * n + 2 + k,)),
        carray(pointer(np.uintp(number)), (1,)),
        carray(pointer(np.uintp(number + 8)), (m,)),
        carray(pointer(np.uintp(number + 8 * (1 + m))), (m + k,)),
        carray(pointer(np.uintp(number + 8 * (1 + 2 * m + k))), (k,)),
    )


@njit(cache=True, nogil=True)
def _call(words: IntArray, function: int, stream: int, row: int = 0, number: int = 0) -> int:
    return call_c(
        np.uintp(words[function]), np.uintp(words[stream]), np.uintp(row), np.uintp(number)
    )


@njit(cache=True, nogil=True)
def _push(block: Block, wanted: FloatArray, velocity: FloatArray, on: bool, moves: bool) -> bool:
    words, n = block.words, len(block.units)
    kept = block.kept[words[PUSHED] % KEPT]
    for i in range(n):
        kept[i], kept[n + i] = wanted[i], (wanted[i] - block.offset[i]) / block.units[i]
        block.row[i], block.row[n + i] = kept[n + i], velocity[i] / block.units[i]
    kept[2 * n], kept[2 * n + 1] = on, moves
    m, column, bit = len(block.outputs), 2 * n, 1
    packed = block.row[column + int(block.is_number[:m].sum()) :].view(np.int64)
    packed[:], packed[0] = 0, on
    for i in range(m):
        if block.is_number[i] != 0.0:
            block.row[column] = block.outputs[i]
            column += 1
        else:
            packed[bit // BITS] |= int(block.outputs[i] != 0.0) << bit % BITS
            bit += 1
    if _call(words, WRITE, STREAM, block.row.ctypes.data) < 0:
        return False
    words[PUSHED] += 1
    return True


@njit(cache=True, nogil=True)
def _bit(block: Block, k: int) -> bool:
    """Return a bit of the sample."""
    numbers = int(block.is_number[len(block.outputs) :].sum())
    packed = block.sample[2 * len(block.units) + numbers :].view(np.int64)
    return bool(packed[k // BITS] >> k % BITS & 1)


@njit(cache=True, nogil=True)
def _judge(block: Block) -> int:
    """Compare a sample with the row that it answers; return the number of an alarm, or 0."""
    words, n, sample = block.words, len(block.units), block.sample
    on, empty = _bit(block, n), _bit(block, n + 1)
    for i in range(n):
        block.actual[0, i] = block.actual[1, i]
        block.actual[1, i] = sample[n + i] * block.units[i] + block.offset[i]
    column, bit = 2 * n, n + 2
    for i in range(len(block.inputs)):
        if block.is_number[len(block.outputs) + i] != 0.0:
            block.inputs[i] = sample[column]
            column += 1
            continue
        if block.inputs[i] != 0.0 and not _bit(block, bit):
            for k in range(n):
                if block.home[k] == i:
                    block.released[k] = block.actual[1, k]
        block.inputs[i] = _bit(block, bit)
        bit += 1
    if words[COUNTED] == 0:
        return 0
    words[PLAYED] += 0 if empty else 1
    if words[PLAYED] == 0:
        return 0
    kept = block.kept[(words[PLAYED] - 1) % KEPT]
    kept[2 * n + FLAGS] = block.inputs[words[TURNS]]
    if empty and kept[2 * n + 1] != 0.0:
        words[UNDERRUNS] += 1
        return EMPTY
    for i in range(n):
        if sample[i] != kept[n + i]:
            return CHANGED
    if kept[2 * n] == 0.0 or not (on or words[CONFIRMED]):
        return 0
    words[CONFIRMED] = 1
    for i in range(n):
        if _bit(block, i):
            return AMPLIFIER + i
    if not on:
        return SWITCHED_OFF
    for i in range(n):
        if not abs(kept[i] - block.actual[1, i]) <= block.limits[i]:
            return BEHIND + i
    return 0


@njit(cache=True, nogil=True)
def _tell_angle(block: Block) -> None:
    """Set the angle by row numbers, so that it is uniform in time however samples arrive.

    It is NaN if the row has not been sampled yet because HAL's thread is late. Extrapolation from
    two samples would know the speed only to one step of the encoder.
    """
    words, angle = block.words, block.kept[:, 2 * len(block.units) + FLAGS]
    last, at = words[PLAYED] - 1, words[PUSHED] - words[WANTED] - LATER
    sampled = np.nan if at > last else angle[at % KEPT]
    block.inputs[words[TURNS]] = angle[last % KEPT] if at < 0 else sampled


@njit(cache=True, nogil=True)
def _read_samples(block: Block) -> int:
    """Read the samples of HAL; return the number of the first alarm, or 0."""
    words, alarm = block.words, 0
    now = time_now(words[TIME:])
    # Steps that catch up follow each other at once; a step that came late saw nothing meanwhile.
    words[SILENT] += min(now - words[LOOKED], 2 * words[PERIOD])
    words[LOOKED] = now
    while _call(words, READ, SAMPLES, block.sample.ctypes.data, block.number.ctypes.data) == 0:
        words[SILENT] = 0
        found = _judge(block)
        alarm = alarm or found
        if words[SEEN] == 0:
            block.actual[0] = block.actual[1]
            words[SEEN] = 1
    lost = _call(words, OVERRUNS, SAMPLES)
    if words[COUNTED] and lost != words[LOST]:
        alarm = UNSEEN
    words[LOST] = lost
    return alarm


@njit(cache=True, nogil=True)
def _begin_count(block: Block) -> bool:
    """Begin to count rows once the FIFO is empty and HAL has reported it."""
    words, n = block.words, len(block.units)
    drained = _call(words, DEPTH, STREAM) == 0
    _read_samples(block)
    if not (drained and words[SEEN] and _bit(block, n + 1)):
        return False
    words[COUNTED], words[PUSHED], words[PLAYED], words[SILENT] = 1, 0, 0, 0
    still = np.zeros(n)
    for _ in range(words[WANTED]):
        _push(block, block.actual[1], still, False, False)
    return True


@njit(cache=True, nogil=True)
def shift_axes(block: Block) -> None:
    """Renumber the axes at rest; the values sent to HAL stay the same, so nothing moves."""
    words, n = block.words, len(block.units)
    block.offset[:] += block.shift
    for k in range(2):
        block.actual[k] += block.shift
    for k in range(KEPT):
        block.kept[k, :n] += block.shift
    if words[POWER] != OFF:
        block.held[:] = block.kept[(words[PUSHED] - 1) % KEPT, :n]
        words[POWER] = HOLD
    publish(words, SHIFT_ASKED, 0)


@njit(cache=True, nogil=True)
def _rows_to_push(words: IntArray, waiting: int, moves: bool) -> int:
    """Return how many times the row is pushed: once, or at rest as often as rows are missing."""
    excess = waiting + 1 - words[WANTED]
    if moves:
        words[LEAST] = min(words[LEAST], waiting)
    if moves or excess * words[UNEVEN] < 0 or excess == 0:
        words[UNEVEN] = 0
    if moves or excess == 0:
        return 1
    words[UNEVEN] += 1 if excess > 0 else -1
    if abs(words[UNEVEN]) < PATIENCE:
        return 1
    words[UNEVEN] = 0
    return 0 if excess > 0 else 2


@njit(cache=True, nogil=True)
def _power(block: Block, setpoint: FloatArray) -> int:
    """Return the power of this row; HOLD becomes FOLLOW; LEAVE lasts until all is played."""
    words, n = block.words, len(block.units)
    power, before = words[POWER], words[POWER_BEFORE]
    if power == OFF and before != OFF and words[SILENT] < LONGEST_SILENCE:
        last, played = (words[PUSHED] - 1) % KEPT, (words[PLAYED] - 1) % KEPT
        if np.any(block.kept[last, :n] != block.kept[played, :n]):
            return LEAVE
    if power == OFF:
        words[POWERED] = words[CONFIRMED] = 0
    elif before == OFF:
        block.held[:] = block.actual[1]
    elif power == HOLD and np.all(setpoint == block.held):
        power = words[POWER] = FOLLOW
    words[POWER_BEFORE] = power
    return int(power)


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def step_hal(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Send one setpoint to HAL and read its samples; see ``drives.CycleDrives``."""
    block = block_at(memory, n)
    told, words = carray(pointer(feedback), (4, n)), block.words
    asked, rate = carray(pointer(setpoint), (2, n))[0], carray(pointer(setpoint), (2, n))[1]
    if not (words[COUNTED] or _begin_count(block)):
        told[0], told[1] = block.actual[1], 0.0
        return 0
    if words[SHIFT_ASKED]:
        shift_axes(block)
    power, wanted, velocity = _power(block, asked), asked, rate
    if power == HOLD:
        wanted = block.held
    elif power != FOLLOW:
        wanted = block.kept[(words[PUSHED] - 1) % KEPT, :n].copy()
    if power == OFF:
        wanted += (block.actual[1] - wanted) * (FOLLOWS / words[WANTED])
    if power != FOLLOW:
        velocity = np.zeros(n)
    moves, fault = bool(np.any(velocity != 0.0)), 0
    waiting = _call(words, DEPTH, STREAM)
    rows = _rows_to_push(words, waiting, moves)
    told[3, 1] = rows - 1
    for _ in range(rows):
        if not _push(block, wanted, velocity, power != OFF, moves):
            fault = FULL
    alarm = _read_samples(block)
    if words[TURNS] >= 0 and words[PLAYED] > 1:
        _tell_angle(block)
    if words[SILENT] > LONGEST_SILENCE:
        fault = STOPPED
    if alarm and moves and words[CONFIRMED] and not _bit(block, n):
        fault = alarm  # without power no axis follows a stop tail
    words[ALARM] = fault or alarm
    if power != OFF:
        publish(words, POWERED, words[CONFIRMED])  # after the alarm, for who waits for it
    told[0] = block.actual[1]
    told[1] = (block.actual[1] - block.actual[0]) * (NANOSECONDS / words[PERIOD])
    if words[PLAYED]:
        told[2] = block.kept[(words[PLAYED] - 1) % KEPT, :n]
    if moves:
        shift = SHIFT * (waiting + 1 - words[WANTED])
        told[3, 0] = min(max(shift, -LARGEST_SHIFT), LARGEST_SHIFT) * words[PERIOD] / NANOSECONDS
    if power == OFF and alarm in (CHANGED, UNSEEN):
        words[COUNTED] = 0
    return fault if fault or words[POWERED] == 0 else -alarm
