"""
Clearances: random scenes with a known result, certificates, and programs with clamps.

    python benchmarks/collision.py --quick      # a seeded share of the scenes, at most two minutes
    python benchmarks/collision.py              # 1,000 hits, 1,000 clear scenes, four programs
    python benchmarks/collision.py --scenes 1000  # the scenes alone
    python benchmarks/collision.py --programs   # the programs alone
    python benchmarks/collision.py --stock      # volumes of the stock, and segments per second

A scene has two convex bodies on links of a machine, and a path on which all axes move. One body is
shifted until the smallest distance along the path, found by dense sampling, has a chosen value: 2
to 316 um below the clearance of 0.1 mm in scenes with a hit, as much above it in clear ones. In a
fifth of the hits it is only 0.5 to 2 um below, so that the stretch below the clearance is shorter
than 0.5 mm, which is one setpoint of 1 ms at 30 m/min. The second program
(``proof/clearance.py``) verifies every certificate.

Prints counts now and then, and a final line. The exit code is 0 only if no hit was missed, every
certificate holds, and at most 1 % of the clear scenes are reported as hits.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from argparse import ArgumentParser
from dataclasses import dataclass, field
from pathlib import Path

import numba
import numpy as np
from collision_cases import (
    distance,
    link_pose,
    moved,
    random_path,
    random_piece,
    route_of,
    space_of,
)

from cnc_interp.collision.clearance import descend
from cnc_interp.collision.cutting import CUT, in_field, pass_over
from cnc_interp.collision.enclosure import position
from cnc_interp.collision.hits import apart
from cnc_interp.collision.link_poses import pose_links
from cnc_interp.collision.mill_sweep import slabs_of
from cnc_interp.collision.motions import AXIS, MOTION, MOVE, TIP
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.collision.stock import field_of, volume
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.clearance import links_of
from cnc_interp.proof.clearance_bound import Cells, Solids, certified

ROOT = Path(__file__).resolve().parents[1]
SHARED = ROOT.parent / 'shared' / 'programs'
CLEARANCE = 1e-4
OFTEN = 400  #: Seeds between two lines of counts.
SHORT = 0.5e-3  #: The way of one setpoint at rapid [m].
LINKS = {
    'xyzac': [('tool_tip', 'workpiece'), ('z_slide', 'a_table'), ('tool_tip', 'base_link')],
    'head_head': [('tool_tip', 'workpiece'), ('a_head', 'base_link'), ('c_head', 'workpiece')],
    'head_table': [('tool_tip', 'workpiece'), ('b_head', 'c_table')],
    'xyzacw': [('tool_tip', 'workpiece'), ('c_table', 'w_slide')],
    'bc_trunnion': [('tool_tip', 'workpiece'), ('z_slide', 'b_table')],
}
BLOCK = """
stock: {link: workpiece, box_mm: {low: [-20, -20, -10], high: [20, 20, 0]}}
tools:
"""
CLAMPS = """
include: {machine}
bodies:
{clamps}
"""
#: A stock around the feeds of a program, for a ball mill that is long enough to reach all of it.
STOCKED = """
stock: {{link: workpiece, box_mm: {{low: {low}, high: {high}}}, grid_mm: 0.4}}
tools: {{1: {{diameter_mm: 6, corner_mm: 3, flute_mm: 45, holder_mm: [[150, 6], [200, 20]]}}}}
"""
#: Programs, their machines, and where six clamps lie around the part [mm].
PROGRAMS = {
    'impeller': (SHARED / 'linuxcnc-impeller-xyzac', 'xyzac', 55.0, -58.0, -25.0),
    'LHchips4': (SHARED / 'linuxcnc-lhchips4', 'xyzac_trt', 95.0, -55.0, -30.0),
    'pyramid': (ROOT / 'examples' / 'pyramid.apt', 'xyzac', 55.0, -58.0, -20.0),
    'first part': (ROOT / 'examples' / 'first_part.ngc', 'xyzac', 55.0, -58.0, -25.0),
}


@dataclass
class Counts:
    scenes: dict[str, int] = field(default_factory=lambda: dict.fromkeys(('hit', 'clear'), 0))
    wrong: dict[str, int] = field(default_factory=lambda: dict.fromkeys(('hit', 'clear'), 0))
    short: int = 0
    near: int = 0  #: Scenes within 5 um of the clearance.
    certificates: int = 0
    contradicted: int = 0
    intervals: list[int] = field(default_factory=list)

    def __str__(self):
        return (
            f'hits {self.scenes["hit"]}, {self.short} of them shorter than a setpoint, '
            f'missed {self.wrong["hit"]}; clear {self.scenes["clear"]}, '
            f'false {self.wrong["clear"]}; within 5 um {self.near}; '
            f'certificates {self.certificates}, contradicted {self.contradicted}; intervals '
            f'mean {np.mean(self.intervals):.0f}, most {max(self.intervals)}'
        )


@numba.njit
def distances(space, route, places):
    """Return the distance of pieces 0 and 1 at places of the path, below 0 where they overlap."""
    pose, rel = np.empty((len(space.chain.parent), 12)), np.empty(12)
    q, s, found = np.empty(route.bezier.shape[1]), route.s, np.empty(len(places))
    for k in range(len(places)):
        cell = max(min(np.searchsorted(s, places[k], 'right') - 1, len(s) - 2), 0)
        position(route.bezier, cell, (places[k] - s[cell]) / (s[cell + 1] - s[cell]), q)
        pose_links(space.chain, q, pose)
        found[k] = apart(space, 0, 1, pose, rel)
    return found


def lowest(machine, pieces, links, path, places=2000):
    """Return the place of the least distance, and the distance there [m]."""
    space, route = space_of(machine, list(pieces), links), route_of(path)
    begin, end = float(path.s[0]), float(path.s[-1])
    width = (end - begin) / (places - 1)

    def at(s):
        return distances(space, route, np.array([s]))[0]

    grid = np.linspace(begin, end, places)
    values = distances(space, route, grid)
    best = float('inf'), begin
    left, right = np.r_[np.inf, values[:-1]], np.r_[values[1:], np.inf]
    low = np.flatnonzero((values <= left) & (values <= right))
    for k in low[np.argsort(values[low])[:4]]:
        a, b = max(begin, grid[k] - width), min(end, grid[k] + width)
        for _ in range(40):  # golden section
            u, v = b - 0.618034 * (b - a), a + 0.618034 * (b - a)
            a, b = (a, v) if at(u) < at(v) else (u, b)
        best = min(best, (at(0.5 * (a + b)), 0.5 * (a + b)))
    return best[1], best[0]


def below(machine, pieces, links, path, s):
    """Return how long the stretch around a place is that lies below the clearance [m]."""
    space, route, ends = space_of(machine, list(pieces), links), route_of(path), []
    for sense in (-1.0, 1.0):
        step, way = 1e-5, 0.0
        while step < 1.0:
            at = s + sense * step
            if not path.s[0] < at < path.s[-1]:
                break
            if distances(space, route, np.array([at]))[0] >= CLEARANCE:
                break
            way, step = step, 1.5 * step
        ends.append(way)
    return sum(ends)


def scene(seed, hits):
    """Return a machine, two pieces, their links and a path with a least distance that is known."""
    rng = np.random.default_rng(seed)
    name = list(LINKS)[rng.integers(len(LINKS))]
    machine = Machine.load(name)
    links = LINKS[name][rng.integers(len(LINKS[name]))]
    short = hits and seed % 5 == 0
    for _ in range(20):
        path = random_path(rng, machine)
        one, other = random_piece(rng), random_piece(rng)
        s = rng.uniform(path.s[0], path.s[-1])
        (_, oa), (rb, ob) = (
            link_pose(machine, k, evaluate(path, np.array([s]))[0][0]) for k in links
        )
        way = rng.normal(size=3)
        way *= rng.uniform(0.05, 0.15) / np.linalg.norm(way)
        other = moved(other, rb.T @ (oa - ob) + way)
        off = 10.0 ** (rng.uniform(-6.3, -5.7) if short else rng.uniform(-5.7, -3.5))
        wanted = CLEARANCE - min(off, 0.9 * CLEARANCE) if hits else CLEARANCE + off
        for _ in range(12):
            s, least = lowest(machine, (one, other), links, path, 400)
            if least <= 0.0 or abs(least - wanted) < 1e-7:
                break
            q = evaluate(path, np.array([s]))[0][0]
            _, n = distance(machine, (one, other), links, q, with_normal=True)
            other = moved(other, (wanted - least) * n)
        s, least = lowest(machine, (one, other), links, path)
        if abs(least - wanted) < 5e-7:
            stretch = below(machine, (one, other), links, path, s) if hits else np.inf
            if not short or stretch < SHORT:
                return machine, (one, other), links, path, s, least, stretch
    return None


def judge(counts, seed, hits):
    made = scene(seed, hits)
    if made is None:
        return
    machine, pieces, links, path, s, least, stretch = made
    q = evaluate(path, np.array([s]))[0][0]
    assert abs(distance(machine, pieces, links, q) - least) < 1e-8, 'from both sides'
    space, route = space_of(machine, list(pieces), links, CLEARANCE), route_of(path)
    cells, pairs = (0, len(path.s) - 1), np.array([[0, 1]])
    found = descend(space, route, cells, pairs, np.full((2, 2), -np.inf), 1 << 16)
    kind = 'hit' if hits else 'clear'
    wrong = (len(found.hit) > 0) != hits
    counts.scenes[kind] += 1
    counts.wrong[kind] += wrong
    counts.short += hits and stretch < SHORT
    counts.near += abs(least - CLEARANCE) < 5e-6
    counts.intervals.append(int(found.effort[0]))
    if wrong:
        print(f'seed {seed}: {kind}, {least * 1e3:.6f} mm, decided wrongly', flush=True)
    solids = Solids(*(getattr(space.pieces, name) for name in Solids._fields))
    rows = np.lexsort((found.span[:, 1], found.span[:, 0]))
    grid = Cells(path.s, path.cell_left, path.cell_right)
    apart = certified(solids, links_of(machine), grid, found.span, found.pair, found.normal, rows)
    counts.certificates += len(rows)
    counts.contradicted += int((apart < CLEARANCE).sum())


def plan(program, machine, folder, *more):
    """Plan a program in a process of its own; return its summary, exit code and memory [MB]."""
    words = [sys.executable, '-m', 'cnc_interp', 'plan', str(program), '--machine', machine]
    words += ['--out', str(folder), '--workers', '1', *more]
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=ROOT)
    told = process.stderr.read().decode()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = code = os.waitstatus_to_exitcode(status)
    file = folder / 'summary.json'
    return (
        (json.loads(file.read_text()) if file.exists() else {}),
        code,
        used.ru_maxrss / 1024,
        told,
    )


def programs():
    print(f'{"program":<12}{"blocks":>8}{"pairs":>7}{"nodes":>8}{"certificates":>14}', end='')
    print(f'{"check s":>9}{"share":>8}{"memory MB":>11}{"proven":>8}{"hits 20 mm higher":>19}')
    for name, (source, machine, radius, low, high) in PROGRAMS.items():
        file = next(iter(sorted(source.glob('*.ngc'))), None) if source.is_dir() else source
        if file is None or not file.exists():
            print(f'{name:<12} left out: no folder shared beside the repository')
            continue
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            alone, _, memory, _ = plan(file, machine, folder / 'alone')
            scene_file = folder / 'scene.yaml'

            def clamped(rise, scene_file=scene_file, machine=machine, at=(radius, low, high)):
                boxes = []
                for k in range(6):
                    x, y = at[0] * np.cos(k * np.pi / 3), at[0] * np.sin(k * np.pi / 3)
                    ends = [
                        [round(x + s * 12, 3), round(y + s * 12, 3), z]
                        for s, z in ((-1, at[1]), (1, at[2] + rise))
                    ]
                    boxes.append(
                        f'  - {{name: clamp {k + 1}, link: workpiece, '
                        f'box_mm: {{low: {ends[0]}, high: {ends[1]}}}}}'
                    )
                scene_file.write_text(CLAMPS.format(machine=machine, clamps='\n'.join(boxes)))

            clamped(0.0)
            made, code, more, told = plan(
                file, machine, folder / 'plan', '--scene', str(scene_file), '--collision', 'warn'
            )
            if 'collision' not in made:
                print(f'{name:<12} exit code {code}: {told.strip().splitlines()[-1][:120]}')
                continue
            blocks = np.load(folder / 'alone' / 'blocks.npz')
            feeds = blocks['tip'][~blocks['rapid']] * 1e3
            low, high = feeds.min(axis=0) - [3.0, 3.0, 2.0], feeds.max(axis=0) + [3.0, 3.0, 0.5]
            stocked_file = folder / 'stocked.yaml'
            stocked_file.write_text(
                scene_file.read_text()
                + STOCKED.format(low=low.round(2).tolist(), high=high.round(2).tolist())
            )
            words = '--scene', str(stocked_file), '--collision', 'warn'
            stocked, _, memory_of_stock, _ = plan(file, machine, folder / 'stocked', *words)
            check = [sys.executable, '-m', 'cnc_interp', 'check', str(folder / 'plan')]
            proof = subprocess.run(check, capture_output=True, cwd=ROOT, check=False)
            clamped(20.0)
            higher, *_ = plan(
                file, machine, folder / 'high', '--scene', str(scene_file), '--collision', 'warn'
            )
            found, seconds = made['collision'], made['planning_time_by_room']
            hits = len(higher.get('collision', {}).get('hits', []))
            share = seconds['collision'] / alone['planning_time']
            verdict = 'yes' if proof.returncode == 0 else f'{len(found["hits"])} hits'
            print(
                f'{name:<12}{made["blocks"]:>8}{found["pairs"]:>7}{found["intervals"]:>8}'
                f'{found["certificates"]:>14}{seconds["collision"]:>9.3f}{share:>8.2%}'
                f'{more - memory:>+11.0f}{verdict:>8}{hits:>19}',
                flush=True,
            )
            rest = stocked['planning_time_by_room']['collision'] - seconds['collision']
            cut = stocked['collision']['stock']
            print(
                f'{"  with a stock":<30}{cut["pieces"]:>8} pieces{rest:>9.3f} s'
                f'{rest / alone["planning_time"]:>9.1%}{memory_of_stock - memory:>+11.0f} MB, '
                f'{cut["removed"] * 1e9:.0f} of {cut["volume"] * 1e9:.0f} mm3, {cut["hits"]} hits',
                flush=True,
            )


def stock():
    """Print volumes against closed forms, and how many segments of 1 mm a second are cut."""
    bodies = BLOCK + ''.join(
        f'  {number}: {{diameter_mm: 6, corner_mm: {corner}, flute_mm: 12}}\n'
        for number, corner in enumerate((0, 3, 1), 1)
    )
    with tempfile.TemporaryDirectory() as temporary:
        file = Path(temporary) / 'scene.yaml'
        file.write_text(bodies)
        found = read_scene(file).bodies
    block = next(body for body in found if body.name == 'stock')
    mills = [body for body in found if body.name == 'cutter']
    layer = [
        lambda z: 3.0,
        lambda z: np.sqrt(max(9.0 - (3.0 - z) ** 2, 0.0)),
        lambda z: 2.0 + np.sqrt(max(1.0 - (1.0 - z) ** 2, 0.0)) if z < 1.0 else 3.0,
    ]
    heights = (np.arange(30000) + 0.5) * 1e-4
    print(f'{"mill":<10}{"grid mm":>9}{"error x":>10}{"y":>10}{"z":>10}{"segments/s, z":>15}')
    still = np.zeros((1, MOTION))
    still[0, AXIS + 2] = 1.0
    made = field_of(block, 0, 4e-4, True)
    pass_over(made, slabs_of(mills[0]), still[0], 4e-5, 0, CUT)  # compiles
    for name, mill, width in zip(('flat', 'ball', 'bull'), mills, layer, strict=True):
        radii = np.array([width(z) for z in heights])
        exact = (20.0 * 2.0 * radii + np.pi * radii**2).mean() * 3.0
        ends = np.linspace(-10.0, 10.0, 21)[:, None] * [np.cos(0.3), np.sin(0.3), 0.0]
        points = (ends - [0.0, 0.0, 3.0]) * 1e-3
        rows = np.zeros((20, MOTION))
        rows[:, TIP : TIP + 3] = 0.5 * (points[1:] + points[:-1])
        rows[:, AXIS + 2] = 1.0
        rows[:, MOVE : MOVE + 3] = 0.5 * np.diff(points, axis=0)
        for grid in (4e-4, 2e-4, 1e-4):
            errors = []
            for axis in range(3):
                made = field_of(block, axis, grid, True)
                before, begun = volume(made), time.process_time()
                made.wanted[:] = 1
                for row in in_field(made, rows):
                    pass_over(made, slabs_of(mill), row, 0.1 * grid, 0, CUT)
                seconds = time.process_time() - begun
                errors.append((before - volume(made)) * 1e9 / exact - 1.0)
            told = ''.join(f'{error:>+10.3%}' for error in errors)
            print(f'{name:<10}{grid * 1e3:>9.2f}{told}{20 / seconds:>15.0f}', flush=True)


def main():
    parser = ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--quick', action='store_true', help='a seeded share, two minutes at most')
    parser.add_argument('--programs', action='store_true', help='the programs alone')
    parser.add_argument('--stock', action='store_true', help='volumes and speed of the stock')
    parser.add_argument('--scenes', type=int, help='scenes alone, so many of each kind')
    options = parser.parse_args()
    if options.stock:
        stock()
        return 0
    if options.programs:
        programs()
        return 0
    judge(Counts(), 0, True)  # compiles the kernels
    counts, begun = Counts(), time.monotonic()
    number, budget = 0, 75.0 if options.quick else float('inf')
    wanted = options.scenes or (200 if options.quick else 1000)
    while min(counts.scenes.values()) < wanted and time.monotonic() - begun < budget:
        for hits in (True, False):
            if counts.scenes['hit' if hits else 'clear'] < wanted:
                judge(counts, number, hits)
        number += 1
        if number % OFTEN == 0:
            print(counts, flush=True)
    if not (options.quick or options.scenes):
        programs()
        stock()
    print(counts)
    share = counts.wrong['clear'] / max(counts.scenes['clear'], 1)
    return int(bool(counts.wrong['hit'] or counts.contradicted) or share > 0.01)


if __name__ == '__main__':
    sys.exit(main())
