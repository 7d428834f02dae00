"""Check that pairs of pieces keep their clearance along the path: the bound, and the descent.

Take an interval (``enclosure.py``) and look from link B at the reference position q = c. A point x
of A then moves by the joints of ``link_poses.py``, one after the other. With unit vectors u_j
along the axes, points o_j on them, senses sigma_j and any unit vector n, to first order

    n . x(t) = n . x + t (w . x + k)
    w = sum_rotary sigma_j a_j (n x u_j)
    k = sum_linear sigma_j a_j n . u_j - sum_rotary sigma_j a_j (n x u_j) . o_j

This is linear in x. The axes are summed before anything is bounded, so that the large opposite
motions of a tool-tip path cancel. The terms in eps add at most ``res``, and higher orders add at
most ``rem``. A joint with angle d contributes d D, where D is the displacement before it, and
d^2/2 times its lever. So the pieces stay apart along n by at least

    -h_B(-n) - max(h_A(n + w) + k, h_A(n - w) - k) - res - rem,   and by  -h_B(-n) - h_A(n) - D.

Interval, pair and n form a *certificate*. Whether it holds does not depend on how n was found.

The descent halves the path until every pair has certificates or a hit; it visits the first half
first. A pair with a certificate for an interval is skipped in its halves.
"""

from __future__ import annotations

from math import pi, sin, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.collision.enclosure import enclose, position
from cnc_interp.collision.gjk import nearest
from cnc_interp.collision.link_poses import Chain, placed, pose_links, turned, turned_back
from cnc_interp.collision.shapes import Pieces, support
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

ROUNDING = 1e-9  #: Allowance of the bound for rounding errors [m].
#: An interval in which the pieces move less than this is not halved again [m]. If it has no
#: certificate, it counts as a hit: the pieces are nearer than the clearance plus a micrometre.
STILL = 0.4e-6
#: Columns of a joint between two links: direction, a point on the axis, signed a, eps, and 1 for
#: a linear axis.
U, O, A, EPS, LINEAR, WIDTH = 0, 3, 6, 7, 8, 9
MOST_JOINTS = 12


class Route(NamedTuple):
    """A part of the path."""

    s: FloatArray  #: (N,): Path length at the ends of its cells [m].
    bezier: FloatArray  #: (N - 1, n_axes, 8): Bezier values of the axes [m, rad].
    line_end: FloatArray  #: (N - 1,): Path length where the program line of each cell ends [m].


class Space(NamedTuple):
    """All that can collide: pieces, the links that carry them, and the clearances of bodies."""

    pieces: Pieces
    chain: Chain
    #: Steps between links: first step, senses and links; see ``chain.step_table``.
    step_first: IntArray
    step_sense: FloatArray
    step_link: IntArray
    clearance: FloatArray  #: (bodies, bodies): Smallest allowed distance [m].


class Found(NamedTuple):
    """What a descent found, row by row."""

    span: FloatArray  #: (n, 2): Path length at begin and end of each certificate [m].
    pair: IntArray  #: (n, 2): The two pieces of each certificate.
    #: (n, 3): Unit vector of each from A to B, in the frame of the link of B [-].
    normal: FloatArray
    #: (m, 9): Hits: path length at begin and end of the stretch that is then skipped, distance,
    #: witness points of A and of B, each in the frame of its link [m].
    hit: FloatArray
    hit_pair: IntArray  #: (m, 2): The pieces that hit.
    effort: IntArray  #: (2,): Number of intervals visited, and of pairs tested.


@njit(cache=True, nogil=True)
def relative_pose(b: FloatArray, a: FloatArray, out: FloatArray) -> None:
    """Write the pose of link A in the frame of link B, (12,)."""
    for i in range(3):
        for j in range(3):
            out[3 * i + j] = b[i] * a[j] + b[3 + i] * a[3 + j] + b[6 + i] * a[6 + j]
    x, y, z = a[9] - b[9], a[10] - b[10], a[11] - b[11]
    for i in range(3):
        out[9 + i] = b[i] * x + b[3 + i] * y + b[6 + i] * z


