"""The time that no motion within programmed feed, velocities and accelerations can beat.

The jerk is free here, and every limit is applied in a form that each real motion keeps. So the
squared speed b = s_dot^2 of a real motion stays below the ceiling, and its time above the bound.
Per axis, with q_dot = q_s s_dot:

    at a point         |q_dot| <= V, and one s_ddot with |q_s s_ddot + q_ss b| <= A for all axes
    from s_0 to s_1    |q_dot(s_1)^2 - q_dot(s_0)^2| <= 2 A w, where w is the way of the axis
    time from s_0      h / F, and the time of each axis alone over its distance with V and A, as
    to s_1             fast at both ends as the ceiling allows

The second line is the integral of d(q_dot^2) = 2 q_ddot dq. It holds for steps of any length.
So TOPP-RA may take every third node, and the result is still a bound. Where limits depend on the
position, the second and third line take the largest V and A in each cell.
"""

from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core import limit_kernels as by_place
from cnc_interp.core.kernels import njit
from cnc_interp.feedrate.speed_guess import FASTEST
from cnc_interp.kinematics.axis_path import AxisPath, septic_coefficients, septic_jet

STEP = 3  #: Number of planner cells in one step of TOPP-RA.
ROOM = 1e-9  #: Part of the largest b by which a step may miss its rows without being solved [-].
ROUNDING = 4e-16  #: Rounding of a difference of two positions, relative to them [-].


class TimeBound(NamedTuple):
    """Ceiling and bound along a path of N cells."""

    squared: FloatArray  #: (N + 1,): Largest possible s_dot^2 at the grid points [m2/s2].
    time: FloatArray  #: (N,): Least time in each cell [s].


