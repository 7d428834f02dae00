"""The outputs that are set while the path rests, one after the other, and those of a stop.

Before an output is set, the interlocks of the machine file are looked at: here, because a function
that can break one lets the path rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, StreamError
from cnc_interp.machine.drives import Drives
from cnc_interp.machine.spindle import Spindle
from cnc_interp.machine_model.signals import ASK, NO_WAIT, STOPS, TIMED, Signals, Step
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Chunk, Wait

NO_FUNCTION = -1  #: Number of what no function of the program sets.
LEAST_DELAY = 0.02  #: An input is looked at so long after the output, at the earliest [s].


class Act(NamedTuple):
    """An output that is set, and what is waited for then."""

    step: Step
    value: float
    number: int = NO_FUNCTION  #: Of the function in the run.
    place: int = 0  #: Number of the step in the machine file.
    block: int = 0  #: At whose begin it acts.
    line: int = 0  #: Of the source.
    before_stop: bool = False  #: Whether it acts before the program stop that is there.

    @property
    def limit(self) -> float:
        """The longest wait [s]."""
        return self.value if self.step.word[:3] == 'M66' else self.step.limit


class ActsOfChunk(NamedTuple):
    rows: list[tuple[int, Act]]  #: With a row of its setpoints.
    tail: list[tuple[int, Act]]  #: With a row of its stop tail.
    end: list[Act]  #: After the end of the program.
    after: int  #: Number of the first function after its setpoints.

    @staticmethod
    def of(chunk: Chunk, signals: Signals, expected: int) -> ActsOfChunk:
        """Find the rows of its functions from a number on; StreamError for what cannot be."""
        functions, first = chunk.functions, chunk.first_function
        if len(functions) and first > expected:
            raise StreamError(f'functions {expected} to {first - 1} are missing')
        new = functions[max(expected - first, 0) :]
        acts = [
            Act(signals.steps[place], value, number, place, block, line, before)
            for number, (block, line, place, value, before) in enumerate(
                zip(*(column.tolist() for column in new.columns().values()), strict=True), expected
            )
        ]
        count, blocks = len(chunk.samples), np.array([act.block for act in acts], dtype=np.int64)
        at = np.searchsorted(chunk.samples.block, blocks).tolist()
        on_tail = np.searchsorted(chunk.tail.block, blocks).tolist()
        rows = [(row, act) for row, act in zip(at, acts, strict=True) if row < count]
        later = [(row, act) for row, act in zip(on_tail, acts, strict=True)][len(rows) :]
        tail = [(row, act) for row, act in later if row < len(chunk.tail)]
        if any(act.step.rests for row, act in rows if row) or any(
            act.step.rests for _, act in tail
        ):
            raise StreamError('a function that waits must be at a rest of the path')
        end = [act for _, act in later] if chunk.wait is Wait.END else []
        return ActsOfChunk(rows, tail, end, expected + len(rows) + len(end))

    def head(self, count: int, length: int) -> ActsOfChunk:
        """Return those of the first of ``length`` setpoints; the others become the tail."""
        rows = [(row, act) for row, act in self.rows if row < count]
        moved = [(row - count, act) for row, act in self.rows if row >= count]
        moved += [(row + length - count, act) for row, act in self.tail]
        return ActsOfChunk(
            rows, moved, [], self.after - len(self.rows) - len(self.end) + len(rows)
        )

    @property
    def switches(self) -> tuple[FloatArray, FloatArray]:
        """Row, output and value of both parts, as the cycle takes them, (k, 3)."""
        parts = (
            [(row, act.step.output, act.value) for row, act in acts]
            for acts in (self.rows, self.tail)
        )
        first, second = (np.array(part, dtype=float).reshape(-1, 3) for part in parts)
        return first, second

    @property
    def waiting(self) -> int:
        """How many of those of row 0 come before the path may go on, the last one waits."""
        first = [act for row, act in self.rows if row == 0]
        return max((k + 1 for k, act in enumerate(first) if act.step.rests), default=0)


class Switching:
    def __init__(self, signals: Signals, drives: Drives, spindle: Spindle):
        self._signals, self._drives, self._spindle = signals, drives, spindle
        self._commanded = spindle.commanded
        self._queue: deque[Act] = deque()
        self._breach = ''  # the interlock that keeps the first one from being set
        self._is_set = self._answered = False  # the first one of the queue
        self._waited = 0.0  # since it was set [s]
        #: What functions have set, until it is published: the run, and the setpoint before.
        self.switched: deque[tuple[RunId, Act, int]] = deque()
        self.begin()

    def begin(self) -> None:
        """Begin a run, of which no function is set; what a stop sets remains."""
        self._forget()
        self.functions = self._queued = 0  # set so far; number after those that wait
        self.off = ''  # which of ``signals.STOPS`` has switched off
        self._were_on: dict[int, float] = {}  # what it has switched off, by output
        self.probes_from = 0  # setpoint with which the line of a probe begins

    @property
    def busy(self) -> bool:
        return bool(self._queue)

    @property
    def text(self) -> str:
        if not self._queue:
            return ''
        step, value = self._queue[0].step, self._queue[0].value
        told = self._signals.text(step.output, value)
        if step.wait == NO_WAIT:
            return told
        return f'{told}: waits for {self._signals.waited(step)}'

    @property
    def asks(self) -> str:
        """What the operator must see to before it goes on; empty for nothing."""
        if self._queue and self._breach:
            return f'{self._breach}; see to it, then press cycle start to try again, or reset'
        if not (self._queue and self._is_set) or self._answered:
            return ''
        step, limit = self._queue[0].step, self._queue[0].limit
        told = self._signals.text(step.output, self._queue[0].value)
        if self._signals.is_change(step):
            return f'put {told} into the spindle, then press cycle start'
        if step.wait == ASK:
            return f'{told}: press cycle start when that is done'
        if step.wait == NO_WAIT or self._waited <= limit:
            return ''
        return (
            f'{told}: {self._signals.waited(step)} has not come within {limit:g} s; see to '
            'it, then press cycle start to go on without it, or reset to give up'
        )

    def answer(self) -> None:
        self._answered = True

    def add(self, acts: Iterable[Act]) -> None:
        self._queue.extend(acts)

    @property
    def waits_for_answer(self) -> str:
        """Say which answer of the machine is waited for; empty if no motion would disturb it."""
        waits = self._queue and self._is_set and self._queue[0].step.wait not in (NO_WAIT, ASK)
        return self.text if waits else ''

    def refusal(self, acts: Iterable[Act]) -> str:
        """Return the interlock that these would break, up to the first one that waits."""
        outputs = self._commanded.copy()
        for act in acts:
            if breach := self._breach_of(act, outputs):
                return breach
            outputs[act.step.output] = act.value
            if act.step.wait != NO_WAIT:
                break
        return ''

    def _breach_of(self, act: Act, outputs: FloatArray) -> str:
        wires = outputs[: self._signals.wired]
        if act.step.output >= len(wires):
            return ''
        known = [*self._drives.inputs, self._spindle.turns, *wires]
        return self._signals.breach(act.step.output, act.value, known)

    def stop(self, word: str) -> None:
        """Switch off what a word of ``signals.STOPS`` says, now; setpoints switch nothing then."""
        self._queue.clear()
        self._is_set, self._breach = False, ''
        off = list(self._signals.off.get(word, ()))
        self._were_on |= {k: value for k in off if (value := float(self._commanded[k]))}
        self._commanded[off] = self._drives.outputs[off] = 0.0  # both: the clock may end
        steps = [self._signals.steps[k] for k in self._signals.words.get(word, ())]
        self.add(Act(step, float(step.value)) for step in steps)
        self.off, self._queued = word, self.functions
        self.work(0.0, lambda _: True)

    def _as_before(self, output: int, value: float) -> Act:
        """Return what sets an output again, and waits for the answer that its function has."""
        steps = (step for step in self._signals.steps if step.word not in STOPS)
        found = (step for step in steps if (step.output, step.value) == (output, value))
        return Act(next(found, Step('', output, value)), value)

    def forget_states(self, follows: bool) -> None:
        """Drop the state that belongs to one run alone."""
        if self._signals.probe:
            for outputs in (self._commanded, self._drives.outputs):
                outputs[self._signals.probe[0]] = 0.0
        if not follows:
            self._commanded[self._signals.wired :] = 0.0

    def queue(self, acts: ActsOfChunk, starts: bool, stops: bool) -> None:
        """Take what must be set before the path goes on, or before a program stop waits."""
        if starts and self.off:  # after a lost planner
            self._forget()
            self.add(self._as_before(*each) for each in self._were_on.items())
            self.off, self._were_on = '', {}
        count = acts.waiting if starts else 0
        for k, (row, act) in enumerate(acts.rows):
            early = row == 0 and (k < count or (stops and act.before_stop))
            if early and act.number >= max(self._queued, self.functions):
                self.add([act])
                self._queued = act.number + 1

    def note(self, act: Act, run_id: RunId, sample: int) -> None:
        """Count a function that was set with a setpoint of a run, unless it is counted."""
        if act.number < self.functions:
            return
        self.functions = act.number + 1
        if self._signals.probe and act.step.output == self._signals.probe[0]:
            self.probes_from = sample
        self.switched.append((run_id, act, sample))

    def _forget(self) -> None:
        self._queue = deque(act for act in self._queue if act.step.word in STOPS)
        self._is_set, self._breach = self._is_set and bool(self._queue), ''

    def work(self, seconds: float, may_begin: Callable[[Act], bool]) -> list[Act]:
        """Advance the time; return what was set."""
        done = []
        self._waited += seconds
        while self._queue:
            act = self._queue[0]
            if not self._is_set:
                if not may_begin(act):
                    break
                if act.step.word not in STOPS:
                    self._breach = self._breach_of(act, self._commanded)
                if self._breach:
                    break
                self._commanded[act.step.output] = act.value
                self._is_set, self._answered, self._waited = True, False, 0.0
                done.append(act)
            if not self._is_answered(act):
                break
            self._queue.popleft()
            self._is_set = False
        return done

    def _is_answered(self, act: Act) -> bool:
        step = act.step
        if step.wait in (NO_WAIT, TIMED):
            return self._waited >= (step.delay if step.wait == NO_WAIT else act.value)
        soonest = max(step.delay, LEAST_DELAY) + self._drives.ahead  # inputs before are old
        if self._answered or step.wait == ASK or self._waited < soonest:
            return self._answered
        known = *self._drives.inputs, self._spindle.turns
        return bool(known[abs(step.wait) - 1]) is (step.wait > 0)
