"""The machine's buffer: chunks of setpoints that wait for their time."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.run.chunk import Chunk, Wait, part_of
from cnc_interp.run.interpolator import Setpoints


@dataclass(frozen=True)
class Rows:
    """Consecutive setpoints and the source line of each."""

    samples: Setpoints
    lines: list[int]

    def __len__(self) -> int:
        """Count them."""
        return len(self.samples)

    def part(self, first: int, last: int) -> Rows:
        """Return the rows from ``first`` to the one before ``last``."""
        return Rows(part_of(self.samples, first, last), self.lines[first:last])


@dataclass(frozen=True)
class BufferedChunk:
    """
    A chunk in the buffer.

    Parameters
    ----------
    serial : int
        Its number in the cycle.
    chunk : Chunk
        Setpoints, stop tail, and what comes after.
    rows, tail : Rows
        Setpoints and stop tail with their lines.

    """

    serial: int
    chunk: Chunk
    rows: Rows
    tail: Rows


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

    def push(self, chunk: BufferedChunk) -> None:
        """Take a chunk."""
        self.chunks.append(chunk)
        self.count += len(chunk.rows)
        self.rests += chunk.chunk.wait is not Wait.NOTHING
        self.newest = np.concatenate([self.newest, chunk.rows.samples.position])[-3:]

    def pop(self) -> BufferedChunk:
        """Hand out the next chunk."""
        chunk = self.chunks.popleft()
        self.count -= len(chunk.rows)
        self.rests -= chunk.chunk.wait is not Wait.NOTHING
        return chunk
