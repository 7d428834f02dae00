"""
Interior point for the jerk-limited motion law: banded, primal-dual, Gauss-Newton on the jerk rows.

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

    jerk at both ends   alpha j + v (gamma b + beta a),  j = (a_{i+1} - a_i)(v_i + v_{i+1})/(2 H)
    acceleration        q_s a + q_ss b
    caps                m_i <= cap_i,  b_i <= min(cap_{i-1}, cap_i)

Each touches m_{i-1}, m_i, m_{i+1}: the Newton matrix is pentadiagonal. The barrier of a cell is
weighted with its share of the time, so that tiny cells are not kept away from their limits.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.program.blocks import FloatArray

SOLVED, STALLED, BROKEN = 0, 1, 2


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
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


@numba.njit(cache=True)
def rows_and_time(
    n_axes: int,
    jerk: FloatArray,
    acceleration: FloatArray,
    cap: FloatArray,
    m: FloatArray,
    width: FloatArray,
    b: FloatArray,
    a: FloatArray,
    v: FloatArray,
    g: FloatArray,
    grad: FloatArray,
    slope: FloatArray,
    d0: FloatArray,
    d1: FloatArray,
    d2: FloatArray,
) -> float:
    """
    Evaluate the rows with their gradients, and the time with gradient and Hessian.

    ``grad[i, r]`` are the derivatives of row r of cell i by m_{i-1}, m_i, m_{i+1}; those by the
    fixed first and last coefficient are zero.
    """
    n = len(width)
    total = 0.0
    slope[:] = 0.0
    d0[:] = 0.0
    d1[:] = 0.0
    d2[:] = 0.0
    da0, da1, db0 = np.zeros(3), np.zeros(3), np.zeros(3)
    db1, dj, ds = np.zeros(3), np.zeros(3), np.zeros(3)
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
        rise = (a[i + 1] - a[i]) / (2 * w)
        j = rise * sum_v
        for c in range(3):
            ds[c] = r0 * db0[c] + r1 * db1[c]
            dj[c] = (da1[c] - da0[c]) * sum_v / (2 * w) + rise * ds[c]
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
        for k in range(n_axes):
            alpha, beta, gamma = jerk[i, 0, k, 0], jerk[i, 0, k, 1], jerk[i, 0, k, 2]
            inner = gamma * b[i] + beta * a[i]
            g[i, k] = alpha * j + v0 * inner
            for c in range(3):
                grad[i, k, c] = (
                    alpha * dj[c] + v0 * (gamma * db0[c] + beta * da0[c]) + inner * r0 * db0[c]
                )
            alpha, beta, gamma = jerk[i, 1, k, 0], jerk[i, 1, k, 1], jerk[i, 1, k, 2]
            inner = gamma * b[i + 1] + beta * a[i + 1]
            row = n_axes + k
            g[i, row] = alpha * j + v1 * inner
            for c in range(3):
                grad[i, row, c] = (
                    alpha * dj[c] + v1 * (gamma * db1[c] + beta * da1[c]) + inner * r1 * db1[c]
                )
            row = 2 * n_axes + k
            first, second = acceleration[i, k, 0], acceleration[i, k, 1]
            g[i, row] = first * a[i] + second * b[i]
            for c in range(3):
                grad[i, row, c] = first * da0[c] + second * db0[c]
        row = 3 * n_axes
        grad[i, row, :] = 0.0
        if 0 < i < n - 1:
            grad[i, row, 1] = 1.0 / cap[i]
        g[i, row] = m[i] / cap[i]
        node_cap = cap[i] if i == 0 else min(cap[i - 1], cap[i])
        for c in range(3):
            grad[i, row + 1, c] = db0[c] / node_cap
        g[i, row + 1] = b[i] / node_cap
    return total


@numba.njit(cache=True)
def gather(
    n_two_sided: int,
    g: FloatArray,
    grad: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
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
                ratio = y / w
                scale += ratio
                push += sign * ratio * miss
                pull += sign * y
                gap += y * w
                centre += y * w / weight[i]
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


@numba.njit(cache=True)
def predict(
    n_two_sided: int,
    g: FloatArray,
    grad: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
    dual: FloatArray,
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
                dy = -y - y * dw / w
                if dw < -w * step:
                    step = -w / dw if -w / dw < step else step
                if dy < -y * step:
                    step = -y / dy if -y / dy < step else step
                change[i, r, side] = dw * dy
                plain += y * w / weight[i]
                linear += (y * dw + w * dy) / weight[i]
                square += dw * dy / weight[i]
                count += 1
                sign = -1.0
    return step, (plain + step * linear + step * step * square) / max(count, 1)


@numba.njit(cache=True)
def correct(
    n_two_sided: int,
    target: float,
    second_order: float,
    grad: FloatArray,
    weight: FloatArray,
    slack: FloatArray,
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
            push = (target * weight[i] - second_order * change[i, r, 0]) / slack[i, r, 0]
            if r < n_two_sided:
                push -= (target * weight[i] - second_order * change[i, r, 1]) / slack[i, r, 1]
            if x0 != 0.0:
                rhs[i - 1] -= push * x0
            rhs[i] -= push * x1
            if x2 != 0.0:
                rhs[i + 1] -= push * x2


@numba.njit(cache=True)
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
                dy = (target * weight[i] - second_order * change[i, r, side] - y * dw) / w - y
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


@numba.njit(cache=True)
def solve(
    h: FloatArray,
    jerk: FloatArray,
    acceleration: FloatArray,
    cap: FloatArray,
    ends: FloatArray,
    m: FloatArray,
    width: FloatArray,
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
    slack, dual = np.ones((n, n_rows, 2)), np.zeros((n, n_rows, 2))
    change, next_dual = np.zeros((n, n_rows, 2)), np.zeros((n, n_rows, 2))
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
            for i in range(n):
                share = 2 * width[i] / (v[i] + v[i + 1]) / total
                weight[i] = max(n * share, 1e-3)
                for r in range(n_rows):
                    slack[i, r, 0] = max(1.0 - g[i, r], 0.1)
                    slack[i, r, 1] = max(1.0 + g[i, r], 0.1)
                    for side in range(2):
                        dual[i, r, side] = 0.1 * total / n * weight[i] / slack[i, r, side]
        for i in range(n):
            rhs[i] = -slope[i]
            residual[i] = slope[i]
        gap, centre, violation = gather(
            n_two_sided, g, grad, weight, slack, dual, d0, d1, d2, residual, rhs
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
        step, reached = predict(n_two_sided, g, grad, weight, slack, dual, dm, change)
        sigma = (reached / centre) ** 3
        sigma = min(max(sigma, 1e-3), 0.9)
        # the gap need not fall further than asked; the jerk rows converge linearly meanwhile
        target = max(sigma * centre, min(centre, 0.2 * tolerance * total / (n * n_rows)))
        second = step * step
        correct(n_two_sided, target, second, grad, weight, slack, change, rhs)
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
            change,
            dm,
            next_dual,
        )
        node_states(m, width, ends, b, a, v)
        calm = follow_widths(h, a, v, width) < 1e-3
        if iteration < len(trace):
            trace[iteration, 4], trace[iteration, 5] = primal, adjoint
    return STALLED, most_iterations, total
