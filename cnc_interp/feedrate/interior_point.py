"""A primal-dual interior point method with predictor and corrector, for the jerk stage.

It needs no feasible starting point. The Hessian is that of the time plus the Gauss-Newton terms of
the rows; for jerk rows this is the convexification by tangents. The barrier of a cell is weighted
with its share of the time. Without the weight, short cells would stay away from their limits.

A step acts on the cells nearby only: its effect decays within a few cells along the band of the
Newton matrix. So each chunk of cells has its own step lengths and its own target of the barrier,
blended along the path. With one length for all, the worst of 20,000 cells would hold up the rest.
No target falls faster than the violation of the rows of its chunk [W1997, chapter 6]: slacks that
are small before the rows hold leave no way to move.
``barrier_rows.py`` describes the rows, the arrays and their shapes.
"""

from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.native import DistinctArrays
from cnc_interp.feedrate import barrier_rows as barrier
from cnc_interp.feedrate import jerk_rows
from cnc_interp.feedrate.barrier_rows import BarrierRows, Iterate, Newton, three_rows
from cnc_interp.feedrate.jerk_rows import FloatRows

#: Part of the longest step with positive slacks and duals that is taken [-].
KEPT_STEP = 0.98
SOLVED, STALLED, BROKEN = 0, 1, 2


class Linearised(NamedTuple):
    """Coefficients and terms of the rows after a whole step."""

    m: FloatArray
    terms: FloatArray


class Aims(NamedTuple):
    """For each cell, the wanted product of slack and dual per cell weight; factor of dw dy."""

    target: FloatArray
    second_order: FloatArray


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _predict_rows(
    factors: FloatRows,
    constant: FloatArray,
    terms: FloatRows,
    sides: FloatRows,
    by_target: FloatRows,
    by_factor: FloatRows,
    square: FloatArray,
    worst: FloatArray,
) -> None:
    """Predict the steps of the rows of one axis and place from the linearised terms.

    Adds forces on the terms: ``by_target`` of the barrier, and ``by_factor`` of dw dy.
    """
    c0, c1, c2 = factors
    x0, x1, x2 = terms
    w0, w1, y0, y1 = sides
    a0, a1, a2 = by_target
    b0, b1, b2 = by_factor
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


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
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
    for j in range(len(cap)):
        inverse = 1.0 / w[j]
        dw = 1.0 - w[j] - cap[j] * x[j]
        t = dw * inverse
        worst[j] = max(worst[j], max(-t, 1.0 + t))
        z = -y[j] * dw * (1.0 + t)
        square[j] += z
        a[j], b[j] = inverse * cap[j], z * inverse * cap[j]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _add_product(total: FloatArray, part: FloatArray, factor: FloatArray) -> None:
    for j in range(len(factor)):
        total[j] += factor[j] * part[j]


@njit(cache=True, nogil=True, error_model='numpy')
def predict(
    problem: BarrierRows,
    predicted: Linearised,
    slopes: FloatArray,
    point: Iterate,
    forces: FloatArray,
    step: FloatArray,
    square: FloatArray,
) -> None:
    """Compute how far the predictor step may go, and what the corrector needs of it.

    With t = dw/w the slack stays positive up to a step length of -1/t. The dual step is dy = -y (1
    + t), so the dual stays positive up to 1/(1 + t). The corrector wants w dy + y dw = target
    weight - w y - factor dw dy: ``forces`` of each cell on its three coefficients, (6, n), first
    by the target, then by the factor. ``predicted`` is after the whole
    predictor step. Of each chunk, ``step`` is the longest step
    length, at most 1, and ``square`` the sum of dw dy over the cell weights.
    """
    n_axes, places = len(problem.factors), barrier.places_of(problem.factors)
    slack, dual, edges, reached = point.slack, point.dual, problem.edges, predicted.terms
    # Rows of x: dw dy, 1 / step length.
    s, x = np.empty((6, barrier.CHUNK)), np.empty((2, barrier.CHUNK))
    zero, by_target, by_factor = np.zeros(barrier.CHUNK), three_rows(s, 0), three_rows(s, 3)
    forces[:] = 0.0
    for chunk in range(len(step)):
        lo, hi = edges[chunk], edges[chunk + 1]
        here = slice(lo, hi)
        x[:] = 0.0
        for q in range(places):
            s[:] = 0.0
            terms = jerk_rows.term_rows(reached, q, lo, hi)
            for k in range(n_axes):
                factors = barrier.factors_of(problem, k, q, lo, hi)
                constant = barrier.constant_of(problem.factors, k, q, lo, hi, zero)
                sides = barrier.sides_of(slack, dual, 2 * (places * k + q), lo, hi)
                _predict_rows(factors, constant, terms, sides, by_target, by_factor, x[0], x[1])
            z = jerk_rows.slope_rows(slopes, q, lo, hi)
            out = forces[0, here], forces[1, here], forces[2, here]
            barrier.by_coefficients(by_target, z, out)
            out = forces[3, here], forces[4, here], forces[5, here]
            barrier.by_coefficients(by_factor, z, out)
        for which in range(2):
            r = 2 * places * n_axes + which
            _predict_cap(
                problem.inverse_caps[which, here],
                predicted.m[here] if which == 0 else reached[4, here],
                slack[r, here],
                dual[r, here],
                s[2 * which],
                s[2 * which + 1],
                x[0],
                x[1],
            )
        barrier.add_to(forces[1, here], s[0], 1.0)
        barrier.add_to(forces[4, here], s[1], 1.0)
        left, right = slopes[9, here], slopes[10, here]
        _add_product(forces[0, here], s[2], left)
        _add_product(forces[3, here], s[3], left)
        _add_product(forces[1, here], s[2], right)
        _add_product(forces[4, here], s[3], right)
        worst, square[chunk] = 1.0, 0.0
        for j in range(hi - lo):
            square[chunk] += x[0, j] / problem.weight[lo + j]
            worst = max(worst, x[1, j])
        step[chunk] = 1.0 / worst


