"""Ctrl-C, SIGTERM and a closed terminal, handled as a request in a loop, or later."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

#: Signals that request the end of a command.
STOPS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


@contextmanager
def stop_signals() -> Iterator[list[int]]:
    """Yield a list that is empty until a signal asks to stop."""
    stop: list[int] = []
    previous = {k: signal.signal(k, lambda found, _frame: stop.append(found)) for k in STOPS}
    try:
        yield stop
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)


@contextmanager
def stops_later() -> Iterator[None]:
    """Delay signals until the end of the context, because ``rclpy`` loses their exceptions."""
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
