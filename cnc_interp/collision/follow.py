"""The stock along the path: pieces of motion, what they cut, and what meets remaining material.

In a piece of motion, a point x of the tool moves from x - v(x) to x + v(x) in the frame of the
stock, where v is linear in x. The bound of ``clearance.py`` tells by how much points leave that.

Two fields are cut. The nominal one tells volumes, and where the mill of a rapid enters material.
The other one, cut with a mill reduced by half the diagonal of a cell, contains all that is left.
Holder and shank must keep their clearance from it. It is cut only where they come near.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import sqrt
from typing import Any, NamedTuple

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
from cnc_interp.collision.mill_sweep import BALL, FAR, R0, R1, SLAB, Z0, Z1, slabs_of
from cnc_interp.collision.scene import Placed, Role
from cnc_interp.collision.stock import (
    BEGIN,
    CUT,
    END,
    FIND,
    LEFT,
    MEET,
    MOST,
    MOTION,
    MOVE,
    REMOVED,
    TIP,
    TOOL,
    TURN,
    Field,
    Mills,
    cut_by,
    field_of,
    freshen,
    of_tool,
    pass_over,
    roomier,
    volume,
)
from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.links import TOOL_TIP

#: What pieces of motion may leave of the true one, as a share of the width of a cell [-].
LOST = 0.25
#: A rapid hits where it enters material deeper than so many times that, because wall and mill of
#: a pocket that was just cut touch each other [-].
ENTERS = 1.5
ATOM = 0.125  #: Share of that which short pieces may leave, before they are joined [-].
MOST_TURN = 0.05  #: By how much the axis turns to either side in a piece of motion, at most [rad].
Spans = list[tuple[float, float]]
#: Where a body meets remaining material: path length of the first contact in its line [m], number
#: of the body in the scene and of its slab, longest stretch of a line of the field in it [m].
Contact = tuple[float, int, int, float]


class Tools(NamedTuple):
    """The slabs of all tools, as each use needs them."""

    mill: Mills
    entering: Mills  #: The mills, reduced by what they may enter in rapids.
    reduced: Mills  #: The mills that leave at least what remains.
    guard: Mills  #: Shanks and holders, grown by their clearance.


class CutStock:
    """The stock of a scene while the tool moves along the path."""

    def __init__(self, placed: Placed, space: Space):
        self._placed, self._space, scene = placed, space, placed.scene
        self.number = next(k for k, b in enumerate(scene.bodies) if b.role is Role.STOCK)
        self.body, self.pitch = scene.bodies[self.number], scene.grid
        self.lost, self._diagonal = LOST * self.pitch, self.pitch / sqrt(2.0)
        self._links = placed.names.index(TOOL_TIP), placed.names.index(self.body.link)
        self.field = field_of(self.body, 2, self.pitch, shifted=True)
        self.whole = volume(self.field)  #: Volume before anything is cut [m3].
        self._left: Field | None = None  # what contains all that is left
        self._owners: list[tuple[int, int]] = []  # of the slabs of guards
        self._tools = Tools(
            self._mills(lambda _: 0.0, cutter=True),
            self._mills(lambda _: -ENTERS * self.lost, cutter=True),
            self._mills(lambda _: -self._diagonal - self.lost, cutter=True),
            self._mills(lambda k: placed.clearance[k, self.number] + self._diagonal, cutter=False),
        )
        self._clear_from = np.full(2, -np.inf)
        self._rows, self._count = np.empty((256, MOTION)), 0

    @property
    def rows(self) -> FloatArray:
        """The pieces of motion that have cut, (n, MOTION)."""
        return self._rows[: self._count]

    def figures(self) -> dict[str, Any]:
        """Return the width of a cell [m], volumes at first and removed [m3], number of pieces."""
        removed = float(self.rows[:, REMOVED].sum())
        own = {'grid': self.pitch, 'volume': self.whole, 'removed': removed}
        return own | {'pieces': len(self.rows)}

    def _mills(self, grown: Callable[[int], float], cutter: bool) -> Mills:
        """Return the slabs of cutters, or of all else on the tools, grown by so much."""
        bodies, slabs, first = self._placed.scene.bodies, [np.empty((0, SLAB))], [0]
        for number in range(max(self._placed.scene.tools) + 1):
            for k, body in enumerate(bodies):
                if body.tool == number and number and (body.role is Role.CUTTER) == cutter:
                    slabs.append(slabs_of(body, grown(k)))
                    if not cutter:
                        self._owners += [(k, i) for i in range(len(slabs[-1]))]
            first.append(sum(map(len, slabs)))
        return Mills(np.concatenate(slabs), np.array(first))

    def follow(
        self,
        route: Route,
        cells: tuple[int, int],
        tool: int,
        rapid: bool,
        near: Mapping[int, Spans],
    ) -> list[Contact]:
        """Follow cells from one to before another, all rapids or all feeds.

        ``near``: where bodies of the tool may meet the stock, and are checked.
        """
        bodies = self._placed.scene.bodies
        mine = [k for k, body in enumerate(bodies) if body.tool == tool and tool]
        cutters = [k for k in mine if bodies[k].role is Role.CUTTER]
        spans = [
            [span for k in mine for span in near.get(k, []) if (k in cutters) == cutter]
            for cutter in (True, False)
        ]
        if not mine or (rapid and not any(spans)):
            return []
        sizes, reach = self._sizes(tool), of_tool(self._tools.mill, tool)[:, Z1].max()
        rows = motions_of(self._space, route, cells, self._links, sizes, ATOM * self.lost)
        rows = joined(rows, reach, sizes[0, 3], (0.5 - ATOM) * self.lost)
        rows[:, TOOL] = tool
        watched = np.stack([_meets(rows, some) for some in spans], axis=1)
        watched[:, 0] &= rapid
        if watched[:, 1].any() and self._left is None:
            self._left = field_of(self.body, 2, self.pitch, False, self._diagonal)
        at, contacts, first = 0, [], self._tools.guard.first[tool]
        while at < len(rows):
            at, found, self._rows, self._count = follow(
                (self.field, self._left or self.field),
                self._tools,
                ToolMotions(rows, watched, not rapid),
                route,
                (self._rows, self._count),
                (at, 0.5 * self.lost),
                self._clear_from,
            )
            for s, which, slab, most in found:
                body, piece = self._owners[int(first + slab)] if which else (cutters[0], 0)
                contacts.append((s, body, piece, most))
            self.field, self._left = roomier(self.field), self._left and roomier(self._left)
        return contacts

    def _sizes(self, tool: int) -> FloatArray:
        """Return the height of the middle of a ball around the mill and one around the tool.

        With it, the radius of the ball, the largest one of the tool, that of a flat end, (2, 4).
        """
        found = []
        mill = of_tool(self._tools.mill, tool)
        for slabs in (mill, np.concatenate([mill, of_tool(self._tools.guard, tool)])):
            ball = slabs[:, BALL] * slabs[:, R0]
            low, high = (slabs[:, Z0] - ball).min(), (slabs[:, Z1] + ball).max()
            wide = slabs[:, [R0, R1]].max()
            flat = 0.0 if slabs[0, BALL] else slabs[0, R0]
            found.append((0.5 * (low + high), np.hypot(0.5 * (high - low), wide), wide, flat))
        return np.array(found)

    def columns(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the columns of ``removal.npz`` and of ``remaining.npz``."""
        used = self.field.used.ravel()
        there = np.arange(self.field.ends.shape[2]) < self.field.used[..., None]
        line = np.repeat(np.arange(len(used)), used)
        names = {'begin': BEGIN, 'end': END, 'removed': REMOVED}
        removal = {name: self.rows[:, column] for name, column in names.items()}
        return removal, {'line': line, 'interval': self.field.ends[there]}

    def field_along(self, axis: int) -> Field:
        """Return what is left on unshifted lines along an axis."""
        field = field_of(self.body, axis, self.pitch, shifted=False)
        return cut_by(field, self.rows, self._tools.mill, 0.5 * self.lost)


