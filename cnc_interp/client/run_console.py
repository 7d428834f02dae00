"""The terminal of a run: send programs, show progress and results, handle Ctrl-C and Enter."""

from __future__ import annotations

import math
import os
import select
import signal
import sys
import termios
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import MachineState

from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.client.question import SentProgram
from cnc_interp.client.recorder_process import RecorderProcess
from cnc_interp.client.run_request import RunRequest, RunResult
from cnc_interp.core import InterpError
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.feedrate.planner_tuning import tool_warnings
from cnc_interp.machine_model.machine import Machine
from cnc_interp.processes.node_processes import Children
from cnc_interp.processes.temporary_folder import TemporaryFolder
from cnc_interp.program.notices import tell, warnings_of
from cnc_interp.wire.run_messages import add_executed, goal_of

Result = RunProgram.Result
#: Longest wait for the nodes to start; they may have to compile all kernels [s].
START_TIMEOUT = 300.0
#: Reason of a stop -> text that asks the operator to continue.
STOP_TEXTS = {
    MachineState.REASON_PROGRAM_STOP: 'program stop',
    MachineState.REASON_OPTIONAL_STOP: 'optional stop',
    MachineState.REASON_SINGLE_BLOCK: 'single block',
    MachineState.REASON_APPROACH: 'the approach is ready: retract, position, plunge',
    MachineState.REASON_FUNCTION: 'an output waits for the operator',
}
OPERATORS_STOPS = (*STOP_TEXTS, MachineState.REASON_FEED_HOLD, MachineState.REASON_AWAY)
SILENCE = 1.0  #: A node that sends nothing for this time counts as lost [s].
#: If all node processes are alive but nothing is heard for this time, ROS is stuck in this process
#: [s]. Threads of Fast DDS 2.14 may deadlock if a participant leaves while its lease is checked.
DEAF = 30.0
RECORD_TIMEOUT = 60.0  #: Longest wait until all nodes know the recorder [s].
SPIN = 0.05  #: Longest wait for an event [s]; then signals and processes are checked.


#: Figures that are copied from a result, and figures that have a value for each axis.
AS_TOLD = (
    'message',
    'program_id',
    'cycle_time',
    'approach_time',
    'path_length',
    'blocks_sent',
    'blocks_executed',
    'samples',
    'starvations',
    'least_buffered_time',
    'contour_error',
)
BY_AXIS = ('following_error', 'velocity_use', 'acceleration_use', 'jerk_use')


