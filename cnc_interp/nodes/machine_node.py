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
from trajectory_msgs.msg import JointTrajectory

from cnc_interp.core.errors import Refusal, StreamError
from cnc_interp.core.units import UM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.machine.drive_model import Drives
from cnc_interp.machine.playback import Playback
from cnc_interp.machine.realtime import Lateness, ask_for_priority, lock_memory
from cnc_interp.machine.simulated import SimulatedMachine
from cnc_interp.machine.states import Event, State
from cnc_interp.nodes import parameters
from cnc_interp.nodes.controls import Controls
from cnc_interp.nodes.diagnostics import ERROR, OK, WARN, Diagnostics
from cnc_interp.nodes.node_main import run_node, start_lifecycle, transition
from cnc_interp.nodes.qos import JOINTS, STATE, STREAM, TRAJECTORY
from cnc_interp.nodes.stream_inlet import Inlet
from cnc_interp.wire.chunk_messages import chunk_from
from cnc_interp.wire.machine_messages import (
    executed_setpoints,
    joint_state,
    machine_state,
)
from cnc_interp.wire.message_checks import check_chunk
from cnc_interp.wire.run_id_messages import run_id_of
from cnc_interp.wire.trajectories import joint_trajectory
from cnc_interp.wire.window_protocol import WindowedReceiver

#: After a longer stall of the computer the clock starts anew instead of being caught up [s].
LONGEST_CATCH_UP = 0.5
#: Time between reports of what was executed [s].
EXECUTED_PERIOD = 0.1
#: Time between words about the clock [s].
CLOCK_PERIOD = 1.0
#: Time between trajectories for a controller [s].
TRAJECTORY_PERIOD = 0.05


