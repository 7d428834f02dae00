"""Keep the mill outside the surface and the other faces of a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from cnc_interp.cam.cutter import Cutter, Postures
from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.passes import Angles, runs
from cnc_interp.cam.scallop import resting
from cnc_interp.cam.surface import Surface, SurfaceError, place
from cnc_interp.core import DEG, MM, UM, BoolArray, FloatArray, IntArray, unit
from cnc_interp.core.kernels import njit

#: Number of rays on which the bottom of the mill is tested; circles on it, as shares of R.
RAYS, CIRCLES = 48, (0.4, 0.7, 1.0)
BEYOND = 0.2 * MM  #: Points further beyond the border than this do not belong to the surface [m].


def gouge_depth(surface: Surface, postures: Postures) -> FloatArray:
    """Return how deep the bottom of the mill enters the surface, tested at points on circles."""
    cutter, frames = postures.cutter, postures.frames
    depth = np.zeros(len(postures))
    turn = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    front, across = postures.front[:, None], postures.turned[1][:, None]
    e = front * np.cos(turn)[:, None] + across * np.sin(turn)[:, None]
    for part in CIRCLES:
        points = postures.centre[:, None, :] + part * cutter.tool_radius * e
        guess = (np.broadcast_to(x[:, None], points.shape[:2]) for x in (frames.u, frames.v))
        u, v, above = surface.project(points, *guess)
        ours = surface.contains(u, v, BEYOND)
        deep = np.where(ours & np.isfinite(above), cutter.corner_radius - above, 0.0)
        depth = np.maximum(depth, deep.max(axis=1))
    return depth


FALL = 4.0 * MM  #: Distance over which a raised tilt falls off on each side [m].
#: Depth at which a raised tilt is accepted, as a share of the allowed depth, because postures lie
#: in between [-].
SHARE = 0.5
#: Places in each interval of a pass at which the heel is tested, because it meets hollows
#: suddenly.
FINER = 4
HALVINGS = 14  #: Halvings of the interval of tilts.


def finely(s: FloatArray, parts: list[tuple[float, float]]) -> FloatArray:
    step = float(np.median(np.diff(s))) / FINER
    counts = (max(2, int(np.ceil((last - first) / step)) + 1) for first, last in parts)
    return np.concatenate([np.linspace(*ends, n) for ends, n in zip(parts, counts, strict=True)])


def raised(
    curve: GuidingCurve,
    cutter: Cutter,
    angles: Angles,
    parts: list[tuple[float, float]],
    highest: float,
    gouge: float,
) -> Angles:
    """Raise tilts where the heel would enter the surface, and smoothly beside these places."""
    if not parts:
        return angles
    s = finely(angles.s, parts)
    tool = angles.postures(curve, cutter, s)

    def enters(tilt: FloatArray, of: BoolArray) -> BoolArray:
        postures = resting(cutter, curve.frames(s[of]), tilt[of], tool.yaw[of])
        return gouge_depth(curve.surface, postures) > SHARE * gouge

    deep = enters(tool.tilt, np.ones(len(s), bool))
    if not deep.any():
        return angles
    low, high = tool.tilt.copy(), np.full(len(s), highest)
    if enters(high, deep).any():
        where = tool.contact[deep][int(np.argmax(enters(high, deep)))]
        raise SurfaceError(
            f'at {place(where)} the bottom of the mill enters the surface even at the largest '
            f'tilt, {highest / DEG:g} deg: the surface is hollow there; take a smaller mill'
        )
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        still = enters(middle, deep)
        low[deep] = np.where(still, middle[deep], low[deep])
        high[deep] = np.where(still, high[deep], middle[deep])
    rise = np.where(deep, high - tool.tilt, 0.0)
    tilt = np.minimum(angles.tilt + smooth_cover(s, rise, FALL, angles.s), highest)
    return Angles(angles.s, tilt, angles.yaw)


def smooth_cover(s: FloatArray, values: FloatArray, distance: float, at: FloatArray) -> FloatArray:
    """Return a smooth function that is nowhere below the values: a mean of maxima nearby."""
    step = float(np.median(np.diff(s)))
    middle = np.arange(s[0] - 2.0 * distance, s[-1] + 2.0 * distance + step, step)
    near = np.abs(middle[:, None] - s[None, :]) <= distance
    largest = np.where(near, values[None, :], 0.0).max(axis=1)
    gap = np.abs(at[:, None] - middle[None, :])
    weight = np.where(gap <= distance, 1.0 + np.cos(np.pi * gap / distance), 0.0)
    total = weight.sum(axis=1)
    return np.asarray(weight @ largest / np.where(total > 0.0, total, 1.0))


STEP = 0.2 * MM  #: Spacing of the tested poses [m].
GOUGE = 1.0 * UM  #: Largest depth at which the mill may enter a neighbour [m].
SHORTEST = 1.0 * MM  #: Parts shorter than this are left out [m].

RowsAt = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Neighbours:
    points: FloatArray  #: (n, 3): Points on the faces and their edges [m].
    face: IntArray  #: (n,): Number of the face of each point.

    def without(self, face: int) -> Neighbours | None:
        others = self.face != face
        return Neighbours(self.points[others], self.face[others]) if others.any() else None

    def turned(self, rotation: FloatArray) -> Neighbours:
        return Neighbours(np.ascontiguousarray(self.points @ rotation.T), self.face)

    def depth(self, cutter: Cutter, tip: FloatArray, axis: FloatArray) -> FloatArray:
        """Return how deep the mill and its shank of the same diameter enter the points [m]."""
        pose = np.concatenate([tip + cutter.corner_radius * axis, axis], axis=1)
        found = deepest(self.points, pose, cutter.tool_radius, cutter.corner_radius)
        return np.asarray(found)

    def free_parts(
        self, rows: RowsAt, cutter: Cutter, parts: list[tuple[float, float]]
    ) -> list[tuple[float, float]]:
        free = []
        for first, last in parts:
            s = np.linspace(first, last, max(2, int(np.ceil((last - first) / STEP)) + 1))
            row = rows(s)
            good = self.depth(cutter, row[:, :3], unit(row[:, 3:] - row[:, :3])) <= GOUGE
            found = [(float(s[x.start]), float(s[x.stop - 1])) for x in runs(good)]
            free += [x for x in found if x[1] - x[0] >= SHORTEST]
        return free


@njit(cache=True, nogil=True)
def deepest(points: FloatArray, pose: FloatArray, R: float, r: float) -> FloatArray:
    """Return how deep mills (C_L, axis), (m, 6), enter the deepest of points, (m,) [m]."""
    depth = np.full(len(pose), -np.inf)
    for i in range(len(pose)):
        c = pose[i]
        for j in range(len(points)):
            x, y, z = points[j, 0] - c[0], points[j, 1] - c[1], points[j, 2] - c[2]
            along = x * c[3] + y * c[4] + z * c[5]
            across = sqrt(max(x * x + y * y + z * z - along * along, 0.0))
            low, out = min(along, 0.0), max(across - R, 0.0)
            distance = sqrt(low * low + out * out)
            inside = r - distance if distance > 0.0 else r + min(along, R - across)
            depth[i] = max(depth[i], inside)
    return depth
