"""Record the messages of a run in a bag, with the parameters of its nodes.

Recording begins and ends with a handshake with every node. The recorder subscribes to the topics
and then requests parameters, so a node that answers knows the subscriptions. At the end every node
publishes its collected messages (``~/flush``). The recorder then waits for a later machine state,
and for as many executed setpoints as this state counts.
"""

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cnc_interp_msgs.msg import MachineState, StreamStatus
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.time import Time
from std_srvs.srv import Trigger

from cnc_interp.client.bag import TOPICS, BagWriter, refuse_existing
from cnc_interp.client.question import Question
from cnc_interp.client.served_node import ServedNode
from cnc_interp.machine.jog import JOG
from cnc_interp.nodes import parameters
from cnc_interp.nodes.qos import listening_to
from cnc_interp.nodes.seals import OWNERS, Ear, Heard
from cnc_interp.processes.stop_signals import stop_signals
from cnc_interp.run.run_state import RunId
from cnc_interp.wire.run_messages import run_id_of

#: Topics that are needed to write plan files.
NEEDED = (
    'loaded_program',
    'blocks',
    'block_batches',
    'segments',
    'executed_setpoints',
    'machine_state',
)


def counting(message: Any) -> RunId:
    """Return the id of the run, or of the motion by hand, that the machine state counts."""
    run_id = run_id_of(message)
    return run_id if run_id.program_id == JOG else RunId(run_id.program_id)