@njit(cache=True, nogil=True, error_model='numpy')
def _dual_step(
    predicted: float, step: float, inverse: float, y: float, aim: float, second_order: float
) -> tuple[float, float]:
    """Return the step of the dual of one side, and how much of it the dual may take, inverted."""
    product = -y * predicted * (1.0 + predicted * inverse)
    dy = ((aim if y > 0.0 else 0.0) - second_order * product - y * step) * inverse - y
    return dy, (-dy / y if y > 0.0 else 0.0)


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _step_rows(
    aims: FloatRows,
    factors: FloatRows,
    constant: FloatArray,
    predicted: FloatRows,
    reached: FloatRows,
    sides: FloatRows,
    steps: FloatRows,
    most: FloatRows,
) -> None:
    """Write the steps of the rows of one axis and place, as their ``sides``, and the most used.

    ``aims``: target, factor of dw dy, and cell weight; then terms after both steps.
    """
    target, second_order, weight = aims
    c0, c1, c2 = factors
    p0, p1, p2 = predicted
    x0, x1, x2 = reached
    w0, w1, y0, y1 = sides
    dw0, dw1, dy0, dy1 = steps
    primal, adjoint = most
    for j in range(len(c0)):
        f0, f1, f2 = c0[j], c1[j], c2[j]
        g_p, g_x = f0 * p0[j] + f1 * p1[j] + f2 * p2[j], f0 * x0[j] + f1 * x1[j] + f2 * x2[j]
        i0, i1, aim = 1.0 / w0[j], 1.0 / w1[j], target[j] * weight[j]
        t0, t1 = 1.0 - w0[j] - constant[j], 1.0 - w1[j] + constant[j]
        dy0[j], a0 = _dual_step(t0 - g_p, t0 - g_x, i0, y0[j], aim, second_order[j])
        dy1[j], a1 = _dual_step(t1 + g_p, t1 + g_x, i1, y1[j], aim, second_order[j])
        dw0[j], dw1[j] = t0 - g_x, t1 + g_x
        primal[j] = max(primal[j], max(-(t0 - g_x) * i0, -(t1 + g_x) * i1))
        adjoint[j] = max(adjoint[j], max(a0, a1))


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _step_cap(
    aims: FloatRows,
    cap: FloatArray,
    predicted: FloatArray,
    reached: FloatArray,
    side: FloatRows,
    step: FloatRows,
    most: FloatRows,
) -> None:
    target, second_order, weight = aims
    p, x = predicted, reached
    w, y = side
    dw, dy = step
    primal, adjoint = most
    for j in range(len(cap)):
        inverse, there = 1.0 / w[j], 1.0 - w[j]
        moved = there - cap[j] * x[j]
        dy[j], most = _dual_step(
            there - cap[j] * p[j], moved, inverse, y[j], target[j] * weight[j], second_order[j]
        )
        dw[j], primal[j] = moved, max(primal[j], -moved * inverse)
        adjoint[j] = max(adjoint[j], most)


