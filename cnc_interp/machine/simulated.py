"""
The simulated machine: drives with following error, soft limits and the states of a machine tool.

It steps one period at a time, or through a whole motion at once. No clock, no ROS.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.differences import BEFORE, largest_differences, limit_shares
from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.machine.drive_model import Drives, drive
from cnc_interp.machine.setpoint_checks import beyond_travel
from cnc_interp.machine.states import FOLLOWING, Event, State, state_after

# A step this many times faster than an axis can go is no setpoint but a fault of the sender.
GROSS = 1.5
# The path on which the contour error is measured reaches back by this many lags of the drives.
LAGS_REMEMBERED = 5.0
LONGEST_MEMORY = 1000


@dataclass(frozen=True)
class Feedback:
    """
    What the machine reports after one period.

    Parameters
    ----------
    state : State
        State of the machine.
    message : str
        Why it is in FAULT, else empty.
    setpoint, position, velocity, following_error : ndarray, shape (n_axes,)
        Commanded and actual axes and their difference [m, rad, per s].
    tip, axis : ndarray, shape (3,)
        Actual tool tip [m] and tool axis [-] in W.
    tip_lag : float
        Distance of the actual tip from the commanded tip [m].
    contour_error : float
        Distance of the actual tip from the path of the latest commanded tips [m].
    feedrate : float
        Actual speed of the tip relative to the workpiece, over this period [m/s].

    """

    state: State
    message: str
    setpoint: FloatArray
    position: FloatArray
    velocity: FloatArray
    following_error: FloatArray
    tip: FloatArray
    axis: FloatArray
    tip_lag: float
    contour_error: float
    feedrate: float


@dataclass(frozen=True)
class Recording:
    """
    A whole run of the drives: the arrays of `Feedback`, one row per setpoint.

    Parameters
    ----------
    position, velocity, following_error : ndarray, shape (K, n_axes)
        Actual axes [m, rad, per s].
    tip, axis : ndarray, shape (K, 3)
        Actual tool tip [m] and tool axis [-].
    tip_lag, contour_error : ndarray, shape (K,)
        Distances from the commanded tip and from the commanded path [m].
    largest_use : ndarray, shape (3, n_axes)
        Largest velocity, acceleration and jerk of the setpoints over their limits.

    """

    position: FloatArray
    velocity: FloatArray
    following_error: FloatArray
    tip: FloatArray
    axis: FloatArray
    tip_lag: FloatArray
    contour_error: FloatArray
    largest_use: FloatArray


class SimulatedMachine:
    """
    A machine that follows setpoints one period at a time.

    Parameters
    ----------
    machine : Machine
        Axes, limits, travel and geometry.
    period : float
        Interpolation period [s].
    position : ndarray, shape (n_axes,)
        Where the axes stand when it is switched on [m, rad].
    drives : Drives
        Parameters of the drives.

    """

    def __init__(
        self, machine: Machine, period: float, position: FloatArray, drives: Drives | None = None
    ):
        if not 0.0 < period < np.inf:
            raise StreamError('the interpolation period must be positive')
        self.machine, self.period, self.drives = machine, period, drives or Drives()
        self.state, self.message = State.INACTIVE, ''
        self._transform = Transform.of(machine)
        self._model = self.drives.discretise(period)
        lag = 1.0 / self.drives.position_gain + self.drives.time_constant
        self._memory = min(LONGEST_MEMORY, int(np.ceil(LAGS_REMEMBERED * lag / period)) + 1)
        self._largest = largest_differences(machine.limits, period)
        self.place(position)

    def place(self, position: FloatArray) -> None:
        """Set the axes at rest somewhere, without moving there, and forget all figures."""
        start = np.array(position, dtype=float)
        fault = self._fault_of_position(start)
        if fault:
            raise StreamError(fault)
        self.setpoints = np.tile(start, (4, 1))
        self._axes = np.stack([start, np.zeros_like(start)])
        self._velocity = np.zeros_like(start)
        self._tip = self._transform.forward(start[None, :])[0][0]
        self._tips = np.tile(self._tip, (self._memory, 1))
        self.largest_use = np.zeros_like(self._largest)
        self._recent_use = np.zeros_like(self._largest)

    def handle(self, event: Event, message: str = '') -> State:
        """
        Change the state by the table.

        Raises
        ------
        StreamError
            If the event is not possible in this state; the state stays.

        """
        following = state_after(self.state, event)
        if event is Event.FAIL:
            self.message = message or self.message or 'fault; reset to go on'
        elif message or event not in (Event.HOLD, Event.STOP):
            self.message = message
        self.state = following
        return following

    def step(self, setpoint: FloatArray, velocity: FloatArray) -> Feedback:
        """
        Follow one setpoint for one period, or refuse it and go to FAULT.

        Raises
        ------
        StreamError
            If the machine does not follow setpoints in its state.

        """
        if self.state not in FOLLOWING:
            raise StreamError(f'setpoint while {self.state.value}; activate and start first')
        wanted = np.array(setpoint, dtype=float)
        fault = self._fault_of_step(wanted, np.asarray(velocity, dtype=float))
        if fault:
            self.handle(Event.FAIL, fault)
            return self.rest()
        return self._advance(wanted, np.array(velocity, dtype=float))

    def rest(self) -> Feedback:
        """Let one period pass at the last setpoint, with the drives settling."""
        return self._advance(self.setpoints[-1], np.zeros_like(self._velocity))

    def simulate(self, positions: FloatArray, velocities: FloatArray | None = None) -> Recording:
        """
        Run all setpoints at once from rest at the first one; the same as stepping through them.

        Parameters
        ----------
        positions : ndarray, shape (K, n_axes)
            Setpoints [m, rad].
        velocities : ndarray, shape (K, n_axes), optional
            Their velocities; central differences when not given [per s].

        """
        r = np.ascontiguousarray(positions, dtype=float)
        rate = np.gradient(r, self.period, axis=0) if velocities is None else velocities
        rate = np.ascontiguousarray(rate, dtype=float)
        at_rest = np.stack([r[0], np.zeros_like(r[0])])
        x, v = drive(*self._model, at_rest, r[0], np.zeros_like(r[0]), r, rate)
        commanded = self._transform.forward(r)[0]
        tip, axis = self._transform.forward(x)
        trail = np.concatenate([np.tile(commanded[:1], (self._memory - 1, 1)), commanded])
        error = _path_errors(trail, tip, self._memory)
        held = np.concatenate([np.tile(r[:1], (BEFORE, 1)), r])
        largest_use = np.abs(limit_shares(held, self._largest)).max(axis=1)
        lag = np.sqrt(np.sum((tip - commanded) ** 2, axis=1))
        return Recording(x, v, r - x, tip, axis, lag, error, largest_use)

    def _advance(self, setpoint: FloatArray, velocity: FloatArray) -> Feedback:
        x, v = drive(
            *self._model, self._axes, self.setpoints[-1], self._velocity, setpoint[None, :],
            velocity[None, :],
        )  # fmt: skip
        self._axes, self._velocity = np.stack([x[0], v[0]]), velocity
        self.setpoints = np.concatenate([self.setpoints[1:], setpoint[None, :]])
        use = np.abs(limit_shares(self.setpoints, self._largest))[:, 0]
        self.largest_use = np.maximum(self.largest_use, use)
        self._recent_use = np.maximum(self._recent_use, use)
        tips, axes = self._transform.forward(np.stack([x[0], setpoint]))
        self._tips = np.concatenate([self._tips[1:], tips[1:]])
        lag = float(np.sqrt(np.sum((tips[0] - tips[1]) ** 2)))
        error = float(_path_errors(self._tips, tips[:1], self._memory)[0])
        feedrate = float(np.sqrt(np.sum((tips[0] - self._tip) ** 2))) / self.period
        self._tip = tips[0]
        return Feedback(
            self.state, self.message, setpoint, x[0], v[0], setpoint - x[0], tips[0], axes[0],
            lag, error, feedrate,
        )  # fmt: skip

    def take_recent_use(self) -> FloatArray:
        """Return the largest use of each limit since the last call, shape (3, n_axes) [-]."""
        recent: FloatArray = self._recent_use
        self._recent_use = np.zeros_like(recent)
        return recent

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
def _path_errors(trail: Any, tips: Any, memory: int) -> Any:
    """Measure each tip against the chords of the ``memory`` commanded tips up to its own."""
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
