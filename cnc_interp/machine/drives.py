"""
The port to the drives: what a drive must be able to do. The rest of the machine knows no more.

Drives come in two kinds. ``CycleDrives`` bring a compiled step, which the cycle of the machine
calls itself: nothing of Python lies between clock and drive. ``FedDrives`` are told in Python what
the cycle has played, some milliseconds later. ``simulated.py`` has drives of the first kind. Real
drives fill the port in another module: the buffer, the cycle and the states stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

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
    """The drives of all axes. Setpoints were checked before against travel and limits."""

    @property
    def lag(self) -> float:
        """How much later than their setpoints the axes are there, about [s]."""
        ...

    @property
    def position(self) -> FloatArray:
        """Where the axes stand or settle at rest, also before ``switch_on`` [m, rad]."""
        ...

    def switch_on(self) -> None:
        """
        Switch the power on and hold the axes where they stand.

        Raises
        ------
        DriveFaultError
            If a drive cannot be switched on.

        """
        ...

    def switch_off(self) -> None:
        """Release the axes; the machine is at rest."""
        ...

    def close(self) -> None:
        """Let the drives go: the machine ends, and its clock has stopped."""
        ...


@runtime_checkable
class CycleDrives(Drives, Protocol):
    """
    Drives with a compiled step that the cycle calls once per period.

    The step is a C function ``int64 step(double *memory, const double *setpoint, double *feedback,
    int64 n_axes)``, made by ``numba.cfunc`` or by any other compiler. ``setpoint`` holds n_axes
    positions, then n_axes velocities, at the end of the period; at rest the velocities are 0.
    ``feedback`` takes the actual positions and velocities in the same layout. Two rows follow for
    drives that answer later, because of a FIFO: the setpoint that the positions answer (before
    the call: ``setpoint``), and one number, the time by which the next period shall begin later
    than by the clock of the machine [s] (before the call: 0).

    It returns 0, or the number of a fault; then the machine is told no further setpoints and the
    last one is held. The number of an alarm, less than 0, stops the machine on its path: the stop
    tail is played to its end. Then the drives are switched off, until the operator's reset.
    """

    @property
    def step(self) -> int:
        """Address of the step."""
        ...

    @property
    def memory(self) -> FloatArray:
        """The state that the step keeps from one period to the next."""
        ...

    def fault(self, number: int) -> str:
        """Say what a number of the step means, and what to do; that of an alarm without sign."""
        ...


@runtime_checkable
class FedDrives(Drives, Protocol):
    """Drives that Python feeds with what the cycle has played. Every call returns at once."""

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
