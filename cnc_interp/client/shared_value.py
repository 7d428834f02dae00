"""A value that several may set: what one of them sees while its own words are on their way."""

from __future__ import annotations

from collections import deque


class SharedValue:
    """
    A value as heard on a topic, and the wishes of this end that were not heard there yet.

    While one is on its way, what is heard is an echo of an older one, however slow the computer
    is: the last wish counts.

    Parameters
    ----------
    value : float
        What counts before anything is heard.
    patience : float
        After this a wish counts as lost to that of another [s].

    """

    def __init__(self, value: float, patience: float):
        self._heard, self._patience = value, patience
        self._wishes: deque[float] = deque()
        self._until = 0.0

    def wish(self, value: float, now: float) -> None:
        """Note what this end sends."""
        if now >= self._until:
            self._wishes.clear()
        self._wishes.append(value)
        self._until = now + self._patience

    def hear(self, value: float) -> None:
        """Note what came over the topic; the wishes before it are not heard any more."""
        if value in self._wishes:
            while self._wishes.popleft() != value:
                pass
        self._heard = value

    def at(self, now: float) -> float:
        """Return the value that counts for this end."""
        return self._wishes[-1] if self._wishes and now < self._until else self._heard
