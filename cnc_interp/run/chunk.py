"""Chunk: consecutive setpoints and their stop tail; the arrow from stream to machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from cnc_interp.run.setpoints import Setpoints


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
