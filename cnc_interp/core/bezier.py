"""Bezier pieces: their points, derivatives, division, degree elevation and proven bounds.

``bspline.py`` converts B-splines to pieces. The NumPy functions work on many pieces at once; the
compiled ones on one piece, and return jets (``jet.py``). A curve lies in the hull of its points,
and each derivative in the hull of their differences, so the bounds miss no place.
"""

from math import comb

import numpy as np
from numba import njit

from cnc_interp.core import FloatArray, norm
from cnc_interp.core.jet import Jet


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
        points[0, i], points[1, i], points[2, i], points[3, i], points[4, i], points[5, i],
    )  # fmt: skip
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
    """Write the Bezier points of a quintic (6, d) between two parameters, as blossoms."""
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
    """Return value and four derivatives, over factorials, at the end of a quintic piece."""
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
    """Return a lower bound of the distance from zero, (..., k, 3) to (...), by a direction."""
    mean = points[..., 0, :]
    for k in range(1, points.shape[-2]):
        mean = mean + points[..., k, :]
    along = points * (mean / np.maximum(norm(mean), 1e-300)[..., None])[..., None, :]
    return np.asarray((along[..., 0] + along[..., 1] + along[..., 2]).min(axis=-1))
