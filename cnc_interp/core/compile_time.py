"""The time in which kernels are compiled: it is told, and it is no time of the work at hand."""

import mmap
import multiprocessing
import sys
import time
from functools import cache
from typing import Any

from numba.core.event import Listener, register

#: Compiling that takes longer is told [s].
PATIENCE = 1.0
COMPILING = 'compiling numeric kernels, once; it takes seconds to minutes'


@cache
def compile_less() -> None:
    """Leave out what no kernel needs and what takes a quarter of the time of set-up.

    That is an entry for C into each kernel; and where an array is assigned to a part of another
    one, an error message with both shapes.
    """
    from numba.core.cpu import CPUTargetOptions
    from numba.core.extending import overload
    from numba.np import arrayobj

    def refuse(source: Any, target: Any) -> None: ...

    @overload(refuse)
    def compiled(source: Any, target: Any) -> Any:
        def refused(source: Any, target: Any) -> None:
            raise ValueError('the array does not fit into the part that it is assigned to')

        return refused

    arrayobj.raise_with_shape_context = refuse
    finalize = CPUTargetOptions.finalize

    def finalize_without_entry(options: Any, flags: Any, given: Any) -> None:
        finalize(options, flags, given)
        flags.no_cfunc_wrapper = True  # ``cfunc`` sets it back

    CPUTargetOptions.finalize = finalize_without_entry


class CompileTime(Listener):  # type: ignore[misc]
    """Adds up the time in which this process, or one forked from it, compiles."""

    def __init__(self) -> None:
        self._depth = 0
        self._lock = multiprocessing.get_context('fork').Lock()
        # time until the last begin, that begin, how many processes compile, whether it was told
        self._shared = memoryview(mmap.mmap(-1, 4 * 8)).cast('d')

    @property
    def seconds(self) -> float:
        total, since, count, _ = self._shared
        return total + (time.monotonic() - since if count else 0.0)

    def on_start(self, event: Any) -> None:
        compile_less()
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

    def on_end(self, event: Any) -> None:
        self._depth -= 1
        if not self._depth:
            with self._lock:
                if self._shared[2] == 1:
                    self._shared[0] = self.seconds
                self._shared[2] -= 1


COMPILE_TIME = CompileTime()
register('numba:compile', COMPILE_TIME)


def working_time() -> float:
    """Return a steady clock that stands still while kernels are compiled [s]."""
    return time.monotonic() - COMPILE_TIME.seconds
