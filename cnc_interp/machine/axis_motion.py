"""Compare the motion of the axes with its setpoints: errors and use of limits; without a clock."""

import math
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, StreamError, norm
from cnc_interp.core.kernels import njit
from cnc_interp.drives.drive_model import memory_of
from cnc_interp.drives.tool_error import AHEAD, on_chord
from cnc_interp.kinematics.path_checks import TRAVEL_SLACK
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, reached
from cnc_interp.run.setpoints import BEFORE, Setpoints, largest_shares, torque_shares

#: Factor on a limit within which differences of setpoints are accepted, for rounding [-].
ROUNDING = 1.01


def beyond_travel(machine: Machine, positions: FloatArray) -> str:
    """Return a text with the first axis that would leave its travel, and where; else ''."""
    travel = machine.travel
    outside = (positions < travel[:, 0] - TRAVEL_SLACK) | (positions > travel[:, 1] + TRAVEL_SLACK)
    if not outside.any():
        return ''
    row, k = (int(x[0]) for x in np.nonzero(outside))
    return (
        f'soft limit: {machine.axis_names[k]} to {positions[row, k]:.6g}, travel is '
        f'{travel[k, 0]:.6g} to {travel[k, 1]:.6g} (m, rad)'
    )


def refuse_setpoints(
    machine: Machine, period: float, before: FloatArray, positions: FloatArray
) -> None:
    """Reject setpoints that leave the travel or break a limit; StreamError with axis and value.

    ``before`` (3, n_axes): the last setpoints before them; ``positions`` (K, n_axes) must end at
    rest [m, rad].
    """
    beyond = beyond_travel(machine, positions)
    if beyond:
        raise StreamError(f'{beyond}; move the workpiece or the program')
    parts = [before, positions, np.tile(positions[-1:], (3, 1))]
    course = np.concatenate(parts)
    uses = [*largest_shares(course, machine.limits, period)]
    if machine.limits.loads:
        uses.append(torque_shares(course, machine.limits, period).max(axis=0))
    for use, what in zip(uses, ('velocity', 'acceleration', 'jerk', 'torque'), strict=False):
        if not use.max() <= ROUNDING:
            k = int(np.argmax(use))
            raise StreamError(
                f'{machine.axis_names[k]} asked for {use.max():.4g} times its largest {what}; '
                'setpoints were spoilt on their way, lost, or made for another machine'
            )


GROSS = 1.5  #: A velocity above this multiple of the limit is an error of the sender [-].


@dataclass(frozen=True)
class Recording:
    """The motion of the axes in K periods, one row each."""

    #: (K, n_axes): Commanded and actual axes, and commanded minus actual position [m, rad, per s].
    #: Drives with a FIFO answer an earlier setpoint; their errors count from that one.
    setpoint: FloatArray
    position: FloatArray
    velocity: FloatArray
    following_error: FloatArray
    #: (K, 3): Actual tool tip [m] and tool axis [-] in W.
    tip: FloatArray
    axis: FloatArray
    #: (K,): Distance of the actual tip from the path of the commanded tips [m]. It belongs to the
    #: tip of a few periods earlier; see ``ContourErrors``.
    contour_error: FloatArray
    feedrate: FloatArray  #: (K,): Actual speed of the tip relative to the workpiece [m/s].
    #: (3, n_axes): Largest velocity, acceleration and jerk of the setpoints over their limits [-];
    #: torques count as accelerations.
    largest_use: FloatArray


class ContourErrors:
    """Distances of actual tips from the commanded path; later tips count too: drives may lead."""

    def __init__(self, period: float, lag: float, tip: FloatArray):
        late = math.ceil(AHEAD / period)
        self._memory = memory_of(period, lag) + late
        self._trail = np.tile(tip, (self._memory - 1, 1))
        self._waiting = np.tile(tip, (late, 1))

    def push(self, commanded: FloatArray, tips: FloatArray) -> FloatArray:
        """Take commanded and actual tips (K, 3); return K distances, ``AHEAD`` periods late."""
        trail = np.concatenate([self._trail, commanded])
        waiting = np.concatenate([self._waiting, tips])
        self._trail, self._waiting = trail[1 - self._memory :], waiting[len(tips) :]
        return path_errors(trail, waiting[: len(tips)], self._memory)


