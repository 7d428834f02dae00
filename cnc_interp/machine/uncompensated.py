"""The error at the tool that a motion would have without compensation, while it is executed."""

from __future__ import annotations

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives.drive_kernels import follow_all
from cnc_interp.drives.drive_model import lag_of, words_of
from cnc_interp.machine.axis_motion import ContourErrors
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform


class Uncompensated:
    """
    Drives of a model beside those of the machine, which get the setpoints as they are.

    Parameters
    ----------
    period : float
        Interpolation period [s].
    position : ndarray, shape (n_axes,)
        Where the axes stand [m, rad].

    """

    def __init__(self, model: Machine, period: float, position: FloatArray):
        self._words = words_of(model, period, position)
        self._transform = Transform.of(model)
        at_rest = self._transform.forward(position[None, :])[0]
        self._contour = ContourErrors(period, lag_of(model), at_rest[0])

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
            Distances from the path of the commanded tips, those of a few periods before [m].

        """
        x, _ = follow_all(self._words, positions, velocities)
        commanded, tips = (self._transform.forward(at)[0] for at in (positions, x))
        return self._contour.push(commanded, tips)
