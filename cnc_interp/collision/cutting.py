"""Pass a tool over a field of the stock in a piece of motion: cut material, or look for contact.

Each block of lines stores its lowest and highest material, so blocks that a slab cannot meet are
skipped. A line is also skipped if it has no material near a cylinder around the slab.
"""

from __future__ import annotations

from math import ceil, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.collision.mill_sweep import BALL, FAR, R0, R1, Z0, Z1, strips_of, swept
from cnc_interp.collision.motions import AXIS, LEFT, MOVE, TIP, TOOL, TURN
from cnc_interp.collision.stock import BLOCK, STEEP, Field, note_span, roomy
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: What a pass over a field does: CUT removes material, and FIND marks the blocks that the tool may
#: meet. MEET returns the first length of material met on a line, MOST the greatest one.
CUT, FIND, MEET, MOST = 0, 1, 2, 3


class Mills(NamedTuple):
    """The slabs of several tools."""

    slabs: FloatArray  #: (n, SLAB).
    first: IntArray  #: Index of the first slab of each tool number; the last entry is the total.


@njit(cache=True, nogil=True, inline='always')
def of_tool(mills: Mills, tool: int) -> FloatArray:
    """Return the slabs of a tool."""
    return mills.slabs[mills.first[tool] : mills.first[tool + 1]]


@njit(cache=True, nogil=True)
def _remove(ends: FloatArray, used: IntArray, i: int, j: int, low: float, high: float) -> float:
    """Remove an interval from a line; return the material removed [m], -1 if the line is full."""
    count, kept, removed = used[i, j], 0, 0.0
    for k in range(count):
        begin, end = ends[i, j, k, 0], ends[i, j, k, 1]
        if begin < low and end > high:
            if count == ends.shape[2]:
                return -1.0
            for m in range(count, k, -1):
                ends[i, j, m, 0], ends[i, j, m, 1] = ends[i, j, m - 1, 0], ends[i, j, m - 1, 1]
            ends[i, j, k, 1], ends[i, j, k + 1, 0] = low, high
            used[i, j] = count + 1
            return high - low
        if begin < high and end > low:
            removed += min(end, high) - max(begin, low)
            if begin >= low:
                begin = high
            else:
                end = low
        if begin < end:
            ends[i, j, kept, 0], ends[i, j, kept, 1] = begin, end
            kept += 1
    used[i, j] = kept
    return removed


@njit(cache=True, nogil=True)
def overlap(ends: FloatArray, used: IntArray, i: int, j: int, low: float, high: float) -> float:
    """Return the length of material of a line within an interval [m]."""
    found = 0.0
    for k in range(used[i, j]):
        found += max(min(high, ends[i, j, k, 1]) - max(low, ends[i, j, k, 0]), 0.0)
    return found


@njit(cache=True, nogil=True, inline='always')
def _extent(
    k: int,
    slab: tuple[float, float, float, float],
    c: tuple[float, float, float],
    a: tuple[float, float, float],
    v: tuple[float, float, float],
) -> tuple[float, float]:
    """Return the least and the greatest coordinate of a moving slab [m]."""
    side = 1.0 if slab[0] else sqrt(max(1.0 - a[k] * a[k], 0.0))
    top = c[k] + slab[3] * a[k]
    low = min(c[k] - slab[1] * side, top - slab[2] * side) - abs(v[k])
    return low, max(c[k] + slab[1] * side, top + slab[2] * side) + abs(v[k])


