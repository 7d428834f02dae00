"""A process that plans sections of a path, forked from the one that has the path."""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from queue import SimpleQueue

from cnc_interp.core.errors import InterpError
from cnc_interp.feedrate.limits import AxisLimits
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.feedrate.window import FeedPlanner, PlannedPiece
from cnc_interp.run.rest_sections import Section

#: Option of ``prctl``: the signal that a process receives when its parent has died.
PARENT_DEATH_SIGNAL = 1


class LostProcessError(InterpError):
    """Somebody has killed a process that planned."""


@dataclass(frozen=True)
class Planning:
    """How motion is planned."""

    limits: AxisLimits  #: Limits of the axes.
    options: PlanOptions  #: Settings of the planner.

    @property
    def afresh_at_rests(self) -> bool:
        """Whether motion after a rest is planned as if nothing was before; drives swing on."""
        return self.options.tool is None

    def planner(self) -> FeedPlanner:
        """Return a planner at rest at time zero."""
        return FeedPlanner(self.limits, self.options)


class PlannerProcess:
    """A planner in a process of its own; it plans sections in the order given."""

    def __init__(self, planning: Planning):
        context = multiprocessing.get_context('fork')
        self.waiting = 0  # sections that were given and not taken back
        self._sections: multiprocessing.Queue[Section | None] = context.Queue()
        self._results, theirs = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_live, args=(planning, os.getpid(), self._sections, theirs)
        )
        self._process.start()
        theirs.close()

    def give(self, section: Section | None) -> None:
        """Give the next section; None asks for the refusal of what was given."""
        self._sections.put(section)
        self.waiting += 1

    def ready(self) -> bool:
        """Tell whether ``take`` need not wait."""
        return self._results.poll()

    def take(self) -> list[PlannedPiece]:
        """
        Return the motion of the first section that was not taken yet.

        Raises
        ------
        PlanningError
            If no law within the limits exists.
        LostProcessError
            If somebody has killed the process.

        """
        try:
            answer = self._results.recv()
        except (EOFError, OSError):
            raise LostProcessError(
                'a process that planned a part of the program was killed; start again'
            ) from None
        self.waiting -= 1
        if isinstance(answer, Exception):
            raise answer
        return list(answer)

    def kill(self) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.join()
        self._sections.cancel_join_thread()
        self._sections.close()
        self._results.close()


def _live(
    planning: Planning,
    parent: int,
    sections: multiprocessing.Queue[Section | None],
    results: Connection,
) -> None:
    """Plan sections until the parent ends this process, or has died."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears Ctrl-C
    ctypes.CDLL(None).prctl(PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        return
    answers: SimpleQueue[list[PlannedPiece] | Exception] = SimpleQueue()
    threading.Thread(target=_send, args=(answers, results), daemon=True).start()
    planner = planning.planner()  # limits are inherited, so kernels are those of the parent
    while True:
        try:
            answers.put(_planned(planner, sections.get()))
        except Exception as problem:
            answers.put(problem)


def _planned(planner: FeedPlanner, section: Section | None) -> list[PlannedPiece]:
    """Return the motion that is committed with a section."""
    if section is None:
        planner.refuse()
        return []
    # ``replace`` makes arrays read-only again; kernels are compiled for such arrays.
    pieces = planner.push(replace(section.path))
    return pieces + planner.finish() if section.rests else pieces


def _send(answers: SimpleQueue[list[PlannedPiece] | Exception], results: Connection) -> None:
    """Send answers, so that planning does not wait until the parent reads them."""
    while True:
        results.send(answers.get())
