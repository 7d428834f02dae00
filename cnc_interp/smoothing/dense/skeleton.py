"""
What a polyline of tiny blocks looks like at the scale of the tolerance: its vertices and corners.

CAM output holds repeated points, steps of 0.1 um and round-off. The skeleton keeps a vertex more
than half a tolerance from the last one kept, and those that a chord would miss by more than a
tenth; how far the dropped ones lie from their chord is carried on, so that nothing is lost.
A corner is where chords of at least three tolerances turn; on shorter ones angles are noise.
"""

from __future__ import annotations

from math import acos, sqrt

import numpy as np
from numba import njit

#: Shortest step of the skeleton, and farthest dropped vertex, in tolerances.
STEP, DROP = 0.5, 0.1
#: Rows dropped in a line at most.
MOST_DROPPED = 512
#: Chords between which a corner is measured, in tolerances; and the way along u within which
#: such a chord is looked for.
CHORD, REACH = 3.0, 6.0
#: Two poses that differ less are one [m].
SAME = 1e-9


@njit(cache=True, nogil=True)
def missed(tip, top, a, b, j):  # type: ignore[no-untyped-def]
    """Return how far the pose j lies from the chord a - b, tip and top at the same place [m]."""
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
def distance(points, a, b):  # type: ignore[no-untyped-def]
    """Return the distance of two points [m]."""
    return sqrt(
        (points[b, 0] - points[a, 0]) ** 2
        + (points[b, 1] - points[a, 1]) ** 2
        + (points[b, 2] - points[a, 2]) ** 2
    )


@njit(cache=True, nogil=True)
def thin(tip, top, tolerance, must):  # type: ignore[no-untyped-def]
    """
    Choose the vertices of the skeleton.

    Parameters
    ----------
    tip, top : ndarray, shape (n, 3)
        Poses; row 0 is the last one kept [m].
    tolerance : ndarray, shape (n, 2)
        Contour and orientation tolerance of the rows [m].
    must : ndarray of bool, shape (n,)
        Rows that are kept whatever they are.

    Returns
    -------
    kept : ndarray of int, shape (m,)
        The rows kept after row 0, as far as that can be told.
    used : ndarray, shape (m, 2)
        How far what was dropped lies from the chord to that row [m].

    """
    n = len(tip)
    kept, used = np.empty(n, dtype=np.int64), np.zeros((n, 2))
    count, k, i = 0, 0, 1
    while i < n:
        far = (
            distance(tip, k, i) > STEP * tolerance[i, 0]
            or distance(top, k, i) > STEP * tolerance[i, 1]
        )
        if not (far or must[i] or i - k >= MOST_DROPPED):
            i += 1
            continue
        while True:
            worst, at, off, off_top = 0.0, 0, 0.0, 0.0
            for j in range(k + 1, i):
                bottom, upper = missed(tip, top, k, i, j)
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
def turn_at(points, j, back, forth):  # type: ignore[no-untyped-def]
    """Return the angle between the chords back - j and j - forth [rad]."""
    dot, a, b = 0.0, 0.0, 0.0
    for i in range(3):
        x, y = points[j, i] - points[back, i], points[forth, i] - points[j, i]
        dot += x * y
        a += x * x
        b += y * y
    return acos(min(1.0, max(-1.0, dot / sqrt(a * b)))) if a > 0.0 and b > 0.0 else 0.0


@njit(cache=True, nogil=True)
def chord_from(points, u, j, step, first, last, least, reach):  # type: ignore[no-untyped-def]
    """Return the nearest vertex in a direction that is ``least`` away; -1 if none is in reach."""
    k = j + step
    while first <= k <= last:
        if distance(points, j, k) >= least:
            return k
        if abs(u[k] - u[j]) >= reach:
            return -1
        k += step
    return -1


@njit(cache=True, nogil=True)
def turns(tip, top, u, closed, tolerance, first, last):  # type: ignore[no-untyped-def]
    """
    Return by how much tip or top turn at the vertices first ... last - 1 [rad].

    Parameters
    ----------
    tip, top, u : ndarray, shapes (n, 3), (n, 3) and (n,)
        The skeleton [m].
    closed : ndarray of bool, shape (n,)
        Vertices beyond which no chord may reach.
    tolerance : ndarray, shape (n, 2)
        Contour and orientation tolerance at the vertices [m].
    first, last : int
        The vertices asked for.

    """
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
            back = chord_from(points, u, j, -1, low, high, least, reach)
            forth = chord_from(points, u, j, 1, low, high, least, reach)
            if back >= 0 and forth >= 0:
                found[j - first] = max(found[j - first], turn_at(points, j, back, forth))
    return found


@njit(cache=True, nogil=True)
def corners(turn, u, closed, tolerance, least, first, last):  # type: ignore[no-untyped-def]
    """Tell which of the vertices first ... last - 1 turn most around, and by more than least."""
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
def straight_from(tip, top, tolerance, a, step, last, most, share):  # type: ignore[no-untyped-def]
    """
    Return the vertex up to which a chord from vertex a stays near all vertices between.

    Parameters
    ----------
    tip, top : ndarray, shape (n, 3)
        The skeleton [m].
    tolerance : ndarray, shape (2,)
        Tolerances [m].
    a, step, last : int
        Start, direction (+1 or -1), and the last vertex that may be taken.
    most : float
        Once the chord is this long it is enough [m].
    share : float
        Tolerances that vertices may lie off.

    Returns
    -------
    vertex : int
    off, off_top : float
        How far the vertices between lie off [m].

    """
    best, best_off, best_top = a + step, 0.0, 0.0
    k = a + step
    while distance(tip, a, k) < most and k != last:
        k += step
        off, off_top = 0.0, 0.0
        for j in range(min(a, k) + 1, max(a, k)):
            bottom, upper = missed(tip, top, a, k, j)
            off, off_top = max(off, bottom), max(off_top, upper)
        if off > share * tolerance[0] or off_top > share * tolerance[1]:
            break
        best, best_off, best_top = k, off, off_top
    return best, best_off, best_top
