"""A scene: bodies of machine, fixtures, stock and tools, and the pairs of them to check."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.collision.link_poses import Chain, chain_of, step_table, steps_between
from cnc_interp.collision.mesh_file import SceneError
from cnc_interp.collision.shapes import Piece, Pieces, gathered
from cnc_interp.core import FloatArray, IntArray
from cnc_interp.machine_model.machine import Machine


class Role(IntEnum):
    BODY = 0  # of the machine, or a fixture
    STOCK = 1
    CUTTER = 2  # the part of a tool that cuts
    SHANK = 3
    HOLDER = 4
    PART = 5  # the shape that the stock must get


@dataclass(frozen=True)
class Body:
    name: str
    link: str  #: Link of the machine that carries it.
    role: Role
    pieces: tuple[Piece, ...]  #: Its pieces in the frame of the link, parents before children.
    child: IntArray  #: (n, 2): The two children of each piece in the tree; -1 for a leaf.
    roots: tuple[int, ...]  #: Pieces without a parent.
    tool: int = 0  #: Number of the tool that it belongs to; 0 if it is always present.
    triangles: FloatArray | None = None  #: (m, 3, 3): Closed surface of a mesh [m].

    def piece_name(self, piece: int) -> str:
        """Return the name of a piece: that of the body, with a number if it has several roots."""
        if len(self.roots) == 1 or self.role is Role.CUTTER:
            return self.name
        return f'{self.name} cone {self.roots.index(piece) + 1}'

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and the highest corner of a box around it [m]."""
        ends = []
        for discs, along, rounded in self.pieces:
            reach = discs[:, 3:] * np.sqrt(np.maximum(1.0 - along**2, 0.0)) + rounded
            ends += [discs[:, :3] - reach, discs[:, :3] + reach]
        return np.concatenate(ends).min(axis=0), np.concatenate(ends).max(axis=0)


@dataclass(frozen=True)
class Scene:
    source: Path  #: File that describes it.
    bodies: tuple[Body, ...]
    #: Smallest allowed distances [m]: ``default``, and by pairs of roles, as ``holder_stock``.
    clearances: dict[str, float]
    ignored: frozenset[frozenset[str]]  #: Pairs of names that may touch.
    tools: tuple[int, ...]  #: Numbers of the tools that have a body.
    first_tool: int  #: Tool in the spindle before the first tool change; 0 if unknown.
    #: Holders by name, rows [height, radius] from the lower end of the spindle up [mm].
    holders: Mapping[str, Any] = field(default_factory=dict)
    files: tuple[Path, ...] = ()  #: Meshes that belong to it, and the scene that it includes.
    grid: float = 0.0  #: Width of the cells in which the stock is cut [m]; 0 without a stock.
    #: The finished part, against which the stock is compared; it never collides.
    part: Body | None = None

    def content(self) -> list[bytes]:
        """Return the content of all files of the scene."""
        return [file.read_bytes() for file in (self.source, *self.files) if file.is_file()]

    def clearance(self, a: Body, b: Body) -> float:
        words = [role.name.lower() for role in (a.role, b.role)]
        keys = ('_'.join(words), '_'.join(reversed(words)), 'default')
        return next(self.clearances[key] for key in keys if key in self.clearances)

    def watched(self, chain: Chain, names: tuple[str, ...]) -> Iterator[tuple[int, int]]:
        """Yield the pairs of bodies to check: all pairs that can move towards each other."""
        links = [names.index(body.link) for body in self.bodies]
        for a, b in combinations(range(len(self.bodies)), 2):
            one, other = self.bodies[a], self.bodies[b]
            apart = not (one.tool and other.tool)
            apart &= frozenset((one.name, other.name)) not in self.ignored
            if apart and steps_between(chain, links[a], links[b]):
                yield (b, a) if other.tool else (a, b)  # the tool is named first

    def in_feed(self, a: int, b: int) -> bool:
        """Return whether a pair is checked in feed moves: every pair but the cutter and stock."""
        roles = {self.bodies[a].role, self.bodies[b].role}
        return roles != {Role.CUTTER, Role.STOCK}


@dataclass(frozen=True)
class Placed:
    """A scene on a machine, as arrays; piece numbers are those of ``collision.npz``."""

    scene: Scene
    chain: Chain
    names: tuple[str, ...]  #: Names of the links.
    pieces: Pieces
    first: tuple[int, ...]  #: Number of each body's first piece, then the number of all pieces.
    pairs: tuple[tuple[int, int], ...]  #: Pairs of bodies to check.
    clearance: FloatArray  #: (bodies, bodies): Smallest allowed distance [m].

    @staticmethod
    def of(scene: Scene, machine: Machine) -> Placed:
        chain, names = chain_of(machine)
        for body in scene.bodies:
            if body.link not in names:
                why = f'machine {machine.name} has no link {body.link!r}'
                links = ', '.join(names)
                raise SceneError(f'{scene.source}: {body.name}: {why}; its links are {links}')
        counts = [len(body.pieces) for body in scene.bodies]
        first = tuple(np.cumsum([0, *counts]).tolist())
        children = [
            np.where(body.child >= 0, body.child + start, -1)
            for body, start in zip(scene.bodies, first, strict=False)
        ]
        pieces = gathered(
            [piece for body in scene.bodies for piece in body.pieces],
            np.concatenate(children),
            np.repeat(np.arange(len(counts)), counts),
            np.repeat([names.index(body.link) for body in scene.bodies], counts),
        )
        clearance = np.array([[scene.clearance(a, b) for b in scene.bodies] for a in scene.bodies])
        pairs = tuple(scene.watched(chain, names))
        return Placed(scene, chain, names, pieces, first, pairs, clearance)

    def steps(self) -> tuple[IntArray, FloatArray, IntArray]:
        return step_table(self.chain)

    def roots(self, body: int) -> list[int]:
        return [self.first[body] + root for root in self.scene.bodies[body].roots]

    def piece_name(self, piece: int) -> str:
        body = int(self.pieces.body[piece])
        return self.scene.bodies[body].piece_name(piece - self.first[body])

    def with_tool(self, tool: int) -> list[tuple[int, int]]:
        """Return the pairs of bodies that exist with a tool in the spindle."""
        there = [body.tool in (0, tool) for body in self.scene.bodies]
        return [(a, b) for a, b in self.pairs if there[a] and there[b]]
