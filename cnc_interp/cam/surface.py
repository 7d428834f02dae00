"""
Surfaces S(u, v): position, normals, curvatures, foot points; and what makes one unfit.

The normal n points out of the material. Curvatures are positive where the surface is convex:
``kappa(d) = n_d . d`` for a unit tangent d, so that the offset ``S + h n`` is regular while
``1 + h kappa > 0`` for both principal curvatures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.spatial import cKDTree

from cnc_interp.cam.vectors import cross, dot, norm, scaled
from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM

#: Ranges of u and v.
Domain = tuple[tuple[float, float], tuple[float, float]]

#: Foot points are found to this distance [m].
FOOT = 1e-13
#: Samples per direction of the checks over the whole surface.
SAMPLES = 121


class SurfaceError(InterpError):
    """A surface that cannot be machined as asked; the message says where and why."""


@dataclass(frozen=True)
class SurfacePoint:
    """
    A surface at parameters of any common shape (...).

    Parameters
    ----------
    position, d_u, d_v : ndarray, shape (..., 3)
        S and its first derivatives [m].
    normal, n_u, n_v : ndarray, shape (..., 3)
        Unit normal out of the material, and its derivatives.

    """

    position: FloatArray
    d_u: FloatArray
    d_v: FloatArray
    normal: FloatArray
    n_u: FloatArray
    n_v: FloatArray

    def offset(self, distance: float) -> SurfacePoint:
        """Return the same points of the surface S + distance n."""
        return SurfacePoint(
            self.position + distance * self.normal,
            self.d_u + distance * self.n_u,
            self.d_v + distance * self.n_v,
            self.normal,
            self.n_u,
            self.n_v,
        )

    def components(self, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a, b with ``tangent = a S_u + b S_v``."""
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        p, q = dot(self.d_u, tangent), dot(self.d_v, tangent)
        determinant = e * g - f * f
        return (g * p - f * q) / determinant, (e * q - f * p) / determinant

    def normal_rate(self, tangent: FloatArray) -> FloatArray:
        """Return the change of n along a tangent vector, shape (..., 3)."""
        a, b = self.components(tangent)
        return scaled(a, self.n_u) + scaled(b, self.n_v)

    def curvature(self, tangent: FloatArray) -> FloatArray:
        """Return the normal curvature along unit tangents, convex positive [1/m]."""
        return dot(self.normal_rate(tangent), tangent)

    def principal_curvatures(self) -> tuple[FloatArray, FloatArray]:
        """Return the smallest and the largest normal curvature, convex positive [1/m]."""
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        l, m, n = dot(self.n_u, self.d_u), dot(self.n_u, self.d_v), dot(self.n_v, self.d_v)
        area = e * g - f * f
        mean = (e * n - 2.0 * f * m + g * l) / (2.0 * area)
        spread = np.sqrt(np.maximum(mean**2 - (l * n - m * m) / area, 0.0))
        return mean - spread, mean + spread


