"""Heights of needles on the disk, in tiles, levels and figures (docs/how_it_works/cam.md).

A record is written after its chunk. A tile without a record is cut again.
"""

from __future__ import annotations

import json
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from fractions import Fraction
from functools import cached_property
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.cam.needle_cuts import TOP
from cnc_interp.cam.needles import NeedleGrid, patches
from cnc_interp.core import UM, BoolArray, FloatArray, InterpError, demand, refuse_if
from cnc_interp.core.small_files import UnreadableError, read_json, write_whole

GOUGE = 0.5 * UM  #: Depth from which a needle counts as gouged [m].
CLASS = 0.1 * UM  #: Width of the classes of the histogram [m].
#: Colours of the map, by their place from -1.3 to 1.3 scallop heights; blue turns to yellow at 1.
COLOURS = [
    [0.0, '#7b1d12'],
    [0.35, '#d9583f'],
    [0.5, '#f7f7f7'],
    [0.75, '#4f93c9'],
    [0.885, '#123a63'],
    [0.89, '#e0b21e'],
    [1.0, '#e08a1e'],
]
RANGE = 1.3
#: Heights are summed in units of 2 ** -HEIGHT_BITS m, their squares in 2 ** -SQUARE_BITS m2.
HEIGHT_BITS, SQUARE_BITS = 60, 75
#: Bit at which such numbers are split, so that neither half overflows when millions are added.
HALF = 24


@dataclass(frozen=True, order=True)
class Extreme:
    """A lowest or highest height and its place; of equal heights the first needle is taken."""

    height: float  #: The height [m]; the negative of it for a highest one.
    row: int
    column: int


@dataclass(frozen=True)
class Figures:
    """Sums over the cut needles, as whole numbers, so that their order does not matter."""

    #: Number of needles, of those that the mill has reached, and of those deeper than ``GOUGE``.
    needles: int = 0
    cut: int = 0
    gouged: int = 0
    #: Sum of the heights and of their squares, in the units of ``exact_sum``.
    total: int = 0
    squares: int = 0
    #: The extremes; None if no needle was cut.
    lowest: Extreme | None = None
    highest: Extreme | None = None
    #: Number of needles in each class of the histogram: from n CLASS to (n + 1) CLASS.
    classes: dict[int, int] = field(default_factory=dict)

    @staticmethod
    def of(height: FloatArray, row: int = 0, column: int = 0) -> Figures:
        reached = is_cut(height)
        h = height[reached]
        total = int(np.count_nonzero(~np.isnan(height)))
        if not len(h):
            return Figures(total)
        ends = []
        for sign in (1.0, -1.0):
            place = int(np.argmin(np.where(reached, sign * height, np.inf)))
            i, j = divmod(place, height.shape[1])
            ends.append(Extreme(sign * float(height[i, j]), row + i, column + j))
        number, count = np.unique(np.floor(h / CLASS).astype(int), return_counts=True)
        return Figures(
            total,
            len(h),
            int(np.count_nonzero(h < -GOUGE)),
            exact_sum(h, HEIGHT_BITS),
            exact_sum(h * h, SQUARE_BITS),
            ends[0],
            ends[1],
            dict(zip(number.tolist(), count.tolist(), strict=True)),
        )

    def __add__(self, other: Figures) -> Figures:
        lows = [x.lowest for x in (self, other) if x.lowest]
        highs = [x.highest for x in (self, other) if x.highest]
        return Figures(
            self.needles + other.needles,
            self.cut + other.cut,
            self.gouged + other.gouged,
            self.total + other.total,
            self.squares + other.squares,
            min(lows, default=None),
            min(highs, default=None),
            dict(Counter(self.classes) + Counter(other.classes)),
        )

    @property
    def mean(self) -> float:
        demand(
            self.cut, InterpError('the program does not cut this surface; give one made for it')
        )
        return float(Fraction(self.total, self.cut << HEIGHT_BITS))

    def statistics(self, deviations: int) -> dict[str, float]:
        mean = self.mean
        assert self.lowest and self.highest
        low, high = self.lowest.height, -self.highest.height
        square = Fraction(self.squares, self.cut << SQUARE_BITS)
        spread = square - Fraction(self.total, self.cut << HEIGHT_BITS) ** 2
        return {
            'highest': high,
            'lowest': low,
            'mean': mean,
            'Sa': float(Fraction(deviations, self.cut << HEIGHT_BITS)),
            'Sq': sqrt(max(float(spread), 0.0)),
            'Sz': high - low,
            'gouged': self.gouged / self.cut,
            'uncut': 1.0 - self.cut / self.needles,
        }

    def to_json(self) -> dict[str, Any]:
        """Return the figures for a file; long numbers are texts."""
        classes = sorted(self.classes.items())
        long = {'total': str(self.total), 'squares': str(self.squares)}
        return asdict(self) | long | {'classes': classes}

    @staticmethod
    def of_json(found: dict[str, Any]) -> Figures:
        """Return the figures of a file; raises KeyError, TypeError or ValueError."""
        ends = {name: found[name] and Extreme(**found[name]) for name in ('lowest', 'highest')}
        long = {name: int(found[name]) for name in ('total', 'squares')}
        return Figures(**found | ends | long | {'classes': dict(found['classes'])})


def is_cut(height: FloatArray) -> BoolArray:
    return np.asarray(height < 0.999 * TOP)


def deviations(height: FloatArray, mean: float) -> int:
    return exact_sum(np.abs(height[is_cut(height)] - mean), HEIGHT_BITS)


def exact_sum(values: FloatArray, bits: int) -> int:
    whole = np.rint(np.ldexp(values, bits)).astype(np.int64)
    return (int((whole >> HALF).sum()) << HALF) + int((whole & ((1 << HALF) - 1)).sum())


