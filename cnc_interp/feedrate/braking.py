"""
Where a law cannot brake, because a curve alone uses a limit for long.

The jerk of an axis is q_s s_dddot + 3 q_ss s_dot s_ddot + q_sss s_dot^3 [B2013, Eq. 8]. On a
circle of radius r at speed v, the last term alone is v^3/r^2. A law that spends the whole jerk
limit on it, all the way round, leaves nothing to brake with: from its states there is no short
stop. The same holds for the acceleration q_s s_ddot + q_ss s_dot^2.

At a state (s_dot, s_ddot) the braking left is the most negative s_dddot (s_ddot) that every axis
allows, divided by the one it would allow on a straight line. Short losses do no harm: the
machine goes on as planned until it can brake. So the mean over ``LASTING`` seconds is what counts.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.limit_table import COULOMB, DRIVE, limits_along

LASTING = 0.25
"""Time without braking that a law may take [s]."""

LEAST = 0.15
"""Smallest mean of the braking left, relative to a straight line [-]."""


def without_braking(
    jet: FloatArray, v: FloatArray, a: FloatArray, duration: FloatArray, table: FloatArray
) -> BoolArray:
    """Find the cells of a law in which braking is not possible for long."""
    q, q_s, q_ss, q_sss = jet
    v, a = v[:, None], a[:, None]
    by_curve = np.array([q_ss * v * v, 3 * q_ss * v * a + q_sss * v**3])
    time = np.concatenate([[0.0], np.cumsum(duration)])
    found = np.zeros((2, len(duration)), dtype=bool)
    if time[-1] < LASTING:
        return found
    acceleration, jerk = limits_along(table, q)[1:]
    acceleration = np.minimum(acceleration, table[DRIVE, :, 0] + table[COULOMB, :, 0])
    for row, limit in enumerate((acceleration, jerk)):
        with np.errstate(divide='ignore', invalid='ignore'):
            # largest deceleration of s that each axis allows; without q_s it allows any
            each = np.where(q_s == 0.0, np.inf, (limit + np.sign(q_s) * by_curve[row]) / abs(q_s))
            straight = np.where(q_s == 0.0, np.inf, limit / abs(q_s)).min(axis=1)
            left = np.clip(each.min(axis=1) / straight, 0.0, 1.0)
        so_far = np.concatenate([[0.0], np.cumsum(np.nan_to_num(left, nan=1.0) * duration)])
        ends = np.minimum(time[:-1] + LASTING, time[-1])
        begins = ends - LASTING
        mean = (np.interp(ends, time, so_far) - np.interp(begins, time, so_far)) / LASTING
        low = np.flatnonzero(mean < LEAST)
        count = np.zeros(len(duration) + 1)
        np.add.at(count, np.searchsorted(time, begins[low], side='right') - 1, 1)
        np.add.at(count, np.minimum(np.searchsorted(time, ends[low]), len(duration)), -1)
        found[row] = np.cumsum(count[:-1]) > 0
    return found
