"""Curves of many corners: cubic B-splines, their derivatives at the ends, and poses on them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import comb
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.smoothing.orientation import norm


@dataclass
class Curves:
    """
    The curves of n corners, as in PathSegments.

    Parameters
    ----------
    bottom, top : ndarray, shape (n, 5, 3)
        Control points [m].
    connection : ndarray, shape (n, m, 3)
        Bezier points of E [m].
    parametrization : ndarray, shape (n, spans, 8)
        Spans of f; none where f(u) = u [-].

    """

    bottom: FloatArray
    top: FloatArray
    connection: FloatArray
    parametrization: FloatArray

    @staticmethod
    def empty(count: int, points: int, spans: int) -> Curves:
        """Return room for a number of corners."""
        return Curves(
            np.zeros((count, 5, 3)),
            np.zeros((count, 5, 3)),
            np.zeros((count, points, 3)),
            np.zeros((count, spans, 8)),
        )

    def put(self, rows: IntArray, other: Curves) -> None:
        """Replace some of the corners."""
        self.bottom[rows], self.top[rows] = other.bottom, other.top
        self.connection[rows] = other.connection
        self.parametrization[rows] = other.parametrization


def spline_points(points: FloatArray, u: FloatArray | float) -> FloatArray:
    """
    Return points of corner splines [B2013, Eq. 1 and A.2].

    Parameters
    ----------
    points : ndarray, shape (..., 5, 3)
        Control points.
    u : float or ndarray, shape (...)
        Parameters in [0, 1].

    Returns
    -------
    ndarray, shape (..., 3)

    """
    if np.ndim(u) == 0:
        places = range(4) if u <= 0.5 else range(4, 0, -1)
        weights = spline_basis(min(float(u), 1.0 - float(u)))
        return sum_of(w * points[..., i, :] for w, i in zip(weights, places, strict=True))
    late = (np.asarray(u) > 0.5)[..., None]
    weights = spline_basis(np.minimum(u, 1.0 - np.asarray(u)))
    return sum_of(
        w[..., None] * np.where(late, points[..., 4 - i, :], points[..., i, :])
        for i, w in enumerate(weights)
    )


def spline_basis(x: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four basis functions that are not zero at x in [0, 0.5] [A.2]."""
    return (
        (1.0 - 2.0 * x) ** 3,
        2.0 * x * (3.0 + x * (7.0 * x - 9.0)),
        2.0 * x * x * (3.0 - 4.0 * x),
        2.0 * x**3,
    )


def sum_of(terms: Iterable[FloatArray]) -> FloatArray:
    """Add arrays in their order."""
    first, *rest = terms
    for term in rest:
        first = first + term
    return first


def bezier(values: FloatArray, t: FloatArray | float) -> FloatArray:
    """Return Bezier curves with points on axis -1 at t, by de Casteljau's scheme."""
    while values.shape[-1] > 1:
        values = values[..., :-1] + np.asarray(t)[..., None] * np.diff(values, axis=-1)
    return values[..., 0]


def top_parameters(parametrization: FloatArray, u: float) -> FloatArray:
    """Return u_top = f(u) of n corners, shape (n,)."""
    n, spans = parametrization.shape[:2]
    if spans == 0:
        return np.full(n, u)
    starts = parametrization[..., 0]
    k = np.maximum((starts <= u).sum(axis=1) - 1, 0)
    rows = np.arange(n)
    start = starts[rows, k]
    end = np.where(k + 1 < spans, starts[rows, np.minimum(k + 1, spans - 1)], 1.0)
    return bezier(parametrization[rows, k, 1:], (u - start) / (end - start))


def poses(curves: Curves, u: float) -> tuple[FloatArray, FloatArray]:
    """Return tool tips [m] and unit tool axes of corners at one u, shape (n, 3) each [Eq. 5]."""
    tip = spline_points(curves.bottom, u)
    if curves.parametrization.shape[1]:
        tool = spline_points(curves.top, top_parameters(curves.parametrization, u)) - tip
    else:
        tool = spline_points(curves.top, u) - tip
    degree = curves.connection.shape[1] - 1
    for i in range(1, degree):  # Bernstein polynomials; the ends of E are zero
        tool += comb(degree, i) * u**i * (1.0 - u) ** (degree - i) * curves.connection[:, i]
    return tip, tool / norm(tool)[:, None]


def end_derivatives(points: FloatArray) -> FloatArray:
    """
    Return C', C'', C''' of corner splines at u = 0 [A.2].

    Parameters
    ----------
    points : ndarray, shape (n, 5, 3)
        Control points, counted from the end in question.

    Returns
    -------
    ndarray, shape (3, n, 3)

    """
    p0, p1, p2, p3 = (points[:, i] for i in range(4))
    return np.stack(
        [
            6.0 * (p1 - p0),
            24.0 * p0 - 36.0 * p1 + 12.0 * p2,
            -48.0 * p0 + 84.0 * p1 - 48.0 * p2 + 12.0 * p3,
        ]
    )
