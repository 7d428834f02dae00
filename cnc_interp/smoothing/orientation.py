"""Tool axes on lines: the great circle between programmed axes [B2013, Eq. 4]."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Scalar products of vectors (..., 3); the order of the sum is fixed, and so are the bits."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def norm(a: FloatArray) -> FloatArray:
    """Return the lengths of vectors (..., 3)."""
    return np.asarray(np.sqrt(dot(a, a)))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return vector products."""
    return np.stack(
        [
            a[..., 1] * b[..., 2] - a[..., 2] * b[..., 1],
            a[..., 2] * b[..., 0] - a[..., 0] * b[..., 2],
            a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0],
        ],
        axis=-1,
    )


def rotations_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the rotation vectors of the great circles from a to b."""
    normal = cross(a, b)
    sine = norm(normal)
    angle = np.arctan2(sine, dot(a, b))
    ratio = np.where(sine < 1e-15, 0.0, angle / np.where(sine < 1e-15, 1.0, sine))
    return np.asarray(normal * ratio[..., None])


def turned_by(axis: FloatArray, rotation: FloatArray, share: FloatArray | float) -> FloatArray:
    """Turn tool axes by a share of rotation vectors, (..., 3) [B2013, Eq. 4 (Rodrigues)]."""
    rate = norm(rotation)
    k = rotation / np.where(rate > 0.0, rate, 1.0)[..., None]
    angle = (share * rate)[..., None]
    sine, cosine = np.sin(angle), np.cos(angle)
    along = k * dot(k, axis)[..., None]
    return np.asarray(axis * cosine + cross(k, axis) * sine + along * (1.0 - cosine))


@njit(cache=True, nogil=True)
def rotation_between(a: FloatArray, b: FloatArray) -> tuple[float, float, float]:
    """Return the rotation vector of one great circle, inside kernels."""
    x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
    sine = sqrt(x * x + y * y + z * z)
    ratio = 0.0
    if sine >= 1e-15:
        ratio = atan2(sine, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / sine
    return x * ratio, y * ratio, z * ratio


@njit(cache=True, nogil=True)
def turn_axis(
    axis: FloatArray, rotation: tuple[float, float, float], share: float, out: FloatArray
) -> None:
    """Write one tool axis, turned by a share of a rotation vector, inside kernels."""
    x, y, z = rotation
    rate = sqrt(x * x + y * y + z * z)
    if rate > 0.0:
        x, y, z = x / rate, y / rate, z / rate
    sine, cosine = sin(share * rate), cos(share * rate)
    along = x * axis[0] + y * axis[1] + z * axis[2]
    side = (y * axis[2] - z * axis[1], z * axis[0] - x * axis[2], x * axis[1] - y * axis[0])
    for i, k in enumerate((x, y, z)):
        out[i] = axis[i] * cosine + side[i] * sine + k * along * (1.0 - cosine)


def angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles between unit vectors."""
    return np.asarray(np.arctan2(norm(cross(a, b)), dot(a, b)))
