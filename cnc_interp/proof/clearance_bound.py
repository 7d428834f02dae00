"""The gap between two pieces that a certificate proves, computed independently of the planner.

The enclosure of the interval comes from the columns of ``path.npz``. Each disc of piece A gets its
own bound along n: its first-order motion, the remainder of the enclosure, and higher orders with
its own levers. The planner bounds a ball around the piece instead; no code is shared.
"""

from math import comb, cos, pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: Derivatives 0 to 3 by u at both ends of a cell -> coefficients of 1, u ... u^7.
HERMITE = np.linalg.inv(
    [
        [
            np.prod(np.arange(k, k - m, -1.0)) * (u if k > m else 1.0) if k >= m else 0.0
            for k in range(8)
        ]
        for u in (0.0, 1.0)
        for m in range(4)
    ]
)
#: Coefficients of 1, u ... u^7 -> Bernstein values.
BERNSTEIN = np.array(
    [[comb(k, i) / comb(7, i) if i <= k else 0.0 for i in range(8)] for k in range(8)]
)


class Cells(NamedTuple):
    """The path, as stored in the plan files."""

    s: FloatArray  #: (N,): Path length at the grid points [m].
    left: FloatArray  #: (4, N - 1, n): Derivatives by s at the left end of each cell.
    right: FloatArray  #: (4, N - 1, n): Likewise at the right end.


class Links(NamedTuple):
    """The tree of links, the base first."""

    parent: IntArray
    axis: IntArray  #: Axis of the joint before each link; -1 if it is fixed.
    turns: BoolArray  #: Whether that axis is rotary.
    origin: FloatArray  #: (n, 3): Origin of each link in the frame of its parent [m].
    along: FloatArray  #: (n, 3): Direction of the axis [-].
    turn: FloatArray  #: (n, 3, 3): How the link is turned in its parent, with the axis at zero.


class Solids(NamedTuple):
    """The pieces of the scene."""

    disc: FloatArray
    first: IntArray
    along: FloatArray
    round: FloatArray
    link: IntArray
    ball: (
        FloatArray  #: (n, 4): Any point near the middle of each piece [m]; its radius is not read.
    )


@njit(cache=True, nogil=True)
def polynomial(cells: Cells, i: int, j: int, out: FloatArray) -> None:
    """Write the coefficients in u of one axis in one cell, (8,)."""
    h = cells.s[i + 1] - cells.s[i]
    for k in range(8):
        total, power = 0.0, 1.0
        for m in range(4):
            total += power * (
                HERMITE[k, m] * cells.left[m, i, j] + HERMITE[k, 4 + m] * cells.right[m, i, j]
            )
            power *= h
        out[k] = total


@njit(cache=True, nogil=True)
def onto(c: FloatArray, u0: float, width: float) -> None:
    """Change coefficients in u to those in v with u = u0 + width v."""
    for k in range(8):
        for i in range(6, k - 1, -1):
            c[i] += u0 * c[i + 1]
    power = 1.0
    for k in range(8):
        c[k] *= power
        power *= width


@njit(cache=True, nogil=True)
def cell_at(s: FloatArray, place: float) -> int:
    found = int(np.searchsorted(s, place, 'right'))
    return max(min(found - 1, len(s) - 2), 0)


@njit(cache=True, nogil=True)
def place(cells: Cells, s: float, out: FloatArray) -> None:
    """Write the axis positions at a path length, (n,) [m, rad]."""
    i = cell_at(cells.s, s)
    u, c = (s - cells.s[i]) / (cells.s[i + 1] - cells.s[i]), np.empty(8)
    for j in range(cells.left.shape[2]):
        polynomial(cells, i, j, c)
        value = c[7]
        for k in range(6, -1, -1):
            value = value * u + c[k]
        out[j] = value


@njit(cache=True, nogil=True)
def enclosure(cells: Cells, begin: float, end: float, out: FloatArray) -> None:
    """Write for each axis the middle, half the change and a bound of the remainder, (3, n)."""
    s, n = cells.s, cells.left.shape[2]
    first = cell_at(s, begin)
    after = int(np.searchsorted(s, end, 'left'))
    last = max(min(after - 1, len(s) - 2), first)
    ends, c = np.empty((2, n)), np.empty(8)
    place(cells, begin, ends[0])
    place(cells, end, ends[1])
    for j in range(n):
        low, high = 1e300, -1e300
        slope = (ends[1, j] - ends[0, j]) / (end - begin)
        for i in range(first, last + 1):
            h = s[i + 1] - s[i]
            from_s, to_s = max(s[i], begin), min(s[i + 1], end)
            polynomial(cells, i, j, c)
            onto(c, (from_s - s[i]) / h, (to_s - from_s) / h)
            c[0] -= ends[0, j] + slope * (from_s - begin)
            c[1] -= slope * (to_s - from_s)
            for k in range(8):
                value = 0.0
                for m in range(k + 1):
                    value += BERNSTEIN[k, m] * c[m]
                low, high = min(low, value), max(high, value)
        out[0, j] = 0.5 * (ends[0, j] + ends[1, j] + low + high)
        out[1, j] = 0.5 * (ends[1, j] - ends[0, j])
        out[2, j] = 0.5 * (high - low)


