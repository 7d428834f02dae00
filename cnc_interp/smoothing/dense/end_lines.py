"""The lines at both ends of a curve: a long block, or a chord over short blocks at a corner."""

from math import sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.dense.knots import AHEAD, LONGEST
from cnc_interp.smoothing.dense.polyline import (
    Polyline,
    Programmed,
    line_jet,
    lone_vertex,
    parts_between,
    pose_between,
    put,
    with_room,
)
from cnc_interp.smoothing.dense.thinning import Vertices, longest_chord

#: Wanted length of a chord at a corner, and the part of it for the corner, both in tolerances.
CHORD, CORNER_PART = 20.0, 14.0
REACH = 30.0  #: Distance along the blocks within which a chord must end, in tolerances.
OFF = 0.3  #: Largest distance of the blocks from the chord, in tolerances.
CUT = 0.5  #: A block on a chord keeps its own program row if it is longer than this [tolerances].
#: A curve begins inside a long block, at most this many longest spacings before the end of the
#: block, and within this part of its length.
LEAD, LEAD_SHARE = 2.0, 0.4


class EndLine(NamedTuple):
    segment: int  #: Segment of the skeleton that the line replaces.
    vertex: int  #: Skeleton vertex at the inner end of the line.
    pose: FloatArray  #: (6,): Tip [m] and tool axis [-] where line and curve meet.
    #: (2,): Deviation of the line from the blocks, and its tolerances [m].
    used: FloatArray
    tolerance: FloatArray
    feed: float  #: Smallest feed of the blocks that the line replaces [m/s].
    #: (m,): Borders of these blocks between ``pose`` and ``vertex``, from 0 to 1 in the direction
    #: of motion [-].
    cuts: FloatArray
    pieces: IntArray  #: (m + 1,): Segments of the skeleton between these borders.


@njit(cache=True, nogil=True)
def _spacing(v: Vertices, k: int) -> tuple[float, float]:
    """Return the longest spacing of knots at a segment, and its smaller tolerance."""
    least = min(v.tolerance[k, 0], v.tolerance[k, 1])
    return LONGEST * least, least


@njit(cache=True, nogil=True)
def _end_line(v: Vertices, vertex: int, step: int, other: int, ended: bool) -> EndLine:
    """Choose the line: a long block beside the run; at a corner, a chord over short blocks."""
    here, pose = v.pose[vertex], np.empty(6)
    if not (v.closed[vertex] or v.corner[vertex]):
        k = vertex if step > 0 else vertex + 1
        there = v.pose[vertex - step]
        longest, least = _spacing(v, k)
        pose_between(here, there, min(LEAD_SHARE, LEAD * longest / _distance(here, there)), pose)
        pieces = np.empty(1, np.int64)
        pieces[0] = k
        return EndLine(k, vertex, pose, v.used[k], v.narrow[k], v.feed[k], np.empty(0), pieces)
    k = vertex + 1 if step > 0 else vertex
    longest, least = _spacing(v, k)
    whole = abs(v.u[other] - v.u[vertex])
    reach = whole / 3.0 if ended and whole < AHEAD * longest else REACH * least
    far = vertex if vertex == other else vertex + step
    while far != other:
        way = v.u[far + step] - (v.u[vertex] + step * reach)
        if way > 0.0 if step > 0 else way <= 0.0:
            break
        far += step
    room, used, tolerance = np.empty(2), np.empty(2), np.empty(2)
    for i in range(2):
        room[i] = v.narrow[min(vertex, far) + 1 : max(vertex, far) + 1, i].min()
    end, off, off_top = longest_chord(v.pose, v.top, room, vertex, step, far, CHORD * least, OFF)
    low, high = min(vertex, end), max(vertex, end)
    for i in range(2):
        used[i] = (off, off_top)[i] + v.used[low + 1 : high + 1, i].max()
        tolerance[i] = v.narrow[low + 1 : high + 1, i].min()
    there = v.pose[end]
    length = _distance(here, there)
    share = min(0.5, CORNER_PART * least / length)
    pose_between(here, there, share, pose)
    # Feet of the inner vertices on the chord, as part of the distance from the pose to its end.
    place = np.empty(high - low - 1)
    for j in range(len(place)):
        along = 0.0
        for i in range(3):
            along += (v.pose[low + 1 + j, i] - here[i]) * (there[i] - here[i])
        place[j] = (along / length**2 - share) / (1.0 - share)
        if step < 0:
            place[j] = 1.0 - place[j]
    apart = CUT * least / (length * (1.0 - share))
    cuts, pieces = _borders(place, np.arange(low + 1, high + 1), apart)
    feed = v.feed[low + 1 : high + 1].min()
    return EndLine(k, end, pose, used, tolerance, feed, cuts, pieces)


