"""`cam simulate --tiles`: cut needles in tiles, then make the figures, levels and page.

A page opened from disk may load scripts but not files. So each tile is a script with its heights:
whole nanometres in three planes of bytes, deflated, in base 64.
"""

import json
import os
import sys
import zlib
from base64 import b64encode
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam.heights import CLASS, COLOURS, RANGE, TILE, Figures, HeightStore
from cnc_interp.cam.nbuffer import TileProgress, cut_tiles
from cnc_interp.cam.needles import MotionPieces, NeedleGrid
from cnc_interp.cam.request import SimulateRequest
from cnc_interp.cam.simulation import Motion, Section
from cnc_interp.cam.summary import heights_in_words, ridges_of
from cnc_interp.cam.surface import SAMPLES, Surface
from cnc_interp.core import MM, UM, FloatArray, InterpError, demand, norm, refuse_if
from cnc_interp.core.progress_bar import ProgressBar
from cnc_interp.report.html import STYLE


def refuse_options(request: SimulateRequest) -> None:
    if request.tiles is None:
        for name in ('workers', 'scheduler'):
            refuse_if(
                getattr(request, name) is not None, InterpError(f'--{name} is for --tiles DIR')
            )
    elif request.out:
        raise InterpError('--tiles DIR writes its own page, DIR/index.html; leave out --out')
    refuse_if(
        request.workers is not None and request.workers < 1,
        InterpError('--workers must be 1 or more'),
    )


def simulate_in_tiles(
    surface: Surface, motion: Motion, section: Section, request: SimulateRequest
) -> dict[str, Any]:
    out, cutter = request.tiles, request.cutter
    assert out is not None
    u, v = surface.grid(SAMPLES, SAMPLES)
    demand(
        surface.contains(u, v).all(),
        InterpError('--tiles does not follow the boundary of a trimmed face; leave it out'),
    )
    grid = NeedleGrid.on(surface, request.spacing, request.margin)
    about = {
        'surface': str(request.surface),
        'motion': str(request.motion),
        'kind': motion.name,
        'tool_radius': cutter.tool_radius,
        'corner_radius': cutter.corner_radius,
        'margin': request.margin,
    }
    store = HeightStore(out, grid, about)
    workers = request.workers or len(os.sched_getaffinity(0))
    sweep = MotionPieces.of(cutter, motion.tip, motion.axis)

    def tell(progress: TileProgress) -> None:
        known = f', {progress.known} known from an earlier start' if progress.known else ''
        bar.show('cutting', progress.share, f'{progress.done} of {progress.total} tiles{known}')

    with ProgressBar(None if request.json else sys.stderr) as bar:
        crew = request.pool(request.scheduler, workers)
        reached = cut_tiles(grid, sweep, crew, store, tell)
    figures = store.figures()
    page = TilePage(store, grid, request.scallop)
    away = store.make_levels(figures.mean, page.add_tile)
    found: dict[str, Any] = figures.statistics(away) | ridges_of(section)
    diameter = 2.0 * (cutter.tool_radius + cutter.corner_radius) / MM
    words = f'{motion.name} motion of {request.motion}, mill of {diameter:g} mm'
    page.write(str(request.surface), words, found, figures)
    found['tiles'] = {
        'rows': grid.shape[0],
        'columns': grid.shape[1],
        'needles': figures.needles,
        'tiles': reached.total,
        'known_before': reached.known,
        'histogram': histogram(figures),
        'folder': str(out),
    }
    return found


def histogram(figures: Figures) -> dict[str, Any]:
    numbers = sorted(figures.classes)
    return {
        'width': CLASS,
        'from': [n * CLASS for n in numbers],
        'needles': [figures.classes[n] for n in numbers],
    }


#: Unit of the heights on the page [m], and the number that means zero.
STEP, ZERO = 1e-9, 1 << 23
POINTS = 65  #: Points in each direction from which the page interpolates x, y and z.


class TilePage:
    def __init__(self, store: HeightStore, grid: NeedleGrid, scallop: float):
        self._store, self._grid, self._scallop = store, grid, scallop

    def add_tile(self, level: int, row: int, column: int, values: list[FloatArray]) -> None:
        """Write a tile: its heights, or lowest, highest and mean of its cells [m]."""
        folder = self._store.folder / 'page' / str(level)
        folder.mkdir(parents=True, exist_ok=True)
        name = f'{row // TILE}_{column // TILE}'
        rows, columns = values[0].shape
        text = f'addTile("{level}/{name}",{rows},{columns},"{encoded(values)}")\n'
        (folder / f'{name}.js').write_text(text, encoding='ascii')

    def write(self, title: str, motion: str, found: dict[str, Any], figures: Figures) -> None:
        assert figures.lowest and figures.highest
        places, lengths = self._places()
        numbers = sorted(figures.classes)
        facts = {
            'tile': TILE,
            'levels': self._store.levels,
            'shape': self._store.shape,
            'lengths': lengths,
            'places': places,
            'step': STEP / UM,
            'zero': ZERO,
            'top': RANGE * self._scallop / UM,
            'scallop': self._scallop / UM,
            'colours': COLOURS,
            'lowest': [figures.lowest.row, figures.lowest.column, figures.lowest.height / UM],
            'highest': [figures.highest.row, figures.highest.column, -figures.highest.height / UM],
            'classes': [[n * CLASS / UM, figures.classes[n]] for n in numbers],
            'width': CLASS / UM,
        }
        words = '\n'.join(line.strip() for line in heights_in_words(found).splitlines())
        here = Path(__file__).parent
        html = (here / 'tile_page.html').read_text(encoding='utf-8')
        for mark, text in (
            ('TITLE', escape(title)),
            ('MOTION', escape(motion)),
            ('STYLE', STYLE),
            ('WORDS', escape(words)),
            ('FACTS', json.dumps(facts).replace('</', '<\\/')),
            ('SCRIPT', (here / 'tile_page.js').read_text(encoding='utf-8')),
        ):
            html = html.replace(f'<!--{mark}-->', text)
        (self._store.folder / 'index.html').write_text(html, encoding='utf-8')

    def _places(self) -> tuple[list[Any], list[float]]:
        u, v = (np.linspace(p[0], p[-1], POINTS) for p in (self._grid.u, self._grid.v))
        points = self._grid.surface.at(*np.meshgrid(u, v, indexing='ij')).position / MM
        middle = POINTS // 2
        lines = points[:, middle], points[middle]
        lengths = [float(norm(np.diff(line, axis=0)).sum()) for line in lines]
        return np.round(points, 4).tolist(), lengths


def encoded(values: list[FloatArray]) -> str:
    planes = []
    for heights in values:
        steps = np.rint(np.nan_to_num(heights) / STEP).astype(np.int64) + ZERO
        whole = np.where(np.isnan(heights), 0, np.clip(steps, 1, (1 << 24) - 1))
        planes += [(whole >> shift & 255).astype(np.uint8).tobytes() for shift in (0, 8, 16)]
    return b64encode(zlib.compress(b''.join(planes), 6)).decode('ascii')
