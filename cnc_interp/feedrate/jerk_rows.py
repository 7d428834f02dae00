"""The rows of the jerk stage: time, limits and their gradients as functions of the unknowns.

The path is cut into n cells of width ``h``. s_dddot is constant in each cell. There is one unknown
per cell: ``m_i``, the middle Bezier coefficient of b = s_dot^2. With p_i = 1/(H_{i-1} + H_i):

    s_ddot at node i   a_i = (m_i - m_{i-1}) p_i
    b at node i        b_i = m_i - a_i H_i = m_{i-1} + a_i H_{i-1}

This is a C1 quadratic spline on the effective widths H. With H = h, b would be quadratic in s and
s_dddot proportional to s_dot. Constant s_dddot over the cell time t requires
``H = h + (a_{i+1} - a_i) t^2/12`` with t = 2 H/(v_i + v_{i+1}). This is exact. In the cell that
leaves rest H = 1.5 h, so b ~ s^(4/3) has no singularity. Elsewhere H = h to second order.
Therefore H is simply updated after each iteration.

The objective is the time, the sum of 2 H/(v_i + v_{i+1}). Rows are scaled to |g| <= 1:

    jerk at both ends   alpha j + beta v a + gamma v b,  j = (a_{i+1} - a_i)(v_i + v_{i+1})/(2 H)
    acceleration        q_s a + q_ss b
    torque              q_s a + q_ss b + (B/J) q_s v + sigma C/J, with sigma = sign(q_s)
    speed               m_i <= v_i v_{i+1},  b_i <= v_i^2, where v_i is the largest s_dot at node i

A row is a constant combination of at most three terms of its cell: (j, v a, v b) at the left end,
the same at the right end, (a, b) at the left node, and (a, b, v) there for the torque, which also
has a constant. Only the terms depend on the unknowns, and each one on m_{i-1}, m_i, m_{i+1} only.
Thus the Newton matrix is pentadiagonal, and one axis costs three multiplications per row.
"""

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import (
    ACCELERATION,
    COULOMB,
    DRIVE,
    JERK,
    VISCOUS,
    limit_at,
)
from cnc_interp.core.native import DistinctArrays

FloatRows = tuple[FloatArray, ...]  #: Rows of equal length that do not overlap in memory.


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def node_states(
    m: FloatArray, width: FloatArray, ends: FloatArray, b: FloatArray, a: FloatArray, v: FloatArray
) -> None:
    n = len(m)
    m[0] = ends[0] + ends[1] * width[0]
    m[n - 1] = ends[2] - ends[3] * width[n - 1]
    b[0], a[0], b[n], a[n] = ends[0], ends[1], ends[2], ends[3]
    for i in range(1, n):
        p = 1.0 / (width[i - 1] + width[i])
        a[i] = (m[i] - m[i - 1]) * p
        b[i] = (m[i] * width[i - 1] + m[i - 1] * width[i]) * p
    for i in range(n + 1):
        v[i] = np.sqrt(max(b[i], 0.0))


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def follow_widths(h: FloatArray, a: FloatArray, v: FloatArray, width: FloatArray) -> float:
    change = 0.0
    for i in range(len(h)):
        t = 2 * width[i] / (v[i] + v[i + 1])
        new = h[i] + (a[i + 1] - a[i]) * t * t / 12
        new = min(max(new, 0.6 * h[i]), 1.6 * h[i])
        change = max(change, abs(new - width[i]) / h[i])
        width[i] = new
    return change


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _nodes_by_coefficients(
    width: FloatArray, al: FloatArray, ar: FloatArray, bl: FloatArray, br: FloatArray
) -> None:
    n = len(width)
    for i in range(1, n):
        p = 1.0 / (width[i - 1] + width[i])
        al[i], ar[i], bl[i], br[i] = -p, p, p * width[i], p * width[i - 1]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _products(
    a: FloatArray,
    b: FloatArray,
    v: FloatArray,
    products: FloatRows,
    by_products: FloatRows,
    by_nodes: FloatRows,
    by_speed: FloatRows,
) -> None:
    """Write v a and v b at the nodes, and the derivatives of v a, v b and v left and right."""
    va, vb = products
    va_l, va_r, vb_l, vb_r = by_products
    al, ar, bl, br = by_nodes
    vl, vr = by_speed
    for i in range(len(v)):
        half = 0.5 / v[i] if v[i] > 0.0 else 0.0
        va[i], vb[i] = v[i] * a[i], v[i] * b[i]
        left, right = half * bl[i], half * br[i]
        vl[i], vr[i] = left, right
        va_l[i], va_r[i] = v[i] * al[i] + a[i] * left, v[i] * ar[i] + a[i] * right
        vb_l[i], vb_r[i] = v[i] * bl[i] + b[i] * left, v[i] * br[i] + b[i] * right


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _jerks(
    width: FloatArray, a: FloatArray, v: FloatArray, by_nodes: FloatRows, out: FloatRows
) -> None:
    """Write the jerk of cells, and its derivatives by the coefficients around them."""
    al, ar, vl, vr = by_nodes
    j, j_l, j_m, j_r = out
    for i in range(len(width)):
        sum_v = v[i] + v[i + 1]
        twice = 0.5 / width[i]
        half, rise = sum_v * twice, (a[i + 1] - a[i]) * twice
        j[i] = rise * sum_v
        j_l[i] = rise * vl[i] - half * al[i]
        j_m[i] = half * (al[i + 1] - ar[i]) + rise * (vr[i] + vl[i + 1])
        j_r[i] = half * ar[i + 1] + rise * vr[i + 1]


