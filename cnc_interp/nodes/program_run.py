"""One run of a program: from its goal over the blocks on their way to the result; no ROS calls."""

from __future__ import annotations

import math
import time
import uuid
from concurrent.futures import Future
from pathlib import Path
from typing import Any

from cnc_interp_msgs.action import RunProgram
from cnc_interp_msgs.msg import LoadedProgram, MachineState

from cnc_interp.core.errors import BlockError, InterpError, ProgramError
from cnc_interp.nodes.peers import RECEIVERS, Peers
from cnc_interp.nodes.program_check import Prepared
from cnc_interp.run.run_id import RunId
from cnc_interp.wire.settings_messages import loaded_program
from cnc_interp.wire.window_protocol import WindowedSender

Result = RunProgram.Result
Outcome = tuple[int, str]
#: How long the first motion may take to reach the machine when all nodes answer [s].
PATIENCE = 10.0
#: A machine that rests for so long after cycle_start has nothing to execute [s].
SETTLED = 0.1


class ProgramRun:
    """
    The state of one run.

    Parameters
    ----------
    goal : RunProgram.Goal
        What the user asked for.

    """

    def __init__(self, goal: Any):
        self.run_id = RunId(uuid.uuid4().hex)
        self.name = Path(goal.program).name if goal.program else '<text>'
        self.preparing: Future[Prepared] | None = None
        self.prepared: Prepared | None = None
        self.checked = 0.0  # share of the text, while it is read and checked
        self.started = self.cancelled = False
        self.last_sequence = -1
        self.missing = self.lost = ''  # nodes that are silent, and that forgot the run
        self.continue_at = 0.0
        self._queued = 0
        self._state: MachineState | None = None  # the last one of this run
        self._known_by: set[str] = set()
        self._taken = False  # by look-ahead and planner
        self._resumed = False  # by the operator, since a node was restarted
        self._wants_since, self._waits_for_more = math.inf, -math.inf  # by the machine's clock [s]
        self._asked_at = time.monotonic()

    def take_turn(self) -> None:
        """Count from now how long the other nodes take."""
        self._asked_at = time.monotonic()

    def has_checked(self, share: float) -> None:
        """Take note of how far the check is; it ends when the user has cancelled."""
        self.checked = share
        if self.cancelled:
            raise BlockError('cancelled before anything moved')

    def see_prepared(self) -> Outcome | None:
        """Take the read and checked program over; a refusal is the result."""
        if self.preparing is None or not self.preparing.done():
            return None
        try:
            self.prepared = self.preparing.result()
        except ProgramError as problem:
            return Result.BAD_PROGRAM, str(problem)
        except Exception as problem:
            known = isinstance(problem, InterpError)
            text = str(problem) if known else f'{type(problem).__name__}: {problem}'
            return Result.CANCELED if self.cancelled else Result.REFUSED, text
        self.last_sequence = len(self.prepared.blocks) - 1
        self.take_turn()
        return None

    def may_start(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        """Start once every node has been heard and the machine rests."""
        if self.cancelled:
            return Result.CANCELED, 'cancelled before anything moved'
        missing = peers.missing(now, timeout)
        state = peers.state
        if not missing and state is not None:
            if state.state in (MachineState.FAULT, MachineState.STOPPING):
                return Result.STOPPED, f'the machine is stopped: {state.message}; call reset'
            self.started = state.state == MachineState.IDLE or (
                state.state == MachineState.STARVED
                and state.waits_for == MachineState.WAITS_FOR_NEW_PLAN
            )
            if self.started:
                self.take_turn()
        if not self.started and now - self._asked_at > PATIENCE:
            if missing:
                return Result.STREAM_LOST, f'{missing} does not answer; start it and try again'
            if state is not None and state.state == MachineState.INACTIVE:
                return Result.REFUSED, 'the drives are off; activate machine_node'
            return Result.BUSY, 'the machine is in another run; wait for its end, or reset it'
        return None

    def loaded(self) -> LoadedProgram:
        """Tell everybody what is about to run."""
        assert self.prepared is not None
        prepared = self.prepared
        message = loaded_program(
            self.run_id.program_id, self.name, prepared.text, prepared.settings
        )
        message.path_length = prepared.path_length
        return message

    def fill(self, sender: WindowedSender[int], most: int) -> None:
        """Queue the next rows; not the whole program at once."""
        while self._queued <= self.last_sequence and sender.unsent < most:
            sender.put(self._queued)
            self._queued += 1

    def watch(self, peers: Peers, now: float, timeout: float) -> Outcome | None:
        """Tell when the run is over, and how; a lost node alone does not end it."""
        state = peers.state
        if state is not None and state.program_id == self.run_id.program_id:
            self._note(state)
            if state.state == MachineState.FAULT:
                return Result.STOPPED, state.message
            if state.completed:
                return Result.SUCCEEDED, 'executed to the end'
        _, refusal = peers.refusal(self.run_id)
        if refusal and (state is None or self._state is not state or peers.at_rest):
            if self.cancelled:
                return Result.CANCELED, 'cancelled; the machine rests on the path'
            moved = self._state is not None
            return Result.STOPPED if moved else Result.REFUSED, refusal
        self.missing = peers.missing(now, timeout)
        if self.missing == 'machine_node':
            return Result.STREAM_LOST, 'machine_node does not answer any more; start it again'
        for stream, node in RECEIVERS.items():
            if peers.knows(stream, self.run_id):
                self._known_by.add(node)
            elif node in self._known_by:
                self.lost = node
        if self._taken or self.missing:
            return None
        self._taken = {'lookahead_node', 'feedrate_node'} <= self._known_by
        if not self._taken and now - self._asked_at > PATIENCE:
            return Result.BUSY, (
                'the look-ahead is in a run that is not over; reset, or else restart '
                'lookahead_node and feedrate_node, then run this again'
            )
        return None

    def _note(self, state: MachineState) -> None:
        """Take a state of this run; note since when it rests though the operator went on."""
        before, self._state = self._state, state
        held = before is not None and before.state == MachineState.HELD
        if self.lost and held and state.state == MachineState.RUNNING:
            self._resumed = True
        wants = state.start_wanted or (self._resumed and state.state == MachineState.STARVED)
        now = state.header.stamp.sec + 1e-9 * state.header.stamp.nanosec
        self._wants_since = min(self._wants_since, now) if wants and self.rests else math.inf
        self._waits_for_more = now - self._wants_since

    @property
    def rests(self) -> bool:
        """Tell whether the machine rests on the path of this run."""
        state = self._state
        return state is not None and (
            state.state == MachineState.HELD or state.waits_for == MachineState.WAITS_FOR_NEW_PLAN
        )

    @property
    def trouble(self) -> str:
        """What keeps the run from going on, and what to do; empty when nothing does."""
        if self.missing:
            return f'{self.missing} does not answer; start it again, then cycle_start'
        return f'{self.lost} was restarted; cycle_start goes on from here' if self.lost else ''

    def may_go_on(self) -> bool:
        """
        Tell whether the operator wants to go on behind a loss, and all nodes are there.

        A machine that still has something to execute starts at once. Only where it goes on
        resting is the rest of the program sent again: it must not move meanwhile.
        """
        return bool(
            self.lost
            and not self.missing
            and self.rests
            and self._state is not None
            and self._waits_for_more >= SETTLED
        )

    def begin_again(self, sender: WindowedSender[int]) -> None:
        """
        Send the program once more, for the part behind the place where the machine rests.

        All of it, because rounding looks at what lies before: the same blocks give the same path.
        """
        assert self._state is not None
        self.continue_at = self._state.path_position
        self.run_id = self.run_id.next_attempt()
        self.lost, self._queued, self._resumed = '', 0, False
        self._wants_since, self._waits_for_more = math.inf, -math.inf
        self._known_by.clear()
        sender.begin(self.run_id)

    def close(self) -> None:
        """Forget the program; a check that still runs ends."""
        self.cancelled = True
        if self.prepared is not None:
            self.prepared.blocks.close()

    def unmoved(self, code: int, message: str) -> RunProgram.Result:
        """Make the result of a run that moved nothing."""
        result = Result(code=code, message=message, program_id=self.run_id.program_id)
        if self.prepared is not None:
            result.notices = list(self.prepared.notices)
        return result

    def result(self, code: int, message: str, peers: Peers, sent: int) -> RunProgram.Result:
        """Collect what the run came to."""
        result = self.unmoved(code, message)
        result.blocks_sent = max(0, sent - 1)
        state = self._state
        if state is None:
            return result
        count = state.samples - state.approach_samples
        result.cycle_time = max(0, count - 1) * peers.period
        result.approach_time = state.approach_samples * peers.period
        result.path_length = max(0.0, state.path_position)
        result.blocks_executed = state.sequence
        result.samples = count
        result.starvations = state.starvations
        result.least_buffered_time = state.least_buffered_time
        result.contour_error = state.largest_contour_error
        result.following_error = state.largest_following_error
        result.velocity_use = state.velocity_use
        result.acceleration_use = state.acceleration_use
        result.jerk_use = state.jerk_use
        return result
