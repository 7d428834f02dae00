"""Check that the motion follows the program in order: it passes every vertex exactly once.

Motion and program can be traversed together, neither going back, without exceeding the tolerance.
That is the Frechet distance of two polygons [Alt and Godau, Computing the Frechet distance between
two polygonal curves, 1995]. It is checked for the tip, the point at flank height, and named axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.proof.plan_files import Stored, held, spans
from cnc_interp.proof.program_shapes import ProgramShapes
from cnc_interp.proof.programmed_path import peaks

ROOM = 2.0  #: Largest accepted distance between vertices, in tolerances [-].
#: The same for tip, rotary and extra axes together; it also holds at vertices [-].
JOINT_ROOM = 3.0
CHORD_SHARE = 0.05  #: Largest distance of the chords of a circle from it, in tolerances [-].


@dataclass(frozen=True)
class Pieces:
    row: IntArray  #: (P,): Program row of each piece.
    #: (P, D): Coordinates at both ends of each piece.
    start: FloatArray
    end: FloatArray
    room: FloatArray  #: (P, D): Accepted distance along each piece; infinite if not compared.
    #: (P + 1, D): Coordinates of start and all ends, and the accepted distance there.
    vertex: FloatArray
    vertex_room: FloatArray

    def backwards(self) -> Pieces:
        return Pieces(
            self.row[::-1],
            self.end[::-1],
            self.start[::-1],
            self.room[::-1],
            self.vertex[::-1],
            self.vertex_room[::-1],
        )

    def pursuit(self) -> Pursuit:
        low = np.full(len(self.row), np.inf)
        low[0] = 0.0
        pieces = (
            self.start,
            self.end - self.start,
            self.room,
            self.vertex[1:],
            self.vertex_room[1:],
        )
        return Pursuit(tuple(np.ascontiguousarray(a) for a in pieces), low)


@dataclass
class Pursuit:
    #: Start, vector and accepted distance of the P pieces; place and accepted distance of their
    #: ends.
    pieces: tuple[FloatArray, ...]
    #: (P,): Smallest reachable part of each piece at the last sample, or infinite.
    low: FloatArray
    #: The pieces reachable at that sample are among [begin, stop).
    begin: int = 0
    stop: int = 1
    furthest: int = 0  #: Farthest piece reached so far; P at the end of the last one.
    lost: int = -1  #: First sample at which no piece can be reached, or -1.

    def follow(self, points: FloatArray, first: int, count: int) -> tuple[IntArray, IntArray]:
        """Advance by k samples; return the first and last piece each can have reached (-1: none).

        ``points`` (k + 3, D) also has two samples before and one after; end samples are repeated.
        """
        # The chord of the motion at a sample begins one before; no chord bulges beyond the ends.
        bulge, more = np.abs(np.diff(points, 2, axis=0)) / 8.0, peaks(points)
        bulge += np.maximum(np.vstack([more[:1], more]), np.vstack([more, more[-1:]]))
        if first == 0:
            bulge[:2] = 0.0
        last = first + len(points) - 3 == count
        if last:
            bulge[-1] = 0.0
        reached = np.full((2, len(points) - 3), -1, dtype=np.int64)
        if self.lost < 0:
            self.begin, self.stop, self.furthest, lost = _follow(
                np.ascontiguousarray(points[1:-1]),
                bulge,
                self.pieces,
                self.low,
                (self.begin, self.stop, self.furthest),
                last,
                reached,
            )
            self.lost = first + lost if lost >= 0 else -1
        return reached[0], reached[1]


@dataclass(frozen=True)
class Order:
    #: Quantities that leave the order, with the sample where, and the farthest program row
    #: reached.
    left: tuple[tuple[str, int, int], ...]
    #: (K,): First and last program row that each sample may execute; stored in temporary files.
    low: Stored
    high: Stored


def order_of(program: ProgramShapes, tolerances: tuple[FloatArray, FloatArray]) -> Order:
    plan, machine = program.plan, program.machine
    count, rows = len(plan.position), len(plan.blocks['tip'])
    shapes = _Shapes(program)

    def joint(position: FloatArray) -> FloatArray:
        rotary = position[:, 3 : 5 if machine.has_rotary else 3]
        extra = position[:, len(machine.axis_names) - len(machine.extra_names) :]
        return np.hstack([program.tips(position), rotary, extra])

    tip = shapes.pieces(shapes.tip, 'contour_tolerance', tolerances[0])
    top = shapes.pieces(shapes.top, 'orientation_tolerance', tolerances[1])
    courses = [('tool tip', program.tips, tip), ('point at flank height', program.tops, top)]
    if shapes.worded.any() or machine.extra_names:
        courses.append(('axes', joint, shapes.joint_pieces(*tolerances)))
    left, low, high = [], Stored.empty(count, np.int32), Stored.empty(count, np.int32)
    for a, b in spans(count):
        high[a:b] = np.full(b - a, rows - 1)
    for name, points_of, pieces in courses:
        # Forwards, then backwards: a row is possible if it can be reached from both ends.
        pursuit = pieces.pursuit()
        for a, b in spans(count):
            first, last = pursuit.follow(points_of(held(plan.position, a, b, 2, 1)), a, count)
            low[a:b] = np.maximum(low[a:b], pieces.row[first])
            high[a:b] = np.minimum(high[a:b], pieces.row[last])
        if pursuit.furthest < len(pieces.row):
            sample = pursuit.lost if pursuit.lost >= 0 else count - 1
            if pursuit.lost >= 0 or not plan.cut:
                left.append((name, sample, int(pieces.row[pursuit.furthest])))
            continue
        reverse = pieces.backwards()
        pursuit = reverse.pursuit()
        for a, b in reversed(list(spans(count))):
            points = points_of(held(plan.position, a, b, 1, 2))
            first, last = pursuit.follow(points[::-1], count - b, count)
            low[a:b] = np.maximum(low[a:b], reverse.row[last[::-1]])
            high[a:b] = np.minimum(high[a:b], reverse.row[first[::-1]])
    return Order(tuple(left), low, high)


class _Shapes:
    def __init__(self, shapes: ProgramShapes):
        plan, machine, program, lines = shapes.plan, shapes.machine, shapes.path, shapes.lines
        blocks, height = plan.blocks, plan.flank_height
        self.blocks, rows, self.has_rotary = blocks, len(blocks['tip']), machine.has_rotary
        self.extra_count = len(machine.extra_names)
        self.height, transform = height, shapes.transform
        tolerance = np.minimum(blocks['contour_tolerance'], blocks['orientation_tolerance'])
        room = 8.0 * CHORD_SHARE * np.maximum(tolerance, 1e-9)
        linear = np.zeros(rows, dtype=np.bool_) if lines is None else lines.linear
        self.worded = linear | program.by_axes
        before = np.r_[0, np.arange(rows - 1)]
        coordinates = np.zeros((2, rows, plan.position.shape[1]))  # at the start, and the way
        if self.worded.any():
            ruled = program.by_axes & ~linear
            coordinates[0, ruled, 3:5] = program.rotary_from[ruled]
            coordinates[1, ruled, 3:5] = (blocks['rotary'] - program.rotary_from)[ruled]
        if lines is not None:
            coordinates[0, linear], coordinates[1, linear] = (
                lines.start[linear],
                lines.step[linear],
            )
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
            self.row,
            vertices[:-1],
            end,
            own[:, None] * wide,
            vertices,
            np.append(vertex[0], at_end)[:, None] * wide,
        )

    def joint_pieces(self, vertex: FloatArray, top: FloatArray) -> Pieces:
        k, extra = self.row, self.blocks['extra_axes'][:, : self.extra_count]
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
    """Return the range of x in [0, 1] with a + x d within ``radius`` of p, in units of ``room``.

    It is (1, 0) if there is no such x.
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
    points: FloatArray,
    bulge: FloatArray,
    pieces: tuple[FloatArray, ...],
    low: FloatArray,
    pursuit: tuple[int, int, int],
    ends: bool,
    reached: IntArray,
) -> tuple[int, int, int, int]:
    """Update the reachable pieces from sample to sample, and return the new state of `Pursuit`.

    ``pieces``: as in `Pursuit`. ``passed`` is the earliest part of the present chord of the motion
    at which the end of the preceding piece can be reached. The free cell of a chord and a piece is
    convex, so this value is all that must be kept.
    """
    start, way, room, end, end_room = pieces
    begin, stop, furthest = pursuit
    samples, count = len(points) - 1, len(start)
    chord = np.zeros(points.shape[1])
    for i in range(samples):
        before, here = points[i], points[i + 1]
        for c in range(len(chord)):
            chord[c] = here[c] - before[c]
        passed, done = np.inf, False
        k, new_begin, new_stop = begin, -1, -1
        while k < count and (k < stop or passed < np.inf):
            old = low[k] if k < stop else np.inf
            low[k] = np.inf
            leaves = np.inf
            if old < np.inf or passed < np.inf:
                a, b = _near(here, start[k], way[k], room[k], 1.0)
                entry = a if passed < np.inf else max(old, a)
                if a <= b and entry <= b:
                    low[k] = entry
                    if new_begin < 0:
                        new_begin = k
                    new_stop = k + 1
                    done = k == count - 1 and b >= 1.0
                left, right = 0.0, 0.0
                for c in range(len(chord)):
                    left += (bulge[i, c] / end_room[k, c]) ** 2
                    right += (bulge[i + 1, c] / end_room[k, c]) ** 2
                radius = 1.0 + np.sqrt(max(left, right))
                a, b = _near(end[k], before, chord, end_room[k], radius)
                entry = a if old < np.inf else max(passed, a)
                if a <= b and entry <= b:
                    leaves = entry
                    furthest = max(furthest, min(k + 1, count - 1))
            passed = leaves
            k += 1
        if new_begin < 0:
            return begin, stop, furthest, i
        begin, stop = new_begin, new_stop
        reached[0, i], reached[1, i] = begin, stop - 1
        if ends and i == samples - 1 and done:
            furthest = count
    return begin, stop, furthest, -1
