"""Segments of one program -> setpoints of one run, as they come; no ROS, no clock."""

from __future__ import annotations

from dataclasses import fields, replace
from itertools import pairwise

import numpy as np

from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.window import FeedPlanner, PlannedPiece
from cnc_interp.interpolator import Interpolator, Setpoints
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes.approach import approach
from cnc_interp.program.blocks import FloatArray, IntArray
from cnc_interp.smoothing.segments import PathSegments

#: Motion that is interpolated at a time [s].
SLICE = 0.5


def part_of(samples: Setpoints, first: int, last: int) -> Setpoints:
    """Take consecutive setpoints."""
    return Setpoints(*(getattr(samples, field.name)[first:last] for field in fields(Setpoints)))


def sliced(piece: PlannedPiece) -> list[PlannedPiece]:
    """Cut the motion of a planned piece into short stretches, on the same path."""
    law = without_long_rows(piece.law)
    stretch = np.floor((law.time - law.time[0]) / SLICE)
    borders = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(law)]
    return [
        PlannedPiece(piece.path, rows_of(law, np.arange(first, last)))
        for first, last in pairwise(borders)
    ]


def rows_of(law: MotionLaw, rows: IntArray) -> MotionLaw:
    """Take some rows of a motion law."""
    return MotionLaw(*(getattr(law, field.name)[rows] for field in fields(MotionLaw)))


def without_long_rows(law: MotionLaw) -> MotionLaw:
    """Cut rows that are longer than a stretch: a slow line is one row of many minutes."""
    parts = np.maximum(1, np.ceil(law.duration / SLICE - 1.0)).astype(np.int64)
    if (parts == 1).all():
        return law
    row = np.repeat(np.arange(len(law)), parts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    duration = law.duration[row] / parts[row]
    time = law.time[row] + place * duration
    s, s_dot, s_ddot, _ = law.evaluate(time, row)
    cut = rows_of(law, row)
    return replace(cut, time=time, duration=duration, s=s, s_dot=s_dot, s_ddot=s_ddot)


class RunPlanner:
    """
    The planning of one run: the approach, then the program.

    ``push`` and ``finish`` plan, which may take long, and may run in a thread of their own;
    ``samples_of`` and the rest are quick and run where the setpoints are sent.

    Parameters
    ----------
    transform : Transform
        The machine's transformation.
    flank_height : float
        Height that measures rotations [m].
    period : float
        Interpolation period [s].
    stands : ndarray, shape (n_axes,)
        Where the machine stands, at rest [m, rad].

    """

    def __init__(
        self, transform: Transform, flank_height: float, period: float, stands: FloatArray
    ):
        self._machine, self._period, self._stands = transform.machine, period, stands
        self._builder = AxisPathBuilder(transform, flank_height)
        self._planner = FeedPlanner(transform.machine)
        self._interpolator = Interpolator(period)
        self._lines: dict[int, int] = {}
        self._first_block = 0
        self._started = False

    def push(self, segments: PathSegments) -> list[PlannedPiece]:
        """
        Take further segments and return the motion that is final, in short stretches.

        Raises
        ------
        InterpError
            If the path cannot be run on the machine; the message names line, axis and value.

        """
        self._note_lines(segments)
        path = self._builder.push(segments)
        pieces = [] if path is None else self._planner.push(path)
        return [stretch for piece in pieces for stretch in sliced(piece)]

    def finish(self) -> list[PlannedPiece]:
        """Plan what is left, down to rest at the end of the path."""
        return [stretch for piece in self._planner.finish() for stretch in sliced(piece)]

    def samples_of(self, piece: PlannedPiece) -> Setpoints:
        """Interpolate the next stretch; the approach comes before the first one."""
        samples = self._interpolator.push(piece)
        if self._started:
            return samples
        self._started = True
        start = np.array(piece.path.cell_left[0, 0])
        before = approach(self._machine, self._period, self._stands, start)
        return Setpoints.concatenate([before, samples])

    def last_sample(self) -> Setpoints | None:
        """Return the sample at rest at the end of the path; None when nothing was planned."""
        return self._interpolator.finish() if self._started else None

    def _note_lines(self, segments: PathSegments) -> None:
        """Remember the source line of each block; forget blocks that are long executed."""
        lines = self._lines
        if len(lines) > 100_000:
            first = self._first_block
            lines = {block: line for block, line in lines.items() if block >= first}
        for (first, last), line in zip(segments.block, segments.line_number, strict=True):
            lines.setdefault(int(first), int(line))
            lines[int(last)] = int(line)
        self._lines = lines

    def lines_of(self, samples: Setpoints) -> list[int]:
        """Return the source line of each setpoint."""
        lines = self._lines
        self._first_block = int(samples.block[0])
        return [lines.get(block, 0) for block in samples.block.tolist()]
