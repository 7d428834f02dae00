"""The cycle of the machine: one compiled call that runs without the interpreter's lock.

It wakes at absolute deadlines, takes one setpoint, steps the drives and records the result. After
a hold or an emergency stop, or if the next chunk is late, it plays the stop tail of the current
chunk. So stopping does not depend on any Python thread.

A ring of descriptors holds the addresses of each chunk's arrays; ``Cycle`` keeps the arrays alive.
A complete chunk is linked to its predecessor. A new plan joins when this link is changed. Played
setpoints are recorded in a second ring. Each ring has one writer and one reader.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray, StreamError
from cnc_interp.core.native import publish
from cnc_interp.machine import cycle_kernels as kernel
from cnc_interp.machine.realtime import RECORD, Lateness, ask_for_priority
from cnc_interp.machine.spindle import Spindle
from cnc_interp.machine_model.signals import Signal
from cnc_interp.run.setpoints import Chunk

NO_SWITCHES, NO_SIGNALS = np.zeros((0, 3)), np.zeros(0)
KEPT = 10.0  #: Time that records are kept [s]; longer than any buffer and stop tail.
STANDS = 0.5  #: Longest wait for a period of the clock; then it counts as stopped [s].


class Records(NamedTuple):
    #: (K,): Setpoint and events of each period. ``row`` of a FAILED record is the fault number.
    source: IntArray
    serial: IntArray
    row: IntArray
    events: IntArray
    #: (K, n_axes): Actual position and velocity of the drives [m, rad, per s].
    position: FloatArray
    velocity: FloatArray
    answered: FloatArray  #: (K, n_axes): Setpoint that they follow; with a FIFO an earlier one.
    setpoint: FloatArray  #: (K, n_axes): Setpoint that was played [m, rad].
    angle: FloatArray  #: (K,): Angle of the spindle in each period [rev].

    def part(self, first: int, last: int) -> Records:
        return Records(*(column[first:last] for column in self))  # type: ignore[arg-type]


def speed_outputs(outputs: Sequence[Signal]) -> kernel.SpeedOutputs:
    """Return those outputs that follow the speed of the tip, as arrays for the cycle."""
    found = [(k, each) for k, each in enumerate(outputs) if each.speeds]
    points = max((len(each.speeds) for _, each in found), default=1)
    rows = [
        [row + row[-1:] * (points - len(row)) for row in (each.speeds, each.shares)]
        for _, each in found
    ]
    return kernel.SpeedOutputs(
        np.array([k for k, _ in found], dtype=np.int64),
        np.array([each.only_with for _, each in found], dtype=np.int64),
        np.array(rows, dtype=float).reshape(-1, 2, points),
    )


class Cycle:
    """Python's interface to the compiled cycle; ``travel`` and ``jump`` as in ``Memory``."""

    def __init__(
        self,
        period: float,
        travel: FloatArray,
        jump: FloatArray,
        slots: int,
        step: int,
        drives: FloatArray,
        outputs: FloatArray = NO_SIGNALS,
        inputs: FloatArray = NO_SIGNALS,
        probe: tuple[int, ...] = (),
        together: float = 0.0,
        spindle: Spindle | None = None,
        by_speed: kernel.SpeedOutputs | None = None,
        switches: Sequence[tuple[int, int, int]] = (),
    ):
        n, kept = len(jump), round(KEPT / period)
        self._step, self._period = step, round(period * 1e9)
        self._together = max(1, round(together / period))  # periods in which calm drives wait
        self._memory = kernel.Memory(
            control=np.zeros(kernel.WORDS, dtype=np.int64),
            chunks=np.zeros((slots, kernel.COLUMNS), dtype=np.int64),
            travel=np.ascontiguousarray(travel, dtype=float),
            jump=np.ascontiguousarray(jump, dtype=float),
            setpoint=np.zeros((2, n)),
            feedback=np.zeros((4, n)),
            drives=drives,
            outputs=outputs,
            inputs=inputs,
            probe=np.array(probe, dtype=np.int64),
            stands=np.zeros(n),
            spindle=spindle or Spindle.without(outputs),
            by_speed=by_speed or speed_outputs(()),
            switches=np.array([(*row, 1) for row in switches], dtype=np.int64).reshape(-1, 4),
            records=np.zeros((kept, 4), dtype=np.int64),
            measured=np.zeros((kept, 5, n)),
            late=np.zeros(RECORD, dtype=np.int64),
        )
        self._control = self._memory.control
        self._kept: deque[tuple[int, tuple[FloatArray, ...]]] = deque()
        self._written = 0  # chunks
        self._control[kernel.QUIT] = 1
        self.run()  # compiles the cycle, or loads it from the cache, before motion

    def place(self, position: FloatArray) -> None:
        self._memory.setpoint[0] = position
        self._memory.feedback[0] = self._memory.feedback[2] = position

    def push(
        self,
        chunk: Chunk,
        switches: tuple[FloatArray, FloatArray] = (NO_SWITCHES, NO_SWITCHES),
        speeds: Sequence[FloatArray] = (),
    ) -> int:
        """Write a chunk into the ring; return its serial number. It plays only once it is linked.

        ``switches``: output changes of the chunk and of its stop tail: rows (k, 3) of setpoint,
        output and value. ``speeds``: tip speeds of both, if an output follows them [m/s].
        """
        serial, descriptors = self._written, self._memory.chunks
        if self._kept and serial - self._kept[0][0] >= len(descriptors):
            raise StreamError('the buffer is full; keep to the window of the stream')
        arrays: list[FloatArray] = []
        descriptor = descriptors[serial % len(descriptors)]
        columns, parts = (kernel.POSITIONS, kernel.TAIL_COLUMNS), (chunk.samples, chunk.tail)
        for column, part, acts in zip(columns, parts, switches, strict=True):
            both = [np.ascontiguousarray(rows) for rows in (part.position, part.velocity)]
            arrays += [*both, acts]
            descriptor[column : column + 3] = *(rows.ctypes.data for rows in both), len(part)
            descriptor[column + kernel.SWITCHES] = acts.ctypes.data
            descriptor[column + kernel.SWITCHES + 1] = len(acts)
        descriptor[[kernel.SPEEDS, kernel.TAIL_SPEEDS]] = 0
        for column, each in zip((kernel.SPEEDS, kernel.TAIL_SPEEDS), speeds, strict=False):
            arrays.append(each)
            descriptor[column] = each.ctypes.data
        descriptor[kernel.RESTS], descriptor[kernel.NEXT] = chunk.rests, kernel.NONE
        self._kept.append((serial, tuple(arrays)))
        self._written = serial + 1
        return serial

    def link(self, after: int, serial: int) -> None:
        descriptors = self._memory.chunks
        publish(descriptors[after % len(descriptors)], kernel.NEXT, serial)

    def relink(self, after: int, serial: int) -> bool:
        """Link chunk ``serial`` behind chunk ``after``; return False if it is too late.

        The chunks between them are skipped. While the cycle plays the last row of ``after``, only
        its next period shows which link it has read. Raises StreamError if the clock has stopped.
        """
        control = self._control
        if control[kernel.SOURCE] != kernel.REST and control[kernel.SERIAL] >= after:
            return False
        self.link(after, serial)
        last = self._memory.chunks[after % len(self._memory.chunks)][kernel.COUNT] - 1
        deadline = time.monotonic() + STANDS
        while (
            control[kernel.SOURCE] == kernel.CHUNK
            and control[kernel.SERIAL] == after
            and control[kernel.ROW] >= last
        ):
            if time.monotonic() > deadline:
                self.halt()
                raise StreamError('the machine clock has stopped; activate machine_node again')
            time.sleep(1e-9 * self._period)
        return bool(
            control[kernel.SOURCE] == kernel.REST or not after < control[kernel.SERIAL] < serial
        )

    def start(self, serial: int) -> None:
        self._control[kernel.LEAVE], self._control[kernel.FIRST] = 0, serial
        publish(self._control, kernel.START, self._control[kernel.START] + 1)

    def leave(self) -> None:
        publish(self._control, kernel.LEAVE, 1)

    def mute(self, mutes: bool) -> None:
        """Keep setpoints from switching outputs, or let them switch outputs again."""
        publish(self._control, kernel.MUTE, int(mutes))

    def watch_limits(self, axes: Sequence[int], watched: bool) -> None:
        """Enable or disable the limit switches of axes; homing disables them."""
        rows = self._memory.switches
        rows[np.isin(rows[:, 1], axes), 3] = watched

    def halt(self) -> None:
        publish(self._control, kernel.HALT, self._control[kernel.HALT] + 1)

    def step(self) -> None:
        kernel.advance(self._memory, self._step)

    def run(self) -> None:
        """Run the cycle by the clock, in the calling thread, until ``quit`` is called."""
        kernel.run_periods(self._memory, self._step, self._period, self._together)

    def quit(self, quits: bool = True) -> None:
        publish(self._control, kernel.QUIT, int(quits))

    def read(self) -> Records:
        memory, control = self._memory, self._control
        first, last = int(control[kernel.READ]), int(control[kernel.RECORDED])
        at, kept = first % len(memory.records), len(memory.records)
        slots: slice | IntArray = slice(at, at + last - first)
        if at + last - first > kept:
            slots = np.arange(first, last) % kept
        records, measured = memory.records[slots].copy(), memory.measured[slots].copy()
        publish(control, kernel.READ, last)
        played = records[records[:, 0] != kernel.REST, 1]
        while len(played) and self._kept and self._kept[0][0] < played[-1]:
            self._kept.popleft()
        source, serial, row, events = records.T
        x, v, answered, setpoint, angle = measured.transpose(1, 0, 2)
        rows = x, v, answered, setpoint, angle[:, 0]
        return Records(source, serial, row, events, *rows)

    @property
    def follows(self) -> bool:
        """Whether the axes move in step with the spindle."""
        return bool(self._control[kernel.SOURCE] == kernel.FOLLOW)

    def has_news(self, count: int) -> bool:
        """Return whether no chunk is playing, or at least ``count`` records are unread."""
        control = self._control
        return bool(
            control[kernel.SOURCE] != kernel.CHUNK
            or control[kernel.RECORDED] - control[kernel.READ] >= count
        )

    def lateness(self) -> Lateness:
        return Lateness(self._memory.late.copy())

    def forget_lateness(self) -> None:
        self._control[kernel.FORGET] += 1


class MachineClock:
    """Runs the cycle in its own thread, which never waits for the Python interpreter."""

    def __init__(self, cycle: Cycle, priority: int):
        self._cycle, self._priority = cycle, priority
        self._thread: threading.Thread | None = None
        self.scheduling = ''  #: Text: scheduling of the thread; empty before the start.

    def start(self) -> None:
        self._cycle.quit(False)
        self._thread = threading.Thread(target=self._run, name='drives', daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._cycle.quit()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _run(self) -> None:
        self.scheduling = ask_for_priority(self._priority)
        self._cycle.run()
