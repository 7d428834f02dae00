"""The main loop of all nodes: start, spin, and end in a controlled way with exit code 0."""

import contextlib
import ctypes
import gc
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from select import select
from threading import Thread
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from cnc_interp.core import InterpError
from cnc_interp.nodes.qos import DIAGNOSTICS
from cnc_interp.processes.this_host import stay_on_this_host

SPIN_TIMEOUT = 0.1  #: Timeout of the executor while the axes come to rest [s].
#: Timeout of the executor in normal operation [s]; signals and the end of the run wake it.
IDLE_TIMEOUT = 1.0
REST_WAIT = 8.0  #: Longest time to bring the axes to rest before a node ends [s].
LAST_WORDS = Duration(seconds=0.2)  #: Longest wait until a topic's last messages are received.
NICENESS = -10  #: Niceness of the nodes, if permitted: setpoints must not be late.


def run_node(make: Callable[[], Any], words: list[str] | None = None, urgent: bool = True) -> int:
    """Run a node until Ctrl-C, SIGTERM, or the end of ROS or of the parent process."""
    stop: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda found, _frame: stop.append(found))
    if urgent:
        come_first()
    stay_on_this_host()
    rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
    node = executor = waker = None
    read, write = os.pipe()
    os.set_blocking(write, False)
    signal.set_wakeup_fd(write)
    run = multiprocessing.parent_process()
    # A node that was started by a run ends when the run ends.
    ended = [] if run is None else [run.sentinel]
    try:
        node = make()
        node.create_service(Trigger, '~/flush', partial(answer_flush, node))
        executor = EventsExecutor()
        executor.add_node(node)
        gc.collect()
        gc.freeze()  # objects that exist now are never freed, so the collector may ignore them
        waker = Thread(target=wake_at, args=([read, *ended], executor), daemon=True)
        waker.start()
        while not stop and rclpy.ok() and not select(ended, [], [], 0.0)[0]:
            executor.spin_once(timeout_sec=IDLE_TIMEOUT)
        if hasattr(node, 'come_to_rest'):
            until = time.monotonic() + REST_WAIT
            while rclpy.ok() and not node.come_to_rest() and time.monotonic() < until:
                executor.spin_once(timeout_sec=SPIN_TIMEOUT)
            node.publish_rest()
            for publisher in node.publishers:
                publisher.wait_for_all_acked(LAST_WORDS)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except InterpError as problem:
        print(f'cnc_interp: {problem}', file=sys.stderr)
        return 2
    finally:
        if node is not None:
            if hasattr(node, 'close'):
                node.close()
            node.destroy_node()
        if waker is not None:  # before the executor goes
            os.write(write, b'\0')
            waker.join()
        if executor is not None:
            executor.shutdown()
        # A forked process ends without Python's own cleanup. DDS removes its files in shared
        # memory when the last object of ROS is deleted, so all of them are deleted here.
        node = executor = None
        gc.unfreeze()
        gc.collect()
        rclpy.try_shutdown()
    return 0


def wake_at(files: list[int], executor: EventsExecutor) -> None:
    """Wake an executor when one of ``files`` becomes readable, because signals do not wake it."""
    select(files, [], [])
    executor.create_task(lambda: None)


def answering(
    act: Callable[[Any, Any], str], wake: Callable[[], None] = lambda: None
) -> Callable[[Any, Any], Any]:
    """Return a service callback that answers with the text of ``act``, or with its error."""

    def serve(request: Any, response: Any) -> Any:
        wake()
        try:
            response.success, response.message = True, act(request, response)
        except InterpError as problem:
            response.success, response.message = False, str(problem)
        return response

    return serve


def end_goal(handle: Any, result: Any, succeeded: bool, cancelled: bool = True) -> None:
    """End the goal of an action with its result; ``cancelled``: whether it may end as cancelled.

    The result must already exist: rclpy would poll an execute callback that awaits it, and would
    use most of a core.
    """

    def execute(goal: Any) -> Any:
        if succeeded:
            goal.succeed()
        elif cancelled and goal.is_cancel_requested:
            goal.canceled()
        else:
            goal.abort()
        return result

    handle.execute(execute)


