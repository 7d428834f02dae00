"""Thinning of dense blocks: the vertices and corners that matter at the scale of the tolerance.

CAM output contains repeated points, steps of 0.1 um and rounding errors. The skeleton keeps a
vertex if it is more than half a tolerance away from the last one kept. It also keeps a vertex if
the chord would miss it by more than a tenth of the tolerance. The largest distance of dropped
vertices from their chord is recorded. A corner is measured between chords of at least three
tolerances, because the angles between shorter chords are noise.
"""

from math import acos, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.dense.knots import AHEAD, LONGEST

#: Shortest step of the skeleton, and largest distance of a dropped vertex, in tolerances.
STEP, DROP = 0.5, 0.1
MOST_DROPPED = 512  #: Largest number of consecutive dropped rows.
#: Shortest chord between which a corner is measured, and the distance in u within which such a
#: chord is searched, both in tolerances.
CHORD, REACH = 3.0, 6.0
#: Kinds of segments: short enough for a curve, too long, or never part of a curve.
SHORT, LONG, FIXED = 0, 1, 2
FEWEST_BLOCKS = 3  #: Smallest number of blocks in a run.


class Vertices(NamedTuple):
    """Columns of ``Skeleton``, as kernels take them; ``pose`` (n, 6) has tips and tool axes."""

    pose: FloatArray
    top: FloatArray
    u: FloatArray
    used: FloatArray
    tolerance: FloatArray
    narrow: FloatArray
    feed: FloatArray
    row: IntArray
    line_number: IntArray
    kind: IntArray
    turning: BoolArray
    closed: BoolArray
    corner: BoolArray


@njit(cache=True, nogil=True)
def _chord_distances(
    tip: FloatArray, top: FloatArray, a: int, b: int, j: int
) -> tuple[float, float]:
    """Return the distances of tip and top of vertex j from the chord a - b, at one place [m]."""
    along, square = 0.0, 0.0
    for i in range(3):
        d, e = tip[b, i] - tip[a, i], top[b, i] - top[a, i]
        along += d * (tip[j, i] - tip[a, i]) + e * (top[j, i] - top[a, i])
        square += d * d + e * e
    share = 0.0
    if square > 0.0:
        share = min(1.0, max(0.0, along / square))
    off, off_top = 0.0, 0.0
    for i in range(3):
        off += (tip[j, i] - tip[a, i] - share * (tip[b, i] - tip[a, i])) ** 2
        off_top += (top[j, i] - top[a, i] - share * (top[b, i] - top[a, i])) ** 2
    return sqrt(off), sqrt(off_top)


@njit(cache=True, nogil=True)
def _distance(points: FloatArray, a: int, b: int) -> float:
    return sqrt(
        (points[b, 0] - points[a, 0]) ** 2
        + (points[b, 1] - points[a, 1]) ** 2
        + (points[b, 2] - points[a, 2]) ** 2
    )


