"""The stock along the path: the tool cuts it, and contacts with remaining material are listed.

Two fields are cut. The nominal one gives volumes, and shows where a rapid enters material.
The outer one surely contains all that is left: its mill is reduced by half the diagonal of a cell.
Holder and shank must keep their clearance from the outer field, which is cut only near them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from cnc_interp.collision.clearance import Route, Space, grown_rows
from cnc_interp.collision.cutting import (
    CUT,
    FIND,
    MEET,
    MOST,
    Mills,
    cut_by,
    freshen,
    of_tool,
    pass_over,
)
from cnc_interp.collision.mill_sweep import BALL, R0, R1, SLAB, Z0, Z1, slabs_of
from cnc_interp.collision.motions import (
    BEGIN,
    END,
    MOTION,
    MOVE,
    REMOVED,
    TOOL,
    TURN,
    joined,
    length_of,
    motions_of,
    part_of,
)
from cnc_interp.collision.scene import Placed, Role
from cnc_interp.collision.stock import Field, field_of, roomier, volume
from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.joint import TOOL_TIP

#: Largest deviation of pieces of motion from the true one, as a share of the width of a cell [-].
LOST = 0.25
#: A rapid is a hit if it enters material deeper than this multiple of that deviation. The margin
#: is needed because the mill touches the walls of a pocket that it has just cut [-].
ENTERS = 1.5
ATOM = 0.125  #: Share of that deviation for short pieces, before they are joined [-].
Spans = list[tuple[float, float]]
#: A contact with remaining material: path length where it begins in its program line [m], number
#: of the body in the scene, number of its slab, and longest stretch of a field line inside it [m].
Contact = tuple[float, int, int, float]


class Tools(NamedTuple):
    """The slabs of all tools, in the four sizes that are needed."""

    mill: Mills
    entering: Mills  #: The mills, reduced by the depth that rapids may enter.
    reduced: Mills  #: The mills, reduced so that they leave no less material than the true ones.
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
        self.field.wanted[:] = 1
        self.whole = volume(self.field)  #: Volume before anything is cut [m3].
        self._left: Field | None = None  # the outer field
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
        """The pieces of motion that have been cut so far, (n, MOTION)."""
        return self._rows[: self._count]

    def figures(self) -> dict[str, Any]:
        """Return the cell width [m], initial and removed volume [m3], and number of pieces."""
        removed = float(self.rows[:, REMOVED].sum())
        own = {'grid': self.pitch, 'volume': self.whole, 'removed': removed}
        return own | {'pieces': len(self.rows)}

    def _mills(self, grown: Callable[[int], float], cutter: bool) -> Mills:
        """Return the slabs of cutters, or of shanks and holders; ``grown`` by body number [m]."""
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
        """Cut along cells [first, last), all rapids or all feeds, and return the contacts.

        ``near``: for each body of the tool, the path lengths where it is checked against the
        stock.
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
        """Return the sizes of the mill and of the whole tool, row by row, (2, 4) [m].

        Columns: height of the middle of a ball around it, radius of that ball, largest radius of
        the tool, and radius of its flat end.
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
        """Return the remaining material as a field of unshifted lines along an axis."""
        return self.cut(field_of(self.body, axis, self.pitch, shifted=False), self.rows)

    def cut(self, field: Field, rows: FloatArray) -> Field:
        """Return a field cut with pieces of motion; those that it has had already are skipped."""
        step = 0.5 * LOST * float(field.place[2])
        return cut_by(field, rows, self._tools.mill, step)


def _meets(rows: FloatArray, spans: Spans) -> BoolArray:
    """Return which pieces of motion overlap any of the spans of the path."""
    begin, end = np.sort(np.array(spans).reshape(-1, 2), axis=0).T
    begun = np.searchsorted(begin, rows[:, END], 'left')
    return np.asarray(begun > np.searchsorted(end, rows[:, BEGIN], 'right'))


class ToolMotions(NamedTuple):
    """Pieces of motion of one tool, in order."""

    motions: FloatArray
    #: (n, 2): Whether the mill is checked against the nominal field, and whether shank and holder
    #: are checked against the outer one.
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
    """Go through pieces of motion in order: check those that are watched, and cut.

    A piece with a contact is divided. Its first half comes first, because cutting along it may
    clear the second half.

    Parameters
    ----------
    fields : tuple
        The nominal field and the outer one.
    pieces : ToolMotions
        The pieces of motion, with the checks that each of them needs.
    past : tuple
        The pieces that have been cut so far, and their number.
    going : tuple
        The piece to begin with, and the ``step`` of ``pass_over`` [m].
    clear_from : ndarray, shape (2,)
        Path length from which on contacts of the mill, and of shank and holder, are listed [m].
        It is updated in place.

    Returns
    -------
    int
        The piece to continue with. If pieces are left, a line of a field is full: enlarge the
        field and call again.
    ndarray
        Rows of hits: path length, 0 for the mill or 1 for shank and holder, slab, and longest
        stretch of material inside it [m].
    ndarray, int
        The pieces that have been cut so far, and their number.

    """
    motions, watched, cuts = pieces
    hits, n_hits, (rows, count), (first, step) = np.empty((4, 4)), 0, past, going
    pitch, row = fields[0].place[2], np.empty(MOTION)
    for k in range(first, len(motions)):
        whole, tool = motions[k], int(motions[k, TOOL])
        begin, end = whole[BEGIN], whole[END]
        while begin < whole[END]:
            for w in range(2):  # a line that has hit is not looked at any more
                if watched[k, w] and begin < clear_from[w]:
                    end = min(end, clear_from[w])
            part_of(whole, begin, end, row)
            hit = -1
            for w in range(2):
                if not watched[k, w] or begin < clear_from[w]:
                    continue
                guard = of_tool(tools.guard if w else tools.entering, tool)
                if _met(fields, guard, tools.reduced, row, rows[:count], w, step):
                    hit = w
                    break
            if fields[1].full[0]:
                return k, hits[:n_hits], rows, count
            if hit >= 0:
                guard = of_tool(tools.guard if hit else tools.entering, tool)
                if _way(row, guard) > pitch:
                    end = 0.5 * (begin + end)
                    continue
                turns = 0.0 if hit else step
                most, which = pass_over(fields[hit], guard, whole, turns, 0, MOST)
                hits = grown_rows(hits, n_hits)
                hits[n_hits] = np.array((begin, float(hit), float(which), most))
                n_hits += 1
                cell = np.searchsorted(route.s[1:-1], begin, 'right')
                clear_from[hit], end = route.line_end[cell], whole[END]
                continue
            if cuts:
                length, _ = pass_over(fields[0], of_tool(tools.mill, tool), row, step, 0, CUT)
                row[REMOVED] = length * pitch * pitch
                rows = grown_rows(rows, count)
                rows[count] = row
                count += 1
            begin, end = end, min(end + 2.0 * (end - begin), whole[END])
        if fields[0].full[0]:
            return k, hits[:n_hits], rows, count
    return len(motions), hits[:n_hits], rows, count


@njit(cache=True, nogil=True)
def _met(
    fields: tuple[Field, Field],
    guard: FloatArray,
    reduced: Mills,
    row: FloatArray,
    rows: FloatArray,
    which: int,
    step: float,
) -> bool:
    """Return whether slabs meet a field; the outer field is first cut near them."""
    if which == 0:
        return pass_over(fields[0], guard, row, step, 0, MEET)[0] > 0.0
    if pass_over(fields[1], guard, row, 0.0, 0, MEET)[0] == 0.0:
        return False  # nor do they meet what is left of this older state
    pass_over(fields[1], guard, row, 0.0, 0, FIND)
    freshen(fields[1], reduced, rows, step)
    return pass_over(fields[1], guard, row, 0.0, 0, MEET)[0] > 0.0


@njit(cache=True, nogil=True)
def _way(row: FloatArray, slabs: FloatArray) -> float:
    """Return how far slabs move in a piece of motion [m]."""
    found = 0.0
    for slab in slabs:
        found = max(found, 2.0 * length_of(row[MOVE:TURN] + slab[Z1] * row[TURN:BEGIN]))
    return found
