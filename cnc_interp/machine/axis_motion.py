"""
Setpoints on their way to the drives: checked before, measured after; no clock, no states.

It does not know which drives it has, see ``drives.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.differences import largest_differences, limit_shares
from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.drives import Drives
from cnc_interp.machine.setpoint_checks import beyond_travel

#: A setpoint that asks an axis for this many times its largest velocity is an error of the sender.
GROSS = 1.5
#: The path on which the contour error is measured reaches back by this many lags of the drives.
LAGS_REMEMBERED = 5.0
LONGEST_MEMORY = 1000


class SetpointRefusedError(StreamError):
    """A setpoint outside the travel, or a jump."""


@dataclass(frozen=True)
class Feedback:
    """
    What the axes did in one period.

    Parameters
    ----------
    setpoint, position, velocity, following_error : ndarray, shape (n_axes,)
        Commanded and actual axes, and commanded minus actual position [m, rad, per s].
    tip, axis : ndarray, shape (3,)
        Actual tool tip [m] and tool axis [-] in W.
    tip_lag : float
        Distance of the actual tip from the commanded tip [m].
    contour_error : float
        Distance of the actual tip from the path of the latest commanded tips [m].
    feedrate : float
        Actual speed of the tip relative to the workpiece, over this period [m/s].

    """

    setpoint: FloatArray
    position: FloatArray
    velocity: FloatArray
    following_error: FloatArray
    tip: FloatArray
    axis: FloatArray
    tip_lag: float
    contour_error: float
    feedrate: float


def memory_of(period: float, lag: float) -> int:
    """Return how many commanded tips the contour error is measured against."""
    return min(LONGEST_MEMORY, int(np.ceil(LAGS_REMEMBERED * lag / period)) + 1)


class AxisMotion:
    """
    The axes of the machine, one setpoint per period.

    Parameters
    ----------
    machine : Machine
        Axes, limits, travel and geometry.
    period : float
        Interpolation period [s].
    drives : Drives
        What moves the axes.

    Raises
    ------
    StreamError
        If the period is not positive or an axis stands outside its travel.

    """

    def __init__(self, machine: Machine, period: float, drives: Drives):
        if not 0.0 < period < np.inf:
            raise StreamError('the interpolation period must be positive')
        self.machine, self.period, self._drives = machine, period, drives
        self._transform = Transform.of(machine)
        self._memory = memory_of(period, drives.lag)
        self._largest = largest_differences(machine.limits, period)
        self._recent_use = np.zeros_like(self._largest)
        self.largest_use = np.zeros_like(self._largest)
        self._place(drives.rest().position)

    def switch_on(self) -> None:
        """Switch the drives on; the axes are held where they stand."""
        self._place(self._drives.switch_on())

    def switch_off(self) -> None:
        """Switch the drives off."""
        self._drives.switch_off()

    def _place(self, position: FloatArray) -> None:
        """Take where the axes stand as the last setpoint."""
        start = np.array(position, dtype=float)
        fault = self._fault_of_position(start)
        if fault:
            raise StreamError(fault)
        self.setpoints = np.tile(start, (4, 1))
        self._tip = self._transform.forward(start[None, :])[0][0]
        self._tips = np.tile(self._tip, (self._memory, 1))

    def follow(self, setpoint: FloatArray, velocity: FloatArray) -> Feedback:
        """
        Follow one setpoint for one period.

        Parameters
        ----------
        setpoint : ndarray, shape (n_axes,)
            Axis coordinates at the end of the period [m, rad].
        velocity : ndarray, shape (n_axes,)
            Axis velocities there [m/s, rad/s].

        Raises
        ------
        SetpointRefusedError
            If the setpoint leaves the travel or jumps. The drives are not told.
        DriveFaultError
            If a drive has failed.

        """
        wanted, rate = np.array(setpoint, dtype=float), np.array(velocity, dtype=float)
        fault = self._fault_of_step(wanted, rate)
        if fault:
            raise SetpointRefusedError(fault)
        actual = self._drives.follow(wanted, rate)
        return self._measured(wanted, actual.position, actual.velocity)

    def rest(self) -> Feedback:
        """Hold the last setpoint for one period; the drives settle."""
        actual = self._drives.rest()
        return self._measured(self.setpoints[-1], actual.position, actual.velocity)

    def forget_use(self) -> None:
        """Start the largest use of the limits anew."""
        self.largest_use = np.zeros_like(self.largest_use)

    def take_recent_use(self) -> FloatArray:
        """Return the largest use of each limit since the last call, shape (3, n_axes) [-]."""
        recent: FloatArray = self._recent_use
        self._recent_use = np.zeros_like(recent)
        return recent

    def _measured(self, setpoint: FloatArray, x: FloatArray, v: FloatArray) -> Feedback:
        """Compare what was asked for with what the drives did."""
        self.setpoints = np.concatenate([self.setpoints[1:], setpoint[None, :]])
        use = np.abs(limit_shares(self.setpoints, self._largest))[:, 0]
        self.largest_use = np.maximum(self.largest_use, use)
        self._recent_use = np.maximum(self._recent_use, use)
        tips, axes = self._transform.forward(np.stack([x, setpoint]))
        self._tips = np.concatenate([self._tips[1:], tips[1:]])
        lag = float(np.sqrt(np.sum((tips[0] - tips[1]) ** 2)))
        error = float(path_errors(self._tips, tips[:1], self._memory)[0])
        feedrate = float(np.sqrt(np.sum((tips[0] - self._tip) ** 2))) / self.period
        self._tip = tips[0]
        return Feedback(setpoint, x, v, setpoint - x, tips[0], axes[0], lag, error, feedrate)

    def _fault_of_position(self, wanted: FloatArray) -> str:
        names = self.machine.axis_names
        if wanted.shape != (len(names),) or not np.isfinite(wanted).all():
            return f'setpoint must be {len(names)} finite numbers, not {wanted.tolist()}'
        beyond = beyond_travel(self.machine, wanted[None, :])
        return f'{beyond}; reset and move inside' if beyond else ''

    def _fault_of_step(self, wanted: FloatArray, velocity: FloatArray) -> str:
        fault = self._fault_of_position(wanted)
        if fault:
            return fault
        if velocity.shape != wanted.shape or not np.isfinite(velocity).all():
            return f'setpoint velocity must be {len(wanted)} finite numbers'
        use = np.abs(wanted - self.setpoints[-1]) / self._largest[0]
        if (use > GROSS).any():
            k = int(np.argmax(use))
            return (
                f'{self.machine.axis_names[k]} asked to jump at {use[k]:.3g} times its largest '
                'velocity; setpoints lost or out of order, reset and restart the program'
            )
        return ''


@njit(cache=True, nogil=True)
def path_errors(trail: FloatArray, tips: FloatArray, memory: int) -> FloatArray:
    """
    Measure each tip against the chords of the ``memory`` commanded tips up to its own.

    Parameters
    ----------
    trail : ndarray, shape (K + memory - 1, 3)
        Commanded tips [m].
    tips : ndarray, shape (K, 3)
        Actual tips [m].
    memory : int
        Commanded tips that count for one actual tip.

    Returns
    -------
    ndarray, shape (K,)
        Distances [m].

    """
    errors = np.empty(len(tips))
    for i in range(len(tips)):
        nearest = np.inf
        for k in range(i, i + memory - 1):
            along, length_sq = 0.0, 0.0
            for c in range(3):
                chord = trail[k + 1, c] - trail[k, c]
                along += (tips[i, c] - trail[k, c]) * chord
                length_sq += chord * chord
            part = min(1.0, max(0.0, along / length_sq)) if length_sq > 0.0 else 0.0
            distance_sq = 0.0
            for c in range(3):
                gap = tips[i, c] - trail[k, c] - part * (trail[k + 1, c] - trail[k, c])
                distance_sq += gap * gap
            nearest = min(nearest, distance_sq)
        errors[i] = np.sqrt(nearest)
    return errors
