"""Sampled setpoints and the stops known among them -> chunks, each with its stop tail."""

from __future__ import annotations

from collections import deque

from cnc_interp.run.chunk import Chunk, Wait, part_of
from cnc_interp.run.interpolator import Setpoints


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
            tail = part_of(kept, end - base, number + 1 - base)
            if stop is not None:
                tail = Setpoints.concatenate([tail, stop])
            wait = self._waits.pop(end - 1, Wait.NOTHING)
            chunks.append(Chunk(part_of(kept, begin - base, end - base), tail, wait))
            begin = end
        self._first = begin
        rest = part_of(kept, begin - base, len(kept))
        self._kept = deque([rest] if len(rest) else [])
        return chunks
