"""Tool axes on lines: the great circle between programmed axes [B2013, Eq. 4]."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """
    Return scalar products; the sum has a fixed order, so the bits do not depend on the shape.

    Parameters
    ----------
    a, b : ndarray, shape (..., 3)
        Vectors in any unit.

    Returns
    -------
    ndarray, shape (...)
        Scalar products over the last axis.

    """
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def norm(a: FloatArray) -> FloatArray:
    """
    Return the lengths of vectors.

    Parameters
    ----------
    a : ndarray, shape (..., 3)
        Vectors in any unit.

    Returns
    -------
    ndarray, shape (...)
        Lengths over the last axis, in the same unit.

    """
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
    """
    Turn tool axes by a part of rotation vectors [B2013, Eq. 4 (Rodrigues)].

    Parameters
    ----------
    axis, rotation : ndarray, shape (..., 3)
        Unit tool axes [-] and rotation vectors [rad, or rad/m if ``share`` is in m].
    share : float or ndarray, shape (...)
        Factor on the rotation [-, or m].

    Returns
    -------
    ndarray, shape (..., 3)
        Turned unit tool axes [-].

    """
    rate = norm(rotation)
    k = rotation / np.where(rate > 0.0, rate, 1.0)[..., None]
    angle = (share * rate)[..., None]
    sine, cosine = np.sin(angle), np.cos(angle)
    along = k * dot(k, axis)[..., None]
    return np.asarray(axis * cosine + cross(k, axis) * sine + along * (1.0 - cosine))


def angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles between unit vectors."""
    return np.asarray(np.arctan2(norm(cross(a, b)), dot(a, b)))
