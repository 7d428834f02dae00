"""Surfaces that a boundary trims: outer loops and holes, as polygons of parameters."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from scipy.spatial import cKDTree

from cnc_interp.cam.surface import Surface, SurfaceError
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.units import MM

#: Distance of the points that stand for the boundary [m].
BOUNDARY = 0.05 * MM
#: Largest gap between edges that meet, as a share of the extent of the boundary.
GAP = 2e-4


class Trimmed(Surface):
    """
    A surface of which only the part within a boundary is machined.

    The surface itself continues beyond the boundary. Its domain is the smallest rectangle around
    the boundary.
    """

    def __init__(self, surface: Surface, edges: Sequence[FloatArray]):
        edges = joined(edges)
        corners = np.concatenate(edges)
        (u0, v0), (u1, v1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        if not (u0 < u1 and v0 < v1):
            raise SurfaceError('the boundary encloses nothing')
        super().__init__(((u0, u1), (v0, v1)))
        self.surface, self.sign = surface, surface.sign
        #: Straight pieces of the boundary, shape (k, 4): u and v of both ends.
        self.pieces = np.concatenate([np.hstack([e[:-1], e[1:]]) for e in edges])
        self.boundary = self._boundary()
        self._tree = cKDTree(self.boundary)

    def derivatives(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, ...]:
        """Return the position and its first and second derivatives."""
        return self.surface.derivatives(u, v)

    def contains(self, u: FloatArray, v: FloatArray, margin: float = 0.0) -> BoolArray:
        """Tell which points lie within the boundary, or no further than a margin outside."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        inside: BoolArray = within(self.pieces, u.ravel(), v.ravel()).reshape(u.shape)
        if not margin:
            return inside
        unsure = inside if margin < 0.0 else ~inside & super().contains(u, v, 2.0 * margin)
        where = self.derivatives(u[unsure], v[unsure])[0]
        sound = np.isfinite(where).all(axis=1)
        near = np.zeros(len(where), bool)
        near[sound] = self._tree.query(where[sound])[0] <= abs(margin)
        inside[unsure] = near if margin > 0.0 else ~near
        return inside

    def _boundary(self) -> FloatArray:
        """Return points along the boundary at distances of at most ``BOUNDARY`` [m]."""
        a, b = self.pieces[:, :2], self.pieces[:, 2:]
        ends = [self.derivatives(*x.T)[0] for x in (a, b)]
        count = np.ceil(norm(ends[1] - ends[0]) / BOUNDARY).astype(int).clip(1, 10_000)
        row = np.repeat(np.arange(len(count)), count)
        nth = np.arange(len(row)) - np.repeat(np.cumsum(count) - count, count)
        uv = a[row] + (nth / count[row])[:, None] * (b[row] - a[row])
        return np.asarray(self.derivatives(*uv.T)[0])


def joined(edges: Sequence[FloatArray]) -> list[FloatArray]:
    """Close the small gaps between edges: all ends at one vertex become the same."""
    corners = np.concatenate(edges)
    size = np.maximum(np.ptp(corners, axis=0), 1e-12)
    ends = np.array([row for edge in edges for row in (edge[0], edge[-1])])
    near = cKDTree(ends / size).query_ball_point(ends / size, GAP)
    if any(len(group) < 2 for group in near):
        raise SurfaceError('the boundary is not closed')
    found = []
    for k, edge in enumerate(edges):
        closed = np.array(edge, float)
        closed[0], closed[-1] = (ends[min(near[2 * k + i])] for i in (0, 1))
        found.append(closed)
    return found


@njit(cache=True, nogil=True)
def within(pieces: FloatArray, u: FloatArray, v: FloatArray) -> BoolArray:
    """Tell which points lie within closed polygons, by the parity of the pieces beside them."""
    inside = np.zeros(len(u), np.bool_)
    for i in range(len(u)):
        for j in range(len(pieces)):
            low, high = pieces[j, 1], pieces[j, 3]
            if (low > v[i]) != (high > v[i]):
                share = (v[i] - low) / (high - low)
                if u[i] < pieces[j, 0] + share * (pieces[j, 2] - pieces[j, 0]):
                    inside[i] = not inside[i]
    return inside
