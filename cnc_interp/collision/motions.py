"""Pieces of motion: chords between poses of the tool, seen from the stock, near the true motion.

In a piece of motion, a point x of the tool moves from x - v(x) to x + v(x) in the frame of the
stock, where v is linear in x. ``displaced`` of ``clearance.py`` bounds its deviation from the
truth.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from cnc_interp.collision.clearance import (
    EPS,
    LINEAR,
    MOST_JOINTS,
    WIDTH,
    A,
    O,
    Route,
    Space,
    displaced,
    grown_rows,
    joints_between,
    relative_pose,
)
from cnc_interp.collision.enclosure import enclose
from cnc_interp.collision.link_poses import pose_links
from cnc_interp.collision.mill_sweep import FAR
from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit

#: Columns of a piece of motion: tip and axis of the tool at its middle, half the motion of the
#: tip, half the change of the axis, all in the frame of the stock [m, -]; path length at both ends
#: [m]; largest deviation of a point of the tool [m]; number of the tool; volume removed [m3].
TIP, AXIS, MOVE, TURN, BEGIN, END, LEFT, TOOL, REMOVED, MOTION = 0, 3, 6, 9, 12, 13, 14, 15, 16, 17
MOST_TURN = 0.05  #: Largest turn of the axis to either side in a piece of motion [rad].


@njit(cache=True, nogil=True)
def part_of(whole: FloatArray, begin: float, end: float, out: FloatArray) -> None:
    """Write the part of a piece of motion from one path length to another [m]."""
    size = whole[END] - whole[BEGIN]
    share, side = (end - begin) / size, (begin + end - whole[BEGIN] - whole[END]) / size
    out[:] = whole
    out[TIP:MOVE] += side * whole[MOVE:BEGIN]
    out[MOVE:BEGIN] *= share
    out[LEFT] *= share
    out[BEGIN], out[END] = begin, end


@njit(cache=True, nogil=True)
def _motion(
    space: Space,
    route: Route,
    span: tuple[float, float, int, int],
    links: tuple[int, int],
    sizes: FloatArray,
    out: FloatArray,
) -> float:
    """Write one piece of motion; return the largest deviation of the mill from it [m].

    The piece is the chord between the poses at both ends. Path and chord each deviate from the
    tangent in the middle by at most the bound of ``displaced``, so from each other by twice that.
    """
    begin, end, first, last = span
    n_links, n_axes = len(space.chain.parent), route.bezier.shape[1]
    motion, pose, rel = np.empty((3, n_axes)), np.empty((n_links, 12)), np.empty(12)
    joints, tool = np.empty((MOST_JOINTS, WIDTH)), np.empty((3, 6))
    enclose(route.s, route.bezier, begin, end, first, last, motion)
    for k, side in ((0, -1.0), (1, 1.0), (2, 0.0)):
        pose_links(space.chain, motion[0] + side * motion[1], pose)
        relative_pose(pose[links[1]], pose[links[0]], rel)
        tool[k, :3] = rel[9:]
        tool[k, 3:] = rel[2:9:3]
    out[:] = 0.0
    out[TIP:MOVE], out[MOVE:BEGIN] = 0.5 * (tool[0] + tool[1]), 0.5 * (tool[1] - tool[0])
    out[BEGIN], out[END] = begin, end
    count, found = joints_between(space, pose, motion, links[0], links[1], joints), 0.0
    for k in range(len(sizes)):
        middle, radius, wide, flat = sizes[k]
        centre = tool[2, :3] + middle * tool[2, 3:]
        _, left = displaced(joints, count, (centre[0], centre[1], centre[2]), radius)
        left, spin = 2.0 * left, 0.0
        for row in joints[:count]:
            lever, turns = 1.0, row[LINEAR] < 0.5
            if turns:
                lever, spin = radius + length_of(centre - row[O:A]), spin + abs(row[A])
            left += row[EPS] * lever
        out[LEFT] = left + 0.5 * wide * spin * spin
        found = found if k else out[LEFT] + flat * length_of(out[TURN:BEGIN])
    return found if length_of(out[TURN:BEGIN]) < MOST_TURN else FAR


@njit(cache=True, nogil=True)
def length_of(v: FloatArray) -> float:
    return sqrt((v * v).sum())


@njit(cache=True, nogil=True)
def motions_of(
    space: Space,
    route: Route,
    cells: tuple[int, int],
    links: tuple[int, int],
    sizes: FloatArray,
    lost: float,
) -> FloatArray:
    """Divide cells [first, last) into pieces of motion, (m, MOTION).

    ``sizes``: of mill and tool, from ``CutStock._sizes``; ``lost``: largest value that ``_motion``
    may return for a piece [m].
    """
    s, found = route.s, 0
    out, tried = np.empty((256, MOTION)), np.empty(MOTION)
    begin, cell = s[cells[0]], cells[0]
    while cell < cells[1]:
        out = grown_rows(out, found)
        end, after, step = s[cell + 1], cell + 1, 1
        while _motion(space, route, (begin, end, cell, cell), links, sizes, out[found]) > lost:
            end = begin + 0.5 * (end - begin)
        while end == s[after] and after < cells[1]:
            last = min(after + step, cells[1])
            span = begin, s[last], cell, last - 1
            if _motion(space, route, span, links, sizes, tried) > lost:
                break
            out[found] = tried
            end, after, step = s[last], last, 2 * step
        found, begin = found + 1, end
        while cell < cells[1] and s[cell + 1] <= begin:
            cell += 1
    return out[:found]


@njit(cache=True, nogil=True)
def joined(rows: FloatArray, reach: float, flat: float, lost: float) -> FloatArray:
    """Join pieces of motion while all points of the mill stay within ``lost`` of one motion [m].

    ``reach``: largest height of the tool; ``flat``: radius of its flat end [m].
    """
    out, found, first, tried = np.empty_like(rows), 0, 0, np.empty(MOTION)
    while first < len(rows):
        last = first + 1
        out[found] = rows[first]
        while last < len(rows) and _join(rows[first : last + 1], reach, flat, tried) <= lost:
            out[found] = tried
            last += 1
        found, first = found + 1, last
    return out[:found]


@njit(cache=True, nogil=True)
def _join(rows: FloatArray, reach: float, flat: float, out: FloatArray) -> float:
    """Write the motion from the first pose of pieces to the last; return its deviation [m]."""
    one, other = rows[0], rows[-1]
    out[:] = one
    for c in range(TIP, MOVE):
        begin, end = one[c] - one[c + MOVE], other[c] + other[c + MOVE]
        out[c], out[c + MOVE] = 0.5 * (begin + end), 0.5 * (end - begin)
    out[END], way, left = other[END], 0.0, 0.0
    for row in rows:
        for side in (-1.0, 1.0):
            s = row[BEGIN] if side < 0.0 else row[END]
            share = (2.0 * s - out[BEGIN] - out[END]) / (out[END] - out[BEGIN])
            off = row[TIP:MOVE] + side * row[MOVE:BEGIN] - out[TIP:MOVE] - share * out[MOVE:BEGIN]
            way = max(way, length_of(off[:3]) + reach * length_of(off[3:]))
        left = max(left, row[LEFT])
    out[LEFT] = way + left
    turn = length_of(out[TURN:BEGIN])
    return way + flat * turn if turn < MOST_TURN else FAR
