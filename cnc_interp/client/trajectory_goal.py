"""Execute a finished plan as one FollowJointTrajectory goal of a ros2_control controller."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import numpy as np
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState

from cnc_interp.client.served_node import ServedNode
from cnc_interp.core import DEG, MM, FloatArray, InterpError
from cnc_interp.machine.drives import AxisRows
from cnc_interp.machine.trajectory_drives import SPACING, Trajectory
from cnc_interp.machine_model.machine import Machine
from cnc_interp.nodes.controller_link import joint_report, joint_trajectory
from cnc_interp.nodes.qos import FEEDBACK
from cnc_interp.proof.plan_files import PlanFiles, gathered

PATIENCE = 10.0  #: Longest wait for the controller and for joint positions [s].
AT_START = np.array([0.1 * DEG, 0.1 * MM])  #: Start tolerance of rotary and linear axes.


def trajectory_of(plan: PlanFiles) -> Trajectory:
    """Return a plan as a trajectory: setpoints at the controller's spacing, and the last one.

    Raises InterpError if the plan needs more than motion.
    """
    waits = plan.blocks['line'][np.asarray(plan.blocks['program_stop']) > 0]
    more = [f'line {line} sets an output' for line in plan.functions['line_number'][:1]]
    more += [f'the program waits after line {line}' for line in waits[:1]]
    if more:
        raise InterpError(
            f'{more[0]}, which a goal of FollowJointTrajectory cannot do; '
            'use cnc-interp run --drives trajectory'
        )
    count, step = len(plan.position), max(1, round(SPACING / plan.period))
    chosen = np.unique(np.append(np.arange(0, count, step), count - 1))
    position, velocity, acceleration = (
        gathered(plan.setpoints[name], chosen) for name in ('position', 'velocity', 'acceleration')
    )
    velocity[-1] = acceleration[-1] = 0.0  # exactly, as controllers demand
    rows = AxisRows(position, velocity, acceleration)
    return Trajectory(0, round(plan.period * 1e9) * chosen, rows)


class FollowedPlan:
    """The execution of a trajectory by a controller; ``joints``: names in axis order."""

    def __init__(self, node: ServedNode, controller: str, joints: Sequence[str], feedback: str):
        try:
            from control_msgs.action import FollowJointTrajectory
        except ModuleNotFoundError:
            raise InterpError(
                'control_msgs is not installed: source the ROS 2 workspace of the controller first'
            ) from None
        self._node, self._controller, self._joints = node, controller, list(joints)
        self._goal = FollowJointTrajectory.Goal
        action = f'{controller}/follow_joint_trajectory'
        self._client = ActionClient(node.node, FollowJointTrajectory, action)
        self._position: FloatArray | None = None
        node.node.create_subscription(JointState, feedback, self._hear, FEEDBACK)
        self._wait(self._client.server_is_ready, PATIENCE, f'nobody offers the action {action}')
        told = f'{feedback} does not report {" ".join(joints)}'
        self._wait(lambda: self._position is not None, PATIENCE, told)
        self.done = 0.0  #: Trajectory time that has been executed [s].
        self.errors = np.zeros(len(joints))  #: Largest following error of each axis [m, rad].

    def _hear(self, message: JointState) -> None:
        if (report := joint_report(message, self._joints)) is not None:
            self._position = report.position

    def _hear_progress(self, message: Any) -> None:
        at = message.feedback.desired.time_from_start
        self.done = at.sec + 1e-9 * at.nanosec
        places = [message.feedback.joint_names.index(name) for name in self._joints]
        if len(message.feedback.error.positions) == len(places):
            errors = np.abs(np.array(message.feedback.error.positions)[places])
            self.errors = np.maximum(self.errors, errors)

    def _wait(self, done: Callable[[], Any], patience: float, otherwise: str) -> None:
        deadline = time.monotonic() + patience
        while not done():
            if time.monotonic() > deadline:
                raise InterpError(otherwise)
            self._node.serve()

    def refuse_elsewhere(self, machine: Machine, first: FloatArray) -> None:
        """Raise InterpError if the joints are not at ``first``, the first setpoint [m, rad]."""
        assert self._position is not None
        away = self._position - first
        for k in np.flatnonzero(np.abs(away) > AT_START[machine.is_linear.astype(int)]).tolist():
            unit, word = (MM, 'mm') if machine.is_linear[k] else (DEG, 'deg')
            raise InterpError(
                f'{self._joints[k]} is at {self._position[k] / unit:.3f} {word}, but the plan '
                f'begins at {first[k] / unit:.3f}; move the robot there first'
            )

    def execute(self, trajectory: Trajectory, told: Callable[[float], None]) -> None:
        """Send the goal and wait for its end; cancel it if this process is interrupted.

        Raises InterpError if the controller rejects or aborts it.
        """
        message = joint_trajectory(trajectory, self._joints)
        sent = self._client.send_goal_async(self._goal(trajectory=message), self._hear_progress)
        try:
            self._wait(sent.done, PATIENCE, f'{self._controller} does not answer')
            if not sent.result().accepted:
                raise InterpError(f'{self._controller} rejected the trajectory; its log says why')
            wanted, silent = sent.result().get_result_async(), f'{self._controller} does not go on'
            while not wanted.done():  # a robot may scale its speed
                self._wait(partial(self._goes_on, wanted, self.done), PATIENCE, silent)
                told(self.done)
        except BaseException:
            self._cancel(sent)
            raise
        result = wanted.result().result
        if result.error_code != result.SUCCESSFUL:
            why = result.error_string or f'error {result.error_code}'
            raise InterpError(f'{self._controller} ended the trajectory: {why}')

    def _cancel(self, sent: Any) -> None:
        silent = f'{self._controller} did not confirm the end; stop the robot by its own button'
        self._wait(sent.done, PATIENCE, silent)
        if sent.result().accepted:
            self._wait(sent.result().cancel_goal_async().done, PATIENCE, silent)

    def _goes_on(self, wanted: Any, before: float) -> bool:
        return bool(wanted.done()) or self.done > before
