"""Compensated drives: the inverse of their model is sent as velocity feed-forward.

For the table to be at r, the equations of ``drive_model.py`` require the motor to be at

    m = r + r'' / omega^2 - 2 zeta / omega^3 r''' + (w / 2) sign,

where the sign is that of the last motion. For any position setpoint c, the loops move it there if
the velocity feed-forward g satisfies kv (c - m) + f g = m' + tau u with u = m'' + B m' + F. So the
proven setpoints are sent unchanged, some periods later, and the whole inverse goes into g:

    f g = kv (m - c) + (1 + tau B) m' + tau m'' + tau F.

Derivatives are those of polynomials that fit some setpoints before and after by least squares.
To know later setpoints, all axes are delayed by the same ``lead``, which does not change the path.
Setpoints of a drive with a longer dead time are sent earlier. Signs at a reversal are smoothed
over a few milliseconds. Programs, stop tails and motion by hand are all compensated.

The feed-forward learnt in earlier runs of a program (``learning.py``) is added to g while the
setpoints are, bit for bit, those of that program. After any other setpoint it fades to zero.
"""

import math

import numpy as np
from numba import carray, types

from cnc_interp.core import FloatArray, IntArray, MachineError
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.core.kernels import cfunc, njit
from cnc_interp.core.native import call_drives, pointer
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine

BESIDE, FEWEST = 8e-3, 5  #: Setpoints to each side: time [s], least number.
DEGREE = 5  #: Degree of the polynomials.
#: Half of the time in which the motor crosses the backlash: least time, time if the largest torque
#: is unknown [s]; and share of that torque that the crossing may use [-].
QUICKEST, CROSSING, CROSSING_TORQUE = 2e-3, 4e-3, 0.6
#: Half of the time over which friction changes its sign [s]; least number of periods of both.
TURNING, SMOOTH_PERIODS = 2e-3, 1.5
LEAST = 0.2  #: Least share of feed-forward that a drive must accept [-].
STILL, SLOW = 1e-12, 1e-7  #: Step and velocity below which an axis rests.

FADE = 15e-3  #: Time in which the learnt part fades [s].
#: Whole numbers before the rows of the axes: inner step, its memory, words of an axis, setpoints
#: known.
STEP, MEMORY, COUNT, KNOWN = 0, 1, 2, 3
#: Then those of what is learnt: its rows, 0 for none; addresses of setpoints and feed-forwards;
#: periods of a fade; the row that is played, 0 for none; periods left, all of them while the
#: setpoints are those of the rows; whether the last setpoint was that of row 0.
ROWS, SETPOINTS, RATES, FADING, ROW, LEFT, READY, HEAD = 4, 5, 6, 7, 8, 9, 10, 11
#: Words of an axis: periods by which its position is sent later; friction and its excess at rest
#: over the inertia, velocity of Stribeck; sign of the last motion.
LATER, COULOMB, EXCESS, STRIBECK, SIGN = 0, 1, 2, 3, 4
#: Then columns over the last setpoints, the newest first: weights of r, sign and friction in g, of
#: r and sign in m'; then r, sign and friction.
IN_RATE, IN_MOTOR, STATE, COLUMNS, FIRST = 0, 3, 5, 8, 5


@njit(cache=True, nogil=True)
def compensate(words: FloatArray, known: int, setpoint: float) -> tuple[float, float]:
    """Take the next setpoint of an axis; return the position and feed-forward to send now."""
    weights, motors = FIRST + IN_RATE * known, FIRST + IN_MOTOR * known
    r = FIRST + STATE * known
    sign, force = r + known, r + 2 * known
    step = setpoint - words[r]
    for k in range(known - 1, 0, -1):
        words[r + k] = words[r + k - 1]
        words[sign + k] = words[sign + k - 1]
        words[force + k] = words[force + k - 1]
    words[r] = setpoint
    if abs(step) > STILL:
        words[SIGN] = math.copysign(1.0, step)
    words[sign] = words[SIGN]
    sent = words[r + int(words[LATER])]
    rate = motor = 0.0
    for k in range(known):
        # Relative to what is sent, so that rounding does not depend on where the axis is.
        away = words[r + k] - sent
        rate += words[weights + k] * away + words[weights + known + k] * words[sign + k]
        motor += words[motors + k] * away + words[motors + known + k] * words[sign + k]
    words[force] = 0.0
    if abs(motor) > SLOW:
        level = words[COULOMB]
        if words[EXCESS] > 0.0:
            level += words[EXCESS] * math.exp(-((motor / words[STRIBECK]) ** 2))
        words[force] = math.copysign(level, motor)
    for k in range(known):
        rate += words[weights + 2 * known + k] * words[force + k]
    return sent, rate


