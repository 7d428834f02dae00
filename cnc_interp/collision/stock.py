"""The stock: material on parallel lines, cut by what the mill sweeps.

A field has lines along one axis w of the stock's frame, one in each cell of a square grid over the
other two, u and v, and on each line the intervals of material. Their ends are exact; only what
lies between the lines is not known. In a field for volumes, lines are shifted within their cells
by multiples of an irrational number. So a wall along the grid does not fall between the same two
lines everywhere, and volumes are right to a fraction of what the width of a cell would suggest.

Blocks of lines know their lowest and highest material, so that a slab skips those that it cannot
meet.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import Any, NamedTuple

import numpy as np

from cnc_interp.collision.clearance import grown_rows
from cnc_interp.collision.drawing import surface
from cnc_interp.collision.mesh_file import SceneError
from cnc_interp.collision.mill_sweep import (
    BALL,
    FAR,
    R0,
    R1,
    Z0,
    Z1,
    strips_of,
    swept,
)
from cnc_interp.collision.scene import Body
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

BLOCK = 8  #: Lines of a block in each direction; blocks without material are skipped.
AROUND = 360  #: Points on the rim of a round stock.
CAPACITY = 4  #: Intervals of a line for which there is room at first.
SHIFTS = 0.6180339887498949, 0.7548776662466927  #: Of lines within their cells, times their row.
STEEP = 1e-3  #: Component of a normal below which a triangle nearly follows the lines [-].
ASIDE = 1.3e-9  #: Lines of a mesh lie so far beside the grid, off edges that follow it [m].
#: Columns of a piece of motion. In its middle, in the frame of the stock: tip and axis of the
#: tool; how far the tip moves to either side, and how the axis turns. Path length at both ends
#: [m]; by how much points of the tool may leave that motion [m]; the tool; what it removed [m3].
TIP, AXIS, MOVE, TURN, BEGIN, END, LEFT, TOOL, REMOVED, MOTION = 0, 3, 6, 9, 12, 13, 14, 15, 16, 17
#: What passing a tool over a field does: cut it; find the blocks that it may meet; return the
#: length of the first material that it meets on a line, or the greatest one.
CUT, FIND, MEET, MOST = 0, 1, 2, 3


class Field(NamedTuple):
    axis: int  #: Axis w of the stock's frame along which the lines run; u and v follow it.
    place: FloatArray  #: (3,): Lowest u and v, and width of a cell [m].
    shift_u: FloatArray  #: (n_v,): How far lines are shifted along u in their cells [-].
    shift_v: FloatArray  #: (n_u,): The same along v.
    used: IntArray  #: (n_u, n_v): Number of intervals of each line.
    ends: FloatArray  #: (n_u, n_v, capacity, 2): Where they begin and end along w [m].
    span: FloatArray  #: (blocks_u, blocks_v, 2): Lowest and highest material of each block [m].
    done: IntArray  #: (blocks_u, blocks_v): Number of pieces of motion that have cut each block.
    wanted: IntArray  #: (blocks_u, blocks_v): 1 of blocks that must be cut by all pieces so far.
    full: IntArray  #: (1,): 1 if a line had no room for a further interval, and was left uncut.


class Mills(NamedTuple):
    """The slabs of several tools."""

    slabs: FloatArray  #: (n, SLAB).
    first: IntArray  #: First slab of each tool, by its number, and how many there are.


@njit(cache=True, nogil=True, inline='always')
def of_tool(mills: Mills, tool: int) -> FloatArray:
    """Return the slabs of a tool."""
    return mills.slabs[mills.first[tool] : mills.first[tool + 1]]


def field_of(body: Body, axis: int, pitch: float, shifted: bool, grown: float = 0.0) -> Field:
    """Return the field of a body, which may be grown by so much [m]."""
    low, high = body.bounds()
    u, v = (axis + 1) % 3, (axis + 2) % 3
    size = [int(np.ceil((high[k] - low[k] + 2.0 * grown) / pitch)) for k in (u, v)]
    middle = 0.5 * (low + high)
    start = [middle[k] - 0.5 * n * pitch for k, n in zip((u, v), size, strict=True)]
    blocks = [-(-n // BLOCK) for n in size]
    shift_v, shift_u = (
        np.arange(n) * share % 1.0 if shifted else np.full(n, 0.5)
        for n, share in zip(size, reversed(SHIFTS), strict=True)
    )
    field = Field(
        axis,
        np.array([*start, pitch]),
        shift_u,
        shift_v,
        np.zeros(size, dtype=np.int64),
        np.zeros((*size, CAPACITY, 2)),
        np.zeros((*blocks, 2)),
        np.zeros(blocks, dtype=np.int64),
        np.zeros(blocks, dtype=np.int64),
        np.zeros(1, dtype=np.int64),
    )
    closed = [body.triangles] if body.triangles is not None else []
    for triangles in closed or [surface(piece, AROUND) for piece in body.pieces]:
        corners = np.ascontiguousarray(triangles[:, :, [u, v, axis]])
        who, ends = crossings(field.place, lines(field), corners, 0.0)
        order = np.lexsort((ends[:, 0], who[:, 0]))
        line, height = who[order, 0], ends[order, 0]
        if len(line) % 2 or (line[::2] != line[1::2]).any():
            raise SceneError(f'{body.name}: a line crosses its surface once; repair the mesh')
        field = roomy(field, add, line[::2], np.column_stack([height[::2], height[1::2]]))
        if grown:
            who, ends = crossings(field.place, lines(field), corners, grown)
            field = roomy(field, add, who[:, 0], ends)
    for i, j in np.ndindex(*field.done.shape):
        note_span(field, i, j)
    return field


def lines(field: Field) -> FloatArray:
    """Return where the lines cross u and v, (n_u, n_v, 2) [m]."""
    i, j = np.indices(field.used.shape)
    low_u, low_v, pitch = field.place
    u, v = low_u + (i + field.shift_u) * pitch, low_v + (j + field.shift_v[:, None]) * pitch
    return np.stack([u, v], axis=-1)


def volume(field: Field) -> float:
    """Return the volume of the material of a field [m3]."""
    there = np.arange(field.ends.shape[2]) < field.used[..., None]
    return float(np.diff(field.ends[there]).sum() * field.place[2] ** 2)


def roomier(field: Field) -> Field:
    """Return the field with room for twice as many intervals, if a line of it is full."""
    if not field.full[0]:
        return field
    field.full[0] = 0
    return field._replace(ends=np.concatenate([field.ends, field.ends], axis=2))


def roomy(field: Field, act: Any, *given: Any) -> Field:
    """Do something to a field until no line of it is full; return it with the room for that."""
    act(field, *given)
    while field.full[0]:
        field = roomier(field)
        act(field, *given)
    return field


@njit(cache=True, nogil=True, inline='always')
def _near(corners: FloatArray, k: int, low: float, pitch: float, room: float, n: int) -> range:
    """Return the rows of lines that a triangle may meet within some room, along u or v."""
    first = int((corners[:, k].min() - room - low) / pitch) - 1
    last = int((corners[:, k].max() + room - low) / pitch) + 1
    return range(max(first, 0), min(last, n - 1) + 1)


@njit(cache=True, nogil=True)
def crossings(
    place: FloatArray, at: FloatArray, corners: FloatArray, room: float
) -> tuple[IntArray, FloatArray]:
    """Return where lines cross triangles, (m, 3, 3), or come nearer to them than ``room``.

    Rows are numbers of line and triangle, and begin and end along w of what is so near [m].
    """
    who, ends, found = np.empty((1024, 2), np.int64), np.empty((1024, 2)), 0
    edge = np.empty((3, 5))
    for t in range(len(corners)):
        p = corners[t]
        n = np.cross(p[1] - p[0], p[2] - p[0])
        size, sense = sqrt((n * n).sum()), np.sign(n[2])
        if room == 0.0 and sense == 0.0:
            continue
        for k in range(3):
            # From the same corner for both triangles of an edge, to the same rounding.
            a, b, turn = p[k], p[(k + 1) % 3], sense
            if a[0] > b[0] or (a[0] == b[0] and a[1] > b[1]):
                a, b, turn = b, a, -sense
            edge[k, :2] = a[:2]
            edge[k, 2:4] = turn * (b[:2] - a[:2]) if sense != 0.0 else b[:2] - a[:2]
            edge[k, 4] = room * sqrt((edge[k, 2:4] ** 2).sum())
        for i in _near(p, 0, place[0], place[2], room, at.shape[0]):
            for j in _near(p, 1, place[1], place[2], room, at.shape[1]):
                x, y, k = at[i, j, 0] + ASIDE, at[i, j, 1] + 0.7 * ASIDE, 0
                while k < 3:
                    out = edge[k, 3] * (x - edge[k, 0]) - edge[k, 2] * (y - edge[k, 1])
                    if max(out, -out if sense == 0.0 else out) > edge[k, 4]:
                        break
                    k += 1
                if k < 3:
                    continue
                low, high = p[:, 2].min() - room, p[:, 2].max() + room
                if room == 0.0 or abs(n[2]) > STEEP * size:
                    middle = p[0, 2] - (n[0] * (x - p[0, 0]) + n[1] * (y - p[0, 1])) / n[2]
                    half = room * size / abs(n[2])
                    low, high = max(low, middle - half), min(high, middle + half)
                who, ends = grown_rows(who, found), grown_rows(ends, found)
                who[found, 0], who[found, 1] = i * at.shape[1] + j, t
                ends[found, 0], ends[found, 1] = low, high
                found += 1
    return who[:found], ends[:found]


@njit(cache=True, nogil=True)
def add(field: Field, line: IntArray, ends: FloatArray) -> None:
    """Unite lines with intervals, (n, 2); those that do not end after they begin are empty."""
    for k in range(len(line)):
        if ends[k, 0] < ends[k, 1]:
            i, j = divmod(line[k], field.used.shape[1])
            _insert(field, i, j, ends[k, 0], ends[k, 1])


@njit(cache=True, nogil=True)
def _insert(field: Field, i: int, j: int, low: float, high: float) -> None:
    """Add an interval to a line, united with all that it meets."""
    ends, count, kept = field.ends[i, j], field.used[i, j], 0
    for k in range(count):
        if ends[k, 1] < low - ASIDE or ends[k, 0] > high + ASIDE:
            ends[kept] = ends[k]
            kept += 1
        else:
            low, high = min(low, ends[k, 0]), max(high, ends[k, 1])
    if kept == len(ends):
        field.full[0] = 1
        return
    k = kept
    while k > 0 and ends[k - 1, 0] > low:
        ends[k] = ends[k - 1]
        k -= 1
    ends[k, 0], ends[k, 1] = low, high
    field.used[i, j] = kept + 1


@njit(cache=True, nogil=True)
def _remove(field: Field, i: int, j: int, low: float, high: float) -> float:
    """Take an interval out of a line and return how much material was in it [m]."""
    ends, count, kept, removed = field.ends[i, j], field.used[i, j], 0, 0.0
    for k in range(count):
        begin, end = ends[k, 0], ends[k, 1]
        if begin < low and end > high:
            if count == len(ends):
                field.full[0] = 1
                return 0.0
            for m in range(count, k, -1):
                ends[m] = ends[m - 1]
            ends[k, 1], ends[k + 1, 0] = low, high
            field.used[i, j] = count + 1
            return high - low
        if begin < high and end > low:
            removed += min(end, high) - max(begin, low)
            if begin >= low:
                begin = high
            else:
                end = low
        if begin < end:
            ends[kept, 0], ends[kept, 1] = begin, end
            kept += 1
    field.used[i, j] = kept
    return removed


@njit(cache=True, nogil=True)
def overlap(field: Field, i: int, j: int, low: float, high: float) -> float:
    """Return how much material of a line is in an interval [m]."""
    found = 0.0
    for k in range(field.used[i, j]):
        found += max(min(high, field.ends[i, j, k, 1]) - max(low, field.ends[i, j, k, 0]), 0.0)
    return found


@njit(cache=True, nogil=True)
def note_span(field: Field, block_u: int, block_v: int) -> None:
    """Find the lowest and the highest material of a block."""
    low, high = FAR, -FAR
    for i in range(BLOCK * block_u, min(BLOCK * block_u + BLOCK, field.used.shape[0])):
        for j in range(BLOCK * block_v, min(BLOCK * block_v + BLOCK, field.used.shape[1])):
            count = field.used[i, j]
            if count:
                low = min(low, field.ends[i, j, 0, 0])
                high = max(high, field.ends[i, j, count - 1, 1])
    field.span[block_u, block_v, 0], field.span[block_u, block_v, 1] = low, high


@njit(cache=True, nogil=True)
def _pass_slab(
    field: Field,
    slab: tuple[float, float, float, float],
    c: tuple[float, float, float],
    a: tuple[float, float, float],
    v: tuple[float, float, float],
    window: tuple[int, int, int, int],
    act: int,
) -> float:
    """Pass a slab over the lines of a window; return the length that ``act`` is about [m]."""
    ball, r0, r1, height = slab
    low, high = np.empty(3), np.empty(3)
    for k in range(3):
        side = 1.0 if ball else sqrt(max(1.0 - a[k] * a[k], 0.0))
        top = c[k] + height * a[k]
        low[k] = min(c[k] - r0 * side, top - r1 * side) - abs(v[k])
        high[k] = max(c[k] + r0 * side, top + r1 * side) + abs(v[k])
    low_u, low_v, pitch = field.place
    i0 = max(int(np.floor((low[0] - low_u) / pitch)), window[0])
    i1 = min(int(np.floor((high[0] - low_u) / pitch)), window[1] - 1)
    j0 = max(int(np.floor((low[1] - low_v) / pitch)), window[2])
    j1 = min(int(np.floor((high[1] - low_v) / pitch)), window[3] - 1)
    if i0 > i1 or j0 > j1:
        return 0.0
    # Across the motion, seen along w, the slab stays within a strip.
    across, nu, nv, least, most = sqrt(v[0] * v[0] + v[1] * v[1]), 0.0, 0.0, -FAR, FAR
    if across > 0.0:
        nu, nv = -v[1] / across, v[0] / across
        tilt = a[0] * nu + a[1] * nv
        side = 1.0 if ball else sqrt(max(1.0 - tilt * tilt, 0.0))
        base = c[0] * nu + c[1] * nv
        least = min(base - r0 * side, base + height * tilt - r1 * side)
        most = max(base + r0 * side, base + height * tilt + r1 * side)
    strips = np.empty((2, 8))
    total, count = 0.0, strips_of(a, slab, v, strips)
    reach = 0.5 * BLOCK * pitch * (abs(nu) + abs(nv))
    for bi in range(i0 // BLOCK, i1 // BLOCK + 1):
        for bj in range(j0 // BLOCK, j1 // BLOCK + 1):
            if field.span[bi, bj, 0] >= high[2] or field.span[bi, bj, 1] <= low[2]:
                continue
            middle = nu * (low_u + (bi + 0.5) * BLOCK * pitch)
            middle += nv * (low_v + (bj + 0.5) * BLOCK * pitch)
            if middle + reach < least or middle - reach > most:
                continue
            if act == FIND:
                field.wanted[bi, bj] = 1
                continue
            removed = 0.0
            for i in range(max(i0, bi * BLOCK), min(i1, bi * BLOCK + BLOCK - 1) + 1):
                for j in range(max(j0, bj * BLOCK), min(j1, bj * BLOCK + BLOCK - 1) + 1):
                    pu = low_u + (i + field.shift_u[j]) * pitch
                    pv = low_v + (j + field.shift_v[i]) * pitch
                    at = pu * nu + pv * nv
                    if at < least or at > most:
                        continue
                    if overlap(field, i, j, low[2], high[2]) == 0.0:
                        continue
                    begin, end = swept(pu - c[0], pv - c[1], a, slab, v, strips, count)
                    begin, end = begin + c[2], end + c[2]
                    if begin >= end:
                        continue
                    if act == CUT:
                        removed += _remove(field, i, j, begin, end)
                        continue
                    total = max(total, overlap(field, i, j, begin, end))
                    if act == MEET and total > 0.0:
                        return total
            if removed > 0.0:
                total += removed
                note_span(field, bi, bj)
    return total


@njit(cache=True, nogil=True)
def pass_over(
    field: Field,
    slabs: FloatArray,
    row: FloatArray,
    step: float,
    window: tuple[int, int, int, int],
    act: int,
) -> tuple[float, int]:
    """Pass slabs over the lines of a window in a piece of motion, in u, v and w.

    ``step``: how far the ends of a slab may turn away from its translation, or else the slab is
    divided [m]; 0: slabs are not divided, but grown by all that they may leave of their motion.
    Returns the length that ``act`` is about, summed up when cutting [m], and the slab it is of.
    """
    total, which = 0.0, -1
    a0, a1, a2 = row[AXIS], row[AXIS + 1], row[AXIS + 2]
    size = sqrt(a0 * a0 + a1 * a1 + a2 * a2)
    a = a0 / size, a1 / size, a2 / size
    t = row[TURN], row[TURN + 1], row[TURN + 2]
    turn = sqrt(t[0] * t[0] + t[1] * t[1] + t[2] * t[2])
    for k in range(len(slabs)):
        slab, parts, grown, wide = slabs[k], 1, 0.0, 0.0
        height = slab[Z1] - slab[Z0]
        if step > 0.0:
            parts = max(1, ceil(0.5 * turn * height / step))
        else:
            grown = row[LEFT] + turn * (0.5 * height + max(slab[R0], slab[R1]))
            wide = grown * (1.0 + 2.0 * abs(slab[R1] - slab[R0]) / height)
        height /= parts
        for n in range(parts):
            z0 = slab[Z0] + n * height - grown
            r0 = slab[R0] + n * (slab[R1] - slab[R0]) / parts
            r1 = r0 + (slab[R1] - slab[R0]) / parts
            at = z0 + 0.5 * height + grown
            c = row[TIP] + z0 * a[0], row[TIP + 1] + z0 * a[1], row[TIP + 2] + z0 * a[2]
            v = row[MOVE] + at * t[0], row[MOVE + 1] + at * t[1], row[MOVE + 2] + at * t[2]
            shape = slab[BALL], r0 + wide, r1 + wide, height + 2.0 * grown
            found = _pass_slab(field, shape, c, a, v, window, act)
            if act == CUT:
                total += found
            elif found > total:
                total, which = found, k
                if act == MEET:
                    return total, which
    return total, which


@njit(cache=True, nogil=True)
def freshen(field: Field, mills: Mills, rows: FloatArray, step: float) -> None:
    """Cut the blocks that are wanted by all pieces of motion so far, (n, MOTION)."""
    n_u, n_v = field.used.shape
    low_u, low_v, pitch = field.place
    for bi in range(field.done.shape[0]):
        for bj in range(field.done.shape[1]):
            if not field.wanted[bi, bj]:
                continue
            i, j = bi * BLOCK, bj * BLOCK
            window = i, min(i + BLOCK, n_u), j, min(j + BLOCK, n_v)
            u, v = low_u + (i + 0.5 * BLOCK) * pitch, low_v + (j + 0.5 * BLOCK) * pitch
            for k in range(field.done[bi, bj], len(rows)):
                row = rows[k]
                slabs = of_tool(mills, int(row[TOOL]))
                at = u - row[TIP], v - row[TIP + 1]
                if len(slabs) == 0 or _beside(row, slabs, at, BLOCK * pitch):
                    continue
                pass_over(field, slabs, row, step, window, CUT)
                if field.full[0]:
                    return
            field.done[bi, bj], field.wanted[bi, bj] = len(rows), 0


@njit(cache=True, nogil=True)
def _beside(row: FloatArray, slabs: FloatArray, at: tuple[float, float], room: float) -> bool:
    """Tell whether a tool surely stays farther than ``room`` from a line, seen from its tip."""
    low, high, wide = slabs[0, Z0], slabs[-1, Z1], slabs[:, R1].max()
    for k in range(2):
        one, other = low * row[AXIS + k], high * row[AXIS + k]
        reach = wide + room + abs(row[MOVE + k]) + high * abs(row[TURN + k])
        if at[k] < min(one, other) - reach or at[k] > max(one, other) + reach:
            return True
    return False


def in_field(field: Field, rows: FloatArray) -> FloatArray:
    """Return pieces of motion in u, v and w of a field."""
    turned = rows.copy()
    for first in (TIP, AXIS, MOVE, TURN):
        turned[:, first : first + 3] = np.roll(rows[:, first : first + 3], 2 - field.axis, axis=1)
    return turned


def cut_by(field: Field, rows: FloatArray, mills: Mills, step: float) -> Field:
    """Cut a field by pieces of motion, (n, MOTION); return it with the room for that."""
    field.wanted[:] = 1
    return roomy(field, freshen, mills, in_field(field, rows), step)