@njit(cache=True, nogil=True)
def _borders(place: FloatArray, segments: IntArray, apart: float) -> tuple[FloatArray, IntArray]:
    """Return borders between segments in [0, 1], at least ``apart`` apart, and the segments."""
    cuts, pieces, count = np.empty(len(place)), segments.copy(), 0
    for x, following in zip(place, segments[1:]):
        if x < apart:  # before the line begins
            pieces[count] = following
        elif x <= 1.0 - apart and (count == 0 or x >= cuts[count - 1] + apart):
            cuts[count] = x
            count += 1
            pieces[count] = following
    return cuts[:count], pieces[: count + 1]


@njit(cache=True, nogil=True)
def _distance(a: FloatArray, b: FloatArray) -> float:
    return sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)


@njit(cache=True, nogil=True)
def with_end_line(
    line: Polyline, v: Vertices, vertex: int, step: int, other: int, ended: bool, height: float
) -> tuple[EndLine, Polyline, FloatArray]:
    """Choose the line on which a run begins at a vertex (``step`` 1) or ends there (-1).

    Returns it, the polyline with it, and the motion at its outer end. ``other`` is the last vertex
    of the run that is known, in the other direction; ``ended`` tells whether the run ends there.
    """
    leg = _end_line(v, vertex, step, other, ended)
    if step > 0:
        line, n, pose, vertex = lone_vertex(leg.pose, -1), 1, v.pose[leg.vertex], leg.vertex
    else:
        n, pose, vertex = len(line.u), leg.pose, -1
        while n > 1 and line.vertex[n - 1] != leg.vertex:
            n -= 1
    before = line.pose[n - 1].copy()
    parts = parts_between(before, pose)
    to = np.empty(6)
    straight = with_room(lone_vertex(before, -1), 1, parts)
    put(straight, 1, pose, -1, Programmed(leg.used, leg.tolerance, 1.0, 0, 0), height)
    jet = line_jet(straight, 0 if step > 0 else parts - 1, 0 if step > 0 else parts, height)
    line = with_room(line, n, parts + 2 * len(leg.cuts))
    for i, k in enumerate(leg.pieces):
        inner = i < len(leg.cuts)
        if inner:
            pose_between(before, pose, leg.cuts[i], to)
        said = Programmed(leg.used, leg.tolerance, leg.feed, v.row[k], v.line_number[k])
        n = put(line, n, to if inner else pose, -1 if inner else vertex, said, height)
    line = Polyline(
        line.pose[:n],
        line.u[:n],
        line.vertex[:n],
        line.used[: n - 1],
        line.tolerance[: n - 1],
        line.feed[: n - 1],
        line.origin[: n - 1],
    )
    return leg, line, jet


@njit(cache=True, nogil=True)
def extended(line: Polyline, v: Vertices, first: int, last: int, height: float) -> Polyline:
    """Return a polyline with the vertices first ... last of the skeleton at its end."""
    n, more = len(line.u), 0
    for k in range(first, last + 1):
        before = line.pose[n - 1] if k == first else v.pose[k - 1]
        more += parts_between(before, v.pose[k])
    line = with_room(line, n, more)
    for k in range(first, last + 1):
        said = Programmed(v.used[k], v.narrow[k], v.feed[k], v.row[k], v.line_number[k])
        n = put(line, n, v.pose[k], k, said, height)
    return line
