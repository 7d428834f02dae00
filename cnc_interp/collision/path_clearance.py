"""Check a whole motion, part by part, before anything moves: find certificates or hits."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.collision.clearance import Found, Route, Space, descend
from cnc_interp.collision.enclosure import DEGREE, bezier_table
from cnc_interp.collision.hits import (
    CollisionError,
    Hit,
    bodies_apart,
    largest_motion,
    least_apart,
    nearest_along,
    positions_at,
)
from cnc_interp.collision.link_poses import pose_links, steps_between
from cnc_interp.collision.mesh_file import SceneError
from cnc_interp.collision.pieces import winding
from cnc_interp.collision.scene import Placed, Scene
from cnc_interp.core import MM, BoolArray, FloatArray, IntArray
from cnc_interp.core.tables import Table, column
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.joint import TOOL_TIP
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import TOOL
from cnc_interp.program.blocks.functions import Functions

if TYPE_CHECKING:
    from cnc_interp.collision.follow import Contact, CutStock, Spans

LEAVES = 1e-7  #: A move by hand may start too near if it then moves further away than this [m].
MOST_HITS = 1 << 16  #: Largest number of hits listed for one part of the path.
#: Outputs that M6 sets to the number of the tool: with a tool changer, and by hand.
TOOL_OUTPUTS = ('tool_number', TOOL)


class Certificates(Table):
    """Rows of ``collision.npz``: certificates that pieces keep their clearance, and hits."""

    begin: FloatArray = column()  #: Path length at the start of the interval, or of a hit [m].
    end: FloatArray = column()  #: Path length at its end [m].
    pair: IntArray = column(2)  #: Numbers of both pieces, A and B.
    #: Unit vector from A to B along which the clearance is proven, in the frame of B's link [-].
    normal: FloatArray = column(3)
    hit: BoolArray = column(default=False)  #: Whether both pieces hit at the start.
    #: For a hit: points of A and of B in the frames of their links, nearer than the clearance [m].
    witness: FloatArray = column(6, default=0.0)


def space_of(placed: Placed) -> Space:
    return Space(placed.pieces, placed.chain, *placed.steps(), placed.clearance)


@dataclass(frozen=True)
class Nearest:
    """The least distance of bodies at the ends of the cells of the path."""

    distance: float  #: Least distance of both bodies [m].
    bodies: tuple[str, str]
    line: int  #: Line of the program.


@dataclass
class ClearanceFigures:
    """Figures of the check: intervals, tests of pairs, certificates, and pairs of bodies."""

    intervals: int = 0
    tests: int = 0
    certificates: int = 0
    pairs: int = 0
    nearest: Nearest | None = None  #: Between the tool's side and the other side of the machine.


class PathClearance:
    """Checks the parts of one path in order; ``push`` checks the next part."""

    def __init__(self, machine: Machine, scene: Scene, most_hits: int = MOST_HITS):
        self.machine, self.scene = machine, scene
        self.placed = placed = Placed.of(scene, machine)
        self._space = space_of(placed)
        count = len(scene.bodies)
        self._until = np.full((count, count), -np.inf)
        self._last: dict[tuple[int, int], Hit] = {}  # the last hit of each pair of bodies
        self._most, self._begun = most_hits, False
        self._tools = np.zeros(0, np.int64), np.zeros(0, np.int64)  # rows, numbers
        self.figures = ClearanceFigures(pairs=len(placed.pairs))

    @cached_property
    def stock(self) -> CutStock | None:
        """The stock that is cut along the path; None if the scene has no stock or no tools."""
        if not self.scene.grid or not self.scene.tools:
            return None
        from cnc_interp.collision.follow import CutStock  # loaded with a stock only

        return CutStock(self.placed, self._space)

    def call_tools(self, functions: Functions) -> None:
        """Set the program's functions up to this part; tool changes select the tool to check."""
        signals = self.machine.signals
        names = [signals.outputs[step.output].name for step in signals.steps]
        calls = np.flatnonzero([names[step] in TOOL_OUTPUTS for step in functions.step])
        self._tools = functions.block[calls], functions.value[calls].astype(np.int64)
        for line, tool in zip(functions.line_number[calls], self._tools[1], strict=True):
            if tool and tool not in self.scene.tools:
                text = f'tool {tool} has no body in the scene; add it to tools of '
                text += f'{self.scene.source}, or its length and radius to the tool table'
                raise CollisionError(text, int(line))

    def push(
        self, path: AxisPath, rapid: BoolArray, line_of: Callable[[int], int]
    ) -> tuple[list[Hit], Certificates]:
        """Check the next part of the path.

        Parameters
        ----------
        path : AxisPath
            The part; it begins where the previous one ended.
        rapid : ndarray, shape (N - 1,)
            Whether each cell is a rapid, in which the cutter must not touch the stock.
        line_of : callable
            Returns the line of a row of the program.

        Returns
        -------
        list of Hit
            The first contact of each pair of bodies on each line, in order.
        Certificates
            The proof for the rest of the part, and the hits.

        """
        lines, route = self._route(path, line_of)
        hits: list[Hit] = []
        parts: list[Certificates] = []
        near: dict[int, Spans] = {}  # where bodies are not clear of the uncut stock
        for pair, hit in self._last.items():  # a line that continues counts as one hit
            if hit.line == lines[0]:
                self._until[pair] = route.line_end[0]
        for first, last, pairs in self._stretches(path, rapid):
            solid = [pair for pair in pairs if not self._cut(pair)]
            self._refuse_inside(route, first, solid)
            if found := self._descend(route, (first, last), solid, self._most, parts):
                hits += self._hits(route, lines, found)
                if self._most == MOST_HITS:
                    self._measure(route, lines, (first, last), solid)
            cut = [pair for pair in pairs if self._cut(pair)]
            if found := self._descend(route, (first, last), cut, MOST_HITS, parts):
                bodies = self.placed.pieces.body[found.hit_pair[:, 0]].tolist()
                for body, (begin, end, *_) in zip(bodies, found.hit, strict=True):
                    until = path.s[last] if len(found.hit) == MOST_HITS else end
                    near.setdefault(body, []).append((begin, until))
        for contact in self._cut_stock(path, rapid, route, near):
            hits += self._stock_hit(route, lines, contact)
        hits.sort(key=lambda hit: hit.s)
        if not self._begun and hits and hits[0].s == path.s[0] and not hits[0].material:
            raise SceneError(touching_text(self.scene, hits[0]))
        self._begun = True
        return hits, Certificates.concatenate(parts) if parts else Certificates.none()

    def _measure(
        self,
        route: Route,
        lines: IntArray,
        cells: tuple[int, int],
        pairs: list[tuple[int, int]],
    ) -> None:
        """Record the least distance between bodies on the tool's side and on the other side.

        The cutter and the stock do not count as a pair.
        """
        tip = self.placed.names.index(TOOL_TIP)
        carries = {tip, *(link for link, _ in steps_between(self.placed.chain, tip, 0))}
        on_tool = [self.placed.names.index(body.link) in carries for body in self.scene.bodies]
        roots = self._roots(
            [(a, b) for a, b in pairs if on_tool[a] != on_tool[b] and self.scene.in_feed(a, b)]
        )
        before = self.figures.nearest
        best = np.inf if before is None else before.distance
        moved = largest_motion(self._space, route)
        distance, row, cell = nearest_along(self._space, route, cells, moved, roots, best)
        if row >= 0:
            a, b = (self.scene.bodies[self.placed.pieces.body[piece]].name for piece in roots[row])
            self.figures.nearest = Nearest(float(distance), (a, b), int(lines[cell]))

    def pass_by(self, path: AxisPath, rapid: BoolArray, functions: Functions) -> None:
        """Cut the stock, without checks, along a part that is not executed.

        ``functions``: those of the program up to the end of that part.
        """
        if self.stock is not None:
            kept = self._tools
            self.call_tools(functions)
            _, route = self._route(path, int)
            for _ in self._cut_stock(path, rapid, route, {}):
                pass
            self._tools = kept

    def _route(self, path: AxisPath, line_of: Callable[[int], int]) -> tuple[IntArray, Route]:
        rows, at = np.unique(path.cell_block, return_inverse=True)
        lines = np.array([line_of(row) for row in rows.tolist()])[at]
        ends = np.append(np.flatnonzero(np.diff(lines)), len(lines) - 1)
        line_end = path.s[1 + ends[np.searchsorted(ends, np.arange(len(lines)))]]
        return lines, Route(path.s, bezier_table(path), line_end)

    def _cut(self, pair: tuple[int, int]) -> bool:
        """Return whether one body of a pair is the stock that is cut."""
        return self.stock is not None and self.stock.number in pair

    def _descend(
        self,
        route: Route,
        cells: tuple[int, int],
        pairs: list[tuple[int, int]],
        most: int,
        parts: list[Certificates],
    ) -> Found | None:
        roots = self._roots(pairs)
        if not len(roots):
            return None
        found = descend(self._space, route, cells, roots, self._until, most)
        parts.append(certificates_of(found))
        self.figures.intervals += int(found.effort[0])
        self.figures.tests += int(found.effort[1])
        self.figures.certificates += len(found.span)
        return found

    def _cut_stock(
        self, path: AxisPath, rapid: BoolArray, route: Route, near: dict[int, Spans]
    ) -> Iterator[Contact]:
        if self.stock is None:
            return
        tool = self._tool_of(path.cell_block)
        starts = np.flatnonzero(np.diff(2 * tool + rapid, prepend=-1))
        for first, last in zip(starts, np.append(starts[1:], len(tool)), strict=True):
            cells, number = (int(first), int(last)), int(tool[first])
            yield from self.stock.follow(route, cells, number, bool(rapid[first]), near)

    def _stock_hit(self, route: Route, lines: IntArray, contact: Contact) -> list[Hit]:
        """Return a contact with the remaining stock as a hit, unless its line already has one."""
        assert self.stock is not None
        s, number, piece, length = contact
        line = int(lines[np.searchsorted(route.s[1:-1], s, 'right')])
        pair, body = (number, self.stock.number), self.scene.bodies[number]
        last = self._last.get(pair)
        if last is not None and last.line == line and s < route.line_end[0]:
            return []
        names = body.piece_name(body.roots[piece]), self.stock.body.name
        q, bodies = tuple(positions_at(route, s).tolist()), (body.name, self.stock.body.name)
        self._last[pair] = hit = Hit(line, names, bodies, length, s, q, material=True)
        return [hit]

    def contact(self, positions: FloatArray, tool: int = 0) -> Hit | None:
        """Return the first contact on straight moves between axis positions, (K, n_axes) [m, rad].

        These are moves by hand: the cutter may touch the stock, to touch it off. Bodies that are
        already too near may move apart.
        """
        ways, cells = np.diff(positions, axis=0), len(positions) - 1
        bezier = positions[:-1, :, None] + ways[:, :, None] * np.arange(DEGREE + 1.0) / DEGREE
        route = Route(np.arange(cells + 1.0), bezier, np.full(cells, float(cells)))
        pairs = self.placed.with_tool(tool or self.scene.first_tool)
        pairs = [pair for pair in pairs if self.scene.in_feed(*pair)]
        until = np.full_like(self._until, -np.inf)
        while pairs and cells:
            roots = self._roots(pairs)
            found = descend(self._space, route, (0, cells), roots, until, 1)
            if not len(found.hit):
                return None
            pair = self._bodies_of(found.hit_pair[0])
            start, end = (self._apart(pair, q) for q in (positions[0], positions[-1]))
            if found.hit[0, 0] > 0.0 or end <= start + LEAVES:
                return self._hits(route, np.zeros(cells, np.int64), found)[0]
            pairs.remove(pair)
        return None

    def distance(self, names: tuple[str, str], q: FloatArray, tool: int = 0) -> float:
        """Return the distance of two bodies at axis positions [m]."""
        tools = 0, tool or self.scene.first_tool
        a, b = (
            next(
                k
                for k, body in enumerate(self.scene.bodies)
                if (body.name == name) and body.tool in tools
            )
            for name in names
        )
        return self._apart((a, b), q)

    def _apart(self, pair: tuple[int, int], q: FloatArray) -> float:
        return float(bodies_apart(self._space, self._roots([pair]), self.poses(q)))

    def _bodies_of(self, pieces: IntArray) -> tuple[int, int]:
        a, b = self.placed.pieces.body[pieces].tolist()
        return a, b

    def _roots(self, pairs: list[tuple[int, int]]) -> IntArray:
        placed = self.placed
        roots = [(p, q) for a, b in pairs for p in placed.roots(a) for q in placed.roots(b)]
        return np.array(roots, dtype=np.int64).reshape(-1, 2)

    def _stretches(
        self, path: AxisPath, rapid: BoolArray
    ) -> Iterator[tuple[int, int, list[tuple[int, int]]]]:
        """Yield ranges of cells [first, last), and the pairs of bodies to check in each range."""
        tool = self._tool_of(path.cell_block)
        starts = np.flatnonzero(np.diff(tool, prepend=tool[0] - 1))
        for first, last in zip(starts, np.append(starts[1:], len(tool)), strict=True):
            pairs = self.placed.with_tool(int(tool[first]))
            always = [pair for pair in pairs if self.scene.in_feed(*pair)]
            yield int(first), int(last), always
            seldom = [pair for pair in pairs if not self.scene.in_feed(*pair)]
            if not seldom:
                continue
            ends = np.flatnonzero(np.diff(rapid[first:last], prepend=False, append=False))
            for begin, end in ends.reshape(-1, 2):
                yield int(first + begin), int(first + end), seldom

    def _tool_of(self, rows: IntArray) -> IntArray:
        called, numbers = self._tools
        at = np.searchsorted(called, rows, 'right') - 1
        tool = np.where(at >= 0, np.append(numbers, 0)[at], self.scene.first_tool)
        if len(self.scene.tools) > 1 and (tool == 0).any() and not len(called):
            text = 'no tool is called before the first motion; name the one in the spindle:'
            raise SceneError(f'{self.scene.source}: {text} tool: NUMBER')
        return np.asarray(tool)

    def _refuse_inside(self, route: Route, first: int, pairs: list[tuple[int, int]]) -> None:
        """Reject a body that starts inside a mesh, because only the mesh surface is checked."""
        meshes = [k for k, body in enumerate(self.scene.bodies) if body.triangles is not None]
        asked = [pair for pair in pairs if pair[0] in meshes or pair[1] in meshes]
        if not asked:
            return
        poses = self.poses(positions_at(route, float(route.s[first])))
        for pair in asked:
            for one, other in (pair, pair[::-1]):
                mesh = self.scene.bodies[one]
                if mesh.triangles is None:
                    continue
                body = self.scene.bodies[other]
                (ra, oa), (rb, ob) = (
                    (poses[k][:9].reshape(3, 3), poses[k][9:])
                    for k in (self.placed.names.index(b.link) for b in (mesh, body))
                )
                leaf = next(k for k, child in enumerate(body.child) if child[0] < 0)
                point = ra.T @ (rb @ body.pieces[leaf].discs[0, :3] + ob - oa)
                if winding(mesh.triangles, point) > 0.5:
                    text = f'{body.name} lies inside {mesh.name} where the motion begins'
                    raise SceneError(f'{self.scene.source}: {text}; move one of them')

    def poses(self, q: FloatArray) -> FloatArray:
        """Return rotation and origin of all links at axis positions, (n, 12) [-, m]."""
        pose = np.empty((len(self.placed.names), 12))
        pose_links(self.placed.chain, q, pose)
        return pose

    def _hits(self, route: Route, lines: IntArray, found: Found) -> list[Hit]:
        hits = []
        for (begin, end, *_), (a, b) in zip(found.hit, found.hit_pair, strict=True):
            cell = min(int(np.searchsorted(route.s, begin, 'right')) - 1, len(lines) - 1)
            bodies = int(self.placed.pieces.body[a]), int(self.placed.pieces.body[b])
            near = least_apart(self._space, route, a, b, begin, end)
            short = float(self.placed.clearance[bodies] - near)
            names = self.placed.piece_name(int(a)), self.placed.piece_name(int(b))
            names_of = self.scene.bodies[bodies[0]].name, self.scene.bodies[bodies[1]].name
            q = tuple(positions_at(route, float(begin)).tolist())
            hit = Hit(int(lines[cell]), names, names_of, max(short, 0.0), float(begin), q)
            self._last[bodies] = self._last[bodies[::-1]] = hit
            hits.append(hit)
        return hits


def certificates_of(found: Found) -> Certificates:
    count, hits = len(found.span), len(found.hit)
    return Certificates(
        np.concatenate([found.span[:, 0], found.hit[:, 0]]),
        np.concatenate([found.span[:, 1], found.hit[:, 1]]),
        np.concatenate([found.pair, found.hit_pair]),
        np.concatenate([found.normal, np.zeros((hits, 3))]),
        np.arange(count + hits) >= count,
        np.concatenate([np.zeros((count, 6)), found.hit[:, 3:]]),
    )


def touching_text(scene: Scene, hit: Hit) -> str:
    one, other = hit.bodies
    return (
        f'{scene.source}: {one} and {other} are too close before anything moves '
        f'({hit.short / MM:.3g} mm short); move one of them or the axes, or add '
        f'[{one}, {other}] to ignore'
    )
