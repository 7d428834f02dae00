"""The filleted end mill: a corner torus of radii R and r_c, a flat bottom and a cylinder above.

C_L is the centre of the circle of corner centres, which has the radius R. u is the unit tool axis
towards the spindle. The mill is the set of all points within r_c of the cylinder that stands on
the disk of that circle. R = 0 is a ball mill, r_c = 0 a flat mill.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite

import numpy as np

from cnc_interp.cam.guiding import CurveFrames
from cnc_interp.core import MM, FloatArray, InterpError, cross, demand, refuse_if, scaled


@dataclass(frozen=True)
class Cutter:
    """A filleted end mill; InterpError if a radius is negative or not finite, or both are zero."""

    #: R, radius of the circle of corner centres [TL2008]; the diameter is 2 (R + r_c) [m].
    tool_radius: float
    corner_radius: float  #: r_c [m].

    def __post_init__(self) -> None:
        for name in ('tool_radius', 'corner_radius'):
            value = getattr(self, name)
            demand(
                isfinite(value) and value >= 0.0,
                InterpError(f'{name} is {value / MM:g} mm; it must not be negative'),
            )
        refuse_if(
            self.tool_radius + self.corner_radius == 0.0, InterpError('a cutter needs a radius')
        )

    @staticmethod
    def of_diameter(diameter: float, corner_radius: float) -> Cutter:
        demand(
            0.0 <= corner_radius <= 0.5 * diameter,
            InterpError(
                f'a corner radius of {corner_radius / MM:g} mm does not fit a diameter of '
                f'{diameter / MM:g} mm; it lies between 0 and {0.5 * diameter / MM:g} mm'
            ),
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
        """Return the tilts at which the swept profile has the given curvature [1/m]."""
        sine = (
            curvature * self.tool_radius / np.maximum(1.0 - curvature * self.corner_radius, 1e-6)
        )
        return np.asarray(np.arcsin(np.clip(sine, np.sin(limits[0]), np.sin(limits[1]))))


@dataclass(frozen=True)
class Postures:
    cutter: Cutter  #: The mill.
    frames: CurveFrames  #: Guided points and their frames.
    #: (n,): Angles [rad].
    tilt: FloatArray
    yaw: FloatArray
    #: (n,): Derivatives of the angles by arc length of K [rad/m].
    tilt_rate: FloatArray
    yaw_rate: FloatArray

    def __len__(self) -> int:
        return len(self.tilt)

    @property
    def turned(self) -> tuple[FloatArray, FloatArray]:
        """Feed direction and direction across it, turned by the yaw about n."""
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        f, t = self.frames.feed, self.frames.across
        return scaled(c, f) - scaled(s, t), scaled(c, t) + scaled(s, f)

    @property
    def axis(self) -> FloatArray:
        f_y = self.turned[0]
        return scaled(np.cos(self.tilt), self.frames.normal) + scaled(np.sin(self.tilt), f_y)

    @property
    def front(self) -> FloatArray:
        f_y = self.turned[0]
        return scaled(np.cos(self.tilt), f_y) - scaled(np.sin(self.tilt), self.frames.normal)

    @property
    def centre(self) -> FloatArray:
        return np.asarray(self.frames.position - self.cutter.tool_radius * self.front)

    @property
    def tip(self) -> FloatArray:
        return self.cutter.tip(self.centre, self.axis)

    @property
    def contact(self) -> FloatArray:
        return self.frames.position - self.cutter.corner_radius * self.frames.normal

    @property
    def turn(self) -> FloatArray:
        """Rotation vector per arc length [TL2008, Eq. 3.5-3.6]: Omega_R1 + yaw' n - tilt' t_y."""
        own = scaled(self.yaw_rate, self.frames.normal) - scaled(self.tilt_rate, self.turned[1])
        return np.asarray(self.frames.turn + own)

    def velocity(self, points: FloatArray) -> FloatArray:
        """Return V_P of points (n, ..., 3) of the mill per arc length of K [TL2008, Eq. 3.4]."""
        shape = (len(self), *[1] * (points.ndim - 2), 3)
        away = points - self.frames.position.reshape(shape)
        turn = np.broadcast_to(self.turn.reshape(shape), away.shape)
        return np.asarray(self.frames.feed.reshape(shape) + cross(turn, away))

    def rim(self, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return unit vectors from C_L to points of the corner circle, and their derivatives."""
        e_f, e_t = self.front, self.turned[1]
        c, s = np.cos(angle), np.sin(angle)
        return scaled(c, e_f) + scaled(s, e_t), scaled(c, e_t) - scaled(s, e_f)
