"""How a path cell is subdivided: evenly in time, finer where its derivatives are not linear."""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.limit_table import ACCELERATION, JERK, limit_at
from cnc_interp.feedrate.speed_guess import speed_inside
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_value

SAMPLES = 96
"""Number of intervals in which a cell is sampled before it is subdivided."""

GROWTH, LONGEST = 0.3, 16.0
"""Growth of the cell time per unit of time at constant speed, and its largest factor [-]."""

RAMP_CELLS, SHORTEST = 8, 2e-5
"""Cells in a ramp between rest and constant speed, and the shortest time of such a cell [s]."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def cell_times(
    s: FloatArray, feed: FloatArray, bounds: FloatArray, v: FloatArray, tau: float
) -> FloatArray:
    """
    Return the wanted cell time at every grid point [s].

    It grows from ``tau`` only where the programmed feed alone limits the speed. There the law
    cruises, because the guess brakes earlier and accelerates later than the law.
    """
    n = len(bounds)
    wanted, growth = np.full(n + 1, tau), np.empty(n)
    for i in range(n):
        h = s[i + 1] - s[i]
        speed, cruise = speed_inside(h / 2, h, v[i], v[i + 1], bounds[i])
        cruise = cruise and bounds[i, 1] >= feed[i] and min(v[i], v[i + 1]) >= speed
        growth[i] = GROWTH * h / speed if cruise else -np.inf
        wanted[i + 1] = min(max(wanted[i] + growth[i], tau), LONGEST * tau)
    for i in range(n - 1, -1, -1):
        wanted[i] = min(wanted[i], max(wanted[i + 1] + growth[i], tau))
    return wanted


@numba.njit(cache=True, nogil=True, error_model='numpy')
def cell_nodes(
    h: float,
    v0: float,
    v1: float,
    bound: FloatArray,
    start: float,
    end: float,
    least: float,
    out: FloatArray,
) -> int:
    """Write the inner nodes of one cell, evenly spaced in time; return their number."""
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
    # A short ramp between rest and a slow constant speed gets cells of its own time scale.
    if last > first and v0 == 0.0:
        start = min(start, max(time[first] / RAMP_CELLS, SHORTEST))
    if last > first and v1 == 0.0:
        end = min(end, max((time[SAMPLES] - time[last]) / RAMP_CELLS, SHORTEST))
    for p in range(SAMPLES):
        middle = (time[p] + time[p + 1]) / 2
        after, before = max(0.0, middle - time[first]), max(0.0, time[last] - middle)
        if last <= first:
            after, before = 0.0, 0.0
        wanted = min(start + GROWTH * after, end + GROWTH * before)
        by_time = (time[p + 1] - time[p]) / wanted
        count[p + 1] = count[p] + max(by_time, least * (x[p + 1] - x[p]) / h)
    cells = int(np.ceil(count[SAMPLES]))
    cells = min(max(cells, 1), len(out) + 1)
    p = 0
    for c in range(1, cells):
        rank = count[SAMPLES] * c / cells
        while count[p + 1] < rank:
            p += 1
        share = (rank - count[p]) / (count[p + 1] - count[p])
        if p == 0 and v0 == 0.0:
            share = share**3
        out[c - 1] = x[p] + share * (x[p + 1] - x[p])
    return cells - 1


@numba.njit(cache=True, nogil=True, error_model='numpy')
def bend(left: FloatArray, right: FloatArray, h: float, v: float, table: FloatArray) -> float:
    """
    Estimate by how much a limit may be exceeded inside a cell whose two ends keep it.

    The constraint rows are linear in q_ss and q_sss. The measure is the largest deviation of q_ss
    and q_sss from the straight line between both ends, at the speed v.

    Parameters
    ----------
    left, right : ndarray, shape (4, n_axes)
        q and its derivatives by s at both ends of the cell [m or rad, per m, per m2, per m3].
    h : float
        Width of the cell [m].
    v : float
        Speed in the cell [m/s].
    table : ndarray, shape (7, n_axes, m)
        Limits of the axes over position; see ``core/limit_table.py``.

    Returns
    -------
    float
        Largest deviation, as a part of the limit [-].

    """
    worst = 0.0
    c, jet = np.empty(8), np.empty(4)
    for k in range(left.shape[1]):
        septic_coefficients(left[:, k], right[:, k], h, c)
        if c[3] == 0.0 and c[4] == 0.0 and c[5] == 0.0 and c[6] == 0.0 and c[7] == 0.0:
            continue
        q = left[0, k]
        by_jerk = v**3 / limit_at(table, JERK, k, q)
        by_acceleration = v**2 / limit_at(table, ACCELERATION, k, q)
        for p in range(1, 8):
            u = p / 8
            septic_value(c, u, h, jet)
            straight = left[3, k] + u * (right[3, k] - left[3, k])
            worst = max(worst, abs(jet[3] - straight) * by_jerk)
            straight = left[2, k] + u * (right[2, k] - left[2, k])
            worst = max(worst, abs(jet[2] - straight) * by_acceleration)
    return worst
