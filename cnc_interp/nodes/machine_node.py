"""The machine node: ``setpoints`` in, at absolute deadlines into the simulated drives."""

from __future__ import annotations

import sys
import threading
import time
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from rclpy.lifecycle import LifecycleNode, TransitionCallbackReturn
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from cnc_interp.errors import StreamError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.machine import Drives, Event, SimulatedMachine, State
from cnc_interp.nodes import parameters
from cnc_interp.nodes.diagnostics import ERROR, OK, WARN, Diagnostics
from cnc_interp.nodes.endpoints import Inlet
from cnc_interp.nodes.machine_messages import joint_state, machine_state
from cnc_interp.nodes.messages import setpoints_from
from cnc_interp.nodes.playback import Playback
from cnc_interp.nodes.qos import JOINTS, STATE
from cnc_interp.nodes.running import run_node, start_lifecycle, transition
from cnc_interp.nodes.soundness import check_chunk
from cnc_interp.nodes.streams import WindowedReceiver

#: After a longer stall of the computer the clock starts anew instead of being caught up [s].
LONGEST_CATCH_UP = 0.5


class MachineNode(LifecycleNode):
    """A simulated machine tool."""

    def __init__(self) -> None:
        super().__init__('machine_node')
        self._values = parameters.declare(self, parameters.MACHINE_NODE)
        self._period: float = self._values['interpolation_period']
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._ticking: threading.Thread | None = None
        self._told = State.INACTIVE
        if self._values['autostart']:
            start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        """Build the machine, standing at zero, and open the streams."""
        return transition(self, self._configure)

    def _configure(self) -> None:
        values = self._values
        machine = Machine.load(values['machine'])
        drives = Drives(values['position_gain'], values['feed_forward'], values['time_constant'])
        home = np.zeros(len(machine.axis_names))
        self._machine = SimulatedMachine(machine, self._period, home, drives)
        self._playback = Playback(self._machine, round(values['start_time'] / self._period))
        self._diagnostics = Diagnostics(self)
        window = round(values['buffer_time'] / self._period)
        self._inlet = Inlet(
            self, WindowedReceiver('setpoints', window), SetpointChunk, self._check, self._take,
            lambda: None, self._diagnostics, status_period=0.01,
        )  # fmt: skip
        self._joints = self.create_publisher(JointState, 'joint_states', JOINTS)
        self._states = self.create_publisher(MachineState, 'machine_state', STATE)
        self.create_timer(0.005, self._work)
        self.create_timer(1.0 / values['joint_state_rate'], self._tell_joints)
        self.create_timer(1.0 / values['machine_state_rate'], self._tell_state)
        self.create_service(Trigger, 'reset', self._reset)

    def on_activate(self, state: Any) -> TransitionCallbackReturn:
        """Switch the drives on and start the clock."""
        self._machine.handle(Event.ACTIVATE)
        self._stop.clear()
        self._ticking = threading.Thread(target=self._run_clock, name='drives', daemon=True)
        self._ticking.start()
        return super().on_activate(state)

    def on_deactivate(self, state: Any) -> TransitionCallbackReturn:
        """Stop the clock; only a machine at rest is switched off."""
        self._stop_clock()
        try:
            self._machine.handle(Event.DEACTIVATE)
        except StreamError as problem:
            self.get_logger().error(str(problem))
            return TransitionCallbackReturn.FAILURE
        return super().on_deactivate(state)

    def _run_clock(self) -> None:
        """Step the drives at absolute deadlines; late ones are caught up."""
        due = time.monotonic()
        while not self._stop.is_set():
            due += self._period
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            elif wait < -LONGEST_CATCH_UP:
                due = time.monotonic()
            with self._lock:
                self._playback.step()

    def _stop_clock(self) -> None:
        self._stop.set()
        if self._ticking is not None:
            self._ticking.join()
            self._ticking = None

    def _check(self, chunk: SetpointChunk) -> None:
        """Let in what fits the machine while its drives are on."""
        if self._machine.state in (State.INACTIVE, State.FAULT):
            state = self._machine.state.value
            raise StreamError(f'the machine is {state}: {self._machine.message or "activate it"}')
        check_chunk(chunk, len(self._machine.machine.axis_names), self._period)

    def _take(self, chunk: SetpointChunk) -> None:
        """Put sound setpoints into the buffer."""
        with self._lock:
            if chunk.first_sample == 0:
                self._playback.begin(chunk.program_id)
            self._playback.push(
                setpoints_from(chunk), list(chunk.line_numbers), chunk.end_of_program
            )

    def _work(self) -> None:
        """Open the window by what was played; tell at once when the state changes."""
        playback, receiver = self._playback, self._inlet.receiver
        with self._lock:
            played = playback.played if playback.program_id == receiver.program_id else 0
            lost, state = playback.lost, self._machine.state
            fault = self._machine.message if state is State.FAULT else ''
        receiver.consumed = played
        self._inlet.buffered_time = playback.buffered * self._period
        if (lost or fault) and receiver.program_id and not receiver.refusal:
            self._inlet.refuse(receiver.program_id, lost or fault)
        if state is not self._told:
            self._told = state
            level = {State.FAULT: ERROR, State.STARVED: WARN}.get(state, OK)
            self._diagnostics.say('drives', level, self._machine.message or state.value)
            self._tell_state()

    def _tell_joints(self) -> None:
        with self._lock:
            feedback = self._playback.feedback
        stamp = self.get_clock().now().to_msg()
        self._joints.publish(joint_state(feedback, self._machine.machine, stamp))

    def _tell_state(self) -> None:
        with self._lock:
            message = machine_state(self._playback, self._period)
        message.header.stamp = self.get_clock().now().to_msg()
        self._states.publish(message)

    def _reset(self, _request: Any, response: Any) -> Any:
        """Clear a fault or what is left of a lost run."""
        with self._lock:
            try:
                self._machine.handle(Event.RESET)
                self._playback.begin('')
                response.success, response.message = True, 'ready'
            except StreamError as problem:
                response.success, response.message = False, str(problem)
        return response

    def close(self) -> None:
        """Stop the clock; the drives hold the last setpoint."""
        self._stop_clock()


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MachineNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
