"""Stage 1: scallop points, where the envelope of the mill leaves the iso-scallop surface.

[TL2008, 3.1] in one unknown. At the angle phi of the corner circle the profile of the corner torus
is a circle about Q = C_L + R e. The envelope touches it where the tool normal m is perpendicular
to V_Q and to the circle of centres: m = unit(V_Q x e'). P = Q + r_c m then satisfies Eq. 3.2 and
3.3. Eq. 3.1 is ``height(P) = S_h``. It is solved from phi = 0, the contact point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.posture import Postures
from cnc_interp.cam.surface import Surface
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.vectors import cross, dot, scaled, unit

Angle = float | FloatArray

CLOSE = 1e-11  #: Largest distance of scallop points from the iso-scallop surface [m].
WIDEST = 1.55  #: Largest angle of the corner circle at which the envelope is sought [rad].


@dataclass(frozen=True)
class Scallops:
    """Scallop points on one side of a pass."""

    #: (n, 3): P [m]; NaN where ``found`` is false, like ``tangent`` and ``normal``.
    position: FloatArray
    #: (n, 3): Unit tangent of the scallop curve and unit normal of the surface [-].
    tangent: FloatArray
    normal: FloatArray
    angle: FloatArray  #: (n,): phi on the corner circle [rad].
    #: (n,): False where the mill does not reach the scallop height within its width.
    found: BoolArray
    #: (n,): Iterations that bracketed and that solved phi.
    marched: IntArray
    refined: IntArray

    def half_width(self, postures: Postures) -> FloatArray:
        """Return the distance of P from K across the feed, (n,) [m]."""
        away = self.position - postures.frames.position
        return np.abs(dot(away, postures.frames.across))


def envelope_point(postures: Postures, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the points at which the envelope touches the corner torus."""
    e, e_d = postures.rim(angle)
    centre = postures.centre + postures.cutter.tool_radius * e
    m = unit(cross(postures.velocity(centre), e_d))
    return np.asarray(centre + postures.cutter.corner_radius * m), m


def estimated_half_width(
    cutter: Cutter, tilt: Angle, yaw: Angle, curvature: FloatArray, height: float
) -> FloatArray:
    """Estimate half widths from the curvatures of tool and surface, 2 w = sqrt(8 h / kappa)."""
    sine = np.sin(tilt)
    swept = (cutter.tool_radius + cutter.corner_radius * sine) / np.maximum(sine, 1e-9)
    swept = swept * np.cos(yaw) ** 2 + cutter.corner_radius * np.sin(yaw) ** 2
    return np.asarray(np.sqrt(2.0 * height / np.maximum(1.0 / swept + curvature, 1e-3)))


def scallop_points(
    surface: Surface, postures: Postures, height: float, side: float = 1.0
) -> Scallops:
    """Find the scallop points of a pass."""
    frames, n = postures.frames, len(postures)
    u, v = frames.u.copy(), frames.v.copy()

    def miss(angle: FloatArray) -> FloatArray:
        nonlocal u, v
        point, _ = envelope_point(postures, side * angle)
        u, v, above = surface.project(point, u, v)
        return above - height

    cutter = postures.cutter
    sine = np.sin(postures.tilt)
    reach = np.maximum(cutter.tool_radius + cutter.corner_radius * sine, 1e-9)
    width = estimated_half_width(cutter, postures.tilt, postures.yaw, frames.curvature, height)
    guess = np.clip(1.05 * width / reach, 1e-4, 1.2)
    low, below = np.zeros(n), np.full(n, -height)
    high = guess
    marched, refined = np.ones(n, np.int64), np.zeros(n, np.int64)
    above = miss(high)
    while True:
        short = ~(above > 0.0) & (high < WIDEST)
        if not short.any():
            break
        marched += short
        low, below = np.where(short, high, low), np.where(short, above, below)
        high = np.where(short, np.minimum(1.25 * high, WIDEST), high)
        above = np.where(short, miss(high), above)
    found = above > 0.0
    angle, kept = high.copy(), np.zeros(n)
    for _ in range(40):
        # Illinois method: the value at the end that stays is halved.
        gap = np.where(found, above - below, 1.0)
        angle = np.where(found, (low * above - high * below) / gap, angle)
        value = miss(angle)
        active = found & (np.abs(value) > CLOSE)
        refined += active
        if not active.any():
            break
        up = value > 0.0
        below = np.where(up & (kept > 0.0), 0.5 * below, below)
        above = np.where(~up & (kept < 0.0), 0.5 * above, above)
        high, above = np.where(up, angle, high), np.where(up, value, above)
        low, below = np.where(up, low, angle), np.where(up, below, value)
        kept = np.where(up, 1.0, -1.0)
    point, m = envelope_point(postures, side * angle)
    u, v, _ = surface.project(point, u, v)
    normal = surface.at(u, v).normal
    tangent = unit(cross(m, normal))
    tangent = scaled(np.sign(dot(tangent, frames.feed)), tangent)
    found = found & np.isfinite(point).all(axis=1) & np.isfinite(normal).all(axis=1)
    missing = np.where(found, 0.0, np.nan)[:, None]
    return Scallops(
        point + missing, tangent + missing, normal + missing, angle, found, marched, refined
    )
