"""
The fastest stop along the path that can be found at once, from any state of the motion.

Two ways. The first is closed-form: s_dddot = -J, 0, +J until speed and acceleration vanish
together, with

    a_p^2 = J v + a^2/2         (largest deceleration; A at most, held for a while then)

slower and slower until the axes keep their limits all along it, which is seen on the true curve.
Lines, gentle curves and the ways out of corners are stopped like that in a fraction of a
millisecond. Where the axes bend harder, the jerk stage plans from the state to rest at a point
ahead; it costs some milliseconds and is asked only where the first way has failed for a while.
Neither may find anything: then the motion goes on as planned and stops a little later.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.feedrate.jerk_stage import PlanOptions, plan
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.stretch import spread
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.kinematics.axis_path import (
    AxisPath,
    cut,
    refine,
    septic_coefficients,
    septic_value,
)

SPACING = 5e-4
"""Time between the instants at which the closed-form stop is checked [s]."""

ACCEPTED = 1.0 - 1e-4
"""Largest use of a limit that counts as kept."""

SLOWER = tuple(0.998 * 0.93**k for k in range(12))
"""Time scales tried: J falls with the third power, A with the second."""

FARTHER = (1.0, 1.5, 2.2)
"""Stopping points tried by the jerk stage, in straight stopping distances."""

LONGEST = 3.0
"""A stop that takes longer is none [s]."""

STOP_OPTIONS = PlanOptions(passes=3)


@numba.njit(cache=True, nogil=True)
def stop_phases(v: float, a: float, acceleration: float, jerk: float, out: FloatArray) -> bool:
    """
    Write the durations of the phases -J, 0, +J of a stop; False where there is none.

    There is none where the deceleration cannot be taken back before the speed is gone.
    """
    if v <= 0.0 or (a < 0.0 and 2 * jerk * v < a * a):
        return False
    peak = np.sqrt(jerk * v + a * a / 2)
    out[1] = 0.0
    if peak > acceleration:
        peak = max(acceleration, -a)
        out[1] = (v + (a * a - 2 * peak * peak) / (2 * jerk)) / peak
    out[0], out[2] = (a + peak) / jerk, peak / jerk
    return bool(out[1] >= 0.0 and out[0] >= 0.0)


@numba.njit(cache=True, nogil=True)
def stop_states(v: float, a: float, jerk: float, duration: FloatArray, out: FloatArray) -> None:
    """Write s, s_dot and s_ddot at the four ends of the phases, shape (4, 3), s from 0."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, v, a
    for k in range(3):
        j, t = (k - 1) * jerk, duration[k]
        s, speed, pull = out[k]
        out[k + 1, 0] = s + t * (speed + t * (pull / 2 + t * j / 6))
        out[k + 1, 1] = speed + t * (pull + t * j / 2)
        out[k + 1, 2] = pull + t * j
    out[3, 1], out[3, 2] = 0.0, 0.0


@numba.njit(cache=True, nogil=True)
def stop_use(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    start: float,
    states: FloatArray,
    duration: FloatArray,
    jerk: float,
    table: FloatArray,
) -> float:
    """Evaluate the largest use of any limit along a stop; beyond ACCEPTED it may be any."""
    n_axes = left.shape[2]
    coefficients, jet = np.empty((n_axes, 8)), np.empty(4)
    worst, cell, known = 0.0, 0, -1
    for phase in range(3):
        steps = int(np.ceil(duration[phase] / SPACING))
        j = (phase - 1) * jerk
        for k in range(steps + 1):
            t = duration[phase] * k / max(steps, 1)
            v = states[phase, 1] + t * (states[phase, 2] + t * j / 2)
            a = states[phase, 2] + t * j
            s = states[phase, 0] + t * (states[phase, 1] + t * (states[phase, 2] / 2 + t * j / 6))
            s += start
            while s > s_grid[cell + 1] and cell + 2 < len(s_grid):
                cell += 1
            h = s_grid[cell + 1] - s_grid[cell]
            u = min(max((s - s_grid[cell]) / h, 0.0), 1.0)
            for i in range(n_axes):
                if cell != known:
                    septic_coefficients(left[:, cell, i], right[:, cell, i], h, coefficients[i])
                septic_value(coefficients[i], u, h, jet)
                use = abs(jet[1] * v) / table[0, i]
                use = max(use, abs(jet[2] * v * v + jet[1] * a) / table[1, i])
                third = jet[3] * v**3 + 3 * jet[2] * v * a + jet[1] * j
                worst = max(worst, use, abs(third) / table[2, i])
            known = cell
            if worst > ACCEPTED:
                return worst
    return worst


@numba.njit(cache=True, nogil=True)
def closed_form(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    start: FloatArray,
    table: FloatArray,
    slower: FloatArray,
    duration: FloatArray,
    states: FloatArray,
) -> float:
    """Find the fastest closed-form stop from ``start`` = (s, v, a); returns its J, or 0."""
    acceleration, jerk = 1e12, 1e12
    h = s_grid[1] - s_grid[0]
    u = min(max((start[0] - s_grid[0]) / h, 0.0), 1.0)
    c, jet = np.empty(8), np.empty(4)
    for i in range(left.shape[2]):
        septic_coefficients(left[:, 0, i], right[:, 0, i], h, c)
        septic_value(c, u, h, jet)
        if jet[1] != 0.0:
            acceleration = min(acceleration, table[1, i] / abs(jet[1]))
            jerk = min(jerk, table[2, i] / abs(jet[1]))
    for k in range(len(slower)):
        j, a = jerk * slower[k] ** 3, acceleration * slower[k] ** 2
        if not stop_phases(start[1], start[2], a, j, duration):
            continue
        stop_states(start[1], start[2], j, duration, states)
        if start[0] + states[3, 0] > s_grid[-1]:
            continue
        use = stop_use(s_grid, left, right, start[0], states, duration, j, table)
        if use <= ACCEPTED:
            return float(j)
    return 0.0


