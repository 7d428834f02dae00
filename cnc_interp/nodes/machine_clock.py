"""The thread in which the compiled cycle of the machine runs."""

from __future__ import annotations

import threading

from cnc_interp.machine.cycle import Cycle
from cnc_interp.machine.realtime import ask_for_priority


class MachineClock:
    """Runs the cycle in a thread of its own, which never needs the interpreter."""

    def __init__(self, cycle: Cycle, priority: int):
        self._cycle, self._priority = cycle, priority
        self._thread: threading.Thread | None = None
        #: How the thread is scheduled; empty before the start.
        self.scheduling = ''

    def start(self) -> None:
        """Start the thread."""
        self._cycle.quit(False)
        self._thread = threading.Thread(target=self._run, name='drives', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread, if it runs."""
        self._cycle.quit()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        self.scheduling = ask_for_priority(self._priority)
        self._cycle.run()
