"""Needles in tiles: the same bits as a whole, over workers, interrupted and gone on with."""

import base64
import json
import re
import sys
import zlib

import numpy as np
import pytest
from tiers import few_of

from cnc_interp.batch.processes import EndedCall, Loss
from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.heights import KINDS, TILE, Figures, HeightStore, deviations
from cnc_interp.cam.nbuffer import TOP, cut_needles, cut_part, cut_tiles
from cnc_interp.cam.needles import PATCH, MotionPieces, NeedleGrid, Needles
from cnc_interp.cam.shapes import Bumps
from cnc_interp.cam.surface import Placed
from cnc_interp.cam.tile_work import STEP, ZERO, TilePage, encoded
from cnc_interp.commands.cli import main
from cnc_interp.commands.parser import BAD_INPUT, FINE
from cnc_interp.core import DEG, MM, UM, InterpError

TILTED = np.array(
    [
        [1.0, 0.0, 0.0],
        [0.0, np.cos(25 * DEG), -np.sin(25 * DEG)],
        [0.0, np.sin(25 * DEG), np.cos(25 * DEG)],
    ]
)
SURFACE = Placed(Bumps((9 * MM, 8 * MM), [(0, 0, 0.4 * MM, 6 * MM)]), TILTED, np.zeros(3))
MILL = Cutter(2 * MM, 1 * MM)


def wild(seed, count=14):
    """Poses that touch the surface anyhow: with the bottom, the side, and far too deep."""
    rng = np.random.default_rng(seed)
    place = np.array([-1.0, -0.5, 0.6]) * MM + rng.normal(0, 0.9, (count, 3)) * MM
    place[3, 2] = -1.5 * MM
    axis = rng.normal(0, 0.35, (count, 3)) + [0, 0, 1]
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    return place @ TILTED.T, axis @ TILTED.T


def gouging():
    """Passes over the surface; one pose dips 60 um into it."""
    x = np.linspace(-5, 5, 21) * MM
    tip = np.vstack(
        [
            np.column_stack([x[:: 1 - 2 * (k % 2)], np.full_like(x, y), 0.5 * MM + 0 * x])
            for k, y in enumerate(np.arange(-4.5, 4.6, 0.9) * MM)
        ]
    )
    tip[5 * 21 + 10, 2] -= 0.16 * MM
    return tip @ TILTED.T, np.tile([0, 0, 1.0], (len(tip), 1)) @ TILTED.T


class Here:
    """A pool that works in this process, ``back`` to front, and may be interrupted."""

    def __init__(self, back=False, stop=None, result=None):
        self.back, self.stop, self.result, self.calls = back, stop, result, 0

    def run(self, function, arguments):
        tasks = list(enumerate(arguments))
        for number, make in tasks[:: -1 if self.back else 1]:
            if self.calls == self.stop:
                raise KeyboardInterrupt
            self.calls += 1
            yield EndedCall(number, self.result or function(make()))


@pytest.mark.parametrize(
    ('mill', 'seed'), few_of(5, (MILL, Cutter(0.0, 3 * MM), Cutter(2 * MM, 0.0)), (1, 2, 3))
)
def test_heights_are_the_same_bits_in_whatever_part_they_are_cut(mill, seed):
    grid = NeedleGrid.on(SURFACE, 0.12 * MM)
    rows, columns = grid.shape
    needles = grid.needles(slice(0, rows), slice(0, columns))
    motion = wild(seed)
    whole = cut_needles(needles, mill, *motion).height
    assert (whole < -1.0 * MM).any() and (whole == TOP).any()
    sweep = MotionPieces.of(mill, *motion)
    left_out = 0
    for tall, wide in ((64, 64), (64, columns)):
        found = np.full(whole.shape, np.nan)
        for i in range(0, rows, tall):
            for j in range(0, columns, wide):
                part = slice(i, min(i + tall, rows)), slice(j, min(j + wide, columns))
                here = grid.needles(*part)
                near = sweep.near(*here.ball)
                left_out += len(sweep) - len(near)
                found[part] = cut_part(here, near)
        assert np.array_equal(found, whole)
    assert left_out > len(sweep) // 2
    # Groups of needles change nothing either, nor does one needle alone.
    for i, j in ((0, 0), (70, 3), (30, 40)):
        alone = needles.part(slice(i, i + 1), slice(j, j + 1))
        assert cut_part(alone, sweep)[0, 0] == whole[i, j]


