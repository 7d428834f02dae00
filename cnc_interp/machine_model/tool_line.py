"""The straight line of the axes X Y Z along which the tool tip moves along the tool axis."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.transform import Transform

#: Smaller components of the tool's direction are rounding [-].
NO_PART = 1e-12


class ToolLine(NamedTuple):
    """Axis positions ``q + x direction`` move the tip by x along the tool axis."""

    direction: FloatArray  #: (n_axes,): Direction in the axes, away from the workpiece [-].
    travel: FloatArray  #: (2,): Range of x within the travel of the axes [m].


def tool_line(transform: Transform, stands: FloatArray) -> ToolLine:
    """
    Return the line along the tool through axis positions, shape (n_axes,) [m, rad].

    The tip is an affine function of X Y Z, so its differences over 1 m are exact.
    """
    n = len(stands)
    tip, axis = transform.forward(stands + np.eye(4, n, -1))
    direction = np.zeros(n)
    direction[:3] = np.linalg.solve((tip[1:] - tip[0]).T, axis[0])
    direction[np.abs(direction) < NO_PART] = 0.0
    moves = direction != 0.0
    ends = (transform.machine.travel[moves] - stands[moves, None]) / direction[moves, None]
    ends = np.sort(ends, axis=1)
    return ToolLine(direction, np.array([ends[:, 0].max(), ends[:, 1].min()]))
