"""
N-buffer: needles along the normals of a surface, cut by the moving mill.

The mill is convex: all points within r_c of a cylinder of radius R that stands on C_L. The
distance of a point of the needle ``B + h n`` from that cylinder is a convex function of h.
Newton's method from below therefore converges monotonically to the height at which the needle
enters the mill. Between two poses tip and axis move on straight lines. The pieces are short, so
that a parabola through three heights locates the lowest height, which is then computed exactly.
The result is the signed height of the material: scallop, excess or gouge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.needle_cuts import TOP, cut
from cnc_interp.cam.surface import Surface
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM, UM

#: Approximate number of needles in a tile, which is tested as a whole.
TILE = 64
#: Longest piece of motion, as a share of the corner radius.
PIECE = 0.3
#: Largest turn of the axis in a piece [rad]; centre and tip then both move nearly straight.
TURN = 2.5e-3
#: Distance of the poses of a first, rough cut [m].
COARSE = 0.4 * MM
#: Poses cut between two calls of the progress.
BATCH = 2000


@dataclass(frozen=True)
class Needles:
    """
    The points at which the machined surface is measured.

    Parameters
    ----------
    base : ndarray, shape (rows, columns, 3)
        Points of the surface [m].
    normal : ndarray, shape (rows, columns, 3)
        Unit normals there [-].

    """

    base: FloatArray
    normal: FloatArray

    @staticmethod
    def on(surface: Surface, spacing: float, margin: float = 0.0) -> Needles:
        """
        Place needles on a surface at nearly equal distances.

        Parameters
        ----------
        surface : Surface
            The surface.
        spacing : float
            Distance of the needles [m].
        margin : float
            Distance of the outer needles from the border [m].

        Returns
        -------
        Needles

        Raises
        ------
        InterpError
            If spacing and margin make too few or too many needles.

        """
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
    The material that the mill leaves on the needles.

    Parameters
    ----------
    needles : Needles
        The needles.
    height : ndarray, shape (rows, columns)
        Signed height above the surface; ``TOP`` where nothing was cut [m].
    pairs : int
        Needles times pieces of motion, for benchmarks.

    """

    needles: Needles
    height: FloatArray
    pairs: int

    @property
    def cut(self) -> Any:
        """True for needles that the mill has reached, shape (rows, columns)."""
        return self.height < 0.999 * TOP

    def statistics(self) -> dict[str, float]:
        """
        Return the roughness figures of the needles that were cut.

        Returns
        -------
        dict of str to float
            ``highest``, ``lowest`` and ``mean`` height; ``Sa`` and ``Sq``, mean and root mean
            square of the height about its mean; ``Sz``, its range [m]. ``gouged`` is the share of
            needles deeper than 0.5 um, ``uncut`` the share that no motion reached [-].

        Raises
        ------
        InterpError
            If no needle was cut.

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
        The needles.
    cutter : Cutter
        The mill.
    tip : ndarray, shape (n, 3)
        Tool tips in order; tip and axis move on straight lines between them [m].
    axis : ndarray, shape (n, 3)
        Unit tool axes [-].
    progress : callable, optional
        Is called with the share done, 0 to 1.

    Returns
    -------
    Heights

    Raises
    ------
    InterpError
        If there are fewer than two poses or one is not finite.

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
    # The distance from the cylinder of a flat mill never becomes negative, so it gets a skin.
    skin = max(r, 1e-9)
    # A sharp edge makes the height along the motion a V instead of a parabola.
    stages, reach = (2, 0.25) if r > 0.05 * MM else (14, 1.0)
    usual = float(np.median(norm(step[:, :3])))
    stride = max(1, int(COARSE / max(usual, 1e-9)))
    for first in range(0, len(middle), BATCH):
        part = slice(first, first + BATCH)
        cut(
            needle, order, starts, ball, pose[first : first + BATCH + 1], middle[part],
            slack[part], stride, stages, reach, R, skin, height,
        )  # fmt: skip
        if progress:
            progress(min(1.0, (first + BATCH) / len(middle)))
    return Heights(needles, height.reshape(rows, columns), len(needle) * len(middle))


def pieces(
    tip: FloatArray, axis: FloatArray, longest: float, arm: float
) -> tuple[FloatArray, FloatArray]:
    """
    Divide long motions so that neither tip nor rim moves further than a length.

    Parameters
    ----------
    tip : ndarray, shape (n, 3)
        Tool tips [m].
    axis : ndarray, shape (n, 3)
        Unit tool axes [-].
    longest : float
        Largest motion of a piece [m].
    arm : float
        Distance of the rim from the tip [m].

    Returns
    -------
    tip : ndarray, shape (m, 3)
        Tool tips, m >= n [m].
    axis : ndarray, shape (m, 3)
        Unit tool axes [-].

    """
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
    """Turn unit vectors a towards b, shape (n, 3), by a share of their angle, shape (n, 1) [-]."""
    angle = np.arctan2(norm(np.cross(a, b)), np.einsum('ij,ij->i', a, b))[:, None]
    sine = np.sin(angle)
    small = sine < 1e-9
    safe = np.where(small, 1.0, sine)
    p = np.where(small, 1.0 - share, np.sin((1.0 - share) * angle) / safe)
    q = np.where(small, share, np.sin(share * angle) / safe)
    mixed = p * a + q * b
    return np.asarray(mixed / norm(mixed)[:, None])


def tiles(needles: Needles) -> tuple[Any, Any, FloatArray]:
    """
    Group needles into tiles.

    Parameters
    ----------
    needles : Needles
        k needles.

    Returns
    -------
    order : ndarray of int, shape (k,)
        Numbers of the needles, tile by tile.
    starts : ndarray of int, shape (tiles + 1,)
        Place in ``order`` where each tile begins; the last entry is k.
    ball : ndarray, shape (tiles, 4)
        Centre and radius of a ball around the points of each tile [m].

    """
    rows, columns = needles.base.shape[:2]
    index = np.arange(rows * columns).reshape(rows, columns)
    # The rows of sections are far apart and their columns close; a tile is still nearly square.
    steps = [
        float(np.median(norm(np.diff(needles.base, axis=k)))) if n > 1 else 1.0
        for k, n in enumerate((rows, columns))
    ]
    wide = int(np.clip(np.sqrt(TILE * min(steps[0] / max(steps[1], 1e-12), TILE)), 1, TILE))
    tall = TILE // wide
    groups = [
        index[i : i + tall, j : j + wide].ravel()
        for i in range(0, rows, tall)
        for j in range(0, columns, wide)
    ]
    order = np.concatenate(groups)
    starts = np.concatenate([[0], np.cumsum([len(g) for g in groups])])
    points = needles.base.reshape(-1, 3)[order]
    low, high = (edge.reduceat(points, starts[:-1]) for edge in (np.minimum, np.maximum))
    ball = np.empty((len(groups), 4))
    ball[:, :3] = 0.5 * (low + high)
    ball[:, 3] = 0.5 * norm(high - low)
    return order, starts, ball