@njit(cache=True, nogil=True, error_model='numpy')
def _blend(values: FloatArray, edges: IntArray, chunk: int, below: bool, out: FloatArray) -> None:
    """Write values of cells of a chunk, on lines to the chunks beside; or ``below`` its own."""
    lo, hi, here = edges[chunk], edges[chunk + 1], values[chunk]
    for i in range(hi - lo):
        way = (i + 0.5) / (hi - lo) - 0.5
        beside = values[max(chunk - 1, 0) if way < 0.0 else min(chunk + 1, len(values) - 1)]
        if below:
            beside = 2 * min(beside, here) - here
        out[i] = here + abs(way) * (beside - here)


@njit(cache=True, nogil=True, error_model='numpy')
def advance(
    aims: Aims,
    problem: BarrierRows,
    predicted: Linearised,
    reached: Linearised,
    point: Iterate,
    floor: FloatArray,
) -> None:
    """Take the corrected step while slacks, duals and coefficients stay positive.

    ``predicted``, ``reached``: after predictor and corrector. Each chunk moves once the step
    length of the next one is known, while its steps are still in the cache. Its ``floor`` falls
    with the violation of its rows.
    """
    m, slack, dual, edges = point.m, point.slack, point.dual, problem.edges
    n_axes, places = len(problem.factors), barrier.places_of(problem.factors)
    n, chunks = len(m), len(edges) - 1
    primal, adjoint = np.ones(chunks), np.ones(chunks)
    # Steps of slacks and duals of this chunk and of the one before.
    dw, dy = np.empty((2, len(slack), barrier.CHUNK)), np.empty((2, len(slack), barrier.CHUNK))
    f, zero = np.empty((2, barrier.CHUNK)), np.zeros(barrier.CHUNK)
    for chunk in range(chunks + 1):
        if chunk < chunks:
            lo, hi = edges[chunk], edges[chunk + 1]
            here, cells, new = slice(lo, hi), slice(0, hi - lo), chunk % 2
            f[:] = 0.0
            aim = aims.target[here], aims.second_order[here], problem.weight[here]
            most = f[0], f[1]
            for q in range(places):
                p = jerk_rows.term_rows(predicted.terms, q, lo, hi)
                x = jerk_rows.term_rows(reached.terms, q, lo, hi)
                for k in range(n_axes):
                    r = 2 * (places * k + q)
                    factors = barrier.factors_of(problem, k, q, lo, hi)
                    constant = barrier.constant_of(problem.factors, k, q, lo, hi, zero)
                    sides = barrier.sides_of(slack, dual, r, lo, hi)
                    steps = barrier.sides_of(dw[new], dy[new], r, 0, hi - lo)
                    _step_rows(aim, factors, constant, p, x, sides, steps, most)
            for which in range(2):
                r = 2 * places * n_axes + which
                _step_cap(
                    aim,
                    problem.inverse_caps[which, here],
                    predicted.m[here] if which == 0 else predicted.terms[4, here],
                    reached.m[here] if which == 0 else reached.terms[4, here],
                    (slack[r, here], dual[r, here]),
                    (dw[new, r, cells], dy[new, r, cells]),
                    most,
                )
            primal_worst, dual_worst = KEPT_STEP, KEPT_STEP
            for j in range(hi - lo):
                primal_worst, dual_worst = max(primal_worst, f[0, j]), max(dual_worst, f[1, j])
            primal[chunk], adjoint[chunk] = KEPT_STEP / primal_worst, KEPT_STEP / dual_worst
            for i in range(max(lo, 1), min(hi, n - 1)):
                dm = reached.m[i] - m[i]
                if dm * primal[chunk] < -0.9 * m[i]:
                    primal[chunk] = -0.9 * m[i] / dm
            floor[chunk] *= 1.0 - primal[chunk]
        if chunk > 0:
            lo, hi = edges[chunk - 1], edges[chunk]
            cells, new = slice(0, hi - lo), (chunk - 1) % 2
            _blend(primal, edges, chunk - 1, True, f[0])
            _blend(adjoint, edges, chunk - 1, True, f[1])
            for i in range(lo, hi):
                m[i] += f[0, i - lo] * (reached.m[i] - m[i])
            for r in range(len(slack)):
                _add_product(slack[r, lo:hi], dw[new, r], f[0, cells])
                _add_product(dual[r, lo:hi], dy[new, r], f[1, cells])


