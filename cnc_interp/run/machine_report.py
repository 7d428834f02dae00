"""What the sending side of a run must know of the machine."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from cnc_interp.core.arrays import FloatArray
from cnc_interp.run.run_id import RunId


class Motion(Enum):
    """Whether the machine moves, and where it rests."""

    MOVING = 'moves'
    STOPPING = 'stops because of a fault or an emergency stop'
    INACTIVE = 'rests, the drives are off'
    IDLE = 'rests without a program'
    HELD = 'rests on the path until cycle_start'
    STARVED = 'rests on the path for want of setpoints'
    FAULT = 'rests until reset'


@dataclass(frozen=True)
class MachineReport:
    """
    What the machine said last.

    Parameters
    ----------
    run_id : RunId
        The run that it executes or has executed last.
    motion : Motion
        Whether it moves.
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
    time : float
        Time of the report by the machine's clock [s].
    message : str
        The reason for its state, for people.

    """

    run_id: RunId
    motion: Motion
    plan_over: bool
    start_wanted: bool
    completed: bool
    path_position: float
    stands: FloatArray
    time: float
    message: str

    @property
    def moves(self) -> bool:
        """Tell whether the axes move, or are about to."""
        starts = self.motion is Motion.HELD and self.start_wanted and not self.plan_over
        return starts or self.motion in (Motion.MOVING, Motion.STOPPING)

    @property
    def rests_on_path(self) -> bool:
        """Tell whether the machine rests on the path and can go on from there."""
        return self.motion in (Motion.HELD, Motion.STARVED)

    @property
    def is_free(self) -> bool:
        """Tell whether a new program may begin."""
        return self.motion in (Motion.IDLE, Motion.STARVED)

    def takes(self, run_id: RunId) -> bool:
        """Tell whether the machine would take the first plan of a run."""
        if self.motion is Motion.HELD:
            # With cycle_start pressed and enough of the old plan it would have left the hold.
            return run_id.attempt > 0 and (self.plan_over or self.start_wanted)
        # A machine whose drives are off refuses the plan itself.
        return self.is_free or self.motion is Motion.INACTIVE

    def left(self, run_id: RunId) -> bool:
        """Tell whether the machine has left a plan by its stop tail and rests on the path."""
        return self.run_id == run_id and self.plan_over and self.rests_on_path
