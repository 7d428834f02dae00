"""The program node: serves the action ``run_program``, and sends ``block_batches``."""

import math
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from functools import partial, reduce
from typing import Any

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1BlockBatch, LoadedProgram, MachineState, ModalState, ProbeContact
from cnc_interp_msgs.srv import SwitchOutputs
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.node import Node
from std_srvs.srv import Trigger

from cnc_interp.core import MM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.nodes import parameters
from cnc_interp.nodes.kernel_warmup import warm_kinematics
from cnc_interp.nodes.node_main import (
    OFF_LINE_END,
    OK,
    PREPARED,
    TOOL,
    WAITING,
    WARN,
    Diagnostics,
    Pace,
    give_back_memory,
    run_node,
)
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.program_check import Prepared, prepare, prepare_line, prepare_on
from cnc_interp.nodes.program_run import BlockFeed, ProgramQueue, ProgramRun, answer, why_not
from cnc_interp.nodes.qos import CONTACTS, LOADED
from cnc_interp.nodes.seals import SealedPublisher, hear
from cnc_interp.nodes.setup_services import SetupServices
from cnc_interp.nodes.streams import Outlet
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates
from cnc_interp.program.job import JobSetup
from cnc_interp.program.reading import MDI, MdiReader
from cnc_interp.program.setup_table import SetupTable
from cnc_interp.run.run_history import RunHistory, RunTimes
from cnc_interp.run.run_phase import SENDING, Code, Outcome, Phase
from cnc_interp.settings.options import Settings
from cnc_interp.wire.path_messages import function_messages
from cnc_interp.wire.run_messages import add_executed, modal_state, run_feedback, state_of


class Mdi:
    def __init__(
        self,
        node: Any,
        transform: Transform,
        settings: Settings,
        of_machine: Callable[[], JobSetup],
    ):
        self._transform, self._settings, self._of_machine = transform, settings, of_machine
        self._reader = MdiReader(transform, settings)
        self._publisher = node.create_publisher(ModalState, 'modal_state', LOADED)
        self._told: JobSetup | None = None

    def tell(self) -> None:
        """Publish the modal state if the offsets or tools of the machine have changed."""
        if (setup := self._of_machine()) is not self._told:
            self._told = setup
            self._publisher.publish(modal_state(self._reader.modes(setup)))

    def coordinates(self, setup: JobSetup) -> ProgramCoordinates:
        """Return the program coordinates of the next MDI line, with the offsets of ``setup``."""
        return self._reader.modes(setup).frame

    def refusal(self, run: ProgramRun, peers: Peers, missing: str, busy: bool) -> Outcome | None:
        """Return why an MDI line cannot start now; otherwise store the machine's position."""
        if busy:
            return Outcome(Code.BUSY, 'a program is running; enter the line when it has ended')
        machine = peers.machine
        run.name, run.stands = MDI, None if machine is None else machine.stands
        return why_not(missing, machine)

    def prepare(self, run: ProgramRun, goal: Any) -> Prepared:
        assert run.stands is not None
        return prepare_line(
            goal,
            self._reader,
            self._of_machine(),
            run.stands,
            self._transform,
            self._settings,
            run.preparation.has_checked,
        )

    def keep(self, prepared: Prepared | None) -> None:
        if prepared is not None and prepared.line is not None:
            self._reader.keep(prepared.line)
            self._told = None
            self.tell()


class ActiveModesTopic:
    def __init__(self, node: Any):
        self._publisher = node.create_publisher(ModalState, 'active_modes', LOADED)
        self._told = ('', -1)

    def tell(self, program: Prepared, state: MachineState) -> None:
        change = program.modes.change_before(state.sequence)
        told = (str(state.program_id), change)
        if told == self._told:
            return
        self._told = told
        if (modes := program.modes.after(change)) is None:
            self._publisher.publish(ModalState(program_id=state.program_id))
        else:
            self._publisher.publish(modal_state(modes, state.program_id))


Result = RunProgram.Result
WORK_PERIOD = 0.02  #: Time between two calls of a run's step [s].
FEEDBACK = 0.1  #: Time between two feedback messages of the action [s].
ALIVE = 1.0  #: Time between empty messages while single block holds blocks back [s].
PRESS_AGAIN = 0.25  #: Time until a service of the machine is called again [s].
FROZEN = 0.5  #: If this node was suspended longer, silence of others is ignored [s].


