"""
Plays the machine's buffer of setpoints into the drives, one period at a time.

Every chunk brings the tail of a stop along the path. The machine follows the tail when the next
chunk is late and when the operator wants to stop. Then the plan is over. The next one must begin
where the machine rests.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from cnc_interp.core.errors import Refusal, StreamError
from cnc_interp.machine.axis_motion import AxisMotion, Feedback, SetpointRefusedError
from cnc_interp.machine.buffer import Buffer, BufferedChunk, Row
from cnc_interp.machine.drives import DriveFaultError
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.run.run_state import Event, Reason, RunState, State

#: Why the machine rests after the last setpoint of a chunk.
WAIT_REASONS = {Wait.OVERRIDE: Reason.OVERRIDE, Wait.CYCLE_START: Reason.PROGRAM_STOP}


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
    axes : AxisMotion
        The axes and their drives.
    full : int
        Setpoints in a full buffer. The machine starts only then, unless it must rest earlier.

    """

    def __init__(self, axes: AxisMotion, full: int):
        self.axes = axes
        self.state = RunState()
        self.feedback = axes.rest()
        self.executed: deque[Executed] = deque(maxlen=100_000)  # until they are published
        self.buffer = Buffer(axes.setpoints[-1])
        self._full = full
        self._given_up = ''  # the run that was reset last
        self.run_id = NO_RUN
        self._forget_run(NO_RUN)

    def switch_on(self) -> None:
        """Switch the drives on."""
        self.axes.switch_on()
        self.state = self.state.after(Event.ACTIVATE)
        self._empty()

    def switch_off(self) -> None:
        """Switch the drives off; at rest without a run, or in a fault."""
        self.state = self.state.after(Event.DEACTIVATE)
        self.axes.switch_off()

    # Runs and plans -----------------------------------------------------------------------------

    def begin(self, run_id: RunId) -> None:
        """Get ready for a run; figures start anew, the axes stay where they are."""
        self.state = self.state.after(Event.BEGIN)
        self._forget_run(run_id)

    def make_room(self, run_id: RunId) -> None:
        """
        Refuse a plan that cannot begin now, else drop what waits in the buffer.

        So the machine rests until the plan does begin: it cannot start with the old one.

        Raises
        ------
        StreamError
            If the machine moves, or waits for something else.

        """
        mine, state = self.run_id, self.state
        if not state.resting:
            raise StreamError(
                f'plan {run_id.plan} of {run_id.program_id} begins while the machine moves',
                Refusal.NOT_READY,
            )
        if run_id.program_id == self._given_up:
            text = f'{run_id.program_id} was given up by reset; run the program again'
            raise StreamError(text, Refusal.GIVEN_UP)
        follows = run_id == mine.next_plan() and state.plan_over
        if run_id.same_attempt(mine) and not follows:
            raise StreamError(
                f'plan {run_id.plan} cannot follow plan {mine.plan} here; '
                'feedrate_node is out of step, reset and run the program again',
                Refusal.NOT_READY,
            )
        same_run = run_id.program_id == mine.program_id and not state.completed
        if state.state is State.HELD and not same_run:
            text = f'{mine.program_id} is on hold; cycle_start or reset first'
            raise StreamError(text, Refusal.NOT_READY)
        self.buffer.clear(self.axes.setpoints[-1])

    def begin_plan(self, run_id: RunId) -> None:
        """Get ready for a new run, or for another plan of the run from where the machine rests."""
        if run_id.program_id != self.run_id.program_id or self.state.completed:
            self.begin(run_id)
            return
        self.state = self.state.after(Event.REPLAN)
        self._empty()
        self.run_id, self.played_of_plan = run_id, 0

    def _forget_run(self, run_id: RunId) -> None:
        """Start everything that counts through a run anew."""
        self.run_id = run_id
        self.played = self.played_of_plan = self.approach_samples = self.starvations = 0
        self.last: Row | None = None
        self._empty()
        self._forget_figures()

    def _empty(self) -> None:
        """Empty the buffer."""
        self.buffer.clear(self.axes.setpoints[-1])
        self._rows: deque[Row] = deque()
        #: The chunk being executed; none at rest and on a stop tail.
        self._current: BufferedChunk | None = None

    def _forget_figures(self) -> None:
        """Start the figures anew: at a run, and where its approach ends."""
        self.axes.forget_use()
        self.largest_following_error = np.zeros(len(self.axes.machine.axis_names))
        self.largest_contour_error = 0.0
        self.least_buffered = np.inf

    @property
    def left(self) -> bool:
        """Tell whether a stop tail has replaced the plan; its remaining setpoints are ignored."""
        on_tail = not self.state.resting and self._current is None
        return on_tail or self.state.plan_over

    def push(self, chunk: Chunk, lines: list[int], tail_lines: list[int]) -> None:
        """Take a chunk into the buffer, unless its plan was left."""
        if not self.left:
            self.buffer.push(chunk, lines, tail_lines)

    def coming(self) -> list[Row]:
        """Return the setpoints to come as things stand, the stop after them included."""
        current, rows = self._current, list(self._rows)
        if self.state.resting or current is None:
            return rows
        if not self.state.leaves_plan:
            for buffered in self.buffer.chunks:
                if current is not None and current.wait is not Wait.NOTHING:
                    break
                current = buffered
                rows += buffered.rows
        return rows + (current.tail_rows() if current else [])

    # What the operator asks for -----------------------------------------------------------------

    def hold(self) -> None:
        """Stop on the path as soon as the setpoints allow, and wait for cycle_start."""
        self.state = self.state.after(Event.HOLD, Reason.FEED_HOLD)

    def stop(self) -> None:
        """Stop on the path as soon as the setpoints allow, and go to FAULT."""
        self._handle(Event.STOP, Reason.EMERGENCY_STOP)

    def start(self) -> None:
        """
        Go on, as soon as setpoints are there.

        Raises
        ------
        StreamError
            If there is nothing to go on with.

        """
        self.state = self.state.after(Event.RESUME)

    def refuse(self, reason: str) -> None:
        """No further setpoints come: stop on the path after those at hand, then FAULT."""
        self._handle(Event.REFUSE, detail=reason)

    def reset(self) -> None:
        """Clear a fault, or give up what is left of a run, at rest only."""
        self.state = self.state.after(Event.RESET)
        self._given_up = self.run_id.program_id or self._given_up
        self._forget_run(NO_RUN)

    def _handle(self, event: Event, reason: Reason = Reason.NONE, detail: str = '') -> None:
        """Change the state; a fault at rest leaves nothing to execute."""
        self.state = self.state.after(event, reason, detail)
        if self.state.state is State.FAULT:
            self._empty()

    # The clock ----------------------------------------------------------------------------------

    def step(self) -> Feedback:
        """Let one period pass."""
        if self.state.may_start and self._has_enough():
            self.state = self.state.after(Event.START)
        if not self.state.resting and not self._rows:
            self._take_next()
        if self._rows:
            self._play(self._rows.popleft())
        else:
            self.feedback = self.axes.rest()
        return self.feedback

    def _has_enough(self) -> bool:
        """Tell whether the buffer is full, or nothing more is needed or will come."""
        buffer = self.buffer
        last = buffer.rests > 0 or bool(buffer.chunks and self.state.refusal)
        return last or buffer.count >= self._full

    def _take_next(self) -> None:
        """Go on after a chunk or a tail that was played to its end."""
        current = self._current
        if current is None and not self.buffer.chunks:
            self._come_to_rest()
        elif current is None:
            self._follow_next()
        elif self.state.leaves_plan:
            self._follow_tail(current)
        elif current.wait is not Wait.NOTHING:
            self._rest_after(current.wait)
        elif current.ends_approach and not self._has_enough():
            self._current = None
            self.state = self.state.after(Event.FILL)
        elif self.buffer.chunks:
            self._follow_next()
        else:
            self._starve(current)

    def _follow_next(self) -> None:
        self._current = self.buffer.pop()
        self._rows.extend(self._current.rows)

    def _rest_after(self, wait: Wait) -> None:
        """Rest where the setpoints say so; they go on from there."""
        self._current = None
        event = {Wait.END: Event.FINISH, Wait.OVERRIDE: Event.PAUSE}.get(wait, Event.WAIT)
        self.state = self.state.after(event, WAIT_REASONS.get(wait, Reason.NONE))

    def _follow_tail(self, current: BufferedChunk) -> None:
        """Leave the plan by the stop after the chunk."""
        self._empty()
        self._rows.extend(current.tail_rows())
        if not self._rows:
            self._come_to_rest()

    def _come_to_rest(self) -> None:
        """Be at rest on the path; another plan must follow."""
        self._empty()
        self.state = self.state.after(Event.REST)

    def _starve(self, current: BufferedChunk) -> None:
        """Leave the plan: the next setpoints are late, or will never come."""
        self.starvations += 1
        if self.state.refusal:
            reason, detail = Reason.STREAM_REFUSED, self.state.refusal
            self.state = self.state.after(Event.STOP, reason, detail)
        else:
            self.state = self.state.after(Event.STARVE, Reason.STARVED, str(self.played))
        self._follow_tail(current)

    def _play(self, row: Row) -> None:
        """Follow one setpoint and keep the figures of the run."""
        current = self._current
        flows = current is not None and current.wait is Wait.NOTHING
        if flows and self.buffer.rests == 0:
            self.least_buffered = min(self.least_buffered, self.buffer.count + len(self._rows))
        if row.block > 0 and (self.last is None or self.last.block == 0):
            self._forget_figures()
        try:
            self.feedback = self.axes.follow(row.position, row.velocity)
        except (SetpointRefusedError, DriveFaultError) as fault:
            refused = isinstance(fault, SetpointRefusedError)
            reason = Reason.SETPOINT_REFUSED if refused else Reason.DRIVE_FAULT
            self._handle(Event.FAIL, reason, str(fault))
            self.feedback = self.axes.rest()
            return
        self.executed.append(Executed(self.run_id, self.played, row))
        self.last = row
        self.played += 1
        self.approach_samples += row.block == 0
        self.played_of_plan += current is not None
        error = np.abs(self.feedback.following_error)
        self.largest_following_error = np.maximum(self.largest_following_error, error)
        self.largest_contour_error = max(self.largest_contour_error, self.feedback.contour_error)
