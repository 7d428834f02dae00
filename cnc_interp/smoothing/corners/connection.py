"""Smooth connection of the orientation on corners and lines [B2013, sections 2.5-3.3, Appendix B].

The tool axis on a corner is the direction of D(u) = C_top(f(u)) + E(u) - C_bottom(u). At both ends
it must continue the tool axis o(s) of the line, together with its derivatives. So D = rho o(s(u))
to that order, where the length rho of D is free. There are three methods:

``exact``   If both polygons are divided in the same ratio, f(u) = u is right to first order and
            rho = h. Otherwise f' and f'' follow from the component along the top curve, and rho
            from the component along the tool axis. The remaining difference of the first two
            derivatives (three with the septic) becomes the end condition of the Hermite
            polynomial E, which is zero at both ends. Tip and axis are then C2 (C3).
``linear``  f(u) = u and E = 0. Industrial controls do this by default; [B2013] compares with it.
``paper``   Newton's method on the discrete third derivative of the axis (Eq. 11); see
            ``paper_parametrization.py``.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import comb

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, cross, dot, norm
from cnc_interp.core.bspline import bezier_values, corner_end_derivatives, corner_spline_points


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


def connect(curves: Curves, height: float, axes: FloatArray, rates: FloatArray) -> None:
    """Compute E and f of corners in place (``exact``), so that tip and axis are smooth."""
    ends = (
        End(curves.bottom, curves.top, height, axes[:, 0], rates[:, 0]),
        End(curves.bottom[:, ::-1], curves.top[:, ::-1], height, axes[:, 1], -rates[:, 1]),
    )
    n = len(axes)
    slides = np.zeros(n, dtype=bool)
    slopes = [np.stack([np.ones(n), np.zeros(n), np.zeros(n)]) for _ in ends]
    if curves.parametrization.shape[1]:
        found = [end.slopes() for end in ends]
        values = _sextic(*found)
        slides = np.diff(values, axis=1).min(axis=1) > 0.0
        # If f would not increase, because the top curve hardly moves, f(u) = u and E does all.
        values = np.where(slides[:, None], values, np.arange(7) / 6.0)
        curves.parametrization[:, 0, 1:] = values
        for slope, f, b in zip(slopes, found, (values, 1.0 - values[:, ::-1]), strict=True):
            third = 120.0 * (b[:, 3] - 3.0 * b[:, 2] + 3.0 * b[:, 1] - b[:, 0])
            slope[:] = np.where(slides, np.stack([*f, third]), slope)
    first, last = (end.residuals(f, slides) for end, f in zip(ends, slopes, strict=True))
    curves.connection[:] = hermite(first, last, curves.connection.shape[1])


class End:
    """One end of many corners; derivatives are taken from the end towards the corner.

    On the line o_s = w k x o, o_ss = -w^2 o and o_sss = -w^2 o_s [B2013, Eq. 4]. s(u) is the arc
    length of the bottom curve.
    """

    def __init__(
        self,
        bottom: FloatArray,
        top: FloatArray,
        height: float,
        axis: FloatArray,
        rate: FloatArray,
    ):
        self.height, self.axis = height, axis
        self.b, self.c = corner_end_derivatives(bottom), corner_end_derivatives(top)
        s1 = norm(self.b[0])[:, None]
        tangent = self.b[0] / s1
        s2, s3 = dot(self.b[1], tangent)[:, None], dot(self.b[2], tangent)[:, None]
        turn, square = cross(rate, axis), dot(rate, rate)[:, None]
        self.o = np.stack(
            [
                turn * s1,
                -square * axis * s1**2 + turn * s2,
                -square * (turn * s1**3 + 3.0 * axis * s1 * s2) + turn * s3,
            ]
        )

    def slopes(self) -> tuple[FloatArray, FloatArray]:
        """Return f' and f'' that make D' and D'' along the top curve those of the line."""
        rho = np.full((len(self.axis), 1), self.height)
        return matching_slopes(self.b, self.c, self.axis, self.o, rho)[:2]

    def residuals(self, f: FloatArray, free_length: BoolArray) -> FloatArray:
        """Return the first three derivatives by u of rho o - D; D is top minus bottom curve."""
        b, c, o, h = self.b, self.c, self.o, self.height
        f1, f2, f3 = f[:, :, None]
        d1 = c[0] * f1 - b[0]
        d2 = c[1] * f1**2 + c[0] * f2 - b[1]
        d3 = c[2] * f1**3 + 3.0 * c[1] * f1 * f2 + c[0] * f3 - b[2]
        return lacking((d1, d2, d3), self.axis, o, h, free_length)


def lacking(
    d: tuple[FloatArray, FloatArray, FloatArray],
    axis: FloatArray,
    turning: FloatArray,
    rho: FloatArray | float,
    free: BoolArray | bool = True,
) -> FloatArray:
    """Return the first three derivatives of rho o - D [m]; rho follows D where it is free."""
    d1, d2, d3 = d
    o1, o2, o3 = turning
    free = np.asarray(free)[..., None]
    rho1 = np.where(free, dot(d1, axis)[:, None], 0.0)
    rho2 = np.where(free, dot(d2 - rho * o2, axis)[:, None], 0.0)
    rho3 = np.where(free, dot(d3 - 3.0 * rho1 * o2 - rho * o3, axis)[:, None], 0.0)
    return np.stack(
        [
            rho1 * axis + rho * o1 - d1,
            rho2 * axis + 2.0 * rho1 * o1 + rho * o2 - d2,
            rho3 * axis + 3.0 * rho2 * o1 + 3.0 * rho1 * o2 + rho * o3 - d3,
        ]
    )


def matching_slopes(
    bottom: FloatArray, top: FloatArray, axis: FloatArray, turning: FloatArray, rho: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives of f with which the tool axis continues smoothly from the line.

    D = C_top(f(u)) - C_bottom(u) must be rho o(u) in each order [B2013, B.3-B.5]. The highest
    derivative of f acts along C_top' only. So this derivative follows from the component e of
    C_top' at right angles to o; rho follows from the component along o. No other f leaves a
    smaller jump of the tool axis's derivatives.
    """
    b, c, o = bottom, top, turning
    e = c[0] - dot(c[0], axis)[:, None] * axis
    reach = dot(c[0], e)
    moving = reach > 1e-12 * rho[:, 0] ** 2
    reach = np.where(moving, reach, 1.0)
    f1 = np.where(moving, dot(b[0] + rho * o[0], e) / reach, 1.0)
    p = f1[:, None]
    rho1 = dot(p * c[0] - b[0], axis)[:, None]
    rest = b[1] - p**2 * c[1] + 2.0 * rho1 * o[0] + rho * o[1]
    f2 = np.where(moving, dot(rest, e) / reach, 0.0)
    q = f2[:, None]
    rho2 = dot(p**2 * c[1] + q * c[0] - b[1] - rho * o[1], axis)[:, None]
    rest = b[2] - p**3 * c[2] - 3.0 * p * q * c[1]
    rest = rest + 3.0 * rho2 * o[0] + 3.0 * rho1 * o[1] + rho * o[2]
    return f1, f2, np.where(moving, dot(rest, e) / reach, 0.0)


