"""The filleted end mill: a corner torus of radii R and r_c, a flat bottom and a cylinder above.

C_L is the centre of the circle of corner centres, which has the radius R. u is the unit tool axis
towards the spindle. The mill is the set of all points within r_c of the cylinder that stands on
the disk of that circle. R = 0 is a ball mill, r_c = 0 a flat mill.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from cnc_interp.core import MM, FloatArray, InterpError


@dataclass(frozen=True)
class Cutter:
    """A filleted end mill; InterpError if a radius is negative or not finite, or both are zero."""

    #: R, radius of the circle of corner centres [TL2008]; the diameter is 2 (R + r_c) [m].
    tool_radius: float
    corner_radius: float  #: r_c [m].

    def __post_init__(self) -> None:
        for name in ('tool_radius', 'corner_radius'):
            value = getattr(self, name)
            if not (isfinite(value) and value >= 0.0):
                raise InterpError(f'{name} is {value / MM:g} mm; it must not be negative')
        if self.tool_radius + self.corner_radius == 0.0:
            raise InterpError('a cutter needs a radius')

    @staticmethod
    def of_diameter(diameter: float, corner_radius: float) -> Cutter:
        if not 0.0 <= corner_radius <= 0.5 * diameter:
            raise InterpError(
                f'a corner radius of {corner_radius / MM:g} mm does not fit a diameter of '
                f'{diameter / MM:g} mm; it lies between 0 and {0.5 * diameter / MM:g} mm'
            )
        return Cutter(0.5 * diameter - corner_radius, corner_radius)

    @property
    def is_ball(self) -> bool:
        """True for a ball mill, whose contact does not depend on the tilt."""
        return self.tool_radius == 0.0

    def tip(self, centre: FloatArray, axis: FloatArray) -> FloatArray:
        return np.asarray(centre - self.corner_radius * axis)

    def effective_radius(self, tilt: float) -> float:
        """Radius of the swept profile at the contact point on a plane [TL2008, Eq. 3.17]."""
        sine = np.sin(tilt)
        return float((self.tool_radius + self.corner_radius * sine) / sine)

    def tilt_of_curvature(self, curvature: FloatArray, limits: tuple[float, float]) -> FloatArray:
        """Return the tilts for which the swept profile has a curvature [1/m]."""
        sine = (
            curvature * self.tool_radius / np.maximum(1.0 - curvature * self.corner_radius, 1e-6)
        )
        return np.asarray(np.arcsin(np.clip(sine, np.sin(limits[0]), np.sin(limits[1]))))
