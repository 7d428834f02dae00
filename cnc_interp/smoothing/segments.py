"""PathSegments: the smooth path in the workpiece frame, and its evaluation."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.program.blocks import POSES

LINE, CORNER, ROTATION, SPLINE = 0, 1, 2, 3
#: Number of control points in the arrays: a line uses 2 of them, a corner 5, a spline all 6.
POINTS = 6


@dataclass(frozen=True)
class PathSegments:
    """
    Smooth segments in path order, one row per segment, each with a parameter u in [0, 1].

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

    kind: IntArray  #: (n,): Kind of the segment: LINE, CORNER, ROTATION or SPLINE.
    #: (n, 6, 3): Control points of bottom and top curve [m]. Lines use the first two (start and
    #: end), corners the first five.
    bottom: FloatArray
    top: FloatArray
    #: (n, m, 3): Bezier points over [0, 1] that are added to the top curve of a corner or spline
    #: [m].
    connection: FloatArray
    #: (n, spans, 8): u_top = f(u) of corners, span by span [-]: the start of the span, then the
    #: seven Bezier values of a sextic on it. No spans if f(u) = u.
    parametrization: FloatArray
    axis: FloatArray  #: (n, 3): Unit tool axis at the start of the segment [-].
    #: (n, 3): Rotation vector of the tool axis over a line or rotation [rad].
    rotation: FloatArray
    #: (n, 6, 2): Control values of the rotary axes on the basis of ``bottom`` [rad]. In poses only
    #: the first two are used: the programmed positions at both ends of the block. NaN if there are
    #: none.
    rotary: FloatArray
    #: (n,): Length of a line; flank height times angle of a rotation; NaN for curves [m].
    length: FloatArray
    #: (n, 2): Programmed ds/dt in the first and second half [m/s]; a corner lies in two blocks.
    feed: FloatArray
    block: IntArray  #: (n, 2): Program rows of the blocks executed in the first and second half.
    line_number: IntArray  #: (n,): Program line of the second block.
    stop: BoolArray  #: (n,): Whether the tool rests at the end of the segment.
    #: (n, 2): Contour and orientation deviation of curves [m], 0 for lines and rotations.
    deviation: FloatArray
    #: (n, 6, k): Control values of k extra axes on the basis of ``bottom`` [m]: a fourth
    #: coordinate of the path. A rotation uses the first two, like a line. The default is k = 0.
    extra: FloatArray = field(default_factory=lambda: np.zeros((0, POINTS, 0)))
    #: (n,): What runs linearly in the blocks, as in ``Blocks``. The default is POSES.
    interpolation: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    #: (n,): What ``deviation`` leaves of the orientation tolerance [m]. The default is 0.
    room: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if len(self.extra) != len(self.kind):
            object.__setattr__(self, 'extra', np.zeros((len(self.kind), POINTS, 0)))
        if len(self.interpolation) != len(self.kind):
            object.__setattr__(self, 'interpolation', np.full(len(self.kind), POSES))
        if len(self.room) != len(self.kind):
            object.__setattr__(self, 'room', np.zeros(len(self.kind)))
        for column in fields(self):
            getattr(self, column.name).flags.writeable = False

    def __len__(self) -> int:
        """Return the number of segments."""
        return len(self.kind)

    def __getitem__(self, rows: slice | IntArray) -> PathSegments:
        """Return the segments at these indices."""
        return PathSegments(*(getattr(self, column.name)[rows] for column in fields(self)))

    @staticmethod
    def concatenate(parts: list[PathSegments]) -> PathSegments:
        """Join batches of segments in order."""
        parts = [part for part in parts if len(part)] or parts[:1]
        names = [column.name for column in fields(PathSegments)]
        return PathSegments(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))


def padded(points: FloatArray) -> FloatArray:
    """Pad control points with zeros to the common number."""
    spare = np.zeros((len(points), POINTS - points.shape[1], 3))
    return np.concatenate([points, spare], axis=1)


def no_rotary(count: int) -> FloatArray:
    """Return the control values of rotary axes that are not programmed, (count, POINTS, 2)."""
    return np.full((count, POINTS, 2), np.nan)
