"""A ROS node in its own context, served by a loop in this process."""

import faulthandler
from typing import Self

import rclpy
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions

from cnc_interp.processes.stop_signals import stops_later
from cnc_interp.processes.this_host import stay_on_this_host

SPIN = 0.1  #: Longest wait for an event [s].
LAST_WAIT = 20.0  #: Longest wait until ROS has ended in this process [s].


class ServedNode:
    """A ROS node served by ``serve``; by default, the environment names the domain."""

    def __init__(self, name: str, namespace: str, domain: int | None = None):
        stay_on_this_host()
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context, domain_id=domain, signal_handler_options=SignalHandlerOptions.NO
        )
        self.node = rclpy.create_node(name, namespace=namespace, context=self._context)
        self.namespace: str = self.node.get_namespace()
        self.domain: int = self._context.get_domain_id()
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self.node)

    def serve(self, timeout: float = SPIN) -> None:
        with stops_later():
            self._executor.spin_once(timeout_sec=timeout)

    def close(self) -> None:
        # Fast DDS may block here for ever, and with it the interpreter (``run_console.DEAF``).
        faulthandler.dump_traceback_later(LAST_WAIT, exit=True, file=2)
        try:
            self._executor.shutdown()
            self._destroy()
            rclpy.shutdown(context=self._context)
        finally:
            faulthandler.cancel_dump_traceback_later()

    def _destroy(self) -> None:
        self.node.destroy_node()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
