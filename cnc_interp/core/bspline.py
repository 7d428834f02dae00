"""Bezier pieces with proven bounds, and the B-splines of programs, the compressor and corners.

A Bezier curve lies in the convex hull of its points, and each derivative in the hull of their
differences, so the bounds hold everywhere. Compiled functions return jets (``jet.py``) of a piece.

The corner spline is a cubic B-spline with knots (0 0 0 0 .5 1 1 1 1) [B2013, section 2.2].
"""

from collections.abc import Iterable
from math import comb
from typing import Any

import numpy as np

from cnc_interp.core import FloatArray, IntArray, norm
from cnc_interp.core.jet import Jet
from cnc_interp.core.kernels import njit


def bezier_values(values: FloatArray, t: FloatArray | float) -> FloatArray:
    """Evaluate Bezier curves (..., k) of degree k - 1 at t in [0, 1], by de Casteljau."""
    while values.shape[-1] > 1:
        values = values[..., :-1] + np.asarray(t)[..., None] * np.diff(values, axis=-1)
    return values[..., 0]


def elevated(points: FloatArray, degree: int) -> FloatArray:
    """Return the Bezier points of the same curves, (n, k, d), with a higher degree."""
    while points.shape[1] <= degree:
        k = points.shape[1]
        share = (np.arange(1, k) / k)[:, None]
        inner = share * points[:, :-1] + (1.0 - share) * points[:, 1:]
        points = np.concatenate([points[:, :1], inner, points[:, -1:]], axis=1)
    return points


