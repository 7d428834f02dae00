"""The machine's buffer: chunks of setpoints that wait to be played."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine.switching import ActsOfChunk
from cnc_interp.run.run_state import RunId
from cnc_interp.run.setpoints import Chunk, Wait


@dataclass(frozen=True)
class BufferedChunk:
    serial: int  #: Serial number of the chunk in the cycle.
    run_id: RunId  #: Plan to which it belongs.
    first: int  #: Number of its first setpoint, counted since the last stop.
    chunk: Chunk  #: Its setpoints and stop tail, and how the run continues.
    acts: ActsOfChunk  #: Functions that act during the chunk.

    def head(self, count: int, serial: int, acts: ActsOfChunk) -> BufferedChunk:
        """Return the first ``count`` setpoints as a chunk with another serial number."""
        return BufferedChunk(serial, self.run_id, self.first, self.chunk.head(count), acts)

    @property
    def after(self) -> int:
        return self.first + len(self.chunk.samples)


class Buffer:
    def __init__(self, stands: FloatArray):
        self.chunks: deque[BufferedChunk] = deque()
        self.clear(stands)

    def clear(self, stands: FloatArray) -> None:
        self.chunks.clear()
        self.count = 0  # setpoints
        self.next_number = 0  # of the next setpoint to be received
        self.rests = 0  # chunks after which the machine rests
        self.newest: FloatArray = np.tile(stands, (3, 1))  # the last three setpoints

    def push(self, chunk: BufferedChunk) -> None:
        self.chunks.append(chunk)
        self.count += len(chunk.chunk.samples)
        self.rests += chunk.chunk.wait is not Wait.NOTHING
        self.next_number = chunk.after
        self.newest = np.concatenate([self.newest, chunk.chunk.samples.position])[-3:]

    def cut(self, number: int, newest: FloatArray) -> None:
        """Drop the chunks that end after setpoint ``number``; ``newest``: the three before it."""
        while self.chunks and self.chunks[-1].after > number:
            chunk = self.chunks.pop()
            self.count -= len(chunk.chunk.samples)
            self.rests -= chunk.chunk.wait is not Wait.NOTHING
        self.newest = newest

    def pop(self) -> BufferedChunk:
        chunk = self.chunks.popleft()
        self.count -= len(chunk.chunk.samples)
        self.rests -= chunk.chunk.wait is not Wait.NOTHING
        return chunk
