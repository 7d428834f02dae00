"""
Compensated paths against exact geometry: contours (G41, G42), and contact normals (G41.2).

``PYTHONPATH=. python benchmarks/compensated_paths.py`` prints the figures of
``docs/operate/programs.md``. Contours consist of lines and arcs; this script computes all
distances from them by closed formulas. It shares no code with the program reader.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.settings.options import Settings

Points = NDArray[np.float64]
MM = 1e-3
XYZ = Transform.of(Machine.load('xyz'))
MACHINES = (
    'xyzac',
    'xyzbc',
    'bc_trunnion',
    'head_head',
    'head_table',
    'xyzac_trt',
    'xyzbc_trt',
    'xyzacw',
)
#: Cutters: radius of the circle of the corner, and of the corner [mm].
CUTTERS = {'ball': (0.0, 5.0), 'fillet': (4.0, 1.0), 'flat end': (5.0, 0.0)}


# --- contours ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Edge:
    """A line, or an arc about a centre by an angle (counter-clockwise positive) [mm, rad]."""

    start: complex
    end: complex
    centre: complex = 0j
    sweep: float = 0.0

    def points(self, count: int, left: float) -> NDArray[np.complex128]:
        """Return points of the edge, moved to its left."""
        share = np.linspace(0.0, 1.0, count)
        if not self.sweep:
            along = (self.end - self.start) / abs(self.end - self.start)
            return self.start + share * (self.end - self.start) + 1j * along * left
        arm = (self.start - self.centre) * np.exp(1j * share * self.sweep)
        return self.centre + arm * (1.0 - np.sign(self.sweep) * left / abs(arm))

    def distance(self, z: NDArray[np.complex128]) -> Points:
        """Return the distance of points from the edge."""
        near = np.minimum(abs(z - self.start), abs(z - self.end))
        if not self.sweep:
            along = (self.end - self.start) / abs(self.end - self.start)
            local = (z - self.start) * np.conj(along)
            beside = (local.real > 0) & (local.real < abs(self.end - self.start))
            return np.where(beside, np.minimum(abs(local.imag), near), near)
        turned = np.angle((z - self.centre) / (self.start - self.centre)) * np.sign(self.sweep)
        beside = turned % (2 * np.pi) <= abs(self.sweep)
        round_it = abs(abs(z - self.centre) - abs(self.start - self.centre))
        return np.where(beside, np.minimum(round_it, near), near)

    def word(self) -> str:
        """Return the block to the end of the edge."""
        place = f'X{self.end.real:.9f} Y{self.end.imag:.9f}'
        if not self.sweep:
            return f'G1 {place}'
        arm = self.centre - self.start
        code = 'G3' if self.sweep > 0 else 'G2'
        return f'{code} {place} I{arm.real:.9f} J{arm.imag:.9f}'


def polygon(corners: list[complex]) -> list[Edge]:
    """Return a closed contour of lines that begins in the middle of its first one."""
    middle = 0.5 * (corners[0] + corners[1])
    ring = [middle, *corners[1:], corners[0], middle]
    return [Edge(a, b) for a, b in pairwise(ring)]


def rounded(corners: list[complex], radius: float) -> list[Edge]:
    """Return the contour with arcs at its corners."""
    edges: list[Edge] = []
    count, at = len(corners), 0.5 * (corners[0] + corners[1])
    begin = at
    for k in range(1, count + 1):
        before, here, after = (corners[(k + i) % count] for i in (-1, 0, 1))
        u, v = ((b - a) / abs(b - a) for a, b in ((before, here), (here, after)))
        turn = float(np.angle(v / u))
        cut = radius * np.tan(0.5 * abs(turn))
        first, last = here - cut * u, here + cut * v
        edges += [
            Edge(at, first),
            Edge(first, last, first + 1j * np.sign(turn) * radius * u, turn),
        ]
        at = last
    return [*edges, Edge(at, begin)]


def star(count: int, inner: float, outer: float) -> list[complex]:
    """Return corners in turn at two distances."""
    at = np.exp(1j * np.pi * np.arange(2 * count) / count)
    return list(at * np.where(np.arange(2 * count) % 2, inner, outer))


def random_corners(rng: np.random.Generator) -> list[complex]:
    """Return the corners of a simple polygon about zero, counter-clockwise."""
    count = int(rng.integers(4, 12))
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(-0.3, 0.3, count)) / count
    return list(rng.uniform(15, 40, count) * np.exp(1j * angle))


def compensated(
    edges: list[Edge], code: str, radius: float, tolerance: float
) -> NDArray[np.complex128]:
    """Return the path of the tool centre beside a contour, as the reader of programs makes it."""
    left = radius if code == 'G41' else -radius
    first = edges[0].points(2, 3 * left)[0]
    lines = [
        'G21 G90 G17',
        f'G0 X{first.real:.9f} Y{first.imag:.9f} Z0',
        f'{code} D1',
        f'G1 X{edges[0].start.real:.9f} Y{edges[0].start.imag:.9f} F1000',
        *(edge.word() for edge in edges),
        'G40',
        f'G0 X{first.real:.9f} Y{first.imag:.9f}',
    ]
    setup = JobSetup(tools={1: Tool(0.0, radius * MM)})
    settings = Settings(contour_tolerance=tolerance * MM)
    blocks = read_text('\n'.join(lines), 'contour.nc', XYZ, settings, setup).blocks
    rows = np.flatnonzero((blocks.line_number >= 4) & (blocks.line_number < 5 + len(edges)))
    return (blocks.tip[rows, 0] + 1j * blocks.tip[rows, 1]) / MM


def compared(edges: list[Edge], code: str, radius: float, tolerance: float) -> tuple[float, float]:
    """Return the largest distance of the path from the exact offset, and of that from the path."""
    path = compensated(edges, code, radius, tolerance)
    share = np.linspace(0.0, 1.0, 41)
    dense = np.concatenate([a + share * (b - a) for a, b in pairwise(path)])
    gap = np.min([edge.distance(dense) for edge in edges], axis=0) - radius
    left = radius if code == 'G41' else -radius
    exact = np.concatenate([edge.points(400, left) for edge in edges])
    free = np.min([edge.distance(exact) for edge in edges], axis=0) > radius - 1e-9
    chords = [Edge(a, b) for a, b in pairwise(path) if abs(b - a) > 1e-12]
    missed = np.min([chord.distance(exact[free]) for chord in chords], axis=0)
    return float(np.abs(gap).max()), float(missed.max())


def contours(count: int) -> None:
    """Print the table of contours, with so many random ones."""
    square = [complex(x, y) for x, y in ((0, 0), (60, 0), (60, 40), (0, 40))]
    shapes = {
        'rectangle': polygon(square),
        'rectangle, corners of radius 8': rounded(square, 8.0),
        'star of ten corners': polygon(star(5, 25.0, 45.0)),
        'star, corners of radius 6': rounded(star(5, 25.0, 45.0), 6.0),
    }
    print('| contour | code, radius | path from the exact offset, mm | offset from the path, mm |')
    print('|---|---|--:|--:|')
    for name, edges in shapes.items():
        for code, radius in (('G42', 5.0), ('G41', 5.0), ('G41', 7.0)):
            try:
                errors = [f'{value:.1e}' for value in compared(edges, code, radius, 0.02)]
            except ProgramError as why:
                errors = [f'refused: {why.message.split(";")[0]}', '']
            print(f'| {name} | {code}, {radius:g} | {errors[0]} | {errors[1]} |')
    random_contours(count, on_grid=False)
    random_contours(count, on_grid=True)


def random_contours(count: int, on_grid: bool) -> None:
    """Print a row of random contours; on a grid of the radius edges are as long as it."""
    rng, worst, refused, wrong = np.random.default_rng(23), [0.0, 0.0], 0, 0
    for number in range(count):
        corners, radius = random_corners(rng), float(rng.uniform(0.5, 6.0))
        if on_grid:
            corners = [
                radius * complex(round(z.real / radius), round(z.imag / radius)) for z in corners
            ]
            corners = [z for i, z in enumerate(corners) if z not in corners[:i]]
        arc = radius * rng.choice([0.5, 1.0, 1.0 + 1e-9, 1.1]) if on_grid else 0.8
        edges = polygon(corners) if number % 2 else rounded(corners, arc)
        edges = [edge for edge in edges if abs(edge.end - edge.start) > 1e-9]
        code = 'G41' if number % 3 else 'G42'
        try:
            worst = list(np.maximum(worst, compared(edges, code, radius, 0.02)))
        except ProgramError:
            refused += 1
            wrong += not on_grid and fits(edges, code, radius)
    kind = 'on a grid of the radius' if on_grid else 'random ones'
    print(
        f'| {count} {kind}, {refused} of them refused | G41, G42, 0.5 to 6 | {worst[0]:.1e} | '
        f'{worst[1]:.1e} |'
    )
    print(f'\nRefused although the cutter can touch all edges: {wrong}.' * (not on_grid))


def fits(edges: list[Edge], code: str, radius: float) -> bool:
    """Tell whether a cutter can touch each edge somewhere without cutting into another one."""
    left = radius if code == 'G41' else -radius
    for edge in edges:
        inside = edge.sweep * left > 0 and abs(edge.start - edge.centre) < radius
        places = edge.points(400, left)
        if (
            inside
            or not (np.min([e.distance(places) for e in edges], axis=0) > radius - 1e-9).any()
        ):
            return False
    return True


# --- contact normals -----------------------------------------------------------------------------


def sphere(step: float) -> tuple[Points, Points]:
    """Return contact points and normals on a sphere of radius 20 about 0, 0, -20."""
    tilt = np.radians(np.arange(10.0, 50.0 + 1e-9, step))
    turn = 1.5 * tilt
    n = np.stack([np.sin(tilt) * np.sin(turn), np.sin(tilt) * np.cos(turn), np.cos(tilt)], axis=1)
    return 20.0 * n - [0, 0, 20], n


def cylinder(step: float) -> tuple[Points, Points]:
    """Return contact points and normals along a cylinder of radius 15 about Y."""
    turn = np.radians(np.arange(-40.0, 40.0 + 1e-9, step))
    n = np.stack([np.sin(turn), 0.0 * turn, np.cos(turn)], axis=1)
    return 15.0 * n + np.stack([0 * turn, 10 * turn, 0 * turn - 15], axis=1), n


def plane(step: float) -> tuple[Points, Points]:
    """Return contact points and normals along a plane that is tilted by 30 deg."""
    along = np.arange(0.0, 80.0 + 1e-9, step)
    n = np.tile([np.sin(np.radians(30)), 0.0, np.cos(np.radians(30))], (len(along), 1))
    x = np.stack([np.cos(np.radians(30)) + 0 * along, 0 * along, -0.5 + 0 * along], axis=1)
    return 0.2 * along[:, None] * x + 0.1 * along[:, None] * [0.0, 1.0, 0.0], n


def height(surface: str, places: Points) -> Points:
    """Return the height of points over a surface [mm]."""
    if surface == 'sphere':
        return np.asarray(np.linalg.norm(places + [0, 0, 20], axis=-1) - 20.0)
    if surface == 'cylinder':
        return np.asarray(np.hypot(places[..., 0], places[..., 2] + 15) - 15.0)
    return np.asarray(places @ [np.sin(np.radians(30)), 0.0, np.cos(np.radians(30))])


def lowest(surface: str, tip: Points, axis: Points, cutter: tuple[float, float]) -> float:
    """Return the height of the lowest point of a cutter over a surface [mm]."""
    ring, corner = cutter
    across = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    across /= np.linalg.norm(across)
    turn, width = 0.0, np.pi
    for _ in range(9):  # narrower and narrower about the lowest place
        turns = turn + np.linspace(-width, width, 101)
        circle = np.cos(turns)[:, None] * across + np.sin(turns)[:, None] * np.cross(axis, across)
        heights = height(surface, tip + corner * axis + ring * circle)
        turn, width = turns[np.argmin(heights)], width / 20
    return float(heights.min() - corner)


def touched(name: str, surface: str, cutter: str, step: float) -> tuple[float, float]:
    """Return the largest gap or gouge of a cutter, at block ends and on the way [mm]."""
    made = {'sphere': sphere, 'cylinder': cylinder, 'plane': plane}[surface](step)
    ring, corner = CUTTERS[cutter]
    letters = Machine.load(name).axis_names[3:5]
    lines = ['G21 G90', 'G0 X0 Y0 Z60', 'G43.4', 'F1000', f'G41.2 D1 R{corner}']
    for k, (point, normal) in enumerate(zip(*made, strict=True)):
        words = [f'{w}{v:.12f}' for w, v in zip('XYZIJK', [*point, *normal], strict=True)]
        share = k / max(len(made[0]) - 1, 1)
        lines.append(
            f'G1 {" ".join(words)} {letters[0]}{4 + 4 * share:.9f} '
            f'{letters[1]}{20 + 30 * share:.9f}'
        )
    setup = JobSetup(tools={1: Tool(0.0, (ring + corner) * MM)})
    geometry = Transform.of(Machine.load(name))
    blocks = read_text('\n'.join(lines), 'part.ngc', geometry, Settings(), setup).blocks
    ends = np.flatnonzero(np.diff(blocks.line_number, append=0))
    ends = ends[blocks.line_number[ends] > 5]
    errors = [
        abs(lowest(surface, blocks.tip[i] / MM, blocks.axis[i], CUTTERS[cutter])) for i in ends
    ]
    between = []
    for i in range(ends[0] + 1, len(blocks)):
        for share in (0.25, 0.5, 0.75):
            tip = (1 - share) * blocks.tip[i - 1] + share * blocks.tip[i]
            axis = (1 - share) * blocks.axis[i - 1] + share * blocks.axis[i]
            axis /= np.linalg.norm(axis)
            between.append(abs(lowest(surface, tip / MM, axis, CUTTERS[cutter])))
    return max(errors), max(between)


def normals() -> None:
    """Print the table of contact normals."""
    print('\n| surface, blocks | cutter | at block ends, mm | on the way, mm |')
    print('|---|---|--:|--:|')
    for surface, step in (('sphere', 1.0), ('cylinder', 1.0), ('plane', 1.0)):
        for cutter in CUTTERS:
            found = [touched(name, surface, cutter, step) for name in MACHINES]
            ends, way = np.max(found, axis=0)
            apart = '0.2 mm' if surface == 'plane' else '1 deg'
            print(f'| {surface}, {apart} apart | {cutter} | {ends:.1e} | {way:.1e} |')


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--count', type=int, default=300, help='random contours of each kind')
    contours(parser.parse_args().count)
    normals()
