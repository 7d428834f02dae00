"""Ctrl-C, SIGTERM and a closed terminal as a request to stop, seen by the loop that runs."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Yield a list that is empty until a signal asks to stop."""
    stop: list[int] = []
    previous = {
        number: signal.signal(number, lambda found, _frame: stop.append(found))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