@njit(cache=True, nogil=True)
def joints_between(
    space: Space, pose: FloatArray, motion: FloatArray, a: int, b: int, out: FloatArray
) -> int:
    """Write the joints from link A to link B in the frame of B, row by row; return their number.

    ``motion`` (3, n_axes): c, a and eps of the axes.
    """
    chain, count = space.chain, 0
    at = a * len(chain.parent) + b
    for step in range(space.step_first[at], space.step_first[at + 1]):
        k, sense = space.step_link[step], space.step_sense[step]
        row, axis = out[count], chain.axis[k]
        u = turned_back(
            pose[b], turned(pose[k], (chain.along[k, 0], chain.along[k, 1], chain.along[k, 2]))
        )
        o = turned_back(
            pose[b],
            (pose[k, 9] - pose[b, 9], pose[k, 10] - pose[b, 10], pose[k, 11] - pose[b, 11]),
        )
        row[0], row[1], row[2] = u
        row[3], row[4], row[5] = o
        row[A], row[EPS], row[LINEAR] = sense * motion[1, axis], motion[2, axis], chain.linear[k]
        count += 1
    return count


@njit(cache=True, nogil=True)
def displaced(
    joints: FloatArray, count: int, centre: tuple[float, float, float], radius: float
) -> tuple[float, float]:
    """Return D and rem of a ball: how far it moves, and how much higher orders can add [m]."""
    way, rest = 0.0, 0.0
    for j in range(count):
        row = joints[j]
        d = abs(row[A]) + row[EPS]
        if row[LINEAR] > 0.5:
            way += d
            continue
        x, y, z = centre[0] - row[3], centre[1] - row[4], centre[2] - row[5]
        cx, cy, cz = y * row[2] - z * row[1], z * row[0] - x * row[2], x * row[1] - y * row[0]
        lever = sqrt(cx * cx + cy * cy + cz * cz) + radius
        chord = 2.0 * sin(0.5 * min(d, pi))
        rest += chord * way + 0.5 * d * d * lever
        way += chord * lever
    return way, rest


@njit(cache=True, nogil=True)
def reach(pieces: Pieces, piece: int, v: tuple[float, float, float]) -> float:
    """Return the support function of a piece along any vector of its link [m]."""
    along = pieces.along[piece, 0], pieces.along[piece, 1], pieces.along[piece, 2]
    _, value = support(pieces.disc, pieces.first[piece], pieces.first[piece + 1], along, v)
    return value + pieces.round[piece] * sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@njit(cache=True, nogil=True)
def reach_from(
    pieces: Pieces, piece: int, pose: FloatArray, v: tuple[float, float, float]
) -> float:
    """Return the support function of a piece of link A, both in the frame of link B [m]."""
    shift = v[0] * pose[9] + v[1] * pose[10] + v[2] * pose[11]
    return reach(pieces, piece, turned_back(pose, v)) + shift


@njit(cache=True, nogil=True)
def gap(
    pieces: Pieces,
    a: int,
    b: int,
    pose: FloatArray,
    joints: FloatArray,
    count: int,
    n: tuple[float, float, float],
) -> float:
    """Return a lower bound of the gap between two pieces along n in the whole interval [m].

    ``pose`` (12,): the link of A in the frame of that of B, at the reference position.
    """
    ball = pieces.ball[a]
    centre, radius = placed(pose, (ball[0], ball[1], ball[2])), ball[3]
    way, rest = displaced(joints, count, centre, radius)
    w0 = w1 = w2 = k = res = 0.0
    for j in range(count):
        row = joints[j]
        if row[LINEAR] > 0.5:
            along = n[0] * row[0] + n[1] * row[1] + n[2] * row[2]
            k += row[A] * along
            res += row[EPS] * abs(along)
            continue
        m0 = n[1] * row[2] - n[2] * row[1]
        m1 = n[2] * row[0] - n[0] * row[2]
        m2 = n[0] * row[1] - n[1] * row[0]
        w0, w1, w2 = w0 + row[A] * m0, w1 + row[A] * m1, w2 + row[A] * m2
        k -= row[A] * (m0 * row[3] + m1 * row[4] + m2 * row[5])
        off = m0 * (centre[0] - row[3]) + m1 * (centre[1] - row[4]) + m2 * (centre[2] - row[5])
        res += row[EPS] * (abs(off) + sqrt(m0 * m0 + m1 * m1 + m2 * m2) * radius)
    ahead = reach_from(pieces, a, pose, (n[0] + w0, n[1] + w1, n[2] + w2)) + k
    behind = reach_from(pieces, a, pose, (n[0] - w0, n[1] - w1, n[2] - w2)) - k
    other = -reach(pieces, b, (-n[0], -n[1], -n[2]))
    first_order = other - max(ahead, behind) - res - rest
    return max(first_order, other - reach_from(pieces, a, pose, n) - way) - ROUNDING


