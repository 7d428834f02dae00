"""The user's side of a run: sends the goal, shows progress, collects the result."""

from __future__ import annotations

import select
import signal
import sys
import termios
import time
from collections.abc import Callable
from types import TracebackType
from typing import Any

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from cnc_interp.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.nodes.children import Children
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.playback import PROGRAM_STOP
from cnc_interp.nodes.program_run import CHECKING
from cnc_interp.nodes.qos import DIAGNOSTICS, STREAM
from cnc_interp.nodes.recorder import Recorder
from cnc_interp.nodes.running import stay_on_this_host
from cnc_interp.nodes.session import RunRequest, RunResult
from cnc_interp.nodes.showing import Progress

Result = RunProgram.Result
#: When all kernels must be compiled first, starting takes a minute or more [s].
START_TIMEOUT, SLOW_START = 300.0, 8.0
#: How long topics may take to be found, and what was executed to be told [s].
RECORD_TIMEOUT = 10.0


class Client:
    """
    A node that runs one program on others.

    Parameters
    ----------
    namespace : str
        Where the nodes live.
    domain : int
        Their ROS domain.
    children : Children
        Their processes.

    """

    def __init__(self, namespace: str, domain: int, children: Children):
        self._children = children
        stay_on_this_host()
        self._context = rclpy.Context()
        rclpy.init(
            context=self._context,
            domain_id=domain,
            signal_handler_options=SignalHandlerOptions.NO,
        )
        self._node = rclpy.create_node('run', namespace=namespace, context=self._context)
        self._executor = EventsExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._action = ActionClient(self._node, RunProgram, 'run_program')
        self._peers = Peers(self._node)
        self._cycle_start = self._node.create_client(Trigger, 'cycle_start')
        self._restarted = self._attended = self._stop_told = False
        self.received: list[SetpointChunk] = []
        self._feedback: RunProgram.Feedback | None = None
        self._first_motion = float('nan')
        self._interrupted = False
        self._checking = ''
        self._node.create_subscription(DiagnosticArray, '/diagnostics', self._hear, DIAGNOSTICS)
        self._previous = {
            number: signal.signal(number, self._interrupt)
            for number in (signal.SIGINT, signal.SIGTERM)
        }

    def _interrupt(self, _number: int, _frame: Any) -> None:
        """Ctrl-C or SIGTERM: a second one ends at once."""
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True

    def run(
        self, request: RunRequest, machine: Machine, started: float, attended: bool
    ) -> RunResult:
        """
        Run a program to its end.

        Parameters
        ----------
        request : RunRequest
            What shall be run.
        machine : Machine
            Its axes.
        started : float
            When the command began, in monotonic time [s].
        attended : bool
            Whether an operator has buttons; else program stops wait for Enter on a terminal, and
            for nobody where there is none.

        Raises
        ------
        InterpError
            When the program was refused before anything moved, or a node ended.

        """
        if request.out is not None or request.record is not None:
            self._node.create_subscription(
                SetpointChunk, 'executed_setpoints', self.received.append, STREAM
            )
        self._attended = attended
        recorder = Recorder(self._node, request.record) if request.record is not None else None
        try:
            return self._run(request, machine, started, recorder)
        finally:
            if recorder is not None:
                recorder.close()

    def _run(
        self, request: RunRequest, machine: Machine, started: float, recorder: Recorder | None
    ) -> RunResult:
        """Run a program while what is said is recorded."""
        self._wait_for_nodes()
        if recorder is not None and not self._spin(recorder.ready, RECORD_TIMEOUT):
            raise InterpError(f'{request.record}: not all topics of the run can be heard')
        outcome = self._execute(request)
        if request.out is not None or recorder is not None:
            self._wait_for_record(
                outcome.samples + round(outcome.approach_time / self._peers.period)
            )
        if outcome.code in (Result.BAD_PROGRAM, Result.REFUSED) and not outcome.samples:
            raise InterpError(outcome.message)
        names = machine.axis_names

        def by_axis(values: Any) -> dict[str, float]:
            return dict(zip(names, values, strict=False))

        return RunResult(
            ok=outcome.code == Result.SUCCEEDED and outcome.blocks_executed == outcome.blocks_sent,
            message=outcome.message,
            program=str(request.program),
            machine=machine.name,
            program_id=outcome.program_id,
            cycle_time=outcome.cycle_time,
            approach_time=outcome.approach_time,
            start_to_motion=self._first_motion - started,
            path_length=outcome.path_length,
            blocks_sent=outcome.blocks_sent,
            blocks_executed=outcome.blocks_executed,
            samples=outcome.samples,
            starvations=outcome.starvations,
            least_buffered_time=outcome.least_buffered_time,
            contour_error=outcome.contour_error,
            following_error=by_axis(outcome.following_error),
            velocity_use=by_axis(outcome.velocity_use),
            acceleration_use=by_axis(outcome.acceleration_use),
            jerk_use=by_axis(outcome.jerk_use),
            position=by_axis(self._peers.state.positions if self._peers.state else ()),
            notices=tuple(outcome.notices),
        )

    def _wait_for_record(self, count: int) -> None:
        """Wait until all setpoints executed were told."""
        self._spin(lambda: sum(len(m.sequences) for m in self.received) >= count, RECORD_TIMEOUT)

    def _wait_for_nodes(self) -> None:
        """Wait until all four nodes answer; the first start ever compiles for a while."""
        began = time.monotonic()
        told = False

        def ready() -> bool:
            nonlocal told
            waited = time.monotonic() - began
            if waited > SLOW_START and not told:
                told = True
                print('compiling the kernels, once; takes a minute or two', file=sys.stderr)
            return self._action.server_is_ready() and not self._peers.missing(
                time.monotonic(), 1.0
            )

        if not self._spin(ready, START_TIMEOUT):
            silent = self._peers.missing(time.monotonic(), 1.0) or 'program_node'
            raise InterpError(f'{silent} does not answer; is another ROS middleware set?')

    def _execute(self, request: RunRequest) -> RunProgram.Result:
        """Send the goal and wait for its result, showing progress; cancel when interrupted."""
        goal = RunProgram.Goal(
            program=str(request.program),
            contour_tolerance=request.contour_tolerance,
            orientation_tolerance=request.orientation_tolerance,
            force_tolerances=request.force_tolerances,
            flank_height=request.flank_height,
            feedrate=request.feedrate or 0.0,
        )
        accepted = self._action.send_goal_async(goal, feedback_callback=self._take_feedback)
        self._spin(accepted.done)
        handle = accepted.result()
        wanted = handle.get_result_async()
        progress = Progress(None if request.quiet else sys.stderr)
        cancelling = False

        def done() -> bool:
            nonlocal cancelling
            if self._interrupted and not cancelling:
                cancelling = True
                handle.cancel_goal_async()
                print(
                    '\ncancelled: the blocks on their way are executed, then the machine rests; '
                    'once more ends at once',
                    file=sys.stderr,
                )
            self._see_motion()
            self._bring_back_lost_nodes()
            self._pass_program_stop()
            if self._checking:
                progress.checking(self._checking)
            if self._feedback is not None:
                progress.show(self._feedback)
            return bool(wanted.done())

        self._spin(done)
        answer = wanted.result()
        progress.end(answer.result.code == Result.SUCCEEDED)
        result: RunProgram.Result = answer.result
        if not request.quiet:
            for notice in result.notices:
                print(f'note: {notice}', file=sys.stderr)
        return result

    def _bring_back_lost_nodes(self) -> None:
        """Start killed nodes again, and go on from where the machine has stopped."""
        for name in self._children.revive():
            print(f'\n{name} was killed; it is started again', file=sys.stderr)
            self._restarted = True
        state = self._peers.state
        stands = state is not None and state.plan_over and not state.start_wanted
        if self._restarted and stands and not self._peers.missing(time.monotonic(), 1.0):
            self._restarted = False
            self._cycle_start.call_async(Trigger.Request())

    def _pass_program_stop(self) -> None:
        """Where the program waits for its operator (M0), go on after Enter."""
        state = self._peers.state
        waits = (
            state is not None
            and state.state == MachineState.HELD
            and state.message == PROGRAM_STOP
            and not state.start_wanted
        )
        if not waits or state is None:
            self._stop_told = False
            return
        if sys.stdin.isatty():
            if not self._stop_told:
                self._stop_told = True
                print(f'\nline {state.line_number}: program stop; Enter to go on', file=sys.stderr)
                termios.tcflush(sys.stdin, termios.TCIFLUSH)
            if not select.select([sys.stdin], [], [], 0.0)[0]:
                return
            sys.stdin.readline()
        elif self._attended:
            return
        self._cycle_start.call_async(Trigger.Request())

    def _hear(self, array: DiagnosticArray) -> None:
        """Note how far the check of the program is."""
        for status in array.status:
            if status.hardware_id == self._node.get_namespace() and CHECKING in status.message:
                self._checking = status.message

    def _take_feedback(self, message: Any) -> None:
        self._feedback = message.feedback

    def _see_motion(self) -> None:
        """Note when the machine executed its first setpoint."""
        state = self._peers.state
        if self._first_motion != self._first_motion and state is not None and state.samples:
            past = state.samples * state.interpolation_period
            self._first_motion = time.monotonic() - past

    def _spin(self, done: Callable[[], bool], timeout: float = float('inf')) -> bool:
        """Serve ROS until something is done; the nodes must live."""
        deadline = time.monotonic() + timeout
        while not done():
            if time.monotonic() > deadline:
                return False
            self._children.check()
            self._executor.spin_once(timeout_sec=0.05)
        return True

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        fault: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._executor.shutdown()
        self._action.destroy()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
