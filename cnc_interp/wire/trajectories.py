"""Coming setpoints as `trajectory_msgs/JointTrajectory`, the message of ros2_control."""

from __future__ import annotations

from typing import Any

from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from cnc_interp.kinematics.machine import Machine
from cnc_interp.run.interpolator import Setpoints

#: Time between points; the controller interpolates between them [s].
SPACING = 0.004


def joint_trajectory(
    rows: Setpoints, machine: Machine, period: float, stamp: Any
) -> JointTrajectory:
    """
    Turn setpoints into a trajectory that replaces the one before.

    It ends with the stop tail: where no other follows, the controller comes to rest on the path.

    Parameters
    ----------
    rows : Setpoints
        Setpoints to come, the last one at rest.
    machine : Machine
        Its axis names are the joint names.
    period : float
        Interpolation period [s].
    stamp : Time
        When the first setpoint is due, less one period.

    """
    step = max(1, round(SPACING / period))
    chosen = list(range(step - 1, len(rows), step))
    if not chosen or chosen[-1] != len(rows) - 1:
        chosen.append(len(rows) - 1)
    message = JointTrajectory(joint_names=list(machine.axis_names))
    message.header.stamp = stamp
    for k in chosen:
        nanoseconds = round((k + 1) * period * 1e9)
        message.points.append(
            JointTrajectoryPoint(
                positions=rows.position[k].tolist(),
                velocities=rows.velocity[k].tolist(),
                accelerations=rows.acceleration[k].tolist(),
                time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9),
            )
        )
    return message
