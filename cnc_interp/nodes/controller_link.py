"""The topics of a trajectory controller of ros2_control, served by a separate thread."""

import threading
from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import rclpy
from builtin_interfaces.msg import Duration, Time
from rclpy.experimental import EventsExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from cnc_interp.machine.trajectory_drives import JointReport, Trajectory
from cnc_interp.nodes.qos import FEEDBACK, TRAJECTORY
from cnc_interp.wire.path_messages import packed

SECOND = 10**9


def joint_trajectory(trajectory: Trajectory, joints: Sequence[str]) -> JointTrajectory:
    """Return a trajectory as a message with accelerations; controllers then use quintics."""
    message = JointTrajectory(joint_names=list(joints))
    message.header.stamp = Time(**_parts(trajectory.start))
    rows = trajectory.rows
    message.points = [
        JointTrajectoryPoint(
            positions=packed(rows.position[k]),
            velocities=packed(rows.velocity[k]),
            accelerations=packed(rows.acceleration[k]),
            time_from_start=Duration(**_parts(int(trajectory.times[k]))),
        )
        for k in range(len(rows))
    ]
    return message


def joint_report(message: JointState, joints: Sequence[str]) -> JointReport | None:
    """Return position and velocity of ``joints``; None if a position is missing or not finite."""
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


SPIN_TIMEOUT = 0.1  #: Time after which the thread checks again whether it must end [s].


class ControllerLink:
    """The topics of the controller, on a node of their own: it runs while machine_node waits."""

    def __init__(self, namespace: str, values: Mapping[str, Any], joints: Sequence[str]):
        self._joints, controller = joints, values['controller']
        feedback, speed = values['controller_feedback'], values['controller_speed']
        self._full, self._speed = values['controller_full_speed'], 1.0
        alone = {'namespace': namespace, 'use_global_arguments': False}
        self._node = rclpy.create_node('controller_link', **alone)
        topic = f'{controller}/joint_trajectory'
        self._trajectories = self._node.create_publisher(JointTrajectory, topic, TRAJECTORY)
        self._node.create_subscription(JointState, feedback, self._hear, FEEDBACK)
        if speed:
            self._node.create_subscription(Float64, speed, self._hear_speed, FEEDBACK)
        self.name = f'controller {controller}, positions on {feedback}'
        self._clock = self._node.get_clock()
        self._reports: deque[JointReport] = deque(maxlen=10_000)
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._spin, name='controller', daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        executor = EventsExecutor()
        executor.add_node(self._node)
        while not self._ends.is_set() and rclpy.ok():
            executor.spin_once(timeout_sec=SPIN_TIMEOUT)
        executor.remove_node(self._node)
        executor.shutdown()

    def _hear(self, message: JointState) -> None:
        report = joint_report(message, self._joints)
        if report is not None:
            self._reports.append(report)

    def _hear_speed(self, message: Float64) -> None:
        self._speed = message.data / self._full

    def speed(self) -> float:
        return self._speed

    def now(self) -> int:
        return int(self._clock.now().nanoseconds)

    def listens(self) -> bool:
        return bool(self._trajectories.get_subscription_count())

    def send(self, trajectory: Trajectory) -> None:
        self._trajectories.publish(joint_trajectory(trajectory, self._joints))

    def take_reports(self) -> list[JointReport]:
        return [self._reports.popleft() for _ in range(len(self._reports))]

    def close(self) -> None:
        self._ends.set()
        self._thread.join()
        self._node.destroy_node()