def answer_flush(node: Any, _request: Any, response: Any) -> Any:
    """At the end of a recording, publish the messages that the node has collected."""
    if hasattr(node, 'publish_rest'):
        node.publish_rest()
    response.success = True
    return response


def come_first(niceness: int = NICENESS) -> None:
    """Raise the priority of this process and of its session, if that is permitted."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    if os.getsid(0) == os.getpid():  # a session of its own, not that of a shell
        with contextlib.suppress(OSError):
            Path('/proc/self/autogroup').write_text(str(niceness), encoding='ascii')


def transition(node: Any, work: Callable[[], None]) -> TransitionCallbackReturn:
    """Do the work of a lifecycle transition; log why it fails, because rclpy does not."""
    node.problem = ''
    try:
        work()
    except InterpError as problem:
        node.problem = str(problem)
    except Exception as problem:
        node.problem = f'{type(problem).__name__}: {problem}'
    if node.problem:
        node.get_logger().error(node.problem)
        return TransitionCallbackReturn.FAILURE
    return TransitionCallbackReturn.SUCCESS


def start_lifecycle(node: Any) -> None:
    if node.trigger_configure() != TransitionCallbackReturn.SUCCESS:
        raise InterpError(f'{node.get_name()} cannot be configured: {node.problem}')
    node.trigger_activate()


def every(node: Any, period: float, act: Callable[[], None]) -> Any:
    """Call ``act`` at intervals of a steady clock [s], because ``/clock`` may stop."""
    return node.create_timer(period, act, clock=Clock(clock_type=ClockType.STEADY_TIME))


#: Time between two calls at rest [s]. It determines how often nodes report at rest, and their
#: processor load.
REST = 0.5
CALM = 1.0  #: Time without work after which the node counts as resting [s].


def give_back_memory() -> None:
    """Free the memory that a run leaves in reference cycles, and return it to the system.

    Python's collector starts after a number of objects. A run leaves few objects with large
    arrays, so they would stay for many runs. The C library then returns the free memory.
    """
    gc.collect()
    trim = getattr(ctypes.CDLL(None), 'malloc_trim', None)  # of glibc
    if trim is not None:
        trim(0)


class Pace:
    """Calls the work of a node at short intervals while there is any, and rarely at rest."""

    def __init__(self, node: Any, period: float, work: Callable[[], bool]):
        self._work, self._period, self._needed = work, period, time.monotonic()
        self._slow = False
        self._timer = every(node, period, self._call)

    def wake(self) -> None:
        """Return to the short intervals; call it at every command or message."""
        self._needed = time.monotonic()
        if self._slow:
            self._set(False)

    def _call(self) -> None:
        if self._work():
            self.wake()
        elif not self._slow and time.monotonic() - self._needed > CALM:
            self._set(True)
            give_back_memory()

    def _set(self, slow: bool) -> None:
        self._slow = slow
        self._timer.timer_period_ns = round((REST if slow else self._period) * 1e9)
        self._timer.reset()


WAITING = 'waiting'  #: Key: names of waiting programs, from program_node.
TOOL = 'tool'  #: Key: number of the tool that the operator must put in now.
#: Key: distance of the tool tip from the end of its line while it rests in single block [m].
OFF_LINE_END = 'off_line_end'
PREPARED = 'prepared'  #: Key: progress of preparing a program [-].
#: Key: contour error without compensation, from machine_node [m].
WITHOUT = 'contour_error_without_compensation'
#: Key: names of two bodies that hit, or would hit, each other, separated by ``AND``.
BODIES, AND, STOCK = 'bodies', ' | ', 'stock'
OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics:
    def __init__(self, node: Any):
        self._node = node
        self._parts: dict[str, DiagnosticStatus] = {}
        self._publisher = node.create_publisher(DiagnosticArray, '/diagnostics', DIAGNOSTICS)
        every(node, 1.0, self.publish)

    def say(self, part: str, level: bytes, message: str, **values: object) -> None:
        status = DiagnosticStatus(
            level=level,
            name=f'{self._node.get_name()}: {part}',
            message=message,
            hardware_id=self._node.get_namespace(),
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
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