def divided(points: FloatArray, u: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Divide Bezier curves, (n, k, d), at one parameter: the parts before and after u."""
    left, right = [points[:, 0]], [points[:, -1]]
    while points.shape[1] > 1:
        points = (1.0 - u) * points[:, :-1] + u * points[:, 1:]
        left.append(points[:, 0])
        right.append(points[:, -1])
    return np.stack(left, axis=1), np.stack(right[::-1], axis=1)


def start_derivatives(points: FloatArray) -> FloatArray:
    """Return the first three derivatives of Bezier curves, (n, k, d), at u = 0, (3, n, d)."""
    degree = points.shape[1] - 1
    found, factor, rest = [], 1.0, points
    for order in range(3):
        rest = rest[:, 1:] - rest[:, :-1]
        factor *= degree - order
        found.append(factor * rest[:, 0])
    return np.stack(found)


@njit(cache=True, nogil=True, inline='always')
def bezier_jet(points: FloatArray, i: int, u: float) -> Jet:
    """Return the jet in u of coordinate i of a Bezier curve, (k, d), by de Casteljau."""
    n = points.shape[0]
    work = np.empty(n)
    for k in range(n):
        work[k] = points[k, i]
    d1 = d2 = d3 = 0.0
    v = 1.0 - u
    for level in range(n - 1, 0, -1):
        if level == 3:
            d3 = work[3] - 3.0 * work[2] + 3.0 * work[1] - work[0]
        if level == 2:
            d2 = work[2] - 2.0 * work[1] + work[0]
        if level == 1:
            d1 = work[1] - work[0]
        for k in range(level):
            work[k] = v * work[k] + u * work[k + 1]
    p = n - 1.0
    return (work[0], p * d1, p * (p - 1.0) * d2 / 2.0, p * (p - 1.0) * (p - 2.0) * d3 / 6.0)


@njit(cache=True, nogil=True, inline='always')
def quintic_jet(points: FloatArray, i: int, u: float) -> Jet:
    """Return the jet in u of coordinate i of a quintic Bezier curve, fast: no work array."""
    p0, p1, p2, p3, p4, p5 = (
        points[0, i],
        points[1, i],
        points[2, i],
        points[3, i],
        points[4, i],
        points[5, i],
    )
    d1, d2, d3, d4, d5 = p1 - p0, p2 - p1, p3 - p2, p4 - p3, p5 - p4
    a1 = 5.0 * d1
    d1, d2, d3, d4 = d2 - d1, d3 - d2, d4 - d3, d5 - d4
    a2 = 10.0 * d1
    d1, d2, d3 = d2 - d1, d3 - d2, d4 - d3
    a3 = 10.0 * d1
    d1, d2 = d2 - d1, d3 - d2
    a4, a5 = 5.0 * d1, d2 - d1
    return (
        p0 + u * (a1 + u * (a2 + u * (a3 + u * (a4 + u * a5)))),
        a1 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + 5.0 * u * a5))),
        a2 + u * (3.0 * a3 + u * (6.0 * a4 + 10.0 * u * a5)),
        a3 + u * (4.0 * a4 + 10.0 * u * a5),
    )


@njit(cache=True, nogil=True)
def quintic_part(points: FloatArray, a: float, b: float, out: FloatArray) -> None:
    """Write the Bezier points of the part of a quintic (6, d) between two parameters."""
    columns = points.shape[1]
    work = np.empty(6)
    for c in range(columns):
        for k in range(6):
            for i in range(6):
                work[i] = points[i, c]
            for r in range(1, 6):
                t = b if r <= k else a
                for i in range(6 - r):
                    work[i] = (1.0 - t) * work[i] + t * work[i + 1]
            out[k, c] = work[0]


@njit(cache=True, nogil=True)
def quintic_end_jet(points: FloatArray, length: float) -> FloatArray:
    """Return value and four Taylor coefficients at the end of a quintic piece."""
    columns = points.shape[1]
    jet = np.zeros((5, columns))
    choose = (1.0, 5.0, 10.0, 10.0, 5.0)
    difference = points.copy()
    for k in range(5):
        jet[k] = choose[k] * difference[5 - k] / length**k
        for j in range(5 - k):
            difference[j] = difference[j + 1] - difference[j]
    return jet


def largest(points: FloatArray) -> FloatArray:
    """Return the largest length among the vectors of each curve, shape (..., k, 3) to (...)."""
    return np.asarray(norm(points).max(axis=-1, initial=0.0))


def weighted_largest(points: FloatArray) -> FloatArray:
    """Bound the lengths of curves by maxima of the Bernstein polynomials, (n, k, 3) to (n,)."""
    k, degree = np.arange(points.shape[1]), points.shape[1] - 1
    share = k / degree
    weight = np.array([comb(degree, int(i)) for i in k]) * share**k * (1.0 - share) ** (degree - k)
    return np.asarray((weight * norm(points)).sum(axis=1))


def derivative_bounds(points: FloatArray, length: float = 1.0) -> FloatArray:
    """Bound the first three derivatives of Bezier curves over intervals of a length, (3, ...)."""
    degree, found = points.shape[-2] - 1, []
    for order in range(3):
        points = np.diff(points, axis=-2) * ((degree - order) / length)
        found.append(largest(points))
    return np.stack(found)


def least_length(points: FloatArray) -> FloatArray:
    """Return a lower bound of the distance from zero, (..., k, 3) to (...), by one direction."""
    mean = points[..., 0, :]
    for k in range(1, points.shape[-2]):
        mean = mean + points[..., k, :]
    along = points * (mean / np.maximum(norm(mean), 1e-300)[..., None])[..., None, :]
    return np.asarray((along[..., 0] + along[..., 1] + along[..., 2]).min(axis=-1))


def cubic_bezier_points(points: FloatArray, knots: FloatArray) -> FloatArray:
    """Return Bezier points (n, 4, d) of cubic spans, by blossoms; ``knots`` (n, 6) around each."""
    left, right = knots[:, 2], knots[:, 3]
    found = []
    for count in range(4):
        level = [points[:, i] for i in range(4)]
        for degree in range(1, 4):  # de Boor's scheme with another argument on each level
            x = right if degree <= count else left
            level = [
                _between(level[i], level[i + 1], x, knots[:, i + degree - 1], knots[:, i + 3])
                for i in range(4 - degree)
            ]
        found.append(level[0])
    return np.stack(found, axis=1)


def _between(
    a: FloatArray, b: FloatArray, x: FloatArray, low: FloatArray, high: FloatArray
) -> FloatArray:
    share = ((x - low) / (high - low))[:, None]
    return np.asarray((1.0 - share) * a + share * b)


@njit(cache=True, nogil=True)
def clamped_knots(knots: FloatArray) -> FloatArray:
    """Return the knot vector of a clamped quintic B-spline: both ends six times."""
    n = len(knots)
    full = np.empty(n + 10)
    full[:5] = knots[0]
    full[5 : 5 + n] = knots
    full[5 + n :] = knots[n - 1]
    return full


@njit(cache=True, nogil=True)
def quintic_bezier_matrices(full: FloatArray, spans: int) -> FloatArray:
    """Return matrices (spans, 6, 6) from control points of a quintic B-spline to Bezier points."""
    matrices = np.zeros((spans, 6, 6))
    d = np.empty((6, 6))
    for s in range(spans):
        a, b = full[s + 5], full[s + 6]
        for k in range(6):  # Bezier point k is the blossom with k arguments b, the others a
            d[:] = 0.0
            for j in range(6):
                d[j, j] = 1.0
            for r in range(1, 6):
                x = b if r <= k else a
                for j in range(5, r - 1, -1):
                    low, high = full[s + j], full[s + j + 6 - r]
                    share = (x - low) / (high - low)
                    for i in range(6):
                        d[j, i] = (1.0 - share) * d[j - 1, i] + share * d[j, i]
            matrices[s, k] = d[5]
    return matrices


@njit(cache=True, nogil=True)
def quintic_bezier_points(
    coefficients: FloatArray, matrices: FloatArray, spans: int
) -> FloatArray:
    """Return the Bezier points of the first spans of a quintic B-spline, (spans, 6, d)."""
    points = np.zeros((spans, 6, coefficients.shape[1]))
    for s in range(spans):
        for k in range(6):
            for i in range(6):
                for c in range(coefficients.shape[1]):
                    points[s, k, c] += matrices[s, k, i] * coefficients[s + i, c]
    return points


@njit(cache=True, nogil=True)
def quintic_basis(
    matrices: FloatArray, knots: FloatArray, x: FloatArray, span: IntArray
) -> FloatArray:
    """Return the six basis functions of a quintic B-spline that are not zero at each x."""
    basis = np.zeros((len(x), 6))
    for m in range(len(x)):
        s = span[m]
        t = (x[m] - knots[s]) / (knots[s + 1] - knots[s])
        v = 1.0 - t
        weight = (
            v**5,
            5.0 * t * v**4,
            10.0 * t * t * v**3,
            10.0 * t**3 * v * v,
            5.0 * t**4 * v,
            t**5,
        )
        for k in range(6):
            for i in range(6):
                basis[m, i] += weight[k] * matrices[s, k, i]
    return basis


@njit(cache=True, nogil=True)
def quintic_end_coefficients(
    jet: FloatArray, full: FloatArray, known: int, at_end: bool
) -> FloatArray:
    """Return the first or last ``known`` control points of a clamped quintic B-spline.

    ``jet`` (known, d): Taylor coefficients at that end.
    """
    choose = (1.0, 5.0, 10.0, 10.0, 5.0, 1.0)
    found = np.zeros((known, jet.shape[1]))
    symmetric = np.zeros(6)
    symmetric[0] = 1.0
    last = len(full) - 1
    for i in range(known):
        if i > 0:
            step = full[last - 5 - i] - full[last] if at_end else full[5 + i] - full[0]
            for k in range(i, 0, -1):
                symmetric[k] += step * symmetric[k - 1]
        for k in range(i + 1):
            found[i] += symmetric[k] / choose[k] * jet[k]
    return found


def corner_spline_points(points: FloatArray, u: FloatArray | float) -> FloatArray:
    """Return points at u of corner splines, (..., 5, 3) [B2013, Eq. 1 and A.2]."""
    if np.ndim(u) == 0:
        places = range(4) if u <= 0.5 else range(4, 0, -1)
        weights = _corner_basis(min(float(u), 1.0 - float(u)))
        return sum_of(w * points[..., i, :] for w, i in zip(weights, places, strict=True))
    late = (np.asarray(u) > 0.5)[..., None]
    weights = _corner_basis(np.minimum(u, 1.0 - np.asarray(u)))
    return sum_of(
        w[..., None] * np.where(late, points[..., 4 - i, :], points[..., i, :])
        for i, w in enumerate(weights)
    )


def _corner_basis(x: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four basis functions that are not zero at x in [0, 0.5] [B2013, Eq. A.2]."""
    return (
        (1.0 - 2.0 * x) ** 3,
        2.0 * x * (3.0 + x * (7.0 * x - 9.0)),
        2.0 * x * x * (3.0 - 4.0 * x),
        2.0 * x**3,
    )


def sum_of(terms: Iterable[FloatArray]) -> FloatArray:
    """Add arrays in the given order, so that the result is reproducible bit by bit."""
    first, *rest = terms
    for term in rest:
        first = first + term
    return first


def corner_pieces(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Bezier points of both halves of corner splines, shape (n, 5 or more, d)."""
    p0, p1, p2, p3, p4 = (points[:, i] for i in range(5))
    before, after = 0.5 * (p1 + p2), 0.5 * (p2 + p3)
    middle = 0.5 * (before + after)
    return (np.stack([p0, p1, before, middle], axis=1), np.stack([middle, after, p3, p4], axis=1))


def corner_end_derivatives(points: FloatArray) -> FloatArray:
    """Return three derivatives of corner splines at u = 0, (3, n, 3) [B2013, Eq. A.2]."""
    p0, p1, p2, p3 = (points[:, i] for i in range(4))
    first, second = 6.0 * (p1 - p0), 24.0 * p0 - 36.0 * p1 + 12.0 * p2
    return np.stack([first, second, -48.0 * p0 + 84.0 * p1 - 48.0 * p2 + 12.0 * p3])


@njit(cache=True, nogil=True, inline='always')
def corner_spline_jet(points: FloatArray, i: int, u: float, second_half: bool) -> Jet:
    """Return the jet in u of coordinate i of one half of a corner spline [B2013, Eq. 1, A.2]."""
    if second_half:  # the reversed control points give the same curve backwards
        p0, p1, p2, p3 = points[4, i], points[3, i], points[2, i], points[1, i]
        x, sign = 1.0 - u, -1.0
    else:
        p0, p1, p2, p3 = points[0, i], points[1, i], points[2, i], points[3, i]
        x, sign = u, 1.0
    # (1-2x)^3 p0 + 2x(3 - 9x + 7x^2) p1 + 2x^2(3 - 4x) p2 + 2x^3 p3, in powers of x
    a1 = 6.0 * (p1 - p0)
    a2 = 12.0 * p0 - 18.0 * p1 + 6.0 * p2
    a3 = -8.0 * p0 + 14.0 * p1 - 8.0 * p2 + 2.0 * p3
    return (
        p0 + x * (a1 + x * (a2 + x * a3)),
        sign * (a1 + x * (2.0 * a2 + 3.0 * x * a3)),
        a2 + 3.0 * x * a3,
        sign * a3,
    )
