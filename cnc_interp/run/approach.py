"""
The approach: from where the machine stands to the path, straight in the axes from point to point.

To the start pose of a program all axes run at once. To a place inside the program the tool is
drawn back along itself, positioned above the place, and plunges along itself.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_checks import check_travel
from cnc_interp.machine_model.transform import ToolLine, Transform, tool_line

#: Axes nearer than this to the next point stay where they are [m, rad].
THERE = 1e-12


def approach(
    transform: Transform, flank_height: float, start: FloatArray, end: FloatArray
) -> AxisPath | None:
    """Make the approach path to the start pose: all axes run straight and arrive together."""
    return straight(transform, flank_height, np.stack([start, end]), np.array([np.inf]))


def way_inside(
    transform: Transform, stands: FloatArray, place: FloatArray, retract: float
) -> FloatArray:
    """
    Return the corners of the way to a place inside the program.

    The tool is drawn back at least by ``retract``, and farther where the other end lies higher
    along the tool, as far as the travel goes. So a machine whose tool keeps its direction
    positions at one height, above both ends.

    ``stands, place`` (n_axes,): axis positions where the machine stands, and of the place [m,
    rad].
    ``retract``: length of the plunge, and least way back [m].
    Returns (5, n_axes): where it stands, drawn back, above the place, where the plunge begins, the
    place [m, rad].
    """
    here, there = tool_line(transform, stands), tool_line(transform, place)
    plunge = min(retract, there.travel[1])
    begin = place + plunge * there.direction
    back = stands + _height(here, stands, begin, retract) * here.direction
    above = place + _height(there, place, back, plunge) * there.direction
    return np.stack([stands, back, above, begin, place])


def _height(line: ToolLine, foot: FloatArray, other: FloatArray, least: float) -> float:
    """Return how far above ``foot`` the tool is as high as at ``other``, within the travel [m]."""
    height = max(least, float(line.direction @ (other - foot)))
    return max(0.0, min(height, float(line.travel[1])))


def approach_inside(
    transform: Transform, flank_height: float, stands: FloatArray, place: FloatArray,
    retract: float, plunge_feed: float,
) -> AxisPath | None:  # fmt: skip
    """Make the path to a place inside the program: retract, position, plunge."""
    corners = way_inside(transform, stands, place, retract)
    feeds = np.array([np.inf, np.inf, np.inf, plunge_feed])
    return straight(transform, flank_height, corners, feeds)


def straight(
    transform: Transform, flank_height: float, points: FloatArray, feeds: FloatArray
) -> AxisPath | None:
    """
    Make a path from point to point, with a rest at each.

    Each axis runs monotonically between two points, so it stays within its travel when both do.
    """
    machine = transform.machine
    there = np.concatenate([points[1:, None], np.zeros((len(points) - 1, 3, points.shape[1]))], 1)
    none = np.zeros(len(there), dtype=np.int64)
    check_travel(machine, none.astype(float), there, there, none)
    moves = np.abs(np.diff(points, axis=0)).max(axis=1) > THERE
    if not moves.any():
        return None
    points, feeds = np.concatenate([points[:1], points[1:][moves]]), feeds[moves]
    way = np.diff(points, axis=0)
    weight = np.where(machine.is_linear, 1.0, flank_height)
    length = np.sqrt(((weight * way) ** 2).sum(axis=1))
    left = np.zeros((4, *way.shape))
    left[1] = way / length[:, None]
    right = left.copy()
    left[0], right[0] = points[:-1], points[1:]
    tip, axis = transform.forward(points)
    after = np.append(np.cumsum(length[::-1])[::-1], 0.0)
    return AxisPath(
        s=-after, cell_left=left, cell_right=right, tip=tip, axis=axis, cell_feed=feeds,
        cell_block=np.zeros(len(feeds), dtype=np.int64), stop=np.ones(len(points), dtype=np.bool_),
    )  # fmt: skip
