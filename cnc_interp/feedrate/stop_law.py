"""
The fastest stop along the path that can be found in milliseconds, from any state of motion.

The first way is closed-form. s_dddot = -J, 0, +J until speed and acceleration are zero together.
The largest deceleration is

    a_p = sqrt(J v + a^2/2)         (if this exceeds A, then A is held for a while)

J and A are reduced until the axes keep their limits along the true curve. This is enough for
lines, gentle curves and corner exits, and takes a fraction of a millisecond. Where the path
curves more, the second way plans with the jerk stage to rest at a point ahead. This takes some
milliseconds, so callers use it only after the first way has failed for a while. If both fail, the
motion continues as planned and stops a little later.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.feedrate.jerk_stage import PlanOptions, plan
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.stretch import spread_law
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
"""Largest accepted use of a limit [-]."""

TIME_SCALES = tuple(0.998 * 0.93**k for k in range(12))
"""Time scales tried in order: J is multiplied by the third power, A by the second."""

DISTANCE_FACTORS = (1.0, 1.5, 2.2)
"""Distances to rest tried by the jerk stage, relative to the stop on a straight line."""

LONGEST_STOP = 3.0
"""Longest accepted stop [s]."""

STOP_OPTIONS = PlanOptions(passes=3)


@numba.njit(cache=True, nogil=True)
def _stop_phases(v: float, a: float, acceleration: float, jerk: float, out: FloatArray) -> bool:
    """
    Write the durations [s] of the phases -J, 0, +J of a stop.

    Returns False if there is no such stop: the speed is zero before the deceleration can be.
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
def _stop_states(v: float, a: float, jerk: float, duration: FloatArray, out: FloatArray) -> None:
    """Write s, s_dot and s_ddot at the start and after each phase, shape (4, 3); s starts at 0."""
    out[0, 0], out[0, 1], out[0, 2] = 0.0, v, a
    for k in range(3):
        j, t = (k - 1) * jerk, duration[k]
        s, speed, pull = out[k]
        out[k + 1, 0] = s + t * (speed + t * (pull / 2 + t * j / 6))
        out[k + 1, 1] = speed + t * (pull + t * j / 2)
        out[k + 1, 2] = pull + t * j
    out[3, 1], out[3, 2] = 0.0, 0.0


@numba.njit(cache=True, nogil=True)
def _stop_use(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    start: float,
    states: FloatArray,
    duration: FloatArray,
    jerk: float,
    table: FloatArray,
) -> float:
    """Return the largest use of a limit along a stop; above ACCEPTED the value is incomplete."""
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
def _closed_form(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    start: FloatArray,
    table: FloatArray,
    slower: FloatArray,
    duration: FloatArray,
    states: FloatArray,
) -> float:
    """Find the fastest closed-form stop from ``start`` = (s, v, a); return its J [m/s3], or 0."""
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
        if not _stop_phases(start[1], start[2], a, j, duration):
            continue
        _stop_states(start[1], start[2], j, duration, states)
        if start[0] + states[3, 0] > s_grid[-1]:
            continue
        use = _stop_use(s_grid, left, right, start[0], states, duration, j, table)
        if use <= ACCEPTED:
            return float(j)
    return 0.0


def _straight_distance(path: AxisPath, v: float, a: float, table: FloatArray) -> float:
    """Estimate the stopping distance [m], as if the first cell continued straight."""
    q_s = np.abs(path.cell_left[1, 0])
    with np.errstate(divide='ignore'):
        acceleration, jerk = (table[1] / q_s).min(), (table[2] / q_s).min()
    return float(v * (np.sqrt(v / jerk) + v / acceleration / 2) + max(a, 0.0) * v / jerk)


def stopping_part(path: AxisPath, s: float, v: float, a: float, table: FloatArray) -> AxisPath:
    """
    Cut out the part of the path in which a stop from this state can end.

    Parameters
    ----------
    path : AxisPath
        Path that contains the state.
    s, v, a : float
        State of motion: s, s_dot and s_ddot [m, m/s, m/s2].
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.

    Returns
    -------
    AxisPath
        The path from the cell of s to the next programmed stop, or to the longest stop tried.

    """
    first = int(np.clip(np.searchsorted(path.s, s, side='right') - 1, 0, len(path.s) - 2))
    reach = _straight_distance(cut(path, first, first + 1), v, a, table)
    last = int(np.searchsorted(path.s, s + 1.05 * DISTANCE_FACTORS[-1] * reach))
    last = min(max(last, first + 1), len(path.s) - 1)
    stops = np.flatnonzero(path.stop[first + 1 : last + 1])
    return cut(path, first, first + 1 + int(stops[0]) if len(stops) else last)


