"""
The cycle of the machine: one compiled call without the interpreter's lock.

It wakes at absolute deadlines, takes one setpoint, steps the drives and records what it did.
It also decides on stops. After a hold, an emergency stop, and where the next chunk is late, it
plays the stop tail of the current chunk. So no thread of Python lies between clock and stop.

Chunks stand in a ring of descriptors with the addresses of their arrays; ``Cycle`` keeps the
arrays alive. A chunk is linked to the one before it after all of it is written, and another link
lets a new plan join in the middle of the ring. Records of what was played stand in a second ring.
Each ring has one writer and one reader.
"""

from __future__ import annotations

import time
from collections import deque
from typing import NamedTuple

import numpy as np
from numba import carray, cfunc, njit, types

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import StreamError
from cnc_interp.machine.native import (
    call_drives,
    fence,
    pointer,
    publish,
    sleep_until,
    time_now,
)
from cnc_interp.machine.realtime import RECORD, Lateness, note_lateness
from cnc_interp.run.chunk import Chunk

#: What the cycle plays.
REST, CHUNK, TAIL = 0, 1, 2
#: What happened in a period: bits of a record.
STARVED, ENDED, WAITED, REFUSED, FAILED = 1, 2, 4, 8, 16
#: Words that Python writes and the cycle reads ...
QUIT, LEAVE, HALT, START, FIRST, READ, FORGET = range(7)
#: ... and words that the cycle writes.
HALTED, STARTED, SOURCE, SERIAL, ROW, RECORDED, FORGOTTEN, WORDS = range(7, 15)
#: Columns of a descriptor: positions, velocities and count of a chunk, then of its stop tail;
#: whether the machine rests after it; and the chunk that comes next.
POSITIONS, VELOCITIES, COUNT, TAIL_COLUMNS, RESTS, NEXT, COLUMNS = 0, 1, 2, 3, 6, 7, 8
#: No chunk comes next, so far.
NONE = -1
#: After a longer stall of the computer the clock starts anew and does not catch up [ns].
LONGEST_CATCH_UP = 500_000_000
#: Records are kept so long until they are read [s]: longer than any buffer and any stop tail.
KEPT = 10.0


class Memory(NamedTuple):
    """
    What the cycle shares with the threads of Python.

    Parameters
    ----------
    control : ndarray of int, shape (WORDS,)
        Commands and state.
    chunks : ndarray of int, shape (slots, COLUMNS)
        Descriptors of chunks; that of chunk ``serial`` stands in slot ``serial % slots``.
    travel : ndarray, shape (n_axes, 2)
        Smallest and largest setpoint [m, rad].
    jump : ndarray, shape (n_axes,)
        Largest step between two setpoints [m, rad].
    setpoint, feedback : ndarray, shape (2, n_axes)
        Position and velocity, commanded and actual [m, rad, per s].
    drives : ndarray
        Memory of the drives.
    records : ndarray of int, shape (count, 4)
        Source, serial and row of the setpoint of a period, and what happened.
    measured : ndarray, shape (count, 2, n_axes)
        Feedback of the same periods [m, rad, per s].
    late : ndarray of int, shape (RECORD,)
        Histogram of the clock, see ``realtime.Lateness``.

    """

    control: IntArray
    chunks: IntArray
    travel: FloatArray
    jump: FloatArray
    setpoint: FloatArray
    feedback: FloatArray
    drives: FloatArray
    records: IntArray
    measured: FloatArray
    late: IntArray


@njit(cache=True, nogil=True)
def _choose(memory: Memory) -> int:
    """Choose what is played in this period; return what happened."""
    control, chunks = memory.control, memory.chunks
    source, serial, row = control[SOURCE], control[SERIAL], control[ROW] + 1
    events = 0
    if control[HALTED] != control[HALT]:
        control[HALTED], source = control[HALT], REST
    if source == REST and control[STARTED] != control[START]:
        control[STARTED] = control[START]
        source, serial, row = CHUNK, control[FIRST], 0
    while source != REST:
        slot = serial % len(chunks)
        if row < chunks[slot, COUNT + (TAIL_COLUMNS if source == TAIL else 0)]:
            break
        if source == TAIL:
            source = REST
            events |= ENDED
        elif control[LEAVE]:
            source, row = TAIL, 0
        elif chunks[slot, RESTS]:
            source = REST
            events |= WAITED
        elif chunks[slot, NEXT] != NONE:
            serial, row = chunks[slot, NEXT], 0
        else:
            source, row = TAIL, 0
            events |= STARVED
    control[SOURCE], control[SERIAL], control[ROW] = source, serial, row
    return events