#: Needles in each direction of a tile, which is a chunk of the store and an image of the page.
TILE = 256
MADE_BY = {'made_by': 'cnc_interp'}  #: Attribute that identifies stores of this package.
KINDS = ('lowest', 'highest', 'mean')  #: Values of a cell of a level.
#: Faults of a record after which its tile is cut again.
UNREADABLE = (OSError, UnreadableError, ValueError, TypeError, KeyError)


class HeightStore:
    def __init__(self, folder: Path, grid: NeedleGrid, about: dict[str, Any]):
        self.folder, self.shape = folder, grid.shape
        self._zarr = _zarr()
        place = folder / 'heights.zarr'
        if not self._fits(place, grid):
            for old in (place, folder / 'tiles', folder / 'page'):
                shutil.rmtree(old, ignore_errors=True)
            place.mkdir(parents=True)
            group = self._zarr.open_group(place, mode='w', attributes=MADE_BY)
            self._array(group, 'height', self.shape)
            for name, values in (('u', grid.u), ('v', grid.v)):
                group.create_array(name, data=values)
        (folder / 'tiles').mkdir(exist_ok=True)
        self._group = self._zarr.open_group(place, mode='r+')
        self._group.attrs.update(about | {'unit': 'm'})
        self._height = self._group['height']

    def _fits(self, place: Path, grid: NeedleGrid) -> bool:
        """Return whether a store of these needles exists; reject a folder with other content."""
        ours = False
        try:
            found = self._zarr.open_group(place, mode='r')
            ours = dict(found.attrs).items() >= MADE_BY.items()
            return ours and all(
                np.array_equal(found[name][:], needles)
                for name, needles in (('u', grid.u), ('v', grid.v))
            )
        except (OSError, ValueError, KeyError):
            return False
        finally:
            refuse_if(
                not ours and self.folder.exists() and any(self.folder.iterdir()),
                InterpError(f'{self.folder}: it holds other files; choose a new folder'),
            )

    @staticmethod
    def _array(group: Any, name: str, shape: tuple[int, int]) -> Any:
        return group.create_array(
            name,
            shape=shape,
            chunks=(TILE, TILE),
            dtype='float64',
            fill_value=np.nan,
            overwrite=True,
        )

    def knows(self, row: int, column: int, key: str) -> bool:
        try:
            found = read_json(self._file(row, column))
            Figures.of_json(found['figures'])
        except UNREADABLE:
            return False
        return bool(found['key'] == key)

    def keep(self, row: int, column: int, key: str, height: FloatArray, figures: Figures) -> None:
        rows, columns = height.shape
        self._height[row : row + rows, column : column + columns] = np.where(
            is_cut(height), height, np.nan
        )
        record = {'key': key, 'figures': figures.to_json()}
        write_whole(self._file(row, column), json.dumps(record) + '\n')

    def tile(
        self, row: int, column: int, level: int = 0, kind: str = 'mean', size: int = TILE
    ) -> FloatArray:
        """Return a part of a level, by default a tile [m]; NaN where nothing was cut."""
        array = self._height if level == 0 else self._group[f'level/{level}/{kind}']
        return np.asarray(array[row : row + size, column : column + size])

    def figures(self) -> Figures:
        total = Figures()
        for place in patches(*self.shape, TILE, TILE):
            try:
                total += Figures.of_json(read_json(self._file(*place))['figures'])
            except UNREADABLE:
                raise InterpError(f'{self._file(*place)}: the tile is missing') from None
        return total

    def make_levels(
        self, mean: float, seen: Callable[[int, int, int, list[FloatArray]], None]
    ) -> int:
        away = 0
        for place in patches(*self.shape, TILE, TILE):
            height = self.tile(*place)
            away += deviations(np.where(np.isnan(height), TOP, height), mean)
            seen(0, *place, [height])
        for level in range(1, self.levels):
            shape = self.level_shape(level)
            arrays = [self._array(self._group, f'level/{level}/{k}', shape) for k in KINDS]
            for row, column in patches(*shape, TILE, TILE):
                below = 2 * row, 2 * column, level - 1
                made = [reduced(self.tile(*below, kind, 2 * TILE), kind) for kind in KINDS]
                for array, cells in zip(arrays, made, strict=True):
                    rows, columns = cells.shape
                    array[row : row + rows, column : column + columns] = cells
                seen(level, row, column, made)
        return away

    @cached_property
    def levels(self) -> int:
        count = 1
        while max(self.level_shape(count - 1)) > TILE:
            count += 1
        return count

    def level_shape(self, level: int) -> tuple[int, int]:
        rows, columns = self.shape
        return -(-rows // (1 << level)), -(-columns // (1 << level))

    def _file(self, row: int, column: int) -> Path:
        return self.folder / 'tiles' / f'{row // TILE}_{column // TILE}.json'


def reduced(cells: FloatArray, kind: str) -> FloatArray:
    rows, columns = (n + n % 2 for n in cells.shape)
    filled = np.full((rows, columns), np.nan)
    filled[: cells.shape[0], : cells.shape[1]] = cells
    four = np.stack([filled[i::2, j::2] for i in (0, 1) for j in (0, 1)])
    if kind == 'lowest':
        return np.asarray(np.fmin.reduce(four))
    if kind == 'highest':
        return np.asarray(np.fmax.reduce(four))
    known = ~np.isnan(four)
    total = np.where(known, four, 0.0).sum(axis=0)
    return np.asarray(np.where(known.any(axis=0), total, np.nan) / np.maximum(known.sum(0), 1))


def _zarr() -> Any:
    try:
        import zarr
    except ModuleNotFoundError as problem:
        raise InterpError(
            f'--tiles needs Zarr ({problem.name} is missing): pip install zarr'
        ) from None
    return zarr
