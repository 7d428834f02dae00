"""Both ends of a stream with a sliding window, as in TCP. They need no clock and no ROS.

Items are numbered without gaps within a program. An item with several elements (a chunk of
setpoints) has several numbers. The sender keeps every item until it is acknowledged. It resends
the first missing item, and later items only if the receiver reports that they are missing, too.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from cnc_interp.core import Refusal, StreamError
from cnc_interp.run.run_state import NO_RUN, RunId

Item = TypeVar('Item')
REMEMBERED = 64  #: Late messages are recognised for this many past runs.
#: Time allowed for resent items to arrive [s]. It doubles with each failure, so that resending
#: does not add to the load of an overloaded computer.
SETTLE = 0.05
MOST_PATIENT = 16.0  #: Longest delay of resending over the shortest one [-].


@dataclass(frozen=True)
class Numbered(Generic[Item]):
    """An item with the number of its first element and the count of its elements."""

    first: int
    count: int
    item: Item

    @property
    def after(self) -> int:
        return self.first + self.count


class WindowedSender(Generic[Item]):
    """The sending end. It resends after ``resend_after`` [s] of silence, then after twice that."""

    def __init__(self, resend_after: float):
        self.resend_after = self._patience = resend_after
        self.run_id = NO_RUN
        self._begin(0, 0)

    def _begin(self, first: int, limit: int) -> None:
        self._items: deque[Numbered[Item]] = deque()  # from the first unacknowledged one
        self._in_flight = 0  # how many of them are sent and not taken for lost
        self._repeats = self._repeated = 1  # that may be sent again: now, and last time
        self._first = first
        self.next_number = first
        self.acknowledged = first
        self.limit = limit
        self.sent = first  # number after the last item that was ever sent
        self._since = 0.0
        self.unanswered_since = math.inf  # what was sent and is not acknowledged [s]
        self._again, self._settle = -math.inf, SETTLE
        self._patience = self.resend_after

    def begin(self, run_id: RunId, first: int = 0, limit: int = 0) -> None:
        """Begin a run whose first item has number ``first``; drop all items of the old run."""
        self.run_id = run_id
        self._begin(first, limit)

    def put(self, item: Item, count: int = 1) -> None:
        self._items.append(Numbered(self.next_number, count, item))
        self.next_number += count

    @property
    def unsent(self) -> int:
        return self.next_number - self.sent

    @property
    def all_acknowledged(self) -> bool:
        return not self._items

    def due(self, now: float) -> list[Numbered[Item]]:
        """Return the items to send or resend now. The first item may be sent without a window."""
        if self._in_flight and now - self._since > self._patience:
            self._lost()
            self._patience = min(2.0 * self._patience, MOST_PATIENT * self.resend_after)
        found = []
        while self._in_flight < len(self._items):
            item = self._items[self._in_flight]
            if item.first >= self.limit and item.first > self._first:
                break
            if item.first < self.sent:
                if not self._repeats:
                    break
                self._repeats -= 1
            if self._in_flight == 0:
                self._since, self.unanswered_since = now, min(now, self.unanswered_since)
            found.append(item)
            self._in_flight += 1
            self.sent = max(self.sent, item.after)
        return found

    def _lost(self) -> None:
        self._in_flight, self._repeats, self._repeated = 0, 1, 1

    def take_back(self, items: int) -> None:
        """Mark the last ``items`` returned by ``due`` as not sent, because publishing failed."""
        self._in_flight = max(0, self._in_flight - items)
        self._repeats += items

    def acknowledge(
        self, run_id: RunId, next_number: int, window_limit: int, now: float, gap: bool = False
    ) -> None:
        """Process a status of the receiver; missing items within the window will be resent."""
        if run_id != self.run_id or next_number > self.sent:
            return
        if self._items and self._items[0].after <= next_number:
            while self._items and self._items[0].after <= next_number:
                self._items.popleft()
                self._in_flight = max(0, self._in_flight - 1)
            self._since, self._patience = now, self.resend_after
            self._again, self._settle = -math.inf, SETTLE
            self._repeats = self._repeated = min(2 * self._repeated, 1 + len(self._items))
            self.unanswered_since = now if self._in_flight else math.inf
        if gap and window_limit > next_number and now - self._again > self._settle:
            self._lost()
            self._again = now
            self._settle = min(2.0 * self._settle, MOST_PATIENT * self.resend_after)
        self.acknowledged = max(self.acknowledged, next_number)
        self.open(window_limit)

    def open(self, window_limit: int) -> None:
        self.limit = max(self.limit, window_limit)


class WindowedReceiver:
    """The receiving end; ``window``: how many numbers may be sent beyond the last consumed one.

    ``gives_way``: function that returns whether a run on a topic is given up for a new run there.
    """

    def __init__(
        self, stream: str, window: int, gives_way: Callable[[str], bool] = lambda topic: False
    ):
        self.stream, self.window, self.gives_way = stream, window, gives_way
        self.run_id = NO_RUN
        self.next_number = 0
        self.consumed = 0
        self.complete = False
        self.refused, self.refusal_text, self._closed = Refusal.NONE, '', ''
        self._past: deque[RunId] = deque(maxlen=REMEMBERED)

    @property
    def active(self) -> bool:
        return bool(self.run_id) and not self.complete and not self.refused

    @property
    def limit(self) -> int:
        """Number of the first item that must not be sent yet."""
        return self.consumed + self.window if self.active else self.next_number

    def expect(self, run_id: RunId, first: int, begins: bool) -> None:
        """Raise StreamError unless item ``first`` is the next one or ``begins`` a plan."""
        why, kind = self._fault(run_id, first, begins)
        if kind is Refusal.PLAN_OVER:
            raise StreamError(why, kind)
        if kind:
            raise StreamError(f'{self.stream}: {why}', kind)

    def _fault(self, run_id: RunId, first: int, begins: bool) -> tuple[str, Refusal]:
        due = self.next_number
        if not run_id:
            return f'item {first} has no program id; send one', Refusal.FOREIGN_RUN
        if run_id != self.run_id:
            return self._fault_of_new(run_id, first, begins)
        if self.refused:
            return f'{first} after the refusal: {self.refusal_text}', self.refused
        if first < due:
            return f'repeat of {first}; {due} is next; nothing changed', Refusal.REPEAT
        if self._closed:
            return self._closed, Refusal.PLAN_OVER
        if self.complete:
            return f'{first} after the end of the program', Refusal.LATE
        if first > due:
            return f'gap: {first} came, but {due} is next; send again from {due}', Refusal.GAP
        return '', Refusal.NONE

    def _fault_of_new(self, run_id: RunId, first: int, begins: bool) -> tuple[str, Refusal]:
        # A plan from rest begins after the one before is closed; one that joins does not wait.
        goes_on = run_id.attempt > self.run_id.attempt or first > 0
        if self.active and not (goes_on and run_id.continues(self.run_id)):
            why = f'foreign program {run_id} while {self.run_id} runs; wait for its end'
            return why, Refusal.FOREIGN_RUN
        if run_id in self._past:
            return f'{first} of old program {run_id}', Refusal.LATE
        if not begins:
            why = f'gap: {first} of unknown program {run_id}; a program begins at 0'
            return why, Refusal.FOREIGN_RUN
        return '', Refusal.NONE

    def take(self, run_id: RunId, first: int, count: int = 1, end: bool = False) -> None:
        """Count an item as received; ``expect`` must have accepted it."""
        if run_id != self.run_id:
            self._begin(run_id, first)
        self.next_number += count
        self.complete = end

    def _begin(self, run_id: RunId, first: int = 0) -> None:
        if self.run_id:
            self._past.append(self.run_id)
        self.run_id = run_id
        self.next_number = self.consumed = first
        self.complete, self.refused, self.refusal_text, self._closed = False, Refusal.NONE, '', ''

    def refuse(self, run_id: RunId, kind: Refusal, reason: str) -> None:
        """Accept no more items of a run; kind and reason go into ``StreamStatus``."""
        if run_id != self.run_id:
            self._begin(run_id)
        self.refused, self.refusal_text = kind, reason

    def close(self, reason: str) -> None:
        """Accept no more items of this plan; messages in transit are ignored."""
        self.complete, self._closed = True, reason

    def make_way(self, run_id: RunId) -> None:
        """Close the current run, which has not moved, if ``run_id`` is a new run."""
        if run_id not in self._past:
            self.close('its sender has begun another run before it moved')

    def consume(self, count: int) -> None:
        self.consumed += count


class Silence:
    """Silence of another node while this node waits for it; the caller passes the time."""

    def __init__(self) -> None:
        self._heard = -math.inf
        self._waits_since = math.inf

    def hear(self, now: float) -> None:
        self._heard = now

    def waited(self, waits: bool, now: float) -> float:
        """Return how long this node has waited without hearing the other node [s]; else 0."""
        self._waits_since = min(self._waits_since, now) if waits else math.inf
        return now - max(self._heard, self._waits_since) if waits else 0.0
