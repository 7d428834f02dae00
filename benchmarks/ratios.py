"""
Cycle times with L2/L1 fixed and chosen for each corner, for corner_rounding.md.

    PYTHONPATH=. python benchmarks/ratios.py [--search]

``--search`` also tries other ratios at one corner after another, in programs of a few corners.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from paths import ROOT, SHARED, time_along
from whole_plans import path_of

from cnc_interp.core import DEG, MM, MM_PER_MIN, FloatArray
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.problems.paths import dome, random_blocks
from cnc_interp.program import Blocks, read_program
from cnc_interp.run.path_chain import is_faster
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.corner_curve import Corners
from cnc_interp.smoothing.lookahead import LookAhead

FIXED = (1.4, 1.5, 1.75, 2.0, 2.5)
TRIED = (1.4, 1.5, 1.6, 1.75, 2.0, 2.25, 2.5, 3.0, 4.0)
#: Corners that a program may have for the search, and how often it goes through them.
FEW, SWEEPS = 8, 2
TULSYAN = 'Tulsyan_Altintas_IJMTM_2015.apt'
MACHINE = Machine.load('xyzac')


class Told(LookAhead):
    """A look-ahead that is told the ratio of each corner by its place."""

    table: dict[bytes, float]

    def _ratios(self, corners: Corners) -> FloatArray:
        found = [self.table[tip.tobytes()] for tip in corners.tip]
        return np.repeat(np.array(found)[:, None], 2, axis=1)


def cycle_time(
    blocks: Blocks, ratio: float | None = None, table: dict[bytes, float] | None = None
) -> float:
    """Plan blocks and return the time they take [s]."""
    settings, transform = Settings(corner_ratio=ratio, compress=False), Transform.of(MACHINE)
    if table is None:
        return plan_path(path_of(blocks, transform, settings), MACHINE).law.end_time
    told = Told(settings, traits_of(transform), partial(is_faster, transform, settings))
    told.table = table
    return time_along(told, blocks, transform, settings)


def search(blocks: Blocks) -> float:
    """Return the best time found by changing one corner's ratio after another [s]."""
    table = {tip.tobytes(): 2.0 for tip in blocks.tip}
    best = cycle_time(blocks, table=table)
    for _ in range(SWEEPS):
        for tip in blocks.tip[1:-1]:
            for ratio in TRIED:
                changed = table | {tip.tobytes(): ratio}
                time = cycle_time(blocks, table=changed)
                if time < best:
                    best, table = time, changed
    return best


def unlike() -> Blocks:
    """Make a polyline of blocks from 0.1 to 15 mm with unlike turns and rotations."""
    rng = np.random.default_rng(7)
    count = 60
    step = rng.normal(size=(count, 3))
    step *= (np.exp(rng.uniform(np.log(0.1), np.log(15.0), count)) * MM)[:, None] / np.sqrt(
        (step**2).sum(axis=1, keepdims=True)
    )
    tip = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    lean = rng.uniform(15.0, 45.0, count + 1) * DEG
    way = np.cumsum(rng.uniform(-0.4, 0.4, count + 1))
    ring = np.sin(lean)
    axis = np.column_stack([ring * np.sin(way), ring * np.cos(way), np.cos(lean)])
    return Blocks.of_poses(tip, axis, 3000.0 * MM_PER_MIN)


def programs() -> Iterator[tuple[str, Blocks]]:
    """Yield names and blocks; public programs where they stand beside the repository."""
    transform = Transform.of(MACHINE)
    examples, public = ROOT / 'examples', SHARED / 'programs'
    impeller = public / 'linuxcnc-impeller-xyzac' / 'impeller-7bl-xyzac.ngc'
    files = [
        ('pocket corner', examples / 'pocket_corner.apt', 3.0, 0, None),
        ('pocket corner', examples / 'pocket_corner.apt', 0.02, 0, None),
        ('pyramid', examples / 'pyramid.apt', 0.02, 0, None),
        ('pyramid', examples / 'pyramid.apt', 0.2, 0, None),
        ('square', public / 'cnclite-square-apt' / 'Square_apt.apt', 0.02, 0, None),
        ('tulsyan', public / 'cnclite-tulsyan-apt' / TULSYAN, 0.02, 0, None),
        ('yelun', public / 'hust-yelun-cl' / 'yelun.txt', 0.02, 0, None),
        ('impeller [100:240]', impeller, 0.01, 100, 240),
        ('impeller [1000:1200]', impeller, 0.01, 1000, 1200),
        ('impeller [1000:1200]', impeller, 0.05, 1000, 1200),
    ]
    for name, file, tolerance, first, last in files:
        if not file.exists():
            continue
        options = Settings(
            contour_tolerance=tolerance * MM,
            orientation_tolerance=tolerance * MM,
            force_tolerances=True,
            feedrate=3000.0 * MM_PER_MIN,
        )
        blocks = read_program(file, transform, options).blocks[first:last]
        moved = file.parent != examples
        # The workpiece may stand elsewhere on this machine: begin over the C axis.
        blocks = replace(blocks, tip=blocks.tip - blocks.tip[0]) if moved else blocks
        yield f'{name}, {tolerance:g} mm', blocks
    yield 'dome spiral, 2,000 blocks of 0.5 mm', dome()
    yield 'unlike blocks, 0.1 to 15 mm', unlike()
    for seed in range(8):
        yield f'random 5-axis {seed}', random_blocks(seed)


def main(arguments: list[str]) -> None:
    """Print the table in Markdown: the best fixed time, and all others relative to it."""
    searching = '--search' in arguments
    heads = [f'{ratio:g}' for ratio in FIXED] + ['auto'] + ['search'] * searching
    print('| program | best fixed, s | ' + ' | '.join(heads) + ' |')
    print('|---' * (len(heads) + 2) + '|')
    for name, blocks in programs():
        times = [cycle_time(blocks, ratio) for ratio in FIXED]
        best = min(times)
        times.append(cycle_time(blocks))
        cells = [f'{100.0 * (time / best - 1.0):+.2f} %' for time in times]
        if searching:
            few = len(blocks) <= FEW + 2
            cells.append(f'{100.0 * (search(blocks) / best - 1.0):+.2f} %' if few else '')
        print(f'| {name} | {best:.3f} | ' + ' | '.join(cells) + ' |', flush=True)


if __name__ == '__main__':
    main(sys.argv[1:])
