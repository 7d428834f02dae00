"""
Smooth orientation connection of corners to their lines [B2013, sections 2.5-3.3, Appendix B].

The axis of a corner is the direction of D(u) = C_top(f(u)) + E(u) - C_bottom(u). At both ends it
must continue that of the line, rho o(s(u)) with a length rho of its own, and its derivatives.
Three ways:

``exact``   Where the top polygon is divided like the bottom one, f(u) = u is right to first order
            and rho = h. Otherwise f' and f'' follow, order by order, from the component along the
            top curve, and rho from the one along the axis. What is left of the first derivatives
            (two with the quintic, three with the septic) is the end condition of the Hermite
            polynomial E, zero at both ends. Tip and axis are then C2 (C3) for any walls.
``linear``  f(u) = u and no E: the default of industrial controls, the paper's bad example.
``paper``   Three first and three last values of f, found one after the other by Newton's method
            on the discrete third derivative of the axis (Eq. 11), joined by a cubic spline.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.corners.corner_curves import Curves, end_derivatives, spline_points
from cnc_interp.smoothing.orientation import cross, dot, norm, turned_by

#: Step of the paper's discrete derivative, in bottom parameter (the paper does not state one).
PAPER_STEP = 0.02


def connect(
    curves: Curves, height: float, axes: FloatArray, rates: FloatArray, method: str
) -> None:
    """
    Fill connection E and parametrization f of corners.

    Parameters
    ----------
    curves : Curves
        Bottom and top are given; a sextic f is fitted where there is room for one span.
    height : float
        Flank height h [m].
    axes : ndarray, shape (n, 2, 3)
        Programmed tool axis at entry and exit [-].
    rates : ndarray, shape (n, 2, 3)
        Rotation vector per metre of path on the lines before and after [rad/m].
    method : {'exact', 'linear', 'paper'}
        How.

    """
    if method == 'paper':
        curves.parametrization[:] = paper_spans(curves, axes, rates)
    if method != 'exact':
        return
    ends = (
        End(curves.bottom, curves.top, height, axes[:, 0], rates[:, 0]),
        End(curves.bottom[:, ::-1], curves.top[:, ::-1], height, axes[:, 1], -rates[:, 1]),
    )
    n = len(axes)
    slides = np.zeros(n, dtype=bool)
    slopes = [np.stack([np.ones(n), np.zeros(n), np.zeros(n)]) for _ in ends]
    if curves.parametrization.shape[1]:
        found = [end.slopes() for end in ends]
        values = sextic(*found)
        slides = np.diff(values, axis=1).min(axis=1) > 0.0
        # Where the top curve hardly moves, or backwards, f stays u and E does everything.
        values = np.where(slides[:, None], values, np.arange(7) / 6.0)
        curves.parametrization[:, 0, 1:] = values
        for slope, f, b in zip(slopes, found, (values, 1.0 - values[:, ::-1]), strict=True):
            third = 120.0 * (b[:, 3] - 3.0 * b[:, 2] + 3.0 * b[:, 1] - b[:, 0])
            slope[:] = np.where(slides, np.stack([*f, third]), slope)
    first, last = (end.residuals(f, slides) for end, f in zip(ends, slopes, strict=True))
    curves.connection[:] = hermite(first, last, curves.connection.shape[1])


class End:
    """
    One end of many corners, seen inward: its curves, and how the line's axis goes on.

    On the line o_s = w k x o, o_ss = -w^2 o, o_sss = -w^2 o_s; s(u) is the bottom's arc length.

    Parameters
    ----------
    bottom, top : ndarray, shape (n, 5, 3)
        Control points, counted from this end [m].
    height : float
        Flank height [m].
    axis, rate : ndarray, shape (n, 3)
        Tool axis here [-], and the line's rotation vector per metre inward [rad/m].

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
        self.b, self.c = end_derivatives(bottom), end_derivatives(top)
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
        """Return f' and f'', shape (n,): D' and D'' along the top curve are those of the line."""
        b, c, o, h = self.b, self.c, self.o, self.height
        e = c[0] - dot(c[0], self.axis)[:, None] * self.axis
        reach = dot(c[0], e)
        moving = reach > 1e-12 * h * h
        reach = np.where(moving, reach, 1.0)
        f1 = np.where(moving, dot(b[0] + h * o[0], e) / reach, 1.0)
        rho1 = dot(f1[:, None] * c[0] - b[0], self.axis)[:, None]
        rest = b[1] - (f1**2)[:, None] * c[1] + 2.0 * rho1 * o[0] + h * o[1]
        return f1, np.where(moving, dot(rest, e) / reach, 0.0)

    def residuals(self, f: FloatArray, free_length: FloatArray) -> FloatArray:
        """
        Return what D lacks here: (rho o - D)', '' and ''', shape (3, n, 3).

        ``f`` holds f', f'', f''', shape (3, n); with ``free_length`` rho follows D, else rho = h.
        """
        b, c, o, h = self.b, self.c, self.o, self.height
        f1, f2, f3 = f[:, :, None]
        d1 = c[0] * f1 - b[0]
        d2 = c[1] * f1**2 + c[0] * f2 - b[1]
        d3 = c[2] * f1**3 + 3.0 * c[1] * f1 * f2 + c[0] * f3 - b[2]
        free = free_length[:, None]
        rho1 = np.where(free, dot(d1, self.axis)[:, None], 0.0)
        rho2 = np.where(free, dot(d2 - h * o[1], self.axis)[:, None], 0.0)
        rho3 = dot(d3 - 3.0 * rho1 * o[1] - h * o[2], self.axis)[:, None]
        rho3 = np.where(free, rho3, 0.0)
        return np.stack(
            [
                rho1 * self.axis + h * o[0] - d1,
                rho2 * self.axis + 2.0 * rho1 * o[0] + h * o[1] - d2,
                rho3 * self.axis + 3.0 * rho2 * o[0] + 3.0 * rho1 * o[1] + h * o[2] - d3,
            ]
        )


