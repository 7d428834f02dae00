"""
A stand-in for a robot with joint_trajectory_controller and joint_state_broadcaster.

A process of its own, with its own clock and period. It takes trajectories as ``controller_model``
says, moves axes with a lag, and reports them. What it commanded is written to a file, row by row,
and ``StandIn`` reads it. ``tell`` makes it stall, holds an axis fast, or puts it somewhere. Where
``control_msgs`` is installed, it also takes goals of FollowJointTrajectory.
"""

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
import uuid
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / 'unit'))

import rclpy
from controller_model import ControllerModel, time_of
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.duration import Duration
from rclpy.experimental import EventsExecutor
from rclpy.time import Time
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64
from trajectory_msgs.msg import JointTrajectory

from cnc_interp.nodes.node_main import come_first
from cnc_interp.processes.this_host import stay_on_this_host

#: Joints in an order of their own, and the axes of the machine that they are.
JOINTS = ('table_c', 'table_a', 'slide_z', 'slide_y', 'slide_x')
OF_AXES = "['slide_x', 'slide_y', 'slide_z', 'table_a', 'table_c']"
#: Period of the controller, and lag of its axes [s].
PERIOD, LAG = 0.0037, 0.002
#: Numbers in a row: time [ns], whether it lay between points, positions in the order of the axes.
COLUMNS = 2 + len(JOINTS)