def _meets(rows: FloatArray, spans: Spans) -> BoolArray:
    """Return which pieces of motion meet spans of the path."""
    begin, end = np.sort(np.array(spans).reshape(-1, 2), axis=0).T
    begun = np.searchsorted(begin, rows[:, END], 'left')
    return np.asarray(begun > np.searchsorted(end, rows[:, BEGIN], 'right'))


class ToolMotions(NamedTuple):
    """Pieces of motion in order, of one tool."""

    motions: FloatArray
    #: (n, 2): Whether the mill must not enter the first field; shank and holder, the second.
    watched: BoolArray
    cuts: bool


@njit(cache=True, nogil=True)
def follow(
    fields: tuple[Field, Field],
    tools: Tools,
    pieces: ToolMotions,
    route: Route,
    past: tuple[FloatArray, int],
    going: tuple[int, float],
    clear_from: FloatArray,
) -> tuple[int, FloatArray, FloatArray, int]:
    """Follow pieces of motion in order: check those that are watched, and cut.

    Parameters
    ----------
    fields : tuple
        The nominal field, and the one that contains all that is left.
    pieces : ToolMotions
        What is not clear is divided, its first half first, because cutting may clear the second.
    past : tuple
        The pieces that have cut so far, and their number.
    going : tuple
        The piece to begin with, and how far the ends of slabs may turn [m].
    clear_from : ndarray, shape (2,)
        Path lengths from which on contacts are listed, which it brings up to date [m].

    Returns
    -------
    int
        The piece that is next. Not the last one: a line is full; give it room and go on.
    ndarray
        Rows of hits: path length, 1 of shank or holder, its slab, longest material in it [m].
    ndarray, int
        The pieces that have cut so far, and their number.

    """
    motions, watched, cuts = pieces
    hits, n_hits, (rows, count), (first, step) = np.empty((4, 4)), 0, past, going
    n_u, n_v = fields[0].used.shape
    pitch, window = fields[0].place[2], (0, n_u, 0, n_v)
    waiting, row = np.empty((64, MOTION)), np.empty(MOTION)
    for k in range(first, len(motions)):
        tool, depth = int(motions[k, TOOL]), 1
        mill, waiting[0] = of_tool(tools.mill, tool), motions[k]
        while depth:
            depth -= 1
            row[:] = waiting[depth]
            parted = False
            for w in range(2):
                if not watched[k, w] or row[BEGIN] < clear_from[w]:
                    continue
                guard, field, turns = of_tool(tools.entering, tool), fields[w], step
                if w == 1:
                    guard, turns = of_tool(tools.guard, tool), 0.0
                met, which = pass_over(field, guard, row, turns, window, MEET)
                if met > 0.0 and w == 1:  # with an older state of the field, which is larger
                    pass_over(field, guard, row, turns, window, FIND)
                    freshen(field, tools.reduced, rows[:count], step)
                    if field.full[0]:
                        return k, hits[:n_hits], rows, count
                    met, which = pass_over(field, guard, row, turns, window, MEET)
                if met == 0.0:
                    continue
                if _way(row, guard) > pitch and depth + 2 < len(waiting):
                    halve(row, waiting[depth + 1], waiting[depth])
                    depth, parted = depth + 2, True
                    break
                most, which = pass_over(field, guard, motions[k], turns, window, MOST)
                hits = grown_rows(hits, n_hits)
                hits[n_hits, 0], hits[n_hits, 1] = row[BEGIN], w
                hits[n_hits, 2], hits[n_hits, 3] = which, most
                n_hits += 1
                cell = np.searchsorted(route.s[1:-1], row[BEGIN], 'right')
                clear_from[w] = route.line_end[cell]
            if cuts and not parted:
                length, _ = pass_over(fields[0], mill, row, step, window, CUT)
                row[REMOVED] = length * pitch * pitch
                rows = grown_rows(rows, count)
                rows[count] = row
                count += 1
        if fields[0].full[0] or fields[1].full[0]:
            return k, hits[:n_hits], rows, count
    return len(motions), hits[:n_hits], rows, count