def sextic(
    first: tuple[FloatArray, FloatArray], last: tuple[FloatArray, FloatArray]
) -> FloatArray:
    """
    Return the Bezier values of f, shape (n, 7), with f(0.5) = 0.5.

    So the knots of both curves coincide. ``first`` has f' and f'' at u = 0, ``last`` the
    derivatives of 1 - f counted backwards from u = 1.
    """
    f1, f2 = first
    g1, g2 = last
    b1, b5 = f1 / 6.0, 1.0 - g1 / 6.0
    b2, b4 = f1 / 3.0 + f2 / 30.0, 1.0 - g1 / 3.0 - g2 / 30.0
    b3 = (32.0 - (6.0 * b1 + 15.0 * b2 + 15.0 * b4 + 6.0 * b5 + 1.0)) / 20.0
    return np.stack([np.zeros_like(b1), b1, b2, b3, b4, b5, np.ones_like(b1)], axis=1)


def hermite(first: FloatArray, last: FloatArray, points: int) -> FloatArray:
    """
    Return the Bezier points of E, zero at both ends with given derivatives there.

    Parameters
    ----------
    first, last : ndarray, shape (3, n, 3)
        E', E'', E''' at u = 0, and counted backwards from u = 1 [m].
    points : int
        6 for the quintic (two derivatives), 8 for the septic (three).

    Returns
    -------
    ndarray, shape (n, points, 3)

    """
    degree = points - 1
    found = np.zeros((first.shape[1], points, 3))
    for end, values in ((first, found), (last, found[:, ::-1])):
        values[:, 1] = end[0] / degree
        values[:, 2] = 2.0 * values[:, 1] + end[1] / (degree * (degree - 1))
        if degree == 7:
            values[:, 3] = 3.0 * values[:, 2] - 3.0 * values[:, 1] + end[2] / 210.0
    return found


def first_values(
    bottom: FloatArray, top: FloatArray, axis: FloatArray, rate: FloatArray
) -> FloatArray:
    """
    Return the paper's first three values of u_top, shape (3, n) [section 3.3, Eq. 11].

    The bottom points are ``PAPER_STEP`` apart in u; before the corner the axis is the line's at
    the same steps of arc length. Gauss-Newton: the third difference is almost linear in u_top.
    """
    n = len(axis)
    speed = norm(end_derivatives(bottom)[0])
    before = [turned_by(axis, rate, (k - 2) * PAPER_STEP * speed) for k in range(3)]
    values = np.empty((3, n))

    def tool_at(u: FloatArray, point: FloatArray) -> FloatArray:
        tool = spline_points(top, u) - point
        return np.asarray(tool / norm(tool)[:, None])

    for k in range(3):
        u = np.full(n, (k + 1) * PAPER_STEP)
        point = spline_points(bottom, u)
        expected = 3.0 * before[2] - 3.0 * before[1] + before[0]
        step = 1e-6
        for _ in range(8):
            slope = (tool_at(u + step, point) - tool_at(u - step, point)) / (2.0 * step)
            square = dot(slope, slope)
            change = dot(slope, tool_at(u, point) - expected)
            u = u - np.where(square > 0.0, change / np.where(square > 0.0, square, 1.0), 0.0)
        values[k] = u
        before = [*before[1:], tool_at(u, point)]
    return values


def paper_spans(curves: Curves, axes: FloatArray, rates: FloatArray) -> FloatArray:
    """Return f through the paper's six points by a cubic spline, shape (n, 7, 8)."""
    steps = PAPER_STEP * np.arange(1, 4)
    x = np.concatenate([[0.0], steps, 1.0 - steps[::-1], [1.0]])
    first = first_values(curves.bottom, curves.top, axes[:, 0], rates[:, 0])
    last = first_values(curves.bottom[:, ::-1], curves.top[:, ::-1], axes[:, 1], -rates[:, 1])
    n = len(axes)
    y = np.concatenate([np.zeros((1, n)), first, 1.0 - last[::-1], np.ones((1, n))]).T
    h = np.diff(x)
    system = np.zeros((8, 8))  # for the second derivatives; not a knot at both ends
    system[0, :3] = h[1], -h[0] - h[1], h[0]
    system[7, 5:] = h[6], -h[5] - h[6], h[5]
    for i in range(1, 7):
        system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
    right = np.zeros((n, 8))
    right[:, 1:7] = 6.0 * np.diff(np.diff(y, axis=1) / h, axis=1)
    bend = np.linalg.solve(system, right.T).T
    slope = np.diff(y, axis=1) / h - h * (2.0 * bend[:, :-1] + bend[:, 1:]) / 6.0
    b1 = y[:, :-1] + slope * h / 3.0
    b2 = 2.0 * b1 - y[:, :-1] + bend[:, :-1] * h**2 / 6.0
    values = np.stack([y[:, :-1], b1, b2, y[:, 1:]], axis=2)
    for degree in range(3, 6):  # a cubic's Bezier values as those of a sextic
        share = np.arange(1, degree + 1) / (degree + 1.0)
        inside = share * values[..., :-1] + (1.0 - share) * values[..., 1:]
        values = np.concatenate([values[..., :1], inside, values[..., -1:]], axis=2)
    return np.concatenate([np.broadcast_to(x[:-1, None], (n, 7, 1)), values], axis=2)
