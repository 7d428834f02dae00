"""PathSegments: the smooth path in the workpiece frame (from smoothing to kinematics)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import sqrt

import numpy as np
from numba import njit

from cnc_interp.core import jet
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray

LINE, CORNER, ROTATION, SPLINE = 0, 1, 2, 3
#: Control points that a segment has room for: a line uses 2, a corner 5, a spline all 6.
POINTS = 6


@dataclass(frozen=True)
class PathSegments:
    """
    Smooth segments in path order, one row per segment, parameter u in [0, 1].

    A ``LINE`` goes straight from ``bottom[0]`` to ``bottom[1]`` while the tool axis turns on a
    great circle at constant rate [B2013, Eq. 4]. A ``CORNER`` is the pair of cubic B-splines of
    [B2013, section 2.3] with knots (0 0 0 0 .5 1 1 1 1): the tip runs on ``bottom``, the tool
    axis is the direction of ``top(f(u)) + connection(u) - bottom(u)`` (Eq. 5 with parametrization
    f and connection of ``connection.py``). A ``ROTATION`` turns the tool about the resting tip
    ``bottom[0]``. A ``SPLINE`` is one polynomial span of a 5-axis curve: the tip runs on the
    quintic Bezier curve ``bottom``, the tool axis is the direction of ``top(u) + connection(u)
    - bottom(u)`` with the quintic Bezier curve ``top``.

    Parameters
    ----------
    kind : ndarray of int, shape (n,)
        LINE, CORNER, ROTATION or SPLINE.
    bottom, top : ndarray, shape (n, 6, 3)
        Control points of bottom and top curve [m]; lines use the first two (start and end),
        corners the first five.
    connection : ndarray, shape (n, m, 3)
        Bezier points over [0, 1] added to the top curve of a corner or spline [m].
    parametrization : ndarray, shape (n, spans, 8)
        u_top = f(u) of corners, span by span: start of the span, then the seven Bezier values of
        a sextic on it; no spans where f(u) = u everywhere [-].
    axis : ndarray, shape (n, 3)
        Unit tool axis at the start of the segment [-].
    rotation : ndarray, shape (n, 3)
        Rotation vector that the tool axis runs through on lines and in rotations [rad].
    rotary : ndarray, shape (n, 2, 2)
        Programmed rotary axes at start and end, NaN where not programmed [rad].
    length : ndarray, shape (n,)
        Length of lines; flank height times angle of rotations; NaN for curves [m].
    feed : ndarray, shape (n, 2)
        Programmed ds/dt in the first and second half (the two blocks of a corner) [m/s].
    block : ndarray of int, shape (n, 2)
        Rows of the blocks executed in the first and second half.
    line_number : ndarray of int, shape (n,)
        Line of the second block in the part program.
    stop : ndarray of bool, shape (n,)
        True where the tool rests at the end of the segment.
    deviation : ndarray, shape (n, 2)
        Contour and orientation deviation of curves, 0 elsewhere [m].

    """

    kind: IntArray
    bottom: FloatArray
    top: FloatArray
    connection: FloatArray
    parametrization: FloatArray
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


def room_for(points: FloatArray) -> FloatArray:
    """Return control points, shape (n, k, 3), with room up to POINTS of them."""
    spare = np.zeros((len(points), POINTS - points.shape[1], 3))
    return np.concatenate([points, spare], axis=1)


@njit(cache=True, nogil=True, inline='always')
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


@njit(cache=True, nogil=True, inline='always')
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


@njit(cache=True, nogil=True, inline='always')
def quintic_component(points, i, u):  # type: ignore[no-untyped-def]
    """Return the jet of one coordinate of a quintic Bezier curve, in powers of u."""
    p0, p1, p2, p3, p4, p5 = (
        points[0, i], points[1, i], points[2, i], points[3, i], points[4, i], points[5, i],
    )  # fmt: skip
    d1, d2, d3, d4, d5 = p1 - p0, p2 - p1, p3 - p2, p4 - p3, p5 - p4
    a1 = 5.0 * d1
    d1, d2, d3, d4 = d2 - d1, d3 - d2, d4 - d3, d5 - d4
    a2 = 10.0 * d1
    d1, d2, d3 = d2 - d1, d3 - d2, d4 - d3
    a3 = 10.0 * d1
    d1, d2 = d2 - d1, d3 - d2
    a4, a5 = 5.0 * d1, d2 - d1
    return (
        p0 + u * (a1 + u * (a2 + u * (a3 + u * (a4 + u * a5)))),
        a1 + u * (2.0 * a2 + u * (3.0 * a3 + u * (4.0 * a4 + 5.0 * u * a5))),
        a2 + u * (3.0 * a3 + u * (6.0 * a4 + 10.0 * u * a5)),
        a3 + u * (4.0 * a4 + 10.0 * u * a5),
    )


@njit(cache=True, nogil=True)
def spline_jets(bottom, top, connection, u):  # type: ignore[no-untyped-def]
    """Return the vector jets, in u, of tool tip and tool axis of a spline [B2013, Eq. 5]."""
    tip, tool = np.empty((3, 4)), np.empty((3, 4))
    for i in range(3):
        p = quintic_component(bottom, i, u)
        d = jet.subtract(quintic_component(top, i, u), p)
        d = jet.add(d, bezier_component(connection, i, u))
        tip[i, 0], tip[i, 1], tip[i, 2], tip[i, 3] = p
        tool[i, 0], tool[i, 1], tool[i, 2], tool[i, 3] = d
    return vector_jet(tip), jet.normalised(vector_jet(tool))


@njit(cache=True, nogil=True)
def span_at(parametrization, u):  # type: ignore[no-untyped-def]
    """Return number, start and length of the span of f in which u lies."""
    k = parametrization.shape[0] - 1
    while k > 0 and parametrization[k, 0] > u:
        k -= 1
    end = parametrization[k + 1, 0] if k + 1 < parametrization.shape[0] else 1.0
    return k, parametrization[k, 0], end - parametrization[k, 0]


@njit(cache=True, nogil=True)
def top_parameter(parametrization, u, inside):  # type: ignore[no-untyped-def]
    """Return the jet of u_top = f(u), on the span in which ``inside`` lies."""
    if parametrization.shape[0] == 0:
        return (u, 1.0, 0.0, 0.0)
    k, start, length = span_at(parametrization, inside)
    f = bezier_component(parametrization[k, 1:].copy().reshape(7, 1), 0, (u - start) / length)
    return (f[0], f[1] / length, f[2] / length**2, f[3] / length**3)


@njit(cache=True, nogil=True)
def corner_breaks(parametrization):  # type: ignore[no-untyped-def]
    """Return the parameters, from 0 to 1, where a corner's third derivative may jump."""
    spans = parametrization.shape[0]
    if spans == 0:
        return np.array([0.0, 0.5, 1.0])
    low, high = 0.0, 1.0
    for _ in range(60):  # f rises: where the top curve passes its own knot
        middle = 0.5 * (low + high)
        if top_parameter(parametrization, middle, middle)[0] < 0.5:
            low = middle
        else:
            high = middle
    if abs(low - 0.5) < 1e-9:
        low = 0.5
    return np.unique(np.concatenate((parametrization[:, 0], np.array([0.5, low, 1.0]))))


