"""Analytic surfaces: references for the B-spline surfaces, and the examples of the paper."""

from __future__ import annotations

from abc import abstractmethod
from typing import Any

import numpy as np

from cnc_interp.cam.surface import Surface, SurfaceError
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