class MachineNode(LifecycleNode):
    """A simulated machine tool."""

    def __init__(self) -> None:
        super().__init__('machine_node')
        self._values = parameters.declare(self, parameters.MACHINE_NODE)
        self._period: float = self._values['interpolation_period']
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._ticking: threading.Thread | None = None
        self._told: tuple[Any, ...] = ()
        self._lateness = Lateness(self._period)
        self._scheduling = self._locked = ''
        if self._values['autostart']:
            start_lifecycle(self)

    def on_configure(self, _state: Any) -> TransitionCallbackReturn:
        """Build the machine, standing at zero, and open the streams."""
        return transition(self, self._configure)

    def _configure(self) -> None:
        values = self._values
        machine = Machine.load(values['machine'])
        priority = values['realtime_priority']
        # The others of this process come right behind the clock: it may wait for them.
        ask_for_priority(max(priority - 1, min(priority, 1)))
        self._locked = lock_memory() if values['lock_memory'] else 'memory may be paged out'
        drives = Drives(values['position_gain'], values['feed_forward'], values['time_constant'])
        home = np.zeros(len(machine.axis_names))
        self._machine = SimulatedMachine(machine, self._period, home, drives)
        self._playback = Playback(self._machine, round(values['start_time'] / self._period))
        self._diagnostics = Diagnostics(self)
        window = round(values['buffer_time'] / self._period)
        self._inlet = Inlet(
            self, WindowedReceiver('setpoints', window), SetpointChunk, self._check, self._take,
            self._see_refusal, self._diagnostics, status_period=0.01,
        )  # fmt: skip
        self._joints = self.create_publisher(JointState, 'joint_states', JOINTS)
        self._states = self.create_publisher(MachineState, 'machine_state', STATE)
        self._executed = self.create_publisher(SetpointChunk, 'executed_setpoints', STREAM)
        if values['trajectory_topic']:
            self._trajectories = self.create_publisher(
                JointTrajectory, values['trajectory_topic'], TRAJECTORY
            )
            self.create_timer(TRAJECTORY_PERIOD, self._tell_trajectory)
        self._controls = Controls(self, self._playback, self._lock, self._give_up)
        self.create_timer(0.005, self._work)
        self.create_timer(EXECUTED_PERIOD, self._tell_executed)
        self.create_timer(CLOCK_PERIOD, self._tell_clock)
        self.create_timer(1.0 / values['joint_state_rate'], self._tell_joints)
        self.create_timer(1.0 / values['machine_state_rate'], self._tell_state)

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
        self._scheduling = ask_for_priority(self._values['realtime_priority'])
        due = time.monotonic()
        while not self._stop.is_set():
            due += self._period
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            elif wait < -LONGEST_CATCH_UP:
                due = time.monotonic()
            self._lateness.add(time.monotonic() - due)
            with self._lock:
                self._playback.step()

    def _stop_clock(self) -> None:
        self._stop.set()
        if self._ticking is not None:
            self._ticking.join()
            self._ticking = None

    def _check(self, chunk: SetpointChunk) -> None:
        """Let in what fits the machine, its state, and where it stands."""
        playback = self._playback
        with self._lock:
            state = self._machine.state
            mine = run_id_of(chunk) == playback.run_id
            if mine and playback.left:
                raise StreamError(self._left(), Refusal.LATE)
            if chunk.first_sample == 0:
                playback.make_room(run_id_of(chunk))
            before = playback.buffer.newest
        if state in (State.INACTIVE, State.STOPPING, State.FAULT):
            reason = self._machine.message or 'activate it'
            stopped = state is not State.INACTIVE
            kind = Refusal.MACHINE_FAULT if stopped else Refusal.NOT_READY
            raise StreamError(f'the machine is {state.value}: {reason}', kind)
        check_chunk(chunk, self._machine.machine, self._period, before)

    def _left(self) -> str:
        """Say once for all setpoints of a plan why they are void; not with the number of each."""
        return f'setpoints of plan {self._playback.run_id.plan} that come after its stop are void'

    def _take(self, chunk: SetpointChunk) -> None:
        """Put sound setpoints into the buffer; not where the plan was left since their check."""
        with self._lock:
            if chunk.first_sample == 0:
                self._playback.begin_plan(run_id_of(chunk))
                if not self._playback.played:  # a new run, and its figures
                    self._lateness = Lateness(self._period)
            elif self._playback.left:
                return
            self._playback.push(
                chunk_from(chunk), list(chunk.line_numbers), list(chunk.tail_line_numbers)
            )

    def _see_refusal(self) -> None:
        """Nothing more comes of this run: stop on the path behind what is sound."""
        with self._lock:
            self._playback.end_with(self._inlet.receiver.refusal_text)

    def _give_up(self, reason: str, kind: Refusal = Refusal.GIVEN_UP) -> None:
        """Tell the senders that the run is over."""
        receiver = self._inlet.receiver
        if receiver.run_id and not receiver.refused:
            self._inlet.refuse(receiver.run_id, kind, reason)

    def _work(self) -> None:
        """Open the window by what was played; tell at once when the state changes."""
        playback, receiver = self._playback, self._inlet.receiver
        with self._lock:
            mine = playback.run_id == receiver.run_id
            receiver.consumed = playback.played_of_plan if mine else 0
            over, state = mine and playback.plan_over, self._machine.state
            fault = self._machine.message if state is State.FAULT else ''
            news = (state, playback.run_id, playback.plan_over, playback.start_wanted)
        self._inlet.buffered_time = playback.buffer.count * self._period
        if fault:
            self._give_up(fault, Refusal.MACHINE_FAULT)
        elif over and receiver.active:
            receiver.close(self._left())
        if news != self._told:
            self._told = news
            level = {State.FAULT: ERROR, State.STARVED: WARN}.get(state, OK)
            self._diagnostics.say('drives', level, self._machine.message or state.value)
            self._tell_state()

    def _tell_clock(self) -> None:
        """Say how punctual the drives are stepped in this run, and how they are scheduled."""
        late = self._lateness
        figures = {
            'periods': late.count,
            'missed_periods': late.missed,
            'late_p50_us': f'{late.quantile(0.5) / UM:.0f}',
            'late_p99_us': f'{late.quantile(0.99) / UM:.0f}',
            'late_max_us': f'{late.largest / UM:.0f}',
        }
        said = f'{self._scheduling}; {self._locked}'
        self._diagnostics.say('clock', OK, said, **figures)

    def _tell_executed(self) -> None:
        with self._lock:
            messages = executed_setpoints(self._playback, self._period)
        for message in messages:
            self._executed.publish(message)

    def _tell_trajectory(self) -> None:
        with self._lock:
            rows = self._playback.coming()
        if rows:
            stamp = self.get_clock().now().to_msg()
            self._trajectories.publish(
                joint_trajectory(rows, self._machine.machine, self._period, stamp)
            )

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

    def close(self) -> None:
        """Stop the clock; the drives hold the last setpoint."""
        self._stop_clock()


def main(arguments: list[str] | None = None) -> int:
    """Run the node."""
    return run_node(MachineNode, arguments)


if __name__ == '__main__':
    sys.exit(main())
