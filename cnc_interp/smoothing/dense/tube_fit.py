"""The smoothest quintic spline within the tolerance tube of a polyline.

The spline X = (tip, top) minimises the squared distance from samples of the polyline plus a
multiple of the integral of |X'''|^2. This is a banded system of normal equations. It is solved
several times. After each sweep, the weight of a sample is multiplied by a power of its deviation
over the wanted deviation. Samples well inside the tube lose weight, samples near its wall gain
weight. The result tends to the spline with the smallest integral inside the tube. Lawson's
weights for Chebyshev approximation work in the same way.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.bspline import quintic_basis, quintic_end_coefficients
from cnc_interp.core.kernels import njit

#: Output of ``knots.sample_points``.
Samples = tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]

#: Weight of the integral of |X'''|^2 [m^6] at a tolerance of TYPICAL [m].
STIFFNESS, TYPICAL = 1e-19, 1e-5
POWER = 1.2  #: Exponent of the change of weights.
#: Smallest and largest factor on a weight in one sweep, and the range of weights.
LEAST_CHANGE, MOST_CHANGE = 0.2, 8.0
LEAST_WEIGHT, MOST_WEIGHT = 1e-5, 1e9


@njit(cache=True, nogil=True)
def _bend_bands(matrices: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the bands of the integral of |X'''|^2 as a quadratic form of the control points."""
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
def _solve_bands(bands: FloatArray, right: FloatArray, first: int, last: int) -> bool:
    """Solve some rows of a symmetric system in place (Cholesky); False if it is indefinite."""
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
def _deviations(
    coefficients: FloatArray,
    basis: FloatArray,
    span: IntArray,
    point: FloatArray,
    tool: FloatArray,
    allowed: FloatArray,
    turning: bool,
    out: FloatArray,
) -> float:
    """Write the deviation of each sample as part of its tolerance, and return the largest one.

    Only the direction of D = top - tip matters: along the tool axis, the error is that of the tip.
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


class QuinticBasis(NamedTuple):
    """The knots of a quintic spline, those with multiple ends, and its Bezier matrices."""

    full: FloatArray
    matrices: FloatArray
    knots: FloatArray


@njit(cache=True, nogil=True)
def fit(
    basis: QuinticBasis,
    start: FloatArray,
    end: FloatArray,
    samples: Samples,
    turning: bool,
    sweeps: tuple[int, int],
    aim: float,
    stiffness: float,
) -> tuple[FloatArray, float]:
    """Fit the smoothest quintic spline within the tolerance tube.

    ``start`` and ``end`` (m, 6) have value and derivatives over factorials, ``aim`` is the wanted
    deviation as part of the tolerance [-]. Returns the control points and the largest deviation of
    a sample.
    """
    full, matrices, knots = basis
    x, span, point, tool, allowed, simpson = samples
    columns = 6 if turning else 3
    spans = len(knots) - 1
    count = spans + 5
    head, tail = len(start), len(end)
    coefficients = np.zeros((count, columns))
    fixed = np.zeros((count, columns))
    if head:
        fixed[:head] = quintic_end_coefficients(start, full, head, False)[:, :columns]
    if tail:
        fixed[count - tail :] = quintic_end_coefficients(end, full, tail, True)[::-1, :columns]
    at_samples = quintic_basis(matrices, knots, x, span)
    bend = _bend_bands(matrices, knots)
    weight, off = np.ones(len(x)), np.empty(len(x))
    best, best_off = fixed.copy(), np.inf
    for sweep in range(sweeps[1]):
        bands = stiffness * bend
        right = np.zeros((count, columns))
        for m in range(len(x)):
            w = weight[m] * simpson[m]
            s = span[m]
            for i in range(6):
                wi = w * at_samples[m, i]
                for j in range(i, 6):
                    bands[s + i, j - i] += wi * at_samples[m, j]
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
        if not _solve_bands(bands, right, head, count - tail):
            break
        coefficients[:] = fixed
        coefficients[head : count - tail] = right[head : count - tail]
        largest = _deviations(coefficients, at_samples, span, point, tool, allowed, turning, off)
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
