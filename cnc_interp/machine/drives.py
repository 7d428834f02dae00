"""The interface to the drives, which is all that the rest of the machine knows about them.

There are two kinds of drives. ``CycleDrives`` provide a compiled step, which the cycle of the
machine calls (``simulated_drives.py``, ``hal_drives.py``). ``DelayedDrives`` receive the played
setpoints from Python and execute them after a delay (``trajectory_drives.py``).
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
    """The reports of the drives in some periods, one row each."""

    #: (K, n_axes): Actual axis coordinates and velocities [m, rad, per s].
    position: FloatArray
    velocity: FloatArray
    answered: FloatArray  #: (K, n_axes): Command that the actual positions answer [m, rad].


class Drives(ABC):
    """The drives of all axes. Their setpoints have been checked against travel and limits."""

    lag = 0.0  #: Approximate lag of the axes behind their setpoints [s].
    ahead = 0.0  #: Delay from receiving a setpoint to executing it; 0: in its own period [s].
    #: Whether the drives provide the inputs. Otherwise the topic ``machine_inputs`` does.
    wired = False
    calm = 0.0  #: Time between two steps after a long rest; 0: every period [s].
    #: Values of the outputs in the machine file; others write this memory.
    outputs: FloatArray
    inputs: FloatArray  #: Last reported values of the inputs in the machine file.

    @property
    @abstractmethod
    def position(self) -> FloatArray:
        """Positions at which the axes rest or settle, also before ``switch_on`` [m, rad]."""

    def exchange(self, seconds: float) -> None:
        """Exchange outputs and inputs, ``seconds`` after the last call."""

    def switch_on(self) -> None:
        """Switch the power on and hold the axes at their positions."""

    def switch_off(self) -> None:
        """Release the axes; the machine is at rest."""

    def close(self) -> None:
        """Release the drives when the machine ends; its clock has already stopped."""

    def fault(self, number: int) -> str:
        """Return what a fault number means and what to do; alarms are given without their sign."""
        return f'fault {number}'


class CycleDrives(Drives):
    """Drives with a compiled step that the cycle calls once per period.

    The step is a C function ``int64 step(double *memory, const double *setpoint, double *feedback,
    int64 n_axes)``, made by ``numba.cfunc`` or by any other compiler. ``setpoint`` holds n_axes
    positions, then n_axes velocities, at the end of the period; at rest the velocities are 0.
    ``feedback`` receives the actual values in the same layout. Two rows follow for drives that
    answer later because of a FIFO. The first is the setpoint that the positions answer (preset to
    ``setpoint``). The second holds the delay of the next period [s], and how many extra times the
    drives will play this setpoint, which is allowed only at rest (preset to 0).

    The step returns 0, or the number of a fault; no setpoints are then sent and the last one is
    held. A negative number is an alarm and stops the machine on its path: the stop tail is played
    to its end. Then the drives are switched off until the operator's reset.
    """

    step: int  #: Address of the step.
    memory: FloatArray  #: The state that the step keeps from one period to the next.


class HomedDrives(CycleDrives):
    """Drives whose axes must be homed at reference switches before their positions are known."""

    @property
    @abstractmethod
    def released(self) -> FloatArray:
        """Position of each axis when its watched input went off; exact for an index [m, rad]."""

    @abstractmethod
    def watch(self, axis: int, number: int) -> None:
        """Watch an input for an axis; ``released`` is NaN until the input goes off."""

    @abstractmethod
    def shift(self, by: FloatArray) -> None:
        """Renumber the axes: add ``by`` [m, rad] to their positions. Nothing moves."""


class DelayedDrives(Drives):
    """Drives that Python feeds with played setpoints; without news they stop on the path."""

    alarm = ''  #: Why the machine must stop on its path; empty if all is well.

    @abstractmethod
    def follow(self, played: AxisRows, stop: AxisRows) -> AxisFeedback:
        """Take the setpoints of some periods, and report the motion of the axes meanwhile."""
