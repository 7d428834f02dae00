"""Segments whose passages of the pole are not chosen yet, and bounds of these passages."""

from __future__ import annotations

from dataclasses import dataclass
from math import comb
from typing import Self

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.kinematics import pole_bounds as polar
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.kinematics.path_ahead import PassageEnd, PathAhead
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.segments import PathSegments

AT_POLE = 0.9  #: The path is at the pole if nearer to it than this share of its tolerance [-].
EXACT = 0.01  #: Accuracy of the bound of the deviation, over the remaining tolerance [-].
#: Matrices from the coefficients of a polynomial to its Bezier values, of degree 6 and 5.
TO_BEZIER = [
    np.array([[comb(j, k) / comb(n, k) for k in range(n + 1)] for j in range(n + 1)])
    for n in (6, 5)
]


@dataclass(frozen=True)
class Guides:
    """Guides of the outer axis, one row per segment, and bounds of their effect."""

    rows: slice
    values: FloatArray  # (n, 13)
    bounds: FloatArray  # of the deviation, (n,) [rad]
    turning: float  # bound of C' [rad/m]


@dataclass(frozen=True, kw_only=True)
class PathAtPole(PathAhead):
    transform: FiveAxis  #: The machine's five-axis transformation.
    #: (n, 2): Parameters between which a segment is at the pole; first > last if it is not.
    near: FloatArray
    sine: FloatArray  #: (n,): Sine of the angle between tool axis and pole at the start [-].
    rates: FloatArray

    @classmethod
    def look_at(
        cls, transform: FiveAxis, height: float, segments: PathSegments, motion: IntArray
    ) -> Self:
        n = len(segments)
        ahead = PathAhead.of(height, segments, motion, np.tile(axes.NO_GUIDE, (n, 1)))
        rates, sine, near = polar.rates_of(segments), np.ones(n), np.tile([2.0, -1.0], (n, 1))
        rows = np.flatnonzero(segments.interpolation == POSES)
        if len(rows):
            posed = segments[rows]
            limits = AT_POLE * np.maximum(posed.room, 0.0) / height
            near[rows], sine[rows] = polar.near_pole(
                transform.packed,
                posed.kind,
                ahead.shapes[rows],
                posed.parametrization,
                rates[rows, polar.TURN],
                limits,
            )
        return cls(**vars(ahead), transform=transform, near=near, sine=sine, rates=rates)

    def sine_at(self, i: int, u: float) -> float:
        kind, span = self.segments.kind[i], self.segments.parametrization[i]
        return float(polar.pole_sine(self.transform.packed, kind, self.shapes[i], span, u))

    def following(self, i: int, u: float, s: float, branch: float, near: float) -> PassageEnd:
        """Return the rotary positions on a branch for the tool axis at one point of a segment."""
        outer = self.transform.outer
        stands = axes.Stands(np.zeros(3 + self.beside.shape[2]), np.array([branch]), self.height)
        stands.q[3 + outer] = near
        inside = u + (1e-9 if u < 0.5 else -1e-9)
        place = axes.Place(0.0, u, inside)
        q = axes.sample(self.transform.packed, self.segment(i), stands, axes.NO_GUIDE, place)[0]
        return PassageEnd(i, u, s, q[:, 3 + outer].copy(), branch, q[0, 4 - outer])

    def may_change_sign(self, i: int, tilt: float) -> bool:
        """Return whether the tilt may change to this side: its travel must be as long there."""
        transform = self.transform
        inner = 1 - transform.outer
        low, high = transform.machine.travel[3 + inner]
        pole = transform.pole if self.segments.axis[i] @ transform.pole > 0.0 else -transform.pole
        level = transform.rotary_solutions(pole)
        upright = float(level[0][inner]) if level else 0.0
        tilt = upright + (tilt - upright + np.pi) % (2.0 * np.pi) - np.pi
        down, up = upright - low, high - upright
        return bool(up >= down - 1e-9 if tilt > upright else down >= up - 1e-9)

    # Stretches -------------------------------------------------------------------------------

    def guides_between(self, left: PassageEnd, right: PassageEnd) -> Guides:
        rows, guides = self.led_between(left, right)
        return Guides(rows, guides, *self._bounds(rows, guides))

    def _bounds(self, rows: slice, guides: FloatArray) -> tuple[FloatArray, float]:
        segments = self.segments[rows]
        slope, length = guides[0, axes.GUIDE], guides[0, axes.GUIDE_LENGTH]
        turning = np.zeros(2)
        for order in (1, 2):
            slope = slope[1:] * np.arange(1, len(slope)) / length
            turning[order - 1] = np.abs(TO_BEZIER[order - 1] @ slope).max()
        exact = EXACT * np.maximum(segments.room, 1e-9) / self.height
        packed, rates = self.transform.packed, self.rates[rows]
        bounds = polar.gap_bounds(packed, self.rows(rows), guides, rates, turning, exact)
        return np.asarray(bounds), float(turning[0])
