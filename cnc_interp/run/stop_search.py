"""Stops along the path, looked for every few milliseconds while a plan is sampled."""

from __future__ import annotations

from collections.abc import Iterator

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.run.course import Course
from cnc_interp.run.interpolator import Interpolator, Setpoints
from cnc_interp.run.leg import Leg

STOP_EVERY = 0.005
"""Time between setpoints at which a stop is looked for [s]."""

HASTE, HASTY_EVERY = 0.3, 0.02
"""Begin of a plan that joins in motion, and the time between stops in it [s]: it must be early."""


class StopSearch:
    """Find stops at the setpoints of one plan."""

    def __init__(
        self, course: Course, table: FloatArray, period: float, joins_at: int | None = None
    ):
        self._course, self._table, self._period = course, table, period
        self._every = max(1, round(STOP_EVERY / period))
        self._hasty_every = self._every * round(HASTY_EVERY / STOP_EVERY)
        self._hasty_until = 0 if joins_at is None else joins_at + round(HASTE / period)

    def stops(
        self, leg: Leg, piece: PlannedPiece, numbers: range
    ) -> Iterator[tuple[int, Setpoints]]:
        """
        Look for stops at the setpoints of a slice of the motion.

        Parameters
        ----------
        leg : Leg
            The leg that the slice belongs to.
        piece : PlannedPiece
            The slice.
        numbers : range
            Numbers of its setpoints in the stream.

        Yields
        ------
        tuple of int and Setpoints
            Number of a setpoint, and the setpoints after it down to rest.

        """
        ahead: AxisPath | None = None
        first = -(-(numbers.start + 1) // self._every) * self._every - 1
        for number in range(first, numbers.stop, self._every):
            if number < self._hasty_until and (number + 1) % self._hasty_every:
                continue
            state = leg.state_at(number, piece)
            if state[1] <= 0.0:
                continue
            if ahead is None:
                ahead = self._course.ahead(float(piece.law.s[0]))
            stop = stop_law(ahead, state, self._table, 0.0)
            if stop is not None:
                yield number, self._sampled(stop)

    def _sampled(self, stop: PlannedPiece) -> Setpoints:
        """Sample a stop: the setpoints after its first state, the last one at rest."""
        interpolator = Interpolator(self._period, 1)
        return Setpoints.concatenate([interpolator.push(stop), interpolator.finish()])
