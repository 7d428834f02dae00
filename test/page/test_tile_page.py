"""The page of heights in tiles, opened from the disk in a real browser."""

import numpy as np
import pytest
from browser import Browser

from cnc_interp.cam.heights import TILE, Figures, HeightStore
from cnc_interp.cam.needles import NeedleGrid, patches
from cnc_interp.cam.shapes import Plane
from cnc_interp.cam.tile_work import TilePage
from cnc_interp.core import MM, UM

pytest.importorskip('zarr', reason='needs the optional part tiles')

GOUGE = (700, 900)
#: Colour of a pixel of the map, and how many of its pixels are red: the gouge.
RED = """(() => {
  const all = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
  let red = 0;
  for (let i = 0; i < all.length; i += 4) {
    red += all[i] > 100 && all[i + 1] < 60 && all[i + 2] < 60;
  }
  return red;
})()"""


@pytest.fixture(scope='module')
def page(tmp_path_factory):
    """A flat surface of 1501 x 1201 needles, 2 um high, with one needle 20 um deep."""
    folder = tmp_path_factory.mktemp('tiles')
    grid = NeedleGrid.on(Plane((30 * MM, 24 * MM)), 0.02 * MM)
    store = HeightStore(folder, grid, {})
    for row, column in patches(*grid.shape, TILE, TILE):
        rows, columns = (min(TILE, n - i) for n, i in zip(grid.shape, (row, column), strict=True))
        height = np.full((rows, columns), 2 * UM)
        if row <= GOUGE[0] < row + TILE and column <= GOUGE[1] < column + TILE:
            height[GOUGE[0] - row, GOUGE[1] - column] = -20 * UM
        store.keep(row, column, 'key', height, Figures.of(height, row, column))
    figures = store.figures()
    made = TilePage(store, grid, 10 * UM)
    away = store.make_levels(figures.mean, made.add_tile)
    made.write('a <plane>', 'motion', figures.statistics(away), figures)
    browser = Browser()
    yield browser.open(f'file://{folder}/index.html', 900, 800)
    browser.close()


def test_one_gouged_needle_is_seen_from_afar_and_found(page):
    page.wait(lambda: page.run('typeof levelNow === "function" && tiles.size > 1'))
    assert page.run('document.title') == 'a <plane>'
    page.wait(lambda: 1 <= page.run(RED) <= 9)
    assert page.run('levelNow()') >= 1
    for kind, seen in (('highest', False), ('lowest', True)):
        page.run(f'kind = "{kind}"; drawNow()')
        page.wait(lambda seen=seen: (page.run(RED) > 0) == seen)
    page.run('document.getElementById("low").click()')
    page.wait(lambda: page.run(RED) >= 36)  # 6 x 6 pixels a needle
    page.run('tell(canvas.width / 2, canvas.height / 2)')
    told = 'x -1.000, y 6.000, z 0.000 mm · needle 700, 900: -20.000 µm'
    page.wait(lambda: page.run('document.getElementById("place").textContent') == told)
    page.run('document.getElementById("all").click()')
    page.wait(lambda: 1 <= page.run(RED) <= 9)
    assert page.faults == []
