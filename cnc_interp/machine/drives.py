"""
The port to the drives: what a drive must be able to do. The rest of the machine knows no more.

Drives come in two kinds. ``CycleDrives`` bring a compiled step, which the cycle of the machine
calls itself: nothing of Python lies between clock and drive. ``DelayedDrives`` are told in Python
what the cycle has played, some milliseconds later, and execute it after a delay.
``simulated_drives.py`` and ``hal_drives.py`` have drives of the first kind,
``trajectory_drives.py`` those of the second. The buffer, the cycle and the states do
not know which drives there are.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import StreamError


class DriveFaultError(StreamError):
    """A drive cannot follow; the message names the axis and the cause."""


@dataclass(frozen=True)
class AxisRows:
    """Setpoints of consecutive periods, one row each."""

    #: (K, n_axes): Axis coordinates and their derivatives at the end of each period [m or rad, per
    #: s, per s2].
    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray

    def __len__(self) -> int:
        """Return the number of periods."""
        return len(self.position)

    def part(self, rows: slice | IntArray) -> AxisRows:
        """Return some rows."""
        return AxisRows(self.position[rows], self.velocity[rows], self.acceleration[rows])

    def then(self, other: AxisRows) -> AxisRows:
        """Return these rows and others after them."""
        return AxisRows(
            np.concatenate([self.position, other.position]),
            np.concatenate([self.velocity, other.velocity]),
            np.concatenate([self.acceleration, other.acceleration]),
        )

    @staticmethod
    def held(position: FloatArray, count: int) -> AxisRows:
        """Return rows of axes that stand still."""
        still = np.zeros((count, len(position)))
        return AxisRows(np.tile(position, (count, 1)), still, still)


class AxisFeedback(NamedTuple):
    """What the drives reported in some periods, one row each."""

    #: (K, n_axes): Actual axis coordinates and velocities [m, rad, per s].
    position: FloatArray
    velocity: FloatArray
    #: (K, n_axes): The commanded position that the actual one answers [m, rad].
    answered: FloatArray


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
        """Switch the power on and hold the axes where they stand."""
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
class DelayedDrives(Drives, Protocol):
    """
    Drives that Python feeds with what the cycle has played; they execute it after a delay.

    The end of every stop tail is known in time. So they come to rest on the path by themselves
    when they hear nothing more. Every call returns at once.
    """

    @property
    def alarm(self) -> str:
        """Why the machine must stop on its path; empty if all is well."""
        ...

    def follow(self, played: AxisRows, stop: AxisRows) -> AxisFeedback:
        """Take the setpoints of some periods, and report what the axes did meanwhile."""
        ...
