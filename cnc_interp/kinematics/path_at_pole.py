"""Segments of which the passages of the pole are not decided yet, and what is known of each.

Places on them are given by path length [m] or by segment and parameter u.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import comb

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.kinematics import pole_bounds as polar
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.kinematics.axis_path import septic_coefficients
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.segments import PathSegments

AT_POLE = 0.9  #: The path is at the pole where this share of its tolerance reaches it [-].
SAME_PLACE = 1e-9  #: Places on the path that are nearer together are the same [m].
EXACT = 0.01  #: How exact the bound of the deviation should be, over the tolerance left [-].
#: From coefficients of a polynomial of degree 6 to its Bezier values; its second row is that of 5.
TO_BEZIER = [
    np.array([[comb(j, k) / comb(n, k) for k in range(n + 1)] for j in range(n + 1)])
    for n in (6, 5)
]


@dataclass(frozen=True)
class PassageEnd:
    segment: int
    u: float
    s: float  #: Path length [m].
    jet: FloatArray  #: (4,): The outer axis, three derivatives by path length [rad, rad/m ...].
    branch: float
    tilt: float  #: Inner axis [rad].
    forbidden: bool = False  #: Whether travel keeps the tilt from changing its sign.


@dataclass(frozen=True)
class Guides:
    """Where the outer axis is given: a row for each segment, and the bounds of what it does."""

    rows: slice
    values: FloatArray  # (n, 13)
    bounds: FloatArray  # of the deviation, (n,) [rad]
    turning: float  # bound of C' [rad/m]


@dataclass(frozen=True)
class PathAtPole:
    transform: FiveAxis  #: The machine's five-axis transformation.
    height: float  #: Flank height [m].
    segments: PathSegments  #: The segments, n of them.
    motion: IntArray  #: (n,): How their rotary axes move.
    guides: FloatArray  #: (n, 13): Where the outer axis is given, as far as it is decided.
    bound: FloatArray  #: (n,): That of the deviation there [rad].
    #: (n,): Position to which the outer axis turns at rest before a segment [rad], else NaN.
    turn_first: FloatArray
    shapes: FloatArray
    beside: FloatArray
    lengths: FloatArray  #: (n,): Path length [m].
    near: FloatArray  #: (n, 2): Parameters between which it is at the pole; first > last if not.
    sine: FloatArray  #: (n,): Sine of the angle between tool axis and pole at the start [-].
    rates: FloatArray
    begun: float = 0.0  #: Path length from the last stop to the first of them [m].

    @classmethod
    def look_at(
        cls, transform: FiveAxis, height: float, segments: PathSegments, motion: IntArray
    ) -> PathAtPole:
        n = len(segments)
        shapes, beside = axes.shapes_of(segments), axes.beside_of(segments)
        rates, lengths, sine = polar.rates_of(segments), np.zeros(n), np.ones(n)
        near = np.tile([2.0, -1.0], (n, 1))
        rows = np.flatnonzero(segments.interpolation == POSES)
        if len(rows):
            posed = segments[rows]
            some = (posed.kind, shapes[rows])
            lengths[rows] = polar.lengths_of(*some, beside[rows], posed.length)
            limits = AT_POLE * np.maximum(posed.room, 0.0) / height
            near[rows], sine[rows] = polar.near_pole(
                transform.packed, *some, posed.parametrization, rates[rows, polar.TURN], limits
            )
        return cls(
            transform,
            height,
            segments,
            motion.copy(),
            np.tile(axes.NO_GUIDE, (n, 1)),
            np.zeros(n),
            np.full(n, np.nan),
            shapes,
            beside,
            lengths,
            near,
            sine,
            rates,
        )

    def __len__(self) -> int:
        return len(self.segments)

    def __getitem__(self, rows: slice) -> PathAtPole:
        columns = {name: getattr(self, name)[rows] for name in COLUMNS}
        return replace(self, segments=self.segments[rows], **columns)

    def and_more(self, more: PathAtPole) -> PathAtPole:
        parts = (self, more)
        columns = {name: np.concatenate([getattr(x, name) for x in parts]) for name in COLUMNS}
        segments = PathSegments.concatenate([x.segments for x in parts])
        return replace(self, segments=segments, **columns)

    def with_poses(self, i: int) -> bool:
        return int(self.motion[i]) in (axes.RESTING, axes.FOLLOWING)

    @cached_property
    def ends(self) -> FloatArray:
        """Path lengths at the ends of the segments, (n + 1,), the start first [m]."""
        return np.cumsum(np.concatenate([[self.begun], self.lengths]))

    # Places ----------------------------------------------------------------------------------

    def way(self, i: int, u: float) -> float:
        kind, length = self.segments.kind[i], self.segments.length[i]
        return float(polar.way_to(kind, self.shapes[i], self.beside[i], length, u))

    def sine_at(self, i: int, u: float) -> float:
        kind, span = self.segments.kind[i], self.segments.parametrization[i]
        return float(polar.pole_sine(self.transform.packed, kind, self.shapes[i], span, u))

    def place(self, s: float) -> tuple[int, float]:
        i = int(np.clip(np.searchsorted(self.ends, s, 'right') - 1, 0, len(self) - 1))
        way = s - float(self.ends[i])
        if way <= SAME_PLACE or way >= self.lengths[i] - SAME_PLACE:
            return i, 0.0 if way <= SAME_PLACE else 1.0
        kind, length = self.segments.kind[i], self.segments.length[i]
        return i, float(polar.place_at(kind, self.shapes[i], self.beside[i], length, way))

    def following(self, i: int, u: float, s: float, branch: float, near: float) -> PassageEnd:
        """Solve the rotary axes for the tool axis at one point, on a branch."""
        outer, segments = self.transform.outer, self.segments
        stands = axes.Stands(np.zeros(3 + self.beside.shape[2]), np.array([branch]), self.height)
        stands.q[3 + outer] = near
        inside = u + (1e-9 if u < 0.5 else -1e-9)
        segment = axes.Segment(
            int(segments.kind[i]),
            axes.FOLLOWING,
            self.shapes[i],
            self.beside[i],
            segments.parametrization[i],
            float(segments.length[i]),
        )
        place = axes.Place(0.0, u, inside)
        q = axes.sample(self.transform.packed, segment, stands, axes.NO_GUIDE, place)[0]
        return PassageEnd(i, u, s, q[:, 3 + outer].copy(), branch, q[0, 4 - outer])

    def may_change_sign(self, i: int, tilt: float) -> bool:
        """Tell whether the tilt may go to the other side: its travel there is not the shorter."""
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
        begin = left.segment + (left.u >= 1.0)
        end = right.segment + (right.u > 0.0)
        guides = np.tile(axes.NO_GUIDE, (end - begin, 1))
        length = right.s - left.s
        coefficients = np.empty(8)
        septic_coefficients(left.jet, right.jet, length, coefficients)
        guides[:, axes.GUIDE_FROM], guides[:, axes.GUIDE_TO] = -1.0, 1.5
        if begin == left.segment:
            guides[0, axes.GUIDE_FROM] = left.u
        guides[-1, axes.GUIDE_TO] = right.u if end == right.segment + 1 else 1.0
        guides[:, axes.BRANCH_AFTER] = right.branch
        guides[:, axes.GUIDE_BEGUN] = self.ends[begin:end] - left.s
        guides[:, axes.GUIDE_LENGTH] = length
        guides[:, axes.GUIDE] = coefficients
        rows = slice(begin, end)
        return Guides(rows, guides, *self._bounds(rows, guides))

    def _bounds(self, rows: slice, guides: FloatArray) -> tuple[FloatArray, float]:
        segments = self.segments[rows]
        slope, length = guides[0, axes.GUIDE], guides[0, axes.GUIDE_LENGTH]
        turning = np.zeros(2)
        for order in (1, 2):
            slope = slope[1:] * np.arange(1, len(slope)) / length
            turning[order - 1] = np.abs(TO_BEZIER[order - 1] @ slope).max()
        exact = EXACT * np.maximum(segments.room, 1e-9) / self.height
        columns = axes.SegmentRows(
            segments.kind,
            np.full(len(segments), axes.FOLLOWING),
            self.shapes[rows],
            self.beside[rows],
            segments.parametrization,
            segments.length,
        )
        packed, rates = self.transform.packed, self.rates[rows]
        bounds = polar.gap_bounds(packed, columns, guides, rates, turning, exact)
        return np.asarray(bounds), float(turning[0])


#: What is known of each segment, beside the segment itself.
COLUMNS = tuple(
    field.name
    for field in fields(PathAtPole)
    if field.name not in ('transform', 'height', 'segments', 'begun')
)