class RunConsole:
    def __init__(
        self,
        client: OperatorClient,
        children: Children,
        request: RunRequest,
        recorder: RecorderProcess | None,
    ):
        self._client, self._children, self._request = client, children, request
        self._recorder = recorder
        self._record_lost = False
        self._progress = ProgressBar(None if request.quiet else sys.stderr)
        self._first_motion = float('nan')
        self._interrupted = self._cancelling = False
        self._restarted = False  # a node, and the run has not gone on since
        self._forgotten = False  # the programs, because program_node was lost
        self._stop_told = False
        self._listened = -math.inf  # when messages were last checked [s]
        self._warned = ''  # the run whose warnings were shown last
        self._pressed: Future[Answer] | None = None  # cycle_start after a restart
        self._passed: Future[Answer] | None = None  # cycle_start after a program stop
        self._previous = {
            number: signal.signal(number, self._interrupt)
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        }

    def _interrupt(self, number: int, _frame: Any) -> None:
        """Handle Ctrl-C, SIGTERM, SIGHUP: the first cancels the program, the second ends at once.

        SIGHUP means that the terminal was closed, so nothing can be written to it.
        """
        if number == signal.SIGHUP:
            sys.stdout = sys.stderr = open(os.devnull, 'w')  # noqa: SIM115
            self._progress = ProgressBar(None)
        if self._interrupted:
            raise KeyboardInterrupt
        self._interrupted = True

    def run(self, machine: Machine, started: float) -> list[RunResult]:
        """Run the programs one after the other; return their results.

        ``started``: monotonic time at which the command began [s]. Raises InterpError if the first
        program is rejected before anything moves, or if a node ends.
        """
        self._wait_for_nodes()
        if machine.guessed and not self._request.quiet:
            tell([machine.guessed])
        programs = [self._send(program) for program in self._request.programs]
        results: list[RunResult] = []
        for sent in programs:
            outcome = self._result_of(sent)
            refused = outcome.code in (Result.BAD_PROGRAM, Result.REFUSED) and not outcome.samples
            if refused and not results:
                raise InterpError(outcome.message)
            results.append(self._as_told(sent.goal.program, outcome, machine, started))
            if self._forgotten:  # and so were the programs after it
                break
        return results

    def _as_told(
        self, program: str, outcome: RunProgram.Result, machine: Machine, started: float
    ) -> RunResult:
        def by_axis(values: Any) -> Any:
            return dict(zip(machine.axis_names, values, strict=False))

        return RunResult(
            ok=outcome.code == Result.SUCCEEDED and outcome.blocks_executed == outcome.blocks_sent,
            program=program,
            machine=machine.name,
            start_to_motion=self._first_motion - started,
            axis_units={axis.name: axis.unit for axis in machine.axes},
            **{name: getattr(outcome, name) for name in AS_TOLD},
            **{name: by_axis(getattr(outcome, name)) for name in BY_AXIS},
            position=by_axis(outcome.positions),
            notices=(*outcome.notices, *filter(None, [machine.guessed])),
            faults=tuple(self._children.faults.values()),
            scene=str(self._request.settings.scene or ''),
            hits=tuple(text for _, text in self._client.hits.values()),
            stock=self._client.stock,
        )

    def _wait_for_nodes(self) -> None:
        """Wait until program_node accepts programs and all nodes know the recorder."""
        recorder = self._recorder
        if recorder is None:
            if not self._spin(lambda: self._client.takes_programs, START_TIMEOUT):
                raise InterpError('program_node does not answer; is another ROS middleware set?')
            return

        def ready() -> bool:
            recorder.ready()
            return not self._client.silent_for(SILENCE)

        if not self._spin(ready, START_TIMEOUT):
            silent = self._client.silent_for(SILENCE)
            raise InterpError(f'{silent} does not answer; is another ROS middleware set?')
        if not self._spin(recorder.ready, RECORD_TIMEOUT):
            raise InterpError('not all topics of the run can be received; run it again')

    def _send(self, program: Path) -> SentProgram:
        sent = self._client.run(goal_of(program, self._request.settings))
        self._spin(lambda: sent.accepted)
        return sent

    def _result_of(self, sent: SentProgram) -> RunProgram.Result:
        def done() -> bool:
            if self._interrupted and not self._cancelling:
                self._cancelling = True
                sent.cancel()
                print(
                    '\ncancelled: blocks already sent are executed, then the machine rests; '
                    'press Ctrl-C again to end at once',
                    file=sys.stderr,
                )
            self._demand_to_hear()
            self._see_motion()
            self._tell_warnings()
            self._tell_lost_record()
            self._bring_back_lost_nodes()
            self._pass_program_stop()
            self._show_progress(sent)
            return self._client.peers.at_rest if self._forgotten else sent.result is not None

        while not done():
            self._client.serve(SPIN)
        result = sent.result
        self._progress.end(result is not None and result.code == Result.SUCCEEDED)
        if self._forgotten or result is None:
            return self._forgotten_result()
        if not self._request.quiet:
            told = warnings_of(result.notices)
            tell([notice for notice in result.notices if notice not in told])
        return result

    def _demand_to_hear(self) -> None:
        now, peers = time.monotonic(), self._client.peers
        if now - self._listened > SILENCE:
            peers.trust(now)  # this process itself was suspended
        self._listened = now
        if now - peers.heard > DEAF:
            raise InterpError(
                f'the nodes have sent nothing for {DEAF:g} s, so they are ended: the machine '
                'stops on its path; run the program again'
            )

    def _tell_warnings(self) -> None:
        program = self._client.program
        if program is not None and program.program_id != self._warned:
            self._warned = program.program_id
            tell(warnings_of(program.start_notes))

    def _tell_lost_record(self) -> None:
        if self._recorder is None or self._record_lost:
            return
        self._recorder.look()
        fault = self._recorder.fault
        if fault is not None:
            self._record_lost = True
            print(f'\n{reason_of(fault)}; the run goes on', file=sys.stderr)

    def _show_progress(self, sent: SentProgram) -> None:
        feedback, name = sent.feedback, Path(sent.goal.program).name
        if self._client.prepared is not None:
            self._progress.show(self._client.waits_for.partition(':')[0], self._client.prepared)
        elif feedback is not None and not feedback.programs_ahead:
            line = f'line {feedback.line_number}' if feedback.line_number else ''
            share, left = feedback.progress, feedback.remaining_time
            self._progress.show(f'running {name}', share, line, left)

    def _forgotten_result(self) -> RunProgram.Result:
        """Return what is known of the result of a run after program_node was lost."""
        result, state = Result(), self._client.state
        if state is not None:
            result.program_id = state.program_id
            add_executed(result, [state])
        return result

    def _bring_back_lost_nodes(self) -> None:
        for name, why in self._children.revive().items():
            print(f'\n{name} {why}; it is started again', file=sys.stderr)
            self._restarted = True
            self._forgotten = self._forgotten or name == 'program_node'
        state = self._client.state
        if state is None or not (state.may_resume and state.plan_over) or state.start_wanted:
            return
        if state.reason in OPERATORS_STOPS:
            self._restarted = False
        if not self._restarted or self._forgotten or self._client.silent_for(SILENCE):
            return
        if self._pressed is None:
            self._pressed = self._client.ask('cycle_start')
        elif self._pressed.done():
            self._restarted, self._pressed = not self._pressed.result().ok, None

    def _pass_program_stop(self) -> None:
        """Continue after a stop (M0) when Enter is pressed, or at once with ``pass_stops``."""
        state = self._client.state
        if (
            state is None
            or state.waits_for != MachineState.WAITS_FOR_CYCLE_START
            or state.reason not in STOP_TEXTS
        ):
            self._stop_told = False
            return
        answers = state.reason == MachineState.REASON_FUNCTION
        # Simulated drives have no operator; at real drives no option may answer for one.
        passes = self._request.pass_stops and (self._request.simulated or not answers)
        asked = not passes and at_terminal()
        if not self._stop_told:
            self._stop_told = True
            if not passes:
                text = state.message if answers else STOP_TEXTS[state.reason]
                stop = f'\nline {state.line_number}: {text}; '
                print(stop + ('Enter to go on' if asked else self._elsewhere()), file=sys.stderr)
            if asked:
                termios.tcflush(sys.stdin, termios.TCIFLUSH)
        if passes:
            if self._passed is None or self._passed.done():
                self._passed = self._client.ask('cycle_start')
        elif asked and enter_pressed():
            self._passed = self._client.ask('cycle_start')

    def _elsewhere(self) -> str:
        space, domain = self._client.namespace, self._client.domain
        return (
            'waits for cycle start. Press it on the page '
            f'(cnc-interp panel --attach --namespace {space} --domain {domain}) or call it '
            f'(ROS_DOMAIN_ID={domain} ros2 service call {space}/cycle_start '
            'std_srvs/srv/Trigger). To run without such stops: --pass-stops'
        )

    def _see_motion(self) -> None:
        state = self._client.state
        if self._first_motion != self._first_motion and state is not None and state.samples:
            past = state.samples * state.interpolation_period
            self._first_motion = time.monotonic() - past

    def _spin(self, done: Callable[[], bool], timeout: float = float('inf')) -> bool:
        """Serve ROS until ``done`` or for ``timeout`` [s]; raise an error if a node has ended."""
        deadline = time.monotonic() + timeout
        while not done():
            if time.monotonic() > deadline:
                return False
            self._children.check()
            self._client.serve(SPIN)
        return True

    def __enter__(self) -> RunConsole:
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)


