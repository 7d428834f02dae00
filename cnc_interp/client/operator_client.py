"""The operator's ROS node: listens to the other nodes, and sends programs and commands."""

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial
from typing import Any

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import Jog, LoadedProgram, MachineSignals, MachineState, ModalState
from cnc_interp_msgs.srv import Home, MoveAxes, SetOffset, SetTool, SwitchOutputs, TouchOff
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from std_msgs.msg import Float64
from std_srvs.srv import SetBool, Trigger

from cnc_interp.client.alarms import AlarmList
from cnc_interp.client.question import AGAIN, Question, SentProgram
from cnc_interp.client.served_node import SPIN, ServedNode
from cnc_interp.core import InterpError
from cnc_interp.nodes.node_main import (
    AND,
    BODIES,
    OFF_LINE_END,
    PREPARED,
    STOCK,
    TOOL,
    WAITING,
    WITHOUT,
)
from cnc_interp.nodes.peers import Peers, watch_machine
from cnc_interp.nodes.qos import BEATS, DIAGNOSTICS, LOADED, OVERRIDE
from cnc_interp.run.overrides import OVERRIDES
from cnc_interp.run.run_history import RunHistory

__all__ = ['STOPS', 'SWITCHES', 'Answer', 'MachineState', 'OperatorClient']

SWITCHES = ('single_block', 'optional_stop')  #: Switches: stop after each line; stop at M1.
#: Command (name of its service) -> type of the service.
SERVICES = {
    **dict.fromkeys(('cycle_start', 'feed_hold', 'reset', 'emergency_stop'), Trigger),
    **dict.fromkeys(SWITCHES, SetBool),
    'switch_outputs': SwitchOutputs,
    'move_axes': MoveAxes,
    'home': Home,
    'set_offset': SetOffset,
    'set_tool': SetTool,
    'touch_off': TouchOff,
}
MACHINE = 'machine_node'
OFFERED_BY = {
    'optional_stop': 'feedrate_node',
    **dict.fromkeys(('set_offset', 'set_tool', 'touch_off'), 'program_node'),
}
#: Commands that do no harm if they arrive twice or late; they are resent until answered.
STOPS = ('feed_hold', 'emergency_stop')
#: Silence of a node that counts as lost; longest wait for an answer [s].
SILENCE, ANSWER = 2.0, 3.0
CALM = 1.0  #: Longest wait for an event if no request is pending [s].
ECHO = 10.0  #: Longest time until the machine reports an override of this client [s].


class SharedValue:
    """The latest value on a topic. A value sent by this client applies for ``patience`` [s]."""

    def __init__(self, value: float, patience: float):
        self._heard, self._patience = value, patience
        self._wishes: deque[float] = deque()
        self._until = 0.0

    def wish(self, value: float, now: float) -> None:
        """Record a value that this client sends at the time ``now`` [s]."""
        if now >= self._until:
            self._wishes.clear()
        if value != self.at(now):
            self._wishes.append(value)
            self._until = now + self._patience

    def hear(self, value: float) -> None:
        """Record a received value; a sent value equal to it, and all earlier ones, are dropped."""
        if value == self._heard:
            return
        if value in self._wishes:
            while self._wishes.popleft() != value:
                pass
        self._heard = value

    def at(self, now: float) -> float:
        return self._wishes[-1] if self._wishes and now < self._until else self._heard


@dataclass(frozen=True)
class Answer:
    ok: bool
    message: str
    response: Any = None


