"""Bezier spans of cubic B-splines: extraction, degree elevation, division; vectorised."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray


def cubic_spans(points: FloatArray, knots: FloatArray) -> FloatArray:
    """
    Return the Bezier points of spans of cubic B-splines.

    Parameters
    ----------
    points : ndarray, shape (n, 4, 3)
        The four control points that act on each span [m].
    knots : ndarray, shape (n, 6)
        The knots around it: the span lies between the third and the fourth [-].

    Returns
    -------
    ndarray, shape (n, 4, 3)
        From the blossom of the span's polynomial: b_i has i arguments at its right end.

    """
    left, right = knots[:, 2], knots[:, 3]
    found = []
    for count in range(4):
        level = [points[:, i] for i in range(4)]
        for degree in range(1, 4):  # de Boor's scheme with an argument of its own at each level
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
    """Return the affine combination of a and b, shape (n, 3), for x between two knots."""
    share = ((x - low) / (high - low))[:, None]
    return np.asarray((1.0 - share) * a + share * b)


def elevated(points: FloatArray, degree: int) -> FloatArray:
    """Return the same Bezier curves, shape (n, k, 3), with ``degree + 1`` points."""
    while points.shape[1] <= degree:
        k = points.shape[1]
        share = (np.arange(1, k) / k)[:, None]
        inner = share * points[:, :-1] + (1.0 - share) * points[:, 1:]
        points = np.concatenate([points[:, :1], inner, points[:, -1:]], axis=1)
    return points


def divided(points: FloatArray, u: float = 0.5) -> tuple[FloatArray, FloatArray]:
    """Divide Bezier curves, shape (n, k, 3), at u into two, by de Casteljau's scheme."""
    left, right = [points[:, 0]], [points[:, -1]]
    while points.shape[1] > 1:
        points = (1.0 - u) * points[:, :-1] + u * points[:, 1:]
        left.append(points[:, 0])
        right.append(points[:, -1])
    return np.stack(left, axis=1), np.stack(right[::-1], axis=1)


def derivatives(points: FloatArray) -> FloatArray:
    """Return C', C'', C''' of Bezier curves, shape (n, k, 3) with k > 3, at u = 0: (3, n, 3)."""
    degree = points.shape[1] - 1
    found, factor, rest = [], 1.0, points
    for order in range(3):
        rest = rest[:, 1:] - rest[:, :-1]
        factor *= degree - order
        found.append(factor * rest[:, 0])
    return np.stack(found)
