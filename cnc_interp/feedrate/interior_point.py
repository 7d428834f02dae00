"""
A primal-dual interior point method with predictor and corrector, for the jerk stage.

It needs no feasible starting point. The Hessian is that of the time plus the Gauss-Newton terms of
the rows; for jerk rows this is the convexification by tangents. The barrier of a cell is weighted
with its share of the time. Without the weight, short cells would stay away from their limits.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.barrier_rows import add_rows, start_rows
from cnc_interp.feedrate.barrier_steps import advance, predict
from cnc_interp.feedrate.jerk_rows import (
    follow_widths,
    linearise,
    node_states,
    terms_and_time,
)

SOLVED, STALLED, BROKEN = 0, 1, 2


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _factorize(d0: FloatArray, d1: FloatArray, d2: FloatArray) -> bool:
    """
    Factor a symmetric pentadiagonal matrix into L D L^T in place; False if it is not finite.

    ``d0`` becomes 1/D. If rounding makes a pivot too small, a very large one replaces it. Its
    unknown then does not change in this iteration.
    """
    n = len(d0)
    given = d0.copy()
    for i in range(n):
        pivot = d0[i]
        if not np.isfinite(pivot):
            return False
        if not pivot > 1e-14 * given[i]:
            pivot = 1e30 * (given[i] + 1e-300)
        inverse = 1.0 / pivot
        d0[i] = inverse
        first, second = d1[i], d2[i]
        l1, l2 = first * inverse, second * inverse
        if i + 1 < n:
            d0[i + 1] -= l1 * first
            d1[i + 1] -= l1 * second
        if i + 2 < n:
            d0[i + 2] -= l2 * second
        d1[i], d2[i] = l1, l2
    return True


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _substitute(inverse: FloatArray, l1: FloatArray, l2: FloatArray, x: FloatArray) -> None:
    """Solve for the right-hand side ``x`` in place, with the factors from ``_factorize``."""
    n = len(x)
    before, earlier = 0.0, 0.0
    for i in range(n):
        value = x[i]
        if i > 1:
            value -= l2[i - 2] * earlier
        if i > 0:
            value -= l1[i - 1] * before
        x[i] = value
        before, earlier = value, before
    after, later = 0.0, 0.0
    for i in range(n - 1, -1, -1):
        value = x[i] * inverse[i] - l2[i] * later - l1[i] * after
        x[i] = value
        after, later = value, after


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _inverse_caps(caps: FloatArray) -> FloatArray:
    """Return the reciprocals of the caps of cells and left nodes; 0 where nothing is free."""
    n = len(caps)
    inverse = np.zeros((2, n))
    if n < 3:
        return inverse
    for i in range(1, n):
        inverse[0, i] = 1.0 / caps[i, 0] if i < n - 1 else 0.0
        inverse[1, i] = 1.0 / caps[i, 1]
    return inverse


@numba.njit(cache=True, nogil=True, error_model='numpy')
def solve(
    h: FloatArray,
    rows: FloatArray,
    caps: FloatArray,
    ends: FloatArray,
    m: FloatArray,
    width: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    warm: bool,
    tolerance: float,
    most_iterations: int,
) -> tuple[int, int, float]:
    """
    Minimise the time over one part of the path.

    Parameters
    ----------
    h : ndarray, shape (n,)
        Cell widths [m].
    rows : ndarray, shape (n_axes, 9, n) or (n_axes, 13, n)
        Per axis: q_s, 3 q_ss, q_sss over the jerk limit at the left ends of the cells; the same at
        their right ends; then q_s, q_ss, 0 over the acceleration limit at their left nodes. With
        torques also q_s, q_ss, (B/J) q_s over T/J at these nodes, and sign(q_s) C/T.
    caps : ndarray, shape (n, 2)
        Largest coefficient of each cell, and largest s_dot^2 at its left node [m2/s2].
    ends : ndarray, shape (4,)
        s_dot^2 and s_ddot at the start, then at the end [m2/s2, m/s2].
    m : ndarray, shape (n,)
        Coefficients: a positive starting point on entry, the solution on return [m2/s2].
    width : ndarray, shape (n,)
        Effective widths; those of the solution on return [m].
    slack, dual : ndarray, shape (6 n_axes + 2, n) or (8 n_axes + 2, n)
        Slacks and duals of the rows. With ``warm`` they start from the last solution.
    warm : bool
        Whether ``m``, ``slack`` and ``dual`` solve the same problem with slightly other limits.
    tolerance : float
        Accepted gap to the optimum, relative to the time [-].
    most_iterations : int
        Largest number of iterations.

    Returns
    -------
    status, iterations, time : int, int, float
        SOLVED, STALLED or BROKEN, the number of iterations and the time reached [s].

    """
    n, n_rows = len(h), len(slack)
    b, a, v = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    terms, slopes = np.zeros((7, n + 1)), np.zeros((14, n + 1))
    predicted, reached = np.zeros((7, n + 1)), np.zeros((7, n + 1))
    inverse_caps = _inverse_caps(caps)
    change, next_dual = np.empty((n_rows, n)), np.empty((n_rows, n))
    d0, d1, d2 = np.empty(n + 2), np.empty(n + 2), np.empty(n + 2)
    rhs, residual = np.empty(n + 2), np.empty(n + 2)
    centring, bending = np.empty(n + 2), np.empty(n + 2)
    dm, weight = np.zeros(n + 2), np.ones(n)
    inner = slice(1, n + 1)
    total, count = 0.0, 0
    calm = False
    for iteration in range(most_iterations):
        node_states(m, width, ends, b, a, v)
        total = terms_and_time(width, b, a, v, terms, slopes)
        if not np.isfinite(total):
            return BROKEN, iteration, total
        if iteration == 0:
            count = start_rows(
                total, rows, inverse_caps, m, terms, width, v, weight, slack, dual, warm
            )
        gap, weighted, violation = add_rows(
            rows, inverse_caps, m, width, v, terms, slopes, weight, slack, dual,
            d0, d1, d2, residual, rhs,
        )  # fmt: skip
        centre = weighted / max(count, 1)
        off = 0.0
        for i in range(n):
            off += abs(residual[i + 1]) * m[i]
        if calm and gap < tolerance * total and violation < 2e-4 and off < 1e-3 * total:
            return SOLVED, iteration, total
        for i in (1, n):
            d0[i], rhs[i] = 1.0, 0.0
        if not _factorize(d0[inner], d1[inner], d2[inner]):
            return BROKEN, iteration, total
        dm[inner] = rhs[inner]
        _substitute(d0[inner], d1[inner], d2[inner], dm[inner])
        linearise(terms, slopes, dm, predicted)
        m_predicted = m + dm[inner]
        step, square = predict(
            rows, inverse_caps, m_predicted, predicted, slopes, weight, slack, dual,
            centring, bending,
        )  # fmt: skip
        # sum of (w + step dw)(y + step dy) with w dy + y dw = -w y
        left = centre * (1.0 - step) + step * step * square / max(count, 1)
        sigma = (left / centre) ** 3
        sigma = min(max(sigma, 1e-3), 0.9)
        # The gap may stay at the tolerance: the jerk rows converge linearly in the meantime.
        target = max(sigma * centre, min(centre, 0.2 * tolerance * total / (n * (n_rows / 2 + 1))))
        second = step * step
        dm[inner] = rhs[inner] - target * centring[inner] + second * bending[inner]
        dm[1], dm[n] = 0.0, 0.0
        _substitute(d0[inner], d1[inner], d2[inner], dm[inner])
        linearise(terms, slopes, dm, reached)
        advance(
            target, second, rows, inverse_caps, m_predicted, predicted, m + dm[inner], reached,
            weight, m, slack, dual, change, next_dual,
        )  # fmt: skip
        node_states(m, width, ends, b, a, v)
        calm = follow_widths(h, a, v, width) < 1e-3
    return STALLED, most_iterations, total
