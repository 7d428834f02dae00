"""A hit: the program line, both pieces, by how much they are too near, and where."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cnc_interp.collision.clearance import (
    Route,
    Space,
    larger_to_divide,
    reach,
    reach_from,
    relative_pose,
)
from cnc_interp.collision.enclosure import position
from cnc_interp.collision.gjk import nearest
from cnc_interp.collision.link_poses import placed, pose_links
from cnc_interp.collision.shapes import Pieces
from cnc_interp.core import MM, BlockError, FloatArray, IntArray, norm
from cnc_interp.core.kernels import njit
from cnc_interp.machine_model.machine import Machine, place_text

BETTER = 1e-9  #: Smallest gain in depth for which another direction is taken [m].
PLACES = 33  #: Half the number of places along a hit at which distances are measured.
FIRST_PLACE = 1e-5  #: Path length from the begin of a hit to the next place [m].
DEPTHS = 5  #: Largest number of these places at which the depth of overlapping pieces is measured.
DIRECTIONS = 200  #: Number of directions with which the search for the depth of an overlap begins.


class CollisionError(BlockError):
    """A line of the program brings two bodies nearer than their clearance."""


class CollisionsError(CollisionError):
    """A program hits something in one or more lines; the attributes describe the first hit."""

    def __init__(self, hits: list[Hit], machine: Machine, source: str):
        texts = [hit.text(machine) for hit in hits]
        super().__init__(texts[0], hits[0].line)
        self.hits, self.source = tuple(hits), source
        self._text = '\n'.join(f'{source}:{hit.line}: {hit.text(machine)}' for hit in hits)

    def __str__(self) -> str:
        return self._text


@dataclass(frozen=True)
class Hit:
    line: int  #: Line of the program.
    #: Names of both pieces; ``bodies`` names the bodies that they belong to.
    names: tuple[str, str]
    bodies: tuple[str, str]
    #: Clearance minus the least distance of both pieces in the rest of the line, at the places
    #: that ``least_apart`` measures. With ``material``, the length of the contact [m].
    short: float
    s: float  #: Path length where the hit begins [m].
    q: tuple[float, ...]  #: Axis positions there [m, rad].
    material: bool = False  #: Whether the tool enters remaining material.

    def to_json(self, machine: Machine) -> dict[str, Any]:
        return {
            'line': self.line,
            'pieces': list(self.names),
            'bodies': list(self.bodies),
            'short': self.short,
            'positions': list(self.q),
            'text': self.text(machine),
        }

    def text(self, machine: Machine) -> str:
        one, other = self.names
        what = 'of material' if self.material else 'short'
        where = f'{self.short / MM:.3g} mm {what} at {place_text(machine.axes, self.q)}'
        return f'hit: line {self.line}, {one} and {other}, {where}'


@njit(cache=True, nogil=True)
def apart(space: Space, a: int, b: int, pose: FloatArray, rel: FloatArray) -> float:
    """Return the distance of two pieces [m]; if they overlap, minus the depth of the overlap.

    The depth is the smallest found over many directions, so it is never too small.
    """
    pieces = space.pieces
    relative_pose(pose[pieces.link[b]], pose[pieces.link[a]], rel)
    out = np.empty(9)
    distance = nearest(pieces, a, b, rel, out)
    if distance > 0.0:
        return distance
    best, n0, n1, n2 = -1e300, 0.0, 0.0, 1.0
    for k in range(DIRECTIONS):
        z = 1.0 - (2.0 * k + 1.0) / DIRECTIONS
        across, angle = np.sqrt(1.0 - z * z), 2.399963229728653 * k
        n = across * np.cos(angle), across * np.sin(angle), z
        found = _along(space, a, b, rel, n)
        if found > best:
            best, n0, n1, n2 = found, n[0], n[1], n[2]
    step = 0.1
    while step > 1e-5:
        moved = False
        for k in range(6):
            way = step if k % 2 else -step
            x = n0 + way * (k // 2 == 0)
            y = n1 + way * (k // 2 == 1)
            z = n2 + way * (k // 2 == 2)
            length = np.sqrt(x * x + y * y + z * z)
            found = _along(space, a, b, rel, (x / length, y / length, z / length))
            if found > best + BETTER:  # less may be rounding, for ever
                best, n0, n1, n2, moved = found, x / length, y / length, z / length, True
        if not moved:
            step *= 0.5
    return min(best, 0.0)


@njit(cache=True, nogil=True)
def _along(space: Space, a: int, b: int, rel: FloatArray, n: tuple[float, float, float]) -> float:
    ahead = reach_from(space.pieces, a, rel, n)
    return -reach(space.pieces, b, (-n[0], -n[1], -n[2])) - ahead


@njit(cache=True, nogil=True)
def least_apart(space: Space, route: Route, a: int, b: int, begin: float, end: float) -> float:
    """Return the least distance of two pieces at places of a stretch [m]; minus the depth below 0.

    Half of the places are evenly spaced. The other half become denser towards the begin, so that
    a contact much shorter than its line is measured too.
    """
    pose, rel = np.empty((len(space.chain.parent), 12)), np.empty(12)
    q, out, least = np.empty(route.bezier.shape[1]), np.empty(9), 1e300
    within, count, way = np.empty(2 * PLACES), 0, end - begin
    for k in range(2 * PLACES):
        share = (k // 2) / (PLACES - 1)
        if k % 2 and way > FIRST_PLACE:
            share = (FIRST_PLACE / way) ** (1.0 - share)
        within[count] = begin + way * share
        pose_at(space, route, within[count], q, pose)
        relative_pose(pose[space.pieces.link[b]], pose[space.pieces.link[a]], rel)
        distance = nearest(space.pieces, a, b, rel, out)
        least, count = min(least, distance), count + (distance == 0.0)
    places = np.sort(within[:count])
    for k in range(min(count, DEPTHS)):
        at = places[(2 * k + 1) * count // (2 * min(count, DEPTHS))]
        pose_at(space, route, at, q, pose)
        least = min(least, apart(space, a, b, pose, rel))
    return least


@njit(cache=True, nogil=True)
def pose_at(space: Space, route: Route, at: float, q: FloatArray, pose: FloatArray) -> None:
    """Write the axis positions at a path length, and the poses of all links."""
    s = route.s
    cell = max(min(int(np.searchsorted(s, at, 'right')) - 1, len(s) - 2), 0)
    position(route.bezier, cell, (at - s[cell]) / (s[cell + 1] - s[cell]), q)
    pose_links(space.chain, q, pose)


@njit(cache=True, nogil=True)
def bodies_apart(space: Space, roots: IntArray, pose: FloatArray) -> float:
    """Return the least distance over pairs of pieces, (k, 2), down to their smallest parts [m]."""
    rel, waiting, best = np.empty(12), [(roots[0, 0], roots[0, 1])], 1e300
    for k in range(1, len(roots)):
        waiting.append((roots[k, 0], roots[k, 1]))
    while waiting:
        a, b = waiting.pop()
        divided = larger_to_divide(space.pieces, a, b)
        found = apart(space, a, b, pose, rel)
        if divided < 0:
            best = min(best, found)
        elif found < best:
            for part in space.pieces.child[divided]:
                waiting.append((part, b) if divided == a else (a, part))
    return best


@njit(cache=True, nogil=True)
def nearest_along(
    space: Space,
    route: Route,
    cells: tuple[int, int],
    moved: FloatArray,
    roots: IntArray,
    best: float,
) -> tuple[float, int, int]:
    """Return the least distance at the begins of cells, or ``best`` if that is smaller [m].

    Also return the row of ``roots`` and the cell where it occurs; -1 and -1 if none is nearer. A
    pair is not measured again before it could have come nearer than ``best``; ``moved`` is the
    largest motion up to each cell [m].
    """
    pose, rel = np.empty((len(space.chain.parent), 12)), np.empty(12)
    q, out, pieces = np.empty(route.bezier.shape[1]), np.empty(9), space.pieces
    normal, clear = np.zeros((len(roots), 3)), np.full(len(roots), -1.0)
    found, where, soonest = -1, -1, -1.0
    for cell in range(cells[0], cells[1]):
        if moved[cell] < soonest:
            continue
        pose_at(space, route, route.s[cell], q, pose)
        for row in range(len(roots)):
            if moved[cell] < clear[row]:
                continue
            waiting, least = [(roots[row, 0], roots[row, 1])], np.inf
            while waiting:
                a, b = waiting.pop()
                apart = _balls_apart(pieces, a, b, pose)
                if apart >= best:
                    least = min(least, apart)
                    continue
                divided = larger_to_divide(pieces, a, b)
                if divided >= 0:
                    for part in pieces.child[divided]:
                        waiting.append((part, b) if divided == a else (a, part))
                    continue
                relative_pose(pose[pieces.link[b]], pose[pieces.link[a]], rel)
                n = normal[row, 0], normal[row, 1], normal[row, 2]
                if n != (0.0, 0.0, 0.0):
                    apart = _along(space, a, b, rel, n)
                if apart < best:
                    apart = nearest(pieces, a, b, rel, out)
                    normal[row] = out[:3]
                    if apart < best:
                        best, found, where = apart, row, cell
                least = min(least, apart)
            clear[row] = moved[cell] + least - best
        soonest = clear.min()
    return best, found, where


def largest_motion(space: Space, route: Route) -> FloatArray:
    """Return how far two points of the machine may have moved, up to each cell, (N - 1,) [m].

    A rotary joint moves the points beyond it by at most its angle times their reach from its link.
    """
    chain, pieces = space.chain, space.pieces
    way, most = np.zeros(route.bezier.shape[1]), np.abs(route.bezier).max(axis=(0, 2))
    reach = np.zeros(len(chain.parent))
    np.maximum.at(reach, pieces.link, norm(pieces.ball[:, :3]) + pieces.ball[:, 3])
    for link in range(len(reach) - 1, 0, -1):
        axis, is_linear, parent = chain.axis[link], chain.linear[link], chain.parent[link]
        if axis >= 0:
            way[axis] += 1.0 if is_linear else reach[link]
        beyond = reach[link] + norm(chain.origin[link]) + (most[axis] if is_linear else 0.0)
        reach[parent] = max(reach[parent], beyond)
    steps = np.abs(np.diff(route.bezier[:, :, 0], axis=0)) @ way
    return np.append(0.0, np.cumsum(steps))


@njit(cache=True, nogil=True)
def _balls_apart(pieces: Pieces, a: int, b: int, pose: FloatArray) -> float:
    one, other = pieces.ball[a], pieces.ball[b]
    x, y, z = placed(pose[pieces.link[a]], (one[0], one[1], one[2]))
    u, v, w = placed(pose[pieces.link[b]], (other[0], other[1], other[2]))
    return np.sqrt((x - u) ** 2 + (y - v) ** 2 + (z - w) ** 2) - one[3] - other[3]


def positions_at(route: Route, s: float) -> FloatArray:
    """Return the axis positions at a path length [m, rad]."""
    cell = int(np.clip(np.searchsorted(route.s, s, 'right') - 1, 0, len(route.s) - 2))
    q = np.empty(route.bezier.shape[1])
    position(route.bezier, cell, (s - route.s[cell]) / np.diff(route.s)[cell], q)
    return q
