"""Compiled loops of the N-buffer: where needles first enter the moving mill.

A group of needles is skipped only if the test of each of its needles would skip it too. So a
needle ends at the same height, bit for bit, in every tile.
"""

from math import sqrt
from typing import NamedTuple

from cnc_interp.core import MM, BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit

#: Depth at which needles begin below the surface, and height at which they end above it [m].
DEPTH, TOP = 2.0 * MM, 1.0 * MM
SHORT = 0.05 * MM  #: Distance below the end of a needle at which the search for a cut begins [m].
#: Rounding of distances: a group of needles is skipped only with this extra distance [m].
ROUNDING = 1e-9 * MM


@njit(cache=True, nogil=True, inline='always')
def gap(
    needle: FloatArray,
    j: int,
    h: float,
    x: float,
    y: float,
    z: float,
    a: float,
    b: float,
    c: float,
    R: float,
    skin: float,
) -> tuple[float, float]:
    """Return how far a point of a needle is from the mill [m], and its derivative by height [-].

    The point lies at height h [m] on row j of ``needle``, shape (k, 6): base [m] and normal [-].
    The mill has C_L at x, y, z [m] and the unit axis a, b, c [-]. Its surface lies ``skin`` [m]
    outside the cylinder of radius R [m] that stands on C_L.
    """
    nx, ny, nz = needle[j, 3], needle[j, 4], needle[j, 5]
    dx = needle[j, 0] + h * nx - x
    dy = needle[j, 1] + h * ny - y
    dz = needle[j, 2] + h * nz - z
    along = dx * a + dy * b + dz * c
    across = sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    low, out = min(along, 0.0), max(across - R, 0.0)
    distance = sqrt(low * low + out * out)
    # d(distance)/dh = (low low' + out out') / distance
    nu = nx * a + ny * b + nz * c
    rise = low * nu
    if out > 0.0:
        inward = dx * nx + dy * ny + dz * nz
        rise += out * (inward - along * nu) / across
    return distance - skin, rise / max(distance, 1e-15)


@njit(cache=True, nogil=True)
def entry(
    needle: FloatArray,
    j: int,
    x: float,
    y: float,
    z: float,
    a: float,
    b: float,
    c: float,
    R: float,
    skin: float,
    begin: float,
) -> float:
    """Return the height at which a needle enters the mill, or TOP [m]; the distance is convex."""
    h = begin
    distance, rise = gap(needle, j, h, x, y, z, a, b, c, R, skin)
    if distance < 0.0:
        h = -DEPTH
        distance, rise = gap(needle, j, h, x, y, z, a, b, c, R, skin)
    for _ in range(60):
        if distance < 1e-11:
            return h
        if rise >= 0.0:
            return TOP
        h -= distance / rise
        if h >= TOP:
            return TOP
        distance, rise = gap(needle, j, h, x, y, z, a, b, c, R, skin)
    return h


@njit(cache=True, nogil=True)
def entry_at(
    needle: FloatArray,
    j: int,
    first: FloatArray,
    last: FloatArray,
    i: int,
    share: float,
    R: float,
    skin: float,
    most: float,
) -> float:
    """Return the entry height at a share of piece i of the motion; ``most``: lowest so far [m]."""
    x = first[i, 0] + share * (last[i, 0] - first[i, 0])
    y = first[i, 1] + share * (last[i, 1] - first[i, 1])
    z = first[i, 2] + share * (last[i, 2] - first[i, 2])
    a = first[i, 3] + share * (last[i, 3] - first[i, 3])
    b = first[i, 4] + share * (last[i, 4] - first[i, 4])
    c = first[i, 5] + share * (last[i, 5] - first[i, 5])
    size = sqrt(a * a + b * b + c * c)
    begin = max(most - SHORT, -DEPTH)
    height: float = entry(needle, j, x, y, z, a / size, b / size, c / size, R, skin, begin)
    return height


@njit(cache=True, nogil=True)
def lowest(first: float, half: float, last: float) -> float:
    """Return the place in [0, 1] of the minimum of the parabola through 3 values."""
    bend = first - 2.0 * half + last
    if bend > 0.0:
        share = 0.5 + 0.25 * (first - last) / bend
        if share > 0.0 and share < 1.0:
            return share
    if first < last:
        return 0.0
    return 1.0


@njit(cache=True, nogil=True, inline='always')
def cut_roughly(
    needle: FloatArray, j: int, most: float, middle: FloatArray, i: int, R: float, skin: float
) -> float:
    """Return the height of a needle after the mill stood in the middle of piece i [m]."""
    x, y, z = middle[i, 0], middle[i, 1], middle[i, 2]
    a, b, c = middle[i, 3], middle[i, 4], middle[i, 5]
    distance, rise = gap(needle, j, most, x, y, z, a, b, c, R, skin)
    if distance < 0.0 or (rise > 0.0 and distance <= SHORT):
        begin = max(most - SHORT, -DEPTH)
        height: float = entry(needle, j, x, y, z, a, b, c, R, skin, begin)
        return min(most, height)
    return most


