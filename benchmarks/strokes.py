"""Strokes of one axis, and their minimum time by ruckig's closed form."""

from __future__ import annotations

import numpy as np
import ruckig

from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine


def line_path(length: float) -> AxisPath:
    """Make a stroke of the X axis alone, without programmed feed."""
    jet = np.zeros((4, 2, 5))
    jet[0, :, 0], jet[1, :, 0] = (0.0, length), 1.0
    return AxisPath(
        s=np.array([0.0, length]),
        cell_left=jet[:, :1].copy(),
        cell_right=jet[:, 1:].copy(),
        tip=jet[0, :, :3].copy(),
        axis=np.tile([0.0, 0.0, 1.0], (2, 1)),
        cell_feed=np.array([np.inf]),
        cell_block=np.array([0]),
        stop=np.array([True, True]),
    )


def stroke_time(length: float, machine: Machine) -> float:
    """Time of the time-optimal stroke of the X axis from rest to rest [s]."""
    wanted, found = ruckig.InputParameter(1), ruckig.Trajectory(1)
    wanted.current_position, wanted.target_position = [0.0], [length]
    wanted.max_velocity = [float(machine.max_velocity[0])]
    wanted.max_acceleration = [float(machine.max_acceleration[0])]
    wanted.max_jerk = [float(machine.max_jerk[0])]
    ruckig.Ruckig(1).calculate(wanted, found)
    return float(found.duration)
