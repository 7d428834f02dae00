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

#: Distances that differ by less are equal [m].
SAME = 1e-6
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
    """
    Compare each pose with the last ``memory`` commanded chords; return errors of tip and axis.

    Where the tip stands or goes back on its way, many chords are as near as the nearest one. The
    axis is compared with the one on them that is most like it.
    """
    found, away, turn = np.zeros((len(tip), 2)), np.zeros(memory + 1), np.zeros(memory + 1)
    for i in range(len(tip)):
        first, last = max(i - memory, 0), max(i, 1)
        for k in range(first, last):
            along, length_sq = 0.0, 0.0
            for c in range(3):
                chord = tips[k + 1, c] - tips[k, c]
                along += (tip[i, c] - tips[k, c]) * chord
                length_sq += chord * chord
            part = 0.0
            if length_sq > 0.0:
                part = min(1.0, max(0.0, along / length_sq))
            distance_sq = turn_sq = 0.0
            for c in range(3):
                gap = tip[i, c] - tips[k, c] - part * (tips[k + 1, c] - tips[k, c])
                lean = axis[i, c] - axes[k, c] - part * (axes[k + 1, c] - axes[k, c])
                distance_sq += gap * gap
                turn_sq += lean * lean
            away[k - first], turn[k - first] = np.sqrt(distance_sq), np.sqrt(turn_sq)
        nearest = away[: last - first].min()
        least = np.inf
        for k in range(last - first):
            if away[k] <= nearest + SAME:
                least = min(least, turn[k])
        found[i, 0], found[i, 1] = nearest, least
    return found
