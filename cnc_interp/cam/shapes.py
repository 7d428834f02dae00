"""Surfaces: analytic ones, among them the examples of the paper, B-splines, and trimmed ones."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.interpolate import NdBSpline, make_interp_spline
from scipy.spatial import cKDTree

from cnc_interp.cam.surface import Surface, demand
from cnc_interp.core import MM, BoolArray, FloatArray, norm
from cnc_interp.core.kernels import njit
from cnc_interp.program.geometry.subdivide import ragged


class Graph(Surface):
    """A surface z = h(x, y) over a rectangle with u = x and v = y; the normal points up."""

    def __init__(self, size: tuple[float, float]):
        demand(min(size) > 0.0, 'size must be two positive lengths')
        x, y = 0.5 * size[0], 0.5 * size[1]
        super().__init__(((-x, x), (-y, y)))

    @abstractmethod
    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        """Return h [m], h_x, h_y [-], h_xx, h_xy and h_yy [1/m], each (...)."""

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        x, y = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        zero, one = np.zeros_like(x), np.ones_like(x)
        h = [np.broadcast_to(value, x.shape) for value in self.height(x, y)]
        first = [(x, y), (one, zero), (zero, one), (zero, zero), (zero, zero), (zero, zero)]
        return tuple(np.stack([a, b, c], axis=-1) for (a, b), c in zip(first, h, strict=True))


class Plane(Graph):
    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


class Bumps(Graph):
    def __init__(self, size: tuple[float, float], bumps: Any):
        super().__init__(size)
        self.bumps = np.asarray(bumps, float)
        demand(
            self.bumps.ndim == 2 and self.bumps.shape[1] == 4 and np.all(self.bumps[:, 3] > 0.0),
            'bumps must be rows of x, y, height and a positive width',
        )

    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        total = [np.zeros_like(x) for _ in range(6)]
        for x0, y0, tall, width in self.bumps:
            p, q, w = (x - x0) / width, (y - y0) / width, width
            bell = tall * np.exp(-0.5 * (p * p + q * q))
            terms = (1.0, -p / w, -q / w, (p * p - 1.0) / w**2, p * q / w**2, (q * q - 1.0) / w**2)
            for k, term in enumerate(terms):
                total[k] += bell * term
        return tuple(total)


class Cap(Graph):
    """A part of a sphere, joined to a plane by a part of a torus [TL2008, Fig. 1]."""

    def __init__(self, size: tuple[float, float], radius: float, blend: float, angle: float):
        super().__init__(size)
        demand(
            radius > 0.0 and blend > 0.0 and 0.0 < angle < 0.5 * np.pi,
            'radius and blend must be positive, angle between 0 and 90 deg',
        )
        self.radius, self.blend = radius, blend
        self.join = radius * np.sin(angle)
        self.foot = (radius + blend) * np.sin(angle)
        self.top = radius - (radius + blend) * np.cos(angle) + blend

    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        rho = np.sqrt(x * x + y * y)
        safe = np.maximum(rho, 1e-12)
        ball = np.sqrt(np.maximum(self.radius**2 - np.minimum(rho, self.join) ** 2, 1e-12))
        away = np.clip(self.foot - rho, 0.0, self.foot - self.join)
        ring = np.sqrt(self.blend**2 - away**2)
        on_ball, flat = rho <= self.join, rho >= self.foot
        angle = np.arcsin(self.join / self.radius)
        peak = (self.radius + self.blend) * np.cos(angle) - self.blend
        h = np.where(on_ball, ball - peak, np.where(flat, 0.0, self.blend - ring))
        slope = np.where(on_ball, -rho / ball, np.where(flat, 0.0, -away / ring))
        bend = np.where(
            on_ball, -(self.radius**2) / ball**3, np.where(flat, 0.0, self.blend**2 / ring**3)
        )
        c, s = x / safe, y / safe
        ratio = np.where(rho < 1e-9, bend, slope / safe)
        second = bend * c * c + ratio * s * s, (bend - ratio) * c * s, bend * s * s + ratio * c * c
        return h, slope * c, slope * s, *second


class Cylinder(Surface):
    """A part of a cylinder about y; u is the angle from the vertical and v = y."""

    def __init__(self, radius: float, angle: float, length: float, hollow: bool = False):
        demand(
            radius > 0.0 and length > 0.0 and 0.0 < angle < 2.0 * np.pi,
            'radius and length must be positive, angle between 0 and 360 deg',
        )
        self.radius, self.up = radius, -1.0 if hollow else 1.0
        super().__init__(((-0.5 * angle, 0.5 * angle), (-0.5 * length, 0.5 * length)))

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        s, c, zero = self.radius * np.sin(u), self.radius * np.cos(u), np.zeros_like(u)
        k = self.up
        return (
            np.stack([s, v, k * c - k * self.radius], axis=-1),
            np.stack([c, zero, -k * s], axis=-1),
            np.stack([zero, zero + 1.0, zero], axis=-1),
            np.stack([-s, zero, -k * c], axis=-1),
            np.zeros((*u.shape, 3)),
            np.zeros((*u.shape, 3)),
        )


class Torus(Surface):
    """A part of a torus: u runs along its circle about y, v about that circle."""

    def __init__(self, ring: float, radius: float, u_angle: float, v_angle: float):
        demand(
            ring >= 0.0 and radius > 0.0 and u_angle > 0.0 and 0.0 < v_angle < np.pi,
            'radii and angles of a sphere or torus must be positive',
        )
        self.ring, self.radius = ring, radius
        super().__init__(((-0.5 * u_angle, 0.5 * u_angle), (-0.5 * v_angle, 0.5 * v_angle)))

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        s, c, a = np.sin(u), np.cos(u), self.radius
        far, d_far, dd_far = self.ring + a * np.cos(v), -a * np.sin(v), -a * np.cos(v)
        zero, y = np.zeros_like(u), a * np.sin(v)

        def turned(rho: FloatArray, sine: FloatArray, cosine: FloatArray) -> FloatArray:
            return np.stack([rho * sine, zero, rho * cosine], axis=-1)

        across = np.stack([zero, y, zero - self.ring - a], axis=-1)
        d_across = np.stack([zero, a * np.cos(v), zero], axis=-1)
        dd_across = np.stack([zero, -y, zero], axis=-1)
        return (
            turned(far, s, c) + across,
            turned(far, c, -s),
            turned(d_far, s, c) + d_across,
            turned(far, -s, -c),
            turned(d_far, c, -s),
            turned(dd_far, s, c) + dd_across,
        )


class BSplineSurface(Surface):
    """Tensor-product B-spline surface; the last spans continue beyond its border."""

    def __init__(
        self,
        knots: tuple[FloatArray, FloatArray],
        control_points: FloatArray,
        degree: tuple[int, int] = (3, 3),
        flip: bool = False,
    ):
        for t, k, n, name in zip(knots, degree, control_points.shape, 'uv', strict=False):
            demand(k >= 2, f'degree {k} in {name}: curvatures need degree 2 or more')
            demand(
                len(t) == n + k + 1,
                f'{len(t)} knots in {name} for {n} control points of degree {k}; '
                f'there must be {n + k + 1}',
            )
            demand(
                not np.any(np.diff(t) < 0.0) and t[k] < t[n], f'the knots in {name} must not fall'
            )
        demand(
            control_points.ndim == 3 and control_points.shape[2] == 3,
            'control points must have the shape (n_u, n_v, 3)',
        )
        self.spline = NdBSpline(tuple(np.asarray(t, float) for t in knots), control_points, degree)
        u, v = ((float(t[k]), float(t[-k - 1])) for t, k in zip(knots, degree, strict=True))
        super().__init__((u, v), flip)

    @staticmethod
    def through(points: FloatArray, flip: bool = False) -> BSplineSurface:
        points = np.asarray(points, float)
        demand(
            points.ndim == 3 and min(points.shape[:2]) >= 4 and points.shape[2] == 3,
            'a surface through points needs a grid of at least 4 x 4 points',
        )
        knots = []
        control = points
        for axis in (0, 1):
            steps = np.mean(norm(np.diff(points, axis=axis)), axis=1 - axis)
            demand(np.all(steps > 0.0), 'neighbouring rows of points coincide')
            at = np.concatenate([[0.0], np.cumsum(steps)]) / np.sum(steps)
            spline = make_interp_spline(at, control, k=3, axis=axis)
            knots.append(spline.t)
            control = np.moveaxis(spline.c, 0, axis) if spline.axis == axis else spline.c
        return BSplineSurface((knots[0], knots[1]), np.ascontiguousarray(control), (3, 3), flip)

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        at = np.stack([np.asarray(u, float), np.asarray(v, float)], axis=-1)
        orders = (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)
        return tuple(np.asarray(self.spline(at, nu=order)) for order in orders)


class RationalSurface(Surface):
    def __init__(
        self,
        knots: tuple[FloatArray, FloatArray],
        control_points: FloatArray,
        weights: FloatArray,
        degree: tuple[int, int] = (3, 3),
        flip: bool = False,
    ):
        w = np.repeat(weights[..., None], 3, axis=2)
        self.above = BSplineSurface(knots, w * control_points, degree)
        self.weight = BSplineSurface(knots, w, degree)
        super().__init__(self.above.domain, flip)

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its derivatives: w S = A, differentiated twice."""
        a, a_u, a_v, a_uu, a_uv, a_vv = self.above.derivatives(u, v)
        w, w_u, w_v, w_uu, w_uv, w_vv = self.weight.derivatives(u, v)
        s = a / w
        s_u, s_v = (a_u - w_u * s) / w, (a_v - w_v * s) / w
        return (
            *(s, s_u, s_v),
            (a_uu - 2.0 * w_u * s_u - w_uu * s) / w,
            (a_uv - w_u * s_v - w_v * s_u - w_uv * s) / w,
            (a_vv - 2.0 * w_v * s_v - w_vv * s) / w,
        )


