"""Simulated drives behind the port of ``drives.py``, and a whole motion of them at once."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives.compensation import Compensation, compensate_all
from cnc_interp.drives.drive_model import RING, follow_all, follow_once, lag_of, words_of
from cnc_interp.machine.axis_motion import AxisMotion, Recording
from cnc_interp.machine_model.machine import Machine


class SimulatedDrives:
    """Drives that follow setpoints by ``drive_model.py``; at first they stand at ``position``."""

    def __init__(self, machine: Machine, period: float, position: FloatArray):
        self.lag, self.step = lag_of(machine), int(follow_once.address)
        words = words_of(machine, period, position)
        self.memory = np.concatenate([[float(words.shape[1])], words.ravel()])
        self._words = self.memory[1:].reshape(words.shape)

    @property
    def position(self) -> FloatArray:
        """The last setpoint, where the axes stand or settle [m, rad]."""
        held: FloatArray = self._words[:, RING].copy()
        return held

    def switch_on(self) -> None:
        """Do nothing: simulated axes are where they were."""

    def switch_off(self) -> None:
        """Do nothing: simulated axes stand still without power."""

    def close(self) -> None:
        """Do nothing: there is nothing to let go."""

    def fault(self, number: int) -> str:
        """Say what a fault number means; simulated drives have no faults."""
        return f'fault {number}'


def simulate(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray | None = None,
    model: Machine | None = None,
) -> Recording:
    """
    Run simulated drives through all setpoints, from rest at the first one.

    The bits are those of ``Cycle`` with ``SimulatedDrives``. ``positions``, ``velocities``
    (K, n_axes): setpoints [m, rad, per s]; without velocities, central differences; ``model``:
    compensate its drives. All axes are then later by ``Compensation.lead``.
    """
    r = np.ascontiguousarray(positions, dtype=float)
    rate = np.gradient(r, period, axis=0) if velocities is None else velocities
    rate = np.ascontiguousarray(rate, dtype=float)
    sent, lag = r, lag_of(machine)
    if model is not None:
        compensation = Compensation(model, period, r[0])
        sent, rate = compensate_all(compensation.words, compensation.known, r)
        lag = compensation.lead
    x, v = follow_all(words_of(machine, period, r[0]), sent, rate)
    return AxisMotion(machine, period, lag, r[0]).measure(r, x, v)
