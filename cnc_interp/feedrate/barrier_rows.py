"""The inequality rows of the jerk stage inside one iteration of the interior point method.

Each row g <= 1 has a slack w and a dual y, a row |g| <= 1 one of each per side. A row of an axis
is a constant combination of the three terms of its place (``jerk_rows``). So sums over the axes
are first made in the terms, and multiplied by the derivatives by m_{i-1}, m_i, m_{i+1} once per
cell and place. The last two rows are the speed caps of the cell and of its left node. A row whose
factors are all zero has the dual zero and takes part in nothing.

Neighbouring cells are neighbours in memory, so that the compiler computes several at once. Sums
over the axes are made for ``CHUNK`` cells at a time, so they stay in the cache.

If a drive has a largest torque, there is a fourth place, again the left node. Its rows have a
constant: -1 <= g + constant <= 1, because Coulomb friction takes its part of the torque.

Arrays for n cells, p places and r = 2 p n_axes + 2 rows; places: q = 0 (left end), 1 (right end),
2 (left node), and 3 (left node, torque):

    factors       (n_axes, 9, n)     row 3 q + f: factor of term f at place q; the limit is 1
                  (n_axes, 13, n)    with four places; row 12 is the constant of place 3
    inverse_caps  (2, n)             1 / largest s_dot^2 in the cell and at its left node [s2/m2]
    edges         (chunks + 1,)      first cell of each chunk, and the end
    m             (n,)               coefficients: the unknowns [m2/s2]
    width         (n,)               effective widths of the cells [m]
    terms         (7, n + 1)         terms of the rows;  slopes (14, n + 1): their derivatives
    weight        (n,)               barrier weight of the cell: its share of the time [-]
    slack, dual   (r, n)             w and y: rows 2 (p k + q) and 2 (p k + q) + 1 are both sides
                                     of place q of axis k; the last two are the caps
    d0, d1, d2, rhs, residual        (n + 2,): diagonals of the Newton matrix, right-hand side,
                                     dual residual; entry i + 1 belongs to m_i
    dm            (n + 2,)           step of m, likewise; both ends are zero
"""

from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.native import DistinctArrays
from cnc_interp.feedrate.jerk_rows import FloatRows, slope_rows, term_rows

#: Smallest slack, and slack times dual over the time, at the beginning of a warm start.
WARM_SLACK, WARM_GAP = 1e-2, 1e-4
CHUNK = 256  #: Most cells that are summed over all axes at a time, and that step alike.


class BarrierRows(NamedTuple):
    """The rows of a part of the path, with the weights and chunks of its cells."""

    factors: FloatArray
    inverse_caps: FloatArray
    weight: FloatArray
    edges: IntArray


class Iterate(NamedTuple):
    """The variables of the iteration: coefficients, effective widths, slacks and duals."""

    m: FloatArray
    width: FloatArray
    slack: FloatArray
    dual: FloatArray


class Newton(NamedTuple):
    """The symmetric pentadiagonal matrix of a step, its right-hand side, the dual residual."""

    d0: FloatArray
    d1: FloatArray
    d2: FloatArray
    rhs: FloatArray
    residual: FloatArray


