"""The polyline that a curve follows: vertices, used tolerance, feed and program rows."""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.bspline import quintic_part
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.orientation import rotation_between, turn_axis

#: Largest turn between two vertices [rad]; on so short an arc, chord and great circle agree.
TURN = 0.03
#: Feeds with a smaller relative difference are equal, because inverse-time words are rounded [-].
SAME_FEED = 1e-3


class Polyline(NamedTuple):
    """A polyline of n vertices; segment k connects the vertices k and k + 1."""

    pose: FloatArray  #: (n, 6): Tip [m] and tool axis [-].
    u: FloatArray  #: (n,): Curve parameter [m].
    #: (n,): Index of the skeleton vertex, or -1 where a turning block was divided.
    vertex: IntArray
    #: (n - 1, 2): Deviation of the segments from the program, and their tolerances [m].
    used: FloatArray
    tolerance: FloatArray
    feed: FloatArray  #: (n - 1,): Programmed speed of the tip [m/s].
    origin: IntArray  #: (n - 1, 2): Row and line of the program.

    def part(self, first: int, last: int) -> Polyline:
        at, between = slice(first, last + 1), slice(first, last)
        return Polyline(
            self.pose[at],
            self.u[at],
            self.vertex[at],
            self.used[between],
            self.tolerance[between],
            self.feed[between],
            self.origin[between],
        )

    def upto(self, vertex: int) -> Polyline:
        """Return the polyline up to a skeleton vertex, or its first vertex if it starts later."""
        found = np.flatnonzero(self.vertex == vertex)
        return self.part(0, int(found[0]) if len(found) else 0)


@njit(cache=True, nogil=True)
def parts_between(a: FloatArray, b: FloatArray) -> int:
    """Return into how many parts the turn between two poses is divided."""
    turn = rotation_between(a[3:], b[3:])
    return max(1, ceil(sqrt(turn[0] ** 2 + turn[1] ** 2 + turn[2] ** 2) / TURN))


@njit(cache=True, nogil=True)
def pose_between(a: FloatArray, b: FloatArray, share: float, out: FloatArray) -> None:
    """Write the pose at a part of the line from one pose to another."""
    for i in range(3):
        out[i] = a[i] + share * (b[i] - a[i])
    turn_axis(a[3:], rotation_between(a[3:], b[3:]), share, out[3:])


@njit(cache=True, nogil=True)
def with_room(line: Polyline, n: int, more: int) -> Polyline:
    """Copy the first n vertices of a polyline, with room for more at the end."""
    m = n + more
    longer = Polyline(
        np.empty((m, 6)),
        np.empty(m),
        np.empty(m, np.int64),
        np.empty((m - 1, 2)),
        np.empty((m - 1, 2)),
        np.empty(m - 1),
        np.empty((m - 1, 2), np.int64),
    )
    for k in range(n):
        longer.u[k], longer.vertex[k] = line.u[k], line.vertex[k]
        for i in range(6):
            longer.pose[k, i] = line.pose[k, i]
    for k in range(n - 1):
        longer.feed[k] = line.feed[k]
        for i in range(2):
            longer.used[k, i], longer.tolerance[k, i] = line.used[k, i], line.tolerance[k, i]
            longer.origin[k, i] = line.origin[k, i]
    return longer


@njit(cache=True, nogil=True)
def lone_vertex(pose: FloatArray, vertex: int) -> Polyline:
    """Return a polyline with one vertex, whose curve parameter is 0."""
    line = Polyline(
        np.empty((1, 6)),
        np.zeros(1),
        np.empty(1, np.int64),
        np.empty((0, 2)),
        np.empty((0, 2)),
        np.empty(0),
        np.empty((0, 2), np.int64),
    )
    line.vertex[0] = vertex
    for i in range(6):
        line.pose[0, i] = pose[i]
    return line


class Programmed(NamedTuple):
    """Programmed data of a segment of a polyline."""

    used: FloatArray  #: (2,): Its deviation from the program [m].
    tolerance: FloatArray  #: (2,): Its tolerances [m].
    feed: float
    row: int
    line: int


