"""
The steps of the interior point method: predictor, corrector, and how far they are taken.

``barrier_rows.py`` describes the rows, the arrays and their shapes.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.barrier_rows import cap_slope, has_free_terms, is_fixed_cap

KEPT_STEP = 0.98
"""Part of the longest step with positive slacks and duals that is taken [-]."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _linearised_terms(
    terms: FloatArray, slopes: FloatArray, before: float, here: float, after: float
) -> tuple[float, float, float]:
    """Return the three terms, linearised, after the step (before, here, after) of m."""
    return (
        terms[0] + slopes[0, 0] * before + slopes[0, 1] * here + slopes[0, 2] * after,
        terms[1] + slopes[1, 0] * before + slopes[1, 1] * here + slopes[1, 2] * after,
        terms[2] + slopes[2, 0] * before + slopes[2, 1] * here + slopes[2, 2] * after,
    )


@numba.njit(cache=True, nogil=True, error_model='numpy')
def predict(
    rows: FloatArray,
    caps: FloatArray,
    m: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    dm: FloatArray,
    change: FloatArray,
) -> tuple[float, float]:
    """
    Compute the predictor step of slacks and duals.

    With t = dw/w the slack stays positive up to a step length of -1/t. The dual step is
    dy = -y (1 + t), so the dual stays positive up to 1/(1 + t).

    Parameters
    ----------
    rows, caps, m, terms, slopes, weight, slack, dual, inverse, dm : ndarray
        Input, with the shapes of the module docstring.
    change : ndarray, shape (n, 3 n_axes + 2, 2)
        Output: products dw dy of each row, for the corrector.

    Returns
    -------
    step, square : float
        Longest step length with positive slacks and duals, at most 1, and the sum of dw dy
        divided by the cell weights.

    """
    n, n_axes = rows.shape[0], rows.shape[3]
    worst, square = 1.0, 0.0
    for i in range(n):
        before = dm[i - 1] if i > 0 else 0.0
        after = dm[i + 1] if i < n - 1 else 0.0
        cell_square = 0.0
        for q in range(3):
            if not has_free_terms(slopes[i, q]):
                continue
            x0, x1, x2 = _linearised_terms(terms[i, q], slopes[i, q], before, dm[i], after)
            for k in range(n_axes):
                c0, c1, c2 = rows[i, q, 0, k], rows[i, q, 1, k], rows[i, q, 2, k]
                if c0 == 0.0 and c1 == 0.0 and c2 == 0.0:
                    continue
                r = q * n_axes + k
                g = c0 * x0 + c1 * x1 + c2 * x2
                dw0, dw1 = 1.0 - slack[i, r, 0] - g, 1.0 - slack[i, r, 1] + g
                t0, t1 = dw0 * inverse[i, r, 0], dw1 * inverse[i, r, 1]
                worst = max(worst, max(max(-t0, -t1), 1.0 + max(t0, t1)))
                change[i, r, 0] = -dual[i, r, 0] * dw0 * (1.0 + t0)
                change[i, r, 1] = -dual[i, r, 1] * dw1 * (1.0 + t1)
                cell_square += change[i, r, 0] + change[i, r, 1]
        for which in range(2):
            if is_fixed_cap(i, n, which):
                continue
            r, cap = 3 * n_axes + which, caps[i, which]
            g = _linearised_cap(m, terms[i], slopes[i], cap, which, i, before, dm[i], after)
            dw = 1.0 - slack[i, r, 0] - g
            t = dw * inverse[i, r, 0]
            worst = max(worst, max(-t, 1.0 + t))
            change[i, r, 0] = -dual[i, r, 0] * dw * (1.0 + t)
            cell_square += change[i, r, 0]
        square += cell_square / weight[i]
    return 1.0 / worst, square


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _linearised_cap(
    m: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    cap: float,
    which: int,
    i: int,
    before: float,
    here: float,
    after: float,
) -> float:
    """Return the left side of a cap row, linearised, after the step (before, here, after) of m."""
    if which == 0:
        return float((m[i] + here) / cap)
    b = terms[2, 1] + slopes[2, 1, 0] * before + slopes[2, 1, 1] * here + slopes[2, 1, 2] * after
    return float(b / cap)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def correct(
    target: float,
    second_order: float,
    rows: FloatArray,
    caps: FloatArray,
    slopes: FloatArray,
    weight: FloatArray,
    inverse: FloatArray,
    change: FloatArray,
    rhs: FloatArray,
) -> None:
    """
    Turn the right-hand side of the predictor into that of the corrector.

    Parameters
    ----------
    target : float
        Wanted product of slack and dual, per unit of cell weight.
    second_order : float
        Factor of the products dw dy.
    rows, caps, slopes, weight, inverse, change : ndarray
        Input, with the shapes of the module docstring.
    rhs : ndarray, shape (n,)
        Right-hand side, updated in place.

    """
    n, n_axes = rows.shape[0], rows.shape[3]
    push_by = np.zeros(3)
    for i in range(n):
        aim = target * weight[i]
        push_by[:] = 0.0
        for q in range(3):
            if not has_free_terms(slopes[i, q]):
                continue
            p0, p1, p2 = 0.0, 0.0, 0.0
            for k in range(n_axes):
                c0, c1, c2 = rows[i, q, 0, k], rows[i, q, 1, k], rows[i, q, 2, k]
                if c0 == 0.0 and c1 == 0.0 and c2 == 0.0:
                    continue
                r = q * n_axes + k
                push = (aim - second_order * change[i, r, 0]) * inverse[i, r, 0]
                push -= (aim - second_order * change[i, r, 1]) * inverse[i, r, 1]
                p0 += push * c0
                p1 += push * c1
                p2 += push * c2
            for c in range(3):
                push_by[c] += (
                    p0 * slopes[i, q, 0, c] + p1 * slopes[i, q, 1, c] + p2 * slopes[i, q, 2, c]
                )
        for which in range(2):
            if is_fixed_cap(i, n, which):
                continue
            r = 3 * n_axes + which
            push = (aim - second_order * change[i, r, 0]) * inverse[i, r, 0]
            for c in range(3):
                push_by[c] += push * cap_slope(slopes[i], caps[i, which], which, c)
        for c in range(3):
            if 0 <= i - 1 + c < n:
                rhs[i - 1 + c] -= push_by[c]


