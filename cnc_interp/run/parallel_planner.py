"""Plan the feed in several processes, while this one smooths, interpolates and writes.

Different processes plan the stretches between exact stops, each from time zero. Afterwards the
times are shifted. The result agrees bit for bit with that of ``FeedPlanner``.
"""

from __future__ import annotations

import ctypes
import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import InterpError
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath, cut

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit


ENOUGH = 500  #: Least work of a section, in path cells; about 0.1 s of planning.
#: Work that is added for each rest, because short strokes cost more; in path cells.
STROKE = 20
#: Option of ``prctl`` that sets the signal which a process gets when its parent dies.
PARENT_DEATH_SIGNAL = 1
AHEAD = 4  #: Number of sections that each process may have in its queue.


@dataclass(frozen=True)
class PathSection:
    path: AxisPath  #: Path of the section.
    rests: bool  #: Whether the motion rests at the end of the section.


class RestSections:
    def __init__(self, at_rests: bool = True) -> None:
        self._at_rests = at_rests
        self._parts: list[AxisPath] = []
        self._work = 0

    def push(self, path: AxisPath) -> Iterator[PathSection]:
        begin = counted = 0
        for rest in np.flatnonzero(path.stop).tolist() if self._at_rests else ():
            if rest == 0 and not self._parts:
                continue  # the first point of the path
            self._work += rest - counted + STROKE
            counted = rest
            if self._work < ENOUGH:
                continue
            if rest > begin:
                self._parts.append(cut(path, begin, rest))
                begin = rest
            yield self._section(len(self._parts), rests=True)
        last = len(path.s) - 1
        if last > begin:
            self._parts.append(cut(path, begin, last))
            self._work += last - counted
        # The newest part is kept, because the next part may begin with a rest.
        if self._work >= ENOUGH and len(self._parts) > 1:
            yield self._section(len(self._parts) - 1, rests=False)

    def finish(self) -> Iterator[PathSection]:
        if self._parts:
            yield self._section(len(self._parts), rests=True)

    def _section(self, parts: int, rests: bool) -> PathSection:
        path = AxisPath.join(self._parts[:parts])
        del self._parts[:parts]
        self._work = sum(len(part.s) - 1 for part in self._parts)
        return PathSection(path, rests)


class LostProcessError(InterpError):
    """A planning process was killed."""


@dataclass(frozen=True)
class Planning:
    limits: Limits  #: Limits of the axes.
    options: PlanOptions  #: Settings of the planner.
    tool: ToolLimit | None = None  #: Limit of the tool error that the drives cause.

    def planner(self) -> FeedPlanner:
        return FeedPlanner(self.limits, self.options, tool=self.tool)


class PlannerProcess:
    def __init__(self, planning: Planning):
        context = multiprocessing.get_context('fork')
        self.waiting = 0  # sections that were given and not taken back
        self._sections: multiprocessing.Queue[PathSection | None] = context.Queue()
        self.results, theirs = context.Pipe(duplex=False)
        given = planning, os.getpid(), self._sections, theirs
        self._process = context.Process(target=_live, args=given)
        self._process.start()
        theirs.close()

    def give(self, section: PathSection | None) -> None:
        self._sections.put(section)
        self.waiting += 1

    def take(self) -> list[PlannedPiece]:
        """Return the motion of the next section, or raise the error of its planning."""
        try:
            answer = self.results.recv()
        except (EOFError, OSError):
            raise LostProcessError(
                'a process that planned a part of the program was killed; start again'
            ) from None
        self.waiting -= 1
        if isinstance(answer, Exception):
            raise answer
        return list(answer)

    def kill(self) -> None:
        self._process.kill()
        self._process.join()
        self._sections.cancel_join_thread()
        self._sections.close()
        self.results.close()


def _live(
    planning: Planning,
    parent: int,
    sections: multiprocessing.Queue[PathSection | None],
    results: Connection,
) -> None:
    """Plan sections until the parent process kills this one, or dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent hears Ctrl-C
    for number in (signal.SIGTERM, signal.SIGHUP):  # not the handler of the parent
        signal.signal(number, signal.SIG_DFL)
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


def _planned(planner: FeedPlanner, section: PathSection | None) -> list[PlannedPiece]:
    if section is None:
        planner.refuse()
        return []
    # ``replace`` makes arrays read-only again; kernels are compiled for such arrays.
    pieces = planner.push(replace(section.path))
    return pieces + planner.finish() if section.rests else pieces


def _send(answers: SimpleQueue[list[PlannedPiece] | Exception], results: Connection) -> None:
    while True:
        results.send(answers.get())


class ParallelPlanner:
    def __init__(self, planning: Planning, processes: int):
        afresh = planning.tool is None  # after a rest, except for drives that swing on
        self._planning, self._most = planning, processes if afresh else 1
        self._sections = RestSections(afresh)
        self._processes: list[PlannerProcess] = []
        self._given: deque[PlannerProcess] = (
            deque()
        )  # the processes that have the sections, in order
        self._moving: PlannerProcess | None = None  # it has the begin of a stretch
        self._time = 0.0

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        pieces: list[PlannedPiece] = []
        for section in self._sections.push(path):
            self._give(section)
            pieces += self._collected(AHEAD * len(self._processes))
        return pieces

    def finish(self) -> list[PlannedPiece]:
        for section in self._sections.finish():
            if not self._processes:  # a short program
                planner = self._planning.planner()
                return planner.push(section.path) + planner.finish()
            self._give(section)
        return self._collected(0)

    def refuse(self) -> None:
        """Plan the path received so far; raise the error if it cannot be planned."""
        for section in self._sections.finish():
            self._give(replace(section, rests=False))
        self._collected(0)
        if self._moving is not None:
            self._moving.give(None)
            self._moving.take()

    def close(self) -> None:
        for process in self._processes:
            process.kill()

    def _give(self, section: PathSection) -> None:
        """Queue a section for the process that began its stretch, else for the least busy one."""
        if not self._processes:
            # All are forked at once, because a process with threads must not fork.
            self._processes = [PlannerProcess(self._planning) for _ in range(self._most)]
        process = self._moving or min(self._processes, key=lambda one: one.waiting)
        process.give(section)
        self._given.append(process)
        self._moving = None if section.rests else process

    def _collected(self, most: int) -> list[PlannedPiece]:
        """Return the motion of finished sections; wait until at most ``most`` are pending."""
        pieces: list[PlannedPiece] = []
        while self._given and (len(self._given) > most or self._given[0].results.poll()):
            pieces += self._on_the_clock(self._given.popleft().take())
        return pieces

    def _on_the_clock(self, pieces: list[PlannedPiece]) -> list[PlannedPiece]:
        """Shift a motion to the end of the preceding one; add times as ``Stretch.law`` does."""
        placed = []
        for piece in pieces:
            law = piece.law
            time = self._time + np.concatenate([[0.0], np.cumsum(law.duration)])
            # ``replace`` makes arrays read-only again; kernels are compiled for such arrays.
            path, law = replace(piece.path), replace(law, time=time[:-1])
            placed.append(replace(piece, path=path, law=law))
            self._time = law.end_time
        return placed
