"""The work of `cam simulate --tiles`: needles in tiles, their figures, levels and the page."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.heights import CLASS, Figures, HeightStore
from cnc_interp.cam.needle_tiles import TileCutter, TileProgress, TileWorkers
from cnc_interp.cam.needles import NeedleGrid, Sweep
from cnc_interp.cam.simulation import Motion, Section
from cnc_interp.cam.summary import ridges_of
from cnc_interp.cam.surface import SAMPLES, Surface
from cnc_interp.cam.tile_page import TilePage
from cnc_interp.core.errors import InterpError
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.core.units import MM, UM

#: Returns who cuts tiles: address of a scheduler, or number of processes here.
Pool = Callable[[str | None, int], TileWorkers]


def refuse_options(options: argparse.Namespace) -> None:
    """Refuse options that do not belong together."""
    if options.tiles is None:
        for name in ('workers', 'scheduler'):
            if getattr(options, name) is not None:
                raise InterpError(f'--{name} is for --tiles DIR')
    elif options.out:
        raise InterpError('--tiles DIR writes its own page, DIR/index.html; leave out --out')
    if options.workers is not None and options.workers < 1:
        raise InterpError('--workers must be 1 or more')
    if options.device != 'cpu' and options.scheduler is None:
        from cnc_interp.cam.warp_cuts import warp

        warp(options.device)


def simulate_in_tiles(
    surface: Surface, cutter: Cutter, motion: Motion, section: Section,
    options: argparse.Namespace,
) -> dict[str, Any]:  # fmt: skip
    """Cut needles tile by tile; write heights, levels and page."""
    out: Path = options.tiles
    u, v = surface.grid(SAMPLES, SAMPLES)
    if not surface.contains(u, v).all():
        raise InterpError('--tiles does not follow the boundary of a trimmed face; leave it out')
    grid = NeedleGrid.on(surface, options.spacing * MM, options.margin * MM)
    about = {
        'surface': str(options.surface), 'motion': str(options.motion), 'kind': motion.name,
        'tool_radius': cutter.tool_radius, 'corner_radius': cutter.corner_radius,
        'margin': options.margin * MM,
    }  # fmt: skip
    store = HeightStore(out, grid, about)
    workers = options.workers or len(os.sched_getaffinity(0))
    pool: Pool = options.pool
    bar = ProgressBar(None if options.json else sys.stderr)

    def tell(progress: TileProgress) -> None:
        known = f', {progress.known} known before' if progress.known else ''
        bar.show('cutting', progress.share, f'{progress.done} of {progress.total} tiles{known}')

    tiles = TileCutter(grid, Sweep.of(cutter, motion.tip, motion.axis), options.device)
    done = False
    try:
        reached = tiles.run(pool(options.scheduler, workers), store, tell)
        done = True
    finally:
        bar.end(complete=done)
    figures = store.figures()
    page = TilePage(store, grid, options.scallop * UM)
    away = store.make_levels(figures.mean, page.add_tile)
    found: dict[str, Any] = figures.statistics(away) | ridges_of(section)
    diameter = 2.0 * (cutter.tool_radius + cutter.corner_radius) / MM
    words = f'{motion.name} motion of {options.motion}, mill of {diameter:g} mm'
    page.write(str(options.surface), words, found, figures)
    found['tiles'] = {
        'rows': grid.shape[0], 'columns': grid.shape[1], 'needles': figures.needles,
        'tiles': reached.total, 'known_before': reached.known,
        'histogram': histogram(figures), 'folder': str(out),
    }  # fmt: skip
    return found


def histogram(figures: Figures) -> dict[str, Any]:
    """Return the classes of the heights that are not empty: lower ends [m] and counts."""
    numbers = sorted(figures.classes)
    return {
        'width': CLASS,
        'from': [n * CLASS for n in numbers],
        'needles': [figures.classes[n] for n in numbers],
    }
