"""Slides for motion by hand: each axis alone, or the tool along its own axis."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.kinematics.path_checks import TRAVEL_SLACK
from cnc_interp.machine_model.error_map import NO_ERRORS, ErrorMap
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform

THERE = TRAVEL_SLACK  #: An axis nearer than this to its target has arrived [m, rad].
#: Share of the drives' limits for curvature that geometric errors add to a motion by hand, and
#: share for its nominal axes; the rest is a reserve for the slope of the errors [-].
BENT, KEPT = 0.1, 0.75
TINY = 1e-12  #: Least bound of an error, because limits are divided by it.


@dataclass(frozen=True, eq=False)
class Slides:
    """Slides for motion by hand: m coordinates x that move n axes: ``q = origin + x @ direction``.

    The axes q are nominal; ``positions`` and ``motion`` return commanded axes.
    """

    origin: FloatArray  #: (n,): Axis positions at x = 0 [m, rad].
    direction: FloatArray  #: (m, n): Motion of the axes per unit of each coordinate x.
    limits: Limits  #: Limits of the m coordinates, equal at all positions.

    #: Map from nominal to commanded axes, and the travel (n, 2) of these if errors are mapped.
    errors: ErrorMap = field(default=NO_ERRORS, kw_only=True)
    travel: FloatArray | None = field(default=None, kw_only=True)

    def nominal(self, x: FloatArray) -> FloatArray:
        return self.origin + x @ self.direction

    def positions(self, x: FloatArray) -> FloatArray:
        return self.errors.commanded(self.nominal(x))

    def within_travel(self, x: FloatArray) -> bool:
        q, (low, high) = x, self.limits.travel.T
        if self.travel is not None:
            q, (low, high) = self.positions(x), self.travel.T
        return bool(((q >= low - THERE) & (q <= high + THERE)).all())

    def motion(self, rows: FloatArray, jerk: FloatArray) -> FloatArray:
        """Return positions, velocities, accelerations and jerks of the commanded axes, (4, k, n).

        ``rows`` (k, 3, m): x with two derivatives; ``jerk`` (k, m): the third one.
        """
        x, v, a = rows.swapaxes(0, 1)
        rates = (part @ self.direction for part in (v, a, jerk))
        return self.errors.motion(np.stack([self.nominal(x), *rates]))

    def coordinates(self, commanded: FloatArray) -> FloatArray:
        weights = self.direction / (self.direction**2).sum(axis=1, keepdims=True)
        return weights @ (self.errors.nominal(commanded[None])[0] - self.origin)

    @staticmethod
    def of_drives(machine: Machine) -> Slides:
        """Return one slide for each axis without its geometric errors; x is q."""
        n = len(machine.axis_names)
        return Slides(np.zeros(n), np.eye(n), machine.limits.lowest)

    @staticmethod
    def of_axes(machine: Machine) -> Slides:
        """Return one slide for each nominal axis, with limits that commanded axes also keep."""
        drives, errors = Slides.of_drives(machine), machine.errors
        if errors is None:
            return drives
        off, _, bend, third = np.maximum(errors.bounds, TINY)
        linear, (velocity, acceleration, jerk) = machine.is_linear, drives.limits.by_order
        a, j = BENT * acceleration[linear].min(), BENT * jerk[linear].min()
        by_jerk = min(j / (3.0 * bend * acceleration[linear].max()), np.cbrt(j / third))
        most = min(np.sqrt(a / bend), by_jerk)
        limits = drives.limits.having(
            max_velocity=np.where(linear, np.minimum(KEPT * velocity, most), velocity),
            max_acceleration=KEPT * acceleration,
            max_jerk=KEPT * jerk,
            travel=machine.travel + np.outer(linear, [off, -off]),
        )
        mapped = Transform.of(machine).errors
        return replace(drives, limits=limits, errors=mapped, travel=machine.travel)
