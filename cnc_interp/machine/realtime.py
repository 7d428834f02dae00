"""Punctuality of a periodic thread; real-time scheduling and locked memory where permitted."""

from __future__ import annotations

import ctypes
import os
import resource
from array import array

import numpy as np

from cnc_interp.core.units import MS

#: Flags of `mlockall` in <sys/mman.h>: all present pages, and all future ones.
LOCK_CURRENT, LOCK_FUTURE = 1, 2
#: Width of a class of the histogram, and the upper end of the last class [s].
CLASS, LATEST = 2e-6, 100.0 * MS


def ask_for_priority(priority: int) -> str:
    """
    Ask for real-time scheduling of the calling thread; return what was granted, in words.

    Parameters
    ----------
    priority : int
        SCHED_FIFO, 1 to 99; 0 asks for nothing.

    """
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except (OSError, AttributeError) as problem:
            return f'SCHED_FIFO {priority} was not permitted ({problem}); {niceness()}'
        return f'SCHED_FIFO {priority}'
    return niceness()


def niceness() -> str:
    """Return how the calling thread is scheduled without real time, in words."""
    return f'ordinary scheduling, niceness {os.getpriority(os.PRIO_PROCESS, 0)}'


def lock_memory() -> str:
    """Lock all present and future pages of this process in memory; return the result in words."""
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(LOCK_CURRENT | LOCK_FUTURE) == 0:
        return 'memory locked'
    return f'memory was not locked ({os.strerror(ctypes.get_errno())})'


class Lateness:
    """
    Histogram of how late a periodic thread woke up; its memory does not grow.

    Parameters
    ----------
    period : float
        Its period [s].

    """

    def __init__(self, period: float):
        self._period = period
        self._counts = array('Q', bytes(8 * (round(LATEST / CLASS) + 1)))
        self.count = self.missed = 0
        self.largest = 0.0

    def add(self, late: float) -> None:
        """Count one wake-up, ``late`` [s] after its deadline."""
        late = max(late, 0.0)
        self._counts[min(int(late / CLASS), len(self._counts) - 1)] += 1
        self.count += 1
        self.missed += late > self._period
        self.largest = max(self.largest, late)

    def quantile(self, share: float) -> float:
        """Return the lateness that a share of the wake-ups did not exceed, to one class [s]."""
        below = np.cumsum(np.frombuffer(self._counts, dtype=np.uint64))
        found = int(np.searchsorted(below, share * self.count))
        return min((found + 1) * CLASS, self.largest)
