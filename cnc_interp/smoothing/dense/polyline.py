"""The polyline that a curve follows: vertices, used tolerance, feed and program rows."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numba import njit

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.bezier import quintic_part
from cnc_interp.smoothing.orientation import dot, norm, rotations_between, turned_by

#: Largest turn between two vertices [rad]; on so short an arc, chord and great circle agree.
TURN = 0.03
#: Feeds with a smaller relative difference are equal, because inverse-time words are rounded [-].
SAME_FEED = 1e-3


@dataclass
class Polyline:
    """A polyline of n vertices; segment k connects the vertices k and k + 1."""

    #: Tip [m], tool axis [-] and curve parameter [m].
    tip: FloatArray
    axis: FloatArray
    u: FloatArray
    #: (n,): Index of the skeleton vertex, or -1 where a turning block was divided.
    vertex: IntArray
    #: (n - 1, 2): Deviation of the segments from the program, and their tolerances [m].
    used: FloatArray
    tolerance: FloatArray
    feed: FloatArray  #: (n - 1,): Programmed speed of the tip [m/s].
    #: (n - 1,): Row and line of the program.
    row: IntArray
    line: IntArray

    @staticmethod
    def at(tip: FloatArray, axis: FloatArray, vertex: int) -> Polyline:
        """Return a polyline with one vertex, whose curve parameter is 0."""
        return Polyline(
            tip[None].copy(), axis[None].copy(), np.zeros(1), np.array([vertex]),
            np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0), np.zeros(0, np.int64),
            np.zeros(0, np.int64),
        )  # fmt: skip

    def extended(
        self, tip: FloatArray, axis: FloatArray, vertex: IntArray, used: FloatArray,
        tolerance: FloatArray, feed: FloatArray, row: IntArray, line: IntArray, height: float,
    ) -> Polyline:  # fmt: skip
        """Return the polyline with k more vertices and the segments that end there."""
        begin, begin_axis = np.vstack([self.tip[-1:], tip]), np.vstack([self.axis[-1:], axis])
        rotation = rotations_between(begin_axis[:-1], begin_axis[1:])
        counts = np.maximum(np.ceil(norm(rotation) / TURN), 1.0).astype(np.int64)
        if (counts > 1).any():
            segment = np.repeat(np.arange(len(tip)), counts)
            number = np.arange(len(segment)) - (np.cumsum(counts) - counts)[segment] + 1
            final = number == counts[segment]
            share = number / counts[segment]
            cut_tip = begin[segment] + share[:, None] * (tip - begin[:-1])[segment]
            cut_axis = turned_by(begin_axis[segment], rotation[segment], share)
            tip = np.where(final[:, None], tip[segment], cut_tip)
            axis = np.where(final[:, None], axis[segment], cut_axis)
            vertex = np.where(final, vertex[segment], -1)
            used, tolerance, feed = used[segment], tolerance[segment], feed[segment]
            row, line = row[segment], line[segment]
        all_tip, all_axis = np.vstack([self.tip, tip]), np.vstack([self.axis, axis])
        m = len(self.tip) - 1
        step = np.diff(all_tip[m:], axis=0)
        top = step + height * np.diff(all_axis[m:], axis=0)
        du = np.sqrt(0.5 * (dot(step, step) + dot(top, top)))
        u = np.cumsum(np.concatenate([self.u[-1:], du]))  # the same bits for any batches
        return Polyline(
            all_tip, all_axis, np.concatenate([self.u, u[1:]]),
            np.concatenate([self.vertex, vertex]), np.vstack([self.used, used]),
            np.vstack([self.tolerance, tolerance]), np.concatenate([self.feed, feed]),
            np.concatenate([self.row, row]), np.concatenate([self.line, line]),
        )  # fmt: skip

    def part(self, first: int, last: int) -> Polyline:
        """Return the polyline of the vertices first ... last."""
        columns = [getattr(self, field.name) for field in fields(self)]
        return Polyline(
            *(c[first : last + 1] for c in columns[:4]), *(c[first:last] for c in columns[4:])
        )

    def upto(self, vertex: int) -> Polyline:
        """Return the polyline up to a skeleton vertex, or its first vertex if it starts later."""
        found = np.flatnonzero(self.vertex == vertex)
        return self.part(0, int(found[0]) if len(found) else 0)

    def line_jet(self, k: int, end: bool, height: float) -> FloatArray:
        """
        Return position and derivatives of tip and top at one end of segment k.

        The tip moves straight. The top T = p + h o moves on an arc with o_u = w x o.
        """
        du = self.u[k + 1] - self.u[k]
        at = k + 1 if end else k
        p, o = self.tip[at], self.axis[at]
        rate = rotations_between(self.axis[k], self.axis[k + 1]) / du
        jet = np.zeros((4, 6))
        jet[0] = np.concatenate([p, p + height * o])
        turned = o
        for order, factorial in ((1, 1.0), (2, 2.0), (3, 6.0)):
            turned = np.cross(rate, turned)
            jet[order, 3:] = height * turned / factorial
        straight = (self.tip[k + 1] - self.tip[k]) / du
        jet[1, :3] += straight
        jet[1, 3:] += straight
        return jet


@njit(cache=True, nogil=True)
def pieces(
    points: FloatArray, knots: FloatArray, u: FloatArray, feed: FloatArray,
    tolerance: FloatArray, apart: BoolArray,
) -> tuple[IntArray, FloatArray, FloatArray, FloatArray, IntArray]:  # fmt: skip
    """
    Divide the spans of a curve where the programmed feed changes; if ``apart``, the tolerances.

    ``points`` (n, 6, d) are Bezier points. Returns for m pieces: their spans, Bezier points, curve
    parameters at their ends (m + 1,), programmed speed [m/s], and the polyline segments in the
    middle of their first and second half (m, 2).
    """
    n = len(points)
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
        source[:count].copy(), cut[:count].copy(), ends[: count + 1].copy(), speed[:count].copy(),
        segment[:count].copy(),
    )  # fmt: skip
