"""
Proven bounds of Bezier curves from their points.

A curve lies in the convex hull of its Bezier points, and each derivative in the hull of its own
points, which are differences. So no place of the curve is missed.
"""

from __future__ import annotations

from math import comb

import numpy as np

from cnc_interp.core.arrays import FloatArray


def _size(v: FloatArray) -> FloatArray:
    """Return the lengths of vectors, shape (..., 3) to (...); the order of the sum is fixed."""
    return np.asarray(np.sqrt(v[..., 0] ** 2 + v[..., 1] ** 2 + v[..., 2] ** 2))


def largest(points: FloatArray) -> FloatArray:
    """Return the largest length among the vectors of each curve, shape (..., k, 3) to (...)."""
    return np.asarray(_size(points).max(axis=-1, initial=0.0))


def weighted_largest(points: FloatArray) -> FloatArray:
    """
    Bound the lengths of curves by the maxima of the Bernstein polynomials, (n, k, 3) to (n,).

    This is sharper than the largest point where few of the points are far from zero.
    """
    k, degree = np.arange(points.shape[1]), points.shape[1] - 1
    share = k / degree
    weight = np.array([comb(degree, int(i)) for i in k]) * share**k * (1.0 - share) ** (degree - k)
    return np.asarray((weight * _size(points)).sum(axis=1))


def derivative_bounds(points: FloatArray, length: float = 1.0) -> FloatArray:
    """Bound the first three derivatives of Bezier curves over intervals of a length, (3, ...)."""
    degree, found = points.shape[-2] - 1, []
    for order in range(3):
        points = np.diff(points, axis=-2) * ((degree - order) / length)
        found.append(largest(points))
    return np.stack(found)


def least_length(points: FloatArray) -> FloatArray:
    """
    Return a lower bound of the distance of Bezier curves from zero, shape (..., k, 3) to (...).

    In the direction of the mean of the points, the component of the curve is at least that of the
    nearest point. Where the hull contains zero, the bound is not positive.
    """
    mean = points[..., 0, :]
    for k in range(1, points.shape[-2]):
        mean = mean + points[..., k, :]
    along = points * (mean / np.maximum(_size(mean), 1e-300)[..., None])[..., None, :]
    return np.asarray((along[..., 0] + along[..., 1] + along[..., 2]).min(axis=-1))
