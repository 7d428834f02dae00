"""The upper limit of the feed [B2013, Eq. 10], and a bound of how much of each limit a law uses.

In a cell q(s) is a septic and s(t) a cubic, so position, velocity, acceleration and jerk of an
axis are polynomials x(t) of degree 21 at most. Two bounds hold at every instant of the cell.

* A chord: ``|x| <= max |x(t_i)| + dt^2/8 max |x''|`` between instants dt apart. As s_dddot is
  constant, x'' is a short sum; for the jerk, with q_k = d^k q/ds^k,
  ``q_5 v^5 + 10 q_4 v^3 a + q_3 v (15 a^2 + 10 v j) + 10 q_2 a j``. Bernstein coefficients
  bound each q_k. It costs little and tells for most cells that they are far below all limits.
* A hull: 22 values of x give its 22 Bezier points in t, and x lies between their extremes. If the
  limit depends on the position it is a polynomial in t, too, and x / limit lies between the
  extremes of the ratios of the points. The cell is divided until the hull comes near the values.
"""

from math import comb, perm
from typing import NamedTuple

import numpy as np

from cnc_interp.core import MS, BoolArray, FloatArray
from cnc_interp.core import limit_kernels as by_place
from cnc_interp.core.axis_limits import Limits
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import COULOMB, DRIVE, VISCOUS
from cnc_interp.core.native import DistinctArrays
from cnc_interp.feedrate.motion_law import CellLaw
from cnc_interp.kinematics.axis_path import UNSEEN, AxisPath, PathCells, septic_coefficients
from cnc_interp.machine_model.machine import Machine

#: Excess of a bound over the largest value for which it is near enough: part of the limits of
#: velocity, acceleration and jerk [-]; the parts into which a cell is divided, one after another.
CLOSE, PARTS = np.array([1e-5, 5e-5, 5e-5]), (1, 4, 16)
DEGREE, TORQUE = 21, 3  #: Of x; a row after velocity, acceleration and jerk.
#: Bernstein coefficients of the derivatives of orders 1 to 5 by those of a septic in powers of u.
BERNSTEIN = np.zeros((5, 7, 7))
for _order, _i, _k in np.ndindex(5, 7, 7):
    if _k <= _i <= 6 - _order:
        _by = perm(_k + _order + 1, _order + 1) / comb(6 - _order, _k)
        BERNSTEIN[_order, _i, _k] = comb(_i, _k) * _by


def _by_values(at: FloatArray) -> FloatArray:
    """Return the parts of values in Bezier points: the inverse of the Bernstein matrix, turned."""
    n = len(at)
    rows = np.eye(n, 2 * n, n)
    for k in range(n):
        rows[:, k] = comb(n - 1, k) * at**k * (1 - at) ** (n - 1 - k)
    for k in range(n):  # in plain arithmetic, for the same bits on every processor
        largest = k + int(np.argmax(np.abs(rows[k:, k])))
        rows[[k, largest]] = rows[[largest, k]]
        rows[k] /= rows[k, k]
        others = np.arange(n) != k
        rows[others] -= rows[others, k : k + 1] * rows[k]
    return np.ascontiguousarray(rows[:, n:].T)


_EVEN = np.arange(DEGREE + 1) / DEGREE
INSTANTS = (
    _EVEN * _EVEN * (3 - 2 * _EVEN)
)  #: Where x is taken in its cell: dense at both ends [-].
BEZIER = _by_values(INSTANTS)
ROOMY = 1.0 * MS  #: Shortest period at which the slack covers steps between path cells [s].


