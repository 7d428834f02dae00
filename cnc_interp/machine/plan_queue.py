"""Plans received by the machine: the current chunk, waiting chunks, and how plans join.

A plan may replace the setpoints of another plan that follow a given setpoint, if none of them has
been played. The chunk with that setpoint is cut after it, and the first chunk of the new plan is
linked behind it.
"""

from dataclasses import replace

import numpy as np

from cnc_interp.core import FloatArray, Refusal, StreamError
from cnc_interp.machine.axis_motion import AxisMotion
from cnc_interp.machine.buffer import Buffer, BufferedChunk
from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.drives import AxisRows
from cnc_interp.machine.switching import ActsOfChunk
from cnc_interp.machine_model.signals import Signals
from cnc_interp.run.run_state import NO_RUN, RunId, RunState, State
from cnc_interp.run.setpoints import Chunk, Setpoints

#: Largest distance of a plan's start from the machine's position at rest [m, rad].
ELSEWHERE = 1e-8


class PlanQueue:
    """The setpoints of a run's plans, and how many of them have been played."""

    def __init__(self, cycle: Cycle, axes: AxisMotion, signals: Signals):
        self._cycle, self._axes, self._signals = cycle, axes, signals
        self.buffer = Buffer(axes.setpoints[-1])
        self.given_up = ''  #: ``program_id`` of the run that was given up last.
        self.begin(NO_RUN)

    def begin(self, run_id: RunId) -> None:
        """Begin a run."""
        self.played = 0  # setpoints of the run
        #: Positions at which the run continues after a jog during a hold [m, rad]; otherwise
        #: empty.
        self.away: FloatArray = np.zeros(0)
        self.begin_plan(run_id)

    def begin_plan(self, run_id: RunId) -> None:
        """Begin another plan of the run; it starts where the axes rest."""
        self.empty()
        self.run_id, self.played_of_plan = run_id, 0

    def empty(self) -> None:
        """Drop all setpoints; call it only while the axes rest."""
        self.buffer.clear(self._axes.setpoints[-1])
        #: The current chunk; whether its stop tail is played; and the row played last.
        self.current: BufferedChunk | None = None
        self.on_tail, self.row = False, -1

    def take(self, serial: int) -> None:
        """Make the chunk with this serial number the current one."""
        while self.current is None or self.current.serial < serial:
            self.current, self.row = self.buffer.pop(), -1

    def take_tail(self) -> None:
        """Continue with the stop tail of the current chunk, and drop the chunks after it."""
        current = self.current
        self.empty()
        self.current, self.on_tail = current, True

    @property
    def rows(self) -> Setpoints:
        """The setpoints that are being played: the current chunk's, or those of its stop tail."""
        assert self.current is not None
        return self.current.chunk.tail if self.on_tail else self.current.chunk.samples

    @property
    def line(self) -> int:
        """The source line of the current chunk."""
        return 0 if self.current is None else int(self.current.chunk.samples.line[0])

    def count(self, setpoints: int, of_plan: bool = True) -> None:
        """Add a number of played setpoints to those of the run, and to those of the plan."""
        self.played += setpoints
        self.played_of_plan += setpoints if of_plan else 0

    # What may come -------------------------------------------------------------------------------

    def make_room(self, run_id: RunId, state: RunState) -> None:
        """Drop the buffered setpoints to begin a new plan; StreamError if that is not allowed."""
        mine = self.run_id
        if not state.resting:
            raise StreamError(
                f'plan {run_id.plan} of {run_id.program_id} begins while the machine moves',
                Refusal.NOT_READY,
            )
        if run_id.program_id == self.given_up:
            text = f'{run_id.program_id} was given up by reset; run the program again'
            raise StreamError(text, Refusal.GIVEN_UP)
        if run_id.plan and not run_id.same_attempt(mine):
            text = f'{run_id} began before machine_node was started'
            raise StreamError(text, Refusal.PLAN_OVER)
        follows = run_id.continues(mine) and state.plan_over
        if run_id.same_attempt(mine) and not follows:
            raise StreamError(
                f'plan {run_id.plan} cannot follow plan {mine.plan} here; '
                'feedrate_node is out of step, reset and run the program again',
                Refusal.NOT_READY,
            )
        same_run = run_id.program_id == mine.program_id and not state.completed
        if state.state is State.HELD and not same_run:
            text = f'{mine.program_id} is on hold; press cycle start or reset first'
            raise StreamError(text, Refusal.NOT_READY)
        self.buffer.clear(self._axes.setpoints[-1])

    def is_left(self, state: RunState) -> bool:
        """Return whether a stop has ended the plan; further setpoints of it are ignored."""
        return self.on_tail or state.plan_over

    def is_void(self, run_id: RunId, begins: FloatArray | None, state: RunState) -> bool:
        """Return whether the setpoints of a plan are void because the machine has left that plan.

        A plan is also void if the axes were moved by hand and its first setpoint, ``begins``, is
        not where they are now.
        """
        away = state.state is State.AWAY
        if begins is not None and len(self.away) and run_id.continues(self.run_id):
            elsewhere = np.abs(begins - self._axes.setpoints[-1]).max() > ELSEWHERE
            if away or (state.plan_over and elsewhere):
                self.run_id = run_id
        return run_id == self.run_id and (self.is_left(state) or away)

    def begins_elsewhere(self, begins: FloatArray) -> bool:
        """Return whether setpoint ``begins`` is too far away to start a motion from rest."""
        axes = self._axes
        if begins.shape != axes.setpoints[-1].shape:
            return False  # of another machine; the checks of its message report that
        farthest = axes.machine.max_jerk * axes.period**3 + ELSEWHERE
        return bool((np.abs(begins - axes.setpoints[-1]) > farthest).any())

    # What comes ----------------------------------------------------------------------------------

    def push(self, chunk: Chunk, functions: int) -> None:
        """Append a chunk to the plan; ``functions``: how many the run has already executed."""
        last = self.buffer.chunks[-1] if self.buffer.chunks else self.current
        pushed = self._written(chunk, self.buffer.next_number, last, functions)
        if last is not None:
            self._cycle.link(last.serial, pushed.serial)
        self.buffer.push(pushed)

    def _written(
        self, chunk: Chunk, first: int, before: BufferedChunk | None, functions: int
    ) -> BufferedChunk:
        expected = functions if before is None else max(before.acts.after, functions)
        acts = ActsOfChunk.of(chunk, self._signals, expected)
        if acts.waiting and before is not None and not before.chunk.rests:
            raise StreamError('a function that waits must be at a rest of the path')
        serial = self._cycle.push(chunk, acts.switches, self._speeds(chunk))
        return BufferedChunk(serial, self.run_id, first, chunk, acts)

    def _speeds(self, chunk: Chunk) -> list[FloatArray]:
        """Return the tip speeds of a chunk and its stop tail; [] if no output follows them."""
        if not any(signal.speeds for signal in self._signals.wires):
            return []
        return [self._axes.tip_speeds(rows) for rows in (chunk.samples, chunk.tail)]

    def before_join(self, run_id: RunId, number: int, state: RunState) -> FloatArray:
        """Return the three setpoints before a join at ``number`` [m, rad], or StreamError."""
        mine, buffer, row = self.run_id, self.buffer, self.row + 1
        waits = state.resting and number >= self.played_of_plan
        ahead = waits or (buffer.chunks and number >= buffer.chunks[0].after)
        known = run_id.same_attempt(mine) and run_id.continues(mine) and not self.is_left(state)
        known = known and not state.by_hand
        if not (known and ahead and number <= buffer.next_number):
            text = f'plan {run_id.plan} cannot join plan {mine.plan} at setpoint {number} any more'
            raise StreamError(text, Refusal.TOO_LATE)
        parts = [self._axes.setpoints]
        if self.current is not None:
            parts.append(self.current.chunk.samples.position[row:])
        parts += [c.chunk.samples.position[: max(number - c.first, 0)] for c in buffer.chunks]
        return np.concatenate(parts)[-3:]

    def join(
        self, run_id: RunId, number: int, chunk: Chunk, state: RunState, functions: int
    ) -> None:
        """Replace setpoint ``number`` and all later ones by a chunk; StreamError if too late."""
        newest, buffer = self.before_join(run_id, number, state), self.buffer
        kept = [c for c in buffer.chunks if c.after <= number]
        split = next((c for c in buffer.chunks if c.first < number < c.after), None)
        before, comes = kept[-1] if kept else self.current, []
        if split is not None:
            count = number - split.first
            acts = split.acts.head(count, len(split.chunk.samples))
            head = split.chunk.head(count)
            serial = self._cycle.push(head, acts.switches, self._speeds(head))
            comes.append(split.head(count, serial, acts))
        follows = comes[-1] if comes else before
        pushed = self._written(chunk, number, follows, functions)
        pushed = replace(pushed, run_id=run_id)
        if comes:
            self._cycle.link(comes[0].serial, pushed.serial)
        comes.append(pushed)
        if before is not None and not self._cycle.relink(before.serial, comes[0].serial):
            text = f'plan {run_id.plan} came too late to join at setpoint {number}'
            raise StreamError(text, Refusal.TOO_LATE)
        buffer.cut(number, newest)
        for each in comes:
            buffer.push(each)
        self.run_id = run_id

    def way_to_rest(self, resting: bool) -> AxisRows:
        """Return the stop that would follow the last played setpoint."""
        if resting or self.current is None:
            return AxisRows.held(self._axes.setpoints[-1], 0)
        return axis_rows(
            self.rows[self.row + 1 :]
            if self.on_tail
            else self.current.chunk.head(self.row + 1).tail
        )


def axis_rows(samples: Setpoints) -> AxisRows:
    return AxisRows(samples.position, samples.velocity, samples.acceleration)