@njit(cache=True, nogil=True)
def find_row(head: IntArray, setpoints: FloatArray, wanted: FloatArray) -> float:
    """Find the learnt row of the next setpoint, and store it in ``head[ROW]``."""
    row, left, fading = head[ROW], head[LEFT], head[FADING]
    if row > 0:
        row += 1
        if row == len(setpoints):
            row = 0
        elif left < fading or not _same(setpoints[row], wanted):
            left -= 1
            if left <= 0:
                row = 0
    if row == 0:
        left = fading
        if head[READY] and _same(setpoints[1], wanted):
            row = 1
    head[READY] = _same(setpoints[0], wanted)
    head[ROW], head[LEFT] = row, left
    return 0.5 - 0.5 * math.cos(math.pi * left / fading)


@njit(cache=True, nogil=True)
def _same(first: FloatArray, second: FloatArray) -> bool:
    differs = 0
    for j in range(len(first)):
        differs += first[j] != second[j]
    return differs == 0


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def compensate_once(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Compensate all axes, then step the drives; see ``drives.CycleDrives``."""
    head = carray(pointer(memory), (HEAD,)).view(np.int64)
    count, known = head[COUNT], head[KNOWN]
    words = carray(pointer(memory + 8 * HEAD), (n, count))
    told = carray(pointer(memory + 8 * (HEAD + n * count)), (2, n))
    wanted = carray(pointer(setpoint), (2, n))
    for j in range(n):
        told[0, j], told[1, j] = compensate(words[j], known, wanted[0, j])
    if head[ROWS] > 0:
        shape = (head[ROWS], n)
        weight = find_row(head, carray(pointer(np.uintp(head[SETPOINTS])), shape), wanted[0])
        if head[ROW] > 0:
            rates = carray(pointer(np.uintp(head[RATES])), shape)[head[ROW]]
            for j in range(n):
                told[1, j] += weight * rates[j]
    return call_drives(np.uintp(head[STEP]), np.uintp(head[MEMORY]), told.ctypes.data, feedback, n)


@njit(cache=True, nogil=True)
def compensate_all(
    words: FloatArray, known: int, setpoints: FloatArray
) -> tuple[FloatArray, FloatArray]:
    sent, rates = np.empty_like(setpoints), np.empty_like(setpoints)
    for j in range(setpoints.shape[1]):
        for i in range(len(setpoints)):
            sent[i, j], rates[i, j] = compensate(words[j], known, setpoints[i, j])
    return sent, rates


class Compensation:
    """The memory of a compensation: words of all axes, at rest at ``position`` [m, rad].

    Raises MachineError if a drive of ``model`` takes too little feed-forward of velocity.
    """

    def __init__(self, model: Machine, period: float, position: FloatArray):
        for name, (drive, _) in zip(model.axis_names, model.driven, strict=True):
            if drive.feed_forward < LEAST:
                raise MachineError(
                    f'{drive.feed_forward:g} is too little to compensate by; at least {LEAST:g}',
                    f'drives.{name}.feed_forward',
                )
        beside = max(math.ceil(BESIDE / period - 1e-9), FEWEST)
        turning = math.ceil(max(TURNING / period, SMOOTH_PERIODS) - 1e-9)
        latest = max(drive.delay for drive, _ in model.driven)
        #: Time by which all axes are later than their setpoints [s].
        self.lead = (beside + turning) * period + latest
        self.known = math.ceil(self.lead / period) + beside + 2
        self.words = np.zeros((len(position), FIRST + COLUMNS * self.known))
        for j, (drive, load) in enumerate(model.driven):
            columns = self.words[j, FIRST:].reshape(COLUMNS, self.known)
            self.words[j, COULOMB : STRIBECK + 1] = _friction(drive, load)
            later = (self.lead - drive.delay) / period
            self.words[j, LATER] = round(later)
            _write_weights(columns, drive, load, period, (later, beside, turning))
            columns[STATE] = position[j]

    def memory(
        self,
        step: int,
        memory: FloatArray,
        period: float,
        learnt: tuple[FloatArray, FloatArray] | None,
    ) -> FloatArray:
        """Return the memory of ``compensate_once``, given a step of drives and its memory."""
        axes, count = self.words.shape
        head = np.zeros(HEAD, dtype=np.int64)
        head[[STEP, MEMORY]] = step, memory.ctypes.data
        head[[COUNT, KNOWN]] = count, self.known
        if learnt is not None:
            head[ROWS] = len(learnt[0])
            head[[SETPOINTS, RATES]] = [rows.ctypes.data for rows in learnt]
            head[[FADING, LEFT]] = math.ceil(FADE / period - 1e-9)
        return np.concatenate([head.view(float), self.words.ravel(), np.zeros(2 * axes)])

    def newest(self, memory: FloatArray) -> FloatArray:
        axes, count = self.words.shape
        return memory[HEAD + FIRST + STATE * self.known :: count][:axes].copy()


def compensated_model(name: str, machine: Machine) -> Machine:
    """Load the model of the drives, by name or file; MachineError if it is of another machine."""
    known = Machine.load(name)
    if known.axis_names != machine.axis_names:
        axes = ' '.join(known.axis_names)
        raise MachineError(f'{name} has other axes ({axes})', 'compensation')
    ours, theirs = machine.limits.by_order, known.limits.by_order
    if not (np.allclose(ours, theirs) and np.allclose(machine.travel, known.travel)):
        text = f'{name} has other limits than {machine.name}: it is the model of another machine'
        raise MachineError(f'{text}; name the file that identify made of this one', 'compensation')
    return known


def _friction(drive: AxisDrive, load: DriveLoad | None) -> tuple[float, float, float]:
    if load is None:
        return 0.0, 0.0, 1.0
    coulomb = load.coulomb / load.inertia
    if not drive.static:
        return coulomb, 0.0, 1.0
    return coulomb, max(drive.static / load.inertia - coulomb, 0.0), drive.stribeck_velocity


def _write_weights(
    columns: FloatArray,
    drive: AxisDrive,
    load: DriveLoad | None,
    period: float,
    timing: tuple[float, int, int],
) -> None:
    later, beside, turning = timing
    kv, f, tau = drive.position_gain, drive.feed_forward, drive.time_constant
    viscous = load.viscous / load.inertia if load is not None else 0.0
    # m = (1 + soft d2 - slow d3) r
    soft = slow = 0.0
    if drive.mode_frequency:
        omega = 2.0 * math.pi * drive.mode_frequency
        soft, slow = 1.0 / omega**2, 2.0 * drive.mode_damping / omega**3
    mode = np.array([1.0, 0.0, soft, -slow])
    # Relative to the c that is sent: f g = (kv + (1 + tau B) d + tau d2) m
    loops = np.array([kv, 1.0 + tau * viscous, tau]) / f
    known, half = columns.shape[1], 0.5 * drive.backlash
    crossing = CROSSING  # half of the time in which the motor crosses the backlash, see ``_bump``
    if load is not None:
        most = CROSSING_TORQUE * load.torque / load.inertia
        crossing = min(max(math.sqrt(1.88 * drive.backlash / most), QUICKEST), BESIDE)
    crossing = max(crossing, SMOOTH_PERIODS * period) / period
    # A sign holds from one setpoint to the next.
    edges = np.arange(known + 1.0)
    columns[IN_RATE] = _polynomial(np.convolve(loops, mode), known, later, beside, period)
    columns[IN_RATE + 1] = half * (loops @ _bump(edges - later, crossing, period))
    # Friction is that of the motor's velocity, some periods before it is sent.
    before = later - turning
    columns[IN_MOTOR] = _polynomial(np.append(0.0, mode), known, before, beside, period)
    columns[IN_MOTOR + 1] = half * _bump(edges - before, crossing, period)[1]
    width = max(TURNING, SMOOTH_PERIODS * period) / period
    columns[IN_RATE + 2] = tau / f * _bump(edges - 0.5 - turning, width, period)[0]


def _polynomial(
    operator: FloatArray, known: int, later: float, beside: int, period: float
) -> FloatArray:
    """Return weights of setpoints for the sum of operator[k] r^(k), ``later`` periods ago."""
    near = np.flatnonzero(np.abs(np.arange(known) - later) <= beside)
    scale = beside * period
    powers = np.linalg.pinv(
        np.vander((later - near) * period / scale, DEGREE + 1, increasing=True)
    )
    weights = np.zeros(known)
    for order, factor in enumerate(operator):
        weights[near] += factor * math.factorial(order) / scale**order * powers[order]
    return weights


def _bump(edges: FloatArray, width: float, period: float) -> FloatArray:
    """Return weights of a smoothed column and of its two derivatives by time, shape (3, known).

    A value holds between two ``edges``. It is smoothed by 35 / 32 (1 - (t / width)^2)^3, exactly.
    """
    u = np.clip(edges / width, -1.0, 1.0)
    inside = 1.0 - u**2
    whole = u - u**3 + 0.6 * u**5 - u**7 / 7.0
    curves: FloatArray = np.stack([whole, inside**3, -6.0 * u * inside**2]) * 35.0 / 32.0
    steps: FloatArray = np.diff(curves, axis=1)
    return np.asarray(steps / (width * period) ** np.arange(3)[:, None])
