"""A node's work at two paces: every few milliseconds while something is under way, else rarely."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

#: Time between two calls at rest [s].
REST = 0.05
#: Time after the last need for work until the node rests [s].
CALM = 1.0


class Pace:
    """Calls the work of a node at intervals."""

    def __init__(self, node: Any, period: float, work: Callable[[], bool]):
        self._work, self._period, self._needed = work, period, time.monotonic()
        self._slow = False
        self._timer = node.create_timer(period, self._call)

    def wake(self) -> None:
        """Work at the short intervals from now on; to be called with every command or message."""
        self._needed = time.monotonic()
        if self._slow:
            self._set(False)

    def _call(self) -> None:
        if self._work():
            self.wake()
        elif not self._slow and time.monotonic() - self._needed > CALM:
            self._set(True)

    def _set(self, slow: bool) -> None:
        self._slow = slow
        self._timer.timer_period_ns = round((REST if slow else self._period) * 1e9)
        self._timer.reset()