def test_figures_of_parts_are_those_of_the_whole():
    rng = np.random.default_rng(0)
    height = rng.normal(4 * UM, 3 * UM, (90, 70))
    height[3, 4] = height[80, 2] = -0.9 * MM
    height[:5, 60:] = TOP
    whole = Figures.of(height)
    parts = [
        Figures.of(height[i : i + 20, j : j + 33], i, j)
        for i in range(0, 90, 20)
        for j in range(0, 70, 33)
    ]
    for order in (parts, parts[::-1]):
        assert sum(order, Figures()) == whole
    assert Figures.of_json(json.loads(json.dumps(whole.to_json()))) == whole
    assert (whole.lowest.row, whole.lowest.column) == (3, 4)
    h = height[height < 0.999 * TOP]
    found = whole.statistics(deviations(height, whole.mean))
    away = h - h.mean()
    expected = {
        'mean': h.mean(),
        'Sa': np.abs(away).mean(),
        'Sq': np.sqrt((away**2).mean()),
        'lowest': h.min(),
        'highest': h.max(),
        'Sz': np.ptp(h),
        'gouged': np.mean(h < -0.5 * UM),
        'uncut': 1 - len(h) / height.size,
    }
    assert found == pytest.approx(expected, rel=1e-11)
    assert sum(whole.classes.values()) == whole.cut == len(h)
    empty = Figures.of(np.full((4, 4), TOP))
    assert empty + whole == Figures(whole.needles + 16, *list(vars(whole).values())[1:])
    with pytest.raises(InterpError, match='does not cut this surface'):
        _ = empty.mean


@pytest.fixture
def grid():
    return NeedleGrid.on(SURFACE, 0.03 * MM)  # 301 x 268: 2 x 2 tiles


def cut(folder, grid, pool, motion=None, mill=MILL):
    store = HeightStore(folder, grid, {})
    told = []
    sweep = MotionPieces.of(mill, *(motion or gouging()))
    return store, cut_tiles(grid, sweep, pool, store, told.append), told


def heights(folder):
    import zarr

    return zarr.open_group(folder / 'heights.zarr', mode='r')['height'][:]


@pytest.mark.thorough
def test_tiles_that_are_known_are_not_cut_again(grid, tmp_path):
    whole = cut_needles(Needles.on(SURFACE, 0.03 * MM), MILL, *gouging()).height
    with pytest.raises(KeyboardInterrupt):
        cut(tmp_path, grid, Here(stop=1))
    with pytest.raises(InterpError, match='missing'):
        HeightStore(tmp_path, grid, {}).figures()
    pool = Here(back=True)
    store, reached, told = cut(tmp_path, grid, pool)
    assert (pool.calls, reached.known, reached.done, reached.total) == (3, 1, 4, 4)
    assert told[-1].share == 1.0
    np.testing.assert_array_equal(heights(tmp_path), np.where(whole < TOP, whole, np.nan))
    assert store.figures() == Figures.of(whole)
    # A record that is damaged or missing: this tile only.
    (tmp_path / 'tiles' / '0_1.json').write_text('{"key"')
    (tmp_path / 'tiles' / '1_1.json').unlink()
    again = Here()
    cut(tmp_path, grid, again)
    assert again.calls == 2
    # Another mill: all. Another grid: the old heights are gone.
    other = Here()
    cut(tmp_path, grid, other, mill=Cutter(2 * MM, 1.001 * MM))
    assert other.calls == 4
    HeightStore(tmp_path, NeedleGrid.on(SURFACE, 0.04 * MM), {})
    assert not list((tmp_path / 'tiles').iterdir()) and np.isnan(heights(tmp_path)).all()


def test_a_folder_with_other_files_is_left_alone(grid, tmp_path):
    (tmp_path / 'page').mkdir()
    for text in ('mine', '{}'):
        with pytest.raises(InterpError, match='holds other files; choose a new folder'):
            HeightStore(tmp_path, grid, {})
        (tmp_path / 'heights.zarr').mkdir(exist_ok=True)
        (tmp_path / 'heights.zarr' / 'zarr.json').write_text(text)
    assert (tmp_path / 'page').exists()


def test_a_lost_worker_is_one_line(grid, tmp_path):
    pool = Here(result=Loss.CRASHED)
    with pytest.raises(InterpError, match=r'needle 0, 0: its worker was lost \(crashed\)'):
        cut(tmp_path, grid, pool)


