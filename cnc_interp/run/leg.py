"""A leg: motion from rest to rest, with a planner and a time axis of its own."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.feedrate.feed_planner import FeedPlanner, PlannedPiece
from cnc_interp.feedrate.limits import AxisLimits
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.plan_options import PlanOptions
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.run.chunk import Wait
from cnc_interp.run.setpoints import Interpolator

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit

#: Settings of the planner in a run, where nothing shows the least time.
LIVE = PlanOptions(bound=False)
#: Length of the slices in which motion is sampled [s]; a change of the override waits for one.
SLICE = 0.1
#: Speed below which the end of a law is rest [m/s].
STILL = 1e-9
#: Times nearer than this are the same [s].
SAME_TIME = 1e-9


def sliced(piece: PlannedPiece) -> list[PlannedPiece]:
    """Cut the motion of a planned piece into slices, on the same path."""
    law = without_long_rows(piece.law)
    stretch = np.floor((law.time - law.time[0]) / SLICE)
    borders = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(law)]
    return [
        PlannedPiece(piece.path, law[np.arange(first, last)]) for first, last in pairwise(borders)
    ]


def without_long_rows(law: MotionLaw) -> MotionLaw:
    """Divide rows that are longer than a slice; a slow line may be one row of many minutes."""
    parts = np.maximum(1, np.ceil(law.duration / SLICE - 1.0)).astype(np.int64)
    if (parts == 1).all():
        return law
    row = np.repeat(np.arange(len(law)), parts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    duration = law.duration[row] / parts[row]
    time = law.time[row] + place * duration
    s, s_dot, s_ddot, _ = law.evaluate(time, row)
    cut_law = law[row]
    return replace(cut_law, time=time, duration=duration, s=s, s_dot=s_dot, s_ddot=s_ddot)


class Leg:
    """One leg of a stream: planned, then sampled slice by slice."""

    def __init__(
        self, limits: AxisLimits, period: float, begun: int = 0, start: tuple[float, float] = (0.0,
        0.0), tool: ToolLimit | None = None,
    ):  # fmt: skip
        self.period = period
        self.planner = FeedPlanner(limits, LIVE, start, max(begun - 1, 0) * period, tool)
        self.interpolator = Interpolator(period, begun)
        self.slices: deque[PlannedPiece] = deque()
        self.wait: Wait | None = None
        self.moves = False
        self.number_of_zero: int | None = None  # number in the stream of the sample at time 0

    def push(self, path: AxisPath) -> None:
        """Plan a part of the path; raises PlanningError if no law is within the limits."""
        for piece in self.planner.push(path):
            self.slices.extend(sliced(piece))
        self.moves = True

    def finish(self, wait: Wait) -> None:
        """Plan down to rest at the end of the leg."""
        for piece in self.planner.finish():
            self.slices.extend(sliced(piece))
        self.wait = wait

    def drive(self, piece: PlannedPiece, wait: Wait) -> None:
        """Use a known law down to rest instead of planning one."""
        self.slices.extend(sliced(piece))
        self.moves, self.wait = True, wait

    @property
    def planned(self) -> float:
        """Motion planned but not sampled [s]."""
        if not self.slices:
            return 0.0
        return float(self.slices[-1].law.end_time - self.slices[0].law.time[0])

    def state_at(self, number: int, piece: PlannedPiece) -> tuple[float, float, float]:
        """Return s, s_dot and s_ddot at a sample, in the slice that has it [m, m/s, m/s2]."""
        assert self.number_of_zero is not None
        time = (number - self.number_of_zero) * self.period
        s, v, a, _ = (float(x[0]) for x in piece.law.evaluate(np.array([time])))
        rests = time >= piece.law.end_time - SAME_TIME and v < STILL  # after the last slice
        return (s, 0.0, 0.0) if rests else (s, v, a)
