"""PathSegments: the smooth path in the workpiece frame, and its evaluation."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.columns import Table, column
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
    rotation: FloatArray = column(3)  #: Rotation vector of the axis over a line or rotation [rad].
    #: Control values of the rotary axes on the basis of ``bottom`` [rad]. In poses only the first
    #: two are used: the programmed positions at both ends of the block. NaN if there are none.
    rotary: FloatArray = column(POINTS, 2)
    #: Length of a line; flank height times angle of a rotation; NaN for curves [m].
    length: FloatArray = column()
    #: Programmed ds/dt in the first and second half [m/s]; a corner lies in two blocks.
    feed: FloatArray = column(2)
    block: IntArray = column(2)  #: Program rows of the blocks in the first and second half.
    line_number: IntArray = column()  #: Program line of the second block.
    stop: BoolArray = column()  #: Whether the tool rests at the end of the segment.
    #: Contour and orientation deviation of curves [m], 0 for lines and rotations.
    deviation: FloatArray = column(2)
    #: Control values of k extra axes on the basis of ``bottom`` [m]: a fourth coordinate of the
    #: path. A rotation uses the first two, like a line.
    extra: FloatArray = column(POINTS, 'k', default=0.0)
    interpolation: IntArray = column(default=POSES)  #: What runs linearly, as in ``Blocks``.
    #: What ``deviation`` leaves of the orientation tolerance [m].
    room: FloatArray = column(default=0.0)


def padded(points: FloatArray) -> FloatArray:
    """Pad control points with zeros to the common number."""
    spare = np.zeros((len(points), POINTS - points.shape[1], 3))
    return np.concatenate([points, spare], axis=1)


def no_rotary(count: int) -> FloatArray:
    """Return the control values of rotary axes that are not programmed, (count, POINTS, 2)."""
    return np.full((count, POINTS, 2), np.nan)