@pytest.mark.thorough
def test_no_level_loses_a_gouge(grid, tmp_path):
    store, *_ = cut(tmp_path, grid, Here())
    total = store.figures()
    assert total.lowest.height == pytest.approx(-60 * UM, abs=40 * UM)
    page = TilePage(store, grid, 10 * UM)
    whole = cut_needles(Needles.on(SURFACE, 0.03 * MM), MILL, *gouging()).height
    assert store.make_levels(total.mean, page.add_tile) == deviations(whole, total.mean)
    assert store.levels == 2 and store.level_shape(1) == (151, 134)
    found = {kind: store.tile(0, 0, 1, kind) for kind in KINDS}
    row, column = total.lowest.row // 2, total.lowest.column // 2
    assert found['lowest'][row, column] == total.lowest.height == np.nanmin(found['lowest'])
    assert np.nanmax(found['highest']) == -total.highest.height
    for (i, j), mean in np.ndenumerate(found['mean'][:4, :4]):
        cell = whole[2 * i : 2 * i + 2, 2 * j : 2 * j + 2]
        assert mean == pytest.approx(cell.mean(), rel=1e-12)
    # The page has the same heights in nanometres.
    page.write('surface', 'motion', total.statistics(0), total)
    html = (tmp_path / 'index.html').read_text()
    facts = json.loads(re.search(r'const facts = (.*);', html)[1])
    assert facts['lowest'][:2] == [total.lowest.row, total.lowest.column]
    text = (tmp_path / 'page' / '1' / '0_0.js').read_text()
    rows, columns, packed = re.fullmatch(r'addTile\("1/0_0",(\d+),(\d+),"(.*)"\)\n', text).groups()
    made = decoded(packed, len(KINDS), int(rows), int(columns))
    np.testing.assert_allclose(made, [found[kind] for kind in KINDS], atol=0.51e-9)


def decoded(packed, *shape):
    planes = np.frombuffer(zlib.decompress(base64.b64decode(packed)), np.uint8)
    low, middle, high = planes.reshape(shape[0], 3, *shape[1:]).swapaxes(0, 1).astype(int)
    steps = low + (middle << 8) + (high << 16)
    return np.where(steps == 0, np.nan, (steps - ZERO) * STEP)


def test_heights_reach_the_page_to_the_nanometre():
    heights = np.array([[[-60 * UM, np.nan], [0.0, 1.5 * MM]]])
    np.testing.assert_allclose(
        decoded(encoded(list(heights)), *heights.shape), heights, atol=6e-10
    )


PROGRAM = (
    'G21 G90 G94\nG0 X-6 Y-3 Z5\nG1 Z0.2 F1000\n'
    + ''.join(f'G1 X{6 if k % 2 == 0 else -6}\nG1 Y{-3 + 0.5 * (k + 1)}\n' for k in range(12))
    + 'M30\n'
)


@pytest.fixture
def files(tmp_path):
    surface = {'kind': 'bumps', 'size_mm': [9, 4], 'bumps_mm': [[0, 0, 0.1, 8]]}
    (tmp_path / 'surface.json').write_text(json.dumps(surface))
    (tmp_path / 'program.ngc').write_text(PROGRAM)
    return [
        'cam',
        'simulate',
        str(tmp_path / 'program.ngc'),
        '--surface',
        str(tmp_path / 'surface.json'),
        '--spacing',
        '0.025',
        '--margin',
        '1',
    ]


@pytest.mark.thorough
def test_the_command_says_the_same_in_tiles(files, tmp_path, capsys):
    assert main([*files, '--json']) == FINE
    (whole,) = json.loads(capsys.readouterr().out).values()
    seen = []
    for workers, folder in ((1, 'one'), (2, 'two')):
        out = tmp_path / folder
        words = [*files, '--json', '--tiles', str(out), '--workers', str(workers)]
        assert main(words) == FINE
        (found,) = json.loads(capsys.readouterr().out).values()
        tiles = found.pop('tiles')
        assert found == whole and tiles['known_before'] == 0
        seen.append((out / 'heights.zarr' / 'height' / 'c' / '1' / '0').read_bytes())
    assert seen[0] == seen[1]
    assert main([*files, '--tiles', str(out)]) == FINE
    text = capsys.readouterr().out
    assert (
        f'{tiles["needles"]} needles' in text
        and '2 tiles, 2 of them known from an earlier start' in text
    )
    assert (out / 'index.html').stat().st_size > 20_000


@pytest.mark.parametrize(
    ('words', 'message'),
    [
        (['--workers', '2'], '--workers is for --tiles DIR'),
        (['--scheduler', 'tcp://x:1'], '--scheduler is for --tiles DIR'),
        (['--tiles', 'DIR', '--workers', '0'], '--workers must be 1 or more'),
        (['--tiles', 'DIR', '--html', 'x.html'], 'DIR/index.html; leave out --out'),
        (['--tiles', 'DIR', '--spacing', '1e-6'], 'choose another spacing'),
        (['--spacing', '0.0003'], 'cut them in tiles: cam simulate --tiles DIR'),
    ],
)
def test_options_that_do_not_fit_are_one_line(files, tmp_path, capsys, words, message):
    words = [str(tmp_path / 'd') if w == 'DIR' else w for w in words]
    assert main([*files, *words]) == BAD_INPUT
    error = capsys.readouterr().err
    assert message in error and error.count('\n') == 1


def test_what_is_not_installed_is_named(files, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, 'zarr', None)
    assert main([*files, '--tiles', str(tmp_path / 'd')]) == BAD_INPUT
    assert 'pip install zarr' in capsys.readouterr().err


def test_tile_is_a_whole_number_of_patches():
    assert TILE % PATCH == 0
