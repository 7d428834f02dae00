"""Surfaces S(u, v): position, normal, curvature, foot points and checks.

The normal n points out of the material. Curvatures are positive where the surface is convex:
``kappa(d) = n_d . d`` for a unit tangent d. The offset ``S + h n`` is therefore regular while
``1 + h kappa > 0`` for both principal curvatures.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from cnc_interp.core import MM, BoolArray, FloatArray, InterpError, cross, dot, norm, scaled


@dataclass(frozen=True)
class SurfacePoint:
    """Points of a surface, with tangents and normals, for parameters of any common shape (...)."""

    position: FloatArray  #: (..., 3): S [m].
    #: (..., 3): First derivatives of S [m per unit of u or v].
    d_u: FloatArray
    d_v: FloatArray
    normal: FloatArray  #: (..., 3): Unit normal, out of the material [-].
    #: (..., 3): First derivatives of the normal [1 per unit of u or v].
    n_u: FloatArray
    n_v: FloatArray

    def offset(self, distance: float) -> SurfacePoint:
        return replace(
            self,
            position=self.position + distance * self.normal,
            d_u=self.d_u + distance * self.n_u,
            d_v=self.d_v + distance * self.n_v,
        )

    def components(self, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a and b with ``tangent = a S_u + b S_v``."""
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        p, q = dot(self.d_u, tangent), dot(self.d_v, tangent)
        determinant = e * g - f * f
        return (g * p - f * q) / determinant, (e * q - f * p) / determinant

    def normal_rate(self, tangent: FloatArray) -> FloatArray:
        a, b = self.components(tangent)
        return scaled(a, self.n_u) + scaled(b, self.n_v)

    def curvature(self, tangent: FloatArray) -> FloatArray:
        return dot(self.normal_rate(tangent), tangent)

    def principal_curvatures(self) -> tuple[FloatArray, FloatArray]:
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        l, m, n = dot(self.n_u, self.d_u), dot(self.n_u, self.d_v), dot(self.n_v, self.d_v)
        area = e * g - f * f
        mean = (e * n - 2.0 * f * m + g * l) / (2.0 * area)
        spread = np.sqrt(np.maximum(mean**2 - (l * n - m * m) / area, 0.0))
        return mean - spread, mean + spread


Domain = tuple[tuple[float, float], tuple[float, float]]  #: Ranges of u and v.

FOOT = 1e-13  #: Largest error of foot points [m].
MOST_STEPS = 30  #: Largest number of Newton steps to a foot point.
SAMPLES = 121  #: Samples per direction in the checks of the whole surface.


class SurfaceError(InterpError):
    """A surface that cannot be machined as requested; the message names place and reason."""


def demand(holds: object, text: str) -> None:
    """Raise SurfaceError unless a condition on the surface holds."""
    if not holds:
        raise SurfaceError(text)


