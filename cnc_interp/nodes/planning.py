"""Segments of one program -> setpoints of one run, as they come; no ROS, no clock."""

from __future__ import annotations

from dataclasses import fields

import numpy as np

from cnc_interp.feedrate.window import FeedPlanner, PlannedPiece
from cnc_interp.interpolator import Interpolator, Setpoints
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.transform import Transform
from cnc_interp.nodes.approach import approach
from cnc_interp.program.blocks import FloatArray
from cnc_interp.smoothing.segments import PathSegments


def part_of(samples: Setpoints, first: int, last: int) -> Setpoints:
    """Take consecutive setpoints."""
    return Setpoints(*(getattr(samples, field.name)[first:last] for field in fields(Setpoints)))


class RunPlanner:
    """
    The planning of one run: the approach, then the program.

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
        self._started = False

    def push(self, segments: PathSegments) -> list[Setpoints]:
        """
        Take further segments and return the setpoints that are final.

        Raises
        ------
        InterpError
            If the path cannot be run on the machine; the message names line, axis and value.

        """
        for (first, last), line in zip(segments.block, segments.line_number, strict=True):
            self._lines.setdefault(int(first), int(line))
            self._lines[int(last)] = int(line)
        path = self._builder.push(segments)
        return [] if path is None else self._sampled(self._planner.push(path))

    def finish(self) -> list[Setpoints]:
        """Return what is left, down to rest at the end of the path."""
        found = self._sampled(self._planner.finish())
        if self._started:
            found.append(self._interpolator.finish())
        return found

    def lines_of(self, samples: Setpoints) -> list[int]:
        """Return the source line of each setpoint; earlier blocks are forgotten."""
        first = int(samples.block[0])
        if len(self._lines) > 100_000:
            self._lines = {block: line for block, line in self._lines.items() if block >= first}
        return [self._lines.get(block, 0) for block in samples.block.tolist()]

    def _sampled(self, pieces: list[PlannedPiece]) -> list[Setpoints]:
        """Interpolate pieces, the approach before the first one."""
        found = []
        if pieces and not self._started:
            self._started = True
            start = np.array(pieces[0].path.cell_left[0, 0])
            found.append(approach(self._machine, self._period, self._stands, start))
        found += [self._interpolator.push(piece) for piece in pieces]
        return [samples for samples in found if len(samples)]
