"""Trajectories and joint states: what drives and a controller of ros2_control exchange."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from typing import Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from sensor_msgs.msg import JointState
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine.trajectory_drives import JointReport, Trajectory

SECOND = 10**9


def joint_trajectory(trajectory: Trajectory, joints: Sequence[str]) -> JointTrajectory:
    """
    Turn a trajectory into its message.

    Parameters
    ----------
    trajectory : Trajectory
        Points with position, velocity and acceleration, so that a controller takes quintics.
    joints : sequence of str
        Names of the joints, one for each axis.

    """
    message = JointTrajectory(joint_names=list(joints))
    message.header.stamp = Time(**_parts(trajectory.start))
    rows = trajectory.rows
    message.points = [
        JointTrajectoryPoint(
            positions=_packed(rows.position[k]),
            velocities=_packed(rows.velocity[k]),
            accelerations=_packed(rows.acceleration[k]),
            time_from_start=Duration(**_parts(int(trajectory.times[k]))),
        )
        for k in range(len(rows))
    ]
    return message


def joint_report(message: JointState, joints: Sequence[str]) -> JointReport | None:
    """
    Read the axes from joint states, in whatever order; None if one is missing or not a number.

    Velocities that are not reported count as 0.
    """
    places = {name: k for k, name in enumerate(message.name)}
    chosen = [places.get(name, -1) for name in joints]
    if min(chosen) < 0 or max(chosen) >= len(message.position):
        return None
    position = np.array(message.position)[chosen]
    velocity = np.zeros(len(chosen))
    if max(chosen) < len(message.velocity):
        velocity = np.nan_to_num(np.array(message.velocity)[chosen])
    if not np.isfinite(position).all():
        return None
    stamp = message.header.stamp
    return JointReport(stamp.sec * SECOND + stamp.nanosec, position, velocity)


def _parts(nanoseconds: int) -> dict[str, Any]:
    return {'sec': nanoseconds // SECOND, 'nanosec': nanoseconds % SECOND}


def _packed(row: FloatArray) -> array[float]:
    return array('d', row.tobytes())
