"""What the drives leave of a motion at the tool: how far tip and axis are off their path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.axis_motion import memory_of
from cnc_interp.machine.compensation import Compensation
from cnc_interp.machine.drive_model import lag_of
from cnc_interp.machine.simulated import simulate

#: Time after the last setpoint in which the axes settle [s].
SETTLING = 0.1


@dataclass(frozen=True)
class ToolError:
    """
    Errors of the executed motion, one row per period; they do not count lags along the path.

    Parameters
    ----------
    tip : ndarray, shape (K,)
        Distance of the tip from the path of the commanded tips [m].
    axis : ndarray, shape (K,)
        Angle between tool axis and the commanded one at that place [rad].

    """

    tip: FloatArray
    axis: FloatArray


def tool_error(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray,
    model: Machine | None = None,
) -> ToolError:
    """
    Simulate the drives of a machine, and measure the error at the tool.

    Parameters
    ----------
    machine : Machine
        The machine with its true drives.
    period : float
        Interpolation period [s].
    positions, velocities : ndarray, shape (K, n_axes)
        Setpoints [m, rad, per s].
    model : Machine, optional
        Compensate its drives.

    Returns
    -------
    ToolError
        One row for each setpoint, and for the time in which the axes settle.

    """
    rest = round(SETTLING / period)
    held = np.concatenate([positions, np.tile(positions[-1:], (rest, 1))])
    rates = np.concatenate([velocities, np.zeros((rest, positions.shape[1]))])
    lag = lag_of(machine) if model is None else Compensation(model, period, held[0]).lead
    recording = simulate(machine, period, held, rates, model)
    tip, axis = Transform.of(machine).forward(held)
    found = _errors(tip, axis, recording.tip, recording.axis, memory_of(period, lag))
    return ToolError(found[:, 0], found[:, 1])


@njit(cache=True, nogil=True)
def _errors(
    tips: FloatArray, axes: FloatArray, tip: FloatArray, axis: FloatArray, memory: int
) -> FloatArray:
    """Compare each pose with the nearest place on the last ``memory`` commanded chords."""
    found = np.zeros((len(tip), 2))
    for i in range(len(tip)):
        nearest = least = np.inf
        for k in range(max(i - memory, 0), max(i, 1)):
            along, length_sq = 0.0, 0.0
            for c in range(3):
                chord = tips[k + 1, c] - tips[k, c]
                along += (tip[i, c] - tips[k, c]) * chord
                length_sq += chord * chord
            part = min(1.0, max(0.0, along / length_sq)) if length_sq > 0.0 else 0.0
            distance_sq = turn_sq = 0.0
            for c in range(3):
                away = tip[i, c] - tips[k, c] - part * (tips[k + 1, c] - tips[k, c])
                turn = axis[i, c] - axes[k, c] - part * (axes[k + 1, c] - axes[k, c])
                distance_sq += away * away
                turn_sq += turn * turn
            if length_sq == 0.0 and distance_sq <= nearest:  # the tip stands and the axis turns
                nearest, least = distance_sq, min(least, turn_sq)
            elif distance_sq < nearest:
                nearest, least = distance_sq, turn_sq
        found[i, 0], found[i, 1] = np.sqrt(nearest), np.sqrt(least)
    return found
