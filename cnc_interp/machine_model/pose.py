"""The axis positions of a tool pose, nearest to where the machine stands."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.branch import start_positions
from cnc_interp.machine_model.transform import Transform

#: Least length of the direction of a tool axis [-], and how exactly a fixed one is met [-].
LEAST_LENGTH, SAME_AXIS = 1e-6, 1e-9


def positions_of_pose(
    transform: Transform, tip: FloatArray, axis: FloatArray | None, stands: FloatArray
) -> FloatArray:
    """
    Return the axis positions of a tool pose.

    Parameters
    ----------
    transform : Transform
        The machine's transformation.
    tip : ndarray, shape (3,)
        Tool tip in W; NaN keeps a coordinate [m].
    axis : ndarray, shape (3,), or None
        Direction of the tool axis in W, of any length [-]; None keeps the rotary axes.
    stands : ndarray, shape (n_axes,)
        Where the machine stands; the nearest solution counts, and extra axes stay [m, rad].

    Returns
    -------
    ndarray, shape (n_axes,)
        Axis positions [m, rad].

    Raises
    ------
    BlockError
        If the rotary axes do not reach the direction within their travel.
    ValueError
        If the direction has no length, or the tool of the machine cannot turn to it.

    """
    here, present = (found[0] for found in transform.forward(stands[None, :]))
    tip = np.where(np.isnan(tip), here, tip)
    own = 5 if transform.machine.has_rotary else 3
    rotary = np.zeros(2) if own == 3 else stands[3:5]
    if axis is not None:
        length = float(np.linalg.norm(axis))
        if not LEAST_LENGTH < length < np.inf:
            raise ValueError('the direction of the tool axis has no length')
        wanted = axis / length
        if own == 3 and np.abs(wanted - present).max() > SAME_AXIS:
            raise ValueError('the tool of this machine does not turn; leave out I J K')
        if own == 5:
            rotary, _ = start_positions(transform, wanted, np.full(2, np.nan), rotary, 0)
    linear = transform.linear(tip[None, :], rotary[None, :])[0]
    extra = stands[own:]
    if len(extra):
        linear = linear - extra @ transform.extra_direction
    return np.concatenate([linear, rotary[: own - 3], extra])
