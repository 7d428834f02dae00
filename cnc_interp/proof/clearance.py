"""The proof of ``collision.npz``: it checks every certificate and hit, and that none is missing.

A certificate states that two pieces keep apart along n in an interval. ``clearance_bound.py``
computes the gap again, with its own enclosure of the path and its own bound.

Certificates must cover the whole motion for every pair of bodies that can meet. Where a pair of
pieces has no certificate, the pairs of their parts must have one. Only the rest of a line after a
hit is exempt, and a plan with hits is not proven.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.collision.scene import Placed, Role
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.machine_model.links import joints_of
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import Signals
from cnc_interp.proof.clearance_bound import (
    Cells,
    Links,
    Solids,
    certified,
    frames,
    joints_of_pair,
    place,
)
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.verdict import Ledger

#: Tolerances for rounding: of the distance in a hit against the clearance, of its witness points
#: against their pieces, and of the gap of a certificate [m].
TOUCH, ON_PIECE, ROUNDED = 1.1e-6, 1e-8, 1e-10
MOST_TOLD = 20  #: Largest number of faults of one kind in a report.
TOOL_OUTPUTS = ('tool_number', 'tool')  #: Outputs of M6, with a tool changer or by hand.
Spans = list[tuple[float, float]]


@dataclass(frozen=True)
class Motion:
    """The motion of a plan, and the placed bodies that it moves."""

    ledger: Ledger
    placed: Placed
    cells: Cells
    links: Links

    def spans_where(self, holds: BoolArray) -> Spans:
        """Return the intervals of path length [m] of cells where ``holds``, (N - 1,), is true."""
        edges = np.flatnonzero(np.diff(holds.astype(np.int8), prepend=0, append=0))
        s = self.cells.s
        return [(float(s[a]), float(s[b])) for a, b in edges.reshape(-1, 2)]

    def axes_at(self, s: float) -> FloatArray:
        q = np.empty(self.cells.left.shape[2])
        place(self.cells, s, q)
        return q

    def frames_at(self, s: float) -> tuple[FloatArray, FloatArray]:
        count = len(self.links.parent)
        turn, origin = np.empty((count, 3, 3)), np.empty((count, 3))
        frames(self.links, self.axes_at(s), turn, origin)
        return turn, origin

    def line_at(self, s: float) -> tuple[int, float]:
        """Return the program line executed at path length ``s``, and where it ends [m]."""
        plan = self.ledger.plan
        cell = int(np.searchsorted(self.cells.s, s, 'right')) - 1
        rows = np.asarray(plan.path['block'])[: len(self.cells.s) - 1]
        lines = plan.blocks['line'][rows]
        other = np.flatnonzero(lines[cell:] != lines[cell])
        end = len(lines) if not len(other) else cell + int(other[0])
        return int(lines[cell]), float(self.cells.s[end])


def prove_clearance(ledger: Ledger, machine: Machine) -> Motion | None:
    """Prove that the bodies of the scene keep their clearances in the whole motion of a plan.

    Return the motion if a stock is cut along it; ``stock.py`` then proves the stock.
    """
    plan = ledger.plan
    file, found = plan.settings.get('scene'), plan.collision
    if not file:
        ledger.require(not found, 'collision.npz belongs to a scene, but summary.json names none')
        return None
    if not plan.path:
        return None
    if not found:
        ledger.fail(f'collision.npz is missing, but the plan names the scene {file}; plan again')
        return None
    scene = read_scene(Path(str(file)), str(plan.summary.get('setup') or ''))
    placed = Placed.of(scene, machine)
    path = plan.path
    cells = Cells(*(np.asarray(path[name]) for name in ('s', 'cell_left', 'cell_right')))
    motion = Motion(ledger, placed, cells, links_of(machine))
    pieces = placed.pieces
    count = len(pieces.round)
    pair = found['pair']
    known = ((pair >= 0) & (pair < count)).all(axis=1) & (found['begin'] < found['end'])
    ledger.require(known.all(), 'collision.npz names pieces or intervals that do not exist')
    if not known.all():
        return None
    ledger.require(_tree_is_sound(placed), 'a box of a mesh does not contain its triangles')
    sound = _certificates(motion, found)
    excused = _hits(motion, found)
    _cover(motion, found, sound, excused)
    return motion if scene.grid and scene.tools else None


def links_of(machine: Machine) -> Links:
    joints = joints_of(machine)
    names = [joints[0].parent, *(joint.child for joint in joints)]
    return Links(
        np.array([-1, *(names.index(joint.parent) for joint in joints)]),
        np.array([-1, *(joint.axis for joint in joints)]),
        np.array([False, *(joint.kind in ('revolute', 'continuous') for joint in joints)]),
        np.array([(0.0, 0.0, 0.0), *(joint.origin for joint in joints)]),
        np.array([(0.0, 0.0, 1.0), *(joint.along for joint in joints)]),
        np.array([np.eye(3), *(joint.turn for joint in joints)]),
    )


def _tree_is_sound(placed: Placed) -> bool:
    """Return whether every piece with parts is an axis-aligned box that contains them."""
    pieces = placed.pieces
    reach = pieces.disc[:, 3:] * np.sqrt(
        np.maximum(1.0 - np.repeat(pieces.along, np.diff(pieces.first), axis=0) ** 2, 0.0)
    )
    grown = pieces.round[:, None]
    low = np.minimum.reduceat(pieces.disc[:, :3] - reach, pieces.first[:-1]) - grown
    high = np.maximum.reduceat(pieces.disc[:, :3] + reach, pieces.first[:-1]) + grown
    for k in np.flatnonzero(pieces.child[:, 0] >= 0):
        corners = pieces.disc[pieces.first[k] : pieces.first[k + 1]]
        wanted = {tuple(np.where([i & 1, i & 2, i & 4], high[k], low[k])) for i in range(8)}
        box = wanted <= {tuple(corner) for corner in corners[:, :3]}
        parts = pieces.child[k]
        inside = (low[parts] >= low[k]).all() and (high[parts] <= high[k]).all()
        if not box or not inside or (pieces.body[parts] != pieces.body[k]).any():
            return False
    return True


def _certificates(motion: Motion, found: Mapping[str, Any]) -> BoolArray:
    """Return which certificates hold, (m,); report the others as failures."""
    ledger, placed = motion.ledger, motion.placed
    pieces, hit = placed.pieces, np.asarray(found['hit'], dtype=np.bool_)
    span = np.column_stack([found['begin'], found['end']])
    s = motion.cells.s
    inside = (span[:, 0] >= s[0]) & (span[:, 1] <= s[-1])
    rows = np.flatnonzero(~hit & inside)
    rows = rows[np.lexsort((span[rows, 1], span[rows, 0]))]
    length = np.linalg.norm(found['normal'], axis=1)
    normal = found['normal'] / np.where(length > 0.5, length, 1.0)[:, None]
    solids = Solids(*(getattr(pieces, name) for name in Solids._fields))
    apart = certified(solids, motion.links, motion.cells, span, found['pair'], normal, rows)
    bodies = pieces.body[found['pair']]
    wanted = placed.clearance[bodies[:, 0], bodies[:, 1]]
    sound = np.zeros(len(hit), dtype=np.bool_)
    sound[rows] = (apart[rows] >= wanted[rows] + ROUNDED) & (length[rows] > 0.5)
    wrong = rows[~sound[rows]]
    for row in wrong[:MOST_TOLD]:
        line, _ = motion.line_at(float(span[row, 0]))
        one, other = (placed.piece_name(int(k)) for k in found['pair'][row])
        ledger.fail(f'line {line}: a certificate of {one} and {other} does not hold')
    if len(wrong) > MOST_TOLD:
        ledger.fail(f'{len(wrong)} certificates in all do not hold')
    return sound


def _hits(motion: Motion, found: Mapping[str, Any]) -> dict[tuple[int, int], Spans]:
    """Report every hit as a failure; return where each pair of bodies needs no certificate."""
    ledger, placed = motion.ledger, motion.placed
    pieces = placed.pieces
    excused: dict[tuple[int, int], Spans] = {}
    for row in np.flatnonzero(found['hit']):
        a, b = (int(k) for k in found['pair'][row])
        begin = float(found['begin'][row])
        if not motion.cells.s[0] <= begin < motion.cells.s[-1]:
            ledger.fail('collision.npz has a hit that is not on the path')
            continue
        turn, origin = motion.frames_at(begin)
        points = found['witness'][row].reshape(2, 3)
        places = [
            turn[link] @ point + origin[link]
            for link, point in zip((pieces.link[a], pieces.link[b]), points, strict=True)
        ]
        bodies = int(pieces.body[a]), int(pieces.body[b])
        grown = pieces.round[a] + pieces.round[b]
        distance = float(np.linalg.norm(places[0] - places[1])) - grown
        beside = max(_off(pieces, k, point) for k, point in zip((a, b), points, strict=True))
        line, end = motion.line_at(begin)
        one, other = placed.piece_name(a), placed.piece_name(b)
        if distance > placed.clearance[bodies] + TOUCH or beside > ON_PIECE:
            ledger.fail(f'line {line}: the hit of {one} and {other} is not proven')
            continue
        if not stock_is_cut(placed, *bodies):  # ``stock.py`` checks the remaining stock there
            ledger.fail(f'hit: line {line}, {one} and {other}')
        for key in (bodies, bodies[::-1]):
            excused.setdefault(key, []).append((begin, end))
    return excused


def stock_is_cut(placed: Placed, a: int, b: int) -> bool:
    """Return whether one of two bodies is a stock that is cut along the path."""
    roles = {placed.scene.bodies[k].role for k in (a, b)}
    return Role.STOCK in roles and bool(placed.scene.tools)


def _off(pieces: Any, piece: int, point: FloatArray) -> float:
    """Return the distance of a point from a piece, ignoring its rounding radius [m]."""
    from scipy.optimize import nnls

    discs = pieces.disc[pieces.first[piece] : pieces.first[piece + 1]]
    corners = discs[:, :3] - point
    if discs[:, 3].any():  # discs on one axis: in the half plane of the point
        along, foot = pieces.along[piece], discs[0, :3]
        arm = point - foot
        height = arm @ along
        across = np.linalg.norm(arm - height * along)
        up = (discs[:, :3] - foot) @ along
        corners = np.concatenate(
            [np.column_stack([up - height, side * discs[:, 3] - across]) for side in (-1.0, 1.0)]
        )
    scale = max(float(np.abs(corners).max()), 1e-9)
    rows = np.vstack([corners.T / scale, np.ones(len(corners))])
    weights, _ = nnls(rows, np.append(np.zeros(len(rows) - 1), 1.0), maxiter=50 * len(corners))
    return float(np.linalg.norm(weights @ corners) / max(weights.sum(), 1e-9))


def _pairs(motion: Motion) -> Iterator[tuple[int, int, Spans]]:
    """Yield the pairs of bodies that must keep apart, with the intervals where they must [m]."""
    scene, links, plan = motion.placed.scene, motion.links, motion.ledger.plan
    numbers = [motion.placed.names.index(body.link) for body in scene.bodies]
    rows = np.asarray(plan.path['block'])[:-1]
    rapid = np.asarray(plan.blocks['rapid'], dtype=np.bool_)[rows]
    tool = tools_at(plan, motion.ledger.machine.signals, scene.first_tool, rows)
    unknown = sorted({int(t) for t in tool} - {0, *scene.tools})
    motion.ledger.require(not unknown, f'the scene has no body of the tools {unknown}')
    spare = np.empty(len(links.parent), np.int64), np.empty(len(links.parent))
    for a, b in combinations(range(len(scene.bodies)), 2):
        one, other = scene.bodies[a], scene.bodies[b]
        if (one.tool and other.tool) or frozenset((one.name, other.name)) in scene.ignored:
            continue
        if not joints_of_pair(links, numbers[a], numbers[b], *spare):
            continue
        there = np.ones(len(rows), dtype=np.bool_)
        if owner := one.tool or other.tool:
            there &= tool == owner
        if {one.role, other.role} == {Role.CUTTER, Role.STOCK}:
            there &= rapid
        yield a, b, motion.spans_where(there)


def tools_at(plan: PlanFiles, signals: Signals, first: int, rows: IntArray) -> IntArray:
    """Return the tool number in the spindle at program rows; ``first``: before the first M6."""
    steps, names = signals.steps, [output.name for output in signals.outputs]
    tool = np.full(len(rows), first)
    columns = (plan.functions[name] for name in ('block', 'step', 'value'))
    for block, step, value in zip(*columns, strict=True):
        if names[steps[step].output] in TOOL_OUTPUTS:
            tool[rows >= block] = int(value)
    return tool


def _cover(
    motion: Motion,
    found: Mapping[str, Any],
    sound: BoolArray,
    excused: dict[tuple[int, int], Spans],
) -> None:
    """Require that certificates or hits cover every pair of bodies, down to their leaves."""
    placed, ledger = motion.placed, motion.ledger
    by_pair: dict[tuple[int, int], Spans] = {}
    for row in np.flatnonzero(sound):
        a, b = (int(k) for k in found['pair'][row])
        span = float(found['begin'][row]), float(found['end'][row])
        for key in ((a, b), (b, a)):
            by_pair.setdefault(key, []).append(span)
    for a, b, needed in _pairs(motion):
        left = _left(needed, excused.get((a, b), []))
        for begin, _ in needed:
            if not stock_is_cut(placed, a, b) and _inside(motion, a, b, begin):
                names = f'{placed.scene.bodies[a].name} or {placed.scene.bodies[b].name}'
                ledger.fail(f'{names} is inside the other body at {begin:.6g} m')
        waiting = [(p, q, left) for p in placed.roots(a) for q in placed.roots(b) if left]
        while waiting:
            p, q, open_spans = waiting.pop()
            rest = _left(open_spans, by_pair.get((p, q), []))
            if not rest:
                continue
            parts = _parts(placed, p, q)
            if not parts:
                line, _ = motion.line_at(rest[0][0])
                one, other = placed.piece_name(p), placed.piece_name(q)
                ledger.fail(f'line {line}: nothing proves that {one} and {other} keep apart')
                break
            waiting += [(*both, rest) for both in parts]


def _parts(placed: Placed, p: int, q: int) -> list[tuple[int, int]]:
    """Return the pairs of pieces after dividing the larger one; dividing either is sound."""
    child, ball = placed.pieces.child, placed.pieces.ball
    if child[p, 0] < 0 and child[q, 0] < 0:
        return []
    if child[p, 0] < 0 or (child[q, 0] >= 0 and ball[q, 3] > ball[p, 3]):
        return [(p, int(part)) for part in child[q]]
    return [(int(part), q) for part in child[p]]


def _left(needed: Spans, given: Spans) -> Spans:
    """Return the parts of sorted, disjoint intervals ``needed`` that ``given`` does not cover."""
    merged: list[list[float]] = []
    for low, high in sorted(given):
        if merged and low <= merged[-1][1]:
            merged[-1][1] = max(merged[-1][1], high)
        else:
            merged.append([low, high])
    left, k = [], 0
    for begin, end in needed:
        at = begin
        while k < len(merged) and merged[k][1] <= at:
            k += 1
        i = k
        while i < len(merged) and merged[i][0] < end:
            if merged[i][0] > at:
                left.append((at, merged[i][0]))
            at, i = max(at, merged[i][1]), i + 1
        if at < end:
            left.append((at, end))
    return left


def _inside(motion: Motion, a: int, b: int, s: float) -> bool:
    """Return whether one body lies inside the mesh of the other at path length ``s``."""
    placed, bodies = motion.placed, motion.placed.scene.bodies
    for one, other in ((a, b), (b, a)):
        mesh = bodies[one].triangles
        if mesh is None:
            continue
        turn, origin = motion.frames_at(s)
        links = [placed.names.index(bodies[k].link) for k in (one, other)]
        leaf = next(k for k, child in enumerate(bodies[other].child) if child[0] < 0)
        point = turn[links[1]] @ bodies[other].pieces[leaf].discs[0, :3] + origin[links[1]]
        point = turn[links[0]].T @ (point - origin[links[0]])
        if _crossings(mesh, point) % 2:
            return True
    return False


def _crossings(mesh: FloatArray, point: FloatArray) -> int:
    """Count the triangles that a ray from a point crosses."""
    ray = np.array([0.5377, 0.6180, 0.5736])
    edge, other = mesh[:, 1] - mesh[:, 0], mesh[:, 2] - mesh[:, 0]
    across = np.cross(ray, other)
    size_of = np.einsum('ij,ij->i', edge, across)
    arm = point - mesh[:, 0]
    with np.errstate(divide='ignore', invalid='ignore'):
        u = np.einsum('ij,ij->i', arm, across) / size_of
        turned = np.cross(arm, edge)
        v = turned @ ray / size_of
        way = np.einsum('ij,ij->i', other, turned) / size_of
    return int(((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (way > 0.0)).sum())
