"""Compiled loops of the N-buffer: where needles enter the mill, and where on its way first."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.units import MM

#: Needles begin this deep under the surface and end this high over it [m].
DEPTH, TOP = 2.0 * MM, 1.0 * MM
#: A cut is looked for from this far below a needle's end [m].
SHORT = 0.05 * MM


@njit(cache=True, nogil=True, inline='always')
def _distance(x, y, z, pose, i, R):  # type: ignore[no-untyped-def]
    """Return the distance of a point from the cylinder on C_L, and its parts."""
    dx, dy, dz = x - pose[i, 0], y - pose[i, 1], z - pose[i, 2]
    along = dx * pose[i, 3] + dy * pose[i, 4] + dz * pose[i, 5]
    across = sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    low, out = min(along, 0.0), max(across - R, 0.0)
    return sqrt(low * low + out * out), low, out, across, along


@njit(cache=True, nogil=True, inline='always')
def _gap(needle, j, h, pose, i, R, skin):  # type: ignore[no-untyped-def]
    """Return the distance of a point of a needle from the mill, and its change by height."""
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
def _entry(needle, j, pose, i, R, skin, begin):  # type: ignore[no-untyped-def]
    """
    Return the height at which a needle enters the mill, or TOP if it does not.

    The distance from the cylinder is convex along the needle, so that from below every Newton
    step ends before the root; a distance that no longer falls means a miss.
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
def _entry_at(needle, j, pose, i, share, R, skin, most, mixed):  # type: ignore[no-untyped-def]
    """Return the entry at a share of the way from pose i to pose i + 1; ``mixed`` is scratch."""
    for a in range(6):
        mixed[0, a] = pose[i, a] + share * (pose[i + 1, a] - pose[i, a])
    size = sqrt(mixed[0, 3] ** 2 + mixed[0, 4] ** 2 + mixed[0, 5] ** 2)
    for a in range(3, 6):
        mixed[0, a] /= size
    return _entry(needle, j, mixed, 0, R, skin, max(most - SHORT, -DEPTH))


@njit(cache=True, nogil=True)
def _lowest(first, half, last):  # type: ignore[no-untyped-def]
    """Return where in [0, 1] the parabola through three even values is lowest, and its value."""
    bend = first - 2.0 * half + last
    if bend > 0.0:
        share = 0.5 + 0.25 * (first - last) / bend
        if 0.0 < share < 1.0:
            away = 2.0 * share - 1.0
            return share, half + 0.5 * away * (last - first) + 0.5 * away * away * bend
    return (0.0, first) if first < last else (1.0, last)


@njit(cache=True, nogil=True)
def _coarse(needle, order, starts, tile, ball, middle, stride, R, skin, height):  # type: ignore[no-untyped-def]
    """Cut the needles of a tile by every so many poses: most of the material goes here."""
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
def cut(  # type: ignore[no-untyped-def]
    needle, order, starts, ball, pose, middle, slack, stride, stages, widest, R, skin, height
):
    """Cut all needles by the pieces of motion between successive poses; lowers ``height``."""
    mixed = np.empty((1, 6))
    for tile in range(len(starts) - 1):
        _coarse(needle, order, starts, tile, ball, middle, stride, R, skin, height)
        highest = -inf
        for k in range(starts[tile], starts[tile + 1]):
            highest = max(highest, height[order[k]])
        for i in range(len(middle)):
            # The ball round the tile and its needles must meet the mill.
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
                # The distance is convex along a straight piece, its lowest at least this; and from
                # its end down a needle stands clear where the distance falls upwards.
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
