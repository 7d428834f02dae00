"""What the planning of a run must know of the machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from cnc_interp.core.arrays import FloatArray
from cnc_interp.run.run_id import RunId


class Resting(Enum):
    """Whether the machine rests, and where."""

    MOVING = 'moves or is stopped'
    IDLE = 'rests without a program'
    HELD = 'rests on the path until cycle_start'
    STARVED = 'rests on the path for want of setpoints'


@dataclass(frozen=True)
class MachineReport:
    """
    What the machine said last.

    Parameters
    ----------
    run_id : RunId
        The run that it executes or has executed last.
    resting : Resting
        Whether it rests.
    plan_over : bool
        It left the plan by a stop tail and rests; another plan must follow.
    start_wanted : bool
        cycle_start was asked for, and there are not enough setpoints to start with.
    completed : bool
        The run was executed to its end.
    path_position : float
        Path length executed [m].
    stands : ndarray, shape (n_axes,)
        Commanded axis positions [m, rad].

    """

    run_id: RunId
    resting: Resting
    plan_over: bool
    start_wanted: bool
    completed: bool
    path_position: float
    stands: FloatArray

    def takes(self, run_id: RunId) -> bool:
        """Tell whether the machine would take the first plan of a run."""
        if self.resting is Resting.HELD:
            # With cycle_start pressed and enough of the old plan it would have left the hold.
            return run_id.attempt > 0 and (self.plan_over or self.start_wanted)
        return self.resting is Resting.IDLE or (self.resting is Resting.STARVED and self.plan_over)

    def left(self, run_id: RunId) -> bool:
        """Tell whether the machine has left a plan by its stop tail and rests on the path."""
        rests = self.resting in (Resting.HELD, Resting.STARVED)
        return self.run_id == run_id and self.plan_over and rests