def stop_law(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float,
    thorough: bool,
) -> PlannedPiece | None:  # fmt: skip
    """
    Plan the fastest stop that can be found from a state of motion.

    Parameters
    ----------
    path : AxisPath
        Path that contains the state and continues after it.
    state : tuple of float
        State of motion: s, s_dot and s_ddot [m, m/s, m/s2].
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    time : float
        Time of the state on the clock of the law [s].
    thorough : bool
        Whether to use the jerk stage if there is no closed-form stop.

    Returns
    -------
    PlannedPiece or None
        The stop from this state to rest, within all limits. None if none was found.

    """
    s, v, a = state
    if v <= 0.0:
        return None
    ahead = stopping_part(path, s, v, a, table)
    found = _quick_stop(ahead, state, table, time)
    return planned_stop(ahead, state, table, time) if found is None and thorough else found


def _quick_stop(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float
) -> PlannedPiece | None:
    """Plan a closed-form stop on a path that begins with the cell of the state."""
    duration, states = np.empty(3), np.empty((4, 3))
    jerk = _closed_form(
        path.s, path.cell_left, path.cell_right, np.array(state), table, np.array(TIME_SCALES),
        duration, states,
    )  # fmt: skip
    if not jerk > 0.0:
        return None
    kept = np.flatnonzero(duration > 1e-9)
    ends = state[0] + states[np.r_[kept, 3], 0]
    if not len(kept) or (np.diff(ends) <= 1e-13).any():
        return None
    part = cut_between(path, float(ends[0]), float(ends[-1]), ends)
    nodes = np.searchsorted(part.s, ends).astype(np.int64)
    cells = len(part.s) - 1
    v, a = np.empty(cells + 1), np.empty(cells + 1)
    jerks, durations = np.empty(cells), np.empty(cells)
    rows = np.r_[kept, 3]
    spread_law(
        part.s, nodes, states[rows, 1], states[rows, 2], duration[kept], v, a, jerks, durations
    )
    return _piece_of(part, v, a, jerks, durations, time)


def planned_stop(
    path: AxisPath, state: tuple[float, float, float], table: FloatArray, time: float
) -> PlannedPiece | None:
    """
    Plan a stop with the jerk stage, at the nearest possible of a few points ahead.

    Parameters
    ----------
    path : AxisPath
        Path that begins with the cell of the state.
    state : tuple of float
        State of motion: s, s_dot and s_ddot [m, m/s, m/s2].
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    time : float
        Time of the state on the clock of the law [s].

    Returns
    -------
    PlannedPiece or None
        The stop, None if none within the limits and ``LONGEST_STOP`` seconds was found.

    """
    s, v, a = state
    straight = _straight_distance(path, v, a, table)
    for factor in DISTANCE_FACTORS:
        end = min(s + factor * straight, float(path.s[-1]))
        part = cut_between(path, s, end, np.array([s, end]))
        if not len(part.s) > 1:
            return None
        free = np.full(len(part.s) - 1, np.inf)
        part = AxisPath(**{**vars(part), 'cell_feed': free})
        stretch = plan(part, table, (v, a), STOP_OPTIONS)
        if stretch is not None and float(stretch.duration.sum()) < LONGEST_STOP:
            return _piece_of(
                stretch.path, stretch.v, stretch.a, stretch.jerk, stretch.duration, time
            )
        if end >= path.s[-1]:
            return None
    return None


def cut_between(path: AxisPath, first: float, last: float, at: FloatArray) -> AxisPath:
    """
    Cut the path at two positions.

    Parameters
    ----------
    path : AxisPath
        The path to cut.
    first, last : float
        Path positions of the new ends [m]; both must be in ``at``.
    at : ndarray, shape (k,)
        Path positions that become grid points [m].

    Returns
    -------
    AxisPath
        The path between the two positions.

    """
    lowest = int(np.searchsorted(path.s, first, side='right')) - 1
    highest = int(np.searchsorted(path.s, last))
    lowest, highest = max(lowest, 0), min(max(highest, lowest + 1), len(path.s) - 1)
    part = refine(cut(path, lowest, highest), at)
    return cut(part, int(np.searchsorted(part.s, first)), int(np.searchsorted(part.s, last)))


def _piece_of(
    path: AxisPath, v: FloatArray, a: FloatArray, jerk: FloatArray, duration: FloatArray,
    time: float,
) -> PlannedPiece:  # fmt: skip
    """Build the committed motion from the states at all grid points of a path."""
    begins = time + np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    cells: IntArray = np.arange(len(duration), dtype=np.int64)
    law = MotionLaw(
        begins, duration, path.s[:-1].copy(), v[:-1].copy(), a[:-1].copy(), jerk, cells
    )
    return PlannedPiece(path, law)
