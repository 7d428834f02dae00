"""Segments that wait until their passages of singular poses are chosen.

A point on them is given by its path length [m], or by its segment and parameter u.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Self

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.kinematics import pole_bounds as polar
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.kinematics.axis_path import septic_coefficients
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.segments import PathSegments

SAME_PLACE = 1e-9  #: Points on the path nearer to each other than this are equal [m].


@dataclass(frozen=True)
class PassageEnd:
    segment: int
    u: float
    s: float  #: Path length [m].
    #: (4,): The leading axis and three derivatives by path length [rad, rad/m ...].
    jet: FloatArray
    branch: float
    tilt: float = 0.0  #: Inner axis of a five-axis machine [rad].
    forbidden: bool = False  #: Whether the travel prevents a change of sign of the tilt.


@dataclass(frozen=True, kw_only=True)
class PathAhead:
    """n waiting segments; arrays have a row for each."""

    height: float  #: Flank height [m].
    segments: PathSegments
    motion: IntArray  #: (n,): Motion of their rotary axes; see ``segment_axes.py``.
    guides: FloatArray  #: (n, m): Guides of the segments whose passages are chosen.
    bound: FloatArray  #: (n,): Bound of the deviation of the tool axis [rad].
    #: (n,): Position to which the outer axis turns at rest before a segment [rad], else NaN.
    turn_first: FloatArray
    shapes: FloatArray
    beside: FloatArray
    lengths: FloatArray  #: (n,): Path length [m].
    begun: float = 0.0  #: Path length from the last stop to the first segment [m].

    @staticmethod
    def of(
        height: float, segments: PathSegments, motion: IntArray, guides: FloatArray
    ) -> PathAhead:
        n = len(segments)
        shapes, beside, lengths = axes.shapes_of(segments), axes.beside_of(segments), np.zeros(n)
        rows = np.flatnonzero(segments.interpolation == POSES)
        if len(rows):
            kind, length = segments.kind[rows], segments.length[rows]
            lengths[rows] = polar.lengths_of(kind, shapes[rows], beside[rows], length)
        return PathAhead(
            height=height,
            segments=segments,
            motion=motion.copy(),
            guides=guides,
            bound=np.zeros(n),
            turn_first=np.full(n, np.nan),
            shapes=shapes,
            beside=beside,
            lengths=lengths,
        )

    def __len__(self) -> int:
        return len(self.segments)

    @property
    def _columns(self) -> dict[str, FloatArray]:
        found = {field.name: getattr(self, field.name) for field in fields(self)}
        return {name: rows for name, rows in found.items() if isinstance(rows, np.ndarray)}

    def __getitem__(self, rows: slice) -> Self:
        columns = {name: column[rows] for name, column in self._columns.items()}
        return replace(self, segments=self.segments[rows], **columns)  # type: ignore[arg-type]

    def and_more(self, more: Self) -> Self:
        columns = {
            name: np.concatenate([column, getattr(more, name)])
            for name, column in self._columns.items()
        }
        segments = PathSegments.concatenate([self.segments, more.segments])
        return replace(self, segments=segments, **columns)

    def with_poses(self, i: int) -> bool:
        return int(self.motion[i]) in (axes.RESTING, axes.FOLLOWING)

    @cached_property
    def ends(self) -> FloatArray:
        """Path lengths at the start and at the end of each segment, (n + 1,) [m]."""
        return np.cumsum(np.concatenate([[self.begun], self.lengths]))

    def way(self, i: int, u: float) -> float:
        kind, length = self.segments.kind[i], self.segments.length[i]
        return float(polar.way_to(kind, self.shapes[i], self.beside[i], length, u))

    def place(self, s: float) -> tuple[int, float]:
        i = int(np.clip(np.searchsorted(self.ends, s, 'right') - 1, 0, len(self) - 1))
        way = s - float(self.ends[i])
        if way <= SAME_PLACE or way >= self.lengths[i] - SAME_PLACE:
            return i, 0.0 if way <= SAME_PLACE else 1.0
        kind, length = self.segments.kind[i], self.segments.length[i]
        return i, float(polar.place_at(kind, self.shapes[i], self.beside[i], length, way))

    def segment(self, i: int) -> axes.Segment:
        segments = self.segments
        return axes.Segment(
            int(segments.kind[i]),
            axes.FOLLOWING,
            self.shapes[i],
            self.beside[i],
            segments.parametrization[i],
            float(segments.length[i]),
        )

    def rows(self, some: slice) -> axes.SegmentRows:
        segments = self.segments[some]
        return axes.SegmentRows(
            segments.kind,
            np.full(len(segments), axes.FOLLOWING),
            self.shapes[some],
            self.beside[some],
            segments.parametrization,
            segments.length,
        )

    def led_between(self, left: PassageEnd, right: PassageEnd) -> tuple[slice, FloatArray]:
        """Return the segments between two points, and their guides, which follow the septic."""
        begin = left.segment + (left.u >= 1.0)
        end = right.segment + (right.u > 0.0)
        guides, length, coefficients = self.guides[begin:end].copy(), right.s - left.s, np.empty(8)
        septic_coefficients(left.jet, right.jet, length, coefficients)
        guides[:, axes.GUIDE_FROM], guides[:, axes.GUIDE_TO] = -1.0, 1.5
        if begin == left.segment:
            guides[0, axes.GUIDE_FROM] = left.u
        guides[-1, axes.GUIDE_TO] = right.u if end == right.segment + 1 else 1.0
        guides[:, axes.BRANCH_AFTER] = right.branch
        guides[:, axes.GUIDE_BEGUN] = self.ends[begin:end] - left.s
        guides[:, axes.GUIDE_LENGTH] = length
        guides[:, axes.GUIDE] = coefficients
        return slice(begin, end), guides