def limits_at(machine: Machine, period: float) -> Limits:
    """Return limits for planning, so that differences of setpoints keep the limits of the machine.

    Neighbouring cells of an AxisPath may differ by ``UNSEEN``, a third difference of 2 UNSEEN /
    T^3. From the period ``ROOMY`` on, the slack of the jerk stage covers it; below, the jerk
    falls.
    """
    limits = machine.limits
    if period >= ROOMY:
        return limits
    step = 2.0 * UNSEEN * (1.0 / period**3 - 1.0 / ROOMY**3)

    def lowered(jerk: FloatArray) -> FloatArray:
        return jerk - np.minimum(step, 0.5 * jerk)

    placed = {k: of._replace(max_jerk=lowered(of.max_jerk)) for k, of in limits.placed}
    return limits.having(max_jerk=lowered(limits.max_jerk), by_place=placed)


def feed_limit(path: AxisPath, limits: Limits) -> FloatArray:
    """Return the upper limit of s_dot at the grid points, (N,) [m/s] [B2013, Eq. 10].

    It is ``min(F, V/|q_s|, sqrt(A/|q_ss|), cbrt(J/|q_sss|))`` over all axes and both cells beside.
    """
    out = np.full(len(path.s), np.inf)
    for jets, at in ((path.cell_left, slice(None, -1)), (path.cell_right, slice(1, None))):
        here = limits.along(jets[0])
        with np.errstate(divide='ignore'):
            sides = [(here[k] / np.abs(jets[k + 1])) ** (1 / (k + 1)) for k in range(3)]
        bound = np.minimum.reduce([side.min(axis=1) for side in sides])
        out[at] = np.minimum(out[at], np.minimum(bound, path.cell_feed))
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def derivative_hulls(c: FloatArray, h: float, out: FloatArray) -> None:
    """Write the largest magnitudes of Bernstein coefficients of q_s, q_ss, ..., q_sssss."""
    scale = 1.0
    for order in range(5):
        scale /= h
        out[order] = 0.0
        for i in range(7 - order):
            value = 0.0
            for k in range(i + 1):
                value += BERNSTEIN[order, i, k] * c[order + 1 + k]
            out[order] = max(out[order], abs(value) * scale)


@njit(cache=True, nogil=True, error_model='numpy')
def place_bounds(table: FloatArray) -> FloatArray:
    """Return the lowest limits of the axes and their steepest slopes by position, (2, 3, n)."""
    n_axes, last = table.shape[1], table.shape[2] - 1
    out = np.zeros((2, 3, n_axes))
    for row in range(3):
        for k in range(n_axes):
            out[0, row, k] = table[row, k].min()
            for p in range(last):
                rise = abs(table[row, k, p + 1] - table[row, k, p])
                way = table[by_place.PLACE, k, p + 1] - table[by_place.PLACE, k, p]
                out[1, row, k] = max(out[1, row, k], rise / way)
    return out


@njit(cache=True, nogil=True, error_model='numpy')
def bends_of_use(
    table: FloatArray,
    places: FloatArray,
    k: int,
    hull: FloatArray,
    v: float,
    a: float,
    j: float,
    out: FloatArray,
) -> None:
    """Write bounds of the second derivatives by time of the uses of V, A, J and torque [1/s2].

    ``hull``: bounds of the derivatives of the axis by s; ``v, a, j``: of those of s by time.
    """
    second = hull[1] * v * v + hull[0] * a
    third = hull[2] * v**3 + 3 * hull[1] * v * a + hull[0] * j
    fourth = hull[3] * v**4 + 6 * hull[2] * v * v * a + hull[1] * (3 * a * a + 4 * v * j)
    fifth = hull[4] * v**5 + 10 * hull[3] * v**3 * a + hull[2] * v * (15 * a * a + 10 * v * j)
    fifth += 10 * hull[1] * a * j
    out[0] = (third + places[1, 0, k] * second) / places[0, 0, k]
    out[1] = (fourth + places[1, 1, k] * second) / places[0, 1, k]
    out[2] = (fifth + places[1, 2, k] * second) / places[0, 2, k]
    out[TORQUE] = fourth + table[VISCOUS, k, 0] * third
    out[TORQUE] /= table[DRIVE, k, 0] - table[COULOMB, k, 0]


class AxisLimit(NamedTuple):
    """A limit of an axis in a cell; ``fixed``: whether it does not depend on the position."""

    row: int
    axis: int
    sign: float
    fixed: bool