@njit(cache=True, nogil=True, error_model='numpy')
def terms_and_time(
    width: FloatArray,
    b: FloatArray,
    a: FloatArray,
    v: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
) -> float:
    """Return the time, and write the terms of the rows with their derivatives.

    ``terms``: j in cell i; v a, v b, a, b at node i; zero; v. ``slopes``: derivatives of j by
    m_{i-1}, m_i, m_{i+1}; of v a, v b, a, b and v by m_{i-1} and m_i, two rows each; zero. Those
    by the fixed first and last coefficient are zero.
    """
    n = len(width)
    e = slopes
    for r in (7, 8, 9, 10):
        e[r, 0], e[r, n] = 0.0, 0.0
    _nodes_by_coefficients(width, e[7], e[8], e[9], e[10])
    if n > 1:
        e[7, 1], e[9, 1], e[8, n - 1], e[10, n - 1] = 0.0, 0.0, 0.0, 0.0
    terms[3], terms[4], terms[5], terms[6], e[13] = a, b, 0.0, v, 0.0
    products, by_products = (terms[1], terms[2]), (e[3], e[4], e[5], e[6])
    _products(a, b, v, products, by_products, (e[7], e[8], e[9], e[10]), (e[11], e[12]))
    _jerks(width, a, v, (e[7], e[8], e[11], e[12]), (terms[0], e[0], e[1], e[2]))
    total = 0.0
    for i in range(n):
        total += 2 * width[i] / (v[i] + v[i + 1])
    return total


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _linearised(
    term: FloatArray, left: FloatArray, right: FloatArray, dm: FloatArray, out: FloatArray
) -> None:
    """Write a term of the nodes after a step of the coefficients beside them."""
    for i in range(len(out)):
        out[i] = term[i] + left[i] * dm[i] + right[i] * dm[i + 1]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _linearised_jerk(
    j: FloatArray,
    left: FloatArray,
    middle: FloatArray,
    right: FloatArray,
    dm: FloatArray,
    out: FloatArray,
) -> None:
    for i in range(len(dm) - 2):
        out[i] = j[i] + left[i] * dm[i] + middle[i] * dm[i + 1] + right[i] * dm[i + 2]


