"""PathSegments: the smooth path in the workpiece frame, and jets of tip and axis on a segment."""

from __future__ import annotations

from math import sqrt

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, jet
from cnc_interp.core.bspline import bezier_jet, corner_spline_jet, quintic_jet
from cnc_interp.core.jet import Jet, VectorJet
from cnc_interp.core.kernels import njit
from cnc_interp.core.tables import Table, column
from cnc_interp.program.blocks import POSES

LINE, CORNER, ROTATION, SPLINE = 0, 1, 2, 3
#: Number of control points in the arrays: a line uses 2 of them, a corner 5, a spline all 6.
POINTS = 6


class PathSegments(Table):
    """Smooth segments in path order, one row per segment, each with a parameter u in [0, 1].

    ``LINE``: the tip moves straight from ``bottom[0]`` to ``bottom[1]``. The tool axis turns on a
    great circle at a constant rate [B2013, Eq. 4].

    ``CORNER``: a pair of cubic B-splines [B2013, section 2.3] with knots (0 0 0 0 .5 1 1 1 1). The
    tip moves on ``bottom``. The tool axis is the direction of
    ``top(f(u)) + connection(u) - bottom(u)`` (Eq. 5, with f and connection of ``connection.py``).

    ``ROTATION``: the tool axis turns while the tip rests at ``bottom[0]``.

    ``SPLINE``: one polynomial span of a 5-axis curve. The tip moves on the quintic Bezier curve
    ``bottom``. The tool axis is the direction of ``top(u) + connection(u) - bottom(u)`` with the
    quintic Bezier curve ``top``.

    Where ``interpolation`` is ROTARY_LINEAR or AXES_LINEAR, lines and corners have the rotary axes
    as coordinates: ``rotary`` holds their control values, on the same basis as ``bottom``. With
    AXES_LINEAR ``bottom`` is X Y Z of the axes instead of the tip. There is no top curve. The path
    length counts the rotary axes at flank height, and the extra axes, too (``axis_corner.py``).
    """

    kind: IntArray = column()  #: Kind of the segment: LINE, CORNER, ROTATION or SPLINE.
    #: Control points of bottom and top curve [m]. Lines use the first two (start and end),
    #: corners the first five.
    bottom: FloatArray = column(POINTS, 3)
    top: FloatArray = column(POINTS, 3)
    #: Bezier points over [0, 1] that are added to the top curve of a corner or spline [m].
    connection: FloatArray = column('m', 3)
    #: u_top = f(u) of corners, span by span [-]: the start of the span, then the seven Bezier
    #: values of a sextic on it. No spans if f(u) = u.
    parametrization: FloatArray = column('spans', 8)
    axis: FloatArray = column(3)  #: Unit tool axis at the start of the segment [-].
    #: Programmed ds/dt in the first and second half [m/s]; a corner lies in two blocks.
    feed: FloatArray = column(2)
    block: IntArray = column(2)  #: Program rows of the blocks in the first and second half.
    line_number: IntArray = column()  #: Program line of the second block.
    #: Contour and orientation deviation of curves [m], 0 for lines and rotations.
    deviation: FloatArray = column(2)
    #: Rotation vector of the axis over a line or rotation [rad].
    rotation: FloatArray = column(3, default=0.0)
    #: Control values of the rotary axes on the basis of ``bottom`` [rad]. In poses only the first
    #: two are used: the programmed positions at both ends of the block. NaN if there are none.
    rotary: FloatArray = column(POINTS, 2, default=np.nan)
    #: Length of a line; flank height times angle of a rotation, also where the tip hardly moves;
    #: NaN for curves [m].
    length: FloatArray = column(default=np.nan)
    stop: BoolArray = column(default=False)  #: Whether the tool rests at the end of the segment.
    #: Control values of k extra axes on the basis of ``bottom`` [m]: a fourth coordinate of the
    #: path. A rotation uses the first two, like a line.
    extra: FloatArray = column(POINTS, 'k', default=0.0)
    interpolation: IntArray = column(default=POSES)  #: What runs linearly, as in ``Blocks``.
    #: What ``deviation`` leaves of the orientation tolerance [m].
    room: FloatArray = column(default=0.0)


def padded(points: FloatArray) -> FloatArray:
    spare = np.zeros((len(points), POINTS - points.shape[1], 3))
    return np.concatenate([points, spare], axis=1)


def no_rotary(count: int) -> FloatArray:
    """Return the control values of rotary axes that are not programmed, (count, POINTS, 2)."""
    return np.full((count, POINTS, 2), np.nan)


