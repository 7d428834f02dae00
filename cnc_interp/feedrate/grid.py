"""
The planner's grid: where to put nodes so that a few constant-jerk cells come close to the optimum.

A first guess of the speed costs one pass each way: under a jerk limit v^(3/2) grows at most
linearly along the path (from rest, s = J t^3/6 and v = J t^2/2 give v^(3/2) = 3 sqrt(J/2) s).
Cells that take more time than wanted under this guess are subdivided, evenly in time; in steady
cruise the cells may grow.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.kinematics.axis_path import AxisPath, refine, septic_coefficients, septic_value
from cnc_interp.program.blocks import FloatArray

SAMPLES = 96
"""Points at which a cell to be subdivided is looked at."""

GROWTH = 0.15
"""Growth of cells in steady cruise, per cell."""

ROUNDS = 3
"""Most rounds of guessing and refining."""

FASTEST = 100.0
"""Speed cap where nothing else limits [m/s]."""


@numba.njit(cache=True)
def speed_bounds(
    h: FloatArray, left: FloatArray, right: FloatArray, feed: FloatArray, table: FloatArray
) -> FloatArray:
    """
    Bounds of each cell from both ends and the middle.

    Returns
    -------
    ndarray, shape (n, 4)
        Speed limit by feed and velocity [m/s], the same with Eq. 10 [m/s], largest tangential
        acceleration [m/s2] and jerk [m/s3].

    """
    n, n_axes = len(h), left.shape[2]
    out = np.empty((n, 4))
    c, jet = np.empty(8), np.empty(4)
    for i in range(n):
        fast = min(feed[i], FASTEST)
        slow, acceleration, jerk = fast, 1e12, 1e12
        for k in range(n_axes):
            septic_coefficients(left[:, i, k], right[:, i, k], h[i], c)
            septic_value(c, 0.5, h[i], jet)
            q_s = max(abs(left[1, i, k]), abs(right[1, i, k]), abs(jet[1]))
            q_ss = max(abs(left[2, i, k]), abs(right[2, i, k]), abs(jet[2]))
            q_sss = max(abs(left[3, i, k]), abs(right[3, i, k]), abs(jet[3]))
            if q_s > 0.0:
                fast = min(fast, table[0, k] / q_s)
                acceleration = min(acceleration, table[1, k] / q_s)
                jerk = min(jerk, table[2, k] / q_s)
            if q_ss > 0.0:
                slow = min(slow, np.sqrt(table[1, k] / q_ss))
            if q_sss > 0.0:
                slow = min(slow, (table[2, k] / q_sss) ** (1 / 3))
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = fast, min(fast, slow), acceleration, jerk
    return out


@numba.njit(cache=True)
def reach(v: float, distance: float, acceleration: float, jerk: float) -> float:
    """Speed after a distance at half the jerk's and most of the acceleration's growth."""
    by_jerk = (v**1.5 + 1.06 * np.sqrt(jerk) * distance) ** (2 / 3)
    return min(by_jerk, np.sqrt(v * v + 1.4 * acceleration * distance))


@numba.njit(cache=True)
def guess_speed(h: FloatArray, bounds: FloatArray, v_start: float, v_end: float) -> FloatArray:
    """Guess the speed at the nodes: 0.9 of Eq. 10, and reachable from both sides."""
    n = len(h)
    v = np.empty(n + 1)
    v[0] = v_start
    for i in range(n):
        v[i + 1] = min(0.9 * bounds[i, 1], reach(v[i], h[i], bounds[i, 2], bounds[i, 3]))
        if i + 1 < n:
            v[i + 1] = min(v[i + 1], 0.9 * bounds[i + 1, 1])
    v[n] = min(v[n], v_end)
    for i in range(n - 1, 0, -1):
        v[i] = min(v[i], reach(v[i + 1], h[i], bounds[i, 2], bounds[i, 3]))
    return v


@numba.njit(cache=True)
def speed_inside(
    x: float, h: float, v0: float, v1: float, bound: FloatArray
) -> tuple[float, bool]:
    """Guess the speed within a cell, and tell whether it cruises at its cap there."""
    ramp = min(reach(v0, x, bound[2], bound[3]), reach(v1, h - x, bound[2], bound[3]))
    cap = 0.9 * bound[1]
    return min(ramp, cap), ramp > cap


@numba.njit(cache=True)
def cell_nodes(
    h: float,
    v0: float,
    v1: float,
    bound: FloatArray,
    tau: float,
    least: float,
    out: FloatArray,
) -> int:
    """Write the inner nodes of one cell, even in time, but ``least`` cells; returns how many."""
    x, count = np.empty(SAMPLES + 1), np.zeros(SAMPLES + 1)
    time, cruise = np.zeros(SAMPLES + 1), np.zeros(SAMPLES + 1, dtype=np.bool_)
    speed = np.empty(SAMPLES + 1)
    for p in range(SAMPLES + 1):
        u = p / SAMPLES
        x[p] = h * u**3 / (u**3 + (1 - u) ** 3)
        speed[p], cruise[p] = speed_inside(x[p], h, v0, v1, bound)
    for p in range(SAMPLES):
        factor = 3.0 if speed[p] == 0.0 or speed[p + 1] == 0.0 else 2.0
        time[p + 1] = time[p] + factor * (x[p + 1] - x[p]) / (speed[p] + speed[p + 1])
    first, last = SAMPLES, 0
    for p in range(SAMPLES + 1):
        if cruise[p]:
            first, last = min(first, p), max(last, p)
    for p in range(SAMPLES):
        middle = (time[p] + time[p + 1]) / 2
        away = max(0.0, min(middle - time[first], time[last] - middle)) if last > first else 0.0
        by_time = (time[p + 1] - time[p]) / (tau + GROWTH * away)
        count[p + 1] = count[p] + max(by_time, least * (x[p + 1] - x[p]) / h)
    cells = int(np.ceil(count[SAMPLES]))
    cells = min(max(cells, 1), len(out) + 1)
    p = 0
    for c in range(1, cells):
        wanted = count[SAMPLES] * c / cells
        while count[p + 1] < wanted:
            p += 1
        share = (wanted - count[p]) / (count[p + 1] - count[p])
        if p == 0 and v0 == 0.0:
            share = share**3
        out[c - 1] = x[p] + share * (x[p + 1] - x[p])
    return cells - 1


@numba.njit(cache=True)
def bend(left: FloatArray, right: FloatArray, h: float, v: float, table: FloatArray) -> float:
    """
    Measure how far one cell is from rows that are linear along it, relative to the limits.

    That much a limit may be passed between two nodes that keep it.
    """
    worst = 0.0
    c, jet = np.empty(8), np.empty(4)
    for k in range(left.shape[1]):
        septic_coefficients(left[:, k], right[:, k], h, c)
        if c[3] == 0.0 and c[4] == 0.0 and c[5] == 0.0 and c[6] == 0.0 and c[7] == 0.0:
            continue
        by_jerk, by_acceleration = v**3 / table[2, k], v**2 / table[1, k]
        for p in range(1, 8):
            u = p / 8
            septic_value(c, u, h, jet)
            straight = left[3, k] + u * (right[3, k] - left[3, k])
            worst = max(worst, abs(jet[3] - straight) * by_jerk)
            straight = left[2, k] + u * (right[2, k] - left[2, k])
            worst = max(worst, abs(jet[2] - straight) * by_acceleration)
    return worst


@numba.njit(cache=True)
def grid_nodes(
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    bounds: FloatArray,
    v: FloatArray,
    tau: float,
    most_bend: float,
    whole: int,
) -> FloatArray:
    """Write the new nodes of all cells from ``whole`` on; cells before it stay as they are."""
    n = len(bounds)
    found = np.empty(4096)
    total = 0
    inner = np.empty(2048)
    for i in range(whole, n):
        h = s[i + 1] - s[i]
        slowest = min(v[i], v[i + 1])
        # the guess is slower than the law by up to 2^(2/3) on ramps
        fastest = speed_inside(h / 2, h, v[i], v[i + 1], bounds[i])[0]
        fastest = min(1.5 * max(fastest, max(v[i], v[i + 1])), bounds[i, 1])
        by_bend = np.sqrt(bend(left[:, i], right[:, i], h, fastest, table) / most_bend)
        new = 0
        if by_bend > 1.0 or not (slowest > 0.0 and h < slowest * tau):
            least = by_bend if by_bend > 1.0 else 0.0
            new = cell_nodes(h, v[i], v[i + 1], bounds[i], tau, least, inner)
        if total + new > len(found):
            larger = np.empty(2 * len(found) + new)
            larger[:total] = found[:total]
            found = larger
        for c in range(new):
            found[total + c] = s[i] + inner[c]
        total += new
    return found[:total].copy()


@numba.njit(cache=True)
def guess_time(h: FloatArray, v: FloatArray, bounds: FloatArray) -> float:
    """Guess the duration of the motion [s]."""
    total = 0.0
    for i in range(len(h)):
        middle = speed_inside(h[i] / 2, h[i], v[i], v[i + 1], bounds[i])[0]
        for end in (v[i], v[i + 1]):
            factor = 1.5 if end == 0.0 else 1.0
            total += factor * h[i] / (end + middle)
    return total


def planning_grid(
    path: AxisPath,
    table: FloatArray,
    v_start: float,
    cell_time: tuple[float, float],
    share: float,
    most_bend: float,
    whole: int = 0,
) -> AxisPath:
    """
    Refine a path that ends at rest to the planner's grid.

    Parameters
    ----------
    path : AxisPath
        Path without inner stops.
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits.
    v_start : float
        Speed at its start [m/s].
    cell_time : tuple of float
        Shortest and longest time wanted for a cell [s].
    share : float
        Time wanted for a cell as a share of the whole motion's.
    most_bend : float
        Cells are subdivided until no limit is passed by more than about this part inside them.
    whole : int
        The first cells, which stay as they are.

    Returns
    -------
    AxisPath
        The same curve on the planner's grid.

    """
    for attempt in range(ROUNDS):
        h = np.diff(path.s)
        bounds = speed_bounds(h, path.cell_left, path.cell_right, path.cell_feed, table)
        v = guess_speed(h, bounds, v_start, 0.0)
        tau = min(max(share * guess_time(h, v, bounds), cell_time[0]), cell_time[1])
        # later rounds see what the first guess was too coarse for, not its own rounding up
        ease = 1.0 if attempt == 0 else 1.6
        nodes = grid_nodes(
            path.s,
            path.cell_left,
            path.cell_right,
            table,
            bounds,
            v,
            ease * tau,
            ease**2 * most_bend,
            whole,
        )
        if len(nodes) == 0:
            break
        path = refine(path, nodes)
    return path
