"""Low-level parts of compiled code: distinct arrays, addresses, memory order, the clock."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.extending import intrinsic

from cnc_interp.core import IntArray
from cnc_interp.core.kernels import njit

#: ``CLOCK_MONOTONIC`` and ``TIMER_ABSTIME`` of <time.h>.
MONOTONIC, ABSOLUTE = 1, 1
NANOSECONDS = 1_000_000_000

_gettime = types.ExternalFunction('clock_gettime', types.intc(types.intc, types.uintp))
_nanosleep = types.ExternalFunction(
    'clock_nanosleep', types.intc(types.intc, types.intc, types.uintp, types.uintp)
)


@intrinsic
def pointer(_context: Any, _address: Any) -> Any:
    """Turn an address into a pointer to float64, for ``numba.carray``."""
    signature = types.CPointer(types.float64)(types.uintp)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        return builder.inttoptr(given[0], context.get_value_type(signature.return_type))

    return signature, generate


@intrinsic
def call_c(_context: Any, _function: Any, _first: Any, _second: Any, _third: Any) -> Any:
    """Call a C function ``int f(void *, void *, void *)``, or one of fewer, by its address."""
    signature = types.int64(*[types.uintp] * 4)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(ir.IntType(32), [word] * 3).as_pointer()
        found = builder.call(builder.inttoptr(given[0], kind), given[1:])
        return builder.sext(found, word)

    return signature, generate


@intrinsic
def fence(_context: Any) -> Any:
    """Make all earlier writes visible before any later write (a memory fence)."""

    def generate(context: Any, builder: Any, _signature: Any, _given: Any) -> Any:
        builder.fence('seq_cst')
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def call_drives(
    _context: Any, _step: Any, _memory: Any, _setpoint: Any, _feedback: Any, _count: Any
) -> Any:
    """Call a compiled step of the drives by its address; see ``drives.CycleDrives``."""
    signature = types.int64(*[types.uintp] * 4, types.int64)

    def generate(_context: Any, builder: Any, _signature: Any, given: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(word, [word] * 4).as_pointer()
        return builder.call(builder.inttoptr(given[0], kind), given[1:])

    return signature, generate


@njit(cache=True, nogil=True)
def publish(words: IntArray, index: int, value: int) -> None:
    """Write a word so that all earlier writes are visible before it."""
    fence()
    words[index] = value
    fence()


@njit(cache=True, nogil=True)
def time_now(time: IntArray) -> int:
    """Return the time of the monotonic clock [ns]; ``time`` is the memory of a ``timespec``."""
    _gettime(MONOTONIC, time.ctypes.data)
    return int(time[0] * NANOSECONDS + time[1])


@njit(cache=True, nogil=True)
def sleep_until(due: int, time: IntArray) -> None:
    """Sleep until a time of the monotonic clock [ns]; signals do not end it."""
    time[0], time[1] = due // NANOSECONDS, due % NANOSECONDS
    while _nanosleep(MONOTONIC, ABSOLUTE, time.ctypes.data, np.uintp(0)) != 0:
        pass


class DistinctArrays(CompilerBase):  # type: ignore[misc]
    """Compiler for kernels whose arrays never overlap; its loops can then be vectorised (SIMD)."""

    def define_pipelines(self):  # type: ignore[no-untyped-def]
        self.state.flags.noalias = True
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]
