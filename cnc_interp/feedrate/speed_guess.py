"""A first guess of the speed, from one forward and one backward pass.

Under a jerk limit J, v^(3/2) grows at most linearly along the path: from rest s = J t^3/6 and
v = J t^2/2 give v^(3/2) = 3 sqrt(J/2) s. The guess grows at half that slope. It serves two
purposes: it shows where time is spent, and it is the starting point of the interior point method.
"""

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core import limit_kernels as by_place
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_jet

FASTEST = 100.0  #: Speed limit where no other limit applies [m/s].


@njit(cache=True, nogil=True, error_model='numpy')
def _lowest(table: FloatArray, row: int, axis: int, q0: float, q1: float, q2: float) -> float:
    lowest = by_place.limit_at(table, row, axis, q0)
    if table.shape[2] > 1:
        lowest = min(
            lowest,
            by_place.limit_at(table, row, axis, q1),
            by_place.limit_at(table, row, axis, q2),
        )
    return float(lowest)


@njit(cache=True, nogil=True, error_model='numpy')
def speed_bounds(
    h: FloatArray, left: FloatArray, right: FloatArray, feed: FloatArray, table: FloatArray
) -> FloatArray:
    """Return six bounds of the motion in each cell, (n, 6), from its two ends and its middle.

    Speed by feed and axis velocities, speed by Eq. 10, largest tangential acceleration and jerk;
    then the first one at the left and at the right end alone.
    """
    n, n_axes = len(h), left.shape[2]
    out = np.empty((n, 6))
    c = np.empty(8)
    for i in range(n):
        fast = min(feed[i], FASTEST)
        acceleration, jerk = 1e12, 1e12
        by_second, by_third = np.inf, np.inf
        first, last = fast, fast
        for k in range(n_axes):
            septic_coefficients(left[:, i, k], right[:, i, k], h[i], c)
            q1, q_s, q_ss, q_sss = septic_jet(c, 0.5, h[i])
            begin, middle, end = abs(left[1, i, k]), abs(q_s), abs(right[1, i, k])
            if middle > max(begin, end):
                begin = end = middle
            q_s = max(begin, end)
            q_ss = max(abs(left[2, i, k]), abs(right[2, i, k]), abs(q_ss))
            q_sss = max(abs(left[3, i, k]), abs(right[3, i, k]), abs(q_sss))
            q0, q2 = left[0, i, k], right[0, i, k]
            largest_a = _lowest(table, by_place.ACCELERATION, k, q0, q1, q2)
            largest_a = min(largest_a, table[by_place.DRIVE, k, 0] - table[by_place.COULOMB, k, 0])
            largest_j = _lowest(table, by_place.JERK, k, q0, q1, q2)
            if q_s > 0.0:
                fast = min(fast, _lowest(table, by_place.VELOCITY, k, q0, q1, q2) / q_s)
                first = min(first, by_place.limit_at(table, by_place.VELOCITY, k, q0) / begin)
                last = min(last, by_place.limit_at(table, by_place.VELOCITY, k, q2) / end)
                acceleration = min(acceleration, largest_a / q_s)
                jerk = min(jerk, largest_j / q_s)
            if q_ss > 0.0:
                by_second = min(by_second, largest_a / q_ss)
            if q_sss > 0.0:
                by_third = min(by_third, largest_j / q_sss)
        slow = min(fast, np.sqrt(by_second), by_third ** (1 / 3))
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = fast, slow, acceleration, jerk
        out[i, 4], out[i, 5] = first, last
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def reach(v: float, distance: float, acceleration: float, jerk: float) -> float:
    """Guess the speed after a distance [m/s]; v^(3/2) grows at half the slope of full jerk."""
    by_jerk = (v**1.5 + 1.06 * np.sqrt(jerk) * distance) ** (2 / 3)
    return float(min(by_jerk, np.sqrt(v * v + 1.4 * acceleration * distance)))


@njit(cache=True, nogil=True, error_model='numpy')
def guess_speed(h: FloatArray, bounds: FloatArray, v_start: float, a_start: float) -> FloatArray:
    """Guess a reachable s_dot, below 0.9 of Eq. 10, at the nodes of a path that ends at rest."""
    n = len(h)
    v = np.empty(n + 1)
    v[0] = v_start
    for i in range(n):
        v[i + 1] = min(0.9 * bounds[i, 1], reach(v[i], h[i], bounds[i, 2], bounds[i, 3]))
        if i + 1 < n:
            v[i + 1] = min(v[i + 1], 0.9 * bounds[i + 1, 1])
    v[n] = 0.0
    for i in range(n - 1, 0, -1):
        v[i] = min(v[i], reach(v[i + 1], h[i], bounds[i, 2], bounds[i, 3]))
    # The start state may be too fast for this guess: never guess less than full braking reaches.
    speed, a = v_start, a_start
    for i in range(n - 1):
        t = h[i] / speed if speed > 0.0 else np.inf
        a = max(a - bounds[i, 3] * t, -bounds[i, 2])
        speed += a * t
        if not speed > v[i + 1]:
            break
        v[i + 1] = speed
    return v


@njit(cache=True, nogil=True, error_model='numpy')
def speed_inside(
    x: float, h: float, v0: float, v1: float, bound: FloatArray
) -> tuple[float, bool]:
    # The smaller one of ``reach`` from both ends, with one power and one root.
    rise, growth = 1.06 * np.sqrt(bound[3]), 1.4 * bound[2]
    by_jerk = min(v0**1.5 + rise * x, v1**1.5 + rise * (h - x)) ** (2 / 3)
    ramp = min(by_jerk, np.sqrt(min(v0 * v0 + growth * x, v1 * v1 + growth * (h - x))))
    cap = 0.9 * bound[1]
    return min(ramp, cap), ramp > cap


@njit(cache=True, nogil=True, error_model='numpy')
def speeds_inside(
    h: FloatArray, v: FloatArray, bounds: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Guess the speed in the middle of each cell, and whether the ramps reach the cap there."""
    speed, capped = np.empty(len(h)), np.empty(len(h), np.bool_)
    for i in range(len(h)):
        speed[i], capped[i] = speed_inside(h[i] / 2, h[i], v[i], v[i + 1], bounds[i])
    return speed, capped


@njit(cache=True, nogil=True, error_model='numpy')
def guess_time(h: FloatArray, v: FloatArray, inside: FloatArray) -> float:
    total = 0.0
    for i in range(len(h)):
        for end in (v[i], v[i + 1]):
            factor = 1.5 if end == 0.0 else 1.0
            total += factor * h[i] / (end + inside[i])
    return total
