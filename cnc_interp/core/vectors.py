"""Products of arrays of vectors, (..., 3): faster than ``np.cross`` and ``norm`` on short ones."""

from typing import Any

import numpy as np

from cnc_interp.core import FloatArray


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return scalar products; the order of the sum is fixed, and so are the bits."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def norm(a: FloatArray) -> FloatArray:
    return np.sqrt(dot(a, a))


def unit(a: FloatArray) -> FloatArray:
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(a / norm(a)[..., None])


def scaled(factor: Any, a: FloatArray) -> FloatArray:
    return np.asarray(np.asarray(factor)[..., None] * a)
