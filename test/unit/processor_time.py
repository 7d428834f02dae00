"""A bound on the processor time of a test, which another program beside it does not use up."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def bounded_processor_time(seconds: float) -> Iterator[None]:
    """Raise TimeoutError in the block when it has used so much processor time."""

    def too_long(*_: object) -> None:
        raise TimeoutError(f'more than {seconds:g} s of the processor')

    before = signal.signal(signal.SIGPROF, too_long)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