class StandIn:
    """Starts the stand-in, and reads what it commanded; use it in ``with``."""

    def __init__(self, domain, environment=()):
        self.name = f'/robot_{uuid.uuid4().hex[:8]}'
        self.environment = os.environ | dict(environment) | {'ROS_DOMAIN_ID': str(domain)}
        self._read = 0

    def parameters(self, delay):
        """Parameters of the machine node that lead to it."""
        return {
            'drives': 'trajectory',
            'controller': f'{self.name}/arm_controller',
            'controller_feedback': f'{self.name}/joint_states',
            'controller_joints': OF_AXES,
            'controller_delay': delay,
            'controller_speed': f'{self.name}/speed_scaling',
            'controller_silence': 4.0,  # a busy computer may hold the stand-in up
        }

    def __enter__(self):
        self._folder = tempfile.TemporaryDirectory(prefix='cnc_interp_robot_')
        self._log = Path(self._folder.name) / 'commanded'
        self._log.touch()
        self._process = subprocess.Popen(
            [sys.executable, __file__, self.name, str(self._log)],
            stdin=subprocess.PIPE,
            env=self.environment,
            text=True,
            start_new_session=True,
        )
        return self

    def tell(self, **order):
        """Let it ``stall``, hold an axis fast (``stuck``: joint, or None), or tell a ``speed``.

        ``at``: positions of JOINTS where it stands from now on, with a ``tolerance``.
        """
        self._process.stdin.write(json.dumps(order) + '\n')
        self._process.stdin.flush()

    def commanded(self):
        """What was commanded since the last call: times [s], between points, positions."""
        assert self._process.poll() is None, 'the stand-in has ended'
        content = np.fromfile(self._log, dtype=float, offset=self._read)
        rows = content[: len(content) // COLUMNS * COLUMNS].reshape(-1, COLUMNS)
        self._read += rows.nbytes
        return rows[:, 0], rows[:, 1] > 0.0, rows[:, 2:]

    @property
    def refusals(self):
        """Why messages were refused, or a motion was aborted, line by line."""
        told = self._log.with_suffix('.told')
        return told.read_text().splitlines() if told.exists() else []

    def __exit__(self, *_):
        self._process.stdin.close()  # it ends then
        self._process.wait()
        self._folder.cleanup()


class Robot:
    """The process: topics, axes, log."""

    def __init__(self, name, log):
        self.node = rclpy.create_node('robot')
        self.log, self.told = log.open('ab', buffering=0), log.with_suffix('.told').open('a')
        self.clock = self.node.get_clock()
        self.axes = np.zeros(len(JOINTS))
        self.model = ControllerModel(JOINTS, self.axes)  # no tolerances, as the docs ask
        self.velocity, self.before = np.zeros(len(JOINTS)), self.clock.now().nanoseconds
        self.node.create_subscription(
            JointTrajectory, f'{name}/arm_controller/joint_trajectory', self.hear, 1
        )
        self.reports = self.node.create_publisher(JointState, f'{name}/joint_states', 10)
        self.speeds = self.node.create_publisher(Float64, f'{name}/speed_scaling', 10)
        self.stall, self.stuck, self.speed = False, None, 100.0
        self.at, self.tolerance, self.goal = None, np.inf, None
        with contextlib.suppress(ModuleNotFoundError):
            from control_msgs.action import FollowJointTrajectory

            self.result = FollowJointTrajectory.Result
            self.progress = FollowJointTrajectory.Feedback
            self.server = ActionServer(
                self.node,
                FollowJointTrajectory,
                f'{name}/arm_controller/follow_joint_trajectory',
                self.end,
                goal_callback=self.admit,
                handle_accepted_callback=self.begin,
                cancel_callback=lambda _: CancelResponse.ACCEPT,
            )

    def admit(self, goal):
        why = self.model.refusal(goal.trajectory, self.clock.now().nanoseconds)
        return GoalResponse.REJECT if why else GoalResponse.ACCEPT

    def begin(self, goal):
        self.goal, self.began = goal, self.clock.now().nanoseconds
        self.length = time_of(goal.request.trajectory.points[-1].time_from_start)
        self.hear(goal.request.trajectory)

    def follow(self, now, wanted):
        """Report the progress of a goal, and end it."""
        progress = self.progress(joint_names=list(JOINTS))
        progress.desired.time_from_start = Duration(nanoseconds=now - self.began).to_msg()
        progress.error.positions = (wanted - self.axes).tolist()
        self.goal.publish_feedback(progress)
        cancelled = self.goal.is_cancel_requested
        if cancelled or self.model.aborted or now > self.began + self.length:
            if cancelled:
                self.model = ControllerModel(JOINTS, self.axes)
                self.say('cancelled')
            goal, self.goal = self.goal, None
            goal.execute()

    def end(self, goal):
        result = self.result()
        if goal.is_cancel_requested:
            goal.canceled()
        elif self.model.aborted:
            result.error_code = result.PATH_TOLERANCE_VIOLATED
            result.error_string = self.model.aborted
            goal.abort()
        else:
            goal.succeed()
        return result

    def hear(self, message):
        why = self.model.take(message, self.clock.now().nanoseconds)
        if why:
            self.say(f'refused: {why}')

    def say(self, text):
        print(text, file=self.told, flush=True)

    def cycle(self):
        """One period of the controller."""
        now = self.clock.now().nanoseconds
        if self.at is not None:
            self.axes, self.at = np.array(self.at), None
            self.model = ControllerModel(JOINTS, self.axes, self.tolerance)
        wanted = self.model.update(now, self.axes)[0]
        if self.model.aborted:
            self.say(f'aborted: {self.model.aborted}')
        share = 1.0 - np.exp(-1e-9 * (now - self.before) / LAG)
        moved = self.axes + share * (wanted - self.axes)
        if self.stuck is not None:
            moved[JOINTS.index(self.stuck)] = self.axes[JOINTS.index(self.stuck)]
        self.velocity = (moved - self.axes) / max(1e-9 * (now - self.before), 1e-6)
        self.axes, self.before = moved, now
        row = np.concatenate([[1e-9 * now, self.model.between_points], wanted[::-1]])
        self.log.write(row.tobytes())
        message = JointState(
            name=list(JOINTS), position=self.axes.tolist(), velocity=self.velocity.tolist()
        )
        message.header.stamp = Time(nanoseconds=now).to_msg()
        self.reports.publish(message)
        if self.goal is not None:
            self.follow(now, wanted)
        self.speeds.publish(Float64(data=self.speed))


def main(name, log):
    stay_on_this_host()
    come_first()
    rclpy.init()
    robot, executor = Robot(name, Path(log)), EventsExecutor()
    executor.add_node(robot.node)
    os.set_blocking(0, False)
    due, text = time.monotonic(), ''
    while True:
        due = max(due + PERIOD, time.monotonic())
        executor.spin_once(timeout_sec=0.0)
        while (left := due - time.monotonic()) > 0.0:
            executor.spin_once(timeout_sec=left)
        heard = sys.stdin.buffer.raw.read()
        if heard == b'':
            break  # whoever started it has ended
        if heard:
            *lines, text = (text + heard.decode()).split('\n')
            for line in lines:
                vars(robot).update(json.loads(line))
        if not robot.stall:
            robot.cycle()
    executor.shutdown()
    robot.node.destroy_node()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main(*sys.argv[1:])
