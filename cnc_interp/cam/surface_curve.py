"""Any curve of the guided point on the guiding surface, through points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from cnc_interp.cam.guiding import Frames
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.surface_point import SurfacePoint
from cnc_interp.cam.vectors import cross, norm, scaled, unit
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import UM

#: Distance of the points that show the change of direction of a curve [m].
NEAR = 1.0 * UM


@dataclass(frozen=True)
class SurfaceCurve:
    """A curve of the guided point K on the guiding surface."""

    surface: Surface  #: The surface to machine.
    offset: float  #: Corner radius r_c [m].
    parameters: BSpline  #: u and v by the approximate arc length of K.
    length: float  #: Value of that arc length at the end; it begins at 0 [m].

    @staticmethod
    def through(surface: Surface, offset: float, u: FloatArray, v: FloatArray) -> SurfaceCurve:
        """Interpolate points by a quintic spline."""
        position = surface.at(u, v).offset(offset).position
        s = np.concatenate([[0.0], np.cumsum(norm(np.diff(position, axis=0)))])
        spline = make_interp_spline(s, np.stack([u, v], axis=1), k=5)
        return SurfaceCurve(surface, offset, spline, float(s[-1]))

    def _feed(self, s: FloatArray) -> tuple[SurfacePoint, FloatArray, FloatArray]:
        """Return surface points, feed directions and the speed of K by s, shapes (n, ...)."""
        u, v = self.parameters(s).T
        u_s, v_s = self.parameters(s, 1).T
        point = self.surface.at(u, v)
        guide = point.offset(self.offset)
        run = scaled(u_s, guide.d_u) + scaled(v_s, guide.d_v)
        return point, unit(run), norm(run)

    def frames(self, s: FloatArray) -> Frames:
        """
        Return K and its frame; the rates are by arc length of K.

        Parameters
        ----------
        s : ndarray, shape (n,)
            Places on the curve [m].

        Returns
        -------
        Frames
            n frames.

        """
        point, feed, speed = self._feed(s)
        ahead, behind = self._feed(s + NEAR)[1], self._feed(s - NEAR)[1]
        n, n_s = point.normal, point.offset(self.offset).normal_rate(feed)
        f_s = scaled(0.5 / (NEAR * speed), ahead - behind)
        t = cross(feed, n)
        u, v = self.parameters(s).T
        return Frames(
            point.offset(self.offset).position, n, feed, t, n_s, f_s,
            cross(f_s, n) + cross(feed, n_s), u, v, point.curvature(t),
        )  # fmt: skip


def crossing(u: FloatArray, v: FloatArray) -> int:
    """Find where a line of parameters crosses itself."""
    n = len(u) - 1
    if n < 3:
        return -1
    du, dv = np.diff(u), np.diff(v)

    def side(i: slice, j: slice, shift: int) -> FloatArray:
        """Tell on which side of segments i the ends j lie, (i, j)."""
        x = u[j.start + shift : j.stop + shift][None, :] - u[i][:, None]
        y = v[j.start + shift : j.stop + shift][None, :] - v[i][:, None]
        return np.asarray(du[i][:, None] * y - dv[i][:, None] * x)

    whole = slice(0, n)
    apart = side(whole, whole, 0) * side(whole, whole, 1) < 0.0
    cut = apart & apart.T
    near = np.abs(np.arange(n)[:, None] - np.arange(n)[None, :]) < 2
    hit = (cut & ~near).any(axis=1)
    return int(np.argmax(hit)) if hit.any() else -1