@njit(cache=True, nogil=True)
def select_vertices(
    tip: FloatArray, top: FloatArray, tolerance: FloatArray, must: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Select the rows that become vertices of the skeleton.

    Row 0 was kept before; rows in ``must`` are always kept.

    Returns the rows kept after it, as far as they can be decided, and (m, 2) the largest distances
    of dropped rows from the chord that ends at each of them [m].
    """
    n = len(tip)
    kept, used = np.empty(n, dtype=np.int64), np.zeros((n, 2))
    count, k, i = 0, 0, 1
    while i < n:
        far = (
            _distance(tip, k, i) > STEP * tolerance[i, 0]
            or _distance(top, k, i) > STEP * tolerance[i, 1]
        )
        if not (far or must[i] or i - k >= MOST_DROPPED):
            i += 1
            continue
        while True:
            worst, at, off, off_top = 0.0, 0, 0.0, 0.0
            for j in range(k + 1, i):
                bottom, upper = _chord_distances(tip, top, k, i, j)
                off, off_top = max(off, bottom), max(off_top, upper)
                share = max(bottom / tolerance[j, 0], upper / tolerance[j, 1])
                if share > worst:
                    worst, at = share, j
            if worst <= DROP:
                break
            i = at
        kept[count] = i
        used[count, 0], used[count, 1] = off, off_top
        count += 1
        k = i
        i += 1
    return kept[:count].copy(), used[:count].copy()


@njit(cache=True, nogil=True)
def _turn_at(points: FloatArray, j: int, back: int, forth: int) -> float:
    dot, a, b = 0.0, 0.0, 0.0
    for i in range(3):
        x, y = points[j, i] - points[back, i], points[forth, i] - points[j, i]
        dot += x * y
        a += x * x
        b += y * y
    return acos(min(1.0, max(-1.0, dot / sqrt(a * b)))) if a > 0.0 and b > 0.0 else 0.0


@njit(cache=True, nogil=True)
def _chord_from(
    points: FloatArray,
    u: FloatArray,
    j: int,
    step: int,
    first: int,
    last: int,
    least: float,
    reach: float,
) -> int:
    """Return the nearest vertex in one direction at the distance ``least``; -1 if none is near."""
    k = j + step
    while first <= k <= last:
        if _distance(points, j, k) >= least:
            return k
        if abs(u[k] - u[j]) >= reach:
            return -1
        k += step
    return -1


@njit(cache=True, nogil=True)
def vertex_turns(
    tip: FloatArray,
    top: FloatArray,
    u: FloatArray,
    closed: BoolArray,
    tolerance: FloatArray,
    first: int,
    last: int,
) -> FloatArray:
    """Return the larger turn of tip and top at vertices [rad]; 0 where no chord is long enough."""
    n = len(u)
    found = np.zeros(last - first)
    for j in range(first, last):
        if closed[j]:
            continue
        low = j
        while low > 0 and not closed[low] and u[j] - u[low] < REACH * tolerance[j].max():
            low -= 1
        high = j
        while high < n - 1 and not closed[high] and u[high] - u[j] < REACH * tolerance[j].max():
            high += 1
        for c in range(2):
            points = tip if c == 0 else top
            least = CHORD * tolerance[j, c]
            reach = REACH * tolerance[j].max()
            back = _chord_from(points, u, j, -1, low, high, least, reach)
            forth = _chord_from(points, u, j, 1, low, high, least, reach)
            if back >= 0 and forth >= 0:
                found[j - first] = max(found[j - first], _turn_at(points, j, back, forth))
    return found


@njit(cache=True, nogil=True)
def find_corners(
    turn: FloatArray,
    u: FloatArray,
    closed: BoolArray,
    tolerance: FloatArray,
    least: float,
    first: int,
    last: int,
) -> BoolArray:
    """Return which vertices turn more than ``least`` [rad], and more than all near them."""
    found = np.zeros(last - first, dtype=np.bool_)
    n = len(u)
    for j in range(first, last):
        if turn[j] <= least:
            continue
        reach = CHORD * tolerance[j].max()
        largest = True
        k = j - 1
        while k >= 0 and not closed[k] and u[j] - u[k] <= reach:
            largest &= turn[k] < turn[j]
            k -= 1
        k = j + 1
        while k < n and not closed[k] and u[k] - u[j] <= reach:
            largest &= turn[k] <= turn[j]
            k += 1
        found[j - first] = largest
    return found


@njit(cache=True, nogil=True)
def longest_chord(
    tip: FloatArray,
    top: FloatArray,
    tolerance: FloatArray,
    a: int,
    step: int,
    last: int,
    most: float,
    share: float,
) -> tuple[int, float, float]:
    """Find the farthest vertex whose chord to a keeps near all between; how near [m]."""
    best, best_off, best_top = a + step, 0.0, 0.0
    k = a + step
    while _distance(tip, a, k) < most and k != last:
        k += step
        off, off_top = 0.0, 0.0
        for j in range(min(a, k) + 1, max(a, k)):
            bottom, upper = _chord_distances(tip, top, a, k, j)
            off, off_top = max(off, bottom), max(off_top, upper)
        if off > share * tolerance[0] or off_top > share * tolerance[1]:
            break
        if _distance(tip, a, k) > _distance(tip, a, best):  # blocks may lead back to their start
            best, best_off, best_top = k, off, off_top
    return best, best_off, best_top


@njit(cache=True, nogil=True)
def run_end(v: Vertices, start: int, decided: int) -> tuple[int, bool, bool]:
    """Return the last known vertex of a run, whether it ends, and whether enough is known."""
    if start + 1 < len(v.u) and v.kind[start + 1] != SHORT:
        return start, True, True
    if start + 1 >= decided:
        return start, False, False
    for k in range(start + 1, decided):
        if v.closed[k] or v.corner[k] or (k + 1 < len(v.u) and v.kind[k + 1] != SHORT):
            return k, True, True
    last = decided - 1
    longest = LONGEST * min(v.tolerance[start + 1, 0], v.tolerance[start + 1, 1])
    long = v.u[last] >= v.u[start] + AHEAD * longest
    return last, False, long and last - start >= FEWEST_BLOCKS