def straight_distance(path: AxisPath, v: float, a: float, table: FloatArray) -> float:
    """Estimate the way to rest as if the path went on straight as in its first cell [m]."""
    q_s = np.abs(path.cell_left[1, 0])
    with np.errstate(divide='ignore'):
        acceleration, jerk = (table[1] / q_s).min(), (table[2] / q_s).min()
    return float(v * (np.sqrt(v / jerk) + v / acceleration / 2) + max(a, 0.0) * v / jerk)


def until_rest(path: AxisPath, s: float, v: float, a: float, table: FloatArray) -> AxisPath:
    """Take the part of the path in which a stop can end; it begins with the cell of s."""
    first = int(np.clip(np.searchsorted(path.s, s, side='right') - 1, 0, len(path.s) - 2))
    reach = straight_distance(cut(path, first, first + 1), v, a, table)
    last = int(np.searchsorted(path.s, s + 1.05 * FARTHER[-1] * reach))
    last = min(max(last, first + 1), len(path.s) - 1)
    stops = np.flatnonzero(path.stop[first + 1 : last + 1])
    return cut(path, first, first + 1 + int(stops[0]) if len(stops) else last)


def stop_law(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float,
    thorough: bool,
) -> PlannedPiece | None:  # fmt: skip
    """
    Stop as fast as can be found from a state of the motion.

    Parameters
    ----------
    path : AxisPath
        Path that holds the state and goes on beyond it.
    state : tuple of float
        s, s_dot, s_ddot [m, m/s, m/s2].
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    time : float
        Time of the state on the law's clock [s].
    thorough : bool
        Ask the jerk stage where the closed form finds nothing.

    Returns
    -------
    PlannedPiece or None
        The stop, from the state to rest, within all limits; None where none was found.

    """
    s, v, a = state
    if v <= 0.0:
        return None
    ahead = until_rest(path, s, v, a, table)
    found = quick_stop(ahead, state, table, time)
    return planned_stop(ahead, state, table, time) if found is None and thorough else found


def quick_stop(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float
) -> PlannedPiece | None:
    """Stop in closed form on a path that begins with the cell of the state."""
    duration, states = np.empty(3), np.empty((4, 3))
    jerk = closed_form(
        path.s, path.cell_left, path.cell_right, np.array(state), table, np.array(SLOWER),
        duration, states,
    )  # fmt: skip
    if not jerk > 0.0:
        return None
    kept = np.flatnonzero(duration > 1e-9)
    ends = state[0] + states[np.r_[kept, 3], 0]
    if not len(kept) or (np.diff(ends) <= 1e-13).any():
        return None
    part = between(path, float(ends[0]), float(ends[-1]), ends)
    nodes = np.searchsorted(part.s, ends).astype(np.int64)
    cells = len(part.s) - 1
    v, a = np.empty(cells + 1), np.empty(cells + 1)
    jerks, durations = np.empty(cells), np.empty(cells)
    rows = np.r_[kept, 3]
    spread(part.s, nodes, states[rows, 1], states[rows, 2], duration[kept], v, a, jerks, durations)
    return piece_of(part, v, a, jerks, durations, time)


def planned_stop(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float
) -> PlannedPiece | None:
    """Stop by the jerk stage, at the nearest of a few points ahead."""
    s, v, a = state
    straight = straight_distance(path, v, a, table)
    for factor in FARTHER:
        end = min(s + factor * straight, float(path.s[-1]))
        part = between(path, s, end, np.array([s, end]))
        if not len(part.s) > 1:
            return None
        free = np.full(len(part.s) - 1, np.inf)
        part = AxisPath(**{**vars(part), 'cell_feed': free})
        stretch = plan(part, table, (v, a), STOP_OPTIONS)
        if stretch is not None and float(stretch.duration.sum()) < LONGEST:
            return piece_of(
                stretch.path, stretch.v, stretch.a, stretch.jerk, stretch.duration, time
            )
        if end >= path.s[-1]:
            return None
    return None


def between(path: AxisPath, first: float, last: float, at: FloatArray) -> AxisPath:
    """Cut the path at two positions, with further grid points in between."""
    lowest = int(np.searchsorted(path.s, first, side='right')) - 1
    highest = int(np.searchsorted(path.s, last))
    lowest, highest = max(lowest, 0), min(max(highest, lowest + 1), len(path.s) - 1)
    part = refine(cut(path, lowest, highest), at)
    return cut(part, int(np.searchsorted(part.s, first)), int(np.searchsorted(part.s, last)))


def piece_of(
    path: AxisPath, v: FloatArray, a: FloatArray, jerk: FloatArray, duration: FloatArray,
    time: float,
) -> PlannedPiece:  # fmt: skip
    """Put a law on all cells of a path."""
    begins = time + np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    cells: IntArray = np.arange(len(duration), dtype=np.int64)
    law = MotionLaw(
        begins, duration, path.s[:-1].copy(), v[:-1].copy(), a[:-1].copy(), jerk, cells
    )
    return PlannedPiece(path, law)
