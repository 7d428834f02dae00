"""
The smoothest quintic spline in the tolerance tube around a polyline.

Least squares to samples of the polyline plus a multiple of the integral of |X'''|^2, X = (tip,
top), by banded normal equations; then again and again, with the weight of each sample multiplied
by a power of its deviation from what is wanted: samples well inside the tube let go, samples near
its wall pull. What this tends to is the spline of least integral whose deviation stays within the
tube, as Lawson's weights tend to the Chebyshev approximation.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

#: Weight of the integral of |X'''|^2 at a tolerance of TYPICAL [m^6, m].
STIFFNESS, TYPICAL = 1e-19, 1e-5
#: Deviation wanted, as share of the tolerance, and how sharply weights answer.
AIM, POWER = 0.85, 1.2
#: A sweep changes a weight by these factors at most; and weights in all.
LEAST_CHANGE, MOST_CHANGE = 0.2, 8.0
LEAST_WEIGHT, MOST_WEIGHT = 1e-5, 1e9
#: Coefficients that one span of a quintic depends on.
ORDER = 6


@njit(cache=True, nogil=True)
def clamped(knots):  # type: ignore[no-untyped-def]
    """Return the full knot vector of a quintic that ends at the first and last knot."""
    n = len(knots)
    full = np.empty(n + 10)
    full[:5] = knots[0]
    full[5 : 5 + n] = knots
    full[5 + n :] = knots[n - 1]
    return full


@njit(cache=True, nogil=True)
def bezier_matrices(full, spans):  # type: ignore[no-untyped-def]
    """Return the matrices that make Bezier points of B-spline coefficients, span by span."""
    matrices = np.zeros((spans, 6, 6))
    d = np.empty((6, 6))
    for s in range(spans):
        a, b = full[s + 5], full[s + 6]
        for k in range(6):  # the k-th point is the blossom at k times b, else a
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
def end_coefficients(jet, full, known, at_end):  # type: ignore[no-untyped-def]
    """
    Return the first (last) coefficients of a clamped quintic from its derivatives there.

    Parameters
    ----------
    jet : ndarray, shape (known, d)
        Value and derivatives, divided by their factorials.
    full : ndarray
        Full knot vector.
    known : int
        How many.
    at_end : bool
        Whether the end is meant; coefficients then count from the end.

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


@njit(cache=True, nogil=True)
def bend_matrix(matrices, knots):  # type: ignore[no-untyped-def]
    """Return the bands of the integral of |X'''|^2 as a quadratic form of the coefficients."""
    spans = len(matrices)
    bands = np.zeros((spans + 5, 6))
    gram = np.array([[6.0, 3.0, 1.0], [3.0, 4.0, 3.0], [1.0, 3.0, 6.0]]) / 30.0
    third = np.empty((3, 6))
    for s in range(spans):
        d = knots[s + 1] - knots[s]
        factor = 3600.0 / d**5  # (5 4 3 / d^3)^2 d
        for k in range(3):
            for i in range(6):
                m = matrices[s]
                third[k, i] = m[k + 3, i] - 3.0 * m[k + 2, i] + 3.0 * m[k + 1, i] - m[k, i]
        for i in range(6):
            for j in range(i, 6):
                total = 0.0
                for p in range(3):
                    for q in range(3):
                        total += third[p, i] * gram[p, q] * third[q, j]
                bands[s + i, j - i] += factor * total
    return bands


@njit(cache=True, nogil=True)
def basis_at(matrices, knots, x, span):  # type: ignore[no-untyped-def]
    """Return the six basis functions that are not zero at each of the points, shape (m, 6)."""
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
def solve_bands(bands, right, first, last):  # type: ignore[no-untyped-def]
    """
    Solve the rows first ... last - 1 of a banded symmetric system in place (Cholesky).

    Returns False where rounding made the matrix indefinite.
    """
    width, columns = bands.shape[1], right.shape[1]
    for i in range(first, last):
        if not bands[i, 0] > 0.0:
            return False
        pivot = sqrt(bands[i, 0])
        bands[i, 0] = pivot
        for k in range(1, min(width, last - i)):
            bands[i, k] /= pivot
        for k in range(1, min(width, last - i)):
            for j in range(k, min(width, last - i)):
                bands[i + k, j - k] -= bands[i, k] * bands[i, j]
        for c in range(columns):
            right[i, c] /= pivot
        for k in range(1, min(width, last - i)):
            for c in range(columns):
                right[i + k, c] -= bands[i, k] * right[i, c]
    for i in range(last - 1, first - 1, -1):
        for k in range(1, min(width, last - i)):
            for c in range(columns):
                right[i, c] -= bands[i, k] * right[i + k, c]
        for c in range(columns):
            right[i, c] /= bands[i, 0]
    return True