@njit(cache=True, nogil=True)
def put(
    line: Polyline, n: int, pose: FloatArray, vertex: int, said: Programmed, height: float
) -> int:
    """Write a vertex after the first n ones, and those that divide its segment; return n after."""
    begin = line.pose[n - 1].copy()
    parts = parts_between(begin, pose)
    for part in range(1, parts + 1):
        here, before = line.pose[n], line.pose[n - 1]
        if part == parts:
            for i in range(6):
                here[i] = pose[i]
        else:
            pose_between(begin, pose, part / parts, here)
        tips, tops = 0.0, 0.0
        for i in range(3):
            tips += (here[i] - before[i]) ** 2
            tops += (here[i] - before[i] + height * (here[3 + i] - before[3 + i])) ** 2
        line.u[n] = line.u[n - 1] + sqrt(0.5 * (tips + tops))
        line.vertex[n] = vertex if part == parts else -1
        for i in range(2):
            line.used[n - 1, i], line.tolerance[n - 1, i] = said.used[i], said.tolerance[i]
        line.feed[n - 1] = said.feed
        line.origin[n - 1, 0], line.origin[n - 1, 1] = said.row, said.line
        n += 1
    return n


@njit(cache=True, nogil=True)
def line_jet(line: Polyline, k: int, at: int, height: float) -> FloatArray:
    """Return tip and top with derivatives on segment k, at its vertex ``at``; o_u = w x o."""
    du = line.u[k + 1] - line.u[k]
    turn = rotation_between(line.pose[k, 3:], line.pose[k + 1, 3:])
    x, y, z = turn[0] / du, turn[1] / du, turn[2] / du
    jet = np.zeros((4, 6))
    a, b, c = line.pose[at, 3], line.pose[at, 4], line.pose[at, 5]
    for i in range(3):
        jet[0, i] = line.pose[at, i]
        jet[0, 3 + i] = line.pose[at, i] + height * line.pose[at, 3 + i]
    for order, factorial in ((1, 1.0), (2, 2.0), (3, 6.0)):
        a, b, c = y * c - z * b, z * a - x * c, x * b - y * a
        jet[order, 3] = height * a / factorial
        jet[order, 4] = height * b / factorial
        jet[order, 5] = height * c / factorial
    for i in range(3):
        straight = (line.pose[k + 1, i] - line.pose[k, i]) / du
        jet[1, i] += straight
        jet[1, 3 + i] += straight
    return jet


@njit(cache=True, nogil=True)
def pieces(
    points: FloatArray, knots: FloatArray, line: Polyline, apart: BoolArray
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:
    """Divide spans where the programmed feed changes; if ``apart``, the tolerances.

    Returns for m pieces: their spans, Bezier points, curve parameters at their ends (m + 1,),
    speed [m/s], and the segments in the middle of their first and second half (m, 2).
    """
    n, u, feed, tolerance = len(points), line.u, line.feed, line.tolerance
    most = 2 * n + len(u)
    source, cut = np.empty(most, dtype=np.int64), np.empty((most, 6, points.shape[2]))
    ends, speed, segment = np.empty(most + 1), np.empty(most), np.empty((most, 2), dtype=np.int64)
    count, k = 0, 0
    for s in range(n):
        start, end = knots[s], knots[s + 1]
        least_piece = 1e-9 * (end - start)  # a knot may differ from a vertex by rounding
        while k < len(feed) - 1 and u[k + 1] <= start + least_piece:
            k += 1
        a = start
        while a < end:
            least = most_feed = feed[k]
            b = min(u[k + 1], end)
            while b < end and k < len(feed) - 1:
                following = feed[k + 1]
                low, high = min(least, following), max(most_feed, following)
                if high > low * (1.0 + SAME_FEED):
                    break
                if apart[s] and (
                    tolerance[k, 0] != tolerance[k + 1, 0]
                    or tolerance[k, 1] != tolerance[k + 1, 1]
                ):
                    break
                least, most_feed = low, high
                k += 1
                b = min(u[k + 1], end)
            if end - b < least_piece or k == len(feed) - 1:
                b = end
            source[count], speed[count], ends[count] = s, least, a
            left, right = (a - start) / (end - start), (b - start) / (end - start)
            quintic_part(points[s], left, right, cut[count])
            for half in range(2):
                x = a + (0.25 + 0.5 * half) * (b - a)
                j = k
                while j > 0 and u[j] > x:
                    j -= 1
                segment[count, half] = j
            count += 1
            a = ends[count] = b
            while k < len(feed) - 1 and u[k + 1] <= b:
                k += 1
    return (
        source[:count].copy(),
        cut[:count].copy(),
        ends[: count + 1].copy(),
        speed[:count].copy(),
        segment[:count].copy(),
    )
