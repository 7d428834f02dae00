"""Surfaces: analytic ones, among them the examples of the paper, and B-splines."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np
from scipy.interpolate import NdBSpline, make_interp_spline

from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray


class Graph(Surface):
    """A surface z = h(x, y) over a rectangle with u = x and v = y; the normal points up."""

    def __init__(self, size: tuple[float, float]):
        if not min(size) > 0.0:
            raise SurfaceError('size must be two positive lengths')
        x, y = 0.5 * size[0], 0.5 * size[1]
        super().__init__(((-x, x), (-y, y)))

    @abstractmethod
    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        """Return h [m], h_x, h_y [-], h_xx, h_xy and h_yy [1/m], each (...)."""

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""
        x, y = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        zero, one = np.zeros_like(x), np.ones_like(x)
        h = [np.broadcast_to(value, x.shape) for value in self.height(x, y)]
        first = [(x, y), (one, zero), (zero, one), (zero, zero), (zero, zero), (zero, zero)]
        return tuple(np.stack([a, b, c], axis=-1) for (a, b), c in zip(first, h, strict=True))


class Plane(Graph):
    """The plane z = 0."""

    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        """Return zeros."""
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0


class Bumps(Graph):
    """A plane with bell-shaped bumps, like the surface of the paper's application."""

    def __init__(self, size: tuple[float, float], bumps: Any):
        super().__init__(size)
        self.bumps = np.asarray(bumps, float)
        if self.bumps.ndim != 2 or self.bumps.shape[1] != 4 or not np.all(self.bumps[:, 3] > 0.0):
            raise SurfaceError('bumps must be rows of x, y, height and a positive width')

    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        """Return the sum of the bells and its derivatives."""
        total = [np.zeros_like(x) for _ in range(6)]
        for x0, y0, tall, width in self.bumps:
            p, q, w = (x - x0) / width, (y - y0) / width, width
            bell = tall * np.exp(-0.5 * (p * p + q * q))
            terms = (1.0, -p / w, -q / w, (p * p - 1.0) / w**2, p * q / w**2, (q * q - 1.0) / w**2)
            for k, term in enumerate(terms):
                total[k] += bell * term
        return tuple(total)


class Cap(Graph):
    """A part of a sphere that a part of a torus joins to a plane [TL2008, Fig. 1]."""

    def __init__(self, size: tuple[float, float], radius: float, blend: float, angle: float):
        super().__init__(size)
        if not (radius > 0.0 and blend > 0.0 and 0.0 < angle < 0.5 * np.pi):
            raise SurfaceError('radius and blend must be positive, angle between 0 and 90 deg')
        self.radius, self.blend = radius, blend
        self.join = radius * np.sin(angle)
        self.foot = (radius + blend) * np.sin(angle)
        self.top = radius - (radius + blend) * np.cos(angle) + blend

    def height(self, x: FloatArray, y: FloatArray) -> tuple[Any, ...]:
        """Return the meridian h(rho), turned about z, and its derivatives."""
        rho = np.sqrt(x * x + y * y)
        safe = np.maximum(rho, 1e-12)
        ball = np.sqrt(np.maximum(self.radius**2 - np.minimum(rho, self.join) ** 2, 1e-12))
        away = np.clip(self.foot - rho, 0.0, self.foot - self.join)
        ring = np.sqrt(self.blend**2 - away**2)
        on_ball, flat = rho <= self.join, rho >= self.foot
        peak = (self.radius + self.blend) * np.cos(self._angle()) - self.blend
        h = np.where(on_ball, ball - peak, np.where(flat, 0.0, self.blend - ring))
        slope = np.where(on_ball, -rho / ball, np.where(flat, 0.0, -away / ring))
        bend = np.where(
            on_ball, -(self.radius**2) / ball**3, np.where(flat, 0.0, self.blend**2 / ring**3)
        )
        c, s = x / safe, y / safe
        ratio = np.where(rho < 1e-9, bend, slope / safe)
        return (
            h,
            slope * c,
            slope * s,
            bend * c * c + ratio * s * s,
            (bend - ratio) * c * s,
            bend * s * s + ratio * c * c,
        )

    def _angle(self) -> float:
        """Return the slope where sphere and torus meet [rad]."""
        return float(np.arcsin(self.join / self.radius))


class Cylinder(Surface):
    """A part of a cylinder about y; u is the angle from the vertical and v = y."""

    def __init__(self, radius: float, angle: float, length: float, hollow: bool = False):
        if not (radius > 0.0 and length > 0.0 and 0.0 < angle < 2.0 * np.pi):
            raise SurfaceError('radius and length must be positive, angle between 0 and 360 deg')
        self.radius, self.up = radius, -1.0 if hollow else 1.0
        super().__init__(((-0.5 * angle, 0.5 * angle), (-0.5 * length, 0.5 * length)))

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""
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
        if not (ring >= 0.0 and radius > 0.0 and u_angle > 0.0 and 0.0 < v_angle < np.pi):
            raise SurfaceError('radii and angles of a sphere or torus must be positive')
        self.ring, self.radius = ring, radius
        super().__init__(((-0.5 * u_angle, 0.5 * u_angle), (-0.5 * v_angle, 0.5 * v_angle)))

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""
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
    """
    Tensor-product B-spline surface; the last spans continue beyond its border.

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
        """Interpolate a grid of points by a bicubic surface."""
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
        """Return the position and its first and second derivatives."""
        at = np.stack([np.asarray(u, float), np.asarray(v, float)], axis=-1)
        orders = (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)
        return tuple(np.asarray(self.spline(at, nu=order)) for order in orders)


class RationalSurface(Surface):
    """Rational B-spline surface S = A / w; A and w are B-splines."""

    def __init__(
        self, knots: tuple[FloatArray, FloatArray], control_points: FloatArray,
        weights: FloatArray, degree: tuple[int, int] = (3, 3), flip: bool = False,
    ):  # fmt: skip
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
            s,
            s_u,
            s_v,
            (a_uu - 2.0 * w_u * s_u - w_uu * s) / w,
            (a_uv - w_u * s_v - w_v * s_u - w_uv * s) / w,
            (a_vv - 2.0 * w_v * s_v - w_vv * s) / w,
        )
