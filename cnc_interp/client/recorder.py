"""Listens to every topic of a run and writes it into a bag; `cnc-interp record`."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import parameter_value_to_python
from rclpy.signals import SignalHandlerOptions

from cnc_interp.client.bag import TOPICS, BagWriter
from cnc_interp.nodes import parameters
from cnc_interp.nodes.node_main import stay_on_this_host

#: Nodes whose parameters decide what becomes of the same blocks.
ASKED = {
    node: parameters.NODES[node] for node in ('lookahead_node', 'feedrate_node', 'machine_node')
}
#: Topics that a run cannot do without; a recorder that hears them hears the run.
STREAMS = ('blocks', 'segments', 'setpoints', 'executed_setpoints')
#: A publisher that is found finds the recorder within this time [s].
MUTUAL = 0.5


class Recorder:
    """
    Records what the nodes of a namespace say.

    Parameters
    ----------
    node : Node
        Listens; in the namespace of the run.
    path : Path
        Folder of the bag, to be created.

    """

    def __init__(self, node: Any, path: Path):
        self._bag = BagWriter(path)
        self._subscriptions = {
            topic: node.create_subscription(kind, topic, self._taking(topic), profile, raw=True)
            for topic, (kind, profile) in TOPICS.items()
        }
        self._clients = {
            name: node.create_client(GetParameters, f'{name}/get_parameters') for name in ASKED
        }
        self._asked: dict[str, Any] = {}
        self._known: set[str] = set()
        self._found = time.monotonic()  # when a stream was missing last

    def _taking(self, topic: str) -> Callable[[bytes], None]:
        return lambda data: self._bag.write(topic, data, time.time_ns())

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
        if any(self._subscriptions[t].get_publisher_count() == 0 for t in STREAMS):
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
    stop: list[int] = []
    previous = {
        number: signal.signal(number, lambda found, _frame: stop.append(found))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    stay_on_this_host()
    context = rclpy.Context()
    rclpy.init(context=context, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node('record', namespace=namespace, context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    try:
        recorder = Recorder(node, path)
        try:
            heard = False
            while not stop:
                executor.spin_once(timeout_sec=0.1)
                if recorder.ready() and not heard:
                    heard = True
                    print(f'recording into {path}; Ctrl-C ends it', file=sys.stderr)
        finally:
            recorder.close()
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown(context=context)
        for number, handler in previous.items():
            signal.signal(number, handler)
    return recorder.count
