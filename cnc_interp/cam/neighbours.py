"""The other faces of a part, as points: passes end where the mill would enter them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import sqrt

import numpy as np
from numba import njit

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.passes import runs
from cnc_interp.core import MM, UM, FloatArray, IntArray, unit

STEP = 0.2 * MM  #: Distance of the poses that are tested [m].
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