class ProgramNode(Node):
    """Runs one program at a time. Goals that arrive meanwhile are queued."""

    def __init__(self) -> None:
        super().__init__('program_node')
        self._values = parameters.declare(self, parameters.PROGRAM)
        settings = parameters.settings_of(self._values)
        self._table = SetupTable(settings.setup)
        self._settings = replace(settings, setup=None)  # a goal without one gets the table
        self._transform = Transform.of(Machine.load(self._values['machine']))
        warm_kinematics(self._values['machine'], self._settings.interpolation_period)
        self._run: ProgramRun | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix='prepare')
        self._diagnostics = Diagnostics(self)
        self._peers = Peers(self, len(self._transform.machine.axis_names), self._diagnostics)
        self._mdi = Mdi(self, self._transform, self._settings, lambda: self._table.setup)
        services = self._table, self._transform, self._peers, self._mdi.coordinates
        self._pace = Pace(self, WORK_PERIOD, self._work)
        require = None
        if settings.scene is not None:
            from cnc_interp.collision.scene_file import read_scene, require_tool

            require = partial(require_tool, read_scene(settings.scene))
        self._setup = SetupServices(self, *services, self._pace.wake, require)
        self._signals = self._transform.machine.signals
        self._feed = BlockFeed(self._signals)
        self._switch = self.create_client(SwitchOutputs, 'switch_outputs')
        self._outlet = Outlet(
            self,
            'blocks',
            G1BlockBatch,
            self._values['resend_after'],
            self._feed.message,
            topic='block_batches',
        )
        self._loaded = SealedPublisher(self, LoadedProgram, 'loaded_program', LOADED)
        self._state: MachineState | None = None  # the last one of the run
        self._feedback_at = self._worked_at = self._pressed_at = self._alive_at = 0.0
        self._waits_since = math.inf
        self._queue = ProgramQueue()
        self._history = RunHistory(self._values['run_history'])
        self._contacts: dict[str, ProbeContact] = {}  # the last one, by its run
        tell = self._diagnostics, self._peers.foreign.add
        hear(self, ProbeContact, 'probe_contact', self._see_contact, CONTACTS, *tell)
        self._modes = ActiveModesTopic(self)
        self._buttons = {k: self.create_client(Trigger, k) for k in ('feed_hold', 'reset')}
        self._server = ActionServer(
            self,
            RunProgram,
            'run_program',
            lambda _: Result(),
            handle_accepted_callback=self._accept,
            goal_callback=lambda _: GoalResponse.ACCEPT,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )
        self._diagnostics.say('program', OK, 'no program')

    def _accept(self, handle: Any) -> None:
        self._pace.wake()
        run = ProgramRun(handle.request)
        if handle.request.mdi:
            missing = self._peers.missing(time.monotonic(), self._values['peer_timeout'])
            busy = self._run is not None or bool(self._queue.names)
            if (outcome := self._mdi.refusal(run, self._peers, missing, busy)) is not None:
                answer(handle, run.result(outcome))
                return
        run.preparation.future = self._prepare(run, handle)
        self._queue.add(run, handle)

    def _prepare(self, run: ProgramRun, handle: Any) -> Future[Prepared]:
        if handle.request.mdi:
            return self._worker.submit(self._mdi.prepare, run, handle.request)
        return self._worker.submit(
            prepare,
            handle.request,
            self._transform,
            self._settings,
            run.preparation.has_checked,
            self._values['program_folders'],
            lambda: self._table.setup,
        )

    def _work(self) -> bool:
        now = time.monotonic()
        if self._run is None and (following := self._queue.next()) is not None:
            (self._run, self._goal), self._state = following, None
            self._run.take_turn(now)
            self._times = RunTimes(now)
            self._peers.foreign.clear()
        self._queue.watch()
        self._mdi.tell()
        run = self._run
        if run is None:
            self._see_unknown_run(now)
            return bool(self._queue.names)
        if now - self._worked_at > FROZEN:
            self._peers.trust(now)
        self._worked_at = now
        if self._goal.is_cancel_requested:
            run.preparation.cancelled = True
        state = self._peers.state
        if state is not None and state.program_id == run.run_id.program_id:
            self._state = state
            self._times.see(state_of(state), now)
        run.contact = self._contacts.get(run.run_id.program_id)
        if run.is_stale(self._table.setup):
            run.check_again(self._prepare(run, self._goal), now)
        before = run.phase
        outcome = run.step(self._peers, now, self._values['peer_timeout'])
        if before is Phase.WAITING and run.phase is Phase.OFFERED:
            self._begin(run)
            if not run.parts:
                self._times = RunTimes(now)
            self._loaded.publish(run.loaded())
            program = run.preparation.prepared
            assert program is not None
            used = frozenset[str]() if program.is_own_setup else program.used
            run_id = '' if program.is_own_setup else run.run_id.program_id
            self._setup.use(run.name, run_id, used)
        if run.phase in SENDING:
            self._send_blocks(now)
            self._tell_progress(run.preparation.prepared, now)
        if self._state is not None and run.preparation.prepared is not None:
            self._modes.tell(run.preparation.prepared, self._state)
        self._tell_programs(run)
        self._keep_changes(run, outcome)
        if outcome is not None:
            self._finish(run, outcome)
        elif run.probed is not None:
            self._read_on(run, *run.probed, now)
        elif run.phase in SENDING:
            self._help(run, now)
        return True

    def _begin(self, run: ProgramRun) -> None:
        assert run.preparation.prepared is not None
        if run.rests_throughout:
            functions, signals = run.preparation.prepared.functions, self._signals
            request = SwitchOutputs.Request(functions=function_messages(functions, 0, signals))
            run.answer = self._switch.call_async(request)
            return
        program = run.preparation.prepared
        self._feed.begin(program, run.run_id, run.continue_at, self._outlet.sender)

    def _send_blocks(self, now: float) -> None:
        told, state = self._peers.state, self._state
        single_block = told is not None and told.single_block
        self._feed.fill(
            self._outlet.sender, single_block, 0 if state is None else int(state.sequence)
        )
        self._outlet.pump()
        if self._feed.holds_back and now - self._alive_at > ALIVE:
            self._alive_at = now
            self._outlet.publish(G1BlockBatch())
            if state is None or state.waits_for == MachineState.WAITS_FOR_SETPOINTS:
                self._feed.ahead += 1  # some lines have no motion

    def _see_contact(self, contact: ProbeContact) -> None:
        self._contacts = {contact.program_id: contact}

    def _read_on(
        self, run: ProgramRun, stands: FloatArray, at: FloatArray | None, now: float
    ) -> None:
        """Continue reading a program after its probe; its changes of the setup apply first."""
        before, state = run.preparation.prepared, self._state
        assert before is not None and state is not None
        self._keep_changes(run, Outcome(Code.SUCCEEDED, ''))
        future = self._worker.submit(
            prepare_on,
            before,
            stands,
            at,
            self._table.setup,
            self._transform,
            run.preparation.has_checked,
        )
        run.read_on(future, state, self._outlet.sender.sent, now)
        self._feed.end(self._outlet.sender)
        self._state = None

    def _see_unknown_run(self, now: float) -> None:
        """Tell the operator to reset if the machine waits in a run unknown to this node."""
        state = self._peers.state
        if state is None or not state.program_id:
            return
        waits = state.waits_for == MachineState.WAITS_FOR_SETPOINTS
        self._waits_since = min(self._waits_since, now) if waits else math.inf
        if state.start_wanted or now - self._waits_since > self._values['peer_timeout']:
            text = 'the program of this run is not known here any more; reset, then run it again'
            self._diagnostics.say('program', WARN, text)

    def _help(self, run: ProgramRun, now: float) -> None:
        if run.preparation.cancelled:
            self._press('reset' if run.may_reset else 'feed_hold', now)
        elif run.may_go_on():
            run.begin_again(now, self._outlet.sender.sent)
            self._begin(run)

    def _tell_programs(self, run: ProgramRun) -> None:
        waiting = ', '.join(self._queue.names)
        values: dict[str, object] = {WAITING: waiting}
        text, waits_for = f'running {run.name}', run.waits_for(self._peers)
        state = self._peers.state
        if waits_for is not None and not run.trouble:
            text, values[PREPARED] = waits_for
        if (tool := run.tool_wanted(state, self._signals)) is not None:
            values[TOOL] = tool
        if state is not None and (off := run.off_line_end(state)) is not None:
            values[OFF_LINE_END] = off
            text += f'; rests {off / MM:.3f} mm from the end of line {state.line_number}'
        text += f'; then {waiting}' if waiting else ''
        level, text = (WARN, run.trouble) if run.trouble else (OK, text)
        self._diagnostics.say('program', level, text, **values)

    def _keep_changes(self, run: ProgramRun, outcome: Outcome | None) -> None:
        """Apply the program's changes of offsets and tools up to the last executed block."""
        state = self._state
        ended = outcome is not None and outcome.code is Code.SUCCEEDED
        if not ended and (state is None or not state.samples):
            return
        changes = run.take_changes(0 if state is None else int(state.sequence), ended)
        if run.proposes:
            run.proposed += [found.change for found in changes]
        elif changes:
            try:
                who = f'{run.name} line {changes[-1].line_number}'
                self._setup.apply([found.change for found in changes], who)
            except InterpError as problem:
                self._diagnostics.say('setup', WARN, str(problem))

    def _press(self, button: str, now: float) -> None:
        """Call a service of the machine; repeat it at intervals, because an answer may be lost."""
        if now - self._pressed_at > PRESS_AGAIN:
            self._pressed_at = now
            self._buttons[button].call_async(Trigger.Request())

    def _tell_progress(self, program: Prepared | None, now: float) -> None:
        due = now - self._feedback_at > FEEDBACK
        if due and self._state is not None and program is not None:
            self._feedback_at = now
            self._goal.publish_feedback(run_feedback(self._state, program.path_length))

    def _finish(self, run: ProgramRun, outcome: Outcome) -> None:
        if self._peers.foreign:
            senders = '; '.join(sorted(self._peers.foreign))
            text = f'{outcome.message}. Messages of other nodes were ignored: {senders}'
            outcome = replace(outcome, message=text)
        result = run.result(outcome)
        # A restarted run may end with blocks that were sent before the restart.
        result.blocks_sent = max(1, run.sent_before, self._outlet.sender.sent) - 1
        result.blocks_sent += run.sent_in_parts
        if run.proposed:
            result.proposed = reduce(JobSetup.changed, run.proposed, self._table.setup).text()
        if states := [*run.parts, *([self._state] if self._state is not None else [])]:
            add_executed(result, states)
        succeeded = outcome.code is Code.SUCCEEDED
        self._keep_row(run, result)
        if succeeded:
            self._mdi.keep(run.preparation.prepared)
        level = OK if succeeded else WARN
        self._diagnostics.say('program', level, outcome.message, **{WAITING: ''})
        self._feed.end(self._outlet.sender)
        run.preparation.close()
        self._setup.release()
        self._run = None
        self._goal.request.text = ''  # rclpy keeps a goal for a quarter of an hour
        answer(self._goal, result)
        give_back_memory()
        if not succeeded:
            self._queue.give_up(run.name)

    def _keep_row(self, run: ProgramRun, result: RunProgram.Result) -> None:
        """Append the run to the history; MDI lines are left out."""
        goal, times, now = self._goal.request, self._times, time.monotonic()
        if goal.mdi:
            return
        program = run.preparation.prepared
        row = {
            'started': times.started.isoformat(timespec='seconds'),
            'machine': self._transform.machine.name,
            'program': run.name,
            'sha256': '' if program is None else program.digest,
            'operator': goal.operator_name,
            'outcome': Code(result.code).name.lower(),
            'predicted_s': f'{goal.predicted_time:.3f}' if goal.predicted_time > 0.0 else '',
            'actual_s': f'{now - times.begun:.3f}',
            'motion_s': f'{result.approach_time + result.cycle_time:.3f}',
            'held_s': f'{times.held:.3f}',
            'holds': times.holds,
            'alarms': times.alarms,
            'message': result.message,
        }
        try:
            self._history.append(row)
        except InterpError as problem:
            self._diagnostics.say('history', WARN, str(problem))

    def close(self) -> None:
        """Close the node. Blocks that were sent are still executed, down to rest."""
        self._worker.shutdown(wait=False, cancel_futures=True)
        self._server.destroy()
        self._table.close()


main = partial(run_node, ProgramNode)