BOUNDARY = 0.05 * MM  #: Distance of the points that stand for the boundary [m].
GAP = 2e-4  #: Largest gap between edges that meet, as a share of the extent of the boundary.


class Trimmed(Surface):
    """A surface that continues beyond a boundary, within which it is machined."""

    def __init__(self, surface: Surface, edges: Sequence[FloatArray]):
        edges = joined(edges)
        corners = np.concatenate(edges)
        (u0, v0), (u1, v1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        demand(u0 < u1 and v0 < v1, 'the boundary encloses nothing')
        super().__init__(((u0, u1), (v0, v1)))
        self.surface, self.sign = surface, surface.sign
        #: Straight pieces of the boundary, shape (k, 4): u and v of both ends.
        self.pieces = np.concatenate([np.hstack([e[:-1], e[1:]]) for e in edges])
        self.boundary = self._boundary()
        self._tree = cKDTree(self.boundary)

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        return self.surface.derivatives(u, v)

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        inside: BoolArray = within(self.pieces, u.ravel(), v.ravel()).reshape(u.shape)
        if not margin:
            return inside
        unsure = inside if margin < 0.0 else ~inside & super().contains(u, v, 2.0 * margin)
        where = self.derivatives(u[unsure], v[unsure])[0]
        sound = np.isfinite(where).all(axis=1)
        near = np.zeros(len(where), bool)
        near[sound] = self._tree.query(where[sound])[0] <= abs(margin)
        inside[unsure] = near if margin > 0.0 else ~near
        return inside

    def _boundary(self) -> FloatArray:
        a, b = self.pieces[:, :2], self.pieces[:, 2:]
        ends = [self.derivatives(*x.T)[0] for x in (a, b)]
        count = np.ceil(norm(ends[1] - ends[0]) / BOUNDARY).astype(int).clip(1, 10_000)
        row, nth = ragged(count)
        uv = a[row] + (nth / count[row])[:, None] * (b[row] - a[row])
        return np.asarray(self.derivatives(*uv.T)[0])


def joined(edges: Sequence[FloatArray]) -> list[FloatArray]:
    """Close the small gaps between edges: all ends at one vertex become the same."""
    corners = np.concatenate(edges)
    size = np.maximum(np.ptp(corners, axis=0), 1e-12)
    ends = np.array([row for edge in edges for row in (edge[0], edge[-1])])
    near = cKDTree(ends / size).query_ball_point(ends / size, GAP)
    demand(not any(len(group) < 2 for group in near), 'the boundary is not closed')
    found = []
    for k, edge in enumerate(edges):
        closed = np.array(edge, float)
        closed[0], closed[-1] = (ends[min(near[2 * k + i])] for i in (0, 1))
        found.append(closed)
    return found


@njit(cache=True, nogil=True)
def within(pieces: FloatArray, u: FloatArray, v: FloatArray) -> BoolArray:
    """Return which points lie in closed polygons: a ray along +u meets an odd count of pieces."""
    inside = np.zeros(len(u), np.bool_)
    for i in range(len(u)):
        for j in range(len(pieces)):
            low, high = pieces[j, 1], pieces[j, 3]
            if (low > v[i]) != (high > v[i]):
                share = (v[i] - low) / (high - low)
                if u[i] < pieces[j, 0] + share * (pieces[j, 2] - pieces[j, 0]):
                    inside[i] = not inside[i]
    return inside
