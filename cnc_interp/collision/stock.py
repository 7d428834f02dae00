"""The stock, as intervals of material on parallel lines.

The lines of a field run along one axis w of the stock's frame, one in each cell of a square grid
over u and v. Each line stores its intervals of material. Their ends are exact; only the material
between lines is unknown. In a field for volumes, lines are shifted within their cells by multiples
of an irrational number. A wall along the grid then does not fall between the same two lines
everywhere, so volumes are much more accurate than the cell width suggests.
"""

from __future__ import annotations

from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from cnc_interp.collision.clearance import grown_rows
from cnc_interp.collision.drawing import surface
from cnc_interp.collision.mesh_file import SceneError
from cnc_interp.collision.mill_sweep import (
    FAR,
)
from cnc_interp.collision.scene import Body
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

BLOCK = 8  #: Lines per block in each direction; blocks without material are skipped.
AROUND = 360  #: Points on the rim of a round stock.
CAPACITY = 4  #: Initial room for intervals on each line.
SHIFTS = 0.6180339887498949, 0.7548776662466927  #: Shifts of lines in their cells, per row [-].
#: A triangle whose normal has a smaller component along w nearly follows the lines [-].
STEEP = 1e-3
ASIDE = 1.3e-9  #: Offset of the lines of a mesh, so that none runs along an edge [m].


class Field(NamedTuple):
    axis: int  #: Axis w of the stock's frame along which the lines run; u and v follow it.
    place: FloatArray  #: (3,): Lowest u, lowest v, and width of a cell [m].
    shift_u: FloatArray  #: (n_v,): How far lines are shifted along u in their cells [-].
    shift_v: FloatArray  #: (n_u,): The same along v.
    used: IntArray  #: (n_u, n_v): Number of intervals of each line.
    ends: FloatArray  #: (n_u, n_v, capacity, 2): Their begins and ends along w [m].
    span: FloatArray  #: (blocks_u, blocks_v, 2): Lowest and highest material of each block [m].
    done: IntArray  #: (blocks_u, blocks_v): Number of pieces of motion that have cut each block.
    wanted: IntArray  #: (blocks_u, blocks_v): 1 if all pieces so far must still cut it.
    full: IntArray  #: (1,): 1 if a line had no room for another interval and was left uncut.


def field_of(body: Body, axis: int, pitch: float, shifted: bool, grown: float = 0.0) -> Field:
    """Return the field of a body, grown by ``grown`` [m]."""
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
    """Return the field, with room for twice as many intervals if one of its lines is full."""
    if not field.full[0]:
        return field
    field.full[0] = 0
    return field._replace(ends=np.concatenate([field.ends, field.ends], axis=2))


def roomy(field: Field, act: Any, *given: Any) -> Field:
    """Repeat an action on a field, doubling the room until no line is full; return the field."""
    act(field, *given)
    while field.full[0]:
        field = roomier(field)
        act(field, *given)
    return field


@njit(cache=True, nogil=True, inline='always')
def _near(corners: FloatArray, k: int, low: float, pitch: float, room: float, n: int) -> range:
    """Return the range of rows, along u or v, whose lines a triangle may meet or come near."""
    first = int((corners[:, k].min() - room - low) / pitch) - 1
    last = int((corners[:, k].max() + room - low) / pitch) + 1
    return range(max(first, 0), min(last, n - 1) + 1)


@njit(cache=True, nogil=True)
def crossings(
    place: FloatArray, at: FloatArray, corners: FloatArray, room: float
) -> tuple[IntArray, FloatArray]:
    """Return where lines cross triangles, (m, 3, 3), or come nearer to them than ``room``.

    Each row has the numbers of line and triangle, and begin and end of the near stretch [m].
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
    """Add intervals, (n, 2), to lines. An interval that ends before it begins is empty."""
    for k in range(len(line)):
        if ends[k, 0] < ends[k, 1]:
            i, j = divmod(line[k], field.used.shape[1])
            _insert(field, i, j, ends[k, 0], ends[k, 1])


@njit(cache=True, nogil=True)
def _insert(field: Field, i: int, j: int, low: float, high: float) -> None:
    """Add an interval to a line, and merge it with those that it overlaps."""
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
