"""The curves of many corners, and poses on them."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.bezier import bezier_values
from cnc_interp.core.corner_spline import corner_spline_points
from cnc_interp.smoothing.orientation import norm


@dataclass
class Curves:
    """The curves of n corners, with the same arrays as PathSegments."""

    #: (n, 5, 3): Control points of bottom and top curve [m].
    bottom: FloatArray
    top: FloatArray
    connection: FloatArray  #: (n, m, 3): Bezier points of the connection E [m].
    parametrization: FloatArray  #: (n, spans, 8): Spans of u_top = f(u); no spans if f(u) = u [-].

    @staticmethod
    def empty(count: int, points: int, spans: int) -> Curves:
        return Curves(
            np.zeros((count, 5, 3)),
            np.zeros((count, 5, 3)),
            np.zeros((count, points, 3)),
            np.zeros((count, spans, 8)),
        )

    def put(self, rows: IntArray, other: Curves) -> None:
        """Replace the corners at some rows."""
        self.bottom[rows], self.top[rows] = other.bottom, other.top
        self.connection[rows] = other.connection
        self.parametrization[rows] = other.parametrization


def top_parameters(parametrization: FloatArray, u: float) -> FloatArray:
    """Return u_top = f(u) of many corners at one u, shape (n,) [-]."""
    n, spans = parametrization.shape[:2]
    if spans == 0:
        return np.full(n, u)
    starts = parametrization[..., 0]
    k = np.maximum((starts <= u).sum(axis=1) - 1, 0)
    rows = np.arange(n)
    start = starts[rows, k]
    end = np.where(k + 1 < spans, starts[rows, np.minimum(k + 1, spans - 1)], 1.0)
    return bezier_values(parametrization[rows, k, 1:], (u - start) / (end - start))


def poses(curves: Curves, u: float) -> tuple[FloatArray, FloatArray]:
    """Return tool tips and unit tool axes of corners at one parameter, (n, 3) [B2013, Eq. 5]."""
    tip = corner_spline_points(curves.bottom, u)
    if curves.parametrization.shape[1]:
        at = top_parameters(curves.parametrization, u)
        tool = corner_spline_points(curves.top, at) - tip
    else:
        tool = corner_spline_points(curves.top, u) - tip
    degree = curves.connection.shape[1] - 1
    for i in range(1, degree):  # Bernstein polynomials; E is zero at both ends
        tool += comb(degree, i) * u**i * (1.0 - u) ** (degree - i) * curves.connection[:, i]
    return tip, tool / norm(tool)[:, None]