@njit(cache=True, nogil=True)
def _way(row: FloatArray, slabs: FloatArray) -> float:
    """Return how far slabs move in a piece of motion [m]."""
    found = 0.0
    for slab in slabs:
        found = max(found, 2.0 * _length(row[MOVE:TURN] + slab[Z1] * row[TURN:BEGIN]))
    return found


@njit(cache=True, nogil=True)
def halve(row: FloatArray, before: FloatArray, after: FloatArray) -> None:
    """Write both halves of a piece of motion."""
    for side, out in ((-0.5, before), (0.5, after)):
        out[:] = row
        out[TIP : TIP + 6] += side * row[MOVE : MOVE + 6]
        out[MOVE : MOVE + 6] *= 0.5
        out[LEFT] *= 0.5
    before[END] = after[BEGIN] = 0.5 * (row[BEGIN] + row[END])


@njit(cache=True, nogil=True)
def _motion(
    space: Space,
    route: Route,
    span: tuple[float, float, int, int],
    links: tuple[int, int],
    sizes: FloatArray,
    out: FloatArray,
) -> float:
    """Write one piece of motion; return by how much the mill leaves it [m].

    It is the chord between the poses at both ends. Both leave the tangent in the middle by what
    ``displaced`` bounds, so points leave the chord by twice that.
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
                lever, spin = radius + _length(centre - row[O:A]), spin + abs(row[A])
            left += row[EPS] * lever
        out[LEFT] = left + 0.5 * wide * spin * spin
        found = found if k else out[LEFT] + flat * _length(out[TURN:BEGIN])
    return found if _length(out[TURN:BEGIN]) < MOST_TURN else FAR


@njit(cache=True, nogil=True)
def _length(v: FloatArray) -> float:
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
    """Divide cells from one to before another into pieces of motion, (m, MOTION).

    ``sizes``: of the tool; ``lost``: what points of the mill may leave of their motion [m]. Half
    of that is for what ``_motion`` bounds, and the other half for slabs whose ends turn.
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
    """Write the motion from the first pose of pieces to their last one; return what leaves it."""
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
            way = max(way, _length(off[:3]) + reach * _length(off[3:]))
        left = max(left, row[LEFT])
    out[LEFT] = way + left
    turn = _length(out[TURN:BEGIN])
    return way + flat * turn if turn < MOST_TURN else FAR
