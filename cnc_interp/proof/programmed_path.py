"""
How far a pose is from what was programmed: the proof's own geometry.

A program row moves the tool tip along a straight line while the tool axis turns, in step with it,
on the great circle between both orientations [B2013, Eq. 4]. The point at flank height h therefore
runs along ``T(x) = p_0 + x (p_1 - p_0) + h o(x)``, 0 <= x <= 1. Tip errors are distances to the
lines, orientation errors distances of ``tip + h axis`` to T. Nothing here is shared with planning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray

# Rows searched on either side of the row that a sample says it executes.
WINDOW = 2
# Rows searched at most where blocks are shorter than the tolerance.
WIDE_WINDOW = 500
# Widest turn between two starting points of the search for the nearest point of T [rad].
TURN_PER_START = 0.1
TIE = 1e-9


@dataclass(frozen=True)
class Deviation:
    """
    Distance of poses from the program.

    Parameters
    ----------
    contour : ndarray, shape (K,)
        Distance of the tip from the programmed lines [m].
    row : ndarray of int, shape (K,)
        Program row on which the nearest point lies.
    part : ndarray, shape (K,)
        Where on that row, 0 at its beginning, 1 at its end.
    orientation : ndarray, shape (K,)
        Distance of the point at flank height from its programmed locus [m].
    twist : ndarray, shape (K,)
        Flank height times the angle between the tool axis and the one programmed at the tip's
        nearest point [m]: stricter than ``orientation``, for information.

    """

    contour: FloatArray
    row: IntArray
    part: FloatArray
    orientation: FloatArray
    twist: FloatArray


@dataclass(frozen=True)
class ProgrammedPath:
    """
    The program as lines and great circles, one row per block; row 0 is the start pose.

    Parameters
    ----------
    start, chord : ndarray, shape (M, 3)
        Tip where the row begins and its way to the end [m].
    axis, sideways : ndarray, shape (M, 3)
        Tool axis where the row begins, and the unit vector towards which it turns [-].
    turn : ndarray, shape (M,)
        Angle of the turn [rad].
    by_axes : ndarray of bool, shape (M,)
        Pure rotations that rotary words rule: their great circle is not programmed.
    flank_height : float
        Height of the second point above the tip [m].

    """

    start: FloatArray
    chord: FloatArray
    axis: FloatArray
    sideways: FloatArray
    turn: FloatArray
    by_axes: BoolArray
    flank_height: float

    @staticmethod
    def of(tip: FloatArray, axis: FloatArray, rotary: FloatArray, height: float) -> ProgrammedPath:
        """Build the path from the vertices of the program."""
        before = np.r_[0, np.arange(len(tip) - 1)]
        start, first = tip[before], axis[before]
        chord = tip - start
        cosine = np.sum(first * axis, axis=1)
        across = axis - cosine[:, None] * first
        sine = np.linalg.norm(across, axis=1)
        worded = np.isfinite(rotary).all(axis=1)
        return ProgrammedPath(
            start=np.ascontiguousarray(start, dtype=float),
            chord=chord,
            axis=np.ascontiguousarray(first, dtype=float),
            sideways=across / np.where(sine > 0.0, sine, 1.0)[:, None],
            turn=np.arctan2(sine, cosine),
            by_axes=worded & worded[before] & (np.linalg.norm(chord, axis=1) < TIE),
            flank_height=height,
        )

    def deviation(
        self, tip: FloatArray, axis: FloatArray, block: IntArray, reach: FloatArray | None = None
    ) -> Deviation:
        """
        Measure poses against the rows around the ones they execute.

        Parameters
        ----------
        tip, axis : ndarray, shape (K, 3)
            Poses [m, -].
        block : ndarray of int, shape (K,)
            Row that each pose executes.
        reach : ndarray, shape (K,), optional
            Widen the search to rows within this way of the point at flank height [m].

        """
        low = np.maximum(block - WINDOW, 0)
        high = np.minimum(block + WINDOW, len(self.start) - 1)
        if reach is not None:
            way = np.cumsum(np.linalg.norm(self.chord, axis=1) + self.flank_height * self.turn)
            begin = way[np.maximum(block - 1, 0)]
            low = np.minimum(low, np.searchsorted(way, begin - reach))
            high = np.maximum(high, np.searchsorted(way[:-1], way[block] + reach))
            low = np.maximum(low, block - WIDE_WINDOW)
            high = np.minimum(high, block + WIDE_WINDOW)
        rows = (self.start, self.chord, self.axis, self.sideways, self.turn, self.by_axes)
        return Deviation(*_deviation(
            np.ascontiguousarray(tip), np.ascontiguousarray(axis), low.astype(np.int64),
            high.astype(np.int64), *rows, self.flank_height,
        ))  # fmt: skip


def approach(
    points: FloatArray, vertices: FloatArray, low: IntArray, high: IntArray
) -> tuple[FloatArray, IntArray]:
    """
    Find how near a sampled motion comes to each vertex.

    Between two samples the motion bulges from its chord by an eighth of the second difference;
    the distance is reduced by that much, for the vertex of a corner lies outside of its rounding.

    Parameters
    ----------
    points : ndarray, shape (K, 3)
        The motion, sampled [m].
    vertices : ndarray, shape (M, 3)
        Programmed points [m].
    low, high : ndarray of int, shape (M,)
        First and last sample to search for each vertex.

    Returns
    -------
    tuple of ndarray, shape (M,)
        Distance [m] and the sample before the nearest point.

    """
    bulge = np.zeros(len(points))
    bulge[1:-1] = np.linalg.norm(np.diff(points, 2, axis=0), axis=1) / 8.0
    nearest: tuple[FloatArray, IntArray] = _approach(
        np.ascontiguousarray(points), np.maximum(bulge[:-1], bulge[1:]),
        np.ascontiguousarray(vertices), low.astype(np.int64), high.astype(np.int64),
    )  # fmt: skip
    return nearest


@njit(cache=True, nogil=True)
def _foot(x: Any, a: Any, d: Any) -> Any:
    """Find where on the line from a along d the point x has its foot, within 0 to 1."""
    length_sq = d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
    if length_sq == 0.0:
        return 0.0
    along = (x[0] - a[0]) * d[0] + (x[1] - a[1]) * d[1] + (x[2] - a[2]) * d[2]
    return min(1.0, max(0.0, along / length_sq))


@njit(cache=True, nogil=True)
def _line_distance(x: Any, a: Any, d: Any, part: float) -> Any:
    total = 0.0
    for i in range(3):
        total += (x[i] - a[i] - part * d[i]) ** 2
    return np.sqrt(total)


@njit(cache=True, nogil=True)
def _slope(x: Any, a: Any, d: Any, o: Any, n: Any, turn: float, h: float, part: float) -> Any:
    """Return ``|T - x|^2`` and half its first two derivatives by the part of the row."""
    c, s = np.cos(turn * part), np.sin(turn * part)
    value, first, second = 0.0, 0.0, 0.0
    for i in range(3):
        gap = a[i] + part * d[i] + h * (o[i] * c + n[i] * s) - x[i]
        rate = d[i] + h * turn * (n[i] * c - o[i] * s)
        bend = -h * turn * turn * (o[i] * c + n[i] * s)
        value += gap * gap
        first += gap * rate
        second += rate * rate + gap * bend
    return value, first, second


@njit(cache=True, nogil=True)
def _locus_distance(x: Any, a: Any, d: Any, o: Any, n: Any, turn: float, h: float) -> Any:
    """Find the distance of x from T of one row: starts on a grid, then Newton in a bracket."""
    starts = 1 if turn < 1e-6 else max(4, int(np.ceil(turn / TURN_PER_START)))
    step = 1.0 / starts
    left, here = np.inf, _slope(x, a, d, o, n, turn, h, 0.0)[0]
    best = here
    for j in range(starts + 1):
        right = np.inf
        if j < starts:
            right = _slope(x, a, d, o, n, turn, h, (j + 1) * step)[0]
        if here <= left and here <= right:
            low, high = max(0.0, (j - 1) * step), min(1.0, (j + 1) * step)
            part = j * step
            for _ in range(60):
                value, first, second = _slope(x, a, d, o, n, turn, h, part)
                best = min(best, value)
                if first > 0.0:
                    high = part
                else:
                    low = part
                following = part - first / second if second > 0.0 else 0.5 * (low + high)
                if not low <= following <= high:
                    following = 0.5 * (low + high)
                if abs(following - part) < 1e-13:
                    break
                part = following
        left, here = here, right
    return np.sqrt(best)


@njit(cache=True, nogil=True)
def _twist(tip: Any, axis: Any, k: int, start: Any, chord: Any, first: Any, sideways: Any,
           turn: Any, h: float) -> Any:  # fmt: skip
    """Compare the tool axis with the programmed one at the tip's foot on row k, as length."""
    d = chord[k]
    if d[0] * d[0] + d[1] * d[1] + d[2] * d[2] == 0.0:
        zero = np.zeros(3)
        return _locus_distance(h * axis, zero, zero, first[k], sideways[k], turn[k], h)
    angle = turn[k] * _foot(tip, start[k], d)
    gap = 0.0
    for i in range(3):
        gap += (first[k, i] * np.cos(angle) + sideways[k, i] * np.sin(angle) - axis[i]) ** 2
    return 2.0 * h * np.arcsin(min(1.0, 0.5 * np.sqrt(gap)))


