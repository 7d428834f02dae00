"""Set outputs one after the other while the axes rest on the path, or at a stop.

Before an output is set, the interlocks of the machine file are checked. No other code checks them,
because every function that can break an interlock is executed at rest.
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

NO_FUNCTION = -1  #: ``Act.number`` of an output change that belongs to no function of the run.
LEAST_DELAY = 0.02  #: Shortest time from setting an output to reading its answer [s].


class Act(NamedTuple):
    """An output change, and the condition that is awaited after it."""

    step: Step
    value: float
    number: int = NO_FUNCTION  #: Number of the function in the run.
    place: int = 0  #: Index of the step in ``Signals.steps``.
    block: int = 0  #: Block at the beginning of which it acts.
    line: int = 0  #: Line of the source.
    before_stop: bool = False  #: Whether it acts before the program stop at its block.

    @property
    def limit(self) -> float:
        """Longest wait for the condition [s]."""
        return self.value if self.step.word[:3] == 'M66' else self.step.limit


class ActsOfChunk(NamedTuple):
    rows: list[tuple[int, Act]]  #: Row of the chunk's setpoints, and act there.
    tail: list[tuple[int, Act]]  #: Row of its stop tail, and act there.
    end: list[Act]  #: Acts after the end of the program.
    after: int  #: Number of the first function after the chunk.

    @staticmethod
    def of(chunk: Chunk, signals: Signals, expected: int) -> ActsOfChunk:
        """Find the rows at which functions number ``expected`` and later act, or StreamError."""
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
        """Return the acts if the chunk of ``length`` setpoints is cut after ``count``."""
        rows = [(row, act) for row, act in self.rows if row < count]
        moved = [(row - count, act) for row, act in self.rows if row >= count]
        moved += [(row + length - count, act) for row, act in self.tail]
        return ActsOfChunk(
            rows, moved, [], self.after - len(self.rows) - len(self.end) + len(rows)
        )

    @property
    def switches(self) -> tuple[FloatArray, FloatArray]:
        """Return the output changes of setpoints and stop tail: row, output and value, (k, 3)."""
        parts = (
            [(row, act.step.output, act.value) for row, act in acts]
            for acts in (self.rows, self.tail)
        )
        first, second = (np.array(part, dtype=float).reshape(-1, 3) for part in parts)
        return first, second

    @property
    def waiting(self) -> int:
        """Number of acts at row 0 that must be completed before motion continues."""
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
        #: Executed acts to be published: run, act, and number of the setpoint.
        self.switched: deque[tuple[RunId, Act, int]] = deque()
        self.begin()

    def begin(self) -> None:
        """Begin a run: no function is executed yet. Pending outputs of a stop stay queued."""
        self._forget()
        self.functions = self._queued = 0  # set so far; number after those that wait
        self.off = ''  # which of ``signals.STOPS`` has switched off
        self._were_on: dict[int, float] = {}  # values that it has switched off, by output
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
        """What the operator must do before the run continues; '' if nothing."""
        if self._queue and self._breach:
            return f'{self._breach}; correct this, then press cycle start to try again, or reset'
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
            f'{told}: {self._signals.waited(step)} has not come within {limit:g} s; find the '
            'cause, then press cycle start to continue without it, or reset to give up'
        )

    def answer(self) -> None:
        self._answered = True

    def add(self, acts: Iterable[Act]) -> None:
        self._queue.extend(acts)

    @property
    def waits_for_answer(self) -> str:
        """Text of the input that is awaited and forbids motion by hand; '' if there is none."""
        waits = self._queue and self._is_set and self._queue[0].step.wait not in (NO_WAIT, ASK)
        return self.text if waits else ''

    def refusal(self, acts: Iterable[Act]) -> str:
        """Return the interlock that ``acts`` break, up to the first act that waits; '' if none."""
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
        """Switch off at once the outputs that ``word`` of ``signals.STOPS`` switches off."""
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
        """Return the act that restores an output value; it waits like the program's function."""
        steps = (step for step in self._signals.steps if step.word not in STOPS)
        found = (step for step in steps if (step.output, step.value) == (output, value))
        return Act(next(found, Step('', output, value)), value)

    def forget_states(self, follows: bool) -> None:
        """Disarm the probe; reset the spindle states unless the axes follow the spindle."""
        if self._signals.probe:
            for outputs in (self._commanded, self._drives.outputs):
                outputs[self._signals.probe[0]] = 0.0
        if not follows:
            self._commanded[self._signals.wired :] = 0.0

    def queue(self, acts: ActsOfChunk, starts: bool, stops: bool) -> None:
        """Queue the acts before motion (``starts``) or before a program stop (``stops``)."""
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
        """Record that a function acted at setpoint ``sample``, unless it is already recorded."""
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
        """Advance the time by ``seconds``; set outputs that are due and return their acts."""
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
