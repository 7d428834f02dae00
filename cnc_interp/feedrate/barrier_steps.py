"""
The steps of the interior point method: predictor, corrector, and how far they are taken.

``barrier_rows.py`` describes the rows, the arrays and their shapes.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.distinct_arrays import DistinctArrays
from cnc_interp.feedrate.barrier_rows import (
    CHUNK,
    add_to,
    by_coefficients,
    constant_of,
    places_of,
)
from cnc_interp.feedrate.jerk_rows import slope_rows, term_rows

KEPT_STEP = 0.98
"""Part of the longest step with positive slacks and duals that is taken [-]."""


@numba.njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _predict_rows(
    c0: FloatArray,
    c1: FloatArray,
    c2: FloatArray,
    constant: FloatArray,
    x0: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    w0: FloatArray,
    w1: FloatArray,
    y0: FloatArray,
    y1: FloatArray,
    a0: FloatArray,
    a1: FloatArray,
    a2: FloatArray,
    b0: FloatArray,
    b1: FloatArray,
    b2: FloatArray,
    square: FloatArray,
    worst: FloatArray,
) -> None:
    """Predict the steps of the rows of one axis and place; x are the linearised terms."""
    for j in range(len(c0)):
        f0, f1, f2 = c0[j], c1[j], c2[j]
        g = f0 * x0[j] + f1 * x1[j] + f2 * x2[j] + constant[j]
        i0, i1 = 1.0 / w0[j], 1.0 / w1[j]
        dw0, dw1 = 1.0 - w0[j] - g, 1.0 - w1[j] + g
        t0, t1 = dw0 * i0, dw1 * i1
        worst[j] = max(worst[j], max(max(-t0, -t1), 1.0 + max(t0, t1)))
        z0, z1 = -y0[j] * dw0 * (1.0 + t0), -y1[j] * dw1 * (1.0 + t1)
        square[j] += z0 + z1
        centre, bent = i0 - i1, z0 * i0 - z1 * i1
        a0[j] += centre * f0
        a1[j] += centre * f1
        a2[j] += centre * f2
        b0[j] += bent * f0
        b1[j] += bent * f1
        b2[j] += bent * f2


@numba.njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _predict_cap(
    cap: FloatArray,
    x: FloatArray,
    w: FloatArray,
    y: FloatArray,
    a: FloatArray,
    b: FloatArray,
    square: FloatArray,
    worst: FloatArray,
) -> None:
    """Predict the steps of one cap row of each cell; write the forces a and b on its term."""
    for j in range(len(cap)):
        inverse = 1.0 / w[j]
        dw = 1.0 - w[j] - cap[j] * x[j]
        t = dw * inverse
        worst[j] = max(worst[j], max(-t, 1.0 + t))
        z = -y[j] * dw * (1.0 + t)
        square[j] += z
        a[j], b[j] = inverse * cap[j], z * inverse * cap[j]


@numba.njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _add_product(total: FloatArray, part: FloatArray, factor: FloatArray) -> None:
    """Add a part, times a factor of its own for each cell, to a sum."""
    for j in range(len(factor)):
        total[j] += factor[j] * part[j]


@numba.njit(cache=True, nogil=True, error_model='numpy')
def predict(
    rows: FloatArray,
    inverse_caps: FloatArray,
    m_reached: FloatArray,
    reached: FloatArray,
    slopes: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    centring: FloatArray,
    bending: FloatArray,
) -> tuple[float, float]:
    """
    Compute how far the predictor step may go, and what the corrector needs of it.

    With t = dw/w the slack stays positive up to a step length of -1/t. The dual step is
    dy = -y (1 + t), so the dual stays positive up to 1/(1 + t). The corrector wants
    w dy + y dw = target weight - w y - factor dw dy: two forces on the coefficients.

    Parameters
    ----------
    rows, inverse_caps, slopes, weight, slack, dual : ndarray
        Input, with the shapes of ``barrier_rows``.
    m_reached, reached : ndarray, shape (n,), (7, n + 1)
        Coefficients and linearised terms after the whole predictor step.
    centring, bending : ndarray, shape (n + 2,)
        Output: forces of ``weight`` and of the products dw dy.

    Returns
    -------
    step, square : float
        Longest step length with positive slacks and duals, at most 1, and the sum of dw dy
        divided by the cell weights.

    """
    n, n_axes, places = len(m_reached), rows.shape[0], places_of(rows)
    worst, square = 1.0, 0.0
    centring[:], bending[:] = 0.0, 0.0
    # Rows of x: both forces on the three coefficients of each cell, dw dy, 1 / step length.
    s, x, zero = np.empty((6, CHUNK)), np.empty((8, CHUNK)), np.zeros(CHUNK)
    for lo in range(0, n, CHUNK):
        hi = min(lo + CHUNK, n)
        here = slice(lo, hi)
        x[:] = 0.0
        for q in range(places):
            s[:] = 0.0
            x0, x1, x2 = term_rows(reached, q, lo, hi)
            for k in range(n_axes):
                c, r = 3 * q, 2 * (places * k + q)
                _predict_rows(
                    rows[k, c, here], rows[k, c + 1, here], rows[k, c + 2, here],
                    constant_of(rows, k, q, lo, hi, zero), x0, x1, x2,
                    slack[r, here], slack[r + 1, here], dual[r, here], dual[r + 1, here],
                    s[0], s[1], s[2], s[3], s[4], s[5], x[6], x[7],
                )  # fmt: skip
            z = slope_rows(slopes, q, lo, hi)
            by_coefficients(s[0], s[1], s[2], *z, x[0], x[1], x[2])
            by_coefficients(s[3], s[4], s[5], *z, x[3], x[4], x[5])
        r = 2 * places * n_axes
        _predict_cap(
            inverse_caps[0, here], m_reached[here], slack[r, here], dual[r, here],
            s[0], s[1], x[6], x[7],
        )  # fmt: skip
        _predict_cap(
            inverse_caps[1, here], reached[4, here], slack[r + 1, here], dual[r + 1, here],
            s[2], s[3], x[6], x[7],
        )  # fmt: skip
        add_to(x[1], s[0], 1.0)
        add_to(x[4], s[1], 1.0)
        left, right = slopes[9, here], slopes[10, here]
        _add_product(x[0], s[2], left)
        _add_product(x[3], s[3], left)
        _add_product(x[1], s[2], right)
        _add_product(x[4], s[3], right)
        for j in range(hi - lo):
            square += x[6, j] / weight[lo + j]
            worst = max(worst, x[7, j])
        for c in range(3):
            _add_product(centring[lo + c : hi + c], x[c], weight[here])
            add_to(bending[lo + c : hi + c], x[3 + c], 1.0)
    return 1.0 / worst, square


@numba.njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _step_rows(
    target: float,
    second_order: float,
    c0: FloatArray,
    c1: FloatArray,
    c2: FloatArray,
    constant: FloatArray,
    p0: FloatArray,
    p1: FloatArray,
    p2: FloatArray,
    x0: FloatArray,
    x1: FloatArray,
    x2: FloatArray,
    sign: float,
    weight: FloatArray,
    w: FloatArray,
    y: FloatArray,
    dw: FloatArray,
    dy: FloatArray,
    primal: FloatArray,
    adjoint: FloatArray,
) -> None:
    """Write the steps of one side of the rows: sign g <= 1; p, x are terms after both steps."""
    for j in range(len(c0)):
        f0, f1, f2 = sign * c0[j], sign * c1[j], sign * c2[j]
        inverse, there = 1.0 / w[j], 1.0 - w[j] - sign * constant[j]
        predicted = there - (f0 * p0[j] + f1 * p1[j] + f2 * p2[j])
        step = there - (f0 * x0[j] + f1 * x1[j] + f2 * x2[j])
        product = -y[j] * predicted * (1.0 + predicted * inverse)
        aim = target * weight[j] if y[j] > 0.0 else 0.0
        next_dual = (aim - second_order * product - y[j] * step) * inverse - y[j]
        primal[j] = max(primal[j], -step * inverse)
        adjoint[j] = max(adjoint[j], -next_dual / y[j] if y[j] > 0.0 else 0.0)
        dw[j], dy[j] = step, next_dual


@numba.njit(cache=True, nogil=True, error_model='numpy')
def advance(
    target: float,
    second_order: float,
    rows: FloatArray,
    inverse_caps: FloatArray,
    m_predicted: FloatArray,
    predicted: FloatArray,
    m_reached: FloatArray,
    reached: FloatArray,
    weight: FloatArray,
    m: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    change: FloatArray,
    next_dual: FloatArray,
) -> tuple[float, float]:
    """
    Take the corrected step while slacks, duals and coefficients stay positive.

    Parameters
    ----------
    target : float
        Wanted product of slack and dual, per unit of cell weight.
    second_order : float
        Factor of the products dw dy of the predictor.
    rows, inverse_caps, weight : ndarray
        Input, with the shapes of ``barrier_rows``.
    m_predicted, predicted, m_reached, reached : ndarray, shape (n,), (7, n + 1)
        Coefficients and linearised terms after the whole step of predictor and corrector.
    m, slack, dual : ndarray
        Coefficients, slacks and duals, updated in place.
    change, next_dual : ndarray, shape (r, n)
        Room for the steps of slacks and duals.

    Returns
    -------
    primal, adjoint : float
        Step lengths of slacks and coefficients, and of duals [-].

    """
    n, n_axes, places = len(m), rows.shape[0], places_of(rows)
    primal_worst, dual_worst = KEPT_STEP, KEPT_STEP
    f, zero = np.empty((2, CHUNK)), np.zeros(CHUNK)
    for lo in range(0, n, CHUNK):
        hi = min(lo + CHUNK, n)
        here = slice(lo, hi)
        f[:] = 0.0
        for q in range(places):
            p, x = term_rows(predicted, q, lo, hi), term_rows(reached, q, lo, hi)
            for k in range(n_axes):
                c0, c1 = rows[k, 3 * q, here], rows[k, 3 * q + 1, here]
                c2, constant = rows[k, 3 * q + 2, here], constant_of(rows, k, q, lo, hi, zero)
                for side in range(2):
                    r = 2 * (places * k + q) + side
                    _step_rows(
                        target, second_order, c0, c1, c2, constant, *p, *x, 1.0 - 2.0 * side,
                        weight[here], slack[r, here], dual[r, here],
                        change[r, here], next_dual[r, here], f[0], f[1],
                    )  # fmt: skip
        for which in range(2):
            r, cap = 2 * places * n_axes + which, inverse_caps[which, here]
            p0 = m_predicted[here] if which == 0 else predicted[4, here]
            x0 = m_reached[here] if which == 0 else reached[4, here]
            _step_rows(
                target, second_order, cap, zero, zero, zero, p0, zero, zero, x0, zero, zero, 1.0,
                weight[here], slack[r, here], dual[r, here],
                change[r, here], next_dual[r, here], f[0], f[1],
            )  # fmt: skip
        for j in range(hi - lo):
            primal_worst, dual_worst = max(primal_worst, f[0, j]), max(dual_worst, f[1, j])
    primal, adjoint = KEPT_STEP / primal_worst, KEPT_STEP / dual_worst
    for i in range(1, n - 1):
        dm = m_reached[i] - m[i]
        if dm * primal < -0.9 * m[i]:
            primal = -0.9 * m[i] / dm
    for i in range(n):
        m[i] += primal * (m_reached[i] - m[i])
    for r in range(len(slack)):
        add_to(slack[r], change[r], primal)
        add_to(dual[r], next_dual[r], adjoint)
    return primal, adjoint
