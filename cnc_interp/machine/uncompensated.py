"""The error at the tool that a motion would have without compensation, while it is executed."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives.drive_kernels import follow_all
from cnc_interp.drives.drive_model import lag_of, memory_of, words_of
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.axis_motion import path_errors


class Uncompensated:
    """
    Drives of a model beside those of the machine, which get the setpoints as they are.

    Parameters
    ----------
    model : Machine
        Its drives.
    period : float
        Interpolation period [s].
    position : ndarray, shape (n_axes,)
        Where the axes stand [m, rad].

    """

    def __init__(self, model: Machine, period: float, position: FloatArray):
        self._words = words_of(model, period, position)
        self._transform = Transform.of(model)
        self._memory = memory_of(period, lag_of(model))
        at_rest = self._transform.forward(position[None, :])[0]
        self._trail = np.repeat(at_rest, self._memory - 1, axis=0)

    def contour_errors(self, positions: FloatArray, velocities: FloatArray) -> FloatArray:
        """
        Take the next setpoints; return the distances of the tip from the commanded path.

        Parameters
        ----------
        positions, velocities : ndarray, shape (K, n_axes)
            Setpoints [m, rad, per s].

        Returns
        -------
        ndarray, shape (K,)
            Distances from the path of the latest commanded tips [m].

        """
        x, _ = follow_all(self._words, positions, velocities)
        trail = np.concatenate([self._trail, self._transform.forward(positions)[0]])
        self._trail = trail[1 - self._memory :]
        errors: FloatArray = path_errors(trail, self._transform.forward(x)[0], self._memory)
        return errors
