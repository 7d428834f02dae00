"""The corner spline: a cubic B-spline with knots (0 0 0 0 .5 1 1 1 1) [B2013, section 2.2]."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.jet import Jet


def corner_spline_points(points: FloatArray, u: FloatArray | float) -> FloatArray:
    """Return points at u of corner splines, (..., 5, 3) [B2013, Eq. 1 and A.2]."""
    if np.ndim(u) == 0:
        places = range(4) if u <= 0.5 else range(4, 0, -1)
        weights = _corner_basis(min(float(u), 1.0 - float(u)))
        return sum_of(w * points[..., i, :] for w, i in zip(weights, places, strict=True))
    late = (np.asarray(u) > 0.5)[..., None]
    weights = _corner_basis(np.minimum(u, 1.0 - np.asarray(u)))
    return sum_of(
        w[..., None] * np.where(late, points[..., 4 - i, :], points[..., i, :])
        for i, w in enumerate(weights)
    )


def _corner_basis(x: Any) -> tuple[Any, Any, Any, Any]:
    """Return the four basis functions that are not zero at x in [0, 0.5] [B2013, Eq. A.2]."""
    return (
        (1.0 - 2.0 * x) ** 3,
        2.0 * x * (3.0 + x * (7.0 * x - 9.0)),
        2.0 * x * x * (3.0 - 4.0 * x),
        2.0 * x**3,
    )


def sum_of(terms: Iterable[FloatArray]) -> FloatArray:
    """Add arrays in the given order, so that the result is the same bit for bit."""
    first, *rest = terms
    for term in rest:
        first = first + term
    return first


def corner_pieces(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the Bezier points of both halves of corner splines, shape (n, 5 or more, d)."""
    p0, p1, p2, p3, p4 = (points[:, i] for i in range(5))
    before, after = 0.5 * (p1 + p2), 0.5 * (p2 + p3)
    middle = 0.5 * (before + after)
    return (np.stack([p0, p1, before, middle], axis=1), np.stack([middle, after, p3, p4], axis=1))


def corner_end_derivatives(points: FloatArray) -> FloatArray:
    """Return three derivatives of corner splines at u = 0, (3, n, 3) [B2013, Eq. A.2]."""
    p0, p1, p2, p3 = (points[:, i] for i in range(4))
    first, second = 6.0 * (p1 - p0), 24.0 * p0 - 36.0 * p1 + 12.0 * p2
    return np.stack([first, second, -48.0 * p0 + 84.0 * p1 - 48.0 * p2 + 12.0 * p3])


@njit(cache=True, nogil=True, inline='always')
def corner_spline_jet(points: FloatArray, i: int, u: float, second_half: bool) -> Jet:
    """Return the jet in u of coordinate i of one half of a corner spline [B2013, Eq. 1, A.2]."""
    if second_half:  # the reversed control points give the same curve backwards
        p0, p1, p2, p3 = points[4, i], points[3, i], points[2, i], points[1, i]
        x, sign = 1.0 - u, -1.0
    else:
        p0, p1, p2, p3 = points[0, i], points[1, i], points[2, i], points[3, i]
        x, sign = u, 1.0
    # (1-2x)^3 p0 + 2x(3 - 9x + 7x^2) p1 + 2x^2(3 - 4x) p2 + 2x^3 p3, in powers of x
    a1 = 6.0 * (p1 - p0)
    a2 = 12.0 * p0 - 18.0 * p1 + 6.0 * p2
    a3 = -8.0 * p0 + 14.0 * p1 - 8.0 * p2 + 2.0 * p3
    return (
        p0 + x * (a1 + x * (a2 + x * a3)),
        sign * (a1 + x * (2.0 * a2 + 3.0 * x * a3)),
        a2 + 3.0 * x * a3,
        sign * a3,
    )