def at_terminal() -> bool:
    try:
        return sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (AttributeError, OSError, ValueError):  # no input at all, or a closed terminal
        return False


def enter_pressed() -> bool:
    ready = select.select([sys.stdin], [], [], 0.0)[0]
    return bool(ready) and sys.stdin.readline().endswith('\n')


def run_recorded(
    request: RunRequest,
    machine: Machine,
    client: OperatorClient,
    children: Children,
    started: float,
) -> list[RunResult]:
    """Run the programs of a request, and record them if the request or its results need it."""
    tell(tool_warnings(machine, request.settings))
    judged = request.settings.tool_error is not None
    results: list[RunResult] = []
    with bag_folder(request) as folder:
        try:
            with ExitStack() as records:
                recorder = None
                if folder is not None:
                    kept = request.record is not None
                    recorder = RecorderProcess(folder, kept, client.namespace, client.domain)
                    records.callback(recorder.finish)
                with RunConsole(client, children, request, recorder) as console:
                    results = console.run(machine, started)
        except OSError as fault:  # a fault of the record; the result of the run is still reported
            if not results or fault.filename != str(folder):
                raise
            text = reason_of(fault)
            return [replace(one, ok=False, message=f'{one.message}; {text}') for one in results]
        if folder is not None and (request.out is not None or judged):
            results = written(folder, results, machine, request.out)
    return results


def reason_of(fault: Exception) -> str:
    return f'{fault.filename}: {fault.strerror}' if isinstance(fault, OSError) else str(fault)


def written(
    record: Path, results: list[RunResult], machine: Machine, out: Path | None
) -> list[RunResult]:
    """Write plan files of successful runs from a bag; return the results with the tool error."""
    # Imported after the run, because what reads bags takes a third of a second to load.
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_run import recorded_run, write_run

    told = []
    with Bag(record) as bag:
        for result in results:
            if result.ok:
                run = replace(recorded_run(bag, result.program_id), name=result.program)
                with TemporaryFolder() as folder:
                    summary = write_run(run, machine, out or Path(folder))
                found = {name: summary[name] for name in ('tool_error', 'flank_height')}
                result = replace(result, **found)
            told.append(result)
    return told


@contextmanager
def bag_folder(request: RunRequest) -> Iterator[Path | None]:
    """Yield the path of the bag: requested, temporary (if the results need it), or None."""
    if request.record is not None or request.out is None:
        if request.record is not None or request.settings.tool_error is None:
            yield request.record
        else:
            with TemporaryFolder() as folder:
                yield Path(folder) / 'bag'
        return
    created = not request.out.exists()
    request.out.mkdir(parents=True, exist_ok=True)
    try:
        with TemporaryDirectory(prefix='.run-', dir=request.out) as folder:
            yield Path(folder) / 'bag'
    finally:
        if created and not any(request.out.iterdir()):
            request.out.rmdir()
