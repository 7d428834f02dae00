"""B-splines to Bezier pieces: cubic ones of native programs, quintic ones of the compressor."""

from __future__ import annotations

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray, IntArray


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
        weight = (v**5, 5.0 * t * v**4, 10.0 * t * t * v**3, 10.0 * t**3 * v * v,
                  5.0 * t**4 * v, t**5)  # fmt: skip
        for k in range(6):
            for i in range(6):
                basis[m, i] += weight[k] * matrices[s, k, i]
    return basis


@njit(cache=True, nogil=True)
def quintic_end_coefficients(
    jet: FloatArray, full: FloatArray, known: int, at_end: bool
) -> FloatArray:
    """Return the first or last ``known`` control points of a clamped quintic B-spline.

    ``jet`` (known, d): value and derivatives there, each over the factorial of its order.
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
