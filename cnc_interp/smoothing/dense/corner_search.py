"""Corners of the skeleton, decided as soon as all vertices that matter have arrived."""

from __future__ import annotations

import numpy as np

from cnc_interp.smoothing.dense import thinning
from cnc_interp.smoothing.dense.skeleton import Skeleton


class CornerSearch:
    """Find the corners of a growing skeleton."""

    def __init__(self, angle: float):
        self._angle = angle
        self.turned = 0  # number of vertices whose turn is known
        self.decided = 0  # number of vertices that are known to be corners or not

    def decide(self, skeleton: Skeleton, final: bool) -> None:
        """Decide about the vertices that are known far enough in both directions."""
        n, tolerance = len(skeleton), skeleton.tolerance
        # A repeated point that arrives later may still close the last vertex.
        closed = np.flatnonzero(skeleton.closed[: n if final else n - 1])
        known = int(closed[-1]) + 1 if len(closed) else 0
        widest = float(tolerance[self.decided :].max())
        turned = n
        if not final:
            seen = np.searchsorted(skeleton.u, skeleton.u[-1] - thinning.REACH * widest, 'right')
            turned = max(known, min(int(seen), n - 1), self.turned)
        if turned > self.turned:
            skeleton.turn[self.turned : turned] = thinning.vertex_turns(
                skeleton.blocks.tip, skeleton.top, skeleton.u, skeleton.closed, tolerance,
                self.turned, turned,
            )  # fmt: skip
        self.turned = turned
        decided = n
        if not final:
            last = skeleton.u[turned - 1] if turned else -np.inf
            seen = np.searchsorted(skeleton.u, last - thinning.CHORD * widest, 'left')
            decided = max(known, int(seen), self.decided)
        if decided > self.decided:
            skeleton.corner[self.decided : decided] |= thinning.find_corners(
                skeleton.turn[:turned], skeleton.u[:turned], skeleton.closed[:turned],
                tolerance[:turned], self._angle, self.decided, decided,
            )  # fmt: skip
        self.decided = decided

    def shift(self, first: int) -> None:
        """Renumber the vertices after the first ones were dropped."""
        self.turned -= first
        self.decided -= first
