"""
The motion of a mill as the N-buffer cuts with it: short pieces that are nearly straight.

Between two poses tip and axis move on straight lines. The pieces are short, so that a parabola
through three heights locates the lowest height. All numbers that the cut depends on are those of
the whole motion; a part of the needles is cut by the pieces that can reach it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.needle_cuts import DEPTH, ROUNDING, SHORT, TOP
from cnc_interp.cam.vectors import dot, norm
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM

#: Longest piece of motion, as a share of the corner radius.
PIECE = 0.3
#: Largest turn of the axis in a piece [rad]; centre and tip then both move nearly straight.
TURN = 2.5e-3
#: Distance of the poses of a first, rough cut [m].
COARSE = 0.4 * MM
#: Pieces of a batch; each batch begins with a rough cut.
BATCH = 2000


@dataclass(frozen=True)
class Sweep:
    """Pieces of the motion of a mill."""

    cutter: Cutter  #: The mill.
    #: (n, 6): C_L [m] and unit tool axis [-] at the beginning, in the middle and at the end of a
    #: piece.
    first: FloatArray
    middle: FloatArray
    last: FloatArray
    #: (n,): Largest motion of the mill between the middle and an end of a piece [m].
    slack: FloatArray
    rough: BoolArray  #: (n,): Pieces of the first cut of a batch.
    batch: IntArray  #: (n,): Batch of each piece, in increasing order.

    @staticmethod
    def of(cutter: Cutter, tip: FloatArray, axis: FloatArray) -> Sweep:
        """Divide a motion into pieces."""
        if len(tip) < 2 or not (np.isfinite(tip).all() and np.isfinite(axis).all()):
            raise InterpError('a simulation needs two finite poses or more')
        R, r = cutter.tool_radius, cutter.corner_radius
        tip, axis = pieces(tip, axis, PIECE * min(max(r, 0.5 * MM), 5.0 * MM), R + r)
        pose = np.concatenate([tip + r * axis, axis], axis=1)
        middle = 0.5 * (pose[1:] + pose[:-1])
        middle[:, 3:] /= norm(middle[:, 3:])[:, None]
        step = np.abs(np.diff(pose, axis=0))
        slack = 0.6 * (norm(step[:, :3]) + (R + r + TOP) * norm(step[:, 3:]))
        usual = float(np.median(norm(step[:, :3])))
        stride = max(1, int(COARSE / max(usual, 1e-9)))
        number = np.arange(len(middle))
        rough = number % BATCH % stride == 0
        return Sweep(cutter, pose[:-1], middle, pose[1:], slack, rough, number // BATCH)

    def __len__(self) -> int:
        return len(self.middle)

    @property
    def skin(self) -> float:
        """
        Distance of the mill's surface from its cylinder [m].

        The distance from the cylinder of a flat mill never becomes negative, so it gets a skin.
        """
        return max(self.cutter.corner_radius, 1e-9)

    @property
    def search(self) -> tuple[int, float]:
        """
        Stages of the search for the lowest height, and half its first interval [-].

        A sharp edge makes the height along the motion a V instead of a parabola.
        """
        return (2, 0.25) if self.cutter.corner_radius > 0.05 * MM else (14, 1.0)

    def near(self, centre: FloatArray, radius: float) -> Sweep:
        """Return the pieces that can reach needles; the others change none of them."""
        v = centre - self.middle[:, :3]
        along = dot(v, self.middle[:, 3:])
        across = np.sqrt(np.maximum(dot(v, v) - along * along, 0.0))
        beyond = np.maximum(across - self.cutter.tool_radius, 0.0)
        away = np.hypot(np.minimum(along, 0.0), beyond)
        reach = radius + self.skin + max(TOP, DEPTH) + SHORT + ROUNDING
        kept = away <= reach + self.slack
        return Sweep(
            self.cutter, self.first[kept], self.middle[kept], self.last[kept], self.slack[kept],
            self.rough[kept], self.batch[kept],
        )  # fmt: skip


def pieces(
    tip: FloatArray, axis: FloatArray, longest: float, arm: float
) -> tuple[FloatArray, FloatArray]:
    """Divide long motions so that neither tip nor rim moves further than a length."""
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
