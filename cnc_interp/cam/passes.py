"""Passes along guiding curves: their angles, their width and the check that the mill fits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.posture import Postures
from cnc_interp.cam.scallop import Scallops, scallop_points
from cnc_interp.cam.surface import SurfaceError
from cnc_interp.cam.vectors import dot
from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.units import DEG, MM, UM


@dataclass(frozen=True)
class Angles:
    """
    Tilt and yaw along a pass: cubic splines through values, constant beyond them.

    Parameters
    ----------
    s : ndarray, shape (n,)
        Places in increasing order [m].
    tilt, yaw : ndarray, shape (n,)
        Angles there [rad].

    """

    s: FloatArray
    tilt: FloatArray
    yaw: FloatArray

    def postures(self, curve: GuidingCurve, cutter: Cutter, s: FloatArray) -> Postures:
        """
        Return the postures at places of a curve.

        Parameters
        ----------
        curve : GuidingCurve
            The guiding curve.
        cutter : Cutter
            The mill.
        s : ndarray, shape (m,)
            Places [m].

        Returns
        -------
        Postures
            m postures.

        """
        inside = np.clip(s, self.s[0], self.s[-1])
        moving = (s >= self.s[0]) & (s <= self.s[-1])
        values = np.stack([self.tilt, self.yaw], axis=1)
        # Natural ends: the second derivative joins the constant continuation without a jump.
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
        Path of the guided point K.
    angles : Angles
        Tilt and yaw along it.
    s : ndarray, shape (n,)
        Places of the scallop points [m].
    postures : Postures
        The postures there.
    right : Scallops
        Scallop points on the side of the next pass.
    iterations : ndarray of int, shape (n,)
        Newton steps of stage 2; zero in passes that were not fitted to the previous pass.
    fresh : bool
        True for the first pass and for passes that do not continue the previous pass exactly.

    """

    curve: GuidingCurve
    angles: Angles
    s: FloatArray
    postures: Postures
    right: Scallops
    iterations: IntArray
    fresh: bool

    def tool(self, s: FloatArray) -> Postures:
        """
        Return the postures at places of the pass.

        Parameters
        ----------
        s : ndarray, shape (m,)
            Places [m].

        Returns
        -------
        Postures
            m postures.

        """
        return self.angles.postures(self.curve, self.postures.cutter, s)

    @property
    def plane(self) -> float:
        """Distance of the guiding plane from the origin along N [m]."""
        return self.curve.plane

    @property
    def reach(self) -> FloatArray:
        """
        Distance of the scallop points from the guiding plane.

        Returns
        -------
        ndarray, shape (n,)
            Half widths at the places ``s`` [m].

        """
        return plane_distance(self.postures, self.right, self.curve.plane_normal)


def plane_distance(postures: Postures, scallops: Scallops, normal: FloatArray) -> FloatArray:
    """
    Return the distance of scallop points from the guiding plane.

    The points are first lifted to the guiding surface. On a slope the contact point does not lie
    in the guiding plane, and only on the guiding surface the left and right half widths agree.

    Parameters
    ----------
    postures : Postures
        n postures of the pass.
    scallops : Scallops
        Their n scallop points.
    normal : ndarray, shape (3,)
        Unit normal N of the guiding planes [-].

    Returns
    -------
    ndarray, shape (n,)
        Distances [m].

    """
    lifted = scallops.position + postures.cutter.corner_radius * scallops.normal
    return np.abs(dot(lifted - postures.frames.position, normal))


def evenly(curve: GuidingCurve, count: int) -> FloatArray:
    """
    Return places at equal distances along a whole curve.

    Parameters
    ----------
    curve : GuidingCurve
        The curve.
    count : int
        Number of places.

    Returns
    -------
    ndarray, shape (count,)
        Places [m].

    """
    return np.linspace(0.0, curve.length, count)


def constant_tilt(curve: GuidingCurve, tilt: float, yaw: float, count: int) -> Angles:
    """
    Return constant angles.

    Parameters
    ----------
    curve : GuidingCurve
        The guiding curve.
    tilt, yaw : float
        Angles [rad].
    count : int
        Number of places.

    Returns
    -------
    Angles

    """
    s = evenly(curve, count)
    return Angles(s, np.full(count, tilt), np.full(count, yaw))


def constant_width(
    curve: GuidingCurve, cutter: Cutter, height: float, half_width: float,
    limits: tuple[float, float], yaw: float, count: int,
) -> Angles:  # fmt: skip
    """
    Find the tilts for which the scallop lies in a plane parallel to the guiding plane.

    Parameters
    ----------
    curve : GuidingCurve
        Path of the guided point K.
    cutter : Cutter
        The mill.
    height : float
        Scallop height [m].
    half_width : float
        Distance of the scallop from the guiding plane [m].
    limits : (float, float)
        Smallest and largest tilt [rad].
    yaw : float
        Yaw [rad].
    count : int
        Number of places along the curve.

    Returns
    -------
    Angles

    Raises
    ------
    SurfaceError
        If a tilt would leave its limits; the message names the place and the possible width.

    """
    s = evenly(curve, count)
    bend = curve.frames(s).curvature
    local = half_width / np.maximum(1.0 + cutter.corner_radius * bend, 0.1)
    wanted = 2.0 * height / local**2 - bend
    for _ in range(12):
        angles = Angles(s, tilt_of_curvature(cutter, wanted, limits), np.full(count, yaw))
        postures = angles.postures(curve, cutter, s)
        right = scallop_points(curve.surface, postures, height)
        # Where no scallop was found, the strip is wider than the mill.
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
    """
    Return the tilts for which the swept profile has a curvature.

    Parameters
    ----------
    cutter : Cutter
        The mill.
    curvature : ndarray, shape (n,)
        Curvatures of the swept profile [1/m].
    limits : (float, float)
        Smallest and largest tilt [rad].

    Returns
    -------
    ndarray, shape (n,)
        Tilts within the limits [rad].

    """
    R, r = cutter.tool_radius, cutter.corner_radius
    sine = curvature * R / np.maximum(1.0 - curvature * r, 1e-6)
    return np.asarray(np.arcsin(np.clip(sine, np.sin(limits[0]), np.sin(limits[1]))))


def place(point: FloatArray) -> str:
    """
    Write a point in mm.

    Parameters
    ----------
    point : ndarray, shape (3,)
        The point [m].

    Returns
    -------
    str

    """
    x, y, z = point / MM
    return f'({x:.2f}, {y:.2f}, {z:.2f}) mm'
