"""The state of a run while the cycle plays its setpoints, and how events change it.

A stop tail ends its plan, and the next plan begins where the axes rest. ``plan_queue.py`` holds
the setpoints of the plans.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.machine import cycle_kernels as kernel
from cnc_interp.machine.axis_motion import AxisMotion
from cnc_interp.machine.cycle import Cycle, Records, speed_outputs
from cnc_interp.machine.cycle_kernels import follow_ideally
from cnc_interp.machine.drives import (
    AxisRows,
    CycleDrives,
    DelayedDrives,
    DriveFaultError,
    Drives,
    HomedDrives,
)
from cnc_interp.machine.plan_queue import PlanQueue, axis_rows
from cnc_interp.machine.run_figures import RunFigures
from cnc_interp.machine.spindle import Spindle
from cnc_interp.machine.switching import Act, Switching
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import (
    EMERGENCY,
    FAULT,
    LOST_MACHINE,
    LOST_PLANNER,
    POWER_FAILS,
    RESET,
    SINCE,
    STOPS,
    limit_inputs,
)
from cnc_interp.run.run_state import NO_RUN, Event, Reason, RunId, RunState, State, WaitsFor
from cnc_interp.run.setpoints import Chunk, Setpoints, Wait

#: Event and reason if the machine rests after the last setpoint of a chunk, for each wait.
RESTS = {
    Wait.NOTHING: (Event.FILL, Reason.NONE),
    Wait.OVERRIDE: (Event.PAUSE, Reason.OVERRIDE),
    Wait.PROGRAM_STOP: (Event.WAIT, Reason.PROGRAM_STOP),
    Wait.OPTIONAL_STOP: (Event.WAIT, Reason.OPTIONAL_STOP),
    Wait.SINGLE_BLOCK: (Event.WAIT, Reason.SINGLE_BLOCK),
    Wait.APPROACH: (Event.WAIT, Reason.APPROACH),
    Wait.FUNCTION: (Event.FILL, Reason.NONE),
    Wait.END: (Event.FINISH, Reason.NONE),
}
STOPPED = (Reason.PROGRAM_STOP, Reason.OPTIONAL_STOP)
NO_POWER = 'the power fails; wait until it is back, then reset'
LOST = 2.0  #: If no setpoints arrive for this time, the planner counts as lost [s].
#: Duration of motion that one call reads, if enough is buffered and no event occurs [s].
TOGETHER = 0.01
SPARE_CHUNKS = 4096  #: Slots for chunks, in addition to one for each setpoint of a full buffer.


class Executed(NamedTuple):
    """Consecutive executed setpoints, with the actual positions of the axes [m, rad]."""

    run_id: RunId  #: The plan.
    number: int  #: Number of the first of these setpoints in the run.
    rows: Setpoints
    actual: FloatArray
    ends: bool  #: Whether the program ends with these setpoints.


class Contact(NamedTuple):
    run_id: RunId
    line: int  #: Line of the source.
    position: FloatArray  #: (n_axes,): Positions of the axes at the contact [m, rad].
    at_once: bool  #: Whether the probe had answered before the line began.


class Followed(NamedTuple):
    """Setpoints in step with the spindle, and the spindle angle in the same periods."""

    run_id: RunId
    block: int
    line: int  #: Line of the source.
    ramp: float  #: Turns of the spindle until the axes are in step.
    position: FloatArray  #: (K, n_axes): Setpoints [m, rad].
    angle: FloatArray  #: (K,): Angle of the spindle [rev].
    later: int  #: Periods from a setpoint until the drives are at it.


class Reached(NamedTuple):
    """Place of a setpoint in the program: block, source line and path position ``s`` [m]."""

    block: int
    line: int
    s: float

    @classmethod
    def of(cls, samples: Setpoints) -> Self:
        return cls(int(samples.block[-1]), int(samples.line[-1]), float(samples.s[-1]))


@dataclass
class Progress:
    """Values that are reset when a run begins."""

    last: Reached | None = None  #: Place in the program of the last played setpoint.
    finishing: bool = False  #: Whether the run still executes its last functions.
    answered: bool = False  #: Whether the probe has changed and ended its line.
    waited: float = 0.0  #: Time spent waiting for setpoints [s].
    #: Whether the setpoints of a followed line are skipped; whether a hold follows the line.
    passing: bool = False
    held_after: bool = False


class Playback:
    """The state of the run; its motion starts as soon as ``full`` setpoints are buffered."""

    def __init__(self, machine: Machine, period: float, drives: Drives, full: int):
        self.axes = AxisMotion(machine, period, drives.lag, drives.position)
        self.drives, self._full = drives, full
        self._together = min(round(TOGETHER / period), full // 4)
        self._delayed = drives if isinstance(drives, DelayedDrives) else None
        self._limits = [
            (number, axis, side)
            for axis, name in enumerate(machine.axis_names)
            for side, each in zip((-1, 1), limit_inputs(name), strict=True)
            if (number := machine.signals.input(each)) >= 0
        ]
        step, memory = int(follow_ideally.address), np.zeros(1)
        if isinstance(drives, CycleDrives):
            step, memory = drives.step, drives.memory
        ahead = -1.0 if self._delayed else max(drives.ahead, period)
        self.spindle, self._later = Spindle.of(machine, period, ahead), round(ahead / period) - 1
        self.cycle = Cycle(
            period,
            *self.axes.bounds,
            full + SPARE_CHUNKS,
            step,
            memory,
            drives.outputs,
            drives.inputs,
            machine.signals.probe or (),
            drives.calm,
            self.spindle,
            speed_outputs(machine.signals.wires),
            self._limits,
        )
        self._signals = machine.signals
        self._power_input = machine.signals.input(POWER_FAILS)
        self.followed: deque[Followed] = deque()  # until they are published
        self.contacts: deque[Contact] = deque()  # until they are published
        self.switching = Switching(machine.signals, drives, self.spindle)
        self.plans = PlanQueue(self.cycle, self.axes, machine.signals)
        self.state, self.figures = RunState(), RunFigures(self.axes)
        self._powered = False  # the drives
        self.single_block = False  # rests that were planned for it count
        self._follows = False  # the spindle, in what was read last
        self.executed: deque[Executed] = deque()  # until they are published
        self._place(drives.position)
        self._forget_run(NO_RUN)

    def _place(self, position: FloatArray) -> None:
        self.axes.place(position)
        self.cycle.place(position)
        row = np.array(position, dtype=float)[None, :]
        self.feedback = self.axes.measure(row, row, np.zeros_like(row))
        self.plans.empty()

    def shift(self, drives: HomedDrives, by: FloatArray) -> None:
        """Add ``by`` [m, rad] to the position values of the axes at rest; nothing moves."""
        drives.shift(by)
        self._place(drives.position)

    def switch_on(self) -> None:
        """Switch the drives on. If that fails, the machine is in FAULT until a reset."""
        self.state = self.state.after(Event.ACTIVATE)
        try:
            self._power_on()
        except StreamError as fault:
            self._handle(Event.FAIL, Reason.DRIVE_FAULT, str(fault))
        self.plans.empty()

    def _power_on(self) -> None:
        self.drives.switch_on()
        self._powered = True
        self._place(self.drives.position)

    def _power_off(self) -> None:
        self._powered = False
        self.drives.switch_off()

    def switch_off(self) -> None:
        """Switch the drives off; allowed at rest without a run, or in a fault."""
        self.state = self.state.after(Event.DEACTIVATE)
        self._switch_off(EMERGENCY)
        self._power_off()

    def close(self) -> None:
        self.switching.stop(LOST_MACHINE)
        self.drives.close()

    # Runs and plans -----------------------------------------------------------------------------

    def begin(self, run_id: RunId) -> None:
        self.state = self.state.after(Event.BEGIN)
        self._forget_run(run_id)

    def make_room(self, run_id: RunId) -> None:
        """Drop the buffered setpoints to begin a new plan; StreamError if that is not allowed."""
        self.read()
        self.plans.make_room(run_id, self.state)

    def begin_plan(self, run_id: RunId) -> None:
        """Begin a new run, or another plan of the current run from where the axes rest."""
        if run_id.program_id != self.plans.run_id.program_id or self.state.completed:
            self.begin(run_id)
            return
        self.state = self.state.after(Event.REPLAN)
        self.plans.begin_plan(run_id)

    def _forget_run(self, run_id: RunId) -> None:
        self._progress = Progress()
        self.switching.begin()
        self.switching.forget_states(self.cycle.follows)
        self.plans.begin(run_id)
        self.figures.begin()

    @property
    def last(self) -> Reached | None:
        """Place in the program of the last played setpoint."""
        return self._progress.last

    @property
    def busy(self) -> bool:
        """Whether the cycle must be read often, because setpoints wait or are being played."""
        waits = self.plans.buffer.count or self.switching.busy or self._delayed is not None
        return bool(not self.state.resting or waits)

    @property
    def power_fails(self) -> bool:
        return self._power_input >= 0 and bool(self.drives.inputs[self._power_input])

    def check_jog(self) -> None:
        self.read()
        if not self.state.by_hand:
            self.state.after(Event.JOG)
            if waits := self.switching.waits_for_answer:
                raise StreamError(f'jog is not possible: {waits}; wait for it, or reset')
            if self.state.state is State.IDLE and self.plans.buffer.count:
                raise StreamError('jog is not possible: a program is about to start')

    def begin_jog(self, run_id: RunId, chunk: Chunk) -> None:
        """Begin a motion by hand; a run on hold is kept, and a new plan leads back to its path."""
        self.check_jog()
        plans = self.plans
        if self.state.state is State.HELD:
            plans.away = plans.away if len(plans.away) else self.axes.setpoints[-1].copy()
            plans.empty()
        else:
            self._forget_run(run_id)
        self.state = self.state.after(Event.JOG)
        self.push(chunk)
        self.cycle.start(plans.buffer.chunks[0].serial)

    def push(self, chunk: Chunk) -> bool:
        """Buffer a chunk; return False if its plan or its motion by hand has already ended."""
        by_hand = self.state.by_hand
        self.look()
        over = by_hand and not self.state.by_hand
        if over or self.plans.is_left(self.state):
            return False
        self.plans.push(chunk, self.switching.functions)
        return True

    def before_join(self, run_id: RunId, number: int) -> FloatArray:
        """Return the three setpoints before a join at ``number`` [m, rad], or StreamError."""
        self.read()
        return self.plans.before_join(run_id, number, self.state)

    def join(self, run_id: RunId, number: int, chunk: Chunk) -> None:
        """Replace setpoint ``number`` and all later ones by a chunk; StreamError if too late."""
        self.read()
        self.plans.join(run_id, number, chunk, self.state, self.switching.functions)

    # Requests of the operator -------------------------------------------------------------------

    def hold(self) -> None:
        """Stop on the path as soon as the setpoints allow, and wait for cycle_start."""
        self.read()
        if self.cycle.follows:
            self._progress.held_after = True  # a thread continues to its end
            return
        self._handle(Event.HOLD, Reason.FEED_HOLD)

    def stop(self) -> None:
        """Stop on the path as soon as the setpoints allow, and go to FAULT."""
        self.read()
        self._handle(Event.STOP, Reason.EMERGENCY_STOP)

    def start(self) -> None:
        """Continue as soon as enough setpoints are buffered; StreamError if there is no run."""
        self.read()
        self.state = self.state.after(Event.RESUME)

    def refuse(self, reason: str) -> None:
        """Play the buffered setpoints, then stop on the path and go to FAULT for ``reason``."""
        self.read()
        self._handle(Event.REFUSE, detail=reason)

    def reset(self) -> None:
        """Clear a fault, or give up the rest of a run; StreamError unless at rest."""
        self.read()
        cleared = self.state.after(Event.RESET)
        if not self._powered:
            self._power_on()
        self.state = cleared
        self.cycle.mute(False)
        self.plans.given_up = self.plans.run_id.program_id or self.plans.given_up
        self.switching.stop(RESET)
        self._forget_run(NO_RUN)

    def _handle(self, event: Event, reason: Reason = Reason.NONE, detail: str = '') -> None:
        self.state = self.state.after(event, reason, detail)
        if self.state.leaves_plan:
            self.cycle.leave()
        if self.state.state is State.FAULT:
            self.plans.empty()
        self._see_stop()

    # Outputs ------------------------------------------------------------------------------------

    def switch(self, acts: Sequence[Act]) -> None:
        """Set outputs one after the other; StreamError if axes move or a program is active."""
        self.read()
        if self.state.state is not State.IDLE or self.plans.buffer.count:
            text = self.state.text or self.state.state.value
            raise StreamError(f'outputs are switched by hand at rest without a program ({text})')
        if breach := self.switching.refusal(acts):
            raise StreamError(breach)
        self._forget_run(NO_RUN)
        self.switching.add(acts)
        self._progress.finishing = True
        self._await_answers()
        self._work(0.0)

    def _await_answers(self) -> None:
        self.state = self.state.after(Event.FILL, Reason.FUNCTION, self.switching.text)

    def _switch_off(self, word: str) -> None:
        self.cycle.mute(True)
        self.switching.forget_states(self.cycle.follows)
        self.switching.stop(word)

    def _see_answer(self, number: int) -> None:
        """Record the contact of the probe during setpoint ``number``, and stop on the path."""
        moving = (State.RUNNING, State.HOLDING, State.STARVING)
        if self.last is None or self.state.state not in moving:
            return
        at_once = number <= self.switching.probes_from + 1
        position, since = self.feedback.position[0].copy(), self._signals.input(SINCE)
        if since >= 0:  # else it is that at the end of the period
            position -= self.feedback.velocity[0] * self.drives.inputs[since]
        self.contacts.append(Contact(self.plans.run_id, self.last.line, position, at_once))
        self._progress.answered = True
        self._handle(Event.HOLD, Reason.PROBE)

    def _see_stop(self) -> None:
        stops = self.state.state in (State.STOPPING, State.FAULT)
        if stops and self.switching.off not in (EMERGENCY, FAULT):
            emergency = self.state.reason is Reason.EMERGENCY_STOP
            self._switch_off(EMERGENCY if emergency else FAULT)

    def _work(self, seconds: float) -> None:
        """Continue to set outputs, and start the motion if all conditions are met."""
        switching = self.switching
        waits = self.state.waits_for in (WaitsFor.SETPOINTS, WaitsFor.NEW_PLAN)
        self._see_stop()
        if self.power_fails:
            self._alarm(NO_POWER)
        self._progress.waited = self._progress.waited + seconds if waits else 0.0
        if self._progress.waited >= LOST and not self.switching.off:
            self._switch_off(LOST_PLANNER)
        self._pass_over()
        buffer = self.plans.buffer
        last = buffer.rests > 0 or bool(buffer.chunks and self.state.refusal)
        ready = last or buffer.count >= self._full
        enough = self.state.may_start and ready and not self._progress.passing
        self._queue_functions(enough)
        for act in switching.work(seconds, self._may_begin):
            self.switching.note(act, self.plans.run_id, self.plans.played)
        self.drives.exchange(seconds)
        state = self.state
        if not (state.may_start and (enough or switching.asks or self._progress.finishing)):
            return
        if switching.asks and state.start_wanted:
            switching.answer()
            self._await_answers()
        elif switching.asks:
            self.state = state.after(Event.WAIT, Reason.FUNCTION, switching.asks)
        elif switching.busy:
            if state.text != switching.text:
                self._await_answers()
        elif self._progress.finishing:
            self._progress.finishing = False
            self.state = state.after(Event.FINISH)
        else:
            self.state = state.after(Event.START)
            self.cycle.start(buffer.chunks[0].serial)

    def _may_begin(self, act: Act) -> bool:
        held = self.state.state is State.HELD and not self.state.start_wanted
        return act.step.word in STOPS or act.before_stop or not held

    def _queue_functions(self, starts: bool) -> None:
        stops = self.state.state is State.HELD and self.state.reason in STOPPED
        chunks = self.plans.buffer.chunks
        if not (chunks and (starts or stops)) or chunks[0].first < 0:
            return
        if starts and self.switching.off:
            self.cycle.mute(False)
        self.switching.queue(chunks[0].acts, starts, stops)

    # What the cycle does ------------------------------------------------------------------------

    def step(self) -> None:
        self.cycle.step()
        self.read()

    def look(self) -> None:
        """Read the records of the cycle; for a program, only once several periods are recorded."""
        waits = self._delayed is not None or self.switching.busy
        if waits or self.state.by_hand or self.cycle.has_news(self._together):
            self.read()

    def read(self) -> None:
        """Process the records of the cycle; start it once enough setpoints are buffered."""
        records = self.cycle.read()
        count = len(records.source)
        if count:
            source, serial = records.source, records.serial
            changes = (source[1:] ^ source[:-1]) | (serial[1:] ^ serial[:-1]) | records.events[1:]
            borders = [0, *(np.flatnonzero(changes) + 1).tolist(), count]
            for first, last in pairwise(borders):
                self._take_over(records.part(first, last))
        failed = self.state.state is State.FAULT and self.state.reason is Reason.DRIVE_FAULT
        if failed and self._powered:
            self._power_off()
        self._work(count * self.axes.period)

    def _take_over(self, records: Records) -> None:
        """Process periods with the same source of setpoints; only the first may have events."""
        source, events = int(records.source[0]), int(records.events[0])
        if self.state.resting:
            source = kernel.REST  # delayed drives have failed in the meantime
        if source in (kernel.CHUNK, kernel.FOLLOW):
            self.plans.take(int(records.serial[0]))
        if events & kernel.ALARMED:
            self._alarm(self._cause(events >> kernel.ALARM_SHIFT))
        if events & kernel.STARVED:
            self._starve()
        if source == kernel.TAIL and not self.plans.on_tail:
            self.plans.take_tail()
        if events & kernel.WAITED and self._follows:
            self.state = self.state.after(Event.FILL)
            self._progress.passing = True
        elif events & (kernel.ENDED | kernel.WAITED):
            self._rest(bool(events & kernel.ENDED))
        if events & kernel.ASTRAY and self.state.leaves_plan:
            self._rest(on_tail=True)
        elif events & kernel.ASTRAY:
            text = f'line {self.plans.line}: {self.spindle.cause(self.axes.machine.axis_names)}'
            self._handle(Event.FAIL, Reason.SETPOINT_REFUSED, text)
        self._follows = source == kernel.FOLLOW
        if events & (kernel.REFUSED | kernel.FAILED):
            self._fail(records)
        if self._follows:
            self._measure_followed(records)
        elif source == kernel.REST or self.state.resting:
            self._measure(None, records)
        else:
            first, number = int(records.row[0]), self.plans.played
            self.plans.row = first + len(records.row) - 1
            self._play(self.plans.rows[first : self.plans.row + 1], records)
            if events & kernel.PROBED:
                self._see_answer(number)

    def _cause(self, number: int) -> str:
        if number < kernel.AT_LIMIT:
            return self.drives.fault(number)
        _, axis, side = self._limits[number - kernel.AT_LIMIT]
        name, end = self.axes.machine.axis_names[axis], 'upper' if side > 0 else 'lower'
        return f'{name} is on its {end} limit switch; after the reset jog it off'

    def _starve(self) -> None:
        """Leave the plan after an underrun, or because the stream was rejected."""
        self.figures.starvations += 1
        if self.state.refusal:
            reason, detail = Reason.STREAM_REFUSED, self.state.refusal
            self.state = self.state.after(Event.STOP, reason, detail)
        else:
            self.state = self.state.after(Event.STARVE, Reason.STARVED, str(self.plans.played))

    def _rest(self, on_tail: bool) -> None:
        """Come to rest on the path; a stop (``on_tail``) ends the plan, other rests do not."""
        current = self.plans.current
        if on_tail or self.state.leaves_plan or current is None:
            self.plans.empty()
            self.state = self.state.after(Event.REST)
            if self._progress.answered and self.state.state is State.HELD:
                self.plans.given_up = self.plans.run_id.program_id  # the rest of its line
                self.state = self.state.after(Event.FINISH, Reason.PROBE)
            return
        wait, self.plans.current = current.chunk.wait, None
        if wait is Wait.END:
            self.switching.forget_states(self.cycle.follows)
        if wait is Wait.END and current.acts.end:
            self.switching.add(current.acts.end)
            self._progress.finishing = True
            self._await_answers()
            return
        if wait is Wait.SINGLE_BLOCK and not self.single_block:
            wait = Wait.NOTHING  # single block was switched off after this rest was planned
        self.state = self.state.after(*RESTS[wait])

    def _fail(self, records: Records) -> None:
        """Go to FAULT because the cycle or the drives have rejected a setpoint."""
        row = int(records.row[0])
        if int(records.events[0]) & kernel.FAILED:
            self._handle(Event.FAIL, Reason.DRIVE_FAULT, self.drives.fault(row))
            return
        samples = self.plans.rows
        fault = self.axes.fault_of(samples.position[row], samples.velocity[row])
        self._handle(Event.FAIL, Reason.SETPOINT_REFUSED, fault)

    def _alarm(self, cause: str) -> None:
        """Stop on the path and go to FAULT because of an alarm of the drives."""
        if self.state.state is not State.INACTIVE and self.state.reason is not Reason.DRIVE_FAULT:
            self._handle(Event.STOP, Reason.DRIVE_FAULT, cause)

    def _measure_followed(self, records: Records) -> None:
        wanted, answered = records.setpoint, records.answered
        self.feedback = self.axes.measure(wanted, records.position, records.velocity, answered)
        assert self.plans.current is not None
        block, ramp = self.plans.current.chunk.samples.block[0], self.spindle.state[0].ramp
        line = self.plans.run_id, int(block), self.plans.line, float(ramp)
        self.followed.append(Followed(*line, wanted, records.angle, self._later))

    def _pass_over(self) -> None:
        """Record all setpoints of a line that was executed in step with the spindle."""
        progress, plans = self._progress, self.plans
        while progress.passing:
            if plans.current is None:
                if not plans.buffer.chunks:
                    return
                plans.current = plans.buffer.pop()
            current, samples = plans.current, plans.current.chunk.samples
            for row, act in current.acts.rows:
                self.switching.note(act, plans.run_id, plans.played + row)
            ends = current.chunk.wait is Wait.END
            given = current.run_id, plans.played, samples, samples.position
            self.executed.append(Executed(*given, ends))
            progress.last = Reached.of(samples)
            plans.count(len(samples))
            if current.chunk.wait in (Wait.NOTHING, Wait.OVERRIDE):
                plans.current = None
                continue
            progress.passing = False
            self._rest(False)
            if progress.held_after and self.state.state is State.FILLING:
                self._handle(Event.HOLD, Reason.FEED_HOLD)
            progress.held_after = False

    def _measure(self, samples: Setpoints | None, records: Records) -> bool:
        x, v, answered = records.position, records.velocity, records.answered
        here, follow, delayed = self.axes.setpoints[-1], True, self._delayed
        wanted = AxisRows.held(here, len(x)) if samples is None else axis_rows(samples)
        if delayed is not None:
            try:
                x, v, answered = delayed.follow(wanted, self.plans.way_to_rest(self.state.resting))
            except DriveFaultError as fault:
                self.cycle.halt()
                self._handle(Event.FAIL, Reason.DRIVE_FAULT, str(fault))
                wanted, follow = AxisRows.held(here, len(x)), False
                x, v, answered = delayed.follow(wanted, self.plans.way_to_rest(self.state.resting))
            if delayed.alarm:
                self._alarm(delayed.alarm)
        self.feedback = self.axes.measure(wanted.position, x, v, answered)
        return follow

    def _play(self, samples: Setpoints, records: Records) -> None:
        plans, progress, current = self.plans, self._progress, self.plans.current
        on_tail, left = plans.on_tail, len(plans.rows) - 1 - plans.row
        assert current is not None
        if samples.block[0] > 0 and (progress.last is None or progress.last.block == 0):
            self.figures.begin_motion()
        if not self._measure(samples, records):
            return
        if samples.block[-1] > 0:
            plans.away = np.zeros(0)  # the machine is back on the path
        if not len(plans.away):
            if not on_tail and current.chunk.wait is Wait.NOTHING and plans.buffer.rests == 0:
                figures, waits = self.figures, plans.buffer.count + left
                figures.least_buffered = min(figures.least_buffered, waits)
            progress.last = Reached.of(samples)
        for row, act in current.acts.tail if on_tail else current.acts.rows:
            ahead = row - (plans.row + 1 - len(samples))
            if 0 <= ahead < len(samples) and not self.switching.off:
                self.switching.note(act, plans.run_id, plans.played + ahead)
        at_end = not on_tail and not left
        ends = at_end and current.chunk.wait is Wait.END and not len(plans.away)
        actual = self.feedback.position
        self.executed.append(Executed(current.run_id, plans.played, samples, actual, ends))
        plans.count(len(samples), of_plan=not (on_tail or self.state.by_hand))
        self.figures.add(samples, self.feedback)
