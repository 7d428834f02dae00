"""The thread that does the tasks of a planning session, one after the other."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from threading import Thread
from typing import Any

from cnc_interp.run.planning_session import Task

#: Longest time that the sending thread waits for the planning thread [s].
SWITCH = 5e-4


class PlanningThread:
    """A thread that does one task after another, and the task submitted last."""

    def __init__(self) -> None:
        sys.setswitchinterval(SWITCH)
        self.longest = 0.0  # time of the longest task since the last reading [s]
        self._executor = ThreadPoolExecutor(1, thread_name_prefix='plan')
        self._job: tuple[Task, Future[Any], float] | None = None
        self._loads_rest = False

    def load_rest(self) -> None:
        """
        Import toppra in a thread of its own, unless that has begun.

        It takes a third of a second and is needed where a window is tried again. To be called when
        the machine moves, so that the first motion does not wait for it.
        """
        if not self._loads_rest:
            self._loads_rest = True
            rest = 'cnc_interp.feedrate.time_bound'
            Thread(target=import_module, args=[rest], daemon=True).start()

    def submit(self, task: Task) -> None:
        """Submit a task, which is done after those submitted before."""
        self._job = task, self._executor.submit(task.work), time.monotonic()

    def done(self) -> tuple[Task, Callable[[], Any]] | None:
        """Return the last task and its outcome once; None while it is under way."""
        if self._job is None or not self._job[1].done():
            return None
        task, future, submitted = self._job
        self._job = None
        self.longest = max(self.longest, time.monotonic() - submitted)
        return task, future.result

    def close(self) -> None:
        """Start no further task."""
        self._executor.shutdown(wait=False, cancel_futures=True)
