"""
Orientation along lines and its smooth connection to corners [B2013, sections 2.4-3.3].

The programmed axis turns at w per metre about k: o_s = w k x o and o_ss = -w^2 o. A corner's axis
is the direction of D(u) = C_top(u) - C_bottom(u). With the top polygon divided like the bottom
one, D meets the programmed h o(s(u)) at both ends in value and to first order in direction. What
is left of its first two derivatives, the residual

    r(u) = h o(s(u)) - D(u),     r(0) = r(1) = 0,

is added as the quintic Hermite polynomial E(u) with E' = r' and E'' = r'' at both ends. Then o,
o_s and o_ss are continuous, to rounding, for any walls; E is small of second order in the angle
that the axis turns inside the corner.
"""

from __future__ import annotations

from math import atan2, cos, sin, sqrt

import numpy as np
from numba import njit

from cnc_interp.program.blocks import FloatArray


@njit(cache=True)
def rotation_between(a, b):  # type: ignore[no-untyped-def]
    """Return the rotation vector [rad], shape (3,), of the great circle from a to b."""
    k = np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
    sine = sqrt(k[0] * k[0] + k[1] * k[1] + k[2] * k[2])
    if sine < 1e-15:
        return np.zeros(3)
    return k * (atan2(sine, a[0] * b[0] + a[1] * b[1] + a[2] * b[2]) / sine)


@njit(cache=True)
def turned_by(axis, rotation, share):  # type: ignore[no-untyped-def]
    """Return the axis turned by a share of the rotation vector perpendicular to it [Eq. 4]."""
    angle = sqrt(rotation[0] ** 2 + rotation[1] ** 2 + rotation[2] ** 2)
    if angle == 0.0:
        return axis.copy()
    k = rotation / angle
    cross = np.array(
        [
            k[1] * axis[2] - k[2] * axis[1],
            k[2] * axis[0] - k[0] * axis[2],
            k[0] * axis[1] - k[1] * axis[0],
        ]
    )
    along = (k[0] * axis[0] + k[1] * axis[1] + k[2] * axis[2]) * (1.0 - cos(share * angle))
    return axis * cos(share * angle) + cross * sin(share * angle) + k * along


@njit(cache=True)
def rotations_between(a, b):  # type: ignore[no-untyped-def]
    """Return the rotation vectors [rad], shape (n, 3), of the great circles from a to b."""
    found = np.empty(a.shape)
    for i in range(len(a)):
        found[i] = rotation_between(a[i], b[i])
    return found


@njit(cache=True)
def turned_by_each(axis, rotation, share):  # type: ignore[no-untyped-def]
    """Return many axes, shape (n, 3), each turned by its share of its rotation vector."""
    found = np.empty(axis.shape)
    for i in range(len(axis)):
        found[i] = turned_by(axis[i], rotation[i], share[i])
    return found


@njit(cache=True)
def end_residual(points, top, height, axis, rate):  # type: ignore[no-untyped-def]
    """
    Return r' and r'' at the end of a corner that ``points[0]`` and ``top[0]`` mark.

    ``points`` and ``top`` are the first three control points counted inward from that end,
    ``rate`` is the rotation vector per metre of travel inward [rad/m].
    """
    inner = sqrt(((points[1] - points[0]) ** 2).sum())
    outer = sqrt(((points[2] - points[1]) ** 2).sum())
    s1, s2 = 6.0 * inner, 12.0 * (outer - 2.0 * inner)  # s'(u), s''(u)
    turn = np.array(
        [
            rate[1] * axis[2] - rate[2] * axis[1],
            rate[2] * axis[0] - rate[0] * axis[2],
            rate[0] * axis[1] - rate[1] * axis[0],
        ]
    )
    bend = -axis * (rate**2).sum()
    d = top - points
    d1 = 6.0 * (d[1] - d[0])
    d2 = 12.0 * ((d[2] - d[1]) - 2.0 * (d[1] - d[0]))
    return height * turn * s1 - d1, height * (bend * s1 * s1 + turn * s2) - d2


@njit(cache=True)
def connect(bottom, top, height, axes, rates, connection):  # type: ignore[no-untyped-def]
    """
    Fill ``connection`` with the Bezier points of the quintic E(u) of a corner.

    Parameters
    ----------
    bottom, top : ndarray, shape (5, 3)
        Control points [m].
    height : float
        Flank height h [m].
    axes : ndarray, shape (2, 3)
        Programmed tool axis at entry and exit [-].
    rates : ndarray, shape (2, 3)
        Rotation vector per metre of path on the lines before and after [rad/m].
    connection : ndarray, shape (6, 3)
        Result [m].

    """
    a1, a2 = end_residual(bottom[:3], top[:3], height, axes[0], rates[0])
    b1, b2 = end_residual(bottom[:1:-1], top[:1:-1], height, axes[1], -rates[1])
    connection[0] = 0.0
    connection[5] = 0.0
    connection[1] = a1 / 5.0
    connection[2] = 2.0 * connection[1] + a2 / 20.0
    connection[4] = b1 / 5.0
    connection[3] = 2.0 * connection[4] + b2 / 20.0


def angles_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the angles [rad], shape (n,), between unit vectors of shape (n, 3)."""
    cross = np.cross(a, b)
    return np.arctan2(np.sqrt((cross**2).sum(axis=1)), (a * b).sum(axis=1))