class Surface(ABC):
    """A regular parametric surface over a rectangle; it continues a little beyond its border."""

    def __init__(self, domain: Domain, flip: bool = False):
        self.domain = domain
        self.sign = -1.0 if flip else 1.0

    @abstractmethod
    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""

    def at(self, u: FloatArray, v: FloatArray) -> SurfacePoint:
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
        self, points: FloatArray, u: FloatArray, v: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        u, v = np.array(u, float), np.array(v, float)
        longest = 0.25 * np.array([high - low for low, high in self.domain])
        moved = np.full(u.shape, np.inf)
        for _ in range(MOST_STEPS):
            s, s_u, s_v, s_uu, s_uv, s_vv = self.derivatives(u, v)
            away = s - points
            a, b, c = dot(s_u, s_u), dot(s_u, s_v), dot(s_v, s_v)
            full = a + dot(away, s_uu), b + dot(away, s_uv), c + dot(away, s_vv)
            # Beyond a centre of curvature the exact Hessian leads away; Gauss-Newton does not.
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
        """Return u and v, (rows, columns), on a grid ``extension`` [m] beyond the domain."""
        (u0, u1), (v0, v1) = self.domain
        grow_u, grow_v = self.growth(extension) if extension else (0.0, 0.0)
        u, v = np.meshgrid(
            np.linspace(u0 - grow_u, u1 + grow_u, rows),
            np.linspace(v0 - grow_v, v1 + grow_v, columns),
            indexing='ij',
        )
        return u, v

    def growth(self, extension: float) -> tuple[float, float]:
        u, v = self.grid(9, 9)
        _, s_u, s_v, *_ = self.derivatives(u, v)
        return extension / float(np.median(norm(s_u))), extension / float(np.median(norm(s_v)))

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        (u0, u1), (v0, v1) = self.domain
        grow = self.growth(margin) if margin else (0.0, 0.0)
        grow_u, grow_v = grow[0] + 1e-9 * (u1 - u0), grow[1] + 1e-9 * (v1 - v0)
        along = (u >= u0 - grow_u) & (u <= u1 + grow_u)
        return np.asarray(along & (v >= v0 - grow_v) & (v <= v1 + grow_v))

    def check(self, offset: float = 0.0) -> None:
        """Raise SurfaceError if the surface, or its offset [m], is degenerate or folds."""
        u, v = self.grid(SAMPLES, SAMPLES)
        point = self.at(u, v)
        area = norm(cross(point.d_u, point.d_v))
        demand(np.isfinite(point.position).all(), 'the surface has points that are not finite')
        # One cell beyond a trimming boundary, so that no part between the samples is missed.
        middle = point.position[SAMPLES // 2], point.position[:, SAMPLES // 2]
        cell = max(float(norm(np.diff(line, axis=0)).max()) for line in middle)
        ours = self.contains(u, v, cell) if np.isfinite(cell) else np.ones(u.shape, bool)
        bad = ours & (area < 1e-6 * float(np.median(area[ours])))
        if bad.any():
            raise SurfaceError(f'the surface is degenerate at {_place(point, bad)}')
        n = point.normal
        turned = np.zeros(bad.shape, bool)
        turned[1:] |= dot(n[1:], n[:-1]) < 0.0
        turned[:, 1:] |= dot(n[:, 1:], n[:, :-1]) < 0.0
        turned &= ours
        if turned.any():
            raise SurfaceError(
                f'the surface folds at {_place(point, turned)}; machine both sides as two surfaces'
            )
        smallest = np.where(ours, point.principal_curvatures()[0], np.inf)
        if float(smallest.min()) * offset <= -1.0:
            tightest = smallest == smallest.min()
            radius = -1.0 / float(smallest.min()) / MM
            raise SurfaceError(
                f'a corner radius of {offset / MM:g} mm does not fit: the smallest concave radius '
                f'is {radius:.3g} mm at {_place(point, tightest)}'
            )
        if offset > 0.0:
            self._check_far_parts(point, ours, offset)

    def _check_far_parts(self, point: SurfacePoint, ours: BoolArray, offset: float) -> None:
        samples = point.position[ours]
        tree = cKDTree(samples)
        near, _ = tree.query(point.offset(offset).position.reshape(-1, 3))
        inside = ours & (near < 0.98 * offset).reshape(point.normal.shape[:2])
        if inside.any():
            raise SurfaceError(
                f'the offset by {offset / MM:g} mm meets another part of the surface at '
                f'{_place(point, inside)}; use a smaller corner radius'
            )


def _place(point: SurfacePoint, where: BoolArray) -> str:
    return place(point.position[tuple(np.argwhere(where)[0])])


def place(point: FloatArray) -> str:
    x, y, z = point / MM
    return f'({x:.2f}, {y:.2f}, {z:.2f}) mm'


class Placed(Surface):
    """A surface that is turned and moved, as on a fixture."""

    def __init__(
        self,
        surface: Surface,
        rotation: FloatArray,
        shift: FloatArray,
        domain: Domain | None = None,
        flip: bool = False,
    ):
        super().__init__(domain or surface.domain)
        self.surface, self.rotation, self.shift = surface, rotation, shift
        self.sign = -surface.sign if flip else surface.sign

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        first, *others = (x @ self.rotation.T for x in self.surface.derivatives(u, v))
        return (first + self.shift, *others)

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        if self.domain == self.surface.domain:
            return self.surface.contains(u, v, margin)
        return super().contains(u, v, margin)
