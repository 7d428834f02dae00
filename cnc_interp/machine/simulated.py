"""Simulated drives behind the port of ``drives.py``, and a whole motion of them at once."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.machine import Machine
from cnc_interp.machine.axis_motion import AxisMotion, Recording
from cnc_interp.machine.drive_model import DriveModel, drive, drive_once


class SimulatedDrives:
    """
    Drives that follow setpoints by ``DriveModel``, in the cycle of the machine.

    Parameters
    ----------
    model : DriveModel
        Gains and lag, the same for all axes.
    period : float
        Interpolation period [s].
    position : ndarray, shape (n_axes,)
        Where the axes stand at rest [m, rad].

    """

    def __init__(self, model: DriveModel, period: float, position: FloatArray):
        self.lag, self.step = model.lag, int(drive_once.address)
        start: FloatArray = np.array(position, dtype=float)
        still = np.zeros_like(start)
        model_words = np.ravel(model.discretise(period))
        self.memory = np.concatenate([model_words, start, still, start, still])  # x, v, r, f
        self._held = slice(len(self.memory) - 2 * len(start), len(self.memory) - len(start))

    @property
    def position(self) -> FloatArray:
        """The last setpoint, where the axes stand or settle [m, rad]."""
        held: FloatArray = self.memory[self._held].copy()
        return held

    def switch_on(self) -> None:
        """Do nothing: simulated axes are where they were."""

    def switch_off(self) -> None:
        """Do nothing: simulated axes stand still without power."""

    def fault(self, number: int) -> str:
        """Say what a fault number means; simulated drives have no faults."""
        return f'fault {number}'


def simulate(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray | None = None,
    model: DriveModel | None = None,
) -> Recording:
    """
    Run simulated drives through all setpoints, from rest at the first one.

    The result is the same, bit for bit, as that of ``Cycle`` with ``SimulatedDrives``.

    Parameters
    ----------
    machine : Machine
        Axes, limits and geometry.
    period : float
        Interpolation period [s].
    positions : ndarray, shape (K, n_axes)
        Setpoints [m, rad].
    velocities : ndarray, shape (K, n_axes), optional
        Their velocities; central differences when not given [m/s, rad/s].
    model : DriveModel, optional
        Gains and lag of the drives.

    """
    model = model or DriveModel()
    r = np.ascontiguousarray(positions, dtype=float)
    rate = np.gradient(r, period, axis=0) if velocities is None else velocities
    rate = np.ascontiguousarray(rate, dtype=float)
    start = np.stack([r[0], np.zeros_like(r[0])])
    x, v = drive(*model.discretise(period), start, r[0], np.zeros_like(r[0]), r, rate)
    return AxisMotion(machine, period, model.lag, r[0]).measure(r, x, v)
