"""
The inequality rows of the jerk stage inside one iteration of the interior point method.

Each row g <= 1 has a slack w and a dual y. A row |g| <= 1 has one of each per side. A row of an
axis is a constant combination of the three terms of its cell (module ``jerk_rows``). Therefore
sums over the axes are first made in the terms. They are multiplied by the derivatives by m_{i-1},
m_i, m_{i+1} only once per cell. ``rows[i, q, f, k]`` is the factor of term f at place q of cell i
for axis k; it belongs to row q n_axes + k. The last two rows are the speed caps of the cell and
of its left node. A row without a free coefficient is skipped.

Arrays of this module, for n cells and r = 3 n_axes + 2 rows per cell:

    rows     (n, 3, 3, n_axes)  factors of the terms, scaled so that the limit is 1
    caps     (n, 2)             largest s_dot^2 in the cell and at its left node [m2/s2]
    m        (n,)               coefficients: the unknowns [m2/s2]
    terms    (n, 3, 3)          terms of the rows;  slopes (n, 3, 3, 3): their derivatives
    weight   (n,)               barrier weight of the cell: its share of the time [-]
    slack, dual, inverse        (n, r, 2): w, y and 1/w of both sides of each row
    change, next_dual           (n, r, 2): products dw dy or steps dw; steps dy
    d0, d1, d2                  (n,): diagonals of the Newton matrix
    rhs, residual, dm           (n,): right-hand side, dual residual, step of m
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray

WARM_SLACK, WARM_GAP = 1e-2, 1e-4
"""Smallest slack, and slack times dual over the time, at the beginning of a warm start."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def has_free_terms(slopes: FloatArray) -> bool:
    """Tell whether the terms depend on a free coefficient; other rows are skipped."""
    for f in range(3):
        for c in range(3):
            if slopes[f, c] != 0.0:
                return True
    return False


@numba.njit(cache=True, nogil=True, error_model='numpy')
def is_fixed_cap(i: int, n: int, which: int) -> bool:
    """Tell whether the cap of the cell (which = 0) or of its node (1) has no free coefficient."""
    return i == 0 or n < 3 or (which == 0 and i == n - 1)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def add_rows(
    rows: FloatArray,
    caps: FloatArray,
    m: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    d0: FloatArray,
    d1: FloatArray,
    d2: FloatArray,
    residual: FloatArray,
    rhs: FloatArray,
) -> tuple[float, float, float, int]:
    """
    Add the rows to the Newton matrix and to the right-hand side of the predictor step.

    Parameters
    ----------
    rows, caps, m, terms, slopes, weight, slack, dual : ndarray
        Input, with the shapes of the module docstring.
    inverse : ndarray, shape (n, 3 n_axes + 2, 2)
        Output: reciprocals of the slacks.
    d0, d1, d2, residual, rhs : ndarray, shape (n,)
        Diagonals of the Newton matrix, dual residual and right-hand side; the rows are added.

    Returns
    -------
    gap, weighted, violation, count : float, float, float, int
        Sum of dual times slack, the same sum divided by the cell weights, largest violation of a
        row, number of one-sided rows.

    """
    n, n_axes = rows.shape[0], rows.shape[3]
    gap, weighted, violation = 0.0, 0.0, 0.0
    count = 0
    square, push_by, pull_by = np.zeros((3, 3)), np.zeros(3), np.zeros(3)
    for i in range(n):
        square[:] = 0.0
        push_by[:] = 0.0
        pull_by[:] = 0.0
        cell_gap = 0.0
        for q in range(3):
            if not has_free_terms(slopes[i, q]):
                continue
            x0, x1, x2 = terms[i, q, 0], terms[i, q, 1], terms[i, q, 2]
            s00, s01, s02, s11, s12, s22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            p0, p1, p2, u0, u1, u2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for k in range(n_axes):
                c0, c1, c2 = rows[i, q, 0, k], rows[i, q, 1, k], rows[i, q, 2, k]
                if c0 == 0.0 and c1 == 0.0 and c2 == 0.0:
                    continue
                r = q * n_axes + k
                w0, w1, y0, y1 = slack[i, r, 0], slack[i, r, 1], dual[i, r, 0], dual[i, r, 1]
                g = c0 * x0 + c1 * x1 + c2 * x2
                i0, i1 = 1.0 / w0, 1.0 / w1
                inverse[i, r, 0], inverse[i, r, 1] = i0, i1
                r0, r1 = y0 * i0, y1 * i1
                push, pull, both = r0 * (w0 - 1.0 + g) - r1 * (w1 - 1.0 - g), y0 - y1, r0 + r1
                cell_gap += y0 * w0 + y1 * w1
                violation = max(violation, abs(g) - 1.0)
                count += 2
                s00 += both * c0 * c0
                s01 += both * c0 * c1
                s02 += both * c0 * c2
                s11 += both * c1 * c1
                s12 += both * c1 * c2
                s22 += both * c2 * c2
                p0 += push * c0
                p1 += push * c1
                p2 += push * c2
                u0 += pull * c0
                u1 += pull * c1
                u2 += pull * c2
            for c in range(3):
                e0, e1, e2 = slopes[i, q, 0, c], slopes[i, q, 1, c], slopes[i, q, 2, c]
                push_by[c] += p0 * e0 + p1 * e1 + p2 * e2
                pull_by[c] += u0 * e0 + u1 * e1 + u2 * e2
                t0 = s00 * e0 + s01 * e1 + s02 * e2
                t1 = s01 * e0 + s11 * e1 + s12 * e2
                t2 = s02 * e0 + s12 * e1 + s22 * e2
                for d in range(c, 3):
                    square[c, d] += (
                        t0 * slopes[i, q, 0, d] + t1 * slopes[i, q, 1, d] + t2 * slopes[i, q, 2, d]
                    )
        for which in range(2):
            if is_fixed_cap(i, n, which):
                continue
            r, cap = 3 * n_axes + which, caps[i, which]
            g = m[i] / cap if which == 0 else terms[i, 2, 1] / cap
            w, y = slack[i, r, 0], dual[i, r, 0]
            inverse[i, r, 0] = 1.0 / w
            ratio = y / w
            push = ratio * (g + w - 1.0)
            cell_gap += y * w
            violation = max(violation, g - 1.0)
            count += 1
            for c in range(3):
                e = cap_slope(slopes[i], cap, which, c)
                push_by[c] += push * e
                pull_by[c] += y * e
                for d in range(c, 3):
                    square[c, d] += ratio * e * cap_slope(slopes[i], cap, which, d)
        gap += cell_gap
        weighted += cell_gap / weight[i]
        for c in range(3):
            slot = i - 1 + c
            if slot < 0 or slot >= n:
                continue
            rhs[slot] -= push_by[c]
            residual[slot] += pull_by[c]
            d0[slot] += square[c, c]
            if c < 2:
                d1[slot] += square[c, c + 1]
            if c == 0:
                d2[slot] += square[0, 2]
    return gap, weighted, violation, count