def _sextic(
    first: tuple[FloatArray, FloatArray], last: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """Return the Bezier values of f, (n, 7), with f(0.5) = 0.5, so that inner knots coincide."""
    f1, f2 = first
    g1, g2 = last
    b1, b5 = f1 / 6.0, 1.0 - g1 / 6.0
    b2, b4 = f1 / 3.0 + f2 / 30.0, 1.0 - g1 / 3.0 - g2 / 30.0
    b3 = (32.0 - (6.0 * b1 + 15.0 * b2 + 15.0 * b4 + 6.0 * b5 + 1.0)) / 20.0
    return np.stack([np.zeros_like(b1), b1, b2, b3, b4, b5, np.ones_like(b1)], axis=1)


def hermite(first: FloatArray, last: FloatArray, points: int) -> FloatArray:
    """Return the Bezier points of E: zero at both ends, with given derivatives there."""
    degree = points - 1
    found = np.zeros((first.shape[1], points, 3))
    for end, values in ((first, found), (last, found[:, ::-1])):
        values[:, 1] = end[0] / degree
        values[:, 2] = 2.0 * values[:, 1] + end[1] / (degree * (degree - 1))
        if degree == 7:
            values[:, 3] = 3.0 * values[:, 2] - 3.0 * values[:, 1] + end[2] / 210.0
    return found
