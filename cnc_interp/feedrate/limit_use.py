"""The upper limit of the feed [B2013, Eq. 10], and how much of each limit a motion law uses."""

from typing import NamedTuple

import numba
import numpy as np

from cnc_interp.core import MS, FloatArray, IntArray
from cnc_interp.core import limits_by_position as by_place
from cnc_interp.kinematics.axis_path import UNSEEN, AxisPath, septic_coefficients, septic_jet
from cnc_interp.machine_model.machine import Machine

ROOMY = 1.0 * MS  #: Shortest period at which the slack covers steps between path cells [s].


class PlanningLimits(NamedTuple):
    """Axis limits for planning, which may be lower than those of the machine."""

    max_velocity: FloatArray  #: (n_axes,): Largest velocities [m/s or rad/s].
    limit_table: FloatArray  #: (7, n_axes, m): All limits; see ``core/limits_by_position.py``.


AxisLimits = Machine | PlanningLimits


def limits_at(machine: Machine, period: float) -> AxisLimits:
    """Return limits for planning, so that differences of setpoints keep the limits of the machine.

    Neighbouring cells of an AxisPath may differ by ``UNSEEN``, a third difference of 2 UNSEEN /
    T^3. From the period ``ROOMY`` on, the slack of the jerk stage covers it; below, the jerk
    falls.
    """
    if period >= ROOMY:
        return machine
    step = 2.0 * UNSEEN * (1.0 / period**3 - 1.0 / ROOMY**3)
    table = machine.limit_table.copy()
    table[by_place.JERK] -= np.minimum(step, 0.5 * table[by_place.JERK])
    return PlanningLimits(machine.max_velocity, table)


def feed_limit(path: AxisPath, limits: AxisLimits) -> FloatArray:
    """Return the upper limit of s_dot at the grid points, (N,) [m/s] [B2013, Eq. 10].

    It is ``min(F, V/|q_s|, sqrt(A/|q_ss|), cbrt(J/|q_sss|))`` over all axes and both cells beside.
    """
    table = limits.limit_table
    out = np.full(len(path.s), np.inf)
    for jets, at in ((path.cell_left, slice(None, -1)), (path.cell_right, slice(1, None))):
        here = by_place.limits_along(table, jets[0])
        with np.errstate(divide='ignore'):
            sides = [(here[k] / np.abs(jets[k + 1])) ** (1 / (k + 1)) for k in range(3)]
        bound = np.minimum.reduce([side.min(axis=1) for side in sides])
        out[at] = np.minimum(out[at], np.minimum(bound, path.cell_feed))
    return out


@numba.njit(cache=True, nogil=True, error_model='numpy')
def limit_use(
    h: FloatArray,
    left: FloatArray,
    right: FloatArray,
    feed: FloatArray,
    v: FloatArray,
    a: FloatArray,
    jerk: FloatArray,
    duration: FloatArray,
    table: FloatArray,
    points: IntArray,
    use: FloatArray,
) -> FloatArray:
    """Write the use of velocity, acceleration, jerk and feed by a law in cells, (2, n, 4, n_axes).

    First the largest at all instants, then at both ends only; the torque of a drive counts as
    acceleration (``load_use``), s_dot / F stands in column 0, above 1 where s_dot is negative.
    ``v, a`` (n + 1,) belong to the grid points, ``points`` are the instants in each cell, both
    ends included. Returns the largest over all cells, (4,).
    """
    n, n_axes = len(h), left.shape[2]
    coefficients = np.empty((n_axes, 8))
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
                    q, q_s, q_ss, q_sss = septic_jet(coefficients[k], u, h[i])
                velocity = abs(q_s * s_dot) / by_place.limit_at(table, by_place.VELOCITY, k, q)
                second = q_ss * s_dot * s_dot + q_s * s_ddot
                acceleration = abs(second) / by_place.limit_at(table, by_place.ACCELERATION, k, q)
                acceleration = max(
                    acceleration, abs(by_place.load_use(table, k, q_s * s_dot, second))
                )
                third = abs(q_sss * s_dot**3 + 3 * q_ss * s_dot * s_ddot + q_s * j)
                third /= by_place.limit_at(table, by_place.JERK, k, q)
                use[0, i, 0, k] = max(use[0, i, 0, k], velocity)
                use[0, i, 1, k] = max(use[0, i, 1, k], acceleration)
                use[0, i, 2, k] = max(use[0, i, 2, k], third)
            if step == 1:
                use[1, i] = use[0, i]
        for c in range(4):
            for k in range(n_axes):
                worst[c] = max(worst[c], use[0, i, c, k])
    return worst
