"""
The port to the drives: what a drive must be able to do. The rest of the machine knows no more.

``simulated.py`` fills it. Real drives fill it in another module: the buffer, the playback and the
states stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import StreamError


class DriveFaultError(StreamError):
    """A drive cannot follow; the message names the axis and the cause."""


@dataclass(frozen=True)
class AxisFeedback:
    """
    What the drives report after one period.

    Parameters
    ----------
    position : ndarray, shape (n_axes,)
        Actual axis coordinates [m, rad].
    velocity : ndarray, shape (n_axes,)
        Actual axis velocities [m/s, rad/s].

    """

    position: FloatArray
    velocity: FloatArray


class Drives(Protocol):
    """
    The drives of all axes, told once per interpolation period.

    Every call returns at once: the caller keeps the clock. Setpoints were checked before against
    travel and limits.
    """

    @property
    def lag(self) -> float:
        """How far the axes follow behind their setpoints, about [s]."""
        ...

    def switch_on(self) -> FloatArray:
        """
        Take power and hold the axes where they stand.

        Returns
        -------
        ndarray, shape (n_axes,)
            The setpoint that is held: where the axes stand [m, rad].

        Raises
        ------
        DriveFaultError
            If a drive cannot be switched on.

        """
        ...

    def switch_off(self) -> None:
        """Release the axes; the machine is at rest."""
        ...

    def follow(self, position: FloatArray, velocity: FloatArray) -> AxisFeedback:
        """
        Follow one setpoint for one period.

        Parameters
        ----------
        position : ndarray, shape (n_axes,)
            Axis coordinates at the end of the period [m, rad].
        velocity : ndarray, shape (n_axes,)
            Axis velocities there, for the feed-forward [m/s, rad/s].

        Raises
        ------
        DriveFaultError
            If a drive has failed. The axes come to rest by the drives' own means.

        """
        ...

    def rest(self) -> AxisFeedback:
        """Hold the axes for one period, also after a fault; before ``switch_on`` only report."""
        ...
