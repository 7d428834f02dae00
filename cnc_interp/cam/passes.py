"""Passes: a guiding curve with its angles; how wide it cuts, and whether the mill fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.posture import Postures
from cnc_interp.cam.scallop import Scallops, scallop_points
from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.vectors import dot
from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.units import DEG, MM, UM

#: The bottom of the mill is tested on this many rays and circles, out to C_L + R e.
RAYS, CIRCLES = 48, (0.4, 0.7, 1.0)
#: Points this far beyond the border are not the surface's any more [m].
BEYOND = 0.2 * MM


@dataclass(frozen=True)
class Angles:
    """
    Tilt and yaw along a pass: cubic splines through values, constant beyond them.

    Parameters
    ----------
    s : ndarray, shape (n,)
        Places, rising [m].
    tilt, yaw : ndarray, shape (n,)
        Values there [rad].

    """

    s: FloatArray
    tilt: FloatArray
    yaw: FloatArray

    def postures(self, curve: GuidingCurve, cutter: Cutter, s: FloatArray) -> Postures:
        """Return the postures at places of the curve."""
        inside = np.clip(s, self.s[0], self.s[-1])
        moving = (s >= self.s[0]) & (s <= self.s[-1])
        values = np.stack([self.tilt, self.yaw], axis=1)
        # Ends without curvature: the constant continuation joins without a kick.
        spline = CubicSpline(self.s, values, bc_type='natural')
        angle, rate = spline(inside), spline(inside, 1) * moving[:, None]
        frames = curve.frames(s)
        return Postures(cutter, frames, angle[:, 0], angle[:, 1], rate[:, 0], rate[:, 1])


@dataclass(frozen=True)
class Pass:
    """
    One pass of the mill.

    Parameters
    ----------
    curve : GuidingCurve
        What K follows.
    angles : Angles
        Tilt and yaw along it.
    s : ndarray, shape (n,)
        Places at which the scallop was computed [m].
    postures : Postures
        The postures there.
    right : Scallops
        Scallop points towards the next pass.
    iterations : ndarray of int, shape (n,)
        Newton steps of stage 2, zero in passes that were not fitted to the one before.
    fresh : bool
        True for the first pass and for those that do not continue the one before exactly.

    """

    curve: GuidingCurve
    angles: Angles
    s: FloatArray
    postures: Postures
    right: Scallops
    iterations: IntArray
    fresh: bool

    def tool(self, s: FloatArray) -> Postures:
        """Return the postures at places of the pass."""
        return self.angles.postures(self.curve, self.postures.cutter, s)

    @property
    def plane(self) -> float:
        """Place of the guiding plane along N [m]."""
        return self.curve.plane

    @property
    def reach(self) -> FloatArray:
        """Distance of the scallop points from the guiding plane, shape (n,) [m]."""
        return plane_distance(self.postures, self.right, self.curve.plane_normal)


def plane_distance(postures: Postures, scallops: Scallops, normal: FloatArray) -> FloatArray:
    """
    Return the distance of scallop points from the guiding plane, shape (n,) [m].

    The points are lifted to the guiding surface first: on a slope the contact does not lie in the
    guiding plane, and only there left and right half widths are alike.
    """
    lifted = scallops.position + postures.cutter.corner_radius * scallops.normal
    return np.abs(dot(lifted - postures.frames.position, normal))


def evenly(curve: GuidingCurve, count: int) -> FloatArray:
    """Return places along a whole curve, shape (count,) [m]."""
    return np.linspace(0.0, curve.length, count)


def constant_tilt(curve: GuidingCurve, tilt: float, yaw: float, count: int) -> Angles:
    """Return the same angles all along."""
    s = evenly(curve, count)
    return Angles(s, np.full(count, tilt), np.full(count, yaw))


def constant_width(
    curve: GuidingCurve, cutter: Cutter, height: float, half_width: float,
    limits: tuple[float, float], yaw: float, count: int,
) -> Angles:  # fmt: skip
    """
    Find the tilts with which the scallop lies in a plane parallel to the guiding plane.

    Parameters
    ----------
    curve : GuidingCurve
        What K follows.
    cutter : Cutter
        The mill.
    height, half_width : float
        Scallop height and distance of the scallop from the guiding plane [m].
    limits : (float, float)
        Smallest and largest tilt [rad].
    yaw : float
        Yaw [rad].
    count : int
        Points along the curve.

    Raises
    ------
    SurfaceError
        If the tilt would leave its limits; names the place and the widths that can be had.

    """
    s = evenly(curve, count)
    bend = curve.frames(s).curvature
    local = half_width / np.maximum(1.0 + cutter.corner_radius * bend, 0.1)
    wanted = 2.0 * height / local**2 - bend
    for _ in range(12):
        angles = Angles(s, tilt_of_curvature(cutter, wanted, limits), np.full(count, yaw))
        postures = angles.postures(curve, cutter, s)
        right = scallop_points(curve.surface, postures, height)
        # Where nothing was found the strip is wider than the mill.
        reach = plane_distance(postures, right, curve.plane_normal)
        reach = np.where(right.found, reach, 2.0 * half_width)
        if float(np.abs(reach - half_width).max()) < 0.02 * UM:
            break
        sine = np.sin(angles.tilt)
        held = sine / (cutter.tool_radius + cutter.corner_radius * sine)
        wanted = np.maximum(held + bend, 0.1) * (reach / half_width) ** 2 - bend
    wrong = np.abs(reach - half_width) > 0.005 * half_width
    if wrong.any():
        i = int(np.argmax(np.abs(reach - half_width)))
        wide = reach[i] < half_width
        raise SurfaceError(
            f'a strip of {2.0 * half_width / MM:.3f} mm is too {"wide" if wide else "narrow"} at '
            f'{place(postures.contact[i])}: with the tilt at its '
            f'{"smallest" if wide else "largest"}, {(limits[0] if wide else limits[1]) / DEG:.3g} '
            f'deg, it becomes {2.0 * reach[i] / MM:.3f} mm; take a '
            f'{"smaller" if wide else "larger"} plane distance or other tilt limits'
        )
    return angles


def tilt_of_curvature(
    cutter: Cutter, curvature: FloatArray, limits: tuple[float, float]
) -> FloatArray:
    """Return the tilts whose swept profile has a curvature [1/m], within limits [rad]."""
    R, r = cutter.tool_radius, cutter.corner_radius
    sine = curvature * R / np.maximum(1.0 - curvature * r, 1e-6)
    return np.asarray(np.arcsin(np.clip(sine, np.sin(limits[0]), np.sin(limits[1]))))


def gouge_depth(surface: Surface, postures: Postures) -> FloatArray:
    """
    Return how deep the bottom of the mill enters the surface, shape (n,) [m].

    The equations see the fillet at the contact only. Here circles of the bottom, out to the
    corner circle all round the heel, must stay r_c above the surface.
    """
    cutter, frames = postures.cutter, postures.frames
    depth = np.zeros(len(postures))
    if cutter.is_ball:
        return depth
    turn = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    e = (
        postures.front[:, None, :] * np.cos(turn)[None, :, None]
        + postures.turned[1][:, None, :] * np.sin(turn)[None, :, None]
    )
    (u0, u1), (v0, v1) = surface.domain
    grow = surface.growth(BEYOND)
    for part in CIRCLES:
        points = postures.centre[:, None, :] + part * cutter.tool_radius * e
        guess = np.broadcast_to(frames.u[:, None], points.shape[:2])
        u, v, above = surface.project(
            points, guess, np.broadcast_to(frames.v[:, None], guess.shape)
        )
        ours = (
            (u >= u0 - grow[0]) & (u <= u1 + grow[0]) & (v >= v0 - grow[1]) & (v <= v1 + grow[1])
        )
        deep = np.where(ours & np.isfinite(above), cutter.corner_radius - above, 0.0)
        depth = np.maximum(depth, deep.max(axis=1))
    return depth


def place(point: FloatArray) -> str:
    """Name a point in mm."""
    x, y, z = point / MM
    return f'({x:.2f}, {y:.2f}, {z:.2f}) mm'