class Surface(ABC):
    """
    A regular parametric surface over a rectangle, defined a little beyond its border too.

    Parameters
    ----------
    domain : ((float, float), (float, float))
        Ranges of u and v.
    flip : bool
        The normal is S_u x S_v, or the opposite with ``flip``.

    """

    def __init__(self, domain: Domain, flip: bool = False):
        self.domain = domain
        self.sign = -1.0 if flip else 1.0

    @abstractmethod
    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return S, S_u, S_v, S_uu, S_uv, S_vv, each of shape (..., 3)."""

    def at(self, u: FloatArray, v: FloatArray) -> SurfacePoint:
        """Return points, tangents, normals and their derivatives."""
        s, s_u, s_v, s_uu, s_uv, s_vv = self.derivatives(u, v)
        m = self.sign * cross(s_u, s_v)
        with np.errstate(invalid='ignore', divide='ignore'):
            size = 1.0 / norm(m)
            n = scaled(size, m)
            m_u = self.sign * (cross(s_uu, s_v) + cross(s_u, s_uv))
            m_v = self.sign * (cross(s_uv, s_v) + cross(s_u, s_vv))
            n_u = scaled(size, m_u - scaled(dot(n, m_u), n))
            n_v = scaled(size, m_v - scaled(dot(n, m_v), n))
        return SurfacePoint(s, s_u, s_v, n, n_u, n_v)

    def project(
        self, points: FloatArray, u: FloatArray, v: FloatArray, sweeps: int = 30
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """
        Find the foot points of points near the surface, by Newton's method.

        Parameters
        ----------
        points : ndarray, shape (..., 3)
            Points [m].
        u, v : ndarray, shape (...)
            First guesses.
        sweeps : int
            Most iterations; those that have not converged get NaN as height.

        Returns
        -------
        u, v : ndarray, shape (...)
            Parameters of the foot points; the surface continues beyond its border.
        height : ndarray, shape (...)
            Signed distance along the normal [m].

        """
        u, v = np.array(u, float), np.array(v, float)
        longest = 0.25 * np.array([high - low for low, high in self.domain])
        moved = np.full(u.shape, np.inf)
        for _ in range(sweeps):
            s, s_u, s_v, s_uu, s_uv, s_vv = self.derivatives(u, v)
            away = s - points
            a, b, c = dot(s_u, s_u), dot(s_u, s_v), dot(s_v, s_v)
            full = a + dot(away, s_uu), b + dot(away, s_uv), c + dot(away, s_vv)
            # Beyond a centre of curvature the true Hessian leads away; Gauss-Newton does not.
            sound = (full[0] * full[2] - full[1] ** 2 > 0.01 * (a * c - b * b)) & (full[0] > 0.0)
            a, b, c = (np.where(sound, x, y) for x, y in zip(full, (a, b, c), strict=True))
            p, q = dot(away, s_u), dot(away, s_v)
            determinant = a * c - b * b
            du = np.clip(-(c * p - b * q) / determinant, -longest[0], longest[0])
            dv = np.clip(-(a * q - b * p) / determinant, -longest[1], longest[1])
            u, v = u + du, v + dv
            moved = norm(scaled(du, s_u) + scaled(dv, s_v))
            if not np.any(moved > FOOT):
                break
        point = self.at(u, v)
        height = dot(points - point.position, point.normal)
        return u, v, np.where(moved < 1e-9, height, np.nan)

    def grid(self, rows: int, columns: int, extension: float = 0.0) -> tuple[FloatArray, ...]:
        """Return u and v, shape (rows, columns), over the domain grown by ``extension`` [m]."""
        (u0, u1), (v0, v1) = self.domain
        grow_u, grow_v = self.growth(extension) if extension else (0.0, 0.0)
        u, v = np.meshgrid(
            np.linspace(u0 - grow_u, u1 + grow_u, rows),
            np.linspace(v0 - grow_v, v1 + grow_v, columns),
            indexing='ij',
        )
        return u, v

    def growth(self, extension: float) -> tuple[float, float]:
        """Return how far u and v go beyond the domain to reach ``extension`` [m] everywhere."""
        u, v = self.grid(9, 9)
        _, s_u, s_v, *_ = self.derivatives(u, v)
        return extension / float(np.median(norm(s_u))), extension / float(np.median(norm(s_v)))

    def check(self, offset: float = 0.0) -> None:
        """
        Refuse a surface that folds, or whose offset does.

        Raises
        ------
        SurfaceError
            Naming the place, the smallest concave radius and the radius asked for.

        """
        u, v = self.grid(SAMPLES, SAMPLES)
        point = self.at(u, v)
        area = norm(cross(point.d_u, point.d_v))
        if not np.isfinite(point.position).all():
            raise SurfaceError('the surface has points that are not finite')
        bad = area < 1e-6 * float(np.median(area))
        if bad.any():
            raise SurfaceError(f'the surface is degenerate at {_place(point, bad)}')
        n = point.normal
        turned = np.zeros(bad.shape, bool)
        turned[1:] |= dot(n[1:], n[:-1]) < 0.0
        turned[:, 1:] |= dot(n[:, 1:], n[:, :-1]) < 0.0
        if turned.any():
            raise SurfaceError(
                f'the surface folds at {_place(point, turned)}; machine both sides as two surfaces'
            )
        smallest = point.principal_curvatures()[0]
        if float(smallest.min()) * offset <= -1.0:
            tightest = smallest == smallest.min()
            radius = -1.0 / float(smallest.min()) / MM
            raise SurfaceError(
                f'a corner radius of {offset / MM:g} mm does not fit: the smallest concave radius '
                f'is {radius:.3g} mm at {_place(point, tightest)}'
            )
        if offset > 0.0:
            self._check_far_parts(point, offset)

    def _check_far_parts(self, point: SurfacePoint, offset: float) -> None:
        """Refuse an offset that enters another part of the surface."""
        samples = point.position.reshape(-1, 3)
        tree = cKDTree(samples)
        near, _ = tree.query(point.offset(offset).position.reshape(-1, 3))
        inside = (near < 0.98 * offset).reshape(point.normal.shape[:2])
        if inside.any():
            raise SurfaceError(
                f'the offset by {offset / MM:g} mm meets another part of the surface at '
                f'{_place(point, inside)}; take a smaller corner radius'
            )


def _place(point: SurfacePoint, where: BoolArray) -> str:
    """Name the first point where a condition holds."""
    x, y, z = point.position[tuple(np.argwhere(where)[0])] / MM
    return f'({x:.2f}, {y:.2f}, {z:.2f}) mm'


class BSplineSurface(Surface):
    """
    Tensor-product B-spline surface; beyond its border the last spans continue.

    Parameters
    ----------
    knots : (ndarray, ndarray)
        Knot vectors of u and v.
    control_points : ndarray, shape (n_u, n_v, 3)
        Control points [m].
    degree : (int, int)
        Degrees in u and v, at least 2.
    flip : bool
        Turn the normal round.

    Examples
    --------
    A surface through a grid of points:

    >>> surface = BSplineSurface.through(points)

    """

    def __init__(
        self,
        knots: tuple[FloatArray, FloatArray],
        control_points: FloatArray,
        degree: tuple[int, int] = (3, 3),
        flip: bool = False,
    ):
        for t, k, n, name in zip(knots, degree, control_points.shape, 'uv', strict=False):
            if k < 2:
                raise SurfaceError(f'degree {k} in {name}: curvatures need degree 2 or more')
            if len(t) != n + k + 1:
                raise SurfaceError(
                    f'{len(t)} knots in {name} for {n} control points of degree {k}; '
                    f'there must be {n + k + 1}'
                )
            if np.any(np.diff(t) < 0.0) or not t[k] < t[n]:
                raise SurfaceError(f'the knots in {name} must not fall')
        if control_points.ndim != 3 or control_points.shape[2] != 3:
            raise SurfaceError('control points must have the shape (n_u, n_v, 3)')
        self.spline = NdBSpline(tuple(np.asarray(t, float) for t in knots), control_points, degree)
        u, v = ((float(t[k]), float(t[-k - 1])) for t, k in zip(knots, degree, strict=True))
        super().__init__((u, v), flip)

    @staticmethod
    def through(points: FloatArray, flip: bool = False) -> BSplineSurface:
        """
        Interpolate a grid of points by a bicubic surface.

        Parameters
        ----------
        points : ndarray, shape (n_u, n_v, 3)
            At least four by four points [m].
        flip : bool
            Turn the normal round.

        """
        points = np.asarray(points, float)
        if points.ndim != 3 or min(points.shape[:2]) < 4 or points.shape[2] != 3:
            raise SurfaceError('a surface through points needs a grid of at least 4 x 4 points')
        knots = []
        control = points
        for axis in (0, 1):
            steps = np.mean(norm(np.diff(points, axis=axis)), axis=1 - axis)
            if not np.all(steps > 0.0):
                raise SurfaceError('neighbouring rows of points coincide')
            at = np.concatenate([[0.0], np.cumsum(steps)]) / np.sum(steps)
            spline = make_interp_spline(at, control, k=3, axis=axis)
            knots.append(spline.t)
            control = np.moveaxis(spline.c, 0, axis) if spline.axis == axis else spline.c
        return BSplineSurface((knots[0], knots[1]), np.ascontiguousarray(control), (3, 3), flip)

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return S, S_u, S_v, S_uu, S_uv, S_vv."""
        at = np.stack([np.asarray(u, float), np.asarray(v, float)], axis=-1)
        orders = (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)
        return tuple(np.asarray(self.spline(at, nu=order)) for order in orders)