@njit(cache=True, nogil=True, error_model='numpy')
def _factorize(d0: FloatArray, d1: FloatArray, d2: FloatArray) -> bool:
    """Factor a symmetric pentadiagonal matrix into L D L^T in place; False if it is not finite.

    ``d0`` becomes 1/D. A pivot too small by rounding becomes very large: its unknown then stays.
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


@njit(cache=True, nogil=True, error_model='numpy')
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


@njit(cache=True, nogil=True, error_model='numpy')
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


@njit(cache=True, nogil=True, error_model='numpy')
def solve(
    h: FloatArray,
    rows: FloatArray,
    caps: FloatArray,
    ends: FloatArray,
    point: Iterate,
    warm: bool,
    tolerance: float,
    most_iterations: int,
) -> tuple[int, int, float]:
    """Minimise the time over one part of the path; return status, iterations and time [s].

    ``h`` has the cell widths [m]. ``rows`` are those of ``build_rows``, ``caps`` (n, 2) the
    largest coefficient of each cell and s_dot^2 at its left node. ``ends`` has s_dot^2 and s_ddot
    at start and end. ``point`` has positive coefficients, then the solution. With ``warm``, it
    solves the problem with nearly these limits. ``tolerance`` is the accepted gap to the optimum,
    relative to the time.
    """
    m, width, slack, dual = point
    n, n_rows = len(h), len(slack)
    b, a, v = np.zeros(n + 1), np.zeros(n + 1), np.zeros(n + 1)
    terms, slopes = np.zeros((7, n + 1)), np.zeros((14, n + 1))
    predicted = Linearised(np.empty(n), np.zeros((7, n + 1)))
    reached = Linearised(np.empty(n), np.zeros((7, n + 1)))
    d0, d1, d2 = np.empty(n + 2), np.empty(n + 2), np.empty(n + 2)
    rhs, residual = np.empty(n + 2), np.empty(n + 2)
    newton = Newton(d0, d1, d2, rhs, residual)
    dm, weight, forces = np.zeros(n + 2), np.ones(n), np.empty((6, n))
    edges = barrier.edges_of(n)
    problem, chunks = BarrierRows(rows, _inverse_caps(caps), weight, edges), len(edges) - 1
    count, weighted = np.ones(chunks), np.empty(chunks)
    step, square, floor = np.empty(chunks), np.empty(chunks), np.empty(chunks)
    targets, aims = np.empty(chunks), Aims(np.empty(n), np.empty(n))
    inner, calm, total = slice(1, n + 1), False, 0.0
    for iteration in range(most_iterations):
        jerk_rows.node_states(m, width, ends, b, a, v)
        total = jerk_rows.terms_and_time(width, b, a, v, terms, slopes)
        if not np.isfinite(total):
            return BROKEN, iteration, total
        if iteration == 0:
            barrier.start_rows(total, problem, point, v, terms, warm)
            for c in range(chunks):
                count[c] = max((dual[:, edges[c] : edges[c + 1]] > 0.0).sum(), 1)
        gap, violation = barrier.add_rows(problem, point, v, terms, slopes, newton, weighted)
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
        jerk_rows.linearise(terms, slopes, dm, predicted.terms)
        predicted.m[:] = m + dm[inner]
        predict(problem, predicted, slopes, point, forces, step, square)
        # The gap may stay at the tolerance: the jerk rows converge linearly in the meantime.
        least = 0.2 * tolerance * total / (n * (n_rows / 2 + 1))
        for c in range(chunks):
            # sum of (w + step dw)(y + step dy) with w dy + y dw = -w y
            centre = weighted[c] / count[c]
            left = centre * (1.0 - step[c]) + step[c] ** 2 * square[c] / count[c]
            sigma = min(max((left / centre) ** 3, 1e-3), 0.9)
            if iteration == 0:
                floor[c] = 0.0 if warm else centre  # a warm start hardly violates the rows
            targets[c] = max(sigma * centre, min(centre, least), floor[c])
        step *= step
        for c in range(chunks):
            _blend(targets, edges, c, False, aims.target[edges[c] :])
            _blend(step, edges, c, False, aims.second_order[edges[c] :])
        dm[inner] = rhs[inner]
        for i in range(n):
            aim = aims.target[i] * weight[i]
            for c in range(3):
                dm[i + c] += aims.second_order[i] * forces[3 + c, i] - aim * forces[c, i]
        dm[1], dm[n] = 0.0, 0.0
        _substitute(d0[inner], d1[inner], d2[inner], dm[inner])
        jerk_rows.linearise(terms, slopes, dm, reached.terms)
        reached.m[:] = m + dm[inner]
        advance(aims, problem, predicted, reached, point, floor)
        jerk_rows.node_states(m, width, ends, b, a, v)
        calm = jerk_rows.follow_widths(h, a, v, width) < 1e-3
    return STALLED, most_iterations, total
