"""The model of the simulated drives: how each axis follows its setpoints.

Every axis is a position loop with velocity feed-forward around a velocity loop that answers as a
first-order lag. With m the motor's position and all forces divided by the inertia,

    m' = v,    v' = u - B v - F,    u = (kv (r - m) + f r' - v) / tau,    |u| <= T,

so without friction M/R = (f s + kv) / (tau s^2 + s + kv): stable for all kv, tau > 0, damping
1 / (2 sqrt(kv tau)). On a ramp of speed V it lags by (1 - f) V / kv, under constant acceleration a
by tau a / kv more. The setpoint r comes after a dead time. Friction F is that of Stribeck,

    F = sign(v) (C + (S - C) exp(-(v / v_s)^2)),    |F| <= S at rest.

The table follows the motor after a backlash of width w, through one flexible mode:

    |m - b| <= w / 2,    x'' = omega^2 (b - x) + 2 zeta omega (b' - x').

The measuring system reads x in steps of its resolution. Between two setpoints the drive
interpolates r and r' linearly (first-order hold). Without friction, backlash, mode and the like
the step over one period is exact, by the matrix exponential, whatever the period. Otherwise the
period is divided: within a step the loops and the mode are exact, friction is implicit.
"""

import math

import numpy as np
from numba import carray, types

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import DriveLoad
from cnc_interp.core.kernels import cfunc, njit
from cnc_interp.core.native import pointer
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine

STEP = 1e-4  #: Longest step where one exact step does not do [s].
#: The path on which the contour error is measured reaches back by this many lags of the drives.
LAGS_REMEMBERED = 5.0
SHORTEST_MEMORY, LONGEST_MEMORY = 2, 1000
TERMS = 16  #: Terms of the series of an exponential; the next one is below 1e-17.


def words_of(machine: Machine, period: float, position: FloatArray) -> FloatArray:
    """Compute the words (n_axes, n_words) of axes that stand still at ``position`` [m, rad]."""
    longest = max(drive.delay for drive, _ in machine.driven)
    words = np.zeros((len(position), room_of_delay(longest, period)))
    for row, (drive, load), at in zip(words, machine.driven, position, strict=True):
        axis_words(row, drive, load, period)
        place(row, float(at))
    return words


def room_of_delay(delay: float, period: float) -> int:
    """Return the number of words of an axis for a dead time up to ``delay`` [s]."""
    return RING + 2 * (int(delay / period) + 3)


def lag_of(machine: Machine) -> float:
    return max(drive.lag for drive, _ in machine.driven)


def memory_of(period: float, lag: float) -> int:
    wanted = int(np.ceil(LAGS_REMEMBERED * lag / period)) + 1
    return min(LONGEST_MEMORY, max(SHORTEST_MEMORY, wanted))


def place(words: FloatArray, position: float) -> None:
    words[MOTOR:] = 0.0
    words[[MOTOR, PLAY, TABLE]] = position
    words[RING::2] = position


def axis_words(words: FloatArray, drive: AxisDrive, load: DriveLoad | None, period: float) -> None:
    if load is not None:
        torque, coulomb, viscous = (float(x) for x in load.row)
        excess = max(drive.static / load.inertia - coulomb, 0.0) if drive.static else 0.0
    else:
        torque, coulomb, viscous, excess = np.inf, 0.0, 0.0, 0.0
    plain = not (drive.backlash or drive.mode_frequency or drive.resolution or drive.delay)
    steps = 0 if plain and load is None else math.ceil(period / STEP - 1e-9)
    span = period / max(steps, 1)
    loop = discretise(drive, viscous, span)
    words[SUBSTEPS] = steps
    words[LOOP : LOOP + 12] = np.ravel(loop)
    # A force acts as a setpoint that is further by tau / kv times it.
    words[FORCE : FORCE + 2] = loop[1][:, 0] * drive.time_constant / drive.position_gain
    # At the largest torque: v' = T - B v.
    decay = math.exp(-viscous * span)
    way = -math.expm1(-viscous * span) / viscous if viscous else span
    words[COAST], words[COAST + 1] = way, decay
    fallen = (span - way) / viscous if viscous * span > 1e-4 else 0.5 * span**2
    words[COAST_FORCE], words[COAST_FORCE + 1] = fallen, way
    words[GAIN] = drive.position_gain
    words[FEED_FORWARD], words[LAG] = drive.feed_forward, drive.time_constant
    words[TORQUE], words[COULOMB], words[EXCESS] = torque, coulomb, excess
    words[STRIBECK] = drive.stribeck_velocity
    words[HALF_PLAY] = 0.5 * drive.backlash
    words[HAS_MODE] = float(drive.mode_frequency > 0.0)
    words[MODE : MODE + 4] = np.ravel(_mode(drive, span))
    words[RESOLUTION] = drive.resolution
    words[DELAY], words[RATE] = drive.delay / period, 1.0 / span


