"""One run of a program from goal to outcome, and the queue of goals; without ROS calls."""

import time
import uuid
from collections import deque
from concurrent.futures import Future
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import G1BlockBatch, LoadedProgram, MachineState, ProbeContact

from cnc_interp.core import FloatArray, IntArray, Refusal, StreamError
from cnc_interp.machine_model.signals import Signals
from cnc_interp.nodes.node_main import end_goal
from cnc_interp.nodes.peers import Peers
from cnc_interp.nodes.program_check import Preparation, Prepared
from cnc_interp.nodes.seals import RECEIVERS
from cnc_interp.program import JobSetup
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.targets import ProgramChange
from cnc_interp.program.job import SetupChange
from cnc_interp.program.motion.probing import Probe
from cnc_interp.program.notices import warnings_of
from cnc_interp.run import run_phase
from cnc_interp.run.run_phase import SENDING, Code, MachineReport, Outcome, Phase, PhaseChange
from cnc_interp.run.run_state import NO_RUN, RunId, State
from cnc_interp.wire.path_messages import block_messages, function_messages
from cnc_interp.wire.run_messages import loaded_program, pairs_of
from cnc_interp.wire.window_protocol import WindowedSender

PATIENCE = 10.0  #: Longest wait until look-ahead and planner accept a run [s].
#: Longest wait for nodes that are not heard yet and may still be loading kernels [s].
STARTING = 60.0
FORGOTTEN = 1.0  #: If the machine reports another run for this time, it was reset [s].
SWITCHED = 0.1  #: Longest time from a call to the new state of the machine [s].
SAME = 1e-9  #: Tolerance of the position at the start of an MDI line [m, rad].
#: Path length for a start at the first motion [m]. It is above 0, so that this start waits.
FIRST_MOTION = 5e-14
CANCELLED = 'cancelled before anything moved'
MACHINE = RECEIVERS['setpoints']
PLANNERS = {RECEIVERS['blocks'], RECEIVERS['segments']}


def why_not(missing: str, machine: MachineReport | None) -> Outcome | None:
    """Return why no program can start; ``missing``: name of a silent node. None if one can."""
    if missing or machine is None:
        text = f'{missing or MACHINE} does not answer; start it and try again'
        return Outcome(Code.STREAM_LOST, text)
    if machine.state in (State.FAULT, State.STOPPING):
        return Outcome(Code.STOPPED, f'the machine is stopped: {machine.message}; call reset')
    if machine.state is State.INACTIVE:
        return Outcome(Code.REFUSED, 'the drives are off; activate machine_node')
    if machine.state is State.JOGGING:
        return Outcome(Code.BUSY, 'the axes are moved by hand; release the key, then start again')
    if machine.must_home:
        axes = ' '.join(machine.must_home)
        return Outcome(Code.REFUSED, f'{axes} must be homed before a program starts')
    busy = 'the machine is in another run; wait for its end, or reset it'
    return None if machine.is_free else Outcome(Code.BUSY, busy)


