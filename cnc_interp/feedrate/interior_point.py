"""
Interior point for the jerk stage: primal-dual, predictor and corrector, pentadiagonal.

Starts anywhere; the Hessian is that of the time plus Gauss-Newton on the rows, for the jerk rows
their tangent convexification. The barrier of a cell is weighted with its share of the time,
so that short cells are not kept away from their limits.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.feedrate.jerk_rows import follow_widths, node_states, rows_and_time
from cnc_interp.program.blocks import FloatArray

SOLVED, STALLED, BROKEN = 0, 1, 2

WARM_SLACK, WARM_GAP = 1e-2, 1e-4
"""Least slack, and complementarity over the time, with which a warm start begins."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def factorize(d0: FloatArray, d1: FloatArray, d2: FloatArray) -> bool:
    """
    Factor the symmetric pentadiagonal matrix in place into L D L^T; False if it is not finite.

    A pivot that rounding has eaten is made large: that unknown then rests for one iteration.
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
def substitute(d0: FloatArray, l1: FloatArray, l2: FloatArray, x: FloatArray) -> None:
    """Solve with the factors of ``factorize``, in place."""
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
def gather(
    n_two_sided: int,
    g: FloatArray,
    grad: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    d0: FloatArray,
    d1: FloatArray,
    d2: FloatArray,
    residual: FloatArray,
    rhs: FloatArray,
) -> tuple[float, float, float]:
    """
    Add the rows to the Newton matrix and to the predictor's right-hand side.

    Returns the gap (sum of dual times slack), the mean weighted complementarity and the largest
    violation of a row.
    """
    n, n_rows = g.shape
    gap, centre, violation = 0.0, 0.0, 0.0
    count = 0
    for i in range(n):
        share = 1.0 / weight[i]
        for r in range(n_rows):
            x0, x1, x2 = grad[i, r, 0], grad[i, r, 1], grad[i, r, 2]
            if x0 == 0.0 and x1 == 0.0 and x2 == 0.0:
                continue
            scale, push, pull = 0.0, 0.0, 0.0
            sign = 1.0
            for side in range(2 if r < n_two_sided else 1):
                w, y = slack[i, r, side], dual[i, r, side]
                miss = sign * g[i, r] + w - 1.0
                violation = max(violation, sign * g[i, r] - 1.0)
                inverse[i, r, side] = 1.0 / w
                ratio = y * inverse[i, r, side]
                scale += ratio
                push += sign * ratio * miss
                pull += sign * y
                gap += y * w
                centre += y * w * share
                count += 1
                sign = -1.0
            for c in range(3):
                slot = i - 1 + c
                if slot < 0 or slot >= n:
                    continue
                x = grad[i, r, c]
                rhs[slot] -= push * x
                residual[slot] += pull * x
                d0[slot] += scale * x * x
                if c < 2:
                    d1[slot] += scale * x * grad[i, r, c + 1]
                if c == 0:
                    d2[slot] += scale * x0 * x2
    return gap, centre / max(count, 1), violation


@numba.njit(cache=True, nogil=True, error_model='numpy')
def predict(
    n_two_sided: int,
    g: FloatArray,
    grad: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    dm: FloatArray,
    change: FloatArray,
) -> tuple[float, float]:
    """
    Step of slacks and duals along the predictor: how far it gets, and the complementarity there.

    ``change`` takes the products dw dy that the corrector needs.
    """
    n, n_rows = g.shape
    step = 1.0
    plain, linear, square = 0.0, 0.0, 0.0
    count = 0
    for i in range(n):
        share = 1.0 / weight[i]
        before = dm[i - 1] if i > 0 else 0.0
        after = dm[i + 1] if i < n - 1 else 0.0
        for r in range(n_rows):
            x0, x1, x2 = grad[i, r, 0], grad[i, r, 1], grad[i, r, 2]
            if x0 == 0.0 and x1 == 0.0 and x2 == 0.0:
                continue
            dg = x0 * before + x1 * dm[i] + x2 * after
            sign = 1.0
            for side in range(2 if r < n_two_sided else 1):
                w, y = slack[i, r, side], dual[i, r, side]
                dw = 1.0 - w - sign * (g[i, r] + dg)
                dy = -y - y * dw * inverse[i, r, side]
                if dw < -w * step:
                    step = -w / dw if -w / dw < step else step
                if dy < -y * step:
                    step = -y / dy if -y / dy < step else step
                change[i, r, side] = dw * dy
                plain += y * w * share
                linear += (y * dw + w * dy) * share
                square += dw * dy * share
                count += 1
                sign = -1.0
    return step, (plain + step * linear + step * step * square) / max(count, 1)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def correct(
    n_two_sided: int,
    target: float,
    second_order: float,
    grad: FloatArray,
    weight: FloatArray,
    inverse: FloatArray,
    change: FloatArray,
    rhs: FloatArray,
) -> None:
    """Turn the predictor's right-hand side into the corrector's, aiming at ``target`` * weight."""
    n, n_rows = grad.shape[0], grad.shape[1]
    for i in range(n):
        for r in range(n_rows):
            x0, x1, x2 = grad[i, r, 0], grad[i, r, 1], grad[i, r, 2]
            if x0 == 0.0 and x1 == 0.0 and x2 == 0.0:
                continue
            push = (target * weight[i] - second_order * change[i, r, 0]) * inverse[i, r, 0]
            if r < n_two_sided:
                other = target * weight[i] - second_order * change[i, r, 1]
                push -= other * inverse[i, r, 1]
            if x0 != 0.0:
                rhs[i - 1] -= push * x0
            rhs[i] -= push * x1
            if x2 != 0.0:
                rhs[i + 1] -= push * x2


@numba.njit(cache=True, nogil=True, error_model='numpy')
def advance(
    n_two_sided: int,
    target: float,
    second_order: float,
    keep: float,
    g: FloatArray,
    grad: FloatArray,
    weight: FloatArray,
    m: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    inverse: FloatArray,
    change: FloatArray,
    dm: FloatArray,
    next_dual: FloatArray,
) -> tuple[float, float]:
    """Take the corrected step, as far as slacks, duals and coefficients stay positive."""
    n, n_rows = g.shape
    primal, adjoint = 1.0 / keep, 1.0 / keep
    for i in range(1, n - 1):
        if dm[i] < 0.0 and -0.9 * m[i] > primal * keep * dm[i]:
            primal = -0.9 * m[i] / (keep * dm[i])
    for i in range(n):
        before = dm[i - 1] if i > 0 else 0.0
        after = dm[i + 1] if i < n - 1 else 0.0
        for r in range(n_rows):
            x0, x1, x2 = grad[i, r, 0], grad[i, r, 1], grad[i, r, 2]
            if x0 == 0.0 and x1 == 0.0 and x2 == 0.0:
                continue
            dg = x0 * before + x1 * dm[i] + x2 * after
            sign = 1.0
            for side in range(2 if r < n_two_sided else 1):
                w, y = slack[i, r, side], dual[i, r, side]
                dw = 1.0 - w - sign * (g[i, r] + dg)
                aim = target * weight[i] - second_order * change[i, r, side]
                dy = (aim - y * dw) * inverse[i, r, side] - y
                if dw * primal < -w:
                    primal = -w / dw
                if dy * adjoint < -y:
                    adjoint = -y / dy
                change[i, r, side] = dw
                next_dual[i, r, side] = dy
                sign = -1.0
    primal, adjoint = keep * primal, keep * adjoint
    for i in range(n):
        m[i] += primal * dm[i]
        for r in range(n_rows):
            for side in range(2 if r < n_two_sided else 1):
                slack[i, r, side] += primal * change[i, r, side]
                dual[i, r, side] += adjoint * next_dual[i, r, side]
    return primal, adjoint


@numba.njit(cache=True, nogil=True, error_model='numpy')
def start_rows(
    total: float,
    width: FloatArray,
    v: FloatArray,
    g: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
    warm: bool,
) -> None:
    """Weigh the cells by their time; start slacks and duals, cold or from the last solution."""
    n, n_rows = g.shape
    least, level = (WARM_SLACK, WARM_GAP) if warm else (1.0, 0.3)
    for i in range(n):
        share = 2 * width[i] / (v[i] + v[i + 1]) / total
        weight[i] = max(n * share, 1e-3)
        for r in range(n_rows):
            slack[i, r, 0] = max(1.0 - g[i, r], least)
            slack[i, r, 1] = max(1.0 + g[i, r], least)
            for side in range(2):
                balanced = level * total / n * weight[i] / slack[i, r, side]
                dual[i, r, side] = max(dual[i, r, side], balanced) if warm else balanced


@numba.njit(cache=True, nogil=True, error_model='numpy')
def solve(
    h: FloatArray,
    jerk: FloatArray,
    acceleration: FloatArray,
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
    Minimise the time over one stretch of path.

    Parameters
    ----------
    h : ndarray, shape (n,)
        Cell widths [m].
    jerk : ndarray, shape (n, 2, n_axes, 3)
        q_s, 3 q_ss, q_sss over the jerk limit, at both ends of each cell.
    acceleration : ndarray, shape (n, n_axes, 2)
        q_s, q_ss over the acceleration limit at the left node of each cell.
    cap : ndarray, shape (n,)
        Largest s_dot^2 in each cell [m2/s2].
    ends : ndarray, shape (4,)
        s_dot^2 and s_ddot at the start and at the end.
    m : ndarray, shape (n,)
        Starting point, positive; the solution afterwards.
    width : ndarray, shape (n,)
        Effective widths; those of the solution afterwards.
    slack, dual : ndarray, shape (n, 3 n_axes + 2, 2)
        Work arrays; those of the last solution when ``warm``.
    warm : bool
        The limits have changed a little since the last solution, from which to go on.
    tolerance : float
        Gap to the optimum, relative to the time.
    most_iterations : int
        Where to give up.
    trace : ndarray, shape (k, 6)
        Takes time, gap, violation, residual and the two step lengths of the first k iterations.

    Returns
    -------
    status, iterations, time
        SOLVED, STALLED or BROKEN, what it took and the time reached [s].

    """
    n, n_axes = len(h), jerk.shape[2]
    n_rows, n_two_sided = 3 * n_axes + 2, 3 * n_axes
    b, a, v = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    g, grad = np.zeros((n, n_rows)), np.zeros((n, n_rows, 3))
    change, next_dual = np.zeros((n, n_rows, 2)), np.zeros((n, n_rows, 2))
    inverse = np.zeros((n, n_rows, 2))
    slope, residual, rhs, dm = np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n)
    d0, d1, d2, weight = np.zeros(n), np.zeros(n), np.zeros(n), np.ones(n)
    total = 0.0
    calm = False
    for iteration in range(most_iterations):
        node_states(m, width, ends, b, a, v)
        total = rows_and_time(
            n_axes, jerk, acceleration, cap, m, width, b, a, v, g, grad, slope, d0, d1, d2
        )
        if not np.isfinite(total):
            return BROKEN, iteration, total
        if iteration == 0:
            start_rows(total, width, v, g, weight, slack, dual, warm)
        for i in range(n):
            rhs[i] = -slope[i]
            residual[i] = slope[i]
        gap, centre, violation = gather(
            n_two_sided, g, grad, weight, slack, dual, inverse, d0, d1, d2, residual, rhs
        )
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
        if not factorize(d0, d1, d2):
            return BROKEN, iteration, total
        dm[:] = rhs
        substitute(d0, d1, d2, dm)
        step, reached = predict(n_two_sided, g, grad, weight, slack, dual, inverse, dm, change)
        sigma = (reached / centre) ** 3
        sigma = min(max(sigma, 1e-3), 0.9)
        # the gap need not fall further than asked; the jerk rows converge linearly meanwhile
        target = max(sigma * centre, min(centre, 0.2 * tolerance * total / (n * n_rows)))
        second = step * step
        correct(n_two_sided, target, second, grad, weight, inverse, change, rhs)
        dm[:] = rhs
        substitute(d0, d1, d2, dm)
        primal, adjoint = advance(
            n_two_sided,
            target,
            second,
            0.98,
            g,
            grad,
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
