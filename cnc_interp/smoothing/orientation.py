"""Tool axes on lines: great circles [B2013, Eq. 4], and shares beside the pole."""

from math import atan2, cos, sin, sqrt

import numpy as np

from cnc_interp.core import FloatArray, cross, dot, norm
from cnc_interp.core.kernels import njit

# Beside the pole, see ``kinematics/pole_bounds.py``.
#: Part of the tolerance that can move a path onto the pole [-].
MOVED = 0.8
#: Smallest share of corners and curves, and distance that a path keeps from the pole [-].
LEAST, KEPT = 0.1, 0.7
#: The deviation of a corner at f is at most this times ``(1 - f)^4`` of the largest [-].
FADING = 1.4


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
    return np.asarray(np.arctan2(norm(cross(a, b)), dot(a, b)))


@njit(cache=True, nogil=True)
def share_near_pole(
    pole: FloatArray,
    axis: FloatArray,
    rotation: tuple[float, float, float],
    tolerance: float,
    corner: bool,
) -> float:
    """Return what a corner or curve may use of the orientation tolerance beside a great circle."""
    sense = -1.0 if axis[0] * pole[0] + axis[1] * pole[1] + axis[2] * pole[2] < 0.0 else 1.0
    x, y, z = rotation
    turn = sqrt(x * x + y * y + z * z)
    if turn > 0.0:
        x, y, z = x / turn, y / turn, z / turn
    p = sense * pole[0], sense * pole[1], sense * pole[2]
    a = axis[0], axis[1], axis[2]
    side = y * a[2] - z * a[1], z * a[0] - x * a[2], x * a[1] - y * a[0]
    along = a[0] * p[0] + a[1] * p[1] + a[2] * p[2]
    across = side[0] * p[0] + side[1] * p[1] + side[2] * p[2]
    foot = min(max(atan2(across, along), 0.0), turn)
    c, s = cos(foot), sin(foot)
    near = c * a[0] + s * side[0], c * a[1] + s * side[1], c * a[2] + s * side[2]
    off = (
        near[1] * p[2] - near[2] * p[1],
        near[2] * p[0] - near[0] * p[2],
        near[0] * p[1] - near[1] * p[0],
    )
    along = near[0] * p[0] + near[1] * p[1] + near[2] * p[2]
    distance = atan2(sqrt(off[0] ** 2 + off[1] ** 2 + off[2] ** 2), along) / tolerance
    part = foot / turn if corner and turn > 0.0 else 0.0
    fading = min(max(FADING * (1.0 - part) ** 4, 1e-3), 1.0)
    through = (MOVED - distance) / (fading + MOVED)
    return min(max(through, (distance - KEPT) / fading, LEAST), 1.0)


@njit(cache=True, nogil=True)
def shares_at_corners(
    pole: FloatArray, axis: FloatArray, turns: FloatArray, tolerance: FloatArray
) -> FloatArray:
    """Return these shares at n corners; ``turns`` (n, 2, 3) lead from them along both lines."""
    shares = np.ones(len(axis))
    for k in range(len(axis)):
        if turns[k].any():
            for side in range(2):
                x, y, z = 0.5 * turns[k, side]
                share = share_near_pole(pole, axis[k], (x, y, z), tolerance[k], True)
                shares[k] = min(shares[k], share)
    return shares
