"""PathSegments: the smooth path in the workpiece frame (from smoothing to kinematics)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import sqrt

import numpy as np
from numba import njit

from cnc_interp import jet
from cnc_interp.program.blocks import BoolArray, FloatArray, IntArray

LINE, CORNER, ROTATION = 0, 1, 2


@dataclass(frozen=True)
class PathSegments:
    """
    Smooth segments in path order, one row per segment, parameter u in [0, 1].

    A ``LINE`` goes straight from ``bottom[0]`` to ``bottom[1]`` while the tool axis turns on a
    great circle at constant rate [B2013, Eq. 4]. A ``CORNER`` is the pair of cubic B-splines of
    [B2013, section 2.3] with knots (0 0 0 0 .5 1 1 1 1): the tip runs on ``bottom``, the tool
    axis is the direction of ``top(u) + connection(u) - bottom(u)`` (Eq. 5 with the connection of
    ``orientation.py``). A ``ROTATION`` turns the tool about the resting tip ``bottom[0]``.

    Parameters
    ----------
    kind : ndarray of int, shape (n,)
        LINE, CORNER or ROTATION.
    bottom, top : ndarray, shape (n, 5, 3)
        Control points of bottom and top curve [m]; lines use the first two (start and end).
    connection : ndarray, shape (n, m, 3)
        Bezier points over [0, 1] added to the top curve of a corner [m].
    axis : ndarray, shape (n, 3)
        Unit tool axis at the start of the segment [-].
    rotation : ndarray, shape (n, 3)
        Rotation vector that the tool axis runs through on lines and in rotations [rad].
    rotary : ndarray, shape (n, 2, 2)
        Programmed rotary axes at start and end, NaN where not programmed [rad].
    length : ndarray, shape (n,)
        Length of lines; flank height times angle of rotations; NaN for corners [m].
    feed : ndarray, shape (n, 2)
        Programmed ds/dt in the first and second half (the two blocks of a corner) [m/s].
    block : ndarray of int, shape (n, 2)
        Rows of the blocks executed in the first and second half.
    line_number : ndarray of int, shape (n,)
        Line of the second block in the part program.
    stop : ndarray of bool, shape (n,)
        True where the tool rests at the end of the segment.
    deviation : ndarray, shape (n, 2)
        Contour and orientation deviation of corners, 0 elsewhere [m].

    """

    kind: IntArray
    bottom: FloatArray
    top: FloatArray
    connection: FloatArray
    axis: FloatArray
    rotation: FloatArray
    rotary: FloatArray
    length: FloatArray
    feed: FloatArray
    block: IntArray
    line_number: IntArray
    stop: BoolArray
    deviation: FloatArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    def __len__(self) -> int:
        """Count the segments."""
        return len(self.kind)

    def __getitem__(self, rows: slice | IntArray) -> PathSegments:
        """Take some of the segments."""
        return PathSegments(*(getattr(self, field.name)[rows] for field in fields(self)))

    @staticmethod
    def concatenate(parts: list[PathSegments]) -> PathSegments:
        """Join batches end to end."""
        names = [field.name for field in fields(PathSegments)]
        return PathSegments(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


@njit(cache=True, inline='always')
def spline_component(points, i, u, second_half):  # type: ignore[no-untyped-def]
    """
    Return the jet of one coordinate of the corner's cubic B-spline [B2013, Eq. 1 and A.2].

    ``second_half`` chooses the polynomial piece, so that at u = 0.5 each side can be asked for.
    """
    if second_half:  # the curve read backwards is the same construction
        p0, p1, p2, p3 = points[4, i], points[3, i], points[2, i], points[1, i]
        x, sign = 1.0 - u, -1.0
    else:
        p0, p1, p2, p3 = points[0, i], points[1, i], points[2, i], points[3, i]
        x, sign = u, 1.0
    # (1-2x)^3 p0 + 2x(3 - 9x + 7x^2) p1 + 2x^2(3 - 4x) p2 + 2x^3 p3, in powers of x
    a1 = 6.0 * (p1 - p0)
    a2 = 12.0 * p0 - 18.0 * p1 + 6.0 * p2
    a3 = -8.0 * p0 + 14.0 * p1 - 8.0 * p2 + 2.0 * p3
    return (
        p0 + x * (a1 + x * (a2 + x * a3)),
        sign * (a1 + x * (2.0 * a2 + 3.0 * x * a3)),
        a2 + 3.0 * x * a3,
        sign * a3,
    )


@njit(cache=True, inline='always')
def bezier_component(points, i, u):  # type: ignore[no-untyped-def]
    """Return the jet of one coordinate of a Bezier curve by blossoming de Casteljau's scheme."""
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
    return (
        work[0],
        p * d1,
        p * (p - 1.0) * d2 / 2.0,
        p * (p - 1.0) * (p - 2.0) * d3 / 6.0,
    )


