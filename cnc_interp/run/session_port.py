"""The border of a planning session: what it asks of the node around it, and what it gets."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import Refusal
from cnc_interp.run.chunk import Chunk, Wait
from cnc_interp.run.motion_plan import OperatorSettings
from cnc_interp.run.run_id import NO_RUN, RunId
from cnc_interp.run.run_planner import RunPlanner
from cnc_interp.smoothing.segments import PathSegments


class ChunkSender(Protocol):
    """The sender of the setpoints, as far as planning depends on it."""

    sent: int
    """Number after the last setpoint that was sent."""

    next_number: int
    """Number after the last setpoint that was queued."""

    @property
    def unsent(self) -> int:
        """Setpoints queued but not sent."""

    def begin(self, run_id: RunId) -> None:
        """Start with setpoint 0 of a plan; forget what is queued."""

    def put(self, item: Chunk, count: int = 1) -> None:
        """Queue a chunk of so many setpoints."""


class SessionPort(Protocol):
    """What a planning session asks of the node around it."""

    sender: ChunkSender

    def make_planner(
        self, first: Any, stands: FloatArray, continue_at: float, settings: OperatorSettings
    ) -> RunPlanner:
        """Make the planner of the run that begins with a segment message; see RunPlanner."""

    def read(self, segments: list[Any]) -> tuple[PathSegments, dict[int, Wait]]:
        """Read segment messages; returns also the blocks after which cycle_start is waited for."""

    def join(self, run_id: RunId, first: int) -> None:
        """Send a plan that joins the plan being sent, from a number on."""

    def take_back(self) -> None:
        """Continue with the plan before the one that was to join."""

    def consumed(self, count: int) -> None:
        """Open the window of the segments."""

    def refuse(self, kind: Refusal, reason: str) -> None:
        """Inform the sender of the segments that the run is over."""


@dataclass(frozen=True)
class Received:
    """What the machine reported about the setpoints it receives."""

    run_id: RunId = NO_RUN  #: The plan that it receives.
    executed: float = -math.inf  #: Number of the next setpoint that it executes, by now.
    turned_away: bool = False  #: The plan sent last was to join where the machine has passed.


@dataclass(frozen=True)
class Task:
    """A task, and the function that receives its result."""

    work: Callable[[], Any]
    then: Callable[[Any, float], None]