@numba.njit(cache=True, nogil=True, error_model='numpy')
def cap_slope(slopes: FloatArray, cap: float, which: int, c: int) -> float:
    """Return the derivative of a cap row by m_{i-1} (c = 0), m_i (1) or m_{i+1} (2)."""
    if which == 1:
        return float(slopes[2, 1, c] / cap)
    return 1.0 / cap if c == 1 else 0.0


@numba.njit(cache=True, nogil=True, error_model='numpy')
def start_rows(
    total: float,
    rows: FloatArray,
    caps: FloatArray,
    m: FloatArray,
    terms: FloatArray,
    width: FloatArray,
    v: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    warm: bool,
) -> None:
    """
    Set the cell weights by time, and start slacks and duals.

    Parameters
    ----------
    total : float
        Time of the starting point [s].
    rows, caps, m, terms : ndarray
        Input, with the shapes of the module docstring.
    width : ndarray, shape (n,)
        Effective widths [m].
    v : ndarray, shape (n + 1,)
        s_dot at the nodes [m/s].
    weight, slack : ndarray
        Output: cell weights and slacks.
    dual : ndarray, shape (n, 3 n_axes + 2, 2)
        Output: duals. A warm start keeps larger values of the last solution.
    warm : bool
        Whether ``dual`` holds the last solution of nearly the same problem.

    """
    n, n_axes = rows.shape[0], rows.shape[3]
    least, level = (WARM_SLACK, WARM_GAP) if warm else (1.0, 0.3)
    for i in range(n):
        share = 2 * width[i] / (v[i] + v[i + 1]) / total
        weight[i] = max(n * share, 1e-3)
        for r in range(3 * n_axes + 2):
            q, k = r // n_axes, r % n_axes
            if q < 3:
                g = rows[i, q, 0, k] * terms[i, q, 0] + rows[i, q, 1, k] * terms[i, q, 1]
                g += rows[i, q, 2, k] * terms[i, q, 2]
            else:
                g = (m[i] if k == 0 else terms[i, 2, 1]) / caps[i, k]
            slack[i, r, 0] = max(1.0 - g, least)
            slack[i, r, 1] = max(1.0 + g, least)
            for side in range(2):
                balanced = level * total / n * weight[i] / slack[i, r, side]
                dual[i, r, side] = max(dual[i, r, side], balanced) if warm else balanced
