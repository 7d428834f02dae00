"""B-spline surfaces, plain and rational."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import NdBSpline, make_interp_spline

from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray


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
