"""The functions of a program: outputs of the machine, each set at the start of a block."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from math import nan

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, ProgramError
from cnc_interp.core.tables import Table, column
from cnc_interp.machine_model.machine_entries import Standstill
from cnc_interp.machine_model.signals import FOLLOWS, FREE, Signals

STOP_SPINDLE = ('M5', 'M6', 'M2', 'M30')  #: Words after which the spindle rests.
TAP = 2  #: Rows of a tap in step with the spindle: into the hole, and back.
Acting = tuple[int, float]  #: A step of a function, and the value of its output.


def acting(
    signals: Signals,
    words: Iterable[str],
    given: Mapping[str, float],
    fault: Callable[[str, str], ProgramError],
) -> tuple[list[Acting], list[Acting]]:
    moments: tuple[list[Acting], list[Acting]] = [], []
    for word in words:
        for number in signals.words.get(word, ()):
            step = signals.steps[number]
            value = given.get(step.value, nan) if isinstance(step.value, str) else step.value
            if problem := signals.outputs[step.output].fault_of(value):
                raise fault(problem, word)
            moments[word in signals.after].append((number, value))
    return moments


class Functions(Table):
    #: Row of the block at whose start a function acts; the number of rows means the program end.
    block: IntArray = column()
    line_number: IntArray = column()  #: Line of the program text.
    step: IntArray = column()  #: Number in ``Signals.steps`` of the machine.
    value: FloatArray = column()  #: Value to which the output is set.
    #: Whether a function acts before, not after, a program stop (M0, M1) at the same block.
    before_stop: BoolArray = column(default=False)

    @staticmethod
    def of_rows(rows: Iterable[float]) -> Functions:
        columns = np.asarray(rows, dtype=float).reshape(-1, 5).T
        kinds = (declared.kind for declared in Functions.declared.values())
        return Functions(*(c.astype(kind) for c, kind in zip(columns, kinds, strict=True)))

    def until(self, block: int) -> int:
        """Return the number of functions that act at or before the start of a block."""
        return int(np.searchsorted(self.block, block, side='right'))

    def counts(self, signals: Signals) -> dict[str, int]:
        first = {words.start: word for word, words in signals.words.items()}
        return dict(Counter(first[k] for k in self.step.tolist() if k in first))

    def waits(self, signals: Signals) -> IntArray:
        waiting = np.array([step.rests for step in signals.steps], dtype=np.bool_)
        return np.unique(self.block[waiting[self.step]]) if len(self) else self.block

    def standstill(self, signals: Signals, times: Standstill) -> FloatArray:
        """Return how long the motion must stand still for each function, (n,) [s]."""
        first = {words.start: word for word, words in signals.words.items()}
        rests, wanted, turning, follows = np.zeros(len(self)), 0.0, 0.0, 0
        for k, (step, value) in enumerate(zip(self.step.tolist(), self.value, strict=True)):
            word = first.get(step)
            before = turning
            if word == 'S':
                wanted = float(value)
            if word in ('M3', 'M4') or (word == 'S' and turning):
                turning = wanted
            elif word in STOP_SPINDLE:
                turning = 0.0
            elif word == FOLLOWS:
                follows = int(self.block[k])
            elif word == FREE and self.block[k] == follows + TAP:
                rests[k] = 2.0 * times.reversal
            change = turning**2 - before**2
            rests[k] += times.start * change if change > 0.0 else -times.stop * change
            rests[k] += times.tool_change * (word == 'M6') + float(value) * (word == 'G4')
        return rests

    def speeds(self, signals: Signals) -> FloatArray:
        """Return the distinct spindle speeds in the program, (k,) [rev/min]."""
        word = signals.words.get('S')
        found: FloatArray = np.unique(self.value[self.step == word.start] if word else [])
        return found

    def from_row(self, row: int, signals: Signals) -> Functions:
        """Return the functions for a start at a row: those in effect, then the later ones."""
        after = self.until(row)
        starts = {words.start for words in signals.words.values()}
        threads = [k for word in (FOLLOWS, FREE) for k in signals.words.get(word, ())]
        thread = np.isin(self.step[:after], threads)
        here = self[:after][thread & (self.block[:after] == row)]  # a thread that begins there
        calls: list[list[int]] = []  # the rows of each word
        for k, step in enumerate(self.step[:after].tolist()):
            if thread[k]:
                continue
            if step in starts or not calls:
                calls.append([])
            calls[-1].append(k)
        sets = [{signals.steps[self.step[k]].output for k in call} for call in calls]
        words = [int(self.step[call[0]]) for call in calls]
        last = {output: at for at, outputs in enumerate(sets) for output in outputs}
        places: dict[int, int] = {}
        for at in sorted(set(last.values())):
            # Words keep their first place: S stays before M3 even if S was changed after M3.
            bound = max((k for k in places if sets[k] & sets[at]), default=-1)
            places[at] = words.index(words[at], bound + 1)
        rows = [k for at in sorted(places, key=lambda at: places[at]) for k in calls[at]]
        before = self[np.array(rows, dtype=np.int64)]
        return Functions.concatenate(
            [replace(before, block=np.zeros_like(before.block)), here, self[after:]]
        )
