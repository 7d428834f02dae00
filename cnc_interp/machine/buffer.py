"""The machine's buffer: chunks of setpoints that wait for their time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.interpolator import Setpoints


@dataclass(frozen=True)
class Row:
    """One setpoint in the buffer."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    block: int
    line: int
    s: float


@dataclass(frozen=True)
class BufferedChunk:
    """A chunk in the buffer, its stop tail not unpacked."""

    rows: list[Row]
    tail: Setpoints
    tail_lines: list[int]
    wait: Wait

    @property
    def ends_approach(self) -> bool:
        """Tell whether the machine rests at the start pose after it; the program comes next."""
        return not len(self.tail) and self.rows[-1].block == 0

    def tail_rows(self) -> list[Row]:
        """Unpack the stop after it."""
        return rows_of(self.tail, self.tail_lines)


def rows_of(samples: Setpoints, lines: list[int]) -> list[Row]:
    """Unpack setpoints."""
    columns = (samples.block.tolist(), lines, samples.s.tolist())
    motion = (samples.position, samples.velocity, samples.acceleration, samples.jerk)
    return list(map(Row, *motion, *columns))


class Buffer:
    """
    Chunks in their order.

    Parameters
    ----------
    stands : ndarray, shape (n_axes,)
        Setpoint at which the machine rests while it is empty [m, rad].

    """

    def __init__(self, stands: FloatArray):
        self.chunks: deque[BufferedChunk] = deque()
        self.clear(stands)

    def clear(self, stands: FloatArray) -> None:
        """Forget all chunks; the next one begins where the machine stands."""
        self.chunks.clear()
        self.count = 0  # setpoints
        self.rests = 0  # chunks after which the machine rests
        self.newest: FloatArray = np.tile(stands, (3, 1))  # the last three setpoints

    def push(self, chunk: Chunk, lines: list[int], tail_lines: list[int]) -> None:
        """Take a chunk."""
        rows = rows_of(chunk.samples, lines)
        self.chunks.append(BufferedChunk(rows, chunk.tail, tail_lines, chunk.wait))
        self.count += len(rows)
        self.rests += chunk.wait is not Wait.NOTHING
        self.newest = np.concatenate([self.newest, chunk.samples.position])[-3:]

    def pop(self) -> BufferedChunk:
        """Hand out the next chunk."""
        chunk = self.chunks.popleft()
        self.count -= len(chunk.rows)
        self.rests -= chunk.wait is not Wait.NOTHING
        return chunk