@njit(cache=True, nogil=True, error_model='numpy')
def edges_of(n: int) -> IntArray:
    """Return the first cell of each chunk, and the end: chunks of nearly the same size."""
    chunks = max((n + CHUNK - 1) // CHUNK, 1)
    return np.arange(chunks + 1) * n // chunks


@njit(cache=True, nogil=True, error_model='numpy')
def places_of(rows: FloatArray) -> int:
    return 4 if rows.shape[1] > 9 else 3


@njit(cache=True, nogil=True, error_model='numpy')
def constant_of(
    rows: FloatArray, k: int, q: int, lo: int, hi: int, zero: FloatArray
) -> FloatArray:
    return rows[k, 12, lo:hi] if q == 3 else zero[: hi - lo]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _sum_rows(
    factors: FloatRows,
    constant: FloatArray,
    terms: FloatRows,
    sides: FloatRows,
    squares: FloatRows,
    forces: FloatRows,
    gap: FloatArray,
    use: FloatArray,
) -> None:
    """Add the rows of one axis and place to sums in the terms: squares, pushes and pulls.

    ``sides``: slacks of both sides, then duals; ``forces``: three pushes, then three pulls.
    """
    c0, c1, c2 = factors
    x0, x1, x2 = terms
    w0, w1, y0, y1 = sides
    s00, s01, s02, s11, s12, s22 = squares
    p0, p1, p2, u0, u1, u2 = forces
    for j in range(len(c0)):
        f0, f1, f2 = c0[j], c1[j], c2[j]
        g = f0 * x0[j] + f1 * x1[j] + f2 * x2[j] + constant[j]
        r0, r1 = y0[j] / w0[j], y1[j] / w1[j]
        push = r0 * (w0[j] - 1.0 + g) - r1 * (w1[j] - 1.0 - g)
        pull, both = y0[j] - y1[j], r0 + r1
        gap[j] += y0[j] * w0[j] + y1[j] * w1[j]
        use[j] = max(use[j], abs(g))
        b0, b1 = both * f0, both * f1
        s00[j] += b0 * f0
        s01[j] += b0 * f1
        s02[j] += b0 * f2
        s11[j] += b1 * f1
        s12[j] += b1 * f2
        s22[j] += both * f2 * f2
        p0[j] += push * f0
        p1[j] += push * f1
        p2[j] += push * f2
        u0[j] += pull * f0
        u1[j] += pull * f1
        u2[j] += pull * f2


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _sums_by_coefficients(squares: FloatRows, slopes: FloatRows, out: FloatRows) -> None:
    """Add sums of squares in the terms to the matrix of the cell: h += e s e^T."""
    s00, s01, s02, s11, s12, s22 = squares
    e00, e01, e02, e10, e11, e12, e20, e21, e22 = slopes
    h00, h01, h02, h11, h12, h22 = out
    for j in range(len(e00)):
        a, b, c = e00[j], e01[j], e02[j]
        t0 = s00[j] * a + s01[j] * b + s02[j] * c
        t1 = s01[j] * a + s11[j] * b + s12[j] * c
        t2 = s02[j] * a + s12[j] * b + s22[j] * c
        h00[j] += t0 * a + t1 * b + t2 * c
        a, b, c = e10[j], e11[j], e12[j]
        h01[j] += t0 * a + t1 * b + t2 * c
        t3 = s00[j] * a + s01[j] * b + s02[j] * c
        t4 = s01[j] * a + s11[j] * b + s12[j] * c
        t5 = s02[j] * a + s12[j] * b + s22[j] * c
        h11[j] += t3 * a + t4 * b + t5 * c
        a, b, c = e20[j], e21[j], e22[j]
        h02[j] += t0 * a + t1 * b + t2 * c
        h12[j] += t3 * a + t4 * b + t5 * c
        t0 = s00[j] * a + s01[j] * b + s02[j] * c
        t1 = s01[j] * a + s11[j] * b + s12[j] * c
        t2 = s02[j] * a + s12[j] * b + s22[j] * c
        h22[j] += t0 * a + t1 * b + t2 * c


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def by_coefficients(forces: FloatRows, slopes: FloatRows, out: FloatRows) -> None:
    """Add forces on the terms to the forces on m_{i-1}, m_i, m_{i+1} of each cell."""
    p0, p1, p2 = forces
    e00, e01, e02, e10, e11, e12, e20, e21, e22 = slopes
    out0, out1, out2 = out
    for j in range(len(e00)):
        out0[j] += p0[j] * e00[j] + p1[j] * e01[j] + p2[j] * e02[j]
        out1[j] += p0[j] * e10[j] + p1[j] * e11[j] + p2[j] * e12[j]
        out2[j] += p0[j] * e20[j] + p1[j] * e21[j] + p2[j] * e22[j]


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _time_of_cells(
    width: FloatArray, start: FloatRows, end: FloatRows, hessian: FloatRows, gradient: FloatRows
) -> None:
    """Write gradient g and Hessian h of the time t = 2 H/S of each cell, S = v_i + v_{i+1}.

    d2t = 2 t/S^2 dS dS^T - t/S d2S, and d2S is negative. A node has v, its derivatives ``l`` and
    ``r`` by the coefficients left and right of it, and those of v^2, ``bl`` and ``br``.
    """
    v0, l0, r0, bl0, br0 = start
    v1, l1, r1, bl1, br1 = end
    h00, h01, h02, h11, h12, h22 = hessian
    g0, g1, g2 = gradient
    for j in range(len(width)):
        sum_v = v0[j] + v1[j]
        time = 2 * width[j] / sum_v
        half0 = 0.5 / v0[j] if v0[j] > 0.0 else 0.0
        half1 = 0.5 / v1[j] if v1[j] > 0.0 else 0.0
        k1, k2 = -time / sum_v, 2 * time / (sum_v * sum_v)
        c0 = -2 * half0 * half0 * half0 * k1
        c1 = -2 * half1 * half1 * half1 * k1
        s0, s1, s2 = l0[j], r0[j] + l1[j], r1[j]
        h00[j] = k2 * s0 * s0 + c0 * bl0[j] * bl0[j]
        h01[j] = k2 * s0 * s1 + c0 * bl0[j] * br0[j]
        h02[j] = k2 * s0 * s2
        h11[j] = k2 * s1 * s1 + c0 * br0[j] * br0[j] + c1 * bl1[j] * bl1[j]
        h12[j] = k2 * s1 * s2 + c1 * bl1[j] * br1[j]
        h22[j] = k2 * s2 * s2 + c1 * br1[j] * br1[j]
        g0[j], g1[j], g2[j] = k1 * s0, k1 * s1, k1 * s2


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def _sum_caps(
    caps: FloatRows,
    m: FloatArray,
    node: FloatRows,
    sides: FloatRows,
    squares: FloatRows,
    forces: FloatRows,
    gap: FloatArray,
    use: FloatArray,
) -> None:
    """Add both caps: of the coefficient m, and of v^2 at the left node."""
    cap0, cap1 = caps
    b, bl, br = node
    w0, w1, y0, y1 = sides
    h00, h01, h11 = squares
    push0, push1, pull0, pull1 = forces
    for j in range(len(m)):
        g0, g1 = m[j] * cap0[j], b[j] * cap1[j]
        use[j] = max(use[j], max(g0, g1))
        gap[j] += y0[j] * w0[j] + y1[j] * w1[j]
        r0, r1 = y0[j] / w0[j], y1[j] / w1[j]
        e1, f0, f1 = cap0[j], bl[j] * cap1[j], br[j] * cap1[j]
        by0, by1 = r0 * (g0 + w0[j] - 1.0), r1 * (g1 + w1[j] - 1.0)
        push0[j] += by1 * f0
        push1[j] += by0 * e1 + by1 * f1
        pull0[j] += y1[j] * f0
        pull1[j] += y0[j] * e1 + y1[j] * f1
        h00[j] += r1 * f0 * f0
        h01[j] += r1 * f0 * f1
        h11[j] += r0 * e1 * e1 + r1 * f1 * f1


@njit(cache=True, nogil=True, error_model='numpy', pipeline_class=DistinctArrays)
def add_to(total: FloatArray, part: FloatArray, factor: float) -> None:
    for j in range(len(total)):
        total[j] += factor * part[j]


@njit(cache=True, nogil=True, error_model='numpy')
def three_rows(x: FloatArray, first: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    return x[first], x[first + 1], x[first + 2]


@njit(cache=True, nogil=True, error_model='numpy')
def factors_of(problem: BarrierRows, k: int, q: int, lo: int, hi: int) -> FloatRows:
    """Return the factors of the three terms in the rows of an axis at a place, in cells."""
    c, rows = 3 * q, problem.factors
    return rows[k, c, lo:hi], rows[k, c + 1, lo:hi], rows[k, c + 2, lo:hi]


@njit(cache=True, nogil=True, error_model='numpy')
def sides_of(slack: FloatArray, dual: FloatArray, r: int, lo: int, hi: int) -> FloatRows:
    """Return the slacks of two rows in cells, then their duals."""
    return slack[r, lo:hi], slack[r + 1, lo:hi], dual[r, lo:hi], dual[r + 1, lo:hi]


@njit(cache=True, nogil=True, error_model='numpy')
def add_rows(
    problem: BarrierRows,
    point: Iterate,
    v: FloatArray,
    terms: FloatArray,
    slopes: FloatArray,
    newton: Newton,
    weighted: FloatArray,
) -> tuple[float, float]:
    """Write the Newton matrix, the right-hand side of the predictor step and the residual.

    ``v``: s_dot at the nodes. ``weighted``: of each chunk, the sum of dual times slack over the
    cell weights. Returns the sum without weights, and the largest violation of a row.
    """
    n_axes, places = len(problem.factors), places_of(problem.factors)
    slack, dual, edges = point.slack, point.dual, problem.edges
    total_gap, most = 0.0, 0.0
    for out in newton:
        out[:] = 0.0
    # Rows of x: the matrix of each cell (6), its right-hand side (3), its dual residual (3).
    s, x = np.empty((12, CHUNK)), np.empty((12, CHUNK))
    gap, use, zero = np.empty(CHUNK), np.empty(CHUNK), np.zeros(CHUNK)
    e = slopes
    squares = (*three_rows(s, 0), *three_rows(s, 3))
    forces = (*three_rows(s, 6), *three_rows(s, 9))
    hessian = (*three_rows(x, 0), *three_rows(x, 3))
    for chunk in range(len(weighted)):
        lo, hi = edges[chunk], edges[chunk + 1]
        left, right = slice(lo, hi), slice(lo + 1, hi + 1)
        gap[:], use[:] = 0.0, 0.0
        start = v[left], e[11, left], e[12, left], e[9, left], e[10, left]
        end = v[right], e[11, right], e[12, right], e[9, right], e[10, right]
        _time_of_cells(point.width[left], start, end, hessian, three_rows(x, 6))
        x[9:12] = x[6:9]
        for q in range(places):
            s[:] = 0.0
            at = term_rows(terms, q, lo, hi)
            for k in range(n_axes):
                constant = constant_of(problem.factors, k, q, lo, hi, zero)
                sides = sides_of(slack, dual, 2 * (places * k + q), lo, hi)
                factors = factors_of(problem, k, q, lo, hi)
                _sum_rows(factors, constant, at, sides, squares, forces, gap, use)
            z = slope_rows(slopes, q, lo, hi)
            _sums_by_coefficients(squares, z, hessian)
            by_coefficients(three_rows(s, 6), z, three_rows(x, 6))
            by_coefficients(three_rows(s, 9), z, three_rows(x, 9))
        _sum_caps(
            (problem.inverse_caps[0, left], problem.inverse_caps[1, left]),
            point.m[left],
            (terms[4, left], e[9, left], e[10, left]),
            sides_of(slack, dual, 2 * places * n_axes, lo, hi),
            (x[0], x[1], x[3]),
            (x[6], x[7], x[9], x[10]),
            gap,
            use,
        )
        weighted[chunk] = 0.0
        for j in range(hi - lo):
            total_gap += gap[j]
            weighted[chunk] += gap[j] / problem.weight[lo + j]
            most = max(most, use[j])
        for c, (square, beside) in enumerate(((0, 1), (3, 4), (5, -1))):
            first, last = lo + c, hi + c
            add_to(newton.d0[first:last], x[square], 1.0)
            add_to(newton.rhs[first:last], x[6 + c], -1.0)
            add_to(newton.residual[first:last], x[9 + c], 1.0)
            if beside >= 0:
                add_to(newton.d1[first:last], x[beside], 1.0)
        add_to(newton.d2[lo:hi], x[2], 1.0)
    return total_gap, most - 1.0


@njit(cache=True, nogil=True, error_model='numpy')
def start_rows(
    total: float,
    problem: BarrierRows,
    point: Iterate,
    v: FloatArray,
    terms: FloatArray,
    warm: bool,
) -> None:
    """Set the cell weights by time, and start slacks and duals.

    ``total`` is the time of the starting point [s]. A warm start, from nearly the same problem,
    keeps larger duals.
    """
    rows, weight, m, width = problem.factors, problem.weight, point.m, point.width
    n, n_axes, places = len(m), rows.shape[0], places_of(rows)
    least, level = (WARM_SLACK, WARM_GAP) if warm else (1.0, 0.3)
    for i in range(n):
        share = 2 * width[i] / (v[i] + v[i + 1]) / total
        weight[i] = max(n * share, 1e-3)
    use, taking_part, zero = np.empty(n), np.empty(n, dtype=np.bool_), np.zeros(n)
    for row in range(places * n_axes + 2):
        k, q = row // places, row % places
        if k < n_axes:
            x0, x1, x2 = term_rows(terms, q, 0, n)
            c0, c1, c2 = rows[k, 3 * q], rows[k, 3 * q + 1], rows[k, 3 * q + 2]
            use[:] = c0 * x0 + c1 * x1 + c2 * x2 + constant_of(rows, k, q, 0, n, zero)
            taking_part[:] = (c0 != 0.0) | (c1 != 0.0) | (c2 != 0.0)
        else:
            cap = problem.inverse_caps[row - places * n_axes]
            use[:] = cap * (m if q == 0 else terms[4, :n])
            taking_part[:] = cap != 0.0
        sides = 2 if k < n_axes else 1
        first = 2 * row if k < n_axes else 2 * places * n_axes + q
        for side in range(sides):
            w, y = point.slack[first + side], point.dual[first + side]
            for i in range(n):
                w[i] = max(1.0 - use[i] if side == 0 else 1.0 + use[i], least)
                balanced = level * total / n * weight[i] / w[i]
                y[i] = (max(y[i], balanced) if warm else balanced) if taking_part[i] else 0.0