@njit(cache=True, nogil=True)
def _deviation(tip: Any, axis: Any, low: Any, high: Any, start: Any, chord: Any, first: Any,
               sideways: Any, turn: Any, by_axes: Any, h: float) -> Any:  # fmt: skip
    """Measure each pose against rows low to high; see `Deviation`."""
    count = len(tip)
    contour, part = np.empty(count), np.empty(count)
    row = np.empty(count, dtype=np.int64)
    orientation, twist = np.empty(count), np.empty(count)
    for i in range(count):
        best, best_row, best_part, top_best, twist_best = np.inf, low[i], 0.0, np.inf, np.inf
        top = tip[i] + h * axis[i]
        for k in range(low[i], high[i] + 1):
            foot = _foot(tip[i], start[k], chord[k])
            distance = _line_distance(tip[i], start[k], chord[k], foot)
            if distance < best:
                best, best_row, best_part = distance, k, foot
            if not by_axes[k]:
                top_best = min(top_best, _locus_distance(
                    top, start[k], chord[k], first[k], sideways[k], turn[k], h))  # fmt: skip
        for k in range(low[i], high[i] + 1):
            foot = _foot(tip[i], start[k], chord[k])
            distance = _line_distance(tip[i], start[k], chord[k], foot)
            if distance <= best + TIE and not by_axes[k]:
                twist_best = min(twist_best, _twist(
                    tip[i], axis[i], k, start, chord, first, sideways, turn, h))  # fmt: skip
        contour[i], row[i], part[i] = best, best_row, best_part
        orientation[i], twist[i] = top_best, twist_best
    return contour, row, part, orientation, twist


@njit(cache=True, nogil=True)
def _approach(points: Any, bulge: Any, vertices: Any, low: Any, high: Any) -> Any:
    count = len(vertices)
    nearest = np.full(count, np.inf)
    where = np.zeros(count, dtype=np.int64)
    for k in range(count):
        for i in range(low[k], high[k]):
            chord = points[i + 1] - points[i]
            foot = _foot(vertices[k], points[i], chord)
            distance = _line_distance(vertices[k], points[i], chord, foot) - bulge[i]
            if distance < nearest[k]:
                nearest[k], where[k] = max(0.0, distance), i
                if distance <= 0.0:
                    break
    return nearest, where
