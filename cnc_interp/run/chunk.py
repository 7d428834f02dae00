"""Chunk: consecutive setpoints with the stop behind them (the arrow from stream to machine)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum

from cnc_interp.run.interpolator import Setpoints


class Wait(IntEnum):
    """What the machine does at rest behind the last setpoint of a chunk."""

    NOTHING = 0  # goes on with the next chunk
    OVERRIDE = 1  # rests while the feed override is 0
    CYCLE_START = 2  # rests until cycle_start: single block, M0, M1
    END = 3  # the program ends here


@dataclass(frozen=True)
class Chunk:
    """
    Consecutive setpoints and the stop behind them.

    Parameters
    ----------
    samples : Setpoints
        What is to be executed.
    tail : Setpoints
        From the last of them to rest on the path; empty when that is at rest already.
    wait : Wait
        What comes behind the last one.

    """

    samples: Setpoints
    tail: Setpoints
    wait: Wait


def part_of(samples: Setpoints, first: int, last: int) -> Setpoints:
    """Take consecutive setpoints."""
    return Setpoints(*(getattr(samples, field.name)[first:last] for field in fields(Setpoints)))
