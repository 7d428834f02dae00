"""The port to the drives: what a drive must be able to do. The rest of the machine knows no more.

Drives come in two kinds. ``CycleDrives`` bring a compiled step, which the cycle of the machine
calls itself (``simulated_drives.py``, ``hal_drives.py``). ``DelayedDrives`` are told in Python
what the cycle has played, and execute it after a delay (``trajectory_drives.py``).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.core.tables import Table, column


class DriveFaultError(StreamError):
    """A drive cannot follow; the message names the axis and the cause."""


class AxisRows(Table):
    #: Axis coordinates and their derivatives at the end of each period [m or rad, per s, s2].
    position: FloatArray = column('axes')
    velocity: FloatArray = column('axes')
    acceleration: FloatArray = column('axes')

    @staticmethod
    def held(position: FloatArray, count: int) -> AxisRows:
        still = np.zeros((count, len(position)))
        return AxisRows(np.tile(position, (count, 1)), still, still)


class AxisFeedback(NamedTuple):
    """What the drives reported in some periods, one row each."""

    #: (K, n_axes): Actual axis coordinates and velocities [m, rad, per s].
    position: FloatArray
    velocity: FloatArray
    answered: FloatArray  #: (K, n_axes): The command that the actual one answers [m, rad].


class Drives(ABC):
    """The drives of all axes. Setpoints were checked before against travel and limits."""

    lag = 0.0  #: How much later than their setpoints the axes are there, about [s].
    ahead = 0.0  #: Delay from receiving a setpoint to playing it; 0: played in its period [s].
    #: Whether the drives themselves bring the inputs. Otherwise ``machine_inputs`` does.
    wired = False
    calm = 0.0  #: Time between two steps of drives that have stood for long; 0: each period [s].
    #: What the outputs of the machine file are set to: their memory, which others write.
    outputs: FloatArray
    inputs: FloatArray  #: The inputs of the machine file, as they were reported last.

    @property
    @abstractmethod
    def position(self) -> FloatArray:
        """Where the axes stand or settle at rest, also before ``switch_on`` [m, rad]."""

    def exchange(self, seconds: float) -> None:
        """Take over outputs and inputs, some time after the call before."""

    def switch_on(self) -> None:
        """Switch the power on and hold the axes where they stand."""

    def switch_off(self) -> None:
        """Release the axes; the machine is at rest."""

    def close(self) -> None:
        """Release the drives when the machine ends; its clock has stopped."""

    def fault(self, number: int) -> str:
        """Say what a number of the step means, and what to do; that of an alarm without sign."""
        return f'fault {number}'


class CycleDrives(Drives):
    """Drives with a compiled step that the cycle calls once per period.

    The step is a C function ``int64 step(double *memory, const double *setpoint, double *feedback,
    int64 n_axes)``, made by ``numba.cfunc`` or by any other compiler. ``setpoint`` holds n_axes
    positions, then n_axes velocities, at the end of the period; at rest the velocities are 0.
    ``feedback`` takes the actual ones in the same layout. Two rows follow for drives that answer
    later, because of a FIFO: the setpoint that the positions answer (before the call:
    ``setpoint``); then the time by which the next period shall begin later [s], and how many times
    more than once the drives will play this setpoint, at rest alone (before: 0).

    It returns 0, or the number of a fault; then the machine is told no further setpoints and the
    last one is held. The number of an alarm, less than 0, stops the machine on its path: the stop
    tail is played to its end. Then the drives are switched off, until the operator's reset.
    """

    step: int  #: Address of the step.
    memory: FloatArray  #: The state that the step keeps from one period to the next.


class HomedDrives(CycleDrives):
    """Drives that know where their axes are only after these have found reference switches."""

    @property
    @abstractmethod
    def released(self) -> FloatArray:
        """Where each axis was when its watched input went off, an index exactly [m, rad]."""

    @abstractmethod
    def watch(self, axis: int, number: int) -> None:
        """Watch an input for an axis; until it goes off, ``released`` is NaN."""

    @abstractmethod
    def shift(self, by: FloatArray) -> None:
        """Add to the positions of the axes, which rest and stay where they are [m, rad]."""


class DelayedDrives(Drives):
    """Drives that Python feeds with what the cycle played; unheard, they rest on the path."""

    alarm = ''  #: Why the machine must stop on its path; empty if all is well.

    @abstractmethod
    def follow(self, played: AxisRows, stop: AxisRows) -> AxisFeedback:
        """Take the setpoints of some periods, and report what the axes did meanwhile."""