@njit(cache=True, nogil=True)
def grown_rows(rows: FloatArray, count: int) -> FloatArray:
    if count < len(rows):
        return rows
    more = np.empty((2 * len(rows), rows.shape[1]), rows.dtype)
    more[:count] = rows[:count]
    return more


@njit(cache=True, nogil=True)
def descend(
    space: Space,
    route: Route,
    cells: tuple[int, int],
    pairs: IntArray,
    until: FloatArray,
    most_hits: int,
) -> Found:
    """Find certificates or hits of pairs of pieces, (k, 2), in the cells [first, last).

    ``until`` (bodies, bodies): path length up to which a pair of bodies is known to hit; the
    descent updates it [m]. The descent ends after ``most_hits`` hits.
    """
    pieces, chain, s = space.pieces, space.chain, route.s
    n_links, n_axes = len(chain.parent), route.bezier.shape[1]
    motion, q = np.empty((3, n_axes)), np.empty(n_axes)
    pose, start = np.empty((n_links, 12)), np.empty((n_links, 12))
    rel, out = np.empty(12), np.empty(9)
    tables, counts = np.empty((n_links * n_links, MOST_JOINTS, WIDTH)), np.empty(0, np.int64)
    spans, normals = np.empty((1024, 2)), np.empty((1024, 3))
    owners, found = np.empty((1024, 2), np.int64), 0
    hits, hit_pairs, n_hits = np.empty((16, 9)), np.empty((16, 2), np.int64), 0
    # Open pairs of all intervals that wait, one after the other; their normals, 0 of none.
    pool, pool_n = np.empty((1024, 2), np.int64), np.empty((1024, 3))
    while len(pool) < len(pairs):
        pool, pool_n = grown_rows(pool, len(pool)), grown_rows(pool_n, len(pool_n))
    pool[: len(pairs)], pool_n[: len(pairs)] = pairs, 0.0
    work, work_n = pool.copy(), pool_n.copy()
    # Intervals that wait: begin and end [m]; first and last cell, first open pair, their number.
    ends, marks, depth = np.empty((256, 2)), np.empty((256, 4), np.int64), 1
    ends[0, 0], ends[0, 1] = s[cells[0]], s[cells[1]]
    marks[0] = np.array((cells[0], cells[1] - 1, 0, len(pairs)))
    nodes, tests = 0, 0
    while depth and n_hits < most_hits:
        depth -= 1
        begin, end = ends[depth]
        first, last, at, todo = marks[depth]
        while len(work) < todo:
            work, work_n = grown_rows(work, len(work)), grown_rows(work_n, len(work_n))
        work[:todo], work_n[:todo] = pool[at : at + todo], pool_n[at : at + todo]
        base = top = at + todo
        enclose(s, route.bezier, begin, end, first, last, motion)
        pose_links(chain, motion[0], pose)
        counts = np.full(n_links * n_links, -1)
        nodes, i, started = nodes + 1, 0, False
        while i < todo:
            a, b = work[i]
            n = work_n[i, 0], work_n[i, 1], work_n[i, 2]
            i += 1
            body_a, body_b = pieces.body[a], pieces.body[b]
            clearance, known = space.clearance[body_a, body_b], until[body_a, body_b]
            keep = begin < known < end
            if begin < known and not keep:
                continue
            if not keep:
                tests += 1
                link_a, link_b = pieces.link[a], pieces.link[b]
                table = link_a * n_links + link_b
                if counts[table] < 0:
                    counts[table] = joints_between(
                        space, pose, motion, link_a, link_b, tables[table]
                    )
                joints, count = tables[table], counts[table]
                relative_pose(pose[link_b], pose[link_a], rel)
                ball = pieces.ball[a]
                centre = placed(rel, (ball[0], ball[1], ball[2]))
                way, _ = displaced(joints, count, centre, ball[3])
                x = pieces.ball[b, 0] - centre[0]
                y = pieces.ball[b, 1] - centre[1]
                z = pieces.ball[b, 2] - centre[2]
                apart = sqrt(x * x + y * y + z * z)
                clear = apart - ball[3] - pieces.ball[b, 3] - way - ROUNDING > clearance
                if clear:
                    n = x / apart, y / apart, z / apart
                elif n[0] != 0.0 or n[1] != 0.0 or n[2] != 0.0:
                    clear = gap(pieces, a, b, rel, joints, count, n) > clearance
                distance = 0.0
                if not clear:
                    distance = nearest(pieces, a, b, rel, out)
                    if distance > 0.0:
                        n = out[0], out[1], out[2]
                        clear = gap(pieces, a, b, rel, joints, count, n) > clearance
                if clear:
                    spans = grown_rows(spans, found)
                    normals, owners = grown_rows(normals, found), grown_rows(owners, found)
                    spans[found, 0], spans[found, 1] = begin, end
                    owners[found, 0], owners[found, 1] = a, b
                    normals[found, 0], normals[found, 1], normals[found, 2] = n
                    found += 1
                    continue
                divided = larger_to_divide(pieces, a, b)
                if divided >= 0 and way < pieces.ball[divided, 3]:
                    if todo + 2 > len(work):
                        work, work_n = grown_rows(work, len(work)), grown_rows(work_n, len(work))
                    for c in range(2):
                        child = pieces.child[divided, c]
                        work[todo, 0] = child if divided == a else a
                        work[todo, 1] = b if divided == a else child
                        work_n[todo, 0], work_n[todo, 1], work_n[todo, 2] = n
                        todo += 1
                    continue
                if divided < 0:
                    if not started:
                        position(
                            route.bezier, first, (begin - s[first]) / (s[first + 1] - s[first]), q
                        )
                        pose_links(chain, q, start)
                        started = True
                    relative_pose(start[link_b], start[link_a], rel)
                    at_start = nearest(pieces, a, b, rel, out)
                    if at_start < clearance or way < STILL:
                        hits, hit_pairs = grown_rows(hits, n_hits), grown_rows(hit_pairs, n_hits)
                        hits[n_hits, 0], hits[n_hits, 1] = begin, route.line_end[first]
                        hits[n_hits, 2] = at_start
                        hits[n_hits, 3:] = out[3:]
                        hit_pairs[n_hits, 0], hit_pairs[n_hits, 1] = a, b
                        n_hits += 1
                        until[body_a, body_b] = until[body_b, body_a] = route.line_end[first]
                        keep = end > route.line_end[first]
                        if not keep:
                            continue
            if top + 1 > len(pool):
                pool, pool_n = grown_rows(pool, len(pool)), grown_rows(pool_n, len(pool_n))
            pool[top, 0], pool[top, 1] = a, b
            pool_n[top, 0], pool_n[top, 1], pool_n[top, 2] = n
            top += 1
        if top == base:
            continue
        if last > first:
            middle = (first + last + 1) // 2
            place = s[middle]
        else:
            middle, place = first, 0.5 * (begin + end)
        left_last = middle - 1 if last > first else first
        ends[depth, 0], ends[depth, 1] = place, end
        marks[depth, 0], marks[depth, 1] = middle, last
        ends[depth + 1, 0], ends[depth + 1, 1] = begin, place
        marks[depth + 1, 0], marks[depth + 1, 1] = first, left_last
        for k in range(depth, depth + 2):
            marks[k, 2], marks[k, 3] = base, top - base
        depth += 2
    return Found(
        spans[:found],
        owners[:found],
        normals[:found],
        hits[:n_hits],
        hit_pairs[:n_hits],
        np.array((nodes, tests)),
    )


@njit(cache=True, nogil=True, inline='always')
def larger_to_divide(pieces: Pieces, a: int, b: int) -> int:
    """Return the larger piece of a pair that has parts; -1 if neither has any."""
    if pieces.child[a, 0] < 0:
        return b if pieces.child[b, 0] >= 0 else -1
    return b if pieces.child[b, 0] >= 0 and pieces.ball[b, 3] > pieces.ball[a, 3] else a
