"""The operator's end of the ROS interface: hears what the nodes say, passes commands on."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import LoadedProgram, MachineState
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from cnc_interp.client.goal_sender import AskedGoal
from cnc_interp.client.shared_value import SharedValue
from cnc_interp.nodes.diagnostics import WAITING
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.qos import DIAGNOSTICS, LOADED, STATE

__all__ = [
    'STATE_NAMES',
    'TRIGGERS',
    'Alarm',
    'Answer',
    'MachineState',
    'Operating',
]

#: Commands without a value; each is a service of that name.
TRIGGERS = ('cycle_start', 'feed_hold', 'reset', 'emergency_stop')
#: Those that may come twice, and late: they are sent again while no answer comes.
STOPS = ('feed_hold', 'emergency_stop')
#: Silence after which a node counts as lost, and longest wait for an answer [s].
SILENCE, ANSWER = 2.0, 3.0
#: Time without an answer after which a stop is sent again [s].
AGAIN = 0.5
#: So long an override of this end may be on its way [s].
ECHO = 10.0
#: How soon commands of other threads are seen [s].
SPIN = 0.01
ALARMS_KEPT = 200
#: So far back an alarm is looked for that a new one repeats.
ALARMS_COMPARED = 8
NUMBER = re.compile(r'\d+(\.\d+)?')
LEVELS = {DiagnosticStatus.WARN: 'warning', DiagnosticStatus.ERROR: 'error'}
STATE_NAMES = {
    MachineState.IDLE: 'idle',
    MachineState.RUNNING: 'running',
    MachineState.HOLDING: 'holding',
    MachineState.HELD: 'held',
    MachineState.STARVED: 'starved',
    MachineState.STOPPED: 'stopped',
    MachineState.FAULT: 'fault',
}


@dataclass(frozen=True)
class Alarm:
    """Something that the operator must know: when, how bad, who says it, what, how often."""

    time: str
    level: str
    source: str
    message: str
    count: int = 1

    def repeats(self, other: Alarm) -> bool:
        """Tell whether it is the other again; numbers in the words may differ."""
        one, two = (NUMBER.sub('#', alarm.message) for alarm in (self, other))
        return (self.level, self.source, one) == (other.level, other.source, two)


@dataclass(frozen=True)
class Answer:
    """What came of a command."""

    ok: bool
    message: str


class Operating:
    """
    A node of its own in a thread of its own.

    Parameters
    ----------
    namespace : str
        Where the nodes live.
    domain : int
        Their ROS domain.
    on_state : callable
        Told every ``MachineState``, in the thread of this node.

    """

    def __init__(self, namespace: str, domain: int, on_state: Callable[[MachineState], None]):
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node('panel', namespace=namespace, context=self._context)
        self._namespace = self._node.get_namespace()
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._peers = Peers(self._node)
        self._alarms: deque[Alarm] = deque(maxlen=ALARMS_KEPT)
        self._levels: dict[str, tuple[bytes, str]] = {}
        self._todo: deque[Callable[[], None]] = deque()
        self._pending: list[Callable[[], bool]] = []  # each tells whether it was answered
        self._goals: dict[bytes, Any] = {}  # handles of programs sent from here, by their ids
        self._ahead: dict[bytes, int] = {}  # programs that come before each of them
        self.waiting = ''
        self.program: LoadedProgram | None = None
        self._override = SharedValue(1.0, ECHO)
        self.machine = ''
        node = self._node
        node.create_subscription(MachineState, 'machine_state', on_state, STATE)
        node.create_subscription(LoadedProgram, 'loaded_program', self._see_program, LOADED)
        node.create_subscription(Float64, 'feed_override', self._see_override, LOADED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._see_alarms, DIAGNOSTICS)
        self._triggers = {name: node.create_client(Trigger, name) for name in TRIGGERS}
        self._single_block = node.create_client(SetBool, 'single_block')
        self._set_override = node.create_publisher(Float64, 'feed_override', LOADED)
        self._parameters = node.create_client(GetParameters, 'machine_node/get_parameters')
        self._action = ActionClient(node, RunProgram, 'run_program')
        node.create_timer(0.5, self._ask_for_machine)
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name='ros', daemon=True)

    def start(self) -> None:
        """Hear and speak from here on."""
        self._thread.start()

    # What is heard ------------------------------------------------------------------------------

    @property
    def state(self) -> MachineState | None:
        """The last state of the machine, None before the first."""
        return self._peers.state

    @property
    def silent(self) -> str:
        """Name of a node that does not answer; empty when all do."""
        missing = self._peers.missing(time.monotonic(), SILENCE)
        if not missing and not self._action.server_is_ready():
            return 'program_node'
        return missing

    @property
    def alarms(self) -> list[Alarm]:
        """Alarms, the newest first; one that comes again is one with a higher count."""
        return list(self._alarms)[::-1]

    def warn(self, level: str, source: str, message: str) -> None:
        """Add an alarm of the panel itself."""
        alarm = Alarm(datetime.now().strftime('%H:%M:%S'), level, source, message)
        for before in list(self._alarms)[-ALARMS_COMPARED:]:
            if alarm.repeats(before):
                self._alarms.remove(before)
                alarm = replace(alarm, count=before.count + 1)
        self._alarms.append(alarm)

    def _see_program(self, message: LoadedProgram) -> None:
        self.program = message

    @property
    def override(self) -> float:
        """The feed override: the last one heard, or the wish from here that is on its way."""
        return self._override.at(time.monotonic())

    def _see_override(self, message: Float64) -> None:
        self._override.hear(message.data)

    def _see_alarms(self, array: DiagnosticArray) -> None:
        """Note what became worse; the same words again are no news."""
        for status in array.status:
            if status.hardware_id != self._namespace:
                continue
            news = (status.level, status.message)
            if self._levels.get(status.name) != news and status.level in LEVELS:
                self.warn(LEVELS[status.level], status.name, status.message)
            self._levels[status.name] = news
            for pair in status.values:
                if pair.key == WAITING:
                    self.waiting = pair.value

    def _ask_for_machine(self) -> None:
        """Learn from the machine node which machine it is."""
        if self.machine or not self._parameters.service_is_ready():
            return

        def see(answer: Any) -> None:
            values = answer.result().values
            if values:
                self.machine = values[0].string_value

        asked = self._parameters.call_async(GetParameters.Request(names=['machine']))
        asked.add_done_callback(see)

    # Commands -----------------------------------------------------------------------------------

    def trigger(self, name: str) -> Future[Answer]:
        """Call one of ``TRIGGERS``."""
        return self._call(self._triggers[name], Trigger.Request(), name)

    def set_single_block(self, on: bool) -> Future[Answer]:
        """Stop at the end of each block, or no longer."""
        return self._call(self._single_block, SetBool.Request(data=on), 'single_block')

    def set_override(self, share: float) -> None:
        """Set the feed override [-]."""
        self._override.wish(share, time.monotonic())
        self._todo.append(lambda: self._set_override.publish(Float64(data=share)))

    def run(self, program: Path, options: Mapping[str, Any]) -> Future[Answer]:
        """
        Run a program, behind those that run or wait already.

        Answered when it was accepted; its end becomes an alarm or a notice.

        Parameters
        ----------
        program : Path
            The file, where program_node can read it.
        options : mapping
            Further fields of the goal of ``run_program``.

        """
        goal = RunProgram.Goal(program=str(program), **options)
        wanted: Future[Answer] = Future()

        def send() -> None:
            if not self._action.server_is_ready():
                wanted.set_result(Answer(False, 'program_node does not answer; start it'))
                return
            asked = AskedGoal(self._action, goal, self._see_feedback)
            self._pending.append(lambda: accepted(asked.handle))

        def accepted(handle: Any) -> bool:
            if handle is None:
                return False
            key = bytes(handle.goal_id.uuid)
            self._ahead.setdefault(key, len(self._goals))  # until its first feedback
            self._goals[key] = handle
            wanted.set_result(Answer(True, 'started'))
            handle.get_result_async().add_done_callback(lambda end: self._see_result(key, end))
            return True

        self._todo.append(send)
        return wanted

    def cancel_waiting(self) -> int:
        """Take the programs out of the queue that were sent from here; returns how many."""
        found = [handle for key, handle in self._goals.items() if self._ahead.get(key, 0) > 0]
        self._todo.extend(handle.cancel_goal_async for handle in found)
        return len(found)

    def _see_feedback(self, message: Any) -> None:
        self._ahead[bytes(message.goal_id.uuid)] = message.feedback.programs_ahead

    def _see_result(self, key: bytes, answer: Any) -> None:
        result = answer.result().result
        self._goals.pop(key, None)
        self._ahead.pop(key, None)
        good = result.code == RunProgram.Result.SUCCEEDED
        self.warn('notice' if good else 'error', 'program', result.message)

    def _call(self, client: Any, request: Any, name: str) -> Future[Answer]:
        wanted: Future[Answer] = Future()

        def send() -> None:
            if not client.service_is_ready():
                wanted.set_result(Answer(False, f'{name}: no node offers it; start the nodes'))
                return
            sent, began = [client.call_async(request)], time.monotonic()
            self._pending.append(lambda: answered(sent, began))

        def answered(sent: list[Any], began: float) -> bool:
            waited = time.monotonic() - began
            answer = next((answer for answer in sent if answer.done()), None)
            if answer is not None:
                response = answer.result()
                wanted.set_result(Answer(response.success, f'{name}: {response.message}'))
            elif waited > ANSWER:  # a start is not sent again by itself: it could come too late
                wanted.set_result(Answer(False, f'{name}: no answer; look and press again'))
            elif name in STOPS and waited > AGAIN * len(sent):
                sent.append(client.call_async(request))
            if wanted.done():
                for answer in sent:
                    client.remove_pending_request(answer)
            return wanted.done()

        self._todo.append(send)
        return wanted

    # The thread ---------------------------------------------------------------------------------

    def _serve(self) -> None:
        while not self._ended.is_set():
            while self._todo:
                self._todo.popleft()()
            self._pending = [look for look in self._pending if not look()]
            self._executor.spin_once(timeout_sec=SPIN)

    def close(self) -> None:
        """End; what the machine does is not touched."""
        self._ended.set()
        self._thread.join()
        self._executor.shutdown()
        self._action.destroy()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
