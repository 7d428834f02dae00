"""The phases of a run on the sending side, and how it ends: one table."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

from cnc_interp.core.errors import Refusal


class Phase(Enum):
    QUEUED = 'waits for the programs before it'
    CHECKING = 'is read and checked'
    WAITING = 'waits until all nodes answer and the machine rests'
    OFFERED = 'blocks are sent; look-ahead and planner have not taken the run yet'
    STREAMING = 'blocks are sent and executed'
    LOST = 'a node has forgotten the run; cycle_start is needed'
    ENDED = 'has its result'


class PhaseChange(Enum):
    TURN = 'the programs before it have ended'
    CHECKED = 'it is known to run'
    STALE = 'offsets or tools were changed after the check'
    START = 'all nodes answer and the machine rests'
    TAKEN = 'look-ahead and planner are on the run'
    LOSE = 'a node was restarted'
    BEGIN_AGAIN = 'the program is sent once more'
    READ_ON = 'a probe has answered, what follows is read'
    END = 'there is a result'


P, S = Phase, PhaseChange
TABLE: dict[tuple[Phase, PhaseChange], Phase] = {
    (P.QUEUED, S.TURN): P.CHECKING,
    (P.CHECKING, S.CHECKED): P.WAITING,
    (P.WAITING, S.STALE): P.CHECKING,
    (P.WAITING, S.START): P.OFFERED,
    (P.OFFERED, S.TAKEN): P.STREAMING,
    (P.OFFERED, S.LOSE): P.LOST,
    (P.STREAMING, S.LOSE): P.LOST,
    (P.LOST, S.LOSE): P.LOST,
    (P.LOST, S.BEGIN_AGAIN): P.OFFERED,
    (P.OFFERED, S.READ_ON): P.CHECKING,
    (P.STREAMING, S.READ_ON): P.CHECKING,
    **{(phase, S.END): P.ENDED for phase in P},
}
SENDING = (Phase.OFFERED, Phase.STREAMING, Phase.LOST)  #: Phases in which blocks are sent.


class Code(IntEnum):
    """How a run ended; the constants of the action ``RunProgram``."""

    SUCCEEDED = 0
    BAD_PROGRAM = 1
    REFUSED = 2
    STREAM_LOST = 3
    STOPPED = 4
    CANCELED = 5
    BUSY = 6
    NOT_STARTED = 7


@dataclass(frozen=True)
class Outcome:
    code: Code  #: For programs.
    message: str  #: What happened and what to do, for people.


def refused(kind: Refusal, reason: str, moved: bool) -> Outcome:
    """Return the outcome of a run that a node has refused, after it has moved or not."""
    if kind is Refusal.BAD_PATH:
        return Outcome(Code.REFUSED, reason)
    stopped = moved or kind in (Refusal.GIVEN_UP, Refusal.MACHINE_FAULT)
    return Outcome(Code.STOPPED if stopped else Code.REFUSED, reason)
