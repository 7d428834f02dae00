"""What the sender of a run must know about the machine."""

from __future__ import annotations

from dataclasses import dataclass

from cnc_interp.core.arrays import FloatArray
from cnc_interp.run.run_id import RunId
from cnc_interp.run.run_state import State


@dataclass(frozen=True)
class MachineReport:
    """The last report of the machine."""

    run_id: RunId  #: The run that it executes or has executed last.
    state: State  #: What it is doing.
    plan_over: bool  #: It left the plan by a stop tail and rests; another plan must follow.
    #: cycle_start was asked for, and there are not enough setpoints to start with.
    start_wanted: bool
    completed: bool  #: The run was executed to its end.
    path_position: float  #: Path length executed [m].
    stands: FloatArray  #: (n_axes,): Commanded axis positions [m, rad].
    time: float  #: Time of the report by the machine's clock [s].
    message: str  #: The reason for its state, for people.
    must_home: tuple[str, ...] = ()  #: Axes that must be homed before a program may start.
    #: The axes were moved away from a hold by hand, and are not back on the path yet.
    away: bool = False

    @property
    def rests_on_path(self) -> bool:
        """Tell whether the machine rests on the path after a stop that was not planned."""
        return self.state in (State.HELD, State.STARVED)

    @property
    def is_free(self) -> bool:
        """Tell whether a new program may begin."""
        return self.state is State.IDLE or self._lacks_plan

    @property
    def _lacks_plan(self) -> bool:
        """Tell whether the machine has come to rest because setpoints were late."""
        return self.state is State.STARVED and self.plan_over

    @property
    def moves(self) -> bool:
        """Tell whether the axes move, or are about to."""
        if self.state is State.HELD:
            return self.start_wanted and not self.plan_over
        rests = self.is_free or self.state in (State.INACTIVE, State.FAULT)
        return not rests

    def takes(self, run_id: RunId) -> bool:
        """Tell whether the machine would take the first plan of a run."""
        if self.state is State.HELD:
            # With cycle_start and enough setpoints of the old plan it would have left the hold.
            return run_id.attempt > 0 and (self.plan_over or self.start_wanted)
        waits = self.state in (State.FILLING, State.PAUSED, State.STARVED)
        if waits and run_id.attempt > 0:  # a node was lost meanwhile
            return True
        # A machine whose drives are off refuses the plan itself.
        return self.is_free or self.state is State.INACTIVE

    def left(self, run_id: RunId) -> bool:
        """Tell whether the machine has left a plan by its stop tail and rests on the path."""
        return self.run_id == run_id and self.plan_over and self.rests_on_path