@njit(cache=True)
def corner_jets(bottom, top, connection, u, second_half):  # type: ignore[no-untyped-def]
    """Return the vector jets, in u, of tool tip and tool axis of a corner [B2013, Eq. 5]."""
    px = spline_component(bottom, 0, u, second_half)
    py = spline_component(bottom, 1, u, second_half)
    pz = spline_component(bottom, 2, u, second_half)
    tx = spline_component(top, 0, u, second_half)
    ty = spline_component(top, 1, u, second_half)
    tz = spline_component(top, 2, u, second_half)
    d = (
        jet.add(jet.subtract(tx, px), bezier_component(connection, 0, u)),
        jet.add(jet.subtract(ty, py), bezier_component(connection, 1, u)),
        jet.add(jet.subtract(tz, pz), bezier_component(connection, 2, u)),
    )
    return (px, py, pz), jet.normalised(d)


@njit(cache=True)
def corner_pose(bottom, top, connection, u):  # type: ignore[no-untyped-def]
    """Return tool tip [m] and tool axis [-] of a corner, shape (3,) each [B2013, Eq. 5, A.2]."""
    late = u > 0.5
    x = 1.0 - u if late else u
    basis = (
        (1.0 - 2.0 * x) ** 3,
        2.0 * x * (3.0 + x * (7.0 * x - 9.0)),
        2.0 * x * x * (3.0 - 4.0 * x),
        2.0 * x**3,
    )
    tip, tool = np.zeros(3), np.zeros(3)
    for i in range(4):
        k = 4 - i if late else i
        tip += basis[i] * bottom[k]
        tool += basis[i] * (top[k] - bottom[k])
    degree = connection.shape[0] - 1
    share, choose = (1.0 - u) ** degree, 1.0
    for i in range(degree + 1):  # Bernstein polynomials, 0 < u < 1
        tool += choose * share * connection[i]
        choose *= (degree - i) / (i + 1.0)
        share *= u / (1.0 - u)
    return tip, tool / sqrt((tool**2).sum())


@njit(cache=True)
def great_circle_jets(axis, rotation, u):  # type: ignore[no-untyped-def]
    """Return the jet in u of the axis turned by u times the rotation vector [B2013, Eq. 4]."""
    o = (jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2]))
    angle = sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    if angle == 0.0:
        return o
    k = (rotation[0] / angle, rotation[1] / angle, rotation[2] / angle)
    sine, cosine = jet.sine_cosine((angle * u, angle, 0.0, 0.0))
    return jet.rotated(k, sine, cosine, o)


@njit(cache=True)
def line_jets(bottom, axis, rotation, u):  # type: ignore[no-untyped-def]
    """Return the vector jets, in u, of tool tip and tool axis of a line."""
    dx, dy, dz = (
        bottom[1, 0] - bottom[0, 0],
        bottom[1, 1] - bottom[0, 1],
        bottom[1, 2] - bottom[0, 2],
    )
    p = (
        (bottom[0, 0] + u * dx, dx, 0.0, 0.0),
        (bottom[0, 1] + u * dy, dy, 0.0, 0.0),
        (bottom[0, 2] + u * dz, dz, 0.0, 0.0),
    )
    return p, great_circle_jets(axis, rotation, u)