@njit(cache=True, nogil=True)
def corner_jets(bottom, top, connection, parametrization, u, inside):  # type: ignore[no-untyped-def]
    """
    Return the vector jets, in u, of tool tip and tool axis of a corner [B2013, Eq. 5].

    Where u lies on a break, ``inside`` tells from which side: it lies in the same piece.
    """
    late = late_top = inside > 0.5
    f = top_parameter(parametrization, u, inside)
    if parametrization.shape[0] > 0:
        late_top = top_parameter(parametrization, inside, inside)[0] > 0.5
    tip, tool = np.empty((3, 4)), np.empty((3, 4))
    for i in range(3):
        p = spline_component(bottom, i, u, late)
        t = jet.compose(spline_component(top, i, f[0], late_top), f)
        d = jet.add(jet.subtract(t, p), bezier_component(connection, i, u))
        tip[i, 0], tip[i, 1], tip[i, 2], tip[i, 3] = p
        tool[i, 0], tool[i, 1], tool[i, 2], tool[i, 3] = d
    return vector_jet(tip), jet.normalised(vector_jet(tool))


@njit(cache=True, nogil=True)
def vector_jet(rows):  # type: ignore[no-untyped-def]
    """Return three jets, shape (3, 4), as a vector jet."""
    return (
        (rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3]),
        (rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3]),
        (rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3]),
    )


@njit(cache=True, nogil=True)
def great_circle_jets(axis, rotation, u):  # type: ignore[no-untyped-def]
    """Return the jet in u of the axis turned by u times the rotation vector [B2013, Eq. 4]."""
    o = (jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2]))
    angle = sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    if angle == 0.0:
        return o
    k = (rotation[0] / angle, rotation[1] / angle, rotation[2] / angle)
    sine, cosine = jet.sine_cosine((angle * u, angle, 0.0, 0.0))
    return jet.rotated(k, sine, cosine, o)


@njit(cache=True, nogil=True)
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