@njit(cache=True, nogil=True, error_model='numpy')
def _value(
    row: int,
    slopes: tuple[float, float, float],
    state: tuple[float, float, float],
    sign: float,
    friction: float,
) -> float:
    """Return the limited quantity of an axis: its velocity, acceleration, jerk or torque."""
    (q_s, q_ss, q_sss), (v, a, j) = slopes, state
    if row == by_place.VELOCITY:
        return q_s * v
    if row == by_place.JERK:
        return q_sss * v**3 + 3 * q_ss * v * a + q_s * j
    x = q_ss * v * v + q_s * a
    return sign * (x + friction * q_s * v) if row == TORQUE else x


@njit(cache=True, nogil=True, error_model='numpy')
def _limits(table: FloatArray, row: int, k: int, q: float) -> tuple[float, float]:
    """Return the upper and lower limit of that quantity."""
    if row == TORQUE:
        drive, friction = table[DRIVE, k, 0], table[COULOMB, k, 0]
        return drive - friction, drive + friction
    limit = by_place.limit_at(table, row, k, q)
    return limit, limit


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _to_points(x: FloatArray, points: FloatArray) -> None:
    """Write the Bezier points of a polynomial by its values at the instants."""
    points[:] = 0.0
    for m in range(DEGREE + 1):
        for i in range(DEGREE + 1):
            points[i] += BEZIER[m, i] * x[m]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _jets(
    c: FloatArray,
    u: FloatArray,
    h: float,
    q: FloatArray,
    q_s: FloatArray,
    q_ss: FloatArray,
    q_sss: FloatArray,
) -> None:
    """Write value and three derivatives by s at places u, as ``septic_jet`` does."""
    for i in range(DEGREE + 1):
        q[i], q_s[i], q_ss[i], q_sss[i] = c[7], 0.0, 0.0, 0.0
    for k in range(6, -1, -1):
        for i in range(DEGREE + 1):
            q_sss[i] = q_sss[i] * u[i] + q_ss[i]
            q_ss[i] = q_ss[i] * u[i] + q_s[i]
            q_s[i] = q_s[i] * u[i] + q[i]
            q[i] = q[i] * u[i] + c[k]
    by_s, by_ss, by_sss = 1.0 / h, 2.0 / (h * h), 6.0 / (h * h * h)
    for i in range(DEGREE + 1):
        q_s[i], q_ss[i], q_sss[i] = q_s[i] * by_s, q_ss[i] * by_ss, q_sss[i] * by_sss


@njit(cache=True, nogil=True, error_model='numpy')
def _hull_use(
    table: FloatArray,
    limit: AxisLimit,
    c: FloatArray,
    h: float,
    law: tuple[float, float, float],
    piece: tuple[float, float],
    work: FloatArray,
) -> tuple[float, float]:
    """Return the use of a limit in a part of a cell: the largest of its hull and of its values.

    ``c``: the septic of the axis; ``law``: s_dot, s_ddot and s_dddot where the cell begins;
    ``piece``: begin and duration of the part.
    """
    (v, a, j), (begin, duration), (row, k, sign, fixed) = law, piece, limit
    q, q_s, q_ss, q_sss, u, value, points, up = work
    by_width, friction = 1.0 / h, table[VISCOUS, k, 0]
    for i in range(DEGREE + 1):
        dt = begin + duration * INSTANTS[i]
        u[i] = min(max(dt * (v + dt * (a / 2 + dt * j / 6)) * by_width, 0.0), 1.0)
    _jets(c, u, h, q, q_s, q_ss, q_sss)
    for i in range(DEGREE + 1):
        dt = begin + duration * INSTANTS[i]
        state = v + dt * (a + dt * j / 2), a + dt * j, j
        value[i] = _value(row, (q_s[i], q_ss[i], q_sss[i]), state, sign, friction)
    _to_points(value, points)
    most_up, most_down = _limits(table, row, k, q[0])
    if fixed:
        largest = max(points.max() / most_up, -points.min() / most_down)
        return largest, max(value.max() / most_up, -value.min() / most_down)
    for i in range(DEGREE + 1):
        up[i] = by_place.limit_at(table, row, k, q[i])
    seen = np.abs(value / up).max()
    _to_points(up, value)
    return np.abs(points / value).max(), seen