@njit(cache=True, nogil=True)
def spline_jets(
    bottom: FloatArray, top: FloatArray, connection: FloatArray, u: float
) -> tuple[VectorJet, VectorJet]:
    """Return the jets in u of tool tip [m] and unit tool axis on a SPLINE [B2013, Eq. 5]."""
    tip, tool = np.empty((3, 4)), np.empty((3, 4))
    for i in range(3):
        p = quintic_jet(bottom, i, u)
        d = jet.subtract(quintic_jet(top, i, u), p)
        d = jet.add(d, bezier_jet(connection, i, u))
        tip[i, 0], tip[i, 1], tip[i, 2], tip[i, 3] = p
        tool[i, 0], tool[i, 1], tool[i, 2], tool[i, 3] = d
    return _vector_jet(tip), jet.normalised(_vector_jet(tool))


@njit(cache=True, nogil=True)
def span_at(parametrization: FloatArray, u: float) -> tuple[int, float, float]:
    k = parametrization.shape[0] - 1
    while k > 0 and parametrization[k, 0] > u:
        k -= 1
    end = parametrization[k + 1, 0] if k + 1 < parametrization.shape[0] else 1.0
    return k, parametrization[k, 0], end - parametrization[k, 0]


@njit(cache=True, nogil=True)
def _top_parameter(parametrization: FloatArray, u: float, inside: float) -> Jet:
    """Return the jet of u_top = f(u), evaluated on the span that contains ``inside``."""
    if parametrization.shape[0] == 0:
        return (u, 1.0, 0.0, 0.0)
    k, start, length = span_at(parametrization, inside)
    f = bezier_jet(parametrization[k, 1:].copy().reshape(7, 1), 0, (u - start) / length)
    return (f[0], f[1] / length, f[2] / length**2, f[3] / length**3)


@njit(cache=True, nogil=True)
def corner_breaks(parametrization: FloatArray) -> FloatArray:
    """Return in order the u at which the third derivative of a corner may jump, with 0 and 1."""
    spans = parametrization.shape[0]
    if spans == 0:
        return np.array([0.0, 0.5, 1.0])
    low, high = 0.0, 1.0
    for _ in range(60):  # bisection for f(u) = 0.5, the inner knot of the top curve; f rises
        middle = 0.5 * (low + high)
        if _top_parameter(parametrization, middle, middle)[0] < 0.5:
            low = middle
        else:
            high = middle
    if abs(low - 0.5) < 1e-9:
        low = 0.5
    found: FloatArray = np.unique(
        np.concatenate((parametrization[:, 0], np.array([0.5, low, 1.0])))
    )
    return found


@njit(cache=True, nogil=True)
def corner_jets(
    bottom: FloatArray,
    top: FloatArray,
    connection: FloatArray,
    parametrization: FloatArray,
    u: float,
    inside: float,
) -> tuple[VectorJet, VectorJet]:
    """Return the jets in u of tool tip [m] and unit tool axis on a CORNER [B2013, Eq. 5].

    ``parametrization`` (spans, 8) has the start of each span of f and seven Bezier values on it.
    If u is a break, ``inside`` selects the side: a parameter inside the same smooth piece.
    """
    late = late_top = inside > 0.5
    f = _top_parameter(parametrization, u, inside)
    if parametrization.shape[0] > 0:
        late_top = _top_parameter(parametrization, inside, inside)[0] > 0.5
    tip, tool = np.empty((3, 4)), np.empty((3, 4))
    for i in range(3):
        p = corner_spline_jet(bottom, i, u, late)
        t = jet.compose(corner_spline_jet(top, i, f[0], late_top), f)
        d = jet.add(jet.subtract(t, p), bezier_jet(connection, i, u))
        tip[i, 0], tip[i, 1], tip[i, 2], tip[i, 3] = p
        tool[i, 0], tool[i, 1], tool[i, 2], tool[i, 3] = d
    return _vector_jet(tip), jet.normalised(_vector_jet(tool))


@njit(cache=True, nogil=True)
def _vector_jet(rows: FloatArray) -> VectorJet:
    return (
        (rows[0, 0], rows[0, 1], rows[0, 2], rows[0, 3]),
        (rows[1, 0], rows[1, 1], rows[1, 2], rows[1, 3]),
        (rows[2, 0], rows[2, 1], rows[2, 2], rows[2, 3]),
    )


@njit(cache=True, nogil=True)
def great_circle_jets(axis: FloatArray, rotation: FloatArray, u: float) -> VectorJet:
    """Return the jet of a unit tool axis turned by u times a rotation vector [B2013, Eq. 4]."""
    o = (jet.constant(axis[0]), jet.constant(axis[1]), jet.constant(axis[2]))
    angle = sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    if angle == 0.0:
        return o
    k = (rotation[0] / angle, rotation[1] / angle, rotation[2] / angle)
    sine, cosine = jet.sine_cosine((angle * u, angle, 0.0, 0.0))
    turned: VectorJet = jet.rotated(k, sine, cosine, o)
    return turned


@njit(cache=True, nogil=True)
def line_jets(
    bottom: FloatArray, axis: FloatArray, rotation: FloatArray, u: float
) -> tuple[VectorJet, VectorJet]:
    """Return the jets in u of tip [m] and unit tool axis on a LINE [B2013, Eq. 4]."""
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
