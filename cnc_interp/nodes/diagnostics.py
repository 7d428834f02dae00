"""The diagnostics of a node on ``/diagnostics``: once a second, and changes at once."""

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from cnc_interp.nodes.node_main import every
from cnc_interp.nodes.qos import DIAGNOSTICS

WAITING = 'waiting'  #: Key under which program_node names the programs that wait.
PREPARED = 'prepared'  #: Key of the share of what a program waits for before it moves [-].
#: Key under which machine_node gives the contour error that there were without compensation [m].
WITHOUT = 'contour_error_without_compensation'
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    def __init__(self, node: Any):
        self._node = node
        self._parts: dict[str, DiagnosticStatus] = {}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', DIAGNOSTICS)
        every(node, 1.0, self.publish)

    def say(self, part: str, level: bytes, message: str, **values: object) -> None:
        status = DiagnosticStatus(
            level=level, name=f'{self._node.get_name()}: {part}', message=message,
            hardware_id=self._node.get_namespace(),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )  # fmt: skip
        known = self._parts.get(part)
        self._parts[part] = status
        if known is not None and (known.level, known.message) == (level, message):
            return
        self.publish()
        if level == ERROR:
            self._node.get_logger().error(message)
        elif level == WARN:
            self._node.get_logger().warning(message)

    def publish(self) -> None:
        if not self._parts or not self._node.context.ok():
            return
        array = DiagnosticArray(status=list(self._parts.values()))
        array.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(array)
