"""
One period of a simulated drive, compiled. ``drive_model.py`` has the equations.

Each axis has a row of words: what ``drive_model.py`` computed, the state, and the last setpoints.
"""

from __future__ import annotations

import math

import numpy as np
from numba import carray, cfunc, njit, types

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.native import pointer

#: Words of an axis. Substeps of a period; 0 where one exact step does for all of it.
SUBSTEPS = 0
#: One step of the loops: transition, held and rising, 2 x 2 each; answer to a constant force.
LOOP, FORCE = 1, 13
#: One step at the largest torque: of position and velocity by velocity, and answer to a force.
COAST, COAST_FORCE = 15, 17
#: Gain, feed-forward, lag.
GAIN, FEED_FORWARD, LAG = 19, 20, 21
#: Over the inertia: largest torque, Coulomb friction, excess of the friction at rest. And the
#: velocity of Stribeck.
TORQUE, COULOMB, EXCESS, STRIBECK = 22, 23, 24, 25
#: Half of the backlash; whether there is a mode, and its step, 2 x 2; resolution.
HALF_PLAY, HAS_MODE, MODE, RESOLUTION = 26, 27, 28, 32
#: Delay in periods; steps in a second.
DELAY, RATE = 33, 34
#: State: position and velocity of the motor, position after the play, position of the table and
#: its way per step.
MOTOR, MOTOR_VELOCITY, PLAY, TABLE, TABLE_WAY = 35, 36, 37, 38, 39
#: The setpoints, the newest first: position and velocity of each.
RING = 40


@njit(cache=True, nogil=True)
def follow(words: FloatArray, setpoint: float, rate: float) -> tuple[float, float]:
    """Advance one axis by one period."""
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
        r0 + words[LOOP] * gap + words[LOOP + 1] * v
        + words[LOOP + 5] * f0 + words[LOOP + 8] * dr + words[LOOP + 9] * df
    )  # fmt: skip
    velocity = (
        words[LOOP + 2] * gap + words[LOOP + 3] * v
        + words[LOOP + 7] * f0 + words[LOOP + 10] * dr + words[LOOP + 11] * df
    )  # fmt: skip
    return position, velocity


@njit(cache=True, nogil=True)
def _move_motor(
    words: FloatArray, m: float, v: float, r0: float, f0: float, r: float, f: float
) -> tuple[float, float]:
    """Advance the motor by one step, with its largest torque and its friction."""
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
    """
    Advance all axes over rows of setpoints.

    Parameters
    ----------
    words : ndarray, shape (n_axes, n_words)
        Words of each axis; their state is changed.
    setpoints, rates : ndarray, shape (K, n_axes)
        Setpoints at the end of each period and their velocities [m, rad, per s].

    Returns
    -------
    position, velocity : ndarray, shape (K, n_axes)
        Axes as measured at the end of each period [m, rad, per s].

    """
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