@njit(cache=True, nogil=True, error_model='numpy')
def limit_use(
    path: PathCells,
    law: CellLaw,
    table: FloatArray,
    accepted: FloatArray,
    fresh: BoolArray,
    use: FloatArray,
) -> None:
    """Write the use of velocity, acceleration, jerk and feed by a law in cells, (2, n, 4, n_axes).

    First a bound of the largest in the whole cell, then at both ends only; the torque of a drive
    counts as acceleration, s_dot / F stands in column 0, above 1 where s_dot is negative. Below
    ``accepted`` (4,) the bound need not be near the use. Only ``fresh`` cells (n,) are evaluated.
    """
    s, left, right, feed = path
    v, a, jerk, duration = law
    n, n_axes = len(feed), left.shape[2]
    c, hull, bends = np.empty(8), np.empty(5), np.empty(4)
    places, work = place_bounds(table), np.empty((8, DEGREE + 1))
    rows = TORQUE + 1 if np.isfinite(table[DRIVE]).any() else TORQUE
    for i in range(n):
        if not fresh[i]:
            continue
        use[:, i] = 0.0
        h, t, at_start = s[i + 1] - s[i], duration[i], (v[i], a[i], jerk[i])
        # s_dot has its largest or smallest value at an end, or where s_ddot = 0.
        ends = max(v[i], v[i + 1])
        fast, slow = ends, min(v[i], v[i + 1])
        if a[i] * a[i + 1] < 0.0:
            turn = v[i] - a[i] * a[i] / (2 * jerk[i])
            fast, slow = max(fast, turn), min(slow, turn)
        use[0, i, 3, 0], use[1, i, 3, 0] = fast / feed[i], ends / feed[i]
        if slow < -1e-12 * (v[i] + v[i + 1]):
            use[0, i, 3, 0] = max(use[0, i, 3, 0], 1.0 - slow / (v[i] + v[i + 1]))
        most = fast, max(abs(a[i]), abs(a[i + 1])), abs(jerk[i])
        for k in range(n_axes):
            septic_coefficients(left[:, i, k], right[:, i, k], h, c)
            derivative_hulls(c, h, hull)
            bends_of_use(table, places, k, hull, *most, bends)
            sign = 1.0 if left[1, i, k] + right[1, i, k] > 0.0 else -1.0
            for row in range(rows):
                at, ends = by_place.ACCELERATION if row == TORQUE else row, 0.0
                for node, jet in ((i, left[:, i, k]), (i + 1, right[:, i, k])):
                    state = v[node], a[node], jerk[i]
                    x = _value(row, (jet[1], jet[2], jet[3]), state, sign, table[VISCOUS, k, 0])
                    up, down = _limits(table, row, k, jet[0])
                    ends = max(ends, x / up, -x / down)
                bound = ends + bends[row] * t * t / 8
                if bound > accepted[at] and bound - ends > CLOSE[at]:
                    fixed = row == TORQUE or places[1, row, k] == 0.0
                    limit = AxisLimit(row, k, sign, fixed)
                    for parts in PARTS:
                        found, seen = ends, ends
                        for part in range(parts):
                            piece = t * part / parts, t / parts
                            new = _hull_use(table, limit, c, h, at_start, piece, work)
                            found, seen = max(found, new[0]), max(seen, new[1])
                        bound = min(bound, found)
                        if bound <= accepted[at] or bound - seen <= CLOSE[at]:
                            break
                use[0, i, at, k] = max(use[0, i, at, k], bound)
                use[1, i, at, k] = max(use[1, i, at, k], ends)
