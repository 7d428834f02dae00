"""
Plays the machine's buffer of setpoints into the simulated drives, one period at a time.

Every chunk brings the tail of a stop along the path. It is followed behind the chunk when the next
one is not there, and when the operator wants to stop; then the plan is over, and what follows must
begin where the machine rests.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from cnc_interp.core.errors import StreamError
from cnc_interp.machine.buffer import Buffer, Held, Row
from cnc_interp.machine.simulated import Feedback, SimulatedMachine
from cnc_interp.machine.states import FOLLOWING, Event, State
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.run_id import NO_RUN, RunId

#: States from which the machine starts by itself when setpoints are there; running, it rests
#: for an override of 0.
SELF_STARTING = (State.IDLE, State.STARVED, State.RUNNING)
PROGRAM_STOP = 'program stop; cycle_start to go on'
STOPPED_BY_HAND = 'emergency stop; reset to go on'


class Executed(NamedTuple):
    """A setpoint that was executed: its plan, and its number in the run."""

    run_id: RunId
    number: int
    row: Row


class Playback:
    """
    The machine's buffer and the figures of the run; no thread, no clock.

    Parameters
    ----------
    machine : SimulatedMachine
        The drives.
    start_count : int
        Setpoints at hand before the machine starts, unless it must rest earlier.

    """

    def __init__(self, machine: SimulatedMachine, start_count: int):
        self.machine = machine
        self.feedback = machine.rest()
        self.executed: deque[Executed] = deque(maxlen=100_000)  # until they are told
        self._start_count = start_count
        self.buffer = Buffer(machine.setpoints[-1])
        self._given_up = ''  # the run that was reset last
        self.start_wanted = False
        self.begin(NO_RUN)

    def begin(self, run_id: RunId) -> None:
        """Get ready for a run; figures start anew, the axes stay where they are."""
        if self.machine.state in (State.STARVED, State.HOLDING):
            self.machine.handle(Event.RESET)
        self.run_id = run_id
        self.completed = False
        self.played = self.approach_samples = self.starvations = 0
        self.last: Row | None = None
        self._clear()
        self.plan_over, self.played_of_plan = False, 0
        self._forget_figures()

    def make_room(self, run_id: RunId) -> None:
        """
        Refuse a plan that cannot begin now; else drop what waits in the buffer.

        So the machine rests until the plan does begin: it cannot start with the old one.

        Raises
        ------
        StreamError
            If the machine moves, or waits for something else.

        """
        state = self.machine.state
        if not self.resting:
            raise StreamError(
                f'plan {run_id.plan} of {run_id.program_id} begins while the machine moves'
            )
        if run_id.program_id == self._given_up:
            raise StreamError(f'{run_id.program_id} was given up by reset; run the program again')
        mine = self.run_id
        goes_on = run_id.program_id == mine.program_id and not self.completed
        follows = run_id == mine.next_plan() and self.plan_over
        if run_id.same_attempt(mine) and not follows:
            raise StreamError(
                f'plan {run_id.plan} cannot follow plan {mine.plan} here; '
                'feedrate_node is out of step, reset and run the program again'
            )
        if state is State.HOLDING and not goes_on:
            raise StreamError(f'{mine.program_id} is on hold; cycle_start or reset first')
        self.buffer.clear(self.machine.setpoints[-1])

    def begin_plan(self, run_id: RunId) -> None:
        """Get ready for a new run, or for another plan of the run from where the machine rests."""
        if run_id.program_id != self.run_id.program_id or self.completed:
            self.begin(run_id)
            return
        wanted = self.start_wanted
        self._clear()
        self.run_id, self.start_wanted = run_id, wanted
        self.plan_over, self.played_of_plan = False, 0

    def _clear(self) -> None:
        """Empty the buffer."""
        self.buffer.clear(self.machine.setpoints[-1])
        self._rows: deque[Row] = deque()
        self._current: Held | None = None
        self._on_tail = self._leave = self.start_wanted = False
        self._last_words = ''
        self.resting = True

    def _forget_figures(self) -> None:
        """Start the figures anew: at a run, and where its approach ends."""
        self.machine.largest_use[:] = 0.0
        self.largest_following_error = np.zeros(len(self.machine.machine.axis_names))
        self.largest_contour_error = 0.0
        self.least_buffered = np.inf

    def push(self, chunk: Chunk, lines: list[int], tail_lines: list[int]) -> None:
        """Take a chunk into the buffer."""
        self.buffer.push(chunk, lines, tail_lines)

    @property
    def left(self) -> bool:
        """Tell whether the plan was left by a stop tail: its further setpoints are void."""
        return self._on_tail or self.plan_over

    def coming(self) -> list[Row]:
        """Return the setpoints to come as things stand, the stop behind them included."""
        current, rows = self._current, list(self._rows)
        if self.resting or self._on_tail:
            return rows
        if not self._leave:
            for held in self.buffer.chunks:
                if current is not None and current.wait is not Wait.NOTHING:
                    break
                current = held
                rows += held.rows
        return rows + (current.tail_rows() if current else [])

    # What the operator asks for -----------------------------------------------------------------

    def hold(self) -> None:
        """Stop on the path as soon as the setpoints allow, and wait for cycle_start."""
        if self.machine.state is State.HOLDING:
            self.start_wanted = False
            return
        self.machine.handle(Event.HOLD, 'feed hold; cycle_start to go on')
        self._leave = not self.resting

    def stop(self, reason: str = STOPPED_BY_HAND) -> None:
        """Stop on the path as soon as the setpoints allow, and go to FAULT."""
        self.machine.handle(Event.STOP, reason)
        self._leave = not self.resting
        if self.machine.state is State.STOPPING and self.resting:
            self._come_to_rest()

    def start(self) -> None:
        """
        Go on, as soon as setpoints are there.

        Raises
        ------
        StreamError
            If there is nothing to go on with.

        """
        state = self.machine.state
        if state is State.RUNNING:
            return
        if state not in (State.HOLDING, State.STARVED):
            reason = self.machine.message or 'run a program'
            raise StreamError(f'nothing to go on with while {state.value}: {reason}')
        self.start_wanted = True

    def end_with(self, reason: str) -> None:
        """Nothing more will come: stop on the path behind what is at hand, then FAULT."""
        self._last_words = reason
        if self.resting and self.machine.state in (State.HOLDING, State.STARVED):
            self.stop(reason)

    def reset(self) -> None:
        """Clear a fault, or give up what is left of a run, at rest only."""
        if not self.resting:
            raise StreamError('the machine is still moving; reset when it rests')
        self.machine.handle(Event.RESET)
        self._given_up = self.run_id.program_id or self._given_up
        self.begin(NO_RUN)

    # The clock ----------------------------------------------------------------------------------

    def step(self) -> Feedback:
        """Let one period pass."""
        if self.resting and self._may_start():
            if self.machine.state is not State.RUNNING:
                starts = self.machine.state is State.IDLE
                self.machine.handle(Event.START if starts else Event.RESUME)
            self.start_wanted = self.resting = False
        if not self.resting and not self._rows:
            self._take_next()
        if self._rows and self.machine.state in FOLLOWING:
            self._play(self._rows.popleft())
        else:
            self.feedback = self.machine.rest()
        return self.feedback

    def _may_start(self) -> bool:
        """Start with enough at hand."""
        state, buffer = self.machine.state, self.buffer
        wanted = state in SELF_STARTING or (state is State.HOLDING and self.start_wanted)
        enough = buffer.count >= self._start_count or buffer.rests > 0
        return wanted and bool(buffer.chunks) and enough

    def _take_next(self) -> None:
        """Go on behind a chunk or a tail that was played to its end."""
        current = self._current
        if self._on_tail or (current is None and not self.buffer.chunks):
            self._come_to_rest()
        elif current is None:
            self._follow_next()
        elif self._leave:
            self._follow_tail(current)
        elif current.wait is not Wait.NOTHING:
            self._rest_behind(current.wait)
        elif self.buffer.chunks:
            self._follow_next()
        else:
            self._starve(current)

    def _follow_next(self) -> None:
        self._current = self.buffer.pop()
        self._rows.extend(self._current.rows)

    def _rest_behind(self, wait: Wait) -> None:
        """Rest where the setpoints say so; they go on from there."""
        self.resting = True
        self._current = None
        if wait is Wait.END:
            self.machine.handle(Event.FINISH)
            self.completed = True
        elif wait is Wait.CYCLE_START:
            self.machine.handle(Event.HOLD, PROGRAM_STOP)

    def _follow_tail(self, current: Held) -> None:
        """Leave the plan by the stop behind the chunk."""
        self._on_tail = True
        self._rows.extend(current.tail_rows())
        self.buffer.clear(self.machine.setpoints[-1])
        if not self._rows:
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        """Be at rest on the path; another plan must follow."""
        self._current = None
        self.buffer.clear(self.machine.setpoints[-1])
        self.resting = self.plan_over = True
        self._on_tail = self._leave = False
        if self.machine.state is State.STOPPING:
            self.machine.handle(Event.FAIL)

    def _starve(self, current: Held) -> None:
        """Nothing came in time."""
        self.starvations += 1
        if self._last_words:
            self.machine.handle(Event.STOP, self._last_words)
        elif self.machine.state is State.RUNNING:
            self.machine.handle(
                Event.STARVE, f'no setpoints after {self.played}: stopped on the path; goes on '
                'when they come, or restart the node that is lost and cycle_start',
            )  # fmt: skip
        self._follow_tail(current)

    def _play(self, row: Row) -> None:
        """Follow one setpoint and keep the figures of the run."""
        current = self._current
        flows = current is not None and current.wait is Wait.NOTHING and not self._on_tail
        if flows and self.buffer.rests == 0:
            self.least_buffered = min(self.least_buffered, self.buffer.count + len(self._rows))
        if row.block == 0:
            self.approach_samples += 1
        elif self.last is None or self.last.block == 0:
            self._forget_figures()
        self.feedback = self.machine.step(row.position, row.velocity)
        self.executed.append(Executed(self.run_id, self.played, row))
        self.last = row
        self.played += 1
        self.played_of_plan += not self._on_tail
        error = np.abs(self.feedback.following_error)
        self.largest_following_error = np.maximum(self.largest_following_error, error)
        self.largest_contour_error = max(self.largest_contour_error, self.feedback.contour_error)
        if self.machine.state is State.FAULT:
            self._rows.clear()
            self._come_to_rest()
