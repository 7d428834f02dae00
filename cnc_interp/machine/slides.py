"""What moves by hand: the axes, each for itself, or the tool along its own axis."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.kinematics.path_checks import TRAVEL_SLACK
from cnc_interp.machine_model.machine import Machine

THERE = TRAVEL_SLACK  #: Nearer than this to its target, an axis is there [m, rad].


@dataclass(frozen=True, eq=False)
class Slides:
    """What moves by hand: m straight lines in the n axes, ``q = origin + x @ direction``."""

    origin: FloatArray  #: (n,): Axis positions at x = 0 [m, rad].
    direction: FloatArray  #: (m, n): Motion of the axes per unit of each coordinate x.
    limits: Limits  #: Of the m coordinates, constant ones.

    def positions(self, x: FloatArray) -> FloatArray:
        return self.origin + x @ self.direction

    def motion(self, rows: FloatArray, jerk: FloatArray) -> FloatArray:
        """Return positions, velocities, accelerations and jerks of the axes, (4, k, n).

        ``rows`` (k, 3, m): the first three of the coordinates x; ``jerk`` (k, m).
        """
        x, v, a = rows.swapaxes(0, 1)
        return np.stack([self.positions(x), *(part @ self.direction for part in (v, a, jerk))])

    def coordinates(self, q: FloatArray) -> FloatArray:
        weights = self.direction / (self.direction**2).sum(axis=1, keepdims=True)
        return weights @ (q - self.origin)

    @staticmethod
    def of_axes(machine: Machine) -> Slides:
        """Return the axes of the machine, each its own slide; x is q."""
        n = len(machine.axis_names)
        return Slides(np.zeros(n), np.eye(n), machine.limits.lowest)
