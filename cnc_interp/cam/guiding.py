"""Guiding curves: sections of the guiding surface S_G = S + r_c n by guiding planes [TL2008, 3.2].

The unit normal N of the plane points to the next pass. Along the curve the feed direction
is f = n x N / |n x N|. The direction t = f x n points to the next pass, too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from contourpy import contour_generator
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import label

from cnc_interp.cam.surface import Surface, SurfaceError, demand
from cnc_interp.core import MM, FloatArray, cross, dot, norm, scaled

CELLS = 200  #: Cells per direction of the grid in which curves are searched.
STEP = 0.4 * MM  #: Largest distance of the points of a curve [m].
STEEP = 0.05  #: Smallest sine of the angle between a guiding plane and the surface [-].


@dataclass(frozen=True)
class CurveFrames:
    """The guided point K and its frame at n points of a curve, with derivatives by arc length."""

    position: FloatArray  #: (n, 3): K on the guiding surface [m].
    #: (n, 3): Orthonormal frame n, f, t = f x n [-].
    normal: FloatArray
    feed: FloatArray
    across: FloatArray
    #: (n, 3): Derivatives of the frame by arc length of K [1/m].
    normal_rate: FloatArray
    feed_rate: FloatArray
    across_rate: FloatArray
    #: (n,): Surface parameters [units of u and v].
    u: FloatArray
    v: FloatArray
    #: (n,): Normal curvature of the surface across the feed, positive where convex [1/m].
    curvature: FloatArray

    def __len__(self) -> int:
        return len(self.u)

    @property
    def turn(self) -> FloatArray:
        """Rotation vector of the frame, half the sum of x_i x x_i' [rad/m] [TL2008, appendix]."""
        total = cross(self.feed, self.feed_rate) + cross(self.normal, self.normal_rate)
        return 0.5 * (total + cross(self.across, self.across_rate))


@dataclass(frozen=True)
class GuidingCurve:
    surface: Surface  #: The surface to machine.
    offset: float  #: Corner radius r_c: distance of the guiding surface [m].
    plane_normal: FloatArray  #: (3,): N [-].
    plane: float  #: Distance of the plane from the origin along N [m].
    parameters: BSpline  #: u and v by arc length of K.
    length: float  #: Arc length of the curve, which begins at 0 [m].

    def frames(self, s: FloatArray) -> CurveFrames:
        """Return K and its frame at arc lengths (n,) [m]; the curve continues beyond its ends."""
        uv = self.parameters(s)
        u, v = uv[..., 0], uv[..., 1]
        surface = self.surface.at(u, v)
        guide = surface.offset(self.offset)
        n, N = surface.normal, self.plane_normal
        g = cross(n, np.broadcast_to(N, n.shape))
        size = norm(g)
        f = scaled(1.0 / size, g)
        n_s = guide.normal_rate(f)
        g_s = cross(n_s, np.broadcast_to(N, n.shape))
        f_s = scaled(1.0 / size, g_s - scaled(dot(g_s, f), f))
        t = cross(f, n)
        t_s = cross(f_s, n) + cross(f, n_s)
        return CurveFrames(guide.position, n, f, t, n_s, f_s, t_s, u, v, surface.curvature(t))


