"""
N-buffer: needles along the normals of a surface, cut by the moving mill.

The mill is convex: all points within r_c of a cylinder of radius R standing on C_L. Along a needle
``B + h n`` its distance is therefore a convex function of h, and Newton's method from below runs
monotonically to the height at which the needle enters the mill. Between two poses tip and axis
run straight; the pieces are so short that a parabola through three heights finds the lowest, which
is then computed exactly. What is left of a needle is the signed height: scallop, excess or gouge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, sqrt
from typing import Any

import numpy as np
from numba import njit

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.vectors import norm
from cnc_interp.errors import InterpError
from cnc_interp.program.blocks import FloatArray
from cnc_interp.units import MM, UM

#: Needles begin this deep under the surface and end this high over it [m].
DEPTH, TOP = 2.0 * MM, 1.0 * MM
#: Needles of a tile are sorted out together.
TILE = 8
#: Longest piece of motion, as a share of the corner radius.
PIECE = 0.3
#: A cut is looked for from this far below a needle's end [m].
SHORT = 0.05 * MM
#: Largest turn of the axis in a piece [rad]: centre and tip of the mill then both run straight.
TURN = 2.5e-3
#: Distance of the poses of a first, rough cut [m].
COARSE = 0.4 * MM
#: Poses cut between two calls of the progress.
BATCH = 2000


@dataclass(frozen=True)
class Needles:
    """
    Where the surface is looked at.

    Parameters
    ----------
    base, normal : ndarray, shape (rows, columns, 3)
        Points of the surface [m] and its normals.

    """

    base: FloatArray
    normal: FloatArray

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> Needles:
        """Return needles about evenly over a surface, off its border by a margin [m]."""
        grow = surface.growth(-margin) if margin else (0.0, 0.0)
        (u0, u1), (v0, v1) = surface.domain
        u0, u1, v0, v1 = u0 - grow[0], u1 + grow[0], v0 - grow[1], v1 + grow[1]
        rate = surface.growth(spacing)
        count = [int(np.ceil((b - a) / r)) + 1 for a, b, r in zip((u0, v0), (u1, v1), rate)]
        if min(count) < 2 or count[0] * count[1] > 50_000_000:
            raise InterpError(
                f'needles every {spacing / MM:g} mm make {count[0]} x {count[1]}; choose another '
                'spacing or margin'
            )
        u, v = np.meshgrid(
            np.linspace(u0, u1, count[0]), np.linspace(v0, v1, count[1]), indexing='ij'
        )
        point = surface.at(u, v)
        return Needles(point.position, point.normal)


@dataclass(frozen=True)
class Heights:
    """
    What the mill leaves on the needles.

    Parameters
    ----------
    needles : Needles
        Where.
    height : ndarray, shape (rows, columns)
        Signed height over the surface [m]; ``TOP`` where nothing was cut.
    pairs : int
        Needles times pieces of motion, for the speed.

    """

    needles: Needles
    height: FloatArray
    pairs: int

    @property
    def cut(self) -> Any:
        """True where the mill has been."""
        return self.height < 0.999 * TOP

    def statistics(self) -> dict[str, float]:
        """
        Return what a surface gauge would say [m], over the needles that were cut.

        ``uncut`` is the share of needles that no motion reached; ``Sa`` and ``Sq`` are the mean
        and the root mean square of the height about its mean, ``Sz`` its range.
        """
        h = self.height[self.cut]
        if not len(h):
            raise InterpError('the program cuts nothing of the surface; is it the right one?')
        away = h - h.mean()
        return {
            'highest': float(h.max()),
            'lowest': float(h.min()),
            'mean': float(h.mean()),
            'Sa': float(np.abs(away).mean()),
            'Sq': float(np.sqrt((away**2).mean())),
            'Sz': float(h.max() - h.min()),
            'gouged': float(np.mean(h < -0.5 * UM)),
            'uncut': float(1.0 - self.cut.mean()),
        }


def cut_needles(
    needles: Needles,
    cutter: Cutter,
    tip: FloatArray,
    axis: FloatArray,
    progress: Callable[[float], None] | None = None,
) -> Heights:
    """
    Cut needles by the volume that the mill sweeps along poses.

    Parameters
    ----------
    needles : Needles
        Where the surface is looked at.
    cutter : Cutter
        The mill.
    tip, axis : ndarray, shape (n, 3)
        Tool tips [m] and unit tool axes, in order; in between both run straight.
    progress : callable, optional
        Told the share done, 0 to 1.

    Returns
    -------
    Heights

    """
    if len(tip) < 2 or not (np.isfinite(tip).all() and np.isfinite(axis).all()):
        raise InterpError('a simulation needs two finite poses or more')
    rows, columns = needles.base.shape[:2]
    needle = np.concatenate([needles.base, needles.normal], axis=2).reshape(-1, 6)
    order, starts, ball = tiles(needles)
    height = np.full(len(needle), TOP)
    R, r = cutter.tool_radius, cutter.corner_radius
    tip, axis = pieces(tip, axis, PIECE * min(max(r, 0.5 * MM), 5.0 * MM), R + r)
    pose = np.concatenate([tip + r * axis, axis], axis=1)
    middle = 0.5 * (pose[1:] + pose[:-1])
    middle[:, 3:] /= norm(middle[:, 3:])[:, None]
    step = np.abs(np.diff(pose, axis=0))
    slack = 0.6 * (norm(step[:, :3]) + (R + r + TOP) * norm(step[:, 3:]))
    # A flat mill is a hair thicker: the distance from its own cylinder would not pass zero.
    skin = max(r, 1e-9)
    # Its edge also makes the height along the motion a V instead of a parabola.
    stages, reach = (2, 0.25) if r > 0.05 * MM else (14, 1.0)
    usual = float(np.median(norm(step[:, :3])))
    stride = max(1, int(COARSE / max(usual, 1e-9)))
    for first in range(0, len(middle), BATCH):
        part = slice(first, first + BATCH)
        _cut(
            needle, order, starts, ball, pose[first : first + BATCH + 1], middle[part],
            slack[part], stride, stages, reach, R, skin, height,
        )  # fmt: skip
        if progress:
            progress(min(1.0, (first + BATCH) / len(middle)))
    return Heights(needles, height.reshape(rows, columns), len(needle) * len(middle))


def pieces(
    tip: FloatArray, axis: FloatArray, longest: float, arm: float
) -> tuple[FloatArray, FloatArray]:
    """Divide long motions so that neither tip nor rim moves further than ``longest`` [m]."""
    turn = norm(np.diff(axis, axis=0))
    way = norm(np.diff(tip, axis=0)) + arm * turn
    count = np.ceil(np.maximum(way / longest, turn / TURN)).astype(int).clip(1)
    row = np.repeat(np.arange(len(count)), count)
    nth = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
    share = (nth / count[row])[:, None]
    finer_tip = tip[row] + share * (tip[row + 1] - tip[row])
    finer_axis = _on_great_circle(axis[row], axis[row + 1], share)
    return np.vstack([finer_tip, tip[-1:]]), np.vstack([finer_axis, axis[-1:]])


def _on_great_circle(a: FloatArray, b: FloatArray, share: FloatArray) -> FloatArray:
    """Turn unit vectors a towards b by a share of the angle between them."""
    angle = np.arctan2(norm(np.cross(a, b)), np.einsum('ij,ij->i', a, b))[:, None]
    sine = np.sin(angle)
    small = sine < 1e-9
    safe = np.where(small, 1.0, sine)
    p = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    q = np.where(small, share, np.sin(share * angle) / safe)
    mixed = p * a + q * b
    return np.asarray(mixed / norm(mixed)[:, None])


def tiles(needles: Needles) -> tuple[Any, Any, FloatArray]:
    """Group needles into tiles: their order, where each begins, centre and radius of its ball."""
    rows, columns = needles.base.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    groups = [
        index[i : i + TILE, j : j + TILE].ravel()
        for i in range(0, rows, TILE)
        for j in range(0, columns, TILE)
    ]
    order = np.concatenate(groups)
    starts = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
    points = needles.base.reshape(-1, 3)[order]
    low, high = (edge.reduceat(points, starts[:-1]) for edge in (np.minimum, np.maximum))
    ball = np.empty((len(groups), 4))
    ball[:, :3] = 0.5 * (low + high)
    ball[:, 3] = 0.5 * norm(high - low)
    return order, starts, ball


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
def _cut(  # type: ignore[no-untyped-def]
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
