"""
The rows of the jerk stage: time, limits and their gradients in banded unknowns.

The path is cut into n cells of width ``h``; on each of them s_dddot is constant. The unknowns are
one number per cell, ``m_i``, the middle Bezier coefficient of b = s_dot^2 there, and with
p_i = 1/(H_{i-1} + H_i)

    s_ddot at node i   a_i = (m_i - m_{i-1}) p_i
    b at node i        b_i = m_i - a_i H_i = m_{i-1} + a_i H_{i-1}

which is the C1 quadratic spline on widths H. Were H the true width, b would be quadratic on the
cell and s_dddot proportional to s_dot. Constant s_dddot over the time t of the cell asks for
``H = h + (a_{i+1} - a_i) t^2/12`` instead, t = 2 H/(v_i + v_{i+1}): exact, H = 1.5 h for the cell
that leaves rest (b ~ s^(4/3), no singularity), and H = h to second order elsewhere, so H simply
follows the iterates.

Minimised is the time, sum of 2 H/(v_i + v_{i+1}); rows are scaled so that each reads |g| <= 1:

    jerk at both ends   alpha j + beta v a + gamma v b,  j = (a_{i+1} - a_i)(v_i + v_{i+1})/(2 H)
    acceleration        q_s a + q_ss b
    caps                m_i <= cap_i,  b_i <= min(cap_{i-1}, cap_i)

So a row is a fixed combination of at most three terms of its cell: (j, v a, v b) at the left end,
the same at the right end, (a, b) at the left node. Only these terms and their derivatives depend
on the iterate, and each touches m_{i-1}, m_i, m_{i+1}: the Newton matrix is pentadiagonal, and
an axis costs three multiplications.
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
    """Write b, s_ddot and s_dot at the nodes; ``ends`` = (b, a) at the start and at the end."""
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
    """Update the effective widths from the node states; returns the largest relative change."""
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
    Evaluate the terms of the rows with their derivatives, and the time with gradient and Hessian.

    ``terms[i, q]`` are those of cell i: q = 0 (j, v a, v b) at its left end, 1 the same at its
    right end, 2 (a, b, 0) at its left node; ``slopes[i, q, f]`` the derivatives of term f by
    m_{i-1}, m_i, m_{i+1}. Those by the fixed first and last coefficient are zero.
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
        # d2(time) = 2 time/sum^2 ds ds^T - time/sum * (second derivative of sum_v, negative)
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
