"""Goals that wait while a program runs: each starts when the one before it has ended."""

import time
from collections import deque
from typing import Any, NamedTuple

from cnc_interp_msgs.action import RunProgram

from cnc_interp.nodes.node_main import end_goal
from cnc_interp.nodes.program_run import ProgramRun
from cnc_interp.run.run_phase import Code, Outcome

MOST = 16  #: Largest number of programs that may wait. Each one uses memory.
FEEDBACK = 0.5  #: Time between feedbacks to a goal that waits [s].


class Waiting(NamedTuple):
    run: ProgramRun
    handle: Any


def answer(handle: Any, result: RunProgram.Result) -> None:
    end_goal(handle, result, result.code == Code.SUCCEEDED, result.code == Code.CANCELED)


class ProgramQueue:
    """A queue of goals, first in, first out. Goals that are cancelled or refused leave it, too."""

    def __init__(self) -> None:
        self._entries: deque[Waiting] = deque()
        self._told_at = 0.0

    def add(self, run: ProgramRun, handle: Any) -> None:
        if len(self._entries) < MOST:
            self._entries.append(Waiting(run, handle))
            return
        full = f'{MOST} programs wait already; send it again when one has ended'
        self._end(Waiting(run, handle), Outcome(Code.BUSY, full))

    def next(self) -> Waiting | None:
        return self._entries.popleft() if self._entries else None

    @property
    def names(self) -> list[str]:
        return [entry.run.name for entry in self._entries]

    def watch(self) -> None:
        """End goals that were cancelled or refused. A refused one ends all after it."""
        for entry in list(self._entries):
            if entry not in self._entries:  # a goal before it was refused
                continue
            if entry.handle.is_cancel_requested:
                self._entries.remove(entry)
                text = 'cancelled while it waited; nothing moved'
                self._end(entry, Outcome(Code.CANCELED, text))
            elif (outcome := entry.run.preparation.look()) is not None:
                self._drop(list(self._entries).index(entry) + 1, entry.run.name)
                self._entries.remove(entry)
                self._end(entry, outcome)
        now = time.monotonic()
        if now - self._told_at > FEEDBACK:
            self._told_at = now
            for ahead, entry in enumerate(self._entries, start=1):
                entry.handle.publish_feedback(RunProgram.Feedback(programs_ahead=ahead))

    def give_up(self, name: str) -> None:
        self._drop(0, name)

    def _drop(self, first: int, name: str) -> None:
        while len(self._entries) > first:
            entry = self._entries.pop()
            text = f'not started: {name} before it did not reach its end; send it again'
            self._end(entry, Outcome(Code.NOT_STARTED, text))

    def _end(self, entry: Waiting, outcome: Outcome) -> None:
        entry.run.preparation.close()
        answer(entry.handle, entry.run.result(outcome))