def discretise(
    drive: AxisDrive, viscous: float, span: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Solve the loops over one step exactly for inputs (r, r') that run linearly."""
    kv, f, tau = drive.position_gain, drive.feed_forward, drive.time_constant
    # z' = A z + B u, u' = constant: one exponential of the three stacked.
    stacked = np.zeros((6, 6))
    stacked[0, 1] = 1.0
    stacked[1, :4] = np.array([-kv, -1.0 - viscous * tau, kv, f]) / tau
    stacked[2:4, 4:6] = np.eye(2) / span
    step = exponential(stacked * span)
    return step[:2, :2].copy(), step[:2, 2:4].copy(), step[:2, 4:6].copy()


def _mode(drive: AxisDrive, span: float) -> FloatArray:
    turn = 2.0 * math.pi * drive.mode_frequency * span
    return exponential(np.array([[0.0, 1.0], [-(turn**2), -2.0 * drive.mode_damping * turn]]))


def exponential(matrix: FloatArray) -> FloatArray:
    """Return the exponential of a small matrix; SciPy's would delay each start by 0.3 s.

    The Taylor series converges fast after n halvings; n squarings undo them.
    """
    halvings = max(math.frexp(np.abs(matrix).sum(axis=0).max())[1] + 1, 0)
    scaled = matrix / 2.0**halvings
    term = total = np.eye(len(matrix))
    for k in range(1, TERMS):
        term = term @ scaled / k
        total = total + term
    for _ in range(halvings):
        total = total @ total
    return total


SUBSTEPS = 0  #: Words of an axis. Substeps of a period; 0 where one exact step does for all of it.
#: One step of the loops: transition, held and rising, 2 x 2 each; answer to a constant force.
LOOP, FORCE = 1, 13
#: One step at the largest torque: of position and velocity by velocity, and answer to a force.
COAST, COAST_FORCE = 15, 17
GAIN, FEED_FORWARD, LAG = 19, 20, 21  #: Gain, feed-forward, lag.
#: Over the inertia: largest torque, Coulomb friction, excess of the friction at rest. And the
#: velocity of Stribeck.
TORQUE, COULOMB, EXCESS, STRIBECK = 22, 23, 24, 25
#: Half of the backlash; whether there is a mode, and its step, 2 x 2; resolution.
HALF_PLAY, HAS_MODE, MODE, RESOLUTION = 26, 27, 28, 32
DELAY, RATE = 33, 34  #: Delay in periods; steps in a second.
#: State: position and velocity of the motor, position after the play, position of the table and
#: its way per step.
MOTOR, MOTOR_VELOCITY, PLAY, TABLE, TABLE_WAY = 35, 36, 37, 38, 39
RING = 40  #: The setpoints, the newest first: position and velocity of each.


@njit(cache=True, nogil=True)
def follow(words: FloatArray, setpoint: float, rate: float) -> tuple[float, float]:
    for k in range(len(words) - 1, RING + 1, -1):
        words[k] = words[k - 2]
    words[RING], words[RING + 1] = setpoint, rate
    m, v = words[MOTOR], words[MOTOR_VELOCITY]
    if words[SUBSTEPS] == 0.0:
        m, v = _loop(words, m, v, words[RING + 2], words[RING + 3], setpoint, rate)
        words[MOTOR], words[MOTOR_VELOCITY] = m, v
        return m, v
    n, half = int(words[SUBSTEPS]), words[HALF_PLAY]
    b, x, way = words[PLAY], words[TABLE], words[TABLE_WAY]
    r, f = _delayed(words, 1.0)
    for k in range(1, n + 1):
        r_next, f_next = _delayed(words, 1.0 - k / n)
        m, v = _move_motor(words, m, v, r, f, r_next, f_next)
        r, f = r_next, f_next
        b_next = min(max(b, m - half), m + half)
        # The play moves on a line within the step: the mode's error decays freely.
        rise = b_next - b
        if words[HAS_MODE] != 0.0:
            error, slip = x - b, way - rise
            x = b_next + words[MODE] * error + words[MODE + 1] * slip
            way = rise + words[MODE + 2] * error + words[MODE + 3] * slip
        else:
            x, way = b_next, rise
        b = b_next
    words[MOTOR], words[MOTOR_VELOCITY] = m, v
    words[PLAY], words[TABLE], words[TABLE_WAY] = b, x, way
    if words[RESOLUTION] > 0.0:
        x = words[RESOLUTION] * math.floor(x / words[RESOLUTION] + 0.5)
    return x, way * words[RATE]


@njit(cache=True, nogil=True)
def _delayed(words: FloatArray, age: float) -> tuple[float, float]:
    """Return setpoint and velocity that the drive sees, ``age`` periods before the newest."""
    age += words[DELAY]
    k = int(age)
    part, at = age - k, RING + 2 * k
    r = words[at] + part * (words[at + 2] - words[at])
    f = words[at + 1] + part * (words[at + 3] - words[at + 1])
    return r, f


@njit(cache=True, nogil=True)
def _loop(
    words: FloatArray, m: float, v: float, r0: float, f0: float, r: float, f: float
) -> tuple[float, float]:
    """Advance position and velocity of the motor by one step of the loops, exactly."""
    dr, df = r - r0, f - f0
    # Relative to the last setpoint, so that rounding does not depend on where the axis is.
    gap = m - r0
    position = (
        r0
        + words[LOOP] * gap
        + words[LOOP + 1] * v
        + words[LOOP + 5] * f0
        + words[LOOP + 8] * dr
        + words[LOOP + 9] * df
    )
    velocity = (
        words[LOOP + 2] * gap
        + words[LOOP + 3] * v
        + words[LOOP + 7] * f0
        + words[LOOP + 10] * dr
        + words[LOOP + 11] * df
    )
    return position, velocity


@njit(cache=True, nogil=True)
def _move_motor(
    words: FloatArray, m: float, v: float, r0: float, f0: float, r: float, f: float
) -> tuple[float, float]:
    torque = (words[GAIN] * (r0 - m) + words[FEED_FORWARD] * f0 - v) / words[LAG]
    if abs(torque) <= words[TORQUE]:
        m_next, v_next = _loop(words, m, v, r0, f0, r, f)
        answer, push = words[FORCE], words[FORCE + 1]
    else:
        torque = math.copysign(words[TORQUE], torque)
        answer, push = words[COAST_FORCE], words[COAST_FORCE + 1]
        m_next = m + words[COAST] * v + answer * torque
        v_next = words[COAST + 1] * v + push * torque
    level = words[COULOMB]
    if words[EXCESS] > 0.0:
        level += words[EXCESS] * math.exp(-((v / words[STRIBECK]) ** 2))
    # Friction takes velocity, never more than there is: so an axis sticks without chatter.
    if abs(v_next) <= push * level:
        if v == 0.0:
            return m, 0.0
        return m_next - answer * v_next / push, 0.0
    force = math.copysign(level, v_next)
    return m_next - answer * force, v_next - push * force


@njit(cache=True, nogil=True)
def follow_all(
    words: FloatArray, setpoints: FloatArray, rates: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Advance all axes, whose ``words`` change, over setpoints and rates (K, n_axes) [m, rad]."""
    x, v = np.empty_like(setpoints), np.empty_like(setpoints)
    for j in range(setpoints.shape[1]):
        for i in range(len(setpoints)):
            x[i, j], v[i, j] = follow(words[j], setpoints[i, j], rates[i, j])
    return x, v


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def follow_once(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Advance all axes by one period; see ``drives.CycleDrives``. Word 0 is the words per axis."""
    count = int(carray(pointer(memory), 1)[0])
    words = carray(pointer(memory + 8), (n, count))
    wanted, actual = carray(pointer(setpoint), (2, n)), carray(pointer(feedback), (2, n))
    for j in range(n):
        x, v = follow(words[j], wanted[0, j], wanted[1, j])
        actual[0, j], actual[1, j] = x, v
    return 0
