"""The latest observations, with consecutive numbers; many clients may read them at once."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from threading import Condition

from cnc_interp.core import InterpError
from cnc_interp.mtconnect.device import DataItem

UNAVAILABLE = 'UNAVAILABLE'
NORMAL, WARNING, FAULT = 'Normal', 'Warning', 'Fault'  #: Levels of conditions.
BUFFER = 1 << 17  #: Number of stored observations.


class RequestError(InterpError):
    """A request cannot be answered; ``code``: MTConnect's error code."""

    def __init__(self, code: str, message: str):
        super().__init__(message)
        self.code = code


@dataclass(frozen=True)
class Observation:
    sequence: int
    time: float  #: Time since 1970 [s].
    item: str  #: Id of its data item.
    value: str  #: Value as text; for a condition its level.
    code: str = ''  #: For a condition: name of the reporter.
    text: str = ''  #: For a condition: description of the fault.


class Store:
    """Stores the last observations of a device's data items; at first all are unavailable."""

    def __init__(
        self,
        items: Mapping[str, DataItem],
        size: int = BUFFER,
        clock: Callable[[], float] = time.time,
    ):
        self._items, self.clock, self.size = items, clock, size
        self._kept: deque[Observation] = deque(maxlen=size)
        self._counts: dict[str, list[Observation]] = {item: [] for item in items}
        self._dropped: dict[
            str, list[Observation]
        ] = {}  # valid before the oldest kept observation
        self._news, self._next = Condition(), 1
        self.lose()

    @property
    def next_sequence(self) -> int:
        return self._next

    @property
    def first_sequence(self) -> int:
        return self._kept[0].sequence

    def _add(self, item: str, value: str, code: str = '', text: str = '') -> None:
        if len(self._kept) == self.size:
            oldest = self._kept[0]
            self._dropped[oldest.item] = _after(self._dropped.get(oldest.item, []), oldest)
        found = Observation(self._next, self.clock(), item, value, code, text)
        self._next += 1
        self._kept.append(found)
        self._counts[item] = _after(self._counts[item], found)

    def observe(self, values: Mapping[str, str]) -> None:
        """Add observations of changed values; ``values``: id of a data item -> value."""
        with self._news:
            for item, value in values.items():
                if self._counts[item][0].value != value:
                    self._add(item, value)
            self._news.notify_all()

    def condition(self, item: str, level: str, code: str = '', text: str = '') -> None:
        """Store what one reporter, named by ``code``, reports about a condition."""
        with self._news:
            counts = self._counts[item]
            active = {one.code: one for one in counts if one.value in (WARNING, FAULT)}
            if level != NORMAL:
                known = active.get(code)
                if known is None or (known.value, known.text) != (level, text):
                    self._add(item, level, code, text)
            elif code in active:
                self._add(item, NORMAL, code if len(active) > 1 else '')
            elif counts[0].value == UNAVAILABLE:
                self._add(item, NORMAL)
            self._news.notify_all()

    def lose(self) -> None:
        """Mark all data items as unavailable, because the machine does not answer."""
        with self._news:
            for item, counts in self._counts.items():
                if not counts or counts[0].value != UNAVAILABLE:
                    self._add(item, UNAVAILABLE)
            self._news.notify_all()

    def current(self, items: Collection[str], at: int | None = None) -> list[Observation]:
        """Return the values now, or after observation ``at``; RequestError if that was dropped."""
        with self._news:
            found = self._counts
            if at is not None:
                self._demand(at, self._next - 1, 'at')
                found = dict(self._dropped)
                for one in self._kept:
                    if one.sequence <= at:
                        found[one.item] = _after(found.get(one.item, []), one)
            return [one for item in self._items if item in items for one in found.get(item, [])]

    def sample(
        self, items: Collection[str], begin: int | None, count: int
    ) -> tuple[list[Observation], int]:
        """Return up to ``count`` observations, and the number at which the next sample begins.

        A negative ``count`` goes back from ``begin``, by default from the newest one. Raises
        """
        with self._news:
            if begin is not None:
                self._demand(begin, self._next, 'from')
            kept: Iterable[Observation] = self._kept
            if count < 0:
                last = self._next - 1 if begin is None else begin
                chosen = [one for one in kept if one.sequence <= last and one.item in items]
                chosen = chosen[count:]
                return chosen, chosen[0].sequence if chosen else self.first_sequence
            first = self.first_sequence if begin is None else begin
            chosen = []
            for one in kept:
                if one.sequence >= first and one.item in items:
                    if len(chosen) == count:
                        return chosen, one.sequence
                    chosen.append(one)
            return chosen, self._next

    def wait(self, after: int, timeout: float) -> bool:
        """Wait until observation number ``after`` exists; return False at the timeout [s]."""
        with self._news:
            return self._news.wait_for(lambda: self._next > after, timeout)

    def _demand(self, number: int, last: int, name: str) -> None:
        if not self.first_sequence <= number <= last:
            kept = f'{self.first_sequence} to {last}'
            raise RequestError('OUT_OF_RANGE', f'{name} is {number}; the buffer holds {kept}')


def _after(before: list[Observation], new: Observation) -> list[Observation]:
    """Return an item's current observations after a new one; a condition may have several."""
    others = [one for one in before if one.code not in ('', new.code)] if new.code else []
    return others if new.value == NORMAL and others else [*others, new]
