"""The lines at both ends of a curve: a long block, or a chord over short blocks at a corner."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.smoothing.dense import thinning
from cnc_interp.smoothing.dense.curve_fit import AHEAD, LONGEST
from cnc_interp.smoothing.dense.polyline import Polyline
from cnc_interp.smoothing.dense.skeleton import Skeleton
from cnc_interp.smoothing.orientation import rotations_between, turned_by

#: Wanted length of a chord at a corner, and the part of it for the corner, both in tolerances.
CHORD, CORNER_PART = 20.0, 14.0
#: Distance along the blocks within which a chord must end, in tolerances.
REACH = 30.0
#: Largest distance of the blocks from the chord, in tolerances.
OFF = 0.3
#: A block on a chord keeps its own program row if it is longer than this [tolerances].
CUT = 0.5
#: A curve begins inside a long block, at most this many longest spacings before the end of the
#: block, and within this part of its length.
LEAD, LEAD_SHARE = 2.0, 0.4


@dataclass(frozen=True)
class EndLine:
    """The line on which a run starts or ends."""

    segment: int  #: Segment of the skeleton that the line replaces.
    vertex: int  #: Skeleton vertex at the inner end of the line.
    pose: tuple[FloatArray, FloatArray]  #: Tip [m] and tool axis [-] where line and curve meet.
    goal: tuple[FloatArray, FloatArray]  #: Tip [m] and tool axis [-] of ``vertex``.
    #: (2,): Deviation of the line from the blocks [m].
    used: FloatArray
    tolerance: FloatArray
    feed: float  #: Smallest feed of the blocks that the line replaces [m/s].
    #: (m,): Borders of these blocks between ``pose`` and ``goal``, from 0 to 1 in the direction of
    #: motion [-].
    cuts: FloatArray
    pieces: IntArray  #: (m + 1,): Segments of the skeleton between these borders.

    def shifted(self, first: int) -> EndLine:
        """Return the line after the first vertices of the skeleton were dropped."""
        return replace(self, segment=self.segment - first, vertex=self.vertex - first)


def longest_spacing(skeleton: Skeleton, k: int) -> float:
    """Return the longest spacing of knots at a segment."""
    return LONGEST * float(skeleton.tolerance[k].min())


def choose_end_line(
    skeleton: Skeleton, vertex: int, step: int, other: int, ended: bool
) -> EndLine:
    """
    Choose the line on which a run begins or ends.

    Next to a long block it is that block. At a corner it is a chord over the short blocks near it.
    """
    tip, axis = skeleton.blocks.tip, skeleton.blocks.axis
    here = tip[vertex], axis[vertex]
    if not skeleton.ends[vertex]:
        k = vertex if step > 0 else vertex + 1
        far = vertex - step
        length = float(np.linalg.norm(tip[far] - tip[vertex]))
        share = min(LEAD_SHARE, LEAD * longest_spacing(skeleton, k) / length)
        pose = _pose_between(*here, tip[far], axis[far], share)
        feed, piece = float(skeleton.feed[k]), np.array([k])
        used, tolerance = skeleton.used[k], skeleton.narrow[k]
        return EndLine(k, vertex, pose, here, used, tolerance, feed, np.zeros(0), piece)
    k = vertex + 1 if step > 0 else vertex
    longest, least = longest_spacing(skeleton, k), float(skeleton.tolerance[k].min())
    whole = abs(float(skeleton.u[other] - skeleton.u[vertex]))
    reach = whole / 3.0 if ended and whole < AHEAD * longest else REACH * least
    beyond = np.searchsorted(skeleton.u, skeleton.u[vertex] + step * reach, 'right')
    if step > 0:
        far = min(max(int(beyond) - 1, vertex + 1), other)
    else:
        far = max(min(int(beyond), vertex - 1), other)
    narrow = skeleton.narrow
    room = narrow[min(vertex, far) + 1 : max(vertex, far) + 1].min(axis=0)
    end, off, off_top = thinning.longest_chord(
        tip, skeleton.top, room, vertex, step, far, CHORD * least, OFF
    )
    low, high = min(vertex, end), max(vertex, end)
    used = np.array([off, off_top]) + skeleton.used[low + 1 : high + 1].max(axis=0)
    length = float(np.linalg.norm(tip[end] - tip[vertex]))
    share = min(0.5, CORNER_PART * least / length)
    pose = _pose_between(*here, tip[end], axis[end], share)
    covered = np.arange(low + 1, high + 1)
    # Feet of the inner vertices on the chord, as part of the distance from the pose to its end.
    along = (tip[covered[:-1]] - tip[vertex]) @ (tip[end] - tip[vertex]) / length**2
    place = (along - share) / (1.0 - share)
    if step < 0:
        place = 1.0 - place
    cuts, pieces = _borders(place, covered, CUT * least / (length * (1.0 - share)))
    feed = float(skeleton.feed[low + 1 : high + 1].min())
    tolerance = narrow[low + 1 : high + 1].min(axis=0)
    return EndLine(k, end, pose, (tip[end], axis[end]), used, tolerance, feed, cuts, pieces)


def _borders(place: FloatArray, segments: IntArray, apart: float) -> tuple[FloatArray, IntArray]:
    """Return borders between segments in [0, 1], at least ``apart`` apart, and the segments."""
    cuts: list[float] = []
    pieces = [int(segments[0])]
    for x, following in zip(place, segments[1:], strict=True):
        if x < apart:  # before the line begins
            pieces[-1] = int(following)
        elif x <= 1.0 - apart and x >= (cuts[-1] if cuts else 0.0) + apart:
            cuts.append(float(x))
            pieces.append(int(following))
    return np.array(cuts), np.array(pieces)


def _pose_between(
    tip: FloatArray, axis: FloatArray, far_tip: FloatArray, far_axis: FloatArray, share: float
) -> tuple[FloatArray, FloatArray]:
    """Return the pose at a part of the line from one pose to another."""
    rotation = rotations_between(axis[None], far_axis[None])
    return tip + share * (far_tip - tip), turned_by(axis[None], rotation, share)[0]


def with_end_line(
    line: Polyline, leg: EndLine, pose: tuple[FloatArray, FloatArray], vertex: int,
    skeleton: Skeleton, height: float,
) -> tuple[Polyline, FloatArray]:  # fmt: skip
    """Extend a polyline by an end line, and return the motion at the outer end of that line."""
    n = len(leg.pieces)
    before = line.tip[-1], line.axis[-1]
    inner = [_pose_between(*before, *pose, float(cut)) for cut in leg.cuts]
    straight = Polyline.at(*before, -1).extended(
        pose[0][None], pose[1][None], np.array([-1]), leg.used[None], leg.tolerance[None],
        np.ones(1), leg.pieces[:1], leg.pieces[:1], height,
    )  # fmt: skip
    at_end = vertex < 0
    jet = straight.line_jet(len(straight.feed) - 1 if at_end else 0, at_end, height)
    line = line.extended(
        np.array([tip for tip, _ in [*inner, pose]]), np.array([axis for _, axis in [*inner,
        pose]]), np.append(np.full(n - 1, -1), vertex), np.repeat(leg.used[None], n, axis=0),
        np.repeat(leg.tolerance[None], n, axis=0), np.full(n, leg.feed), skeleton.row[leg.pieces],
        skeleton.blocks.line_number[leg.pieces], height,
    )  # fmt: skip
    return line, jet
