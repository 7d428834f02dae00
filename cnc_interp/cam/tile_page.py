"""
The page of heights in tiles: a map that zooms, without a network and without a server.

A browser may not read files beside a page that it opened from the disk, but it may load scripts.
So each tile is a script that hands over its heights: whole nanometres in three planes of bytes,
deflated, in base 64.
"""

from __future__ import annotations

import json
import zlib
from base64 import b64encode
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam.heights import CLASS, TILE, Figures, HeightStore
from cnc_interp.cam.needles import NeedleGrid
from cnc_interp.cam.summary import heights_in_words
from cnc_interp.cam.vectors import norm
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM, UM
from cnc_interp.report.html import STYLE

#: Unit of the heights on the page [m], and the number that stands for zero.
STEP, ZERO = 1e-9, 1 << 23
#: Points in each direction from which the page tells x, y and z.
POINTS = 65
#: Colours of the map, by their place from -1.3 to 1.3 scallop heights; blue turns to yellow at 1.
COLOURS = [
    [0.0, '#7b1d12'], [0.35, '#d9583f'], [0.5, '#f7f7f7'], [0.75, '#4f93c9'],
    [0.885, '#123a63'], [0.89, '#e0b21e'], [1.0, '#e08a1e'],
]  # fmt: skip
RANGE = 1.3


class TilePage:
    """The page of a store."""

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
        """Write index.html."""
        assert figures.lowest and figures.highest
        places, lengths = self._places()
        numbers = sorted(figures.classes)
        facts = {
            'tile': TILE, 'levels': self._store.levels, 'shape': self._store.shape,
            'lengths': lengths, 'places': places, 'step': STEP / UM, 'zero': ZERO,
            'top': RANGE * self._scallop / UM, 'scallop': self._scallop / UM, 'colours': COLOURS,
            'lowest': [figures.lowest.row, figures.lowest.column, figures.lowest.height / UM],
            'highest': [
                figures.highest.row, figures.highest.column, -figures.highest.height / UM
            ],
            'classes': [[n * CLASS / UM, figures.classes[n]] for n in numbers],
            'width': CLASS / UM,
        }  # fmt: skip
        words = '\n'.join(line.strip() for line in heights_in_words(found).splitlines())
        here = Path(__file__).parent
        html = (here / 'tile_page.html').read_text(encoding='utf-8')
        for mark, text in (
            ('TITLE', escape(title)), ('MOTION', escape(motion)), ('STYLE', STYLE),
            ('WORDS', escape(words)),
            ('FACTS', json.dumps(facts).replace('</', '<\\/')),
            ('SCRIPT', (here / 'tile_page.js').read_text(encoding='utf-8')),
        ):  # fmt: skip
            html = html.replace(f'<!--{mark}-->', text)
        (self._store.folder / 'index.html').write_text(html, encoding='utf-8')

    def _places(self) -> tuple[list[Any], list[float]]:
        """Return points of the surface on a coarse grid, and its lengths along u and v [mm]."""
        u, v = (np.linspace(p[0], p[-1], POINTS) for p in (self._grid.u, self._grid.v))
        points = self._grid.surface.at(*np.meshgrid(u, v, indexing='ij')).position / MM
        middle = POINTS // 2
        lines = points[:, middle], points[middle]
        lengths = [float(norm(np.diff(line, axis=0)).sum()) for line in lines]
        return np.round(points, 4).tolist(), lengths


def encoded(values: list[FloatArray]) -> str:
    """Encode heights for the page."""
    planes = []
    for heights in values:
        steps = np.rint(np.nan_to_num(heights) / STEP).astype(np.int64) + ZERO
        whole = np.where(np.isnan(heights), 0, np.clip(steps, 1, (1 << 24) - 1))
        planes += [(whole >> shift & 255).astype(np.uint8).tobytes() for shift in (0, 8, 16)]
    return b64encode(zlib.compress(b''.join(planes), 6)).decode('ascii')