@njit(cache=True, nogil=True)
def _pass_slab(
    field: Field,
    slab: tuple[float, float, float, float],
    c: tuple[float, float, float],
    a: tuple[float, float, float],
    v: tuple[float, float, float],
    number: int,
    act: int,
) -> float:
    """Pass a slab over the lines of a field; return the length that ``act`` defines [m]."""
    ball, r0, r1, height = slab
    least_u, most_u = _extent(0, slab, c, a, v)
    least_v, most_v = _extent(1, slab, c, a, v)
    low, high = _extent(2, slab, c, a, v)
    low_u, low_v, pitch = field.place
    i0 = max(int(np.floor((least_u - low_u) / pitch)), 0)
    i1 = min(int(np.floor((most_u - low_u) / pitch)), field.used.shape[0] - 1)
    j0 = max(int(np.floor((least_v - low_v) / pitch)), 0)
    j1 = min(int(np.floor((most_v - low_v) / pitch)), field.used.shape[1] - 1)
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
    # A cylinder around a tilted slab meets a line near a height that is linear in u and v.
    wide, lean = max(r0, r1), sqrt(a[0] * a[0] + a[1] * a[1])
    tilted = lean > STEEP and ball < 0.5
    fore, beside = (a[0] / lean, a[1] / lean) if tilted else (0.0, 0.0), 0.0
    sideways = abs(v[1] * fore[0] - v[0] * fore[1])
    lifted = abs(lean * v[2] - a[2] * (v[0] * fore[0] + v[1] * fore[1]))
    total, strips = 0.0, strips_of(a, slab, v)
    ends, used, span, done, wanted = field.ends, field.used, field.span, field.done, field.wanted
    shift_u, shift_v, full = field.shift_u, field.shift_v, field.full
    reach = 0.5 * BLOCK * pitch * (abs(nu) + abs(nv))
    for bi in range(i0 // BLOCK, i1 // BLOCK + 1):
        for bj in range(j0 // BLOCK, j1 // BLOCK + 1):
            if span[bi, bj, 0] >= high or span[bi, bj, 1] <= low:
                continue
            if act == CUT and not (wanted[bi, bj] and done[bi, bj] <= number):
                continue
            middle = nu * (low_u + (bi + 0.5) * BLOCK * pitch)
            middle += nv * (low_v + (bj + 0.5) * BLOCK * pitch)
            if middle + reach < least or middle - reach > most:
                continue
            if act == FIND:
                wanted[bi, bj] = 1
                continue
            removed = 0.0
            for i in range(max(i0, bi * BLOCK), min(i1, bi * BLOCK + BLOCK - 1) + 1):
                for j in range(max(j0, bj * BLOCK), min(j1, bj * BLOCK + BLOCK - 1) + 1):
                    du = low_u + (i + shift_u[j]) * pitch - c[0]
                    dv = low_v + (j + shift_v[i]) * pitch - c[1]
                    begin, end = low, high
                    if tilted:
                        beside = max(abs(dv * fore[0] - du * fore[1]) - sideways, 0.0)
                        if beside >= wide:
                            continue
                        half = (sqrt(wide * wide - beside * beside) + lifted) / lean
                        at = c[2] + a[2] * (du * fore[0] + dv * fore[1]) / lean
                        begin, end = max(low, at - half), min(high, at + half)
                    if overlap(ends, used, i, j, begin, end) == 0.0:
                        continue
                    at = (du + c[0]) * nu + (dv + c[1]) * nv
                    if at < least or at > most:
                        continue
                    begin, end = swept(du, dv, a, slab, v, strips)
                    begin, end = begin + c[2], end + c[2]
                    if begin >= end:
                        continue
                    if act == CUT:
                        length = _remove(ends, used, i, j, begin, end)
                        if length < 0.0:
                            full[0] = 1
                        removed += max(length, 0.0)
                        continue
                    total = max(total, overlap(ends, used, i, j, begin, end))
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
    number: int,
    act: int,
) -> tuple[float, int]:
    """Pass slabs over the lines of a field in a piece of motion ``row``, given in u, v and w.

    ``step``: a slab is divided if turning moves its ends farther than this from its translation
    [m]. With 0, slabs are not divided; they are grown by their largest deviation instead.
    ``number``: index of the piece; CUT skips blocks that this piece has already cut.
    Returns the length that ``act`` defines, for CUT its sum over all lines [m], and its slab.
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
            found = _pass_slab(field, shape, c, a, v, number, act)
            if act == CUT:
                total += found
            elif found > total:
                total, which = found, k
                if act == MEET:
                    return total, which
    return total, which


@njit(cache=True, nogil=True)
def freshen(field: Field, mills: Mills, rows: FloatArray, step: float) -> None:
    """Cut the blocks marked as wanted with all pieces of motion so far, (n, MOTION)."""
    low_u, low_v, pitch = field.place
    box, first = (field.done.shape[0], -1, field.done.shape[1], -1), len(rows)
    for bi in range(field.done.shape[0]):
        for bj in range(field.done.shape[1]):
            if field.wanted[bi, bj]:
                box = min(box[0], bi), max(box[1], bi), min(box[2], bj), max(box[3], bj)
                first = min(first, field.done[bi, bj])
    size = BLOCK * pitch
    middle = low_u + 0.5 * (box[0] + box[1] + 1) * size, low_v + 0.5 * (box[2] + box[3] + 1) * size
    room = 0.5 * (box[1] - box[0] + 1) * size, 0.5 * (box[3] - box[2] + 1) * size
    for k in range(first, len(rows)):
        slabs = of_tool(mills, int(rows[k, TOOL]))
        if len(slabs) and not _beside(rows[k], slabs, middle, room):
            pass_over(field, slabs, rows[k], step, k, CUT)
            if field.full[0]:
                return
    for bi in range(box[0], box[1] + 1):
        for bj in range(box[2], box[3] + 1):
            if field.wanted[bi, bj]:
                field.done[bi, bj], field.wanted[bi, bj] = len(rows), 0


@njit(cache=True, nogil=True)
def _beside(
    row: FloatArray, slabs: FloatArray, middle: tuple[float, float], room: tuple[float, float]
) -> bool:
    """Return whether a tool surely misses a rectangle: its middle, and half its sides [m]."""
    low, high, wide = slabs[0, Z0], slabs[-1, Z1], slabs[:, R1].max()
    for k in range(2):
        at = middle[k] - row[TIP + k]
        one, other = low * row[AXIS + k], high * row[AXIS + k]
        reach = wide + room[k] + abs(row[MOVE + k]) + high * abs(row[TURN + k])
        if at < min(one, other) - reach or at > max(one, other) + reach:
            return True
    return False


def in_field(field: Field, rows: FloatArray) -> FloatArray:
    """Return pieces of motion with their vectors in the coordinates u, v, w of a field."""
    turned = rows.copy()
    for first in (TIP, AXIS, MOVE, TURN):
        turned[:, first : first + 3] = np.roll(rows[:, first : first + 3], 2 - field.axis, axis=1)
    return turned


def cut_by(field: Field, rows: FloatArray, mills: Mills, step: float) -> Field:
    """Cut a field with pieces of motion, (n, MOTION); return it, enlarged if lines were full."""
    field.wanted[:] = 1
    return roomy(field, freshen, mills, in_field(field, rows), step)
