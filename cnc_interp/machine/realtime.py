"""Punctuality of a periodic thread; real-time scheduling and locked memory where permitted."""

import ctypes
import os
import resource

import numpy as np

from cnc_interp.core import UM, IntArray
from cnc_interp.core.kernels import njit

#: Flags of `mlockall` in <sys/mman.h>: lock present and future pages, each at its first use.
LOCK_CURRENT, LOCK_FUTURE, LOCK_ON_FAULT = 1, 2, 4
NANO = 1e-9
#: Width of a class of the histogram [ns]; number of classes, up to 100 ms; after them the largest
#: lateness and the number of periods caught up; number of words of the record.
CLASS, CLASSES = 2000, 50_000
LARGEST, CAUGHT_UP, RECORD = CLASSES, CLASSES + 1, CLASSES + 2


def ask_for_priority(priority: int) -> str:
    """Request SCHED_FIFO priority 1 to 99 for the calling thread; return the result as text."""
    if priority:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
        except (OSError, AttributeError) as problem:
            return f'SCHED_FIFO {priority} was not permitted ({problem}); {niceness()}'
        return f'SCHED_FIFO {priority}'
    return niceness()


def niceness() -> str:
    return f'ordinary scheduling, niceness {os.getpriority(os.PRIO_PROCESS, 0)}'


def lock_memory() -> str:
    """Lock all pages of this process in memory; return the result as text."""
    soft, hard = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft != hard:
        resource.setrlimit(resource.RLIMIT_MEMLOCK, (hard, hard))
    library = ctypes.CDLL(None, use_errno=True)
    if library.mlockall(LOCK_CURRENT | LOCK_FUTURE | LOCK_ON_FAULT) == 0:
        return 'memory locked'
    return f'memory was not locked ({os.strerror(ctypes.get_errno())})'


@njit(cache=True, nogil=True)
def note_lateness(record: IntArray, late: int) -> None:
    """Count one wake-up, ``late`` [ns] after its deadline."""
    late = max(late, 0)
    record[min(late // CLASS, CLASSES - 1)] += 1
    record[LARGEST] = max(record[LARGEST], late)


@njit(cache=True, nogil=True)
def note_catching_up(record: IntArray, late: int) -> None:
    """Count one period that begins ``late`` [ns] without a wake-up."""
    record[CAUGHT_UP] += 1
    record[LARGEST] = max(record[LARGEST], late)


class Lateness:
    """Histogram of the lateness of a periodic thread; periods caught up do not count."""

    def __init__(self, record: IntArray):
        self._reached = np.cumsum(record[:CLASSES])
        self.count = int(self._reached[-1])
        self.largest = float(record[LARGEST]) * NANO
        #: Number of periods that began only after their own end.
        self.caught_up = int(record[CAUGHT_UP])

    def quantile(self, share: float) -> float:
        """Return the lateness that a share of wake-ups did not exceed, rounded to a class [s]."""
        found = int(np.searchsorted(self._reached, share * self.count))
        return min((found + 1) * CLASS * NANO, self.largest)

    def figures(self) -> dict[str, object]:
        """Return the figures for the diagnostics; times in microseconds."""
        shares = {'p50': 0.5, 'p99': 0.99, 'p999': 0.999}
        late = {f'late_{name}_us': self.quantile(share) for name, share in shares.items()}
        late['late_max_us'] = self.largest
        told = {name: f'{value / UM:.0f}' for name, value in late.items()}
        periods = self.count + self.caught_up
        return {'periods': periods, 'missed_periods': self.caught_up, **told}
