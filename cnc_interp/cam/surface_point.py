"""Points of a surface with tangents, normals and curvatures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.vectors import dot, scaled
from cnc_interp.core.arrays import FloatArray


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
        """Return the corresponding points of the surface S + distance n."""
        return SurfacePoint(
            self.position + distance * self.normal,
            self.d_u + distance * self.n_u,
            self.d_v + distance * self.n_v,
            self.normal,
            self.n_u,
            self.n_v,
        )

    def components(self, tangent: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return a and b with ``tangent = a S_u + b S_v``."""
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        p, q = dot(self.d_u, tangent), dot(self.d_v, tangent)
        determinant = e * g - f * f
        return (g * p - f * q) / determinant, (e * q - f * p) / determinant

    def normal_rate(self, tangent: FloatArray) -> FloatArray:
        """Return the derivative of the normal along tangent vectors."""
        a, b = self.components(tangent)
        return scaled(a, self.n_u) + scaled(b, self.n_v)

    def curvature(self, tangent: FloatArray) -> FloatArray:
        """Return the normal curvature along tangents."""
        return dot(self.normal_rate(tangent), tangent)

    def principal_curvatures(self) -> tuple[FloatArray, FloatArray]:
        """Return the principal curvatures."""
        e, f, g = dot(self.d_u, self.d_u), dot(self.d_u, self.d_v), dot(self.d_v, self.d_v)
        l, m, n = dot(self.n_u, self.d_u), dot(self.n_u, self.d_v), dot(self.n_v, self.d_v)
        area = e * g - f * f
        mean = (e * n - 2.0 * f * m + g * l) / (2.0 * area)
        spread = np.sqrt(np.maximum(mean**2 - (l * n - m * m) / area, 0.0))
        return mean - spread, mean + spread