@njit(cache=True, nogil=True, error_model='numpy')
def _ways(h: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    n, n_axes = len(h), left.shape[2]
    ways = np.empty((n, n_axes))
    c = np.empty(8)
    for i in range(n):
        for k in range(n_axes):
            first, last = left[1, i, k], right[1, i, k]
            here, there = left[0, i, k], right[0, i, k]
            ways[i, k] = abs(there - here) + ROUNDING * max(abs(here), abs(there))
            septic_coefficients(left[:, i, k], right[:, i, k], h[i], c)
            middle = septic_jet(c, 0.5, h[i])[1]
            if min(first, last, middle) < 0.0 < max(first, last, middle):
                ways[i, k] = h[i] * max(abs(first), abs(last), abs(middle))
    return ways


@njit(cache=True, nogil=True, error_model='numpy')
def _largest_limits(left: FloatArray, right: FloatArray, table: FloatArray) -> FloatArray:
    n, n_axes = left.shape[1], left.shape[2]
    out = np.empty((2, n, n_axes))
    for i in range(n):
        for k in range(n_axes):
            low, high = left[0, i, k], right[0, i, k]
            if low > high:
                low, high = high, low
            if left[1, i, k] * right[1, i, k] <= 0.0:
                low, high = -by_place.FAR, by_place.FAR  # the axis may turn round inside the cell
            for row in (by_place.VELOCITY, by_place.ACCELERATION):
                out[row, i, k] = by_place.largest_between(table, row, k, low, high)
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def _point_cap(q: FloatArray, q_s: FloatArray, q_ss: FloatArray, table: FloatArray) -> float:
    """Return the largest s_dot^2 at a point: velocities, and accelerations for the best s_ddot.

    Each axis leaves an interval of s_ddot. All have a common point if any two of them have. Two
    axes i and k have one if b |q_ss_i q_s_k - q_ss_k q_s_i| <= A_i |q_s_k| + A_k |q_s_i|.
    """
    cap = FASTEST * FASTEST
    for i in range(len(q_s)):
        if q_s[i] != 0.0:
            cap = min(cap, (by_place.limit_at(table, by_place.VELOCITY, i, q[i]) / q_s[i]) ** 2)
        for k in range(i):
            crossed = abs(q_ss[i] * q_s[k] - q_ss[k] * q_s[i])
            if crossed > 0.0:
                room = by_place.limit_at(table, by_place.ACCELERATION, i, q[i]) * abs(q_s[k])
                room += by_place.limit_at(table, by_place.ACCELERATION, k, q[k]) * abs(q_s[i])
                cap = min(cap, room / crossed)
    return cap


@njit(cache=True, nogil=True, error_model='numpy')
def _point_caps(
    left: FloatArray, right: FloatArray, feed: FloatArray, table: FloatArray
) -> FloatArray:
    """Return the largest s_dot^2 at the grid points, shape (n + 1,) [m2/s2]."""
    n = len(feed)
    caps = np.full(n + 1, FASTEST * FASTEST)
    for i in range(n):
        tip = feed[i] * feed[i]
        caps[i] = min(caps[i], tip, _point_cap(left[0, i], left[1, i], left[2, i], table))
        caps[i + 1] = min(
            caps[i + 1], tip, _point_cap(right[0, i], right[1, i], right[2, i], table)
        )
    return caps


@njit(cache=True, nogil=True, error_model='numpy')
def _reach(b: float, q_s: float, q_s_there: float, room: float) -> float:
    there = q_s_there * q_s_there
    return (q_s * q_s * b + room) / there if there > 0.0 else np.inf


@njit(cache=True, nogil=True, error_model='numpy')
def _both_passes(left: FloatArray, right: FloatArray, rooms: FloatArray, b: FloatArray) -> None:
    """Lower b at the grid points to what can be reached from both sides, in place."""
    n, n_axes = rooms.shape
    for i in range(n):
        for k in range(n_axes):
            b[i + 1] = min(b[i + 1], _reach(b[i], left[1, i, k], right[1, i, k], rooms[i, k]))
    for i in range(n - 1, -1, -1):
        for k in range(n_axes):
            b[i] = min(b[i], _reach(b[i + 1], right[1, i, k], left[1, i, k], rooms[i, k]))


@njit(cache=True, nogil=True, error_model='numpy')
def stroke_time(
    distance: float, start: float, end: float, velocity: float, acceleration: float
) -> float:
    if not distance > 0.0:
        return 0.0
    rise = 2 * acceleration * distance
    start = min(start, velocity**2, end + rise)
    end = min(end, velocity**2, start + rise)
    peak = min((start + end + rise) / 2, velocity**2)
    fast = np.sqrt(peak)
    time = (peak - start) / (fast + np.sqrt(start)) + (peak - end) / (fast + np.sqrt(end))
    steady = max(0.0, distance - (2 * peak - start - end) / (2 * acceleration))
    return float(time / acceleration + steady / fast)


@njit(cache=True, nogil=True, error_model='numpy')
def _least_times(
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    feed: FloatArray,
    largest: FloatArray,
    b: FloatArray,
) -> FloatArray:
    n, n_axes = len(feed), left.shape[2]
    time = np.empty(n)
    for i in range(n):
        time[i] = (s[i + 1] - s[i]) / feed[i]
        for k in range(n_axes):
            distance = abs(right[0, i, k] - left[0, i, k])
            start, end = left[1, i, k] ** 2 * b[i], right[1, i, k] ** 2 * b[i + 1]
            alone = stroke_time(distance, start, end, largest[0, i, k], largest[1, i, k])
            time[i] = max(time[i], alone)
    return time


@njit(cache=True, nogil=True, error_model='numpy')
def _step_rows(
    points: IntArray, left: FloatArray, right: FloatArray, ways: FloatArray, largest: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return q_s^2 / (2 A w) at both ends of the steps between some grid points."""
    n, n_axes = len(points) - 1, ways.shape[1]
    start, end = np.zeros((n, n_axes)), np.zeros((n, n_axes))
    for i in range(n):
        first, last = points[i], points[i + 1]
        for k in range(n_axes):
            room = 2 * largest[1, first:last, k].max() * ways[first:last, k].sum()
            if room > 0.0:
                start[i, k] = left[1, first, k] ** 2 / room
                end[i, k] = right[1, last - 1, k] ** 2 / room
    return start, end


@njit(cache=True, nogil=True, error_model='numpy')
def _last_conflict(
    start: FloatArray, end: FloatArray, b: FloatArray, room: float, last: int
) -> int:
    """Return the last step up to ``last`` that no b at its end allows from its b; -1 if none."""
    for i in range(last, -1, -1):
        low, high = 0.0, b[i + 1]
        for k in range(start.shape[1]):
            from_here = start[i, k] * b[i]
            if end[i, k] > 0.0:
                low = max(low, (from_here - 1.0) / end[i, k])
                high = min(high, (from_here + 1.0) / end[i, k])
            elif from_here > 1.0:
                return i
        if low > high + room:
            return i
    return -1


@njit(cache=True, nogil=True, error_model='numpy')
def _ceiling(
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    feed: FloatArray,
    table: FloatArray,
    nodes: IntArray,
    start: float,
    rests: bool,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray]:
    """Return b by the first two lines, the largest limits and rooms; TOPP-RA's points and rows."""
    largest = _largest_limits(left, right, table)
    ways = _ways(s[1:] - s[:-1], left, right)
    rooms = 2 * largest[1] * ways
    b = _point_caps(left, right, feed, table)
    b[0] = min(b[0], start)
    if rests:
        b[-1] = 0.0
    _both_passes(left, right, rooms, b)
    points = np.append(nodes[:-1:STEP], nodes[-1])
    return b, largest, rooms, points, *_step_rows(points, left, right, ways, largest)


def _controllable(start: FloatArray, end: FloatArray, cap: FloatArray) -> FloatArray:
    """Return the largest b from which the rest can be driven (TOPP-RA); toppra for few steps."""
    found, room, last = cap.copy(), ROOM * float(cap.max()), len(start) - 1
    solver = None
    while (last := _last_conflict(start, end, found, room, last)) >= 0:
        if solver is None:
            from cnc_interp.feedrate.backward_pass import BackwardPass

            solver = BackwardPass(start, end, cap)
        found[last] = solver.largest(last, float(found[last + 1]))
        last -= 1
    return found


def time_bound(
    path: AxisPath, nodes: IntArray, table: FloatArray, start: float, rests: bool
) -> TimeBound:
    """Compute the ceiling of the speed along a path and the least time in its cells."""
    curve = path.s, path.cell_left, path.cell_right, path.cell_feed
    b, largest, rooms, points, first, last = _ceiling(*curve, table, nodes, start, rests)
    b[points] = _controllable(first, last, b[points])
    _both_passes(path.cell_left, path.cell_right, rooms, b)
    return TimeBound(b, _least_times(*curve, largest, b))