@numba.njit(cache=True, nogil=True, error_model='numpy')
def advance(
    target: float,
    second_order: float,
    rows: FloatArray,
    caps: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    weight: FloatArray,
    m: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    change: FloatArray,
    dm: FloatArray,
    next_dual: FloatArray,
) -> tuple[float, float]:
    """
    Take the corrected step while slacks, duals and coefficients stay positive.

    Parameters
    ----------
    target, second_order : float
        The arguments that ``correct`` had.
    rows, caps, terms, slopes, weight, inverse, dm : ndarray
        Input, with the shapes of the module docstring.
    m, slack, dual : ndarray
        Coefficients, slacks and duals, updated in place.
    change, next_dual : ndarray, shape (n, 3 n_axes + 2, 2)
        Products dw dy on entry; overwritten with the steps dw and dy.

    Returns
    -------
    primal, adjoint : float
        Step lengths of slacks and coefficients, and of duals [-].

    """
    n, n_axes = rows.shape[0], rows.shape[3]
    primal_worst, dual_worst = KEPT_STEP, KEPT_STEP
    for i in range(n):
        before = dm[i - 1] if i > 0 else 0.0
        after = dm[i + 1] if i < n - 1 else 0.0
        aim = target * weight[i]
        for q in range(3):
            if not has_free_terms(slopes[i, q]):
                continue
            x0, x1, x2 = _linearised_terms(terms[i, q], slopes[i, q], before, dm[i], after)
            for k in range(n_axes):
                c0, c1, c2 = rows[i, q, 0, k], rows[i, q, 1, k], rows[i, q, 2, k]
                if c0 == 0.0 and c1 == 0.0 and c2 == 0.0:
                    continue
                r = q * n_axes + k
                g = c0 * x0 + c1 * x1 + c2 * x2
                y0, y1 = dual[i, r, 0], dual[i, r, 1]
                i0, i1 = inverse[i, r, 0], inverse[i, r, 1]
                dw0, dw1 = 1.0 - slack[i, r, 0] - g, 1.0 - slack[i, r, 1] + g
                dy0 = (aim - second_order * change[i, r, 0] - y0 * dw0) * i0 - y0
                dy1 = (aim - second_order * change[i, r, 1] - y1 * dw1) * i1 - y1
                primal_worst = max(primal_worst, max(-dw0 * i0, -dw1 * i1))
                dual_worst = max(dual_worst, max(-dy0 / y0, -dy1 / y1))
                change[i, r, 0], change[i, r, 1] = dw0, dw1
                next_dual[i, r, 0], next_dual[i, r, 1] = dy0, dy1
        for which in range(2):
            if is_fixed_cap(i, n, which):
                continue
            r, cap = 3 * n_axes + which, caps[i, which]
            g = _linearised_cap(m, terms[i], slopes[i], cap, which, i, before, dm[i], after)
            y = dual[i, r, 0]
            dw = 1.0 - slack[i, r, 0] - g
            dy = (aim - second_order * change[i, r, 0] - y * dw) * inverse[i, r, 0] - y
            primal_worst = max(primal_worst, -dw * inverse[i, r, 0])
            dual_worst = max(dual_worst, -dy / y)
            change[i, r, 0], next_dual[i, r, 0] = dw, dy
    primal, adjoint = KEPT_STEP / primal_worst, KEPT_STEP / dual_worst
    for i in range(1, n - 1):
        if dm[i] * primal < -0.9 * m[i]:
            primal = -0.9 * m[i] / dm[i]
    for i in range(n):
        m[i] += primal * dm[i]
        for r in range(slack.shape[1]):
            for side in range(2):
                slack[i, r, side] += primal * change[i, r, side]
                dual[i, r, side] += adjoint * next_dual[i, r, side]
    return primal, adjoint
