"""Topics published by the machine node: state, joints, executed setpoints."""

import math
import time
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs import msg
from sensor_msgs.msg import JointState

from cnc_interp.machine.homing import Homing
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.simulated_drives import Uncompensated
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes.controls import Overrides
from cnc_interp.nodes.node_main import OK, WITHOUT, Diagnostics
from cnc_interp.nodes.qos import CONTACTS, JOINTS, LOADED, STATE, STREAM
from cnc_interp.nodes.seals import SealedPublisher
from cnc_interp.wire import machine_messages as messages
from cnc_interp.wire.run_messages import coordinates_from, in_program

EXECUTED_RATE = 10.0  #: Rate of reports of executed setpoints [Hz].
EARLY = 2e-3  #: A message may be this early; it would be late at the next call [s].


class Rate:
    """Calls ``publish`` at most at a rate [Hz]; ``work`` may be called less often, as at rest."""

    def __init__(self, rate: float, publish: Callable[[], None]):
        self._period, self._publish, self._due = 1.0 / rate, publish, -math.inf

    def work(self, now: float) -> None:
        if now > self._due - EARLY:
            self._due = max(self._due, now - self._period) + self._period
            self._publish()


class MachineTopics:
    def __init__(
        self,
        node: Any,
        playback: Playback,
        values: dict[str, Any],
        overrides: Overrides,
        homing: Homing,
        diagnostics: Diagnostics,
        wake: Callable[[], None],
    ):
        self._wake = wake
        self._node, self._playback = node, playback
        self._overrides, self._homing = overrides, homing
        self._diagnostics = diagnostics
        self._period: float = values['interpolation_period']
        self._uncompensated: Uncompensated | None = None
        self._compared, self._without = '', 0.0
        if values['compensation']:
            model, position = Machine.load(values['compensation']), playback.axes.setpoints[-1]
            self._uncompensated = Uncompensated(model, self._period, position)
        self._joints = node.create_publisher(JointState, 'joint_states', JOINTS)
        self._states = SealedPublisher(node, msg.MachineState, 'machine_state', STATE)
        self._executed = SealedPublisher(node, msg.SetpointChunk, 'executed_setpoints', STREAM)
        self._told_signals: msg.MachineSignals | None = None
        self._signals = node.create_publisher(msg.MachineSignals, 'machine_signals', LOADED)
        self._contacts = SealedPublisher(node, msg.ProbeContact, 'probe_contact', CONTACTS)
        self._followed = SealedPublisher(node, msg.FollowedSpindle, 'followed_spindle', STREAM)
        self._feedback = SealedPublisher(node, msg.AxisFeedback, 'axis_feedback', STREAM)
        #: Modal states received last, of the program and of MDI lines.
        self._modes: dict[str, msg.ModalState] = {}
        for topic in ('active_modes', 'modal_state'):
            take = partial(self._take_modes, topic)
            node.create_subscription(msg.ModalState, topic, take, LOADED)
        self._transform = transform = Transform.of(playback.axes.machine)
        self._zero = transform.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        self._rates = (
            Rate(EXECUTED_RATE, self.publish_executed),
            Rate(values['joint_state_rate'], self._publish_joints),
            Rate(values['machine_state_rate'], self.publish_state),
        )

    def _take_modes(self, topic: str, modes: msg.ModalState) -> None:
        self._modes[topic] = modes
        self._wake()  # the coordinates may have changed

    def work(self) -> None:
        now = time.monotonic()
        for rate in self._rates:
            rate.work(now)

    def _now(self) -> Any:
        return self._node.get_clock().now().to_msg()

    def publish_state(self) -> None:
        self._playback.look()
        message = messages.machine_state(self._playback, self._period)
        message.header.stamp = self._now()
        message.feed_override = self._overrides.feed
        message.rapid_override = self._overrides.rapid
        message.spindle_override = self._overrides.spindle
        message.homed, message.must_home = self._homing.homed, self._homing.must_home
        if self._homing.active and message.state == msg.MachineState.IDLE:
            message.state = msg.MachineState.JOGGING  # between two groups all axes rest
        self._add_program_positions(message)
        self._states.publish(message)

    def _add_program_positions(self, message: msg.MachineState) -> None:
        of_program = message.program_id and in_program(message)  # functions alone are no run
        modes = self._modes.get('active_modes' if of_program else 'modal_state')
        if modes is None or modes.program_id not in ('', message.program_id):
            return
        positions, tip, axis = map(np.array, (message.positions, message.tip, message.axis))
        positions = self._transform.counted(positions, tip)
        found = coordinates_from(modes).of_place(positions, tip, axis, self._zero)
        message.coordinates, message.program_positions = modes.coordinates, found.tolist()

    def tell_signals(self) -> None:
        drives, signals = self._playback.drives, self._playback.axes.machine.signals
        values = drives.outputs.tolist(), drives.inputs.tolist()
        message = messages.signals_message(signals, *values)
        if message != self._told_signals and (signals.outputs or signals.inputs):
            self._told_signals = deepcopy(message)
            message.header.stamp = self._now()
            self._signals.publish(message)

    def tell_contacts(self) -> None:
        while self._playback.contacts:
            contact = self._playback.contacts.popleft()
            message = msg.ProbeContact(
                program_id=contact.run_id.program_id,
                line_number=contact.line,
                at_once=contact.at_once,
                positions=self._playback.axes.nominal(contact.position).tolist(),
            )
            message.header.stamp = self._now()
            self._contacts.publish(message)

    def _publish_joints(self) -> None:
        feedback, machine = self._playback.feedback, self._playback.axes.machine
        self._joints.publish(messages.joint_state(feedback, machine, self._now()))

    def publish_executed(self) -> None:
        for setpoints, feedback in messages.executed_setpoints(self._playback, self._period):
            self._feedback.publish(feedback)
            self._executed.publish(setpoints)
            self._compare(setpoints)
        for followed in messages.followed_spindle(self._playback):
            followed.header.stamp = self._now()
            self._followed.publish(followed)

    def _compare(self, executed: msg.SetpointChunk) -> None:
        if self._uncompensated is None:
            return
        if executed.program_id != self._compared:
            self._compared, self._without = executed.program_id, 0.0
        positions, velocities = (
            np.reshape(column, (-1, executed.axis_count))
            for column in (executed.positions, executed.velocities)
        )
        errors = self._uncompensated.contour_errors(positions, velocities)
        of_program = np.array(executed.sequences) > 0  # after the approach
        self._without = max(self._without, float(errors[of_program].max(initial=0.0)))

    def report_compensation(self) -> None:
        if self._uncompensated is not None:
            told = {WITHOUT: f'{self._without:.3g}'}
            self._diagnostics.say('compensation', OK, 'setpoints are compensated', **told)