class OperatorClient(ServedNode):
    """The ROS node of an operator, served by ``serve`` or by a thread (``start``).

    Commands may come from any thread. ``on_state`` is called with every ``MachineState``, in the
    thread that serves the node.
    """

    def __init__(
        self,
        name: str,
        namespace: str,
        domain: int | None = None,
        on_state: Callable[[MachineState], None] = lambda _: None,
    ):
        super().__init__(name, namespace, domain)
        node = self.node
        self.peers = Peers(node)
        self.alarms = AlarmList()
        self._pending: list[Callable[[], bool]] = []  # each returns True once it is answered
        self._sent: list[SentProgram] = []  # programs that have no result yet
        self.waiting = ''
        self.prepared: float | None = None  # progress of what the program waits for
        self.waits_for = ''  # what that is, in words
        self.tool_wanted: int | None = None  # the tool that the operator must put in
        #: Distance of the resting tip from the end of its line in single block [m].
        self.off_line_end: float | None = None
        self.uncompensated: float | None = None  # largest contour error of this run [m]
        self.program: LoadedProgram | None = None
        self.modes: ModalState | None = None  # of the lines by hand
        self.active_modes: ModalState | None = None  # of the block that is executed
        self.signals: MachineSignals | None = None  # outputs and inputs of the machine
        self._overrides = {topic: SharedValue(1.0, ECHO) for topic in OVERRIDES}
        #: Node -> names of two bodies that hit, or would hit, each other; and its report.
        self.hits: dict[str, tuple[tuple[str, ...], str]] = {}
        self.machine = self.scene = self.setup_file = ''
        self.history = RunHistory('')
        self.stock = ''  #: Text about the stock removed so far, if there is one.
        self._on_state = on_state
        watch_machine(node, self._see_state)
        for kind, topic, name in (
            (LoadedProgram, 'loaded_program', 'program'),
            (ModalState, 'modal_state', 'modes'),
            (ModalState, 'active_modes', 'active_modes'),
            (MachineSignals, 'machine_signals', 'signals'),
        ):
            node.create_subscription(kind, topic, partial(setattr, self, name), LOADED)
        node.create_subscription(DiagnosticArray, '/diagnostics', self._see_alarms, DIAGNOSTICS)
        self._services = {name: node.create_client(kind, name) for name, kind in SERVICES.items()}
        self._beats = node.create_publisher(Jog, 'jog', BEATS)
        self._set_overrides = {
            topic: node.create_publisher(Float64, topic, OVERRIDE) for topic in OVERRIDES
        }
        self._action = ActionClient(node, RunProgram, 'run_program')
        # Made last, and DDS reports them in order: a node that answers this can answer all.
        self._doors = {
            owner: node.create_client(GetParameters, f'{owner}/get_parameters')
            for owner in (MACHINE, *OFFERED_BY.values())
        }
        self._simulated = self._knock(MACHINE, 'machine', 'scene', 'setup')
        self._keeps_rows = self._knock('program_node', 'run_history')
        self._pending += [self._knows_machine, self._knows_history]
        self._ended = threading.Event()
        self._thread: threading.Thread | None = None

    # Receiving ----------------------------------------------------------------------------------

    @property
    def state(self) -> MachineState | None:
        return self.peers.state

    def silent_for(self, patience: float) -> str:
        """Return the name of a node that has sent nothing for ``patience`` [s]; '' if none."""
        missing = self.peers.missing(time.monotonic(), patience)
        return missing if missing or self.takes_programs else 'program_node'

    @property
    def takes_programs(self) -> bool:
        return bool(self._action.server_is_ready())

    @property
    def silent(self) -> str:
        return self.silent_for(SILENCE)

    def override_of(self, topic: str) -> float:
        return self._overrides[topic].at(time.monotonic())

    def _see_state(self, state: MachineState) -> None:
        for topic, override in self._overrides.items():
            override.hear(getattr(state, topic))
        self._on_state(state)

    def _see_alarms(self, array: DiagnosticArray) -> None:
        """Store what diagnostics report: alarms, queued programs, progress, hits and errors."""
        for status in array.status:
            if status.hardware_id != self.namespace:
                continue
            self.alarms.hear(status)
            values = {pair.key: pair.value for pair in status.values}
            if WAITING in values:
                self.waiting = values[WAITING]
                self.tool_wanted = int(values[TOOL]) if TOOL in values else None
                off = values.get(OFF_LINE_END)
                self.off_line_end = None if off is None else float(off)
                waits = PREPARED in values
                self.waits_for = status.message if waits else ''
                self.prepared = float(values[PREPARED]) if waits else None
            self.hits.pop(status.name, None)
            if BODIES in values:
                self.hits[status.name] = tuple(values[BODIES].split(AND)), status.message
            if STOCK in values:
                self.stock = values[STOCK]
            if WITHOUT in values:
                self.uncompensated = float(values[WITHOUT])

    def _knock(self, owner: str, *names: str) -> Question:
        return Question(self._doors[owner], GetParameters.Request(names=names))

    def _knows_machine(self) -> bool:
        answer = self._simulated.answer()
        if answer is not None and answer.values:
            self.scene, self.setup_file = (value.string_value for value in answer.values[1:])
            self.machine = answer.values[0].string_value
        return answer is not None

    def _knows_history(self) -> bool:
        answer = self._keeps_rows.answer()
        if answer is not None and answer.values:
            self.history = RunHistory(answer.values[0].string_value)
        return answer is not None

    # Commands -----------------------------------------------------------------------------------

    def offers(self, *services: str) -> bool:
        return all(self._services[name].service_is_ready() for name in services)

    def beat(self, message: Jog) -> None:
        self._executor.create_task(lambda: self._beats.publish(message))

    def set_override(self, share: float, topic: str = 'feed_override') -> None:
        self._overrides[topic].wish(share, time.monotonic())
        told = Float64(data=share)
        self._executor.create_task(lambda: self._set_overrides[topic].publish(told))

    def run(
        self, goal: RunProgram.Goal, on_result: Callable[[RunProgram.Result], None] | None = None
    ) -> SentProgram:
        """Send a program, from the thread that serves the node; earlier programs run first."""
        sent = SentProgram(self._action, goal, len(self._sent))
        self._sent.append(sent)

        def ended() -> bool:
            sent.follow()
            if sent.result is None:
                return False
            self._sent.remove(sent)
            if on_result is not None:
                on_result(sent.result)
            return True

        self._pending.append(ended)
        return sent

    def start_program(
        self,
        goal: RunProgram.Goal,
        on_result: Callable[[RunProgram.Result], None] = lambda _: None,
    ) -> Future[Answer]:
        """Send a program from any thread; return its acceptance. Its end becomes an alarm."""

        def see_result(result: RunProgram.Result) -> None:
            good = result.code == RunProgram.Result.SUCCEEDED
            self.alarms.add('notice' if good else 'error', 'program', result.message)
            on_result(result)

        def accepted(sent: SentProgram) -> Answer | None:
            return Answer(True, 'started') if sent.accepted else None

        return self._program(goal, accepted, see_result)

    def give_line(self, text: str, proposes: bool = False) -> Future[Answer]:
        def ended(sent: SentProgram) -> Answer | None:
            result = sent.result
            if result is None:
                return None
            for notice in result.notices:
                self.alarms.add('notice', 'program', notice)
            good = result.code == RunProgram.Result.SUCCEEDED
            return Answer(good, result.message, result)

        return self._program(RunProgram.Goal(text=text, mdi=True, proposes=proposes), ended)

    def _program(
        self,
        goal: RunProgram.Goal,
        answer: Callable[[SentProgram], Answer | None],
        on_result: Callable[[RunProgram.Result], None] | None = None,
    ) -> Future[Answer]:
        """Send a program; ``answer`` is called repeatedly until it returns an answer."""
        wanted: Future[Answer] = Future()

        def send() -> None:
            if self.takes_programs:
                sent = self.run(goal, on_result)
                self._pending.append(lambda: answered(sent))
            else:
                wanted.set_result(Answer(False, 'program_node does not answer; start it'))

        def answered(sent: SentProgram) -> bool:
            if (found := answer(sent)) is not None:
                wanted.set_result(found)
            return wanted.done()

        self._executor.create_task(send)
        return wanted

    def cancel_lines(self) -> None:
        for sent in [one for one in self._sent if one.goal.mdi]:
            self._executor.create_task(sent.cancel)

    def cancel_waiting(self) -> int:
        found = [sent for sent in list(self._sent) if sent.programs_ahead > 0]
        for sent in found:
            self._executor.create_task(sent.cancel)
        return len(found)

    def ask(self, name: str, request: Any = None, **fields: Any) -> Future[Answer]:
        """Call a service. The commands in ``STOPS`` are resent until they are answered.

        All other requests are sent once, after their node has answered a harmless request. A node
        that has not discovered this client would execute a request, but its answer would be lost.
        """
        wanted: Future[Answer] = Future()
        client, request = self._services[name], request or SERVICES[name].Request(**fields)
        stops = name in STOPS

        def send() -> None:
            if not stops and not client.service_is_ready():
                wanted.set_result(Answer(False, f'no node offers {name}; start the nodes'))
                return
            knock = None if stops else self._knock(OFFERED_BY.get(name, MACHINE))
            question = Question(client, request, AGAIN if stops else math.inf)
            until = time.monotonic() + ANSWER
            self._pending.append(lambda: answered(knock, question, until))

        def answered(knock: Question | None, question: Question, until: float) -> bool:
            heard = knock is None or knock.answer() is not None
            response = question.answer() if heard else None
            if response is not None:
                wanted.set_result(Answer(response.success, response.message, response))
            elif time.monotonic() > until:  # a repeated start may be too late
                question.drop()
                told = 'no answer; check and press again' if heard else 'not sent, no node answers'
                wanted.set_result(Answer(False, f'{name.replace("_", " ")}: {told}'))
            return wanted.done()

        self._executor.create_task(send)
        return wanted

    # Serving ------------------------------------------------------------------------------------

    def serve(self, timeout: float = SPIN) -> None:
        self._pending = [ended for ended in self._pending if not ended()]
        super().serve(timeout)

    def wait_for(self, answer: Future[Answer]) -> Answer:
        while not answer.done():
            self.serve()
        return answer.result()

    def granted(self, answer: Future[Answer]) -> Answer:
        found = self.wait_for(answer)
        if not found.ok:
            raise InterpError(found.message)
        return found

    def start(self) -> None:
        def serve_on() -> None:
            while not self._ended.is_set():
                self.serve(SPIN if self._pending else CALM)

        self._thread = threading.Thread(target=serve_on, name='ros', daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        if self._thread is not None:
            self._executor.create_task(lambda: None)  # wakes it
            self._thread.join()
        super().close()

    def _destroy(self) -> None:
        self._action.destroy()
        super()._destroy()
