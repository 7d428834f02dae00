"""Handle Ctrl-C, SIGTERM and a closed terminal: as a request to a loop, or delayed."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: Signals that request a command to end.
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Yield a list to which the number of each stop signal is appended."""
    stop: list[int] = []
    previous = {k: signal.signal(k, lambda found, _frame: stop.append(found)) for k in STOPS}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def stops_later() -> Iterator[None]:
    """Delay stop signals until the context ends, because ``rclpy`` loses their exceptions."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    try:
        with stop_signals() as came:
            yield
    finally:
        for number in came:
            signal.raise_signal(number)
