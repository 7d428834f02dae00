"""
A feed planner with several processes, while this one smooths, interpolates and writes.

At a rest nothing of the motion before it counts but its end time. So stretches between exact
stops are planned by different processes, each from time zero. The clock of their laws is set
afterwards, with the same additions that ``FeedPlanner`` makes. So the motion has the same bits as
from one process.

A stretch without rests is planned by one process, part by part as it arrives. So is the whole path
if the error at the tool is limited: the drives swing on while the setpoints rest.
"""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Protocol

import numpy as np

from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.run.planner_process import PlannerProcess, Planning
from cnc_interp.run.rest_sections import RestSections, Section

#: Sections that are given out ahead, for each process.
AHEAD = 4


class MotionPlanner(Protocol):
    """Plans the motion along a path that arrives in parts; see ``FeedPlanner``."""

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        """Add the next part of the path; return motion that is committed, in order."""
        ...

    def finish(self) -> list[PlannedPiece]:
        """Return the rest of the motion, down to rest at the end of the path."""
        ...

    def refuse(self) -> None:
        """Raise the refusal of the path so far, if there is one."""
        ...


class ParallelPlanner:
    """
    Plan the motion along a path that arrives in parts, with several processes.

    They start when the path has a section for them.
    """

    def __init__(self, planning: Planning, processes: int):
        self._planning, self._most = planning, processes if planning.afresh_at_rests else 1
        self._sections = RestSections(planning.afresh_at_rests)
        self._processes: list[PlannerProcess] = []
        self._given: deque[PlannerProcess] = deque()  # who has the sections, in order
        self._moving: PlannerProcess | None = None  # it has the begin of a stretch
        self._time = 0.0

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        """
        Add the next part of the path; see ``FeedPlanner.push``.

        Returns
        -------
        list of PlannedPiece
            The motion that is ready, in order. How much that is depends on the processes.

        Raises
        ------
        PlanningError
            If no law within the limits exists.
        LostProcessError
            If somebody has killed a process.

        """
        pieces: list[PlannedPiece] = []
        for section in self._sections.push(path):
            self._give(section)
            pieces += self._collected(AHEAD * len(self._processes))
        return pieces

    def finish(self) -> list[PlannedPiece]:
        """Return the rest of the motion; raises as ``push``."""
        for section in self._sections.finish():
            if not self._processes:  # a short program
                planner = self._planning.planner()
                return planner.push(section.path) + planner.finish()
            self._give(section)
        return self._collected(0)

    def refuse(self) -> None:
        """Plan the path so far, and raise its refusal if there is one."""
        for section in self._sections.finish():
            self._give(replace(section, rests=False))
        self._collected(0)
        if self._moving is not None:
            self._moving.give(None)
            self._moving.take()

    def close(self) -> None:
        """End the processes."""
        for process in self._processes:
            process.kill()

    def _give(self, section: Section) -> None:
        """Give a section to the process that has the begin of its stretch, or the least to do."""
        if not self._processes:
            # All at once: a process that has threads already is no good parent.
            self._processes = [PlannerProcess(self._planning) for _ in range(self._most)]
        process = self._moving or min(self._processes, key=lambda one: one.waiting)
        process.give(section)
        self._given.append(process)
        self._moving = None if section.rests else process

    def _collected(self, most: int) -> list[PlannedPiece]:
        """Return the motion of the first sections, until at most so many are left."""
        pieces: list[PlannedPiece] = []
        while self._given and (len(self._given) > most or self._given[0].ready()):
            pieces += self._on_the_clock(self._given.popleft().take())
        return pieces

    def _on_the_clock(self, pieces: list[PlannedPiece]) -> list[PlannedPiece]:
        """Let motion begin at the end of the motion before; adds as ``Stretch.law`` does."""
        placed = []
        for piece in pieces:
            law = piece.law
            time = self._time + np.concatenate([[0.0], np.cumsum(law.duration)])
            # ``replace`` makes arrays read-only again; kernels are compiled for such arrays.
            path, law = replace(piece.path), replace(law, time=time[:-1])
            placed.append(replace(piece, path=path, law=law))
            self._time = law.end_time
        return placed
