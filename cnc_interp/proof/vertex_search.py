"""Where a motion passes the vertices of its program: a search in chunks of its samples."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.proof.columns import gathered, spans
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.program_shapes import REACH, SLACK
from cnc_interp.proof.programmed_path import distances_to_vertices, peaks


class VertexSearch:
    """The search for the samples at which a motion passes vertices of its program."""

    def __init__(self, plan: PlanFiles):
        self.plan, self.count = plan, len(plan.position)
        # First sample of each row or of a later one.
        self.starts = np.full(len(plan.blocks['tip']) + 1, self.count)
        before = -1
        for a, b in spans(self.count):
            label = np.maximum.accumulate(np.maximum(plan.block[a:b], before))
            rows = np.arange(before + 1, label[-1] + 1)
            self.starts[rows] = a + np.searchsorted(label, rows)
            before = int(label[-1])

    def nearest(
        self,
        points_of: Callable[[FloatArray], FloatArray],
        vertices: FloatArray,
        tolerance: FloatArray,
        unit: FloatArray | None = None,
    ) -> tuple[FloatArray, IntArray]:
        """
        Search each vertex among the samples of its rows; if it is missed, among more samples.

        Parameters
        ----------
        points_of : callable
            Points, shape (k, 3), of axis positions, shape (k, n).
        vertices : ndarray, shape (M, 3)
            A point for each program row.
        tolerance : ndarray, shape (M,)
            Largest distance from it.
        unit : ndarray, shape (M, 3), optional
            Units in which the distance counts; then the tolerance is 1 of them.

        Returns
        -------
        distance : ndarray, shape (M,)
            Distance of each vertex from the motion.
        sample : ndarray of int, shape (M,)
            Sample before the nearest point.

        """
        allowed = tolerance if unit is None else np.ones(len(vertices))
        rows = np.arange(len(vertices))
        unit = np.broadcast_to(np.ones(3) if unit is None else unit, vertices.shape)
        # A vertex lies between its own row and the next. Rounding may shift the row of a sample by
        # one more, except at a stop: a tool that turns back has passed the vertex in the row
        # before.
        spread = np.where(self.plan.blocks['exact_stop'], 0, 1)
        nearest, where = self._among(rows - spread, rows + 1 + spread, points_of, vertices, unit)
        far = nearest > (allowed + SLACK if unit is None else allowed)
        if far.any():
            way = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(vertices, axis=0), axis=1)])
            reach = REACH * tolerance[far]
            first = np.searchsorted(way, way[far] - reach)
            last = np.searchsorted(way, way[far] + reach, 'right')
            first, last = np.minimum(first, rows[far] - 1), np.maximum(last, rows[far] + 2)
            nearest[far], where[far] = self._among(
                first, last, points_of, vertices[far], unit[far]
            )
        far = nearest > allowed
        if far.any():
            more = self._peaks(where[far], points_of, unit[far])
            nearest[far] = np.maximum(nearest[far] - more, 0.0)
        return nearest, where

    def _peaks(
        self,
        where: IntArray,
        points_of: Callable[[FloatArray], FloatArray],
        unit: FloatArray,
    ) -> FloatArray:
        """Return the largest of the ``peaks`` over the chords near these samples, shape (m,)."""
        around = np.clip(where[:, None] + np.arange(-2, 4), 0, self.count - 1)
        points = points_of(gathered(self.plan.position, around.ravel())).reshape(-1, 6, 3)
        return np.asarray(np.linalg.norm(peaks(points) / unit[:, None], axis=2).max(axis=1))

    def _among(
        self,
        first: IntArray,
        last: IntArray,
        points_of: Callable[[FloatArray], FloatArray],
        vertices: FloatArray,
        unit: FloatArray,
    ) -> tuple[FloatArray, IntArray]:
        """Search vertices among the samples of rows, with one sample more on each side."""
        end = len(self.starts) - 1
        low = np.clip(self.starts[np.clip(first, 0, end)] - 1, 0, self.count - 2)
        high = np.clip(self.starts[np.clip(last + 1, 0, end)], 1, self.count - 1)
        nearest, where = np.full(len(vertices), np.inf), np.zeros(len(vertices), dtype=np.int64)
        for a, b in spans(self.count):
            k = np.flatnonzero((low < b) & (high > a) & (nearest > 0.0))
            if not len(k):
                continue
            begin = max(a - 1, 0)
            points = points_of(self.plan.position[begin : b + 2])
            samples = np.maximum(low[k], a) - begin, np.minimum(high[k], b) - begin
            found, at = distances_to_vertices(points, vertices[k], *samples, unit[k])
            better = found < nearest[k]
            nearest[k[better]], where[k[better]] = found[better], begin + at[better]
        return nearest, where
