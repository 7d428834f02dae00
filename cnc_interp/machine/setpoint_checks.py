"""Checks of setpoints before the drives follow them: travel and limits."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.differences import limit_shares, torque_shares
from cnc_interp.core.errors import StreamError
from cnc_interp.kinematics.path_checks import TRAVEL_SLACK
from cnc_interp.machine_model.machine import Machine

# Differences of valid setpoints exceed a limit by rounding at most.
ROUNDING = 1.01


def beyond_travel(machine: Machine, positions: FloatArray) -> str:
    """Return which axis would leave its travel first and where, in words; empty if none does."""
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
    """
    Refuse setpoints that leave the travel or break a limit, before they are executed.

    Parameters
    ----------
    machine : Machine
        Axes, limits and travel.
    period : float
        Interpolation period [s].
    before : ndarray, shape (3, n_axes)
        Setpoints before them [m, rad].
    positions : ndarray, shape (K, n_axes)
        The setpoints, which must end at rest [m, rad].

    Raises
    ------
    StreamError
        With axis, value and limit.

    """
    beyond = beyond_travel(machine, positions)
    if beyond:
        raise StreamError(f'{beyond}; move the workpiece or the program')
    parts = [before, positions, np.tile(positions[-1:], (3, 1))]
    course = np.concatenate(parts)
    table = machine.limit_table
    shares = [*np.abs(limit_shares(course, table, period)), torque_shares(course, table, period)]
    for use, what in zip(shares, ('velocity', 'acceleration', 'jerk', 'torque'), strict=True):
        if not use.max() <= ROUNDING:
            k = int(np.argmax(use.max(axis=0)))
            raise StreamError(
                f'{machine.axis_names[k]} asked for {use.max():.4g} times its largest {what}; '
                'setpoints were spoilt on their way, lost, or made for another machine'
            )
