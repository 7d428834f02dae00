"""A value that several clients may set, as one of them must show it."""

from __future__ import annotations

from collections import deque


class SharedValue:
    """The last value heard on a topic, and the values sent from here that have not come back yet.

    While a sent value is on its way, a value that is heard may be older. So the last value sent
    counts until it is heard, or until ``patience`` is over.
    """

    def __init__(self, value: float, patience: float):
        self._heard, self._patience = value, patience
        self._wishes: deque[float] = deque()
        self._until = 0.0

    def wish(self, value: float, now: float) -> None:
        """Record a value that is sent from here at the time ``now`` [s]."""
        if now >= self._until:
            self._wishes.clear()
        if value != self.at(now):
            self._wishes.append(value)
            self._until = now + self._patience

    def hear(self, value: float) -> None:
        """Record a value that was received. Values sent before it will not be received any more.

        A value that is heard again and again is news only the first time.
        """
        if value == self._heard:
            return
        if value in self._wishes:
            while self._wishes.popleft() != value:
                pass
        self._heard = value

    def at(self, now: float) -> float:
        """Return the value that counts at the time ``now`` [s]."""
        return self._wishes[-1] if self._wishes and now < self._until else self._heard
