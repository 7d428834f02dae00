"""The user's side of a run: sends the goal, shows progress, collects the result."""

from __future__ import annotations

import select
import signal
import sys
import termios
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import rclpy
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState, SetpointChunk
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from cnc_interp.client.goal_sender import AskedGoal
from cnc_interp.client.progress_bar import Progress
from cnc_interp.client.recorder import Recorder
from cnc_interp.client.session import RunRequest, RunResult
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.machine.playback import PROGRAM_STOP
from cnc_interp.nodes.node_main import stay_on_this_host
from cnc_interp.nodes.node_processes import Children
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.program_run import CHECKING
from cnc_interp.nodes.qos import DIAGNOSTICS, STREAM

Result = RunProgram.Result
#: When all kernels must be compiled first, starting takes a minute or more [s].
START_TIMEOUT = 300.0
#: How long topics may take to be found, and what was executed to be told [s].
RECORD_TIMEOUT = 10.0


class Goal(NamedTuple):
    """A program that was sent, the handle of its goal, and what shows how far it is."""

    program: Path
    handle: Any
    progress: Progress


class Client:
    """
    A node that runs programs on others.

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
        self._first_motion = float('nan')
        self._interrupted = self._cancelling = False
        self._forgotten = False  # by a program_node that was killed
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
    ) -> list[RunResult]:
        """
        Run one program after the other, each to its end.

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
            When the first was refused before anything moved, or a node ended.

        """
        if request.out is not None or request.record is not None:
            executed = self._node.create_subscription(
                SetpointChunk, 'executed_setpoints', self.received.append, STREAM
            )
            self._spin(lambda: executed.get_publisher_count() > 0, START_TIMEOUT)
        self._attended = attended
        recorder = Recorder(self._node, request.record) if request.record is not None else None
        try:
            return self._run(request, machine, started, recorder)
        finally:
            if recorder is not None:
                recorder.close()

    def _run(
        self, request: RunRequest, machine: Machine, started: float, recorder: Recorder | None
    ) -> list[RunResult]:
        """Run all programs while what is said is recorded."""
        self._wait_for_nodes()
        if recorder is not None and not self._spin(recorder.ready, RECORD_TIMEOUT):
            raise InterpError(f'{request.record}: not all topics of the run can be heard')
        goals = [self._send(request, program) for program in request.programs]
        results: list[RunResult] = []
        count = 0
        for goal in goals:
            outcome = self._result_of(goal, request)
            count += outcome.samples + round(outcome.approach_time / self._peers.period)
            if request.out is not None or recorder is not None:
                self._wait_for_record(count)
            refused = outcome.code in (Result.BAD_PROGRAM, Result.REFUSED) and not outcome.samples
            if refused and not results:
                raise InterpError(outcome.message)
            results.append(self._result(goal.program, outcome, machine, started))
            if self._forgotten:  # and those that waited, too
                break
        return results

    def _result(
        self, program: Path, outcome: RunProgram.Result, machine: Machine, started: float
    ) -> RunResult:
        """Turn the result of a goal into that of the run."""
        names = machine.axis_names

        def by_axis(values: Any) -> dict[str, float]:
            return dict(zip(names, values, strict=False))

        return RunResult(
            ok=outcome.code == Result.SUCCEEDED and outcome.blocks_executed == outcome.blocks_sent,
            message=outcome.message,
            program=str(program),
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
            axis_units={axis.name: axis.unit for axis in machine.axes},
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
        """Wait until all four nodes answer."""

        def ready() -> bool:
            return self._action.server_is_ready() and not self._peers.missing(
                time.monotonic(), 1.0
            )

        if not self._spin(ready, START_TIMEOUT):
            silent = self._peers.missing(time.monotonic(), 1.0) or 'program_node'
            raise InterpError(f'{silent} does not answer; is another ROS middleware set?')

    def _send(self, request: RunRequest, program: Path) -> Goal:
        """Send a program; it waits for those before it."""
        wanted = RunProgram.Goal(
            program=str(program),
            contour_tolerance=request.contour_tolerance,
            orientation_tolerance=request.orientation_tolerance,
            force_tolerances=request.force_tolerances,
            flank_height=request.flank_height,
            feedrate=request.feedrate or 0.0,
        )
        progress = Progress(None if request.quiet else sys.stderr)
        asked = AskedGoal(self._action, wanted, lambda message: progress.show(message.feedback))
        self._spin(lambda: asked.handle is not None)
        return Goal(program, asked.handle, progress)

    def _result_of(self, goal: Goal, request: RunRequest) -> RunProgram.Result:
        """Wait for the result of a program; cancel it when interrupted."""
        wanted = goal.handle.get_result_async()

        def done() -> bool:
            if self._interrupted and not self._cancelling:
                self._cancelling = True
                goal.handle.cancel_goal_async()
                print(
                    '\ncancelled: the blocks on their way are executed, then the machine rests; '
                    'once more ends at once',
                    file=sys.stderr,
                )
            self._see_motion()
            self._bring_back_lost_nodes()
            self._pass_program_stop()
            if self._checking:
                goal.progress.checking(self._checking)
            return bool(wanted.done()) or (self._forgotten and self._peers.at_rest)

        self._spin(done)
        if not wanted.done():
            return self._forgotten_result()
        result: RunProgram.Result = wanted.result().result
        goal.progress.end(result.code == Result.SUCCEEDED)
        if not request.quiet:
            for notice in result.notices:
                print(f'note: {notice}', file=sys.stderr)
        return result

    def _forgotten_result(self) -> RunProgram.Result:
        """Tell what is known of a run whose program_node was killed."""
        text = 'program_node was killed and has forgotten the program; run it again'
        state = self._peers.state
        if state is None:
            return Result(code=Result.STREAM_LOST, message=text)
        period = self._peers.period
        return Result(
            code=Result.STREAM_LOST,
            message=text,
            program_id=state.program_id,
            samples=state.samples - state.approach_samples,
            approach_time=state.approach_samples * period,
            cycle_time=max(0, state.samples - state.approach_samples - 1) * period,
            blocks_executed=state.sequence,
            path_length=max(0.0, state.path_position),
            starvations=state.starvations,
        )

    def _bring_back_lost_nodes(self) -> None:
        """Start killed nodes again, and go on from where the machine has stopped."""
        for name in self._children.revive():
            print(f'\n{name} was killed; it is started again', file=sys.stderr)
            self._restarted = True
            self._forgotten = self._forgotten or name == 'program_node'
        state = self._peers.state
        stands = state is not None and state.plan_over and not state.start_wanted
        if (
            self._restarted
            and not self._forgotten
            and stands
            and not self._peers.missing(time.monotonic(), 1.0)
        ):
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
        """Note how far the check of the program is, while there is one."""
        for status in array.status:
            mine = status.hardware_id == self._node.get_namespace()
            if mine and status.name == 'program_node: program':
                self._checking = status.message if CHECKING in status.message else ''

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

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._executor.shutdown()
        self._action.destroy()
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)