@njit(cache=True, nogil=True)
def deviations(coefficients, basis, span, point, tool, allowed, turning, out):  # type: ignore[no-untyped-def]
    """
    Write the deviation of each sample as share of its tolerance; returns the largest.

    The top counts as it acts once D = top - tip is normalised: along the tool axis the top may
    be anywhere, and goes with the tip.
    """
    largest = 0.0
    gap = np.zeros(6)
    columns = coefficients.shape[1]
    for m in range(len(span)):
        s = span[m]
        for c in range(columns):
            total = -point[m, c]
            for i in range(6):
                total += basis[m, i] * coefficients[s + i, c]
            gap[c] = total
        off = sqrt(gap[0] ** 2 + gap[1] ** 2 + gap[2] ** 2) / allowed[m, 0]
        if turning:
            along = 0.0
            for i in range(3):
                along += (gap[i] - gap[3 + i]) * tool[m, i]
            top = 0.0
            for i in range(3):
                top += (gap[3 + i] + along * tool[m, i]) ** 2
            off = max(off, sqrt(top) / allowed[m, 1])
        out[m] = off
        largest = max(largest, off)
    return largest


@njit(cache=True, nogil=True)
def fit(full, matrices, knots, start, end, cloud, turning, sweeps, aim, stiffness):  # type: ignore[no-untyped-def]
    """
    Return the coefficients of the smoothest spline in the tube, and its largest deviation.

    Parameters
    ----------
    full, matrices, knots
        Full knot vector, Bezier matrices, and knots.
    start, end : ndarray, shapes (m, 6)
        Value and derivatives, divided by their factorials, that the spline has at both ends.
    cloud : tuple
        What ``samples`` returned.
    turning : bool
        Whether the tool turns; else only the tip is solved for.
    sweeps : tuple of int
        Fewest and most sweeps.
    aim : float
        Deviation wanted, as share of the tolerance.
    stiffness : float
        Weight of the integral of |X'''|^2 [m^6].

    """
    x, span, point, tool, allowed, simpson = cloud
    columns = 6 if turning else 3
    spans = len(knots) - 1
    count = spans + 5
    head, tail = len(start), len(end)
    coefficients = np.zeros((count, columns))
    fixed = np.zeros((count, columns))
    if head:
        fixed[:head] = end_coefficients(start, full, head, False)[:, :columns]
    if tail:
        fixed[count - tail :] = end_coefficients(end, full, tail, True)[::-1, :columns]
    basis = basis_at(matrices, knots, x, span)
    bend = bend_matrix(matrices, knots)
    weight, off = np.ones(len(x)), np.empty(len(x))
    best, best_off = fixed.copy(), np.inf
    for sweep in range(sweeps[1]):
        bands = stiffness * bend
        right = np.zeros((count, columns))
        for m in range(len(x)):
            w = weight[m] * simpson[m]
            s = span[m]
            for i in range(6):
                wi = w * basis[m, i]
                for j in range(i, 6):
                    bands[s + i, j - i] += wi * basis[m, j]
                for c in range(columns):
                    right[s + i, c] += wi * point[m, c]
        for i in range(head):
            for k in range(1, 6):
                if head <= i + k < count - tail:
                    for c in range(columns):
                        right[i + k, c] -= bands[i, k] * fixed[i, c]
        for i in range(max(head, count - tail - 5), count - tail):
            for k in range(1, 6):
                if count - tail <= i + k < count:
                    for c in range(columns):
                        right[i, c] -= bands[i, k] * fixed[i + k, c]
        if not solve_bands(bands, right, head, count - tail):
            break
        coefficients[:] = fixed
        coefficients[head : count - tail] = right[head : count - tail]
        largest = deviations(coefficients, basis, span, point, tool, allowed, turning, off)
        if largest < best_off:
            best_off = largest
            best[:] = coefficients
        if sweep + 1 >= sweeps[0] and largest <= 1.06 * aim:
            return coefficients, largest
        if largest <= 0.35 * aim and sweep == 0:
            return coefficients, largest
        for m in range(len(x)):
            change = (off[m] / aim + 1e-3) ** POWER
            weight[m] *= min(max(change, LEAST_CHANGE), MOST_CHANGE)
            weight[m] = min(max(weight[m], LEAST_WEIGHT), MOST_WEIGHT)
    return best, best_off


@njit(cache=True, nogil=True)
def span_points(coefficients, matrices, spans):  # type: ignore[no-untyped-def]
    """Return the Bezier points of the first spans, shape (spans, 6, d)."""
    points = np.zeros((spans, 6, coefficients.shape[1]))
    for s in range(spans):
        for k in range(6):
            for i in range(6):
                for c in range(coefficients.shape[1]):
                    points[s, k, c] += matrices[s, k, i] * coefficients[s + i, c]
    return points


@njit(cache=True, nogil=True)
def end_jet(points, length):  # type: ignore[no-untyped-def]
    """Return value and four derivatives, divided by their factorials, at the end of a span."""
    columns = points.shape[1]
    jet = np.zeros((5, columns))
    choose = (1.0, 5.0, 10.0, 10.0, 5.0)
    difference = points.copy()
    for k in range(5):
        jet[k] = choose[k] * difference[5 - k] / length**k
        for j in range(5 - k):
            difference[j] = difference[j + 1] - difference[j]
    return jet