#: Topic -> name of its items, and function that returns run, first number and count of items.
NUMBERED: dict[str, tuple[str, Callable[[Any], list[tuple[RunId, int, int]]]]] = {
    'block_batches': ('blocks', lambda m: [(run_id_of(b), b.sequence, 1) for b in m.blocks]),
    'segments': ('segments', lambda m: [(run_id_of(s), s.sequence, 1) for s in m.segments]),
    'setpoints': ('setpoints', lambda m: [(run_id_of(m), m.first_sample, len(m.line_numbers))]),
    'executed_setpoints': (
        'executed setpoints',
        lambda m: [(counting(m), m.first_sample, len(m.line_numbers))],
    ),
    'axis_feedback': (
        'actual positions',
        lambda m: [(counting(m), m.first_sample, len(m.positions) // m.axis_count)],
    ),
}
#: Topics whose items are counted by the machine state; receivers count the others.
EXECUTED = ('executed_setpoints', 'axis_feedback')
#: Longest wait for the last messages [s]; DDS announces lost messages every 3 s.
LAST_WAIT = 10.0


class StreamRecord:
    """The numbers of the recorded items of a stream. Resent items count once."""

    def __init__(self, topic: str):
        self.name, self._numbers = NUMBERED[topic]
        self._spans: dict[RunId, list[tuple[int, int]]] = {}
        self._joins: dict[RunId, int] = {}  # first numbers of plans that join in motion
        #: Run -> number that its receiver had reached in its first and in its last message.
        self._received: dict[RunId, tuple[int, int]] = {}

    def add(self, message: Any) -> None:
        for run_id, first, count in self._numbers(message):
            spans = self._spans.setdefault(run_id, [])
            follows = spans and spans[-1][1] == first
            spans.append((spans.pop()[0] if follows else first, first + count))
            if getattr(message, 'joins', False):
                self._joins[run_id] = first

    def acknowledge(self, run_id: RunId, reached: int) -> None:
        """Note that a receiver has reached a number; all items before it must be recorded."""
        first, last = self._received.get(run_id, (reached, reached))
        self._received[run_id] = first, max(last, reached)

    @property
    def lost(self) -> int:
        """Number of missing items, from the first message of each plan or its receiver."""
        lost = 0
        for run_id in self._spans.keys() | self._received.keys():
            spans = sorted(self._spans.get(run_id, []))
            if not spans and self.name == 'blocks':
                continue  # they may travel one by one
            begin, end = self._received.get(run_id, (spans or [(0, 0)])[0])
            reached = self._joins.get(run_id, min([begin, *(first for first, _ in spans[:1])]))
            for first, after in [*spans, (end, end)]:
                lost += max(0, first - reached)
                reached = max(reached, after)
        return lost


class Recorder:
    def __init__(self, node: Any, path: Path, topics: Iterable[str] = TOPICS):
        self._bag, self._node = BagWriter(path), node
        self._subscriptions = [
            self._listen(topic, kind, listening_to(profile))
            for topic, (kind, profile) in TOPICS.items()
            if topic in topics
        ]
        self._names = {n: [p.name for p in parameters.NODES[n]] for n in parameters.NODES}
        self._parameters = {
            name: Question(
                node.create_client(GetParameters, f'{name}/get_parameters'),
                GetParameters.Request(names=names),
            )
            for name, names in self._names.items()
        }
        self._flush = {
            name: Question(node.create_client(Trigger, f'{name}/flush'), Trigger.Request())
            for name in parameters.NODES
        }
        self._known: set[str] = set()
        self._flushed: set[str] = set()
        self._streams = {topic: StreamRecord(topic) for topic in NUMBERED if topic in topics}
        self._state: MachineState | None = None  # the last one of the machine
        self._ended: Time | None = None  # when the nodes were first requested to flush

    def _listen(self, topic: str, kind: Any, profile: QoSProfile) -> Any:
        write = self._writing(topic)
        if topic in OWNERS:  # messages of other nodes there are not recorded
            return Ear(self._node, Heard(kind, topic, profile), write).subscription
        return self._node.create_subscription(kind, topic, write, profile, raw=True)

    def _writing(self, topic: str) -> Callable[[bytes], None]:
        def write(data: bytes) -> None:
            if self._subscriptions:  # else the message arrived after the record ended
                self._bag.write(topic, data, time.time_ns())

        def number(data: bytes) -> None:
            write(data)
            self._streams[topic].add(deserialize_message(data, TOPICS[topic][0]))

        def acknowledge(data: bytes) -> None:
            write(data)
            status = deserialize_message(data, StreamStatus)
            for record in self._streams.values():
                if record.name == status.stream:
                    record.acknowledge(run_id_of(status), int(status.next_sequence))

        def keep(data: bytes) -> None:
            write(data)
            if self._has_last_state():
                return  # setpoints that the machine executes now are not part of the record
            self._state = deserialize_message(data, MachineState)
            for name in EXECUTED:
                if name in self._streams:
                    told = counting(self._state), int(self._state.samples)
                    self._streams[name].acknowledge(*told)

        if topic in NUMBERED:
            return number
        if topic == 'stream_status':
            return acknowledge
        return keep if topic == 'machine_state' else write

    @property
    def count(self) -> int:
        return self._bag.count

    @property
    def fault(self) -> OSError | None:
        """Error that has ended the recording, or None."""
        return self._bag.fault

    def ready(self) -> bool:
        """Request the parameters of the nodes; return whether all nodes have answered."""
        for node in self._parameters.keys() - self._known:
            answer = self._parameters[node].answer()
            if answer is not None:
                values = map(parameter_value_to_python, answer.values)
                self._bag.note(node, dict(zip(self._names[node], values, strict=True)))
                self._known.add(node)
        return len(self._known) == len(self._parameters)

    def complete(self) -> bool:
        """Make the nodes publish collected messages; return whether all messages are recorded."""
        if self._ended is None:
            self._ended = self._node.get_clock().now()
        for node in self._missing():
            if self._flush[node].answer() is not None:
                self._flushed.add(node)
        whole = not any(stream.lost for stream in self._streams.values())
        return not self._missing() and whole and self._has_last_state()

    def _has_last_state(self) -> bool:
        """Return whether a machine state after the end is recorded; they arrive in order."""
        if self._state is None or self._ended is None:
            return self._ended is not None and 'machine_node' not in self._known
        told = Time.from_msg(self._state.header.stamp, self._ended.clock_type)
        return bool(told > self._ended)

    def _missing(self) -> list[str]:
        return sorted(self._known - self._flushed)

    def finish(self, node: ServedNode) -> None:
        """Wait for the last messages, report what is missing, and close the bag."""
        until = time.monotonic() + LAST_WAIT
        while self.fault is None and not self.complete() and time.monotonic() < until:
            node.serve()
        if self.fault is None:
            self._report()
        self.close()

    def _report(self) -> None:
        if not self.complete():
            nodes = ', '.join(self._missing()) or 'machine_node'
            print(f'the bag may lack the last messages of {nodes}', file=sys.stderr)
        lost = [f'{one.lost} {one.name}' for one in self._streams.values() if one.lost]
        if lost:
            text = 'the computer was too busy; record again to replay or compare'
            print(f'the bag lacks {", ".join(lost)}: {text}', file=sys.stderr)

    def close(self) -> None:
        while self._subscriptions:  # the node may live on
            self._node.destroy_subscription(self._subscriptions.pop())
        self._bag.close()


def record(path: Path, namespace: str) -> int:
    """Record until Ctrl-C or SIGTERM; return the number of messages.

    Raises InterpError if the bag cannot be written.
    """
    refuse_existing(path)  # before ROS starts
    with stop_signals() as stop, ServedNode('record', namespace) as served:
        recorder = Recorder(served.node, path)
        try:
            heard = False
            while not stop:
                served.serve()
                if recorder.ready() and not heard:
                    heard = True
                    print(f'recording into {path}; Ctrl-C ends it', file=sys.stderr)
        finally:
            recorder.finish(served)
    return recorder.count
