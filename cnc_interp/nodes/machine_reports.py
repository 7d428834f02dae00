"""What the machine node publishes: state, joints, executed setpoints."""

from __future__ import annotations

from typing import Any

from cnc_interp_msgs.msg import AxisFeedback, MachineState, SetpointChunk
from sensor_msgs.msg import JointState

from cnc_interp.machine.homing import Homing
from cnc_interp.machine.playback import Playback
from cnc_interp.nodes.overrides import Overrides
from cnc_interp.nodes.qos import JOINTS, STATE, STREAM
from cnc_interp.wire.machine_messages import executed_setpoints, joint_state, machine_state

#: Time between reports of what was executed [s].
EXECUTED_PERIOD = 0.1


class MachineReports:
    """
    Publishes state, joints and executed setpoints at the rates of the node's parameters.

    Parameters
    ----------
    node : Node
        The node.
    playback : Playback
        The machine's buffer.
    values : dict
        Parameters of the node.
    overrides : Overrides
        The overrides that count.
    homing : Homing
        The axes whose position is known.

    """

    def __init__(
        self,
        node: Any,
        playback: Playback,
        values: dict[str, Any],
        overrides: Overrides,
        homing: Homing,
    ):
        self._node, self._playback = node, playback
        self._overrides, self._homing = overrides, homing
        self._period: float = values['interpolation_period']
        self._joints = node.create_publisher(JointState, 'joint_states', JOINTS)
        self._states = node.create_publisher(MachineState, 'machine_state', STATE)
        self._executed = node.create_publisher(SetpointChunk, 'executed_setpoints', STREAM)
        self._feedback = node.create_publisher(AxisFeedback, 'axis_feedback', STREAM)
        node.create_timer(EXECUTED_PERIOD, self.publish_executed)
        node.create_timer(1.0 / values['joint_state_rate'], self._publish_joints)
        node.create_timer(1.0 / values['machine_state_rate'], self.publish_state)

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()

    def publish_state(self) -> None:
        """Publish the state now."""
        self._playback.read()
        message = machine_state(self._playback, self._period)
        message.header.stamp = self._now()
        message.feed_override = self._overrides.feed.value
        message.rapid_override = self._overrides.rapid.value
        message.homed, message.must_home = self._homing.homed, self._homing.must_home
        if self._homing.active and message.state == MachineState.IDLE:
            message.state = MachineState.JOGGING  # between two groups all axes rest
        self._states.publish(message)

    def _publish_joints(self) -> None:
        feedback = self._playback.feedback
        machine = self._playback.axes.machine
        self._joints.publish(joint_state(feedback, machine, self._now()))

    def publish_executed(self) -> None:
        """Publish the setpoints executed since the last call, and where the axes were."""
        self._playback.read()
        for setpoints, feedback in executed_setpoints(self._playback, self._period):
            self._feedback.publish(feedback)
            self._executed.publish(setpoints)
