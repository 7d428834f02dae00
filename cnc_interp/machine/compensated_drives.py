"""Drives behind the port that get the inverse of their model: ``drives/compensation.py``."""

from __future__ import annotations

import math

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives.compensation import (
    COUNT,
    FADE,
    FADING,
    FIRST,
    HEAD,
    KNOWN,
    LEFT,
    MEMORY,
    RATES,
    ROWS,
    SETPOINTS,
    STATE,
    STEP,
    Compensation,
    compensate_once,
)
from cnc_interp.drives.learnt_motion import LearntMotion
from cnc_interp.machine.drives import CycleDrives
from cnc_interp.machine_model.machine import Machine


class CompensatedDrives:
    """
    Drives of the cycle that are sent the inverse of their model.

    Parameters
    ----------
    model : Machine
        Its drives and loads are the model.
    period : float
        Interpolation period [s].
    learnt : LearntMotion, optional
        What earlier runs have taught; it counts while its setpoints are played.

    """

    def __init__(
        self, inner: CycleDrives, model: Machine, period: float, learnt: LearntMotion | None = None
    ):
        compensation = Compensation(model, period, inner.position)
        self._inner, self._shape = inner, compensation.words.shape
        self.lag, self.step = compensation.lead, int(compensate_once.address)
        head, told = np.zeros(HEAD, dtype=np.int64), np.zeros(2 * self._shape[0])
        head[[STEP, MEMORY]] = inner.step, inner.memory.ctypes.data
        head[[COUNT, KNOWN]] = self._shape[1], compensation.known
        self._learnt = learnt  # its arrays must stay where they are
        if learnt is not None:
            head[ROWS] = len(learnt.setpoint)
            head[[SETPOINTS, RATES]] = learnt.setpoint.ctypes.data, learnt.rate.ctypes.data
            head[[FADING, LEFT]] = math.ceil(FADE / period - 1e-9)
        self.memory = np.concatenate([head.view(float), compensation.words.ravel(), told])
        self._newest = HEAD + FIRST + STATE * compensation.known

    @property
    def position(self) -> FloatArray:
        """The last setpoint, where the axes stand or settle [m, rad]."""
        held: FloatArray = self.memory[self._newest :: self._shape[1]][: self._shape[0]].copy()
        return held

    def switch_on(self) -> None:
        """Switch the drives on."""
        self._inner.switch_on()

    def switch_off(self) -> None:
        """Switch the drives off."""
        self._inner.switch_off()

    def close(self) -> None:
        """Let the drives go."""
        self._inner.close()

    def fault(self, number: int) -> str:
        """Say what a fault number of the drives means."""
        return self._inner.fault(number)