@njit(cache=True, nogil=True, inline='always')
def cut_finely(
    needle: FloatArray,
    j: int,
    most: float,
    first: FloatArray,
    middle: FloatArray,
    last: FloatArray,
    slack: float,
    i: int,
    stages: int,
    widest: float,
    R: float,
    skin: float,
) -> float:
    """Return the height of a needle, before ``most``, after the mill's way along piece i [m]."""
    half, rise = gap(
        needle,
        j,
        most,
        middle[i, 0],
        middle[i, 1],
        middle[i, 2],
        middle[i, 3],
        middle[i, 4],
        middle[i, 5],
        R,
        skin,
    )
    # A cut below the end of the needle lies within SHORT of it.
    if half > slack and (rise <= 0.0 or half > slack + SHORT):
        return most
    begin, rise_first = gap(
        needle,
        j,
        most,
        first[i, 0],
        first[i, 1],
        first[i, 2],
        first[i, 3],
        first[i, 4],
        first[i, 5],
        R,
        skin,
    )
    end, rise_last = gap(
        needle,
        j,
        most,
        last[i, 0],
        last[i, 1],
        last[i, 2],
        last[i, 3],
        last[i, 4],
        last[i, 5],
        R,
        skin,
    )
    # The distance is convex along a straight piece: this bounds its minimum. A needle is clear
    # from its end down if the distance falls with the height.
    if min(half, 2.0 * half - max(begin, end)) > 0.0:
        if rise <= 0.0 and rise_first <= 0.0 and rise_last <= 0.0:
            return most
    share = lowest(begin, half, end)
    least: float = most
    reach = widest
    for _ in range(stages):
        low, high = max(share - reach, 0.0), min(share + reach, 1.0)
        begin = entry_at(needle, j, first, last, i, low, R, skin, most)
        half = entry_at(needle, j, first, last, i, 0.5 * (low + high), R, skin, most)
        end = entry_at(needle, j, first, last, i, high, R, skin, most)
        least = min(min(least, begin), min(half, end))
        share = low + lowest(begin, half, end) * (high - low)
        reach = reach * 0.5
    height: float = entry_at(needle, j, first, last, i, share, R, skin, most)
    if height < least:
        return height
    return least


@njit(cache=True, nogil=True, inline='always')
def _away(ball: FloatArray, g: int, middle: FloatArray, i: int, R: float) -> float:
    """Return the distance of the centre of ball g from the cylinder of radius R [m]."""
    dx, dy, dz = ball[g, 0] - middle[i, 0], ball[g, 1] - middle[i, 1], ball[g, 2] - middle[i, 2]
    along = dx * middle[i, 3] + dy * middle[i, 4] + dz * middle[i, 5]
    across = sqrt(max(dx * dx + dy * dy + dz * dz - along * along, 0.0))
    low, out = min(along, 0.0), max(across - R, 0.0)
    return sqrt(low * low + out * out)


@njit(cache=True, nogil=True)
def _reach(order: IntArray, begin: int, end: int, height: FloatArray) -> float:
    """Return the largest distance of an end of a needle of a group from its base [m]."""
    reach = 0.0
    for k in range(begin, end):
        reach = max(reach, abs(height[order[k]]))
    return reach


class NeedleGroups(NamedTuple):
    """Needles, and groups of them that may be skipped together."""

    needle: FloatArray  #: (k, 6): Base [m] and unit normal [-].
    order: IntArray  #: (k,): Numbers of the needles, group by group.
    starts: IntArray  #: (groups + 1,): Where groups begin in ``order``.
    ball: FloatArray  #: (groups, 4): Centre and radius of a ball around the bases of a group [m].


class PieceColumns(NamedTuple):
    """The columns of ``MotionPieces``."""

    first: FloatArray
    middle: FloatArray
    last: FloatArray
    slack: FloatArray
    rough: BoolArray
    batch: IntArray


@njit(cache=True, nogil=True)
def cut(
    groups: NeedleGroups,
    pieces: PieceColumns,
    search: tuple[int, float],
    mill: tuple[float, float],
    height: FloatArray,
) -> None:
    """Cut needles by pieces of motion: ``height`` (k,) is lowered in place [m].

    ``search`` is that of ``MotionPieces``; ``mill``: radius of the cylinder, and skin [m].
    """
    needle, order, starts, ball = groups
    first, middle, last, slack, rough, batch = pieces
    (stages, widest), (R, skin) = search, mill
    for g in range(len(starts) - 1):
        begin, end = starts[g], starts[g + 1]
        i = 0
        while i < len(batch):
            after = i
            while after < len(batch) and batch[after] == batch[i]:
                after += 1
            # ``cut_roughly`` and ``cut_finely`` skip every needle that these distances exclude.
            clear = ball[g, 3] + skin + SHORT + ROUNDING
            reach = _reach(order, begin, end, height)
            for p in range(i, after):
                if not rough[p] or _away(ball, g, middle, p, R) > clear + reach:
                    continue
                for k in range(begin, end):
                    j = order[k]
                    height[j] = cut_roughly(needle, j, height[j], middle, p, R, skin)
                    reach = max(reach, -height[j])
            reach = _reach(order, begin, end, height)
            for p in range(i, after):
                if _away(ball, g, middle, p, R) > clear + reach + slack[p]:
                    continue
                for k in range(begin, end):
                    j = order[k]
                    height[j] = cut_finely(
                        needle,
                        j,
                        height[j],
                        first,
                        middle,
                        last,
                        slack[p],
                        p,
                        stages,
                        widest,
                        R,
                        skin,
                    )
                    reach = max(reach, -height[j])
            i = after
