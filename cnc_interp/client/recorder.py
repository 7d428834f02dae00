"""Records the messages of a run into a bag, with the parameters of its nodes."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from cnc_interp_msgs.msg import SetpointChunk
from rcl_interfaces.srv import GetParameters
from rclpy.parameter import parameter_value_to_python
from rclpy.serialization import deserialize_message

from cnc_interp.client.bag import TOPICS, BagWriter, refuse_existing
from cnc_interp.client.operator_client import OperatorClient
from cnc_interp.client.stop_signals import stop_signals
from cnc_interp.nodes import parameters

#: Nodes whose parameters decide what becomes of the same blocks.
ASKED = {
    node: parameters.NODES[node] for node in ('lookahead_node', 'feedrate_node', 'machine_node')
}
#: Topics that every run has. A recorder that receives all of them is connected to the run.
STREAMS = ('blocks', 'segments', 'setpoints', 'executed_setpoints')
#: Topics from which plan files are written.
NEEDED = ('loaded_program', 'blocks', 'segments', 'executed_setpoints', 'machine_state')
#: A publisher that is found finds the recorder within this time [s].
MUTUAL = 0.5


class Recorder:
    """
    Records the topics of a namespace.

    Parameters
    ----------
    node : Node
        Listens; in the namespace of the run.
    path : Path
        Folder of the bag, to be created.
    topics : iterable of str
        What is recorded, of ``TOPICS``.

    """

    def __init__(self, node: Any, path: Path, topics: Iterable[str] = TOPICS):
        self._bag = BagWriter(path)
        self._subscriptions = {
            topic: node.create_subscription(
                TOPICS[topic][0], topic, self._writing(topic), TOPICS[topic][1], raw=True
            )
            for topic in topics
        }
        self._clients = {
            name: node.create_client(GetParameters, f'{name}/get_parameters') for name in ASKED
        }
        self._asked: dict[str, Any] = {}
        self._known: set[str] = set()
        self._found = time.monotonic()  # when a stream was missing last
        self.executed = 0

    def _writing(self, topic: str) -> Callable[[bytes], None]:
        """Return the callback of a topic; that of executed setpoints counts them, too."""

        def write(data: bytes) -> None:
            self._bag.write(topic, data, time.time_ns())

        def count(data: bytes) -> None:
            write(data)
            self.executed += len(deserialize_message(data, SetpointChunk).sequences)

        return count if topic == 'executed_setpoints' else write

    @property
    def count(self) -> int:
        """Messages recorded so far."""
        return self._bag.count

    def ready(self) -> bool:
        """Ask the nodes for their parameters; tell whether they and their streams are there."""
        for node, client in self._clients.items():
            answer = self._asked.get(node)
            if answer is None and client.service_is_ready():
                names = [parameter.name for parameter in ASKED[node]]
                self._asked[node] = client.call_async(GetParameters.Request(names=names))
            elif answer is not None and answer.done() and node not in self._known:
                values = map(parameter_value_to_python, answer.result().values)
                names = [parameter.name for parameter in ASKED[node]]
                self._bag.note(node, dict(zip(names, values, strict=True)))
                self._known.add(node)
        streams = [self._subscriptions[t] for t in STREAMS if t in self._subscriptions]
        if any(stream.get_publisher_count() == 0 for stream in streams):
            self._found = time.monotonic()
        heard = time.monotonic() - self._found > MUTUAL
        return heard and len(self._known) == len(ASKED)

    def close(self) -> None:
        """Complete the bag."""
        self._bag.close()


def record(path: Path, namespace: str) -> int:
    """
    Record until Ctrl-C or SIGTERM; returns the number of messages.

    Raises
    ------
    InterpError
        If the bag cannot be made.

    """
    refuse_existing(path)  # before ROS starts
    with stop_signals() as stop, OperatorClient('record', namespace) as client:
        recorder = Recorder(client.node, path)
        try:
            heard = False
            while not stop:
                client.serve(0.1)
                if recorder.ready() and not heard:
                    heard = True
                    print(f'recording into {path}; Ctrl-C ends it', file=sys.stderr)
        finally:
            recorder.close()
    return recorder.count
