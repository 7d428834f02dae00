"""
Speed of the N-buffer, and how its time grows with needles, poses and workers.

    python benchmarks/nbuffer.py            # needles x poses / s on one core
    python benchmarks/nbuffer.py --tiles    # 1e5 to 1e7 needles in tiles over 1 and 2 workers

A filleted mill cuts straight passes 2 mm apart over a plane. The first table has the processor
time of one core, the second the wall time and the largest memory.
"""

from __future__ import annotations

import argparse
import hashlib
import resource
import tempfile
import time
from pathlib import Path

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.heights import HeightStore
from cnc_interp.cam.nbuffer import cut_needles, cut_tiles
from cnc_interp.cam.needles import MotionPieces, NeedleGrid, Needles
from cnc_interp.cam.shapes import Plane
from cnc_interp.commands.cam import tile_workers
from cnc_interp.core import DEG, MM, UM, FloatArray

MILL, SIDE, STEPOVER, TILT = Cutter(5 * MM, 1.5 * MM), 30 * MM, 2 * MM, 5 * DEG
POSES = 0.2 * MM


def passes(step: float) -> tuple[FloatArray, FloatArray]:
    """Return tips and axes of zigzag passes with poses so far apart [m]."""
    u = np.array([np.sin(TILT), 0.0, np.cos(TILT)])
    front = np.array([np.cos(TILT), 0.0, -np.sin(TILT)])
    x = np.arange(-0.5 * SIDE, 0.5 * SIDE, step)
    rows = np.arange(-0.5 * SIDE, 0.5 * SIDE, STEPOVER)
    K = [
        np.column_stack([x[:: 1 - 2 * (k % 2)], np.full_like(x, y), np.full_like(x, 1.5 * MM)])
        for k, y in enumerate(rows)
    ]
    tip = np.vstack(K) - MILL.tool_radius * front - MILL.corner_radius * u
    return tip, np.tile(u, (len(tip), 1))


def one_core() -> None:
    """Print one line for each size."""
    surface = Plane((SIDE, SIDE))
    print('needles    poses   seconds   needles x poses / s')
    for spacing, step in ((0.2, 0.2), (0.1, 0.2), (0.05, 0.2), (0.1, 0.1), (0.1, 0.05)):
        needles = Needles.on(surface, spacing * MM)
        tip, axis = passes(step * MM)
        begin = time.process_time()
        found = cut_needles(needles, MILL, tip, axis)
        seconds = time.process_time() - begin
        print(
            f'{needles.base[..., 0].size:7d}  {len(tip):7d}  {seconds:8.2f}   '
            f'{found.height.size * len(MotionPieces.of(MILL, tip, axis)) / seconds:.2e}'
        )


def in_tiles(sizes: list[int], counts: list[int]) -> None:
    """Print one line for each number of needles and workers."""
    # Each worker imports this file; what only the page needs would cost seconds for each tile.
    from cnc_interp.cam.tile_work import TilePage

    sweep = MotionPieces.of(MILL, *passes(POSES))
    print('   needles  workers  cut s  levels, page s  needles x poses / s   memory  heights')
    for size in sizes:
        grid = NeedleGrid.on(Plane((SIDE, SIDE)), SIDE / (np.sqrt(size) - 1.0))
        for workers in counts:
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder)
                store = HeightStore(out, grid, {})
                pool = tile_workers(None, workers)
                list(pool.run(abs, iter([lambda: 1] * workers)))  # loads
                begin = time.perf_counter()
                cut_tiles(grid, sweep, pool, store, lambda _: None)
                cut = time.perf_counter() - begin
                figures = store.figures()
                store.make_levels(figures.mean, TilePage(store, grid, 10 * UM).add_tile)
                after = time.perf_counter() - begin - cut
                digest = hashlib.sha256()
                for file in sorted((out / 'heights.zarr/height').rglob('*')):
                    digest.update(file.read_bytes() if file.is_file() else b'')
            memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            pairs = figures.needles * len(sweep)
            print(
                f'{figures.needles:10d}  {workers:7d}  {cut:5.1f}  {after:14.1f}  '
                f'{pairs / cut:19.2e}  {memory:4.0f} MB  {digest.hexdigest()[:8]}',
                flush=True,
            )


def main() -> None:
    """Print the table that was asked for."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--tiles', action='store_true', help='tiles over workers')
    parser.add_argument('--needles', type=float, nargs='+', default=[1e5, 1e6, 1e7])
    parser.add_argument('--workers', type=int, nargs='+', default=[1, 2])
    options = parser.parse_args()
    cut_needles(Needles.on(Plane((SIDE, SIDE)), 2 * MM), MILL, *passes(2 * MM))  # compiles
    if options.tiles:
        in_tiles([int(n) for n in options.needles], options.workers)
    else:
        one_core()


if __name__ == '__main__':
    main()