class AxisMotion:
    def __init__(self, machine: Machine, period: float, lag: float, position: FloatArray):
        if not 0.0 < period < np.inf:
            raise StreamError('the interpolation period must be positive')
        self.machine, self.period = machine, period
        self._transform = Transform.of(machine)
        self._lag, self._limits = lag, machine.limits
        self._longest_step: FloatArray = machine.max_velocity * period
        self._recent_use = self.largest_use = np.zeros_like(machine.limits.by_order)
        self.place(position)

    @property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Smallest and largest setpoint, and the largest step between two; see ``fault_of``."""
        slack = np.array([-TRAVEL_SLACK, TRAVEL_SLACK])
        return self.machine.travel + slack, GROSS * self._longest_step

    def place(self, position: FloatArray) -> None:
        start = np.array(position, dtype=float)
        beyond = beyond_travel(self.machine, start[None, :])
        if beyond:
            raise StreamError(f'{beyond}; reset and move inside')
        self.setpoints = np.tile(start, (BEFORE, 1))
        self._tip = reached(self._transform, start[None, :])[0]
        self._contour = ContourErrors(self.period, self._lag, self._tip[0])

    def nominal(self, commanded: FloatArray) -> FloatArray:
        """Return nominal axes, which an operator sees, for those of the drives; any shape."""
        rows = commanded.reshape(-1, len(self.machine.axis_names))
        return self._transform.errors.nominal(rows).reshape(commanded.shape)

    def tip_speeds(self, rows: Setpoints) -> FloatArray:
        """Return how fast setpoints move the tip over the workpiece, (K,) [m/s]."""
        step = rows.velocity * (0.5 * self.period)
        ends = [self._transform.forward(rows.position + way)[0] for way in (step, -step)]
        return norm(ends[0] - ends[1]) / self.period

    def measure(
        self,
        setpoints: FloatArray,
        x: FloatArray,
        v: FloatArray,
        answered: FloatArray | None = None,
    ) -> Recording:
        """Compare setpoints with the motion of the drives in the next periods."""
        answered = setpoints if answered is None else answered
        held = np.concatenate([self.setpoints, setpoints])
        use = largest_shares(held, self._limits, self.period)
        if self._limits.loads:
            torques = torque_shares(held, self._limits, self.period)
            use[1] = np.maximum(use[1], torques.max(axis=0))
        self.setpoints = held[-BEFORE:]
        self.largest_use = np.maximum(self.largest_use, use)
        self._recent_use = np.maximum(self._recent_use, use)
        commanded = reached(self._transform, answered)[0]
        tip, axis = reached(self._transform, x)
        moves = np.diff(np.concatenate([self._tip, tip]), axis=0)
        self._tip = tip[-1:]
        return Recording(
            setpoint=setpoints,
            position=x,
            velocity=v,
            following_error=answered - x,
            tip=tip,
            axis=axis,
            contour_error=self._contour.push(commanded, tip),
            feedrate=np.sqrt(np.sum(moves**2, axis=1)) / self.period,
            largest_use=use,
        )

    def take_recent_use(self) -> FloatArray:
        """Return the largest use of each limit since the last call, shape (3, n_axes) [-]."""
        recent, self._recent_use = self._recent_use, np.zeros_like(self._recent_use)
        return recent

    def fault_of(self, wanted: FloatArray, velocity: FloatArray) -> str:
        """Return why a setpoint and its velocity cannot follow the last one; '' if they can."""
        count = len(self.machine.axis_names)
        if not (np.isfinite(wanted).all() and np.isfinite(velocity).all()):
            return f'setpoint and its velocity must be {count} finite numbers each'
        beyond = beyond_travel(self.machine, wanted[None, :])
        if beyond:
            return f'{beyond}; reset and move inside'
        use = np.abs(wanted - self.setpoints[-1]) / self._longest_step
        k = int(np.argmax(use))
        if use[k] <= GROSS:
            return ''
        return (
            f'{self.machine.axis_names[k]} asked to jump at {use[k]:.3g} times its largest '
            'velocity; setpoints lost or out of order, reset and restart the program'
        )


@njit(cache=True, nogil=True)
def path_errors(trail: FloatArray, tips: FloatArray, memory: int) -> FloatArray:
    """Measure each tip against the chords of the ``memory`` commanded tips up to its own."""
    errors = np.empty(len(tips))
    for i in range(len(tips)):
        nearest = np.inf
        for k in range(i, i + memory - 1):
            nearest = min(nearest, on_chord(trail, k, tips[i])[1])
        errors[i] = np.sqrt(nearest)
    return errors