class ProgramRun:
    def __init__(self, goal: Any):
        self.run_id = RunId(uuid.uuid4().hex)
        self.name = Path(goal.program).name if goal.program else '<text>'
        self.proposes = bool(goal.proposes)
        self.proposed: list[SetupChange] = []  # changes that its user decides about
        self.stands: FloatArray | None = None  # start position of an MDI line [m, rad]
        self.phase = Phase.QUEUED
        self.preparation = Preparation()
        self.missing = ''  # a node that is silent
        self.recovery = run_phase.LossRecovery()
        self._since = 0.0  # time at which the phase began [s]
        self.continue_at = 0.0  # path length from which the program continues [m]
        self._machine: MachineReport | None = None  # its last report on this run
        self._machine_at = 0.0  # when it came [s]
        self.sent_before = 0  # blocks, the most of the attempts before
        self._changes_done = 0  # changes of the machine's setup that were executed
        self._known_by: set[str] = set()
        self.answer: Any = None  # of the machine, to functions without motion
        self.contact: ProbeContact | None = None  # of this part of the program
        #: Positions of the axes now, and at the contact of the probe, if any [m, rad]. If set, the
        #: rest of the program must be read.
        self.probed: tuple[FloatArray, FloatArray | None] | None = None
        self.parts: list[MachineState] = []  # the last state of each part before
        self.sent_in_parts = 0  # blocks
        self._noticed: tuple[str, ...] = ()  # in the parts before

    def _change(self, step: PhaseChange, now: float) -> None:
        self.phase, self._since = run_phase.TABLE[self.phase, step], now

    def take_turn(self, now: float) -> None:
        self._change(PhaseChange.TURN, now)

    def step(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        outcome = None
        if self.phase is Phase.CHECKING:
            outcome = self.preparation.look()
            if self.preparation.prepared is not None:
                self._change(PhaseChange.CHECKED, now)
                self.continue_at = self.start_at
                if self.rests_throughout and not self.switches:
                    outcome = Outcome(Code.SUCCEEDED, 'done, without motion')
        elif self.phase is Phase.WAITING:
            outcome = self._wait(peers, now, timeout)
        elif self.phase in SENDING:
            watch = self._switching if self.rests_throughout else self._watch
            outcome = watch(peers, now, timeout)
        if outcome is not None:
            self._change(PhaseChange.END, now)
        return outcome

    def _wait(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        if self.preparation.cancelled:
            return Outcome(Code.CANCELED, CANCELLED)
        missing, machine = peers.missing(now, timeout), peers.machine
        if not missing and machine is not None:
            if machine.must_home or machine.state in (State.FAULT, State.STOPPING):
                return why_not(missing, machine)
            if machine.is_free:
                if self.stands is not None and np.abs(machine.stands - self.stands).max() > SAME:
                    text = 'the axes have moved since the line was entered; enter it again'
                    return Outcome(Code.BUSY, text)
                self._change(PhaseChange.START, now)
                return None
        patience = PATIENCE if peers.all_heard else STARTING
        patient = self.stands is None and now - self._since <= patience
        return None if patient else why_not(missing, machine)

    @property
    def switches(self) -> int:
        program = self.preparation.prepared
        return 0 if program is None else len(program.functions)

    def _switching(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        """Return the outcome of a program without motion once all its functions are done."""
        machine, answer = peers.machine, self.answer
        if peers.missing(now, timeout) or answer is None or machine is None:
            return why_not(MACHINE, None)
        if not answer.done():
            return None if now - self._since <= PATIENCE else why_not(MACHINE, None)
        if (told := answer.result()) is None or not told.success:
            return Outcome(Code.REFUSED, told.message if told else f'{MACHINE} does not answer')
        if machine.state in (State.FAULT, State.STOPPING):
            return Outcome(Code.STOPPED, machine.message)
        if machine.state is not State.IDLE or now - self._since < SWITCHED:
            return None
        if machine.functions < self.switches:
            return Outcome(Code.STOPPED, 'given up by reset')
        return Outcome(Code.SUCCEEDED, 'done, without motion')

    def _watch(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        machine = peers.machine
        mine = machine is not None and machine.run_id.program_id == self.run_id.program_id
        not_begun = self._machine is None and machine is not None and machine.is_free
        if machine is not None and (mine or not_begun):
            self.recovery.see(machine)
        if mine:
            self._machine, self._machine_at = machine, now
        else:
            machine = None
        if (outcome := self._ended(machine, *peers.refusal(self.run_id))) is not None:
            return outcome
        self.missing = peers.missing(now, timeout)
        if self.missing == MACHINE:
            text = f'{MACHINE} does not answer any more; start it again'
            return Outcome(Code.STREAM_LOST, text)
        if self._machine is not None and not self.missing and now - self._machine_at > FORGOTTEN:
            return Outcome(Code.STOPPED, run_phase.LEFT)
        self._see_nodes(peers, now)
        if self.phase is not Phase.OFFERED:
            return None
        if self.missing:
            self._since = now
        if now - self._since <= PATIENCE:
            return None
        if self.run_id.attempt:  # a node was lost again before it was seen on the run
            self.recovery.node = min(PLANNERS - self._known_by)
            self._change(PhaseChange.LOSE, now)
            return None
        return Outcome(
            Code.BUSY,
            'the look-ahead has an unfinished run; press reset, or restart lookahead_node and '
            'feedrate_node if that does not help, then run this again',
        )

    def _ended(self, machine: MachineReport | None, kind: Refusal, reason: str) -> Outcome | None:
        if machine is not None and machine.state is State.FAULT:
            return Outcome(Code.STOPPED, machine.message)
        incomplete = kind in (Refusal.BAD_MESSAGE, Refusal.BAD_PATH)
        if machine is not None and machine.completed and not incomplete:
            program = self.preparation.prepared
            if program is not None and program.probe is not None:
                return self._at_probe(program.probe, machine)
            return Outcome(Code.SUCCEEDED, 'executed to the end')
        if not kind or (machine is not None and machine.moves):
            return None
        if self.preparation.cancelled:
            begun = self._machine is not None
            text = 'cancelled; the machine rests on the path' if begun else CANCELLED
            return Outcome(Code.CANCELED, text)
        return run_phase.refused(kind, reason, moved=self._machine is not None)

    def _at_probe(self, probe: Probe, machine: MachineReport) -> Outcome | None:
        """Return the outcome if the program ends at the probe; otherwise store the contact."""
        contact = self.contact
        if machine.probed and contact is None:
            return None  # its message comes
        if fault := probe.fault(contact is not None, contact is not None and contact.at_once):
            return Outcome(Code.STOPPED, fault)
        if self.preparation.cancelled:
            return Outcome(Code.CANCELED, 'cancelled at the probe')
        at = None if contact is None else np.array(contact.positions)
        self.probed = machine.stands, at
        return None

    def read_on(self, ready: Future[Prepared], state: MachineState, sent: int, now: float) -> None:
        """Begin the next part of a program, after a probe; ``ready``: future of its check."""
        assert self.probed is not None
        self.parts.append(state)
        self.sent_in_parts += max(self.sent_before, sent) - 1
        self.stands = None if self.stands is None else self.probed[0]
        self.run_id, self.contact, self.probed = RunId(uuid.uuid4().hex), None, None
        self.recovery, self._machine, self.answer = run_phase.LossRecovery(), None, None
        self._changes_done = self.sent_before = 0
        self._known_by.clear()
        if self.preparation.prepared is not None:
            self._noticed = self.preparation.prepared.notices
        self.preparation.again(ready)
        self._change(PhaseChange.READ_ON, now)

    def _see_nodes(self, peers: Peers, now: float) -> None:
        for stream, node in RECEIVERS.items():
            if peers.knows(stream, self.run_id):
                self._known_by.add(node)
            elif node in self._known_by:
                self.recovery.node = node
        if self.recovery.node and self.phase is not Phase.LOST:
            self._change(PhaseChange.LOSE, now)
        elif self.phase is Phase.OFFERED and self._known_by >= PLANNERS:
            self._change(PhaseChange.TAKEN, now)

    @property
    def rests_throughout(self) -> bool:
        return self.preparation.prepared is not None and not self.preparation.prepared.path_length

    @property
    def rests(self) -> bool:
        return self._machine is not None and self._machine.rests_on_path

    @property
    def may_reset(self) -> bool:
        """Whether a reset would give this run up: it rests on the path or has not begun."""
        return self._machine is None or self.rests

    @property
    def trouble(self) -> str:
        """Why the run cannot continue, and what the operator must do; '' if it can."""
        if self.missing:
            return f'{self.missing} does not answer; start it again, then press cycle start'
        lost = self.recovery.node
        if not lost:
            return ''
        stands = lost != MACHINE and self.rests
        return f'{lost} was restarted' + (
            '; press cycle start to continue from here' if stands else ''
        )

    def waits_for(self, peers: Peers) -> tuple[str, float] | None:
        """Return what the run waits for before it moves, and the progress [-]; None otherwise."""
        program, state = self.preparation.prepared, peers.state
        if self.phase is Phase.CHECKING:
            share = self.preparation.checked
            return f'checking {self.name}: {share:.0%}', share
        moved = state is not None and state.program_id == self.run_id.program_id and state.samples
        if self.phase not in SENDING or program is None or moved:
            return None
        motion = peers.told('setpoints', self.run_id)
        full = motion.window_limit * peers.period
        share = motion.buffered_time / full if full else 0.0
        blocks = f'{peers.told("blocks", self.run_id).next_sequence} of {len(program.blocks)}'
        text = f'{blocks} blocks accepted, {share:.0%} of the motion needed to start'
        return f'planning {self.name}: {text}', share

    def tool_wanted(self, state: MachineState | None, signals: Signals) -> int | None:
        """Return the number of the tool that the operator must put in now, or None."""
        program = self.preparation.prepared
        if state is None or program is None or not state.functions or self.phase not in SENDING:
            return None
        mine = self.rests_throughout or state.program_id == self.run_id.program_id
        waits = state.reason == MachineState.REASON_FUNCTION and state.may_resume
        last = int(state.functions) - 1
        if not (mine and waits and last < len(program.functions)):
            return None
        step = signals.steps[int(program.functions.step[last])]
        return int(program.functions.value[last]) if signals.is_change(step) else None

    def off_line_end(self, state: MachineState) -> float | None:
        """Return how far the tip rests from the end of its line in single block [m], or None."""
        program = self.preparation.prepared
        rests = state.resting and state.reason == MachineState.REASON_SINGLE_BLOCK
        if program is None or not rests or state.program_id != self.run_id.program_id:
            return None
        row = int(state.sequence)
        return float(np.linalg.norm(program.blocks[row : row + 1].tip[0] - state.tip))

    def may_go_on(self) -> bool:
        return self.phase is Phase.LOST and not self.missing and self.recovery.is_due

    def begin_again(self, now: float, sent: int) -> None:
        """Restart the run where the machine rests: the same blocks are sent again."""
        self.sent_before = max(self.sent_before, sent)
        reached = 0.0 if self._machine is None else self._machine.path_position
        # It is not above 0 on the approach.
        self.continue_at = reached if reached > 0.0 else self.start_at
        self.run_id = self.run_id.next_attempt()
        self._known_by.clear()
        self.recovery.begin_again()
        self._change(PhaseChange.BEGIN_AGAIN, now)

    @property
    def start_at(self) -> float:
        """Path position at which the run starts [m]; 0 at the top of the program."""
        program = self.preparation.prepared
        if program is None or not (program.start or program.waits_first):
            return 0.0
        return max(program.start.s if program.start else 0.0, FIRST_MOTION)

    def is_stale(self, setup: JobSetup) -> bool:
        program = self.preparation.prepared
        return (
            self.phase is Phase.WAITING
            and program is not None
            and not self.parts  # executed parts are not read again
            and not program.is_own_setup
            and program.setup != setup
        )

    def check_again(self, future: Future[Prepared], now: float) -> None:
        self.preparation.again(future)
        self._change(PhaseChange.STALE, now)

    def take_changes(self, block: int, ended: bool) -> list[ProgramChange]:
        """Return the program's setup changes up to ``block`` that were not returned before."""
        program = self.preparation.prepared
        if program is None or program.is_own_setup:
            return []
        first = self._changes_done
        for change in program.changes[first:]:
            if not ended and change.block > block:
                break
            self._changes_done += 1
        return list(program.changes[first : self._changes_done])

    def loaded(self) -> LoadedProgram:
        program = self.preparation.prepared
        assert program is not None
        message = loaded_program(self.run_id.program_id, self.name, program.text, program.settings)
        message.path_length = program.path_length
        if (start := program.start) is not None:
            message.start_line, message.start_pass = start.block.line, start.block.which
            message.start_at = start.s
            message.start_positions = start.position.tolist()
        warnings = warnings_of(program.notices)
        message.start_notes = [*warnings, *(start.texts if start is not None else ())]
        message.mdi = program.line is not None
        return message

    def result(self, outcome: Outcome) -> RunProgram.Result:
        program = self.preparation.prepared
        notices = program.notices if program is not None else self._noticed
        moved = self.run_id.program_id
        if self.parts and self.rests_throughout:
            moved = self.parts[-1].program_id
        return RunProgram.Result(**vars(outcome), program_id=moved, notices=list(notices))


MOST_QUEUED = 512  #: Largest number of blocks queued for sending.
MOST_TOGETHER = 64  #: Largest number of blocks in one message.
#: In single block, number of line ends that are sent ahead of the executed block. It is small,
#: because these lines keep their exact stops when single block is switched off. It is not 1,
#: because the look-ahead and the planner need some blocks beyond the end of a line.
LINES_AHEAD = 8


class BlockFeed:
    """Sends the blocks of a program; in single block it adds an exact stop to each line."""

    def __init__(self, signals: Signals) -> None:
        self._prepared: Prepared | None = None
        self._signals = signals
        self._run_id, self._continue_at = NO_RUN, 0.0
        self._queued = 0
        #: First row that was never queued: single block may add exact stops from here on.
        self._undecided = 0
        self._stops: list[int] = []  # rows of the exact stops that it has added
        self.holds_back = False  # blocks, until the machine has executed more
        self.ahead = LINES_AHEAD

    def begin(
        self, prepared: Prepared, run_id: RunId, continue_at: float, sender: WindowedSender[slice]
    ) -> None:
        if prepared is not self._prepared:  # else the same path is needed again
            start = None if prepared.start is None else prepared.start.block.row
            self._undecided, self._stops, self.ahead = start or 1, [], LINES_AHEAD
        self._prepared, self._run_id, self._continue_at = prepared, run_id, continue_at
        self._queued = 0
        sender.begin(run_id)

    def fill(
        self, sender: WindowedSender[slice], single_block: bool = False, executed: int = 0
    ) -> None:
        """Queue blocks for sending; ``executed``: the last block that the machine has executed."""
        program, self.holds_back = self._prepared, False
        rows = 0 if program is None else len(program.blocks)
        while program is not None and self._queued < rows and sender.unsent < MOST_QUEUED:
            after = min(self._queued + MOST_TOGETHER, rows)
            if self._queued < self._undecided:
                after = min(after, self._undecided)
            elif single_block:
                if sum(row > executed for row in self._stops) >= self.ahead:
                    self.holds_back = True
                    return
                ends = line_ends(program.blocks[self._queued : after + 1])
                if len(ends):
                    after = self._queued + int(ends[0]) + 1
                    self._stops.append(after - 1)
            sender.put(slice(self._queued, after), after - self._queued)
            self._queued = after
            self._undecided = max(self._undecided, after)

    def end(self, sender: WindowedSender[slice]) -> None:
        self._prepared = None
        sender.begin(NO_RUN)

    def message(self, rows: slice, first: int) -> G1BlockBatch:
        prepared = self._prepared
        if prepared is None:
            raise StreamError('a block was requested after its run')
        blocks, sent = prepared.blocks, prepared[rows]
        added = np.isin(np.arange(rows.start, rows.stop), self._stops)
        made = block_messages(
            replace(sent, exact_stop=sent.exact_stop | added),
            self._run_id,
            first,
            prepared.settings.flank_height,
            end=rows.stop == len(blocks),
        )
        functions = prepared.functions
        after = len(functions) if rows.stop == len(blocks) else functions.until(rows.stop - 1)
        begin = functions.until(rows.start - 1)
        for message in function_messages(functions[begin:after], begin, self._signals):
            made[min(message.sequence - first, len(made) - 1)].functions.append(message)
        if first == 0:
            made[0].continue_at = self._continue_at
            made[0].settings = pairs_of(prepared.settings)
        return G1BlockBatch(blocks=made)


def line_ends(blocks: Blocks) -> IntArray:
    """Return the last row of each source line, except within splines, where no stop is allowed."""
    line, spline = blocks.line_number, blocks.on_spline
    return np.flatnonzero((line[:-1] != line[1:]) & ~(spline[:-1] & spline[1:]))


MOST = 16  #: Largest number of queued programs; each needs memory.
FEEDBACK = 0.5  #: Time between two feedback messages to a queued goal [s].


class Waiting(NamedTuple):
    run: ProgramRun
    handle: Any


def answer(handle: Any, result: RunProgram.Result) -> None:
    end_goal(handle, result, result.code == Code.SUCCEEDED, result.code == Code.CANCELED)


class ProgramQueue:
    """A first-in, first-out queue of goals; cancelled or rejected goals are removed."""

    def __init__(self) -> None:
        self._entries: deque[Waiting] = deque()
        self._told_at = 0.0

    def add(self, run: ProgramRun, handle: Any) -> None:
        if len(self._entries) < MOST:
            self._entries.append(Waiting(run, handle))
            return
        full = f'{MOST} programs wait already; send it again when one has ended'
        self._end(Waiting(run, handle), Outcome(Code.BUSY, full))

    def next(self) -> Waiting | None:
        return self._entries.popleft() if self._entries else None

    @property
    def names(self) -> list[str]:
        return [entry.run.name for entry in self._entries]

    def watch(self) -> None:
        """Remove cancelled and rejected goals; a rejected goal also ends all goals after it."""
        for entry in list(self._entries):
            if entry not in self._entries:  # a goal before it was rejected
                continue
            if entry.handle.is_cancel_requested:
                self._entries.remove(entry)
                text = 'cancelled while it waited; nothing moved'
                self._end(entry, Outcome(Code.CANCELED, text))
            elif (outcome := entry.run.preparation.look()) is not None:
                self._drop(list(self._entries).index(entry) + 1, entry.run.name)
                self._entries.remove(entry)
                self._end(entry, outcome)
        now = time.monotonic()
        if now - self._told_at > FEEDBACK:
            self._told_at = now
            for ahead, entry in enumerate(self._entries, start=1):
                entry.handle.publish_feedback(RunProgram.Feedback(programs_ahead=ahead))

    def give_up(self, name: str) -> None:
        self._drop(0, name)

    def _drop(self, first: int, name: str) -> None:
        while len(self._entries) > first:
            entry = self._entries.pop()
            text = f'not started: {name} before it did not reach its end; send it again'
            self._end(entry, Outcome(Code.NOT_STARTED, text))

    def _end(self, entry: Waiting, outcome: Outcome) -> None:
        entry.run.preparation.close()
        answer(entry.handle, entry.run.result(outcome))
