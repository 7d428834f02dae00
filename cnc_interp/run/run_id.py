"""Which run, which attempt at it, and which plan of that attempt."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RunId:
    program_id: str = ''  #: The run, the same string from its start to its end; empty for no run.
    attempt: int = 0  #: How often the run was begun again after the loss of a node.
    plan: int = 0  #: Number of the plan in the attempt. Blocks and segments always have plan 0.

    def __bool__(self) -> bool:
        return bool(self.program_id)

    def __str__(self) -> str:
        attempt = f' (attempt {self.attempt})' if self.attempt else ''
        plan = f', plan {self.plan}' if self.plan else ''
        return f'{self.program_id}{attempt}{plan}'

    def same_attempt(self, other: RunId) -> bool:
        """Tell whether both belong to one attempt of one run; their plans may differ."""
        return (self.program_id, self.attempt) == (other.program_id, other.attempt)

    def continues(self, other: RunId) -> bool:
        """Tell whether this is a later attempt at the other's run, or a later plan of it."""
        later = (self.attempt, self.plan) > (other.attempt, other.plan)
        return self.program_id == other.program_id and later

    def next_attempt(self) -> RunId:
        return RunId(self.program_id, self.attempt + 1)


NO_RUN = RunId()