@njit(cache=True, nogil=True)
def _take_setpoint(memory: Memory) -> bool:
    """Make the chosen row the setpoint; False where it cannot be, then the last one is held."""
    control, setpoint = memory.control, memory.setpoint
    descriptor, n = memory.chunks[control[SERIAL] % len(memory.chunks)], setpoint.shape[1]
    shift = TAIL_COLUMNS if control[SOURCE] == TAIL else 0
    shape = (descriptor[COUNT + shift], n)
    position = carray(pointer(np.uintp(descriptor[POSITIONS + shift])), shape)[control[ROW]]
    velocity = carray(pointer(np.uintp(descriptor[VELOCITIES + shift])), shape)[control[ROW]]
    for i in range(n):
        inside = memory.travel[i, 0] <= position[i] <= memory.travel[i, 1]
        near = abs(position[i] - setpoint[0, i]) <= memory.jump[i]
        if not (inside and near and abs(velocity[i]) < np.inf):
            return False
    for i in range(n):
        setpoint[0, i], setpoint[1, i] = position[i], velocity[i]
    return True


@njit(cache=True, nogil=True)
def _advance(memory: Memory, step: int) -> None:
    """Let one period pass."""
    control, records = memory.control, memory.records
    events = _choose(memory)
    source = control[SOURCE]
    if source != REST and not _take_setpoint(memory):
        events |= REFUSED
        control[SOURCE] = REST
    if control[SOURCE] == REST:
        memory.setpoint[1] = 0.0
    fault = call_drives(
        np.uintp(step), memory.drives.ctypes.data, memory.setpoint.ctypes.data,
        memory.feedback.ctypes.data, memory.setpoint.shape[1],
    )  # fmt: skip
    if fault and source != REST:
        events |= FAILED
        control[SOURCE], control[ROW] = REST, fault
    count = control[RECORDED]
    if source == REST and events == 0 and count - control[READ] >= len(records) - 1:
        return  # nobody reads, nothing moves
    slot = count % len(records)
    records[slot, 0], records[slot, 1] = source, control[SERIAL]
    records[slot, 2], records[slot, 3] = control[ROW], events
    memory.measured[slot] = memory.feedback
    fence()
    control[RECORDED] = count + 1


