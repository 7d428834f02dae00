"""Compiled loops of the N-buffer: where needles enter the mill, and where on its way first."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.units import MM

#: Depth at which needles begin below the surface, and height at which they end above it [m].
DEPTH, TOP = 2.0 * MM, 1.0 * MM
#: Distance below the end of a needle at which the search for a cut begins [m].
SHORT = 0.05 * MM


@njit(cache=True, nogil=True, inline='always')
def _distance(
    x: float, y: float, z: float, pose: FloatArray, i: int, R: float
) -> tuple[float, float, float, float, float]:
    """
    Return the distance of a point from the cylinder of radius R on C_L, and its parts.

    The arguments are x, y, z [m] and row i of ``pose``, shape (n, 6): C_L [m] and unit axis [-].
    The results are the distance, its parts along and across the axis, and the coordinates across
    and along the axis [m].
    """
    dx, dy, dz = x - pose[i, 0], y - pose[i, 1], z - pose[i, 2]
    along = dx * pose[i, 3] + dy * pose[i, 4] + dz * pose[i, 5]
    across = sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    low, out = min(along, 0.0), max(across - R, 0.0)
    return sqrt(low * low + out * out), low, out, across, along


@njit(cache=True, nogil=True, inline='always')
def _gap(
    needle: FloatArray, j: int, h: float, pose: FloatArray, i: int, R: float, skin: float
) -> tuple[float, float]:
    """
    Return the distance of a point of a needle from the mill [m], and its derivative by height [-].

    The point lies at height h [m] on row j of ``needle``, shape (k, 6): base [m] and normal [-].
    """
    nx, ny, nz = needle[j, 3], needle[j, 4], needle[j, 5]
    x, y, z = needle[j, 0] + h * nx, needle[j, 1] + h * ny, needle[j, 2] + h * nz
    distance, low, out, across, along = _distance(x, y, z, pose, i, R)
    # d(distance)/dh = (low low' + out out') / distance
    nu = nx * pose[i, 3] + ny * pose[i, 4] + nz * pose[i, 5]
    rise = low * nu
    if out > 0.0:
        inward = (x - pose[i, 0]) * nx + (y - pose[i, 1]) * ny + (z - pose[i, 2]) * nz
        rise += out * (inward - along * nu) / across
    return distance - skin, rise / max(distance, 1e-15)


@njit(cache=True, nogil=True)
def _entry(
    needle: FloatArray, j: int, pose: FloatArray, i: int, R: float, skin: float, begin: float
) -> float:
    """
    Return the height at which a needle enters the mill, or TOP if it misses the mill [m].

    The distance from the cylinder is convex along the needle. Every Newton step from below
    therefore ends before the root. A distance that no longer falls means a miss.
    """
    h = begin
    gap, rise = _gap(needle, j, h, pose, i, R, skin)
    if gap < 0.0:
        h = -DEPTH
        gap, rise = _gap(needle, j, h, pose, i, R, skin)
    for _ in range(60):
        if gap < 1e-11:
            return h
        if rise >= 0.0:
            return TOP
        h -= gap / rise
        if h >= TOP:
            return TOP
        gap, rise = _gap(needle, j, h, pose, i, R, skin)
    return h


@njit(cache=True, nogil=True)
def _entry_at(
    needle: FloatArray, j: int, pose: FloatArray, i: int, share: float, R: float, skin: float,
    most: float, mixed: FloatArray,
) -> float:  # fmt: skip
    """
    Return the entry height at a share of the motion from pose i to pose i + 1 [m].

    ``most`` is the present height of the needle [m]. ``mixed``, shape (1, 6), is overwritten.
    """
    for a in range(6):
        mixed[0, a] = pose[i, a] + share * (pose[i + 1, a] - pose[i, a])
    size = sqrt(mixed[0, 3] ** 2 + mixed[0, 4] ** 2 + mixed[0, 5] ** 2)
    for a in range(3, 6):
        mixed[0, a] /= size
    height: float = _entry(needle, j, mixed, 0, R, skin, max(most - SHORT, -DEPTH))
    return height


@njit(cache=True, nogil=True)
def _lowest(first: float, half: float, last: float) -> tuple[float, float]:
    """Return the place and value of the minimum in [0, 1] of the parabola through 3 values."""
    bend = first - 2.0 * half + last
    if bend > 0.0:
        share = 0.5 + 0.25 * (first - last) / bend
        if 0.0 < share < 1.0:
            away = 2.0 * share - 1.0
            return share, half + 0.5 * away * (last - first) + 0.5 * away * away * bend
    return (0.0, first) if first < last else (1.0, last)


@njit(cache=True, nogil=True)
def _coarse(
    needle: FloatArray, order: IntArray, starts: IntArray, tile: int, ball: FloatArray,
    middle: FloatArray, stride: int, R: float, skin: float, height: FloatArray,
) -> None:  # fmt: skip
    """Cut the needles of a tile by every ``stride``-th pose, which removes most material."""
    first, last = starts[tile], starts[tile + 1]
    for i in range(0, len(middle), stride):
        far = _distance(ball[tile, 0], ball[tile, 1], ball[tile, 2], middle, i, R)[0]
        if far > ball[tile, 3] + skin + TOP:
            continue
        for k in range(first, last):
            j = order[k]
            gap, rise = _gap(needle, j, height[j], middle, i, R, skin)
            if gap < 0.0 or rise > 0.0:
                begin = max(height[j] - SHORT, -DEPTH)
                height[j] = min(height[j], _entry(needle, j, middle, i, R, skin, begin))


@njit(cache=True, nogil=True)
def cut(
    needle: FloatArray, order: IntArray, starts: IntArray, ball: FloatArray, pose: FloatArray,
    middle: FloatArray, slack: FloatArray, stride: int, stages: int, widest: float, R: float,
    skin: float, height: FloatArray,
) -> None:  # fmt: skip
    """
    Cut all needles by the pieces of motion between successive poses.

    Parameters
    ----------
    needle : ndarray, shape (k, 6)
        Base [m] and unit normal [-] of each needle.
    order : ndarray of int, shape (k,)
        Numbers of the needles, tile by tile.
    starts : ndarray of int, shape (tiles + 1,)
        Place in ``order`` where each tile begins.
    ball : ndarray, shape (tiles, 4)
        Centre and radius of a ball around each tile [m].
    pose : ndarray, shape (n + 1, 6)
        C_L [m] and unit tool axis [-].
    middle : ndarray, shape (n, 6)
        Poses in the middle of the pieces.
    slack : ndarray, shape (n,)
        Largest motion of the mill between the middle and an end of a piece [m].
    stride : int
        Distance of the poses of the first, coarse cut.
    stages : int
        Number of times that the search interval of the lowest height is halved.
    widest : float
        Half the first search interval, as a share of the piece [-].
    R, skin : float
        Radius of the cylinder, and distance of the mill's surface from it [m].
    height : ndarray, shape (k,)
        Heights of the needles, which are lowered in place [m].

    """
    mixed = np.empty((1, 6))
    for tile in range(len(starts) - 1):
        _coarse(needle, order, starts, tile, ball, middle, stride, R, skin, height)
        highest = -inf
        for k in range(starts[tile], starts[tile + 1]):
            highest = max(highest, height[order[k]])
        for i in range(len(middle)):
            # The ball around the tile and its needles must touch the mill.
            far = _distance(ball[tile, 0], ball[tile, 1], ball[tile, 2], middle, i, R)[0]
            if far > ball[tile, 3] + skin + max(highest, 0.0) + slack[i]:
                continue
            for k in range(starts[tile], starts[tile + 1]):
                j = order[k]
                most = height[j]
                half, rise = _gap(needle, j, most, middle, i, R, skin)
                if half > slack[i] and rise <= 0.0:
                    continue
                first, rise_first = _gap(needle, j, most, pose, i, R, skin)
                last, rise_last = _gap(needle, j, most, pose, i + 1, R, skin)
                # The distance is convex along a straight piece: this bounds its minimum. A needle
                # is clear from its end down if the distance falls with the height.
                clear = min(half, 2.0 * half - max(first, last)) > 0.0
                if clear and rise <= 0.0 and rise_first <= 0.0 and rise_last <= 0.0:
                    continue
                share, least = _lowest(first, half, last)
                least = TOP
                reach = widest
                for _ in range(stages):
                    low, high = max(share - reach, 0.0), min(share + reach, 1.0)
                    first = _entry_at(needle, j, pose, i, low, R, skin, most, mixed)
                    half = _entry_at(needle, j, pose, i, 0.5 * (low + high), R, skin, most, mixed)
                    last = _entry_at(needle, j, pose, i, high, R, skin, most, mixed)
                    least = min(least, first, half, last)
                    at, _ = _lowest(first, half, last)
                    share = low + at * (high - low)
                    reach *= 0.5
                least = min(least, _entry_at(needle, j, pose, i, share, R, skin, most, mixed))
                height[j] = min(most, least)
