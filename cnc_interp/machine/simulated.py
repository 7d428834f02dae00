"""Simulated drives behind the port of ``drives.py``, and a whole motion of them at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.differences import BEFORE, largest_differences, limit_shares
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.axis_motion import memory_of, path_errors
from cnc_interp.machine.drive_model import DriveModel, drive
from cnc_interp.machine.drives import AxisFeedback


class SimulatedDrives:
    """
    Drives that follow setpoints by ``DriveModel``, one period at a time; no clock.

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
        self.lag = model.lag
        self._step = model.discretise(period)
        self._setpoint: FloatArray = np.array(position, dtype=float)
        self._velocity = np.zeros_like(self._setpoint)
        self._axes = np.stack([self._setpoint, self._velocity])

    def switch_on(self) -> FloatArray:
        """Return the last setpoint, where the axes stand or settle [m, rad]."""
        return self._setpoint

    def switch_off(self) -> None:
        """Do nothing: simulated axes stand still without power."""

    def follow(self, position: FloatArray, velocity: FloatArray) -> AxisFeedback:
        """Advance the axes by one period towards a setpoint; see ``Drives.follow``."""
        x, v = drive(
            *self._step, self._axes, self._setpoint, self._velocity, position[None, :],
            velocity[None, :],
        )  # fmt: skip
        self._axes = np.stack([x[0], v[0]])
        self._setpoint, self._velocity = position, velocity
        return AxisFeedback(x[0], v[0])

    def rest(self) -> AxisFeedback:
        """Let the axes settle at the last setpoint for one period."""
        return self.follow(self._setpoint, np.zeros_like(self._velocity))


@dataclass(frozen=True)
class Recording:
    """
    A whole motion of the simulated drives, one row per setpoint.

    Parameters
    ----------
    position, velocity, following_error : ndarray, shape (K, n_axes)
        Actual axes, and commanded minus actual position [m, rad, per s].
    tip, axis : ndarray, shape (K, 3)
        Actual tool tip [m] and tool axis [-] in W.
    tip_lag, contour_error : ndarray, shape (K,)
        Distances of the actual tip from the commanded tip and from the commanded path [m].
    largest_use : ndarray, shape (3, n_axes)
        Largest velocity, acceleration and jerk of the setpoints over their limits [-].

    """

    position: FloatArray
    velocity: FloatArray
    following_error: FloatArray
    tip: FloatArray
    axis: FloatArray
    tip_lag: FloatArray
    contour_error: FloatArray
    largest_use: FloatArray


def simulate(
    machine: Machine,
    period: float,
    positions: FloatArray,
    velocities: FloatArray | None = None,
    model: DriveModel | None = None,
) -> Recording:
    """
    Run simulated drives through all setpoints, from rest at the first one.

    The result is the same, bit for bit, as that of ``AxisMotion`` with ``SimulatedDrives``.

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
    transform, memory = Transform.of(machine), memory_of(period, model.lag)
    r = np.ascontiguousarray(positions, dtype=float)
    rate = np.gradient(r, period, axis=0) if velocities is None else velocities
    rate = np.ascontiguousarray(rate, dtype=float)
    start = np.stack([r[0], np.zeros_like(r[0])])
    x, v = drive(*model.discretise(period), start, r[0], np.zeros_like(r[0]), r, rate)
    commanded = transform.forward(r)[0]
    tip, axis = transform.forward(x)
    trail = np.concatenate([np.tile(commanded[:1], (memory - 1, 1)), commanded])
    held = np.concatenate([np.tile(r[:1], (BEFORE, 1)), r])
    shares = limit_shares(held, largest_differences(machine.limits, period))
    return Recording(
        position=x,
        velocity=v,
        following_error=r - x,
        tip=tip,
        axis=axis,
        tip_lag=np.sqrt(np.sum((tip - commanded) ** 2, axis=1)),
        contour_error=path_errors(trail, tip, memory),
        largest_use=np.abs(shares).max(axis=1),
    )