@njit(cache=True, nogil=True)
def frames(links: Links, q: FloatArray, turn: FloatArray, origin: FloatArray) -> None:
    """Write rotations (n, 3, 3) and origins (n, 3) of all links in M."""
    turn[0], origin[0] = np.eye(3), 0.0
    for k in range(1, len(links.parent)):
        p, u, axis = links.parent[k], links.along[k], links.axis[k]
        shift = links.origin[k].copy()
        local = np.eye(3)
        if axis >= 0 and not links.turns[k]:
            shift += u * q[axis]
        elif axis >= 0:
            skew = np.array(((0.0, -u[2], u[1]), (u[2], 0.0, -u[0]), (-u[1], u[0], 0.0)))
            local += sin(q[axis]) * skew + (1.0 - cos(q[axis])) * (skew @ skew)
        turn[k] = turn[p] @ (links.turn[k] @ local)
        origin[k] = origin[p] + turn[p] @ shift


@njit(cache=True, nogil=True)
def size(v: FloatArray) -> float:
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@njit(cache=True, nogil=True)
def crossed(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.array(
        (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])
    )


@njit(cache=True, nogil=True)
def joints_of_pair(links: Links, a: int, b: int, out_link: IntArray, out_sense: FloatArray) -> int:
    """Write the links whose joints lie between links a and b, from a on; return their number."""
    carried = np.zeros(len(links.parent), dtype=np.bool_)
    k = b
    while k >= 0:
        carried[k] = True
        k = links.parent[k]
    count, k = 0, a
    while not carried[k]:
        if links.axis[k] >= 0:
            out_link[count], out_sense[count] = k, 1.0
            count += 1
        k = links.parent[k]
    common, k, begin = k, b, count
    while k != common:
        if links.axis[k] >= 0:
            out_link[count], out_sense[count] = k, -1.0
            count += 1
        k = links.parent[k]
    # From the common link down to b: the other way round.
    out_link[begin:count] = out_link[begin:count][::-1].copy()
    return count


@njit(cache=True, nogil=True)
def around(solids: Solids, piece: int) -> float:
    """Return the distance from the middle of a piece to its farthest point [m]."""
    most, axis = 0.0, solids.along[piece]
    for i in range(solids.first[piece], solids.first[piece + 1]):
        way = solids.disc[i, :3] - solids.ball[piece, :3]
        up = (way * axis).sum()
        across = size(way - up * axis) + solids.disc[i, 3]
        most = max(most, sqrt(up * up + across * across))
    return most + solids.round[piece]


@njit(cache=True, nogil=True)
def certified(
    solids: Solids,
    links: Links,
    cells: Cells,
    span: FloatArray,
    pair: IntArray,
    normal: FloatArray,
    group: IntArray,
) -> FloatArray:
    """Return the least gap between its pieces that each certificate proves, (m,) [m].

    ``group`` (m,): an order of the certificates in which those of one interval are adjacent.
    """
    n_links, n = len(links.parent), cells.left.shape[2]
    proven, motion = np.empty(len(span)), np.empty((3, n))
    turn, origin = np.empty((n_links, 3, 3)), np.empty((n_links, 3))
    steps, senses = np.empty(n_links, np.int64), np.empty(n_links)
    before = -1
    for row in group:
        if before < 0 or span[row, 0] != span[before, 0] or span[row, 1] != span[before, 1]:
            enclosure(cells, span[row, 0], span[row, 1], motion)
            frames(links, motion[0], turn, origin)
        before = row
        a, b = pair[row]
        link_a, link_b = solids.link[a], solids.link[b]
        along = turn[link_b] @ normal[row]
        other = 1e300
        axis = turn[link_b] @ solids.along[b]
        for i in range(solids.first[b], solids.first[b + 1]):
            p = turn[link_b] @ solids.disc[i, :3] + origin[link_b]
            reach = (p * along).sum() - solids.disc[i, 3] * size(crossed(along, axis))
            other = min(other, reach - solids.round[b])
        count = joints_of_pair(links, link_a, link_b, steps, senses)
        axis = turn[link_a] @ solids.along[a]
        middle = turn[link_a] @ solids.ball[a, :3] + origin[link_a]
        radius = around(solids, a)
        near, near_whole = -1e300, -1e300
        for i in range(solids.first[a], solids.first[a + 1]):
            p = turn[link_a] @ solids.disc[i, :3] + origin[link_a]
            rho, r = solids.disc[i, 3], solids.round[a]
            change, change_axis, rest, way = 0.0, np.zeros(3), 0.0, 0.0
            for j in range(count):
                k = steps[j]
                u = turn[k] @ links.along[k]
                half, eps = motion[1, links.axis[k]], motion[2, links.axis[k]]
                most = abs(half) + eps
                if not links.turns[k]:
                    change += senses[j] * half * (along * u).sum()
                    rest += eps * abs((along * u).sum())
                    way += most
                    continue
                # n . (u x (p - o)) = (n x u) . (p - o)
                across = crossed(along, u)
                arm = p - origin[k]
                change += senses[j] * half * (across * arm).sum()
                change_axis += senses[j] * half * across
                # The ball around the disc, or that around the piece, whichever is nearer.
                away = middle - origin[k]
                own = abs((across * arm).sum()) + size(across) * (rho + r)
                rest += eps * min(own, abs((across * away).sum()) + size(across) * radius)
                lever = min(size(crossed(arm, u)) + rho + r, size(crossed(away, u)) + radius)
                chord = 2.0 * sin(0.5 * min(most, pi))
                rest += chord * way + 0.5 * most * most * lever
                way += chord * lever
            here = (p * along).sum()
            for sign in (-1.0, 1.0):
                tilted = along + sign * change_axis
                reach = here + sign * change + rho * size(crossed(tilted, axis)) + r * size(tilted)
                near = max(near, reach + rest)
            near_whole = max(near_whole, here + rho * size(crossed(along, axis)) + r + way)
        proven[row] = other - min(near, near_whole)
    return proven
