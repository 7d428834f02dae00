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
from cnc_interp.feedrate.barrier_steps import advance, correct, predict
from cnc_interp.feedrate.jerk_rows import follow_widths, node_states, terms_and_time

SOLVED, STALLED, BROKEN = 0, 1, 2


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _factorize(d0: FloatArray, d1: FloatArray, d2: FloatArray) -> bool:
    """
    Factor a symmetric pentadiagonal matrix into L D L^T in place; False if it is not finite.

    If rounding makes a pivot too small, a very large one replaces it. Its unknown then does not
    change in this iteration.
    """
    n = len(d0)
    given = d0.copy()
    for i in range(n):
        if not np.isfinite(d0[i]):
            return False
        if not d0[i] > 1e-14 * given[i]:
            d0[i] = 1e30 * (given[i] + 1e-300)
        pivot = d0[i]
        first, second = d1[i], d2[i]
        l1, l2 = first / pivot, second / pivot
        if i + 1 < n:
            d0[i + 1] -= l1 * first
            d1[i + 1] -= l1 * second
        if i + 2 < n:
            d0[i + 2] -= l2 * second
        d1[i], d2[i] = l1, l2
    return True


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _substitute(d0: FloatArray, l1: FloatArray, l2: FloatArray, x: FloatArray) -> None:
    """Solve for the right-hand side ``x`` in place, with the factors from ``_factorize``."""
    n = len(x)
    for i in range(n):
        if i + 1 < n:
            x[i + 1] -= l1[i] * x[i]
        if i + 2 < n:
            x[i + 2] -= l2[i] * x[i]
    for i in range(n - 1, -1, -1):
        value = x[i] / d0[i]
        if i + 1 < n:
            value -= l1[i] * x[i + 1]
        if i + 2 < n:
            value -= l2[i] * x[i + 2]
        x[i] = value


@numba.njit(cache=True, nogil=True, error_model='numpy')
def solve(
    h: FloatArray,
    rows: FloatArray,
    cap: FloatArray,
    ends: FloatArray,
    m: FloatArray,
    width: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    warm: bool,
    tolerance: float,
    most_iterations: int,
    trace: FloatArray,
) -> tuple[int, int, float]:
    """
    Minimise the time over one part of the path.

    Parameters
    ----------
    h : ndarray, shape (n,)
        Cell widths [m].
    rows : ndarray, shape (n, 3, 3, n_axes)
        Per cell: q_s, 3 q_ss, q_sss over the jerk limit at its left end; the same at its right
        end; then q_s, q_ss, 0 over the acceleration limit at its left node.
    cap : ndarray, shape (n,)
        Largest s_dot^2 in each cell [m2/s2].
    ends : ndarray, shape (4,)
        s_dot^2 and s_ddot at the start, then at the end [m2/s2, m/s2].
    m : ndarray, shape (n,)
        Coefficients: a positive starting point on entry, the solution on return [m2/s2].
    width : ndarray, shape (n,)
        Effective widths; those of the solution on return [m].
    slack, dual : ndarray, shape (n, 3 n_axes + 2, 2)
        Slacks and duals of the rows. With ``warm`` they start from the last solution.
    warm : bool
        Whether ``m``, ``slack`` and ``dual`` solve the same problem with slightly other limits.
    tolerance : float
        Accepted gap to the optimum, relative to the time [-].
    most_iterations : int
        Largest number of iterations.
    trace : ndarray, shape (k, 6)
        Output: time, gap, violation, residual and two step lengths of the first k iterations.

    Returns
    -------
    status, iterations, time : int, int, float
        SOLVED, STALLED or BROKEN, the number of iterations and the time reached [s].

    """
    n, n_axes = len(h), rows.shape[3]
    n_rows = 3 * n_axes + 2
    b, a, v = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    terms, slopes = np.zeros((n, 3, 3)), np.zeros((n, 3, 3, 3))
    caps = np.empty((n, 2))
    for i in range(n):
        caps[i, 0] = cap[i]
        caps[i, 1] = cap[i] if i == 0 else min(cap[i - 1], cap[i])
    change, next_dual = np.zeros((n, n_rows, 2)), np.zeros((n, n_rows, 2))
    inverse = np.zeros((n, n_rows, 2))
    slope, residual, rhs, dm = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    d0, d1, d2, weight = np.zeros(n), np.zeros(n), np.zeros(n), np.ones(n)
    total = 0.0
    calm = False
    for iteration in range(most_iterations):
        node_states(m, width, ends, b, a, v)
        total = terms_and_time(width, b, a, v, terms, slopes, slope, d0, d1, d2)
        if not np.isfinite(total):
            return BROKEN, iteration, total
        if iteration == 0:
            start_rows(total, rows, caps, m, terms, width, v, weight, slack, dual, warm)
        for i in range(n):
            rhs[i] = -slope[i]
            residual[i] = slope[i]
        gap, weighted, violation, count = add_rows(
            rows, caps, m, terms, slopes, weight, slack, dual, inverse, d0, d1, d2, residual, rhs
        )
        centre = weighted / max(count, 1)
        off = 0.0
        for i in range(n):
            off += abs(residual[i]) * m[i]
        if iteration < len(trace):
            trace[iteration, 0], trace[iteration, 1] = total, gap
            trace[iteration, 2], trace[iteration, 3] = violation, off
        if calm and gap < tolerance * total and violation < 2e-4 and off < 1e-3 * total:
            return SOLVED, iteration, total
        for i in range(n):
            if i == 0 or i == n - 1:
                d0[i], rhs[i] = 1.0, 0.0
        if not _factorize(d0, d1, d2):
            return BROKEN, iteration, total
        dm[:] = rhs
        _substitute(d0, d1, d2, dm)
        step, square = predict(
            rows, caps, m, terms, slopes, weight, slack, dual, inverse, dm, change
        )
        # sum of (w + step dw)(y + step dy) with w dy + y dw = -w y
        reached = centre * (1.0 - step) + step * step * square / max(count, 1)
        sigma = (reached / centre) ** 3
        sigma = min(max(sigma, 1e-3), 0.9)
        # The gap may stay at the tolerance: the jerk rows converge linearly in the meantime.
        target = max(sigma * centre, min(centre, 0.2 * tolerance * total / (n * n_rows)))
        second = step * step
        correct(target, second, rows, caps, slopes, weight, inverse, change, rhs)
        dm[:] = rhs
        _substitute(d0, d1, d2, dm)
        primal, adjoint = advance(
            target,
            second,
            rows,
            caps,
            terms,
            slopes,
            weight,
            m,
            slack,
            dual,
            inverse,
            change,
            dm,
            next_dual,
        )
        node_states(m, width, ends, b, a, v)
        calm = follow_widths(h, a, v, width) < 1e-3
        if iteration < len(trace):
            trace[iteration, 4], trace[iteration, 5] = primal, adjoint
    return STALLED, most_iterations, total
