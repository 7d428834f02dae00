"""Chunk: consecutive setpoints and their stop tail; the arrow from stream to machine."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from enum import IntEnum

from cnc_interp.run.interpolator import Setpoints


class Wait(IntEnum):
    """What the machine does at rest after the last setpoint of a chunk."""

    NOTHING = 0  # goes on with the next chunk
    OVERRIDE = 1  # rests while the feed override is 0
    PROGRAM_STOP = 2  # rests until cycle_start (M0)
    END = 3  # the program ends here
    OPTIONAL_STOP = 4  # rests until cycle_start (M1)
    SINGLE_BLOCK = 5  # rests until cycle_start
    APPROACH = 6  # rests until cycle_start; the way to the path follows


@dataclass(frozen=True)
class Chunk:
    """Consecutive setpoints and the stop after them."""

    samples: Setpoints  #: The setpoints to be executed.
    #: From the last of them to rest on the path; empty where that is at rest already.
    tail: Setpoints
    wait: Wait  #: What the machine waits for after the last one.

    @property
    def ends_approach(self) -> bool:
        """Tell whether the machine rests at the start pose after the chunk, before the program."""
        return not len(self.tail) and self.samples.block[-1] == 0

    @property
    def rests(self) -> bool:
        """Tell whether the machine rests after the chunk until an operator continues."""
        return self.wait is not Wait.NOTHING or self.ends_approach

    def head(self, count: int) -> Chunk:
        """Return a chunk of the first setpoints; its stop tail is the others and the old tail."""
        rest = self.samples[count:]
        tail = Setpoints.concatenate([rest, self.tail])
        return Chunk(self.samples[:count], tail, Wait.NOTHING)


class ChunkCutter:
    """
    Cut the setpoints of one plan into chunks.

    The tail of a chunk follows the plan to the next setpoint with a known stop, then that stop.
    Setpoints after the last known stop are kept until a further stop is known.
    """

    def __init__(self, size: int, number: int):
        self._size = size
        self._first = self.next_number = number
        self._kept: deque[Setpoints] = deque()  # from setpoint _first on
        self._stops: deque[tuple[int, Setpoints | None]] = deque()
        self._waits: dict[int, Wait] = {}

    def take(self, samples: Setpoints) -> None:
        """Add further setpoints."""
        if len(samples):
            self._kept.append(samples)
            self.next_number += len(samples)

    def add_stop(self, number: int, stop: Setpoints) -> None:
        """Store the stop that begins after a setpoint."""
        self._stops.append((number, stop))

    def end_leg(self, wait: Wait) -> None:
        """Record that the last setpoint is at rest, and what the machine waits for there."""
        self._stops.append((self.next_number - 1, None))
        self._waits[self.next_number - 1] = wait

    def cut(self) -> list[Chunk]:
        """Return the chunks that are complete: those whose tail is known."""
        if not self._stops:
            return []
        kept = Setpoints.concatenate(list(self._kept))
        chunks: list[Chunk] = []
        base = begin = self._first
        while self._stops:
            end = begin + self._size
            end = min(end, min((n + 1 for n in self._waits if n >= begin), default=end))
            while self._stops and self._stops[0][0] < end - 1:
                self._stops.popleft()
            if not self._stops:
                break
            number, stop = self._stops[0]
            tail = kept[end - base : number + 1 - base]
            if stop is not None:
                tail = Setpoints.concatenate([tail, stop])
            wait = self._waits.pop(end - 1, Wait.NOTHING)
            chunks.append(Chunk(kept[begin - base : end - base], tail, wait))
            begin = end
        self._first = begin
        rest = kept[begin - base :]
        self._kept = deque([rest] if len(rest) else [])
        return chunks
