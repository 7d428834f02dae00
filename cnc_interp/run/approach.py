"""The approach: from where the machine stands to the start pose, straight in the axes."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.path_checks import check_travel
from cnc_interp.kinematics.transform import Transform

#: Axes nearer than this to the start pose stay where they are [m, rad].
THERE = 1e-12


def approach(
    transform: Transform, flank_height: float, start: FloatArray, end: FloatArray
) -> AxisPath | None:
    """
    Make the path of the approach: all axes run straight and arrive together.

    Each axis runs monotonically, so it stays within its travel when both ends do.

    Parameters
    ----------
    transform : Transform
        The machine's transformation.
    flank_height : float
        Height that measures rotations [m].
    start, end : ndarray, shape (n_axes,)
        Axis positions where the machine stands, and of the start pose [m, rad].

    Returns
    -------
    AxisPath or None
        Block 0, with s from below 0 to 0 [m]; None where the machine is there already.

    Raises
    ------
    TravelError
        If the start pose lies outside the travel.

    """
    machine = transform.machine
    there = np.concatenate([end[None], np.zeros((3, len(end)))])[None]
    check_travel(machine, np.zeros(1), there, there, np.zeros(1, dtype=np.int64))
    way = end - start
    if np.abs(way).max() <= THERE:
        return None
    weight = np.where(machine.is_linear, 1.0, flank_height)
    length = float(np.sqrt(((weight * way) ** 2).sum()))
    jet = np.zeros((4, 1, len(way)))
    jet[1, 0] = way / length
    left, right = jet.copy(), jet.copy()
    left[0, 0], right[0, 0] = start, end
    tip, axis = transform.forward(np.stack([start, end]))
    return AxisPath(
        s=np.array([-length, 0.0]),
        cell_left=left,
        cell_right=right,
        tip=tip,
        axis=axis,
        cell_feed=np.array([np.inf]),
        cell_block=np.array([0]),
        stop=np.array([True, True]),
    )
