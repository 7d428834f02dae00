"""The time spent compiling kernels: it is reported, and does not count as working time."""

import mmap
import multiprocessing
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

#: Compiling is reported if it takes longer [s].
PATIENCE = 1.0
COMPILING = 'compiling numeric kernels, once; it takes seconds to minutes'


@cache
def _short_refusal() -> Any:
    from numba.core.extending import overload

    def refuse(source: Any, target: Any) -> None: ...

    @overload(refuse)
    def compiled(source: Any, target: Any) -> Any:
        def refused(source: Any, target: Any) -> None:
            raise ValueError('the array does not fit into the part that it is assigned to')

        return refused

    return refuse


class CompileTime:
    """Adds up the time that this process, or one forked from it, spends compiling."""

    def __init__(self) -> None:
        self._depth = 0
        self._lock = multiprocessing.get_context('fork').Lock()
        # time until the last begin, that begin, how many processes compile, whether it was told
        self._shared = memoryview(mmap.mmap(-1, 4 * 8)).cast('d')

    @property
    def seconds(self) -> float:
        total, since, count, _ = self._shared
        return total + (time.monotonic() - since if count else 0.0)

    def start(self) -> None:
        self._depth += 1
        with self._lock:
            if self._depth == 1:
                if not self._shared[2]:
                    self._shared[1] = time.monotonic()
                self._shared[2] += 1
            tells = not self._shared[3] and self.seconds > PATIENCE
            self._shared[3] = self._shared[3] or tells
        if tells:
            print(COMPILING, file=sys.stderr, flush=True)

    def end(self) -> None:
        self._depth -= 1
        if not self._depth:
            with self._lock:
                if self._shared[2] == 1:
                    self._shared[0] = self.seconds
                self._shared[2] -= 1


COMPILE_TIME = CompileTime()


@contextmanager
def compiling() -> Iterator[None]:
    """Measure the time of compiling a kernel; the caller holds numba's own lock.

    For each assignment of an array to a slice, numba compiles an error message with both shapes.
    That takes much of the compile time, so a shorter message replaces it meanwhile.
    """
    from numba.np import arrayobj

    usual = arrayobj.raise_with_shape_context
    arrayobj.raise_with_shape_context = _short_refusal()
    COMPILE_TIME.start()
    try:
        yield
    finally:
        COMPILE_TIME.end()
        arrayobj.raise_with_shape_context = usual


def working_time() -> float:
    """Return a steady clock that stands still while kernels are compiled [s]."""
    return time.monotonic() - COMPILE_TIME.seconds