@njit(cache=True, nogil=True, error_model='numpy')
def linearise(terms: FloatArray, slopes: FloatArray, dm: FloatArray, out: FloatArray) -> None:
    _linearised_jerk(terms[0], slopes[0], slopes[1], slopes[2], dm, out[0])
    for t in range(1, 5):
        _linearised(terms[t], slopes[2 * t + 1], slopes[2 * t + 2], dm, out[t])
    _linearised(terms[6], slopes[11], slopes[12], dm, out[6])
    out[5] = 0.0


@njit(cache=True, nogil=True, error_model='numpy')
def term_rows(terms: FloatArray, q: int, lo: int, hi: int) -> FloatRows:
    """Return the three terms of place q of cells lo ... hi; see ``barrier_rows.py``."""
    if q > 1:
        return terms[3, lo:hi], terms[4, lo:hi], terms[3 + q, lo:hi]
    return terms[0, lo:hi], terms[1, lo + q : hi + q], terms[2, lo + q : hi + q]


@njit(cache=True, nogil=True, error_model='numpy')
def slope_rows(slopes: FloatArray, q: int, lo: int, hi: int) -> FloatRows:
    """Return the derivatives of the three terms of place q by m_{i-1}, then m_i, then m_{i+1}."""
    e, here, after, zero = slopes, slice(lo, hi), slice(lo + 1, hi + 1), slopes[13, lo:hi]
    if q == 2:
        before, middle = (e[7, here], e[9, here], zero), (e[8, here], e[10, here], zero)
        return *before, *middle, zero, zero, zero
    if q == 3:
        before, middle = (
            (e[7, here], e[9, here], e[11, here]),
            (e[8, here], e[10, here], e[12, here]),
        )
        return *before, *middle, zero, zero, zero
    j = e[0, here], e[1, here], e[2, here]
    if q == 0:
        return j[0], e[3, here], e[5, here], j[1], e[4, here], e[6, here], j[2], zero, zero
    return j[0], zero, zero, j[1], e[3, after], e[5, after], j[2], e[4, after], e[6, after]


@njit(cache=True, nogil=True, error_model='numpy')
def build_rows(
    left: FloatArray, right: FloatArray, table: FloatArray, scale: FloatArray, rows: FloatArray
) -> None:
    """Write the rows of ``barrier_rows.py``: derivatives over limits times ``scale``."""
    n, n_axes = left.shape[1], left.shape[2]
    rows[:] = 0.0
    if n < 3:
        return
    for k in range(n_axes):
        for i in range(n):
            by_jerk = 1.0 / (limit_at(table, JERK, k, left[0, i, k]) * scale[i, 2, k])
            rows[k, 0, i] = left[1, i, k] * by_jerk
            rows[k, 1, i] = 3 * left[2, i, k] * by_jerk
            rows[k, 2, i] = left[3, i, k] * by_jerk
            by_jerk = 1.0 / (limit_at(table, JERK, k, right[0, i, k]) * scale[i, 2, k])
            rows[k, 3, i] = right[1, i, k] * by_jerk
            rows[k, 4, i] = 3 * right[2, i, k] * by_jerk
            rows[k, 5, i] = right[3, i, k] * by_jerk
            if i > 0:
                smaller = min(scale[i - 1, 1, k], scale[i, 1, k])
                most = limit_at(table, ACCELERATION, k, left[0, i, k]) * smaller
                rows[k, 6, i] = left[1, i, k] / most
                rows[k, 7, i] = left[2, i, k] / most
                if rows.shape[1] > 9:
                    drive, sign = table[DRIVE, k, 0], np.sign(left[1, i, k] + right[1, i, k])
                    rows[k, 9, i] = left[1, i, k] / (drive * smaller)
                    rows[k, 10, i] = left[2, i, k] / (drive * smaller)
                    rows[k, 11, i] = table[VISCOUS, k, 0] * rows[k, 9, i]
                    rows[k, 12, i] = sign * table[COULOMB, k, 0] / drive
