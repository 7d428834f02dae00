"""
The motion follows the program in order: every vertex once, none left out, none twice.

Motion and program are polygons. The motion follows the program if both can be run through at the
same time, each without going back, so that the two points are never further apart than the
tolerance. This is the decision problem of the Frechet distance. It is decided from sample to
sample by the part of every piece of the program that can be reached [Alt and Godau, Computing the
Frechet distance between two polygonal curves, 1995].

It is decided for the tool tip, for the point at flank height, and for the rotary and extra axes
where the program says how these move. At a vertex the tolerance of the vertex counts. Between
vertices ``ROOM`` times the tolerance is enough, because the distance there is judged elsewhere.
The row numbers of the samples are not used; they are compared with the rows that are possible.
This module shares no code with the planner.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.programmed_axes import ProgrammedAxes
from cnc_interp.proof.programmed_path import ProgrammedPath

# Between vertices a distance of so many tolerances is in order.
ROOM = 2.0
# Likewise where tip, rotary and extra axes are compared together, at the vertices too.
JOINT_ROOM = 3.0
# A circle becomes pieces of the polygon that are so near to it, in tolerances.
CHORD_SHARE = 0.05


@dataclass(frozen=True)
class Pieces:
    """
    The program as straight pieces, in some coordinates.

    Parameters
    ----------
    row : ndarray of int, shape (P,)
        Program row of each piece.
    start, end : ndarray, shape (P, D)
        Coordinates at both ends of each piece.
    room : ndarray, shape (P, D)
        Distance that is in order along each piece; infinite for coordinates that are not compared.
    vertex, vertex_room : ndarray, shape (P + 1, D)
        Coordinates of the ends of the pieces, the start of the first piece first, and the distance
        that is in order there.

    """

    row: IntArray
    start: FloatArray
    end: FloatArray
    room: FloatArray
    vertex: FloatArray
    vertex_room: FloatArray

    def backwards(self) -> Pieces:
        """Return the pieces of the same program, run from its end to its start."""
        return Pieces(
            self.row[::-1], self.end[::-1], self.start[::-1], self.room[::-1], self.vertex[::-1],
            self.vertex_room[::-1],
        )  # fmt: skip

    def followed(self, points: FloatArray) -> tuple[IntArray, IntArray, int]:
        """
        Follow the pieces with a motion.

        Parameters
        ----------
        points : ndarray, shape (K, D)
            Samples of the motion.

        Returns
        -------
        first, last : ndarray of int, shape (K,)
            First and last piece that the motion can have reached at each sample; -1 where none.
        furthest : int
            Furthest piece that it can have reached; the number of pieces if it reached the end.

        """
        bulge = np.zeros(points.shape)
        bulge[1:-1] = np.diff(points, 2, axis=0) / 8.0
        pieces = (
            self.start, self.end - self.start, self.room, self.vertex[1:], self.vertex_room[1:]
        )  # fmt: skip
        found: tuple[IntArray, IntArray, int] = _follow(
            np.ascontiguousarray(points), bulge, *(np.ascontiguousarray(a) for a in pieces)
        )
        return found


@dataclass(frozen=True)
class Order:
    """
    What was found about the order of a motion.

    Parameters
    ----------
    left : tuple of (str, int, int)
        What leaves the order, at which sample, and the furthest program row it reached.
    low, high : ndarray of int, shape (K,)
        First and last program row that each sample can execute.

    """

    left: tuple[tuple[str, int, int], ...]
    low: IntArray
    high: IntArray


def order_of(
    plan: PlanFiles,
    machine: Machine,
    tip: FloatArray,
    axis: FloatArray,
    program: ProgrammedPath,
    lines: ProgrammedAxes | None,
    tolerances: tuple[FloatArray, FloatArray],
) -> Order:
    """
    Follow a program with the motion of its plan.

    Parameters
    ----------
    plan : PlanFiles
        Plan with K setpoints and M program rows.
    machine : Machine
        Machine with the forward kinematics to use.
    tip, axis : ndarray, shape (K, 3)
        Tool tip [m] and unit tool axis [-] of the setpoints.
    program : ProgrammedPath
        The program as lines and great circles.
    lines : ProgrammedAxes or None
        Rows of the program whose rotary axes run linearly.
    tolerances : tuple of ndarray, shape (M,)
        Contour and orientation tolerance at the vertices, slack included [m].

    Returns
    -------
    Order
        Where the motion leaves the order, and the rows that are possible.

    """
    low = np.zeros(len(tip), dtype=np.int64)
    high = np.full(len(tip), len(plan.blocks['tip']) - 1, dtype=np.int64)
    left = []
    shapes = _Shapes(plan, machine, program, lines)
    courses = [
        ('tool tip', tip, shapes.pieces(shapes.tip, 'contour_tolerance', tolerances[0])),
        (
            'point at flank height', tip + plan.flank_height * axis,
            shapes.pieces(shapes.top, 'orientation_tolerance', tolerances[1]),
        ),
    ]  # fmt: skip
    if shapes.worded.any() or machine.extra_names:
        extra = plan.position[:, len(machine.axis_names) - len(machine.extra_names) :]
        rotary = plan.position[:, 3 : 5 if machine.has_rotary else 3]
        joint = np.hstack([tip, rotary, extra])
        courses.append(('axes', joint, shapes.joint_pieces(*tolerances)))
    for name, points, pieces in courses:
        first, last, furthest = pieces.followed(points)
        if furthest < len(pieces.row):
            lost = np.flatnonzero(first < 0)
            sample = int(lost[0]) if len(lost) else len(points) - 1
            left.append((name, sample, int(pieces.row[furthest])))
            continue
        reverse = pieces.backwards()
        first_back, last_back, _ = reverse.followed(points[::-1])
        low = np.maximum(low, pieces.row[first])
        low = np.maximum(low, reverse.row[last_back[::-1]])
        high = np.minimum(high, pieces.row[last])
        high = np.minimum(high, reverse.row[first_back[::-1]])
    return Order(tuple(left), low, high)


class _Shapes:
    """The rows of a program cut into pieces: tip, top and rotary axes at the end of each."""

    def __init__(
        self,
        plan: PlanFiles,
        machine: Machine,
        program: ProgrammedPath,
        lines: ProgrammedAxes | None,
    ):
        blocks, height = plan.blocks, plan.flank_height
        self.blocks, rows, self.has_rotary = blocks, len(blocks['tip']), machine.has_rotary
        self.height, transform = height, Transform.of(machine)
        tolerance = np.minimum(blocks['contour_tolerance'], blocks['orientation_tolerance'])
        room = 8.0 * CHORD_SHARE * np.maximum(tolerance, 1e-9)
        linear = np.zeros(rows, dtype=np.bool_) if lines is None else lines.linear
        self.worded = linear | program.by_axes
        before = np.r_[0, np.arange(rows - 1)]
        coordinates = np.zeros((2, rows, plan.position.shape[1]))  # at the start, and the way
        if self.worded.any():
            ruled = program.by_axes & ~linear
            coordinates[0, ruled, 3:5] = blocks['rotary'][before[ruled]]
            coordinates[1, ruled, 3:5] = (blocks['rotary'] - blocks['rotary'][before])[ruled]
        if lines is not None:
            coordinates[0, linear], coordinates[1, linear] = (
                lines.start[linear], lines.step[linear]
            )  # fmt: skip
        # Second derivatives by the share of the row, largest values; a chord is off by an eighth.
        bend = height * program.turn**2
        turn = np.abs(coordinates[1, :, 3:5]).sum(axis=1)
        lever = np.abs(blocks['tip']).max() + np.abs(machine.offsets).sum()
        lever += np.abs(machine.tool_offset).sum() + height
        way = np.linalg.norm(coordinates[1, :, :3], axis=1)
        bend = np.where(self.worded, turn * (turn * lever + 2.0 * way), bend)
        count = np.maximum(np.ceil(np.sqrt(bend / room)), 1.0).astype(np.int64)
        count[0] = 0
        self.row = np.repeat(np.arange(rows), count)
        number = np.arange(len(self.row)) - np.repeat(np.cumsum(count) - count, count)
        self.ends = number + 1 == count[self.row]
        share = (number + 1) / count[self.row]
        k, x = self.row, share[:, None]
        self.tip = blocks['tip'][before[k]] + x * program.chord[k]
        angle = (share * program.turn[k])[:, None]
        axis = program.axis[k] * np.cos(angle) + program.sideways[k] * np.sin(angle)
        at = coordinates[0, k] + x * coordinates[1, k]
        self.rotary_start = (at - coordinates[1, k] / count[k][:, None])[:, 3:5]
        self.rotary = at[:, 3:5]
        turned = self.worded[k]
        if turned.any():
            axis[turned] = transform.tool_axis(at[turned, 3:5])
        if lines is not None:
            beside = linear[k] & ~lines.in_axes[k]
            self.tip[beside] = at[beside, :3]
            in_axes = linear[k] & lines.in_axes[k]
            self.tip[in_axes], axis[in_axes] = transform.forward(at[in_axes])
        first = ~turned & self.ends
        self.tip[first], axis[first] = blocks['tip'][k[first]], blocks['axis'][k[first]]
        self.top = self.tip + height * axis
        self.first_tip = blocks['tip'][0]
        self.first_top = blocks['tip'][0] + height * blocks['axis'][0]
        self.share = share

    def pieces(self, end: FloatArray, name: str, vertex: FloatArray) -> Pieces:
        """Return the pieces of tip or top, with a tolerance of the rows and of the vertices."""
        first = self.first_tip if end is self.tip else self.first_top
        own = ROOM * np.maximum(self.blocks[name], vertex)[self.row]
        at_end = np.where(self.ends, vertex[self.row], own)
        wide = np.ones(3)
        vertices = np.vstack([first, end])
        return Pieces(
            self.row, vertices[:-1], end, own[:, None] * wide, vertices,
            np.append(vertex[0], at_end)[:, None] * wide,
        )  # fmt: skip

    def joint_pieces(self, vertex: FloatArray, top: FloatArray) -> Pieces:
        """Return the pieces in tip, rotary and extra axes; the rotary ones at flank height."""
        k, extra = self.row, self.blocks['extra_axes']
        tips = self.pieces(self.tip, 'contour_tolerance', vertex)
        start, end = [tips.start], [tips.end]
        contour = JOINT_ROOM / ROOM * tips.room
        room = [contour]
        if self.has_rotary:
            angle = JOINT_ROOM / self.height * np.maximum(top[k], top[k - 1])
            angle = np.repeat(np.where(self.worded[k], angle, np.inf)[:, None], 2, axis=1)
            start.append(np.where(self.worded[k][:, None], self.rotary_start, 0.0))
            end.append(np.where(self.worded[k][:, None], self.rotary, 0.0))
            room.append(angle)
        if extra.shape[1]:
            way = extra[k] - extra[k - 1]
            parts = np.bincount(k)[k][:, None]
            end.append(extra[k - 1] + self.share[:, None] * way)
            start.append(end[-1] - way / parts)
            room.append(np.repeat(contour[:, :1], extra.shape[1], axis=1))
        starts, ends, rooms = (np.hstack(columns) for columns in (start, end, room))
        return Pieces(
            k, starts, ends, rooms, np.vstack([starts[:1], ends]), np.vstack([rooms[:1], rooms])
        )


@njit(cache=True, nogil=True)
def _near(
    p: FloatArray, a: FloatArray, d: FloatArray, room: FloatArray, radius: float
) -> tuple[float, float]:
    """
    Return the part of the line a + x d that is near p, 1 and 0 where there is none.

    Near is within ``radius`` when the coordinates are counted in ``room``.
    """
    length_sq, along = 0.0, 0.0
    for c in range(len(p)):
        step = d[c] / room[c]
        length_sq += step * step
        along += (p[c] - a[c]) / room[c] * step
    foot = along / length_sq if length_sq > 0.0 else 0.0
    rest = radius * radius
    for c in range(len(p)):
        rest -= ((p[c] - a[c] - foot * d[c]) / room[c]) ** 2
    if rest < 0.0:
        return 1.0, 0.0
    if length_sq == 0.0:
        return 0.0, 1.0
    half = np.sqrt(rest / length_sq)
    low, high = max(0.0, foot - half), min(1.0, foot + half)
    if low > high:
        return 1.0, 0.0
    return low, high


@njit(cache=True, nogil=True)
def _follow(
    points: FloatArray, bulge: FloatArray, start: FloatArray, way: FloatArray, room: FloatArray,
    end: FloatArray, end_room: FloatArray,
) -> tuple[IntArray, IntArray, int]:  # fmt: skip
    """
    Reach the pieces from sample to sample; the results are those of `Pieces.followed`.

    ``low[k]`` is the least part of piece k that can be reached at the present sample, infinite if
    none. ``passed`` is the earliest part of the present chord of the motion at which the end of
    the piece before can be reached. Cells of chord and piece are convex, so nothing else counts.
    """
    samples, count = len(points), len(start)
    first = np.full(samples, -1, dtype=np.int64)
    last = np.full(samples, -1, dtype=np.int64)
    low = np.full(count, np.inf)
    low[0] = 0.0
    begin, stop, furthest = 0, 1, 0  # pieces begin ... stop - 1 may have been reached
    chord = np.zeros(points.shape[1])
    for i in range(samples):
        before = points[max(i - 1, 0)]
        for c in range(len(chord)):
            chord[c] = points[i, c] - before[c]
        passed, done = np.inf, False
        k, new_begin, new_stop = begin, -1, -1
        while k < count and (k < stop or passed < np.inf):
            old = low[k] if k < stop else np.inf
            low[k] = np.inf
            leaves = np.inf
            if old < np.inf or passed < np.inf:
                a, b = _near(points[i], start[k], way[k], room[k], 1.0)
                entry = a if passed < np.inf else max(old, a)
                if a <= b and entry <= b:
                    low[k] = entry
                    if new_begin < 0:
                        new_begin = k
                    new_stop = k + 1
                    done = k == count - 1 and b >= 1.0
                left, right = 0.0, 0.0
                for c in range(len(chord)):
                    left += (bulge[max(i - 1, 0), c] / end_room[k, c]) ** 2
                    right += (bulge[i, c] / end_room[k, c]) ** 2
                radius = 1.0 + np.sqrt(max(left, right))
                a, b = _near(end[k], before, chord, end_room[k], radius)
                entry = a if old < np.inf else max(passed, a)
                if a <= b and entry <= b:
                    leaves = entry
                    furthest = max(furthest, min(k + 1, count - 1))
            passed = leaves
            k += 1
        if new_begin < 0:
            return first, last, furthest
        begin, stop = new_begin, new_stop
        first[i], last[i] = begin, stop - 1
        if i == samples - 1 and done:
            furthest = count
    return first, last, furthest
