"""
Products of arrays of vectors, shape (..., 3).

They are faster than ``np.cross`` and ``np.linalg.norm`` on short arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray


def dot(a: FloatArray, b: FloatArray) -> FloatArray:
    """
    Return the scalar products of vectors.

    Parameters
    ----------
    a, b : ndarray, shape (..., 3)
        Vectors [any unit].

    Returns
    -------
    ndarray, shape (...)
        a . b [product of both units].

    """
    return np.asarray(np.einsum('...i,...i->...', a, b))


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """
    Return the vector products of vectors.

    Parameters
    ----------
    a, b : ndarray, shape (..., 3)
        Vectors [any unit].

    Returns
    -------
    ndarray, shape (..., 3)
        a x b [product of both units].

    """
    a0, a1, a2 = a[..., 0], a[..., 1], a[..., 2]
    b0, b1, b2 = b[..., 0], b[..., 1], b[..., 2]
    return np.stack([a1 * b2 - a2 * b1, a2 * b0 - a0 * b2, a0 * b1 - a1 * b0], axis=-1)


def norm(a: FloatArray) -> FloatArray:
    """
    Return the lengths of vectors.

    Parameters
    ----------
    a : ndarray, shape (..., 3)
        Vectors [any unit].

    Returns
    -------
    ndarray, shape (...)
        Lengths [same unit].

    """
    return np.sqrt(dot(a, a))


def unit(a: FloatArray) -> FloatArray:
    """
    Scale vectors to length one.

    Parameters
    ----------
    a : ndarray, shape (..., 3)
        Vectors [any unit].

    Returns
    -------
    ndarray, shape (..., 3)
        Unit vectors [-]; NaN for zero vectors.

    """
    with np.errstate(invalid='ignore', divide='ignore'):
        return np.asarray(a / norm(a)[..., None])


def scaled(factor: Any, a: FloatArray) -> FloatArray:
    """
    Multiply vectors by numbers.

    Parameters
    ----------
    factor : float or ndarray, shape (...)
        One number for each vector [any unit].
    a : ndarray, shape (..., 3)
        Vectors [any unit].

    Returns
    -------
    ndarray, shape (..., 3)
        Products [product of both units].

    """
    return np.asarray(np.asarray(factor)[..., None] * a)