@njit(cache=True, nogil=True)
def _run(memory: Memory, step: int, period: int) -> None:
    """Advance at absolute deadlines, ``period`` [ns] apart, until it is told to quit."""
    control, spec = memory.control, np.zeros(2, dtype=np.int64)
    due = time_now(spec)
    while control[QUIT] == 0:
        due += period
        now = time_now(spec)
        if now < due:
            sleep_until(due, spec)
            now = time_now(spec)
        elif now - due > LONGEST_CATCH_UP:
            due = now
        if control[FORGOTTEN] != control[FORGET]:
            control[FORGOTTEN] = control[FORGET]
            memory.late[:] = 0
        note_lateness(memory.late, now - due)
        _advance(memory, step)


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def follow_ideally(_memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Let the axes be where they should be: the step in place of drives that Python feeds."""
    wanted, actual = carray(pointer(setpoint), 2 * n), carray(pointer(feedback), 2 * n)
    for i in range(2 * n):
        actual[i] = wanted[i]
    return 0


class Records(NamedTuple):
    """
    What was played in K periods.

    Parameters
    ----------
    source, serial, row, events : ndarray of int, shape (K,)
        Setpoint and what happened. The row of a FAILED record is the number of the fault.
    position, velocity : ndarray, shape (K, n_axes)
        What the drives did [m, rad, per s].

    """

    source: IntArray
    serial: IntArray
    row: IntArray
    events: IntArray
    position: FloatArray
    velocity: FloatArray

    def part(self, first: int, last: int) -> Records:
        """Return the periods from ``first`` to the one before ``last``."""
        return Records(
            self.source[first:last], self.serial[first:last], self.row[first:last],
            self.events[first:last], self.position[first:last], self.velocity[first:last],
        )  # fmt: skip


class Cycle:
    """
    The compiled cycle, as the threads of Python use it.

    Parameters
    ----------
    period : float
        Interpolation period [s].
    travel, jump : ndarray, shape (n_axes, 2), (n_axes,)
        Bounds of setpoints, see ``Memory`` [m, rad].
    slots : int
        Chunks that may wait.
    step : int
        Address of the compiled step of the drives.
    drives : ndarray
        Its memory.

    """

    def __init__(
        self,
        period: float,
        travel: FloatArray,
        jump: FloatArray,
        slots: int,
        step: int,
        drives: FloatArray,
    ):
        n, kept = len(jump), round(KEPT / period)
        self._step, self._period = step, round(period * 1e9)
        self._memory = Memory(
            control=np.zeros(WORDS, dtype=np.int64),
            chunks=np.zeros((slots, COLUMNS), dtype=np.int64),
            travel=np.ascontiguousarray(travel, dtype=float),
            jump=np.ascontiguousarray(jump, dtype=float),
            setpoint=np.zeros((2, n)),
            feedback=np.zeros((2, n)),
            drives=drives,
            records=np.zeros((kept, 4), dtype=np.int64),
            measured=np.zeros((kept, 2, n)),
            late=np.zeros(RECORD, dtype=np.int64),
        )
        self._control = self._memory.control
        self._kept: deque[tuple[int, tuple[FloatArray, ...]]] = deque()
        self._written = 0  # chunks
        self._control[QUIT] = 1
        self.run()  # compiled, or read from the cache, before it counts

    def place(self, position: FloatArray) -> None:
        """Take where the axes stand at rest as the last setpoint."""
        self._memory.setpoint[0] = position
        self._memory.feedback[0] = position

    def push(self, chunk: Chunk) -> int:
        """
        Write a chunk into the ring; return its serial number, which is never used again.

        The cycle does not find it before it is linked, or told to start with it.
        """
        serial, descriptors = self._written, self._memory.chunks
        if self._kept and serial - self._kept[0][0] >= len(descriptors):
            raise StreamError('the buffer is full; keep to the window of the stream')
        arrays: list[FloatArray] = []
        descriptor = descriptors[serial % len(descriptors)]
        for column, part in ((POSITIONS, chunk.samples), (TAIL_COLUMNS, chunk.tail)):
            both = [np.ascontiguousarray(rows) for rows in (part.position, part.velocity)]
            arrays += both
            descriptor[column : column + 3] = *(rows.ctypes.data for rows in both), len(part)
        descriptor[RESTS], descriptor[NEXT] = chunk.rests, NONE
        self._kept.append((serial, tuple(arrays)))
        self._written = serial + 1
        return serial

    def link(self, after: int, serial: int) -> None:
        """Let a chunk come after one after which none came so far."""
        descriptors = self._memory.chunks
        publish(descriptors[after % len(descriptors)], NEXT, serial)

    def relink(self, after: int, serial: int) -> bool:
        """
        Let one chunk come after another, in place of those between; False where it is too late.

        The cycle reads the link when it leaves a chunk. It is certain to take the new one where it
        had not begun the chunk after the link was written.
        """
        control = self._control
        if control[SOURCE] != REST and control[SERIAL] >= after:
            return False
        self.link(after, serial)
        while control[SOURCE] == CHUNK and control[SERIAL] == after:
            time.sleep(1e-9 * self._period)  # it began that chunk meanwhile: see what it took
        return bool(control[SOURCE] == REST or not after < control[SERIAL] < serial)

    def start(self, serial: int) -> None:
        """Play from a chunk on, from rest."""
        self._control[LEAVE], self._control[FIRST] = 0, serial
        publish(self._control, START, self._control[START] + 1)

    def leave(self) -> None:
        """Take the stop tail of the chunk that is being played."""
        publish(self._control, LEAVE, 1)

    def halt(self) -> None:
        """Tell the drives no further setpoint."""
        publish(self._control, HALT, self._control[HALT] + 1)

    def step(self) -> None:
        """Let one period pass without the clock."""
        _advance(self._memory, self._step)

    def run(self) -> None:
        """Let periods pass by the clock, in the calling thread, until ``quit`` is called."""
        _run(self._memory, self._step, self._period)

    def quit(self, quits: bool = True) -> None:
        """End ``run``, or let it begin."""
        publish(self._control, QUIT, int(quits))

    def read(self) -> Records:
        """Return what was played since the last call."""
        memory, control = self._memory, self._control
        first, last = int(control[READ]), int(control[RECORDED])
        slots = np.arange(first, last) % len(memory.records)
        records, measured = memory.records[slots], memory.measured[slots]
        publish(control, READ, last)
        played = records[records[:, 0] != REST, 1]
        while len(played) and self._kept and self._kept[0][0] < played[-1]:
            self._kept.popleft()
        source, serial, row, events = records.T
        return Records(source, serial, row, events, measured[:, 0], measured[:, 1])

    def lateness(self) -> Lateness:
        """Return how late the clock woke up."""
        return Lateness(self._memory.late.copy(), self._period * 1e-9)

    def forget_lateness(self) -> None:
        """Start the figures of the clock anew."""
        self._control[FORGET] += 1
