"""
The rows of the jerk stage: time, limits and their gradients as functions of the unknowns.

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
    speed               m_i <= cap_i,  b_i <= min(cap_{i-1}, cap_i)

A row is a constant combination of at most three terms of its cell: (j, v a, v b) at the left end,
the same at the right end, and (a, b) at the left node. Only the terms depend on the unknowns, and
each one on m_{i-1}, m_i, m_{i+1} only. Thus the Newton matrix is pentadiagonal, and one axis costs
three multiplications per row.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray


@numba.njit(cache=True, nogil=True, error_model='numpy')
def node_states(
    m: FloatArray,
    width: FloatArray,
    ends: FloatArray,
    b: FloatArray,
    a: FloatArray,
    v: FloatArray,
) -> None:
    """
    Compute b = s_dot^2, s_ddot and s_dot at the nodes from the coefficients.

    Parameters
    ----------
    m : ndarray, shape (n,)
        Coefficients [m2/s2]. The first and the last are set here from ``ends``.
    width : ndarray, shape (n,)
        Effective widths H [m].
    ends : ndarray, shape (4,)
        s_dot^2 and s_ddot at the start, then at the end [m2/s2, m/s2].
    b, a, v : ndarray, shape (n + 1,)
        Output: s_dot^2, s_ddot and s_dot at the nodes [m2/s2, m/s2, m/s].

    """
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


@numba.njit(cache=True, nogil=True, error_model='numpy')
def follow_widths(h: FloatArray, a: FloatArray, v: FloatArray, width: FloatArray) -> float:
    """
    Update the effective widths from the states at the nodes.

    Parameters
    ----------
    h : ndarray, shape (n,)
        Cell widths [m].
    a, v : ndarray, shape (n + 1,)
        s_ddot and s_dot at the nodes [m/s2, m/s].
    width : ndarray, shape (n,)
        Effective widths H, updated in place [m].

    Returns
    -------
    float
        Largest change of a width, relative to its cell [-].

    """
    change = 0.0
    for i in range(len(h)):
        t = 2 * width[i] / (v[i] + v[i + 1])
        new = h[i] + (a[i + 1] - a[i]) * t * t / 12
        new = min(max(new, 0.6 * h[i]), 1.6 * h[i])
        change = max(change, abs(new - width[i]) / h[i])
        width[i] = new
    return change


@numba.njit(cache=True, nogil=True, error_model='numpy')
def terms_and_time(
    width: FloatArray,
    b: FloatArray,
    a: FloatArray,
    v: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    slope: FloatArray,
    d0: FloatArray,
    d1: FloatArray,
    d2: FloatArray,
) -> float:
    """
    Compute the terms of the rows and the time, both with their derivatives.

    Parameters
    ----------
    width : ndarray, shape (n,)
        Effective widths H [m].
    b, a, v : ndarray, shape (n + 1,)
        s_dot^2, s_ddot and s_dot at the nodes [m2/s2, m/s2, m/s].
    terms : ndarray, shape (n, 3, 3)
        Output: ``terms[i, 0]`` is (j, v a, v b) at the left end of cell i, ``terms[i, 1]`` the
        same at its right end, ``terms[i, 2]`` is (a, b, 0) at its left node.
    slopes : ndarray, shape (n, 3, 3, 3)
        Output: ``slopes[i, q, f]`` has the derivatives of term f by m_{i-1}, m_i, m_{i+1}.
        Derivatives by the fixed first and last coefficient are zero.
    slope : ndarray, shape (n,)
        Output: gradient of the time.
    d0, d1, d2 : ndarray, shape (n,)
        Output: the three upper diagonals of the Hessian of the time.

    Returns
    -------
    float
        Time [s].

    """
    n = len(width)
    total = 0.0
    slope[:] = 0.0
    d0[:] = 0.0
    d1[:] = 0.0
    d2[:] = 0.0
    da0, da1, db0 = np.zeros(3), np.zeros(3), np.zeros(3)
    db1, ds = np.zeros(3), np.zeros(3)
    for i in range(n):
        da0[:] = 0.0
        da1[:] = 0.0
        db0[:] = 0.0
        db1[:] = 0.0
        w = width[i]
        if i > 0:
            p = 1.0 / (width[i - 1] + w)
            if i > 1:
                da0[0], db0[0] = -p, p * w
            if i < n - 1:
                da0[1], db0[1] = p, p * width[i - 1]
        if i < n - 1:
            p = 1.0 / (w + width[i + 1])
            if i > 0:
                da1[1], db1[1] = -p, p * width[i + 1]
            if i < n - 2:
                da1[2], db1[2] = p, p * w
        v0, v1 = v[i], v[i + 1]
        r0 = 0.5 / v0 if v0 > 0.0 else 0.0
        r1 = 0.5 / v1 if v1 > 0.0 else 0.0
        sum_v = v0 + v1
        half = sum_v / (2 * w)
        rise = (a[i + 1] - a[i]) / (2 * w)
        terms[i, 0, 0], terms[i, 0, 1], terms[i, 0, 2] = rise * sum_v, v0 * a[i], v0 * b[i]
        terms[i, 1, 0], terms[i, 1, 1], terms[i, 1, 2] = rise * sum_v, v1 * a[i + 1], v1 * b[i + 1]
        terms[i, 2, 0], terms[i, 2, 1], terms[i, 2, 2] = a[i], b[i], 0.0
        for c in range(3):
            s0, s1 = r0 * db0[c], r1 * db1[c]
            ds[c] = s0 + s1
            dj = (da1[c] - da0[c]) * half + rise * ds[c]
            slopes[i, 0, 0, c] = dj
            slopes[i, 0, 1, c] = v0 * da0[c] + a[i] * s0
            slopes[i, 0, 2, c] = v0 * db0[c] + b[i] * s0
            slopes[i, 1, 0, c] = dj
            slopes[i, 1, 1, c] = v1 * da1[c] + a[i + 1] * s1
            slopes[i, 1, 2, c] = v1 * db1[c] + b[i + 1] * s1
            slopes[i, 2, 0, c] = da0[c]
            slopes[i, 2, 1, c] = db0[c]
            slopes[i, 2, 2, c] = 0.0
        time = 2 * w / sum_v
        total += time
        # d2(time) = 2 time/sum_v^2 ds ds^T - time/sum_v d2(sum_v), and d2(sum_v) is negative.
        k1, k2 = -time / sum_v, 2 * time / (sum_v * sum_v)
        e0 = 2 * r0 * r0 * r0 * time / sum_v
        e1 = 2 * r1 * r1 * r1 * time / sum_v
        for c in range(3):
            slot = i - 1 + c
            if slot < 0 or slot >= n:
                continue
            slope[slot] += k1 * ds[c]
            d0[slot] += k2 * ds[c] * ds[c] + e0 * db0[c] * db0[c] + e1 * db1[c] * db1[c]
            if c < 2:
                d1[slot] += (
                    k2 * ds[c] * ds[c + 1] + e0 * db0[c] * db0[c + 1] + e1 * db1[c] * db1[c + 1]
                )
            if c == 0:
                d2[slot] += k2 * ds[0] * ds[2]
    return total


@numba.njit(cache=True, nogil=True, error_model='numpy')
def build_rows(
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    scale: FloatArray,
    rows: FloatArray,
) -> None:
    """
    Write the rows of the interior point method: derivatives divided by the allowed limits.

    Parameters
    ----------
    left, right : ndarray, shape (4, n, n_axes)
        q and its derivatives by s at both ends of each cell [m or rad, per m^order].
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    scale : ndarray, shape (n, 4, n_axes)
        Parts of the limits that each cell may use [-].
    rows : ndarray, shape (n, 3, 3, n_axes)
        Output: factors of the terms; see ``barrier_rows.py``.

    """
    n, n_axes = left.shape[1], left.shape[2]
    for i in range(n):
        for k in range(n_axes):
            by_jerk = 1.0 / (table[2, k] * scale[i, 2, k])
            rows[i, 0, 0, k] = left[1, i, k] * by_jerk
            rows[i, 0, 1, k] = 3 * left[2, i, k] * by_jerk
            rows[i, 0, 2, k] = left[3, i, k] * by_jerk
            rows[i, 1, 0, k] = right[1, i, k] * by_jerk
            rows[i, 1, 1, k] = 3 * right[2, i, k] * by_jerk
            rows[i, 1, 2, k] = right[3, i, k] * by_jerk
            smaller = scale[i, 1, k] if i == 0 else min(scale[i - 1, 1, k], scale[i, 1, k])
            rows[i, 2, 0, k] = left[1, i, k] / (table[1, k] * smaller)
            rows[i, 2, 1, k] = left[2, i, k] / (table[1, k] * smaller)
            rows[i, 2, 2, k] = 0.0