class GuidingPlanes:
    """The guiding curves in parallel planes, up to the border of the offset surface."""

    def __init__(
        self, surface: Surface, offset: float, plane_normal: FloatArray, extension: float
    ):
        self.surface, self.offset, self.plane_normal = surface, offset, plane_normal
        self.extension = extension
        self._u, self._v = surface.grid(CELLS + 1, CELLS + 1, extension)
        point = surface.at(self._u, self._v)
        across = np.broadcast_to(plane_normal, point.normal.shape)
        cuts = norm(cross(point.normal, across)) >= STEEP
        over = surface.contains(self._u, self._v)
        if not cuts[over].all():
            x, y, z = point.position[over & ~cuts][0] / MM
            raise SurfaceError(
                f'a guiding plane touches the surface at ({x:.2f}, {y:.2f}, {z:.2f}) mm instead '
                'of cutting it; choose another direction of the passes'
            )
        with np.errstate(invalid='ignore', divide='ignore', over='ignore'):
            smallest = point.principal_curvatures()[0]
        parts, _ = label(cuts & (1.0 + offset * smallest > 0.0))
        ours = np.isin(parts, np.unique(parts[over & (parts > 0)]))
        level = point.offset(offset).position @ plane_normal
        self._level = np.where(ours, level, np.nan)
        u, v = surface.grid(CELLS + 1, CELLS + 1)
        level = surface.at(u, v).offset(offset).position @ plane_normal
        level = level[surface.contains(u, v)]
        #: Range of the planes whose contact points lie on the surface itself [m].
        self.span = float(level.min()), float(level.max())

    def curve(self, plane: float) -> GuidingCurve:
        """Return the curve in a plane at this distance along N [m]; SurfaceError if none."""
        surface = self.surface
        generator = contour_generator(self._u, self._v, self._level)
        lines, lengths = [], []
        for line in map(np.asarray, generator.lines(plane)):
            if len(line) > 3:
                lines.append(line)
                lengths.append(self._length(line))
        demand(lines, f'the guiding plane at {plane / MM:.3f} mm misses the surface')
        # Only planes that the strips of passes can reach count, if there are any.
        reachable = 0.5 * self.extension
        near = [self._length(x[surface.contains(x[:, 0], x[:, 1], reachable)]) for x in lines]
        lengths = near if any(near) else lengths
        longest = int(np.argmax(lengths))
        demand(
            sum(lengths) <= 1.2 * lengths[longest],
            f'the guiding plane at {plane / MM:.3f} mm meets the surface in {len(lines)} '
            'curves; split the surface or choose another direction of the passes',
        )
        return self._fit(lines[longest], plane)

    def _length(self, line: FloatArray) -> float:
        position = self.surface.derivatives(line[:, 0], line[:, 1])[0]
        return float(norm(np.diff(position, axis=0)).sum())

    def _fit(self, line: FloatArray, plane: float) -> GuidingCurve:
        """Fit a quintic spline through exact points of the curve, evenly spaced by arc length."""
        count = max(48, int(self._length(line) / STEP))
        uv = self._onto(line, plane)
        for degree in (1, 5):  # first along the points of the contour, then along the smooth curve
            s = self._arc(uv)
            kept = np.concatenate([[True], np.diff(s) > 1e-3 * s[-1] / count])
            spline = make_interp_spline(s[kept], uv[kept], k=degree)
            uv = self._onto(spline(np.linspace(0.0, s[-1], count)), plane)
        s = self._arc(uv)
        curve = GuidingCurve(
            self.surface,
            self.offset,
            self.plane_normal,
            plane,
            make_interp_spline(s, uv, k=5),
            float(s[-1]),
        )
        ends = curve.surface.at(uv[:2, 0], uv[:2, 1]).offset(self.offset).position
        if float(np.dot(ends[1] - ends[0], curve.frames(s[:1]).feed[0])) < 0.0:
            reverse = make_interp_spline(s[-1] - s[::-1], uv[::-1], k=5)
            return replace(curve, parameters=reverse)
        return curve

    def _onto(self, uv: FloatArray, plane: float) -> FloatArray:
        for _ in range(6):
            point = self.surface.at(uv[:, 0], uv[:, 1]).offset(self.offset)
            level = point.position @ self.plane_normal - plane
            slope = point.d_u @ self.plane_normal, point.d_v @ self.plane_normal
            e, g = dot(point.d_u, point.d_u), dot(point.d_v, point.d_v)
            f = dot(point.d_u, point.d_v)
            a, b = g * slope[0] - f * slope[1], e * slope[1] - f * slope[0]
            step = -level / (a * slope[0] + b * slope[1])
            uv = uv + np.stack([step * a, step * b], axis=1)
            if float(np.abs(level).max()) < 1e-12:
                break
        return uv

    def _arc(self, uv: FloatArray) -> FloatArray:
        point = self.surface.at(uv[:, 0], uv[:, 1]).offset(self.offset)
        g = cross(point.normal, np.broadcast_to(self.plane_normal, point.normal.shape))
        f = scaled(1.0 / norm(g), g)
        chords = norm(np.diff(point.position, axis=0))
        half_turn = 0.5 * np.arccos(np.clip(dot(f[1:], f[:-1]), -1.0, 1.0))
        arcs = chords / np.maximum(np.sinc(half_turn / np.pi), 0.5)
        return np.concatenate([[0.0], np.cumsum(arcs)])
