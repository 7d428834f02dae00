"""The clock of the machine: a thread that calls back at absolute deadlines."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from cnc_interp.core.units import UM
from cnc_interp.machine.realtime import Lateness, ask_for_priority

#: After a longer stall of the computer the clock starts anew and does not catch up [s].
LONGEST_CATCH_UP = 0.5


class MachineClock:
    """
    Calls back once per period; late periods are caught up.

    Parameters
    ----------
    period : float
        Interpolation period [s].
    priority : int
        SCHED_FIFO priority to ask for, 1 to 99; 0 asks for nothing.
    on_period : callable
        Called in the thread of the clock.

    """

    def __init__(self, period: float, priority: int, on_period: Callable[[], object]):
        self._period, self._priority, self._on_period = period, priority, on_period
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self._lateness = Lateness(period)
        #: How the thread is scheduled; empty before the start.
        self.scheduling = ''

    def start(self) -> None:
        """Start the thread."""
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, name='drives', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread, if it runs."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        self.scheduling = ask_for_priority(self._priority)
        due = time.monotonic()
        while not self._stop.is_set():
            due += self._period
            wait = due - time.monotonic()
            if wait > 0.0:
                time.sleep(wait)
            elif wait < -LONGEST_CATCH_UP:
                due = time.monotonic()
            self._lateness.add(time.monotonic() - due)
            self._on_period()

    def forget_lateness(self) -> None:
        """Start the figures anew."""
        self._lateness = Lateness(self._period)

    def figures(self) -> dict[str, object]:
        """Return how punctual the thread was, for the diagnostics; times in microseconds."""
        late = self._lateness
        return {
            'periods': late.count,
            'missed_periods': late.missed,
            'late_p50_us': f'{late.quantile(0.5) / UM:.0f}',
            'late_p99_us': f'{late.quantile(0.99) / UM:.0f}',
            'late_max_us': f'{late.largest / UM:.0f}',
        }
