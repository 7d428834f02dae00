"""The move from where the machine stands to the start pose of a program, in joint space."""

from __future__ import annotations

import numpy as np
import ruckig

from cnc_interp.errors import PlanningError, TravelError
from cnc_interp.interpolator import Setpoints
from cnc_interp.kinematics.machine import Machine
from cnc_interp.program.blocks import FloatArray

#: Share of the limits that the approach uses: sampling may round a limit up.
SHARE = 0.99
#: Axes nearer than this to the start pose stay where they are [m, rad].
THERE = 1e-12


def approach(machine: Machine, period: float, start: FloatArray, end: FloatArray) -> Setpoints:
    """
    Move from rest to rest within the limits of all axes, all arriving together.

    Each axis runs monotonically, so it stays within its travel when both ends do.

    Parameters
    ----------
    machine : Machine
        Limits and travel.
    period : float
        Interpolation period [s].
    start, end : ndarray, shape (n_axes,)
        Axis positions [m, rad].

    Returns
    -------
    Setpoints
        Samples in block 0, the last one at rest at ``end``; none when the machine is there.

    Raises
    ------
    TravelError
        If the start pose lies outside the travel.
    PlanningError
        If no move was found.

    """
    outside = (end < machine.travel[:, 0]) | (end > machine.travel[:, 1])
    if outside.any():
        name = machine.axis_names[int(np.argmax(outside))]
        raise TravelError(f'the start pose is outside the travel of axis {name}', 0, name)
    if np.abs(end - start).max() <= THERE:
        return _samples(np.zeros((3, 0, len(end))), period)
    trajectory = _trajectory(machine, start, end)
    count = int(np.ceil(trajectory.duration / period))
    table = np.array([trajectory.at_time(k * period) for k in range(1, count)])
    at_rest = np.stack([end, np.zeros_like(end), np.zeros_like(end)])
    states = np.concatenate([table.reshape(-1, 3, len(end)), at_rest[None]])
    return _samples(np.swapaxes(states, 0, 1), period)


def _trajectory(machine: Machine, start: FloatArray, end: FloatArray) -> ruckig.Trajectory:
    """Find the fastest synchronised move from rest to rest."""
    n = len(end)
    wanted = ruckig.InputParameter(n)
    wanted.current_position, wanted.target_position = start.tolist(), end.tolist()
    wanted.max_velocity = (SHARE * machine.max_velocity).tolist()
    wanted.max_acceleration = (SHARE * machine.max_acceleration).tolist()
    wanted.max_jerk = (SHARE * machine.max_jerk).tolist()
    trajectory = ruckig.Trajectory(n)
    outcome = ruckig.Ruckig(n).calculate(wanted, trajectory)
    if outcome not in (ruckig.Result.Working, ruckig.Result.Finished):
        raise PlanningError(f'no approach to the start pose was found ({outcome}); jog nearer')
    return trajectory


def _samples(states: FloatArray, period: float) -> Setpoints:
    """Pack position, velocity and acceleration, shape (3, K, n), as setpoints of block 0."""
    position, velocity, acceleration = (np.ascontiguousarray(row) for row in states)
    count = len(position)
    return Setpoints(
        time=np.arange(count) * period,
        position=position,
        velocity=velocity,
        acceleration=acceleration,
        jerk=np.zeros_like(position),
        block=np.zeros(count, dtype=np.int64),
        s=np.zeros(count),
    )
