"""The table from which kernels read the limits of the axes; ``Limits.table`` makes it.

Each limit of an axis is piecewise linear between a few positions, and constant beyond the first
and the last. An axis with constant limits has one position. The table has the shape
(7, n_axes, m): rows ``VELOCITY``, ``ACCELERATION``, ``JERK`` hold the limits at the m positions
of row ``PLACE`` [m or rad, per s, s2, s3]. Axes with fewer positions are padded with infinite
ones. With m = 1 all limits are constants.

The drive of an axis may also have a largest torque (or force) T, which inertia J, viscous friction
B and Coulomb friction C must not exceed together:

    |J q_ddot + B q_dot + C sign(q_dot)| <= T

Divided by J, rows ``DRIVE``, ``COULOMB`` and ``VISCOUS`` hold T/J, C/J and B/J [m or rad per s2,
the same, 1/s]. ``DRIVE`` is infinite where the axis has no such limit.
"""

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit

VELOCITY, ACCELERATION, JERK, PLACE, DRIVE, COULOMB, VISCOUS = range(7)

FAR = 1e300  #: Beyond every position; infinite positions would give no difference [m or rad].


def has_loads(table: FloatArray) -> bool:
    return bool(np.isfinite(table[DRIVE]).any())


@njit(cache=True, nogil=True, error_model='numpy')
def acceleration_room(
    table: FloatArray, axis: int, q: float, velocity: float
) -> tuple[float, float]:
    """Return the largest acceleration of an axis in the direction of its velocity, and against."""
    most = limit_at(table, ACCELERATION, axis, q)
    drive = table[DRIVE, axis, 0]
    if drive == np.inf:
        return most, most
    friction = table[COULOMB, axis, 0] + table[VISCOUS, axis, 0] * abs(velocity)
    return min(most, drive - friction), min(most, drive + friction)


@njit(cache=True, nogil=True, error_model='numpy')
def limit_at(table: FloatArray, row: int, axis: int, q: float) -> float:
    """Return one limit of an axis at a position [m or rad]."""
    last = table.shape[2] - 1
    if last == 0:
        return float(table[row, axis, 0])
    i = 0
    while i + 1 < last and q >= table[PLACE, axis, i + 1]:
        i += 1
    start = table[PLACE, axis, i]
    share = (q - start) / (table[PLACE, axis, i + 1] - start)
    share = min(max(share, 0.0), 1.0)
    first = table[row, axis, i]
    return float(first + share * (table[row, axis, i + 1] - first))


def limits_along(table: FloatArray, q: FloatArray) -> FloatArray:
    """Return all limits at positions (K, n_axes): (3, K, n_axes), or (3, 1, n_axes)."""
    if table.shape[2] == 1:
        return np.ascontiguousarray(table[:PLACE].transpose(0, 2, 1))
    return _along(table, np.ascontiguousarray(q))


@njit(cache=True, nogil=True, error_model='numpy')
def _along(table: FloatArray, q: FloatArray) -> FloatArray:
    out = np.empty((3, q.shape[0], q.shape[1]))
    for row in range(3):
        for i in range(q.shape[0]):
            for axis in range(q.shape[1]):
                out[row, i, axis] = limit_at(table, row, axis, q[i, axis])
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def largest_between(table: FloatArray, row: int, axis: int, low: float, high: float) -> float:
    largest = limit_at(table, row, axis, low)
    if table.shape[2] > 1:
        largest = max(largest, limit_at(table, row, axis, high))
        for i in range(1, table.shape[2]):
            if low < table[PLACE, axis, i] < high:
                largest = max(largest, table[row, axis, i])
    return float(largest)
