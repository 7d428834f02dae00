"""The upper limit of the feed [B2013, Eq. 10], and how much of each limit a motion law uses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.limit_table import (
    ACCELERATION,
    JERK,
    VELOCITY,
    constant_table,
    limit_at,
    limits_along,
    load_use,
)
from cnc_interp.core.units import MS
from cnc_interp.kinematics.axis_path import UNSEEN, AxisPath, septic_coefficients, septic_value
from cnc_interp.machine_model.machine import Machine

#: Shortest period at which the slack of the jerk stage covers the steps between path cells [s].
ROOMY = 1.0 * MS


class AxisLimits(Protocol):
    """Velocity, acceleration and jerk limits of the axes; a ``Machine`` has these three arrays."""

    @property
    def max_velocity(self) -> FloatArray:
        """Velocity limits, shape (n_axes,) [m/s or rad/s]."""

    @property
    def max_acceleration(self) -> FloatArray:
        """Acceleration limits, shape (n_axes,) [m/s2 or rad/s2]."""

    @property
    def max_jerk(self) -> FloatArray:
        """Jerk limits, shape (n_axes,) [m/s3 or rad/s3]."""


def limit_table(limits: AxisLimits) -> FloatArray:
    """Return the limits over position (``core/limit_table.py``): a machine has its own table."""
    table: FloatArray | None = getattr(limits, 'limit_table', None)
    if table is not None:
        return table
    rows = (limits.max_velocity, limits.max_acceleration, limits.max_jerk)
    return constant_table(np.array(rows, dtype=np.float64))


@dataclass(frozen=True)
class PlanningLimits:
    """Axis limits for planning, which may be lower than those of the machine."""

    #: (n_axes,): Largest limits [m/s or rad/s, per s, per s2].
    max_velocity: FloatArray
    max_acceleration: FloatArray
    max_jerk: FloatArray
    limit_table: FloatArray  #: (7, n_axes, m): The limits over position.


def limits_at(machine: Machine, period: float) -> AxisLimits:
    """
    Return limits for planning, so that differences of setpoints keep the limits of the machine.

    Neighbouring cells of an AxisPath may differ by up to ``UNSEEN`` on any axis. A step of this
    size has a third difference of 2 UNSEEN / T^3. From the period ``ROOMY`` on, the slack of the
    jerk stage covers it. At shorter periods, the jerk limits are reduced.
    """
    if period >= ROOMY:
        return machine
    step = 2.0 * UNSEEN * (1.0 / period**3 - 1.0 / ROOMY**3)
    jerk, table = machine.max_jerk, machine.limit_table.copy()
    table[JERK] -= np.minimum(step, 0.5 * table[JERK])
    jerk = jerk - np.minimum(step, 0.5 * jerk)
    return PlanningLimits(machine.max_velocity, machine.max_acceleration, jerk, table)


def feed_limit(path: AxisPath, limits: AxisLimits) -> FloatArray:
    """
    Compute the upper limit of the feed at the grid points [B2013, Eq. 10].

    The limit is ``min(F, V/|q_s|, sqrt(A/|q_ss|), cbrt(J/|q_sss|))`` over all axes. At a grid
    point the smaller value of its two neighbouring cells counts.

    Returns (N,): upper limit of s_dot [m/s]. It is attained where s_ddot and s_dddot are zero.
    """
    table = limit_table(limits)
    out = np.full(len(path.s), np.inf)
    for jets, at in ((path.cell_left, slice(None, -1)), (path.cell_right, slice(1, None))):
        here = limits_along(table, jets[0])
        with np.errstate(divide='ignore'):
            sides = [(here[k] / np.abs(jets[k + 1])) ** (1 / (k + 1)) for k in range(3)]
        bound = np.minimum.reduce([side.min(axis=1) for side in sides])
        out[at] = np.minimum(out[at], np.minimum(bound, path.cell_feed))
    return out


@numba.njit(cache=True, nogil=True, error_model='numpy')
def limit_use(
    h: FloatArray, left: FloatArray, right: FloatArray, feed: FloatArray, v: FloatArray,
    a: FloatArray, jerk: FloatArray, duration: FloatArray, table: FloatArray, points: IntArray,
    use: FloatArray,
) -> FloatArray:  # fmt: skip
    """
    Compute how much of each limit a motion law uses in every cell of the true path.

    ``velocity = q_s s_dot``, ``acceleration = q_ss s_dot^2 + q_s s_ddot`` and
    ``jerk = q_sss s_dot^3 + 3 q_ss s_dot s_ddot + q_s s_dddot`` are divided by their limits.
    The torque of a drive counts as acceleration, see ``load_use``. The feed use is s_dot / F. A
    negative s_dot gives a feed use above 1.

    ``h`` (n,): cell widths [m].
    ``left, right`` (4, n, n_axes): q and its derivatives by s at both ends of each cell [m or rad,
    per m, per m2, per m3].
    ``feed`` (n,): programmed feedrate in the cells [m/s].
    ``v, a`` (n + 1,): s_dot and s_ddot at the grid points [m/s, m/s2].
    ``jerk, duration`` (n,): constant s_dddot in each cell [m/s3], and the time spent in the cell
    [s].
    ``table`` (7, n_axes, m): limits of the axes over position; see ``core/limit_table.py``.
    ``points`` (n,): number of instants to check in each cell, both ends included.
    ``use`` (2, n, 4, n_axes): output: the largest use [-] of velocity, acceleration, jerk and feed
    in each cell. ``use[0]`` covers all instants, ``use[1]`` only the two ends of the cell. The
    feed use stands in column 0 of its row.
    Returns (4,): largest use of velocity, acceleration, jerk and feed over all cells [-].
    """
    n, n_axes = len(h), left.shape[2]
    coefficients = np.empty((n_axes, 8))
    jet = np.empty(4)
    worst = np.zeros(4)
    use[:] = 0.0
    for i in range(n):
        curved = False
        for k in range(n_axes):
            septic_coefficients(left[:, i, k], right[:, i, k], h[i], coefficients[k])
            for c in range(2, 8):
                curved = curved or coefficients[k, c] != 0.0
        t = duration[i]
        j, last = jerk[i], points[i] - 1
        for step in range(points[i]):
            # The first two instants are the ends of the cell, because use[1] is taken there only.
            p = 0 if step == 0 else last if step == 1 else step - 1
            dt = t * p / last
            s = dt * (v[i] + dt * (a[i] / 2 + dt * j / 6))
            s_dot, s_ddot = v[i] + dt * (a[i] + dt * j / 2), a[i] + dt * j
            u = min(max(s / h[i], 0.0), 1.0)
            use[0, i, 3, 0] = max(use[0, i, 3, 0], s_dot / feed[i])
            if s_dot < -1e-12 * (v[i] + v[i + 1]):
                use[0, i, 3, 0] = max(use[0, i, 3, 0], 1.0 - s_dot / (v[i] + v[i + 1]))
            for k in range(n_axes):
                if p == last:
                    q, q_s = right[0, i, k], right[1, i, k]
                    q_ss, q_sss = right[2, i, k], right[3, i, k]
                elif p == 0 or not curved:
                    q, q_s = left[0, i, k] + left[1, i, k] * s, left[1, i, k]
                    q_ss, q_sss = left[2, i, k], left[3, i, k]
                else:
                    septic_value(coefficients[k], u, h[i], jet)
                    q, q_s, q_ss, q_sss = jet[0], jet[1], jet[2], jet[3]
                velocity = abs(q_s * s_dot) / limit_at(table, VELOCITY, k, q)
                second = q_ss * s_dot * s_dot + q_s * s_ddot
                acceleration = abs(second) / limit_at(table, ACCELERATION, k, q)
                acceleration = max(acceleration, abs(load_use(table, k, q_s * s_dot, second)))
                third = abs(q_sss * s_dot**3 + 3 * q_ss * s_dot * s_ddot + q_s * j)
                third /= limit_at(table, JERK, k, q)
                use[0, i, 0, k] = max(use[0, i, 0, k], velocity)
                use[0, i, 1, k] = max(use[0, i, 1, k], acceleration)
                use[0, i, 2, k] = max(use[0, i, 2, k], third)
            if step == 1:
                use[1, i] = use[0, i]
        for c in range(4):
            for k in range(n_axes):
                worst[c] = max(worst[c], use[0, i, c, k])
    return worst
