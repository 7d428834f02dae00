"""Which vertices of the chain are corners: found when all that this depends on has come."""

from __future__ import annotations

import numpy as np

from cnc_interp.smoothing.dense import skeleton
from cnc_interp.smoothing.dense.growing_skeleton import Chain


class CornerSearch:
    """
    Mark the corners of a growing chain.

    Parameters
    ----------
    angle : float
        Sharper turns are corners [rad].

    """

    def __init__(self, angle: float):
        self._angle = angle
        self.turned = 0  # vertices whose turn is known
        self.decided = 0  # vertices that are known to be corners or not

    def look(self, chain: Chain, final: bool) -> None:
        """Look at the vertices from where the chain reaches far enough, all if it is final."""
        n, tolerance = len(chain), chain.tolerance
        # a repeated point to come may still close the last vertex
        closed = np.flatnonzero(chain.closed[: n if final else n - 1])
        known = int(closed[-1]) + 1 if len(closed) else 0
        widest = float(tolerance[-1].max())
        turned = n
        if not final:
            seen = np.searchsorted(chain.u, chain.u[-1] - skeleton.REACH * widest, 'right')
            turned = max(known, min(int(seen), n - 1), self.turned)
        if turned > self.turned:
            chain.turn[self.turned : turned] = skeleton.turns(
                chain.blocks.tip, chain.top, chain.u, chain.closed, tolerance, self.turned, turned
            )
        self.turned = turned
        decided = n
        if not final:
            last = chain.u[turned - 1] if turned else -np.inf
            seen = np.searchsorted(chain.u, last - skeleton.CHORD * widest, 'left')
            decided = max(known, int(seen), self.decided)
        if decided > self.decided:
            chain.corner[self.decided : decided] |= skeleton.corners(
                chain.turn[:turned], chain.u[:turned], chain.closed[:turned], tolerance[:turned],
                self._angle, self.decided, decided,
            )  # fmt: skip
        self.decided = decided

    def shift(self, first: int) -> None:
        """Count the vertices from a later one."""
        self.turned -= first
        self.decided -= first
