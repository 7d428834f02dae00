"""The N-buffer in tiles: a worker gets needles and the motion near them, and returns heights."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any, Protocol

from cnc_interp.cam.heights import TILE, Figures, HeightStore
from cnc_interp.cam.nbuffer import Device, cut_part
from cnc_interp.cam.needles import MotionPieces, NeedleGrid, Needles, patches
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import InterpError

#: Files whose text decides the heights of a tile.
ENGINE = ('needle_cuts.py', 'nbuffer.py', 'heights.py', 'needles.py', 'warp_cuts.py')


@dataclass(frozen=True)
class TileTask:
    """All that a worker needs for a tile."""

    #: Place of the first needle.
    row: int
    column: int
    needles: Needles  #: The needles.
    sweep: MotionPieces  #: Pieces of motion that can reach them.
    device: Device  #: What cuts.

    @property
    def key(self) -> str:
        """Hash of all that the heights depend on."""
        digest = hashlib.sha256(_engine())
        cutter, sweep = self.sweep.cutter, self.sweep
        digest.update(repr((self.row, self.column, cutter, self.device)).encode())
        for values in (
            self.needles.base, self.needles.normal, sweep.first, sweep.last, sweep.rough,
            sweep.batch,
        ):  # fmt: skip
            digest.update(values.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class CutTile:
    """A tile that was cut."""

    height: FloatArray  #: (rows, columns): Heights; ``TOP`` where nothing was cut [m].
    figures: Figures  #: Their figures.


class TileWorkers(Protocol):
    """Who cuts tiles; the pools of `batch` do."""

    def run(
        self,
        function: Callable[[TileTask], CutTile | str],
        arguments: Iterator[Callable[[], TileTask]],
    ) -> Iterator[Any]:
        """Call a function with each argument; yield what has ended, with number and result."""
        ...


@dataclass(frozen=True)
class TileProgress:
    """How far the tiles are."""

    #: Tiles with heights, those of an earlier start among them, and all.
    done: int
    known: int
    total: int

    @property
    def share(self) -> float:
        """Part of the tiles to be cut that is done [-]."""
        return (self.done - self.known) / max(1, self.total - self.known)


def cut_tile(task: TileTask) -> CutTile | str:
    """Cut a tile; returns a sentence if the device is missing."""
    try:
        height = cut_part(task.needles, task.sweep, task.device)
    except InterpError as problem:
        return str(problem)
    return CutTile(height, Figures.of(height, task.row, task.column))


class TileCutter:
    """The tiles of a grid of needles, and who cuts them."""

    def __init__(self, grid: NeedleGrid, sweep: MotionPieces, device: Device = 'cpu'):
        self._grid, self._sweep, self._device = grid, sweep, device
        self._places = list(patches(*grid.shape, TILE, TILE))

    def task(self, row: int, column: int) -> TileTask:
        rows, columns = self._grid.shape
        needles = self._grid.needles(
            slice(row, min(row + TILE, rows)), slice(column, min(column + TILE, columns))
        )
        sweep = self._sweep.near(*needles.ball)
        return TileTask(row, column, needles, sweep, self._device)

    def run(
        self, workers: TileWorkers, store: HeightStore, progress: Callable[[TileProgress], None]
    ) -> TileProgress:
        """Cut all tiles that the store does not know; each is written as soon as it is cut."""
        total, known = len(self._places), 0
        given: list[tuple[tuple[int, int], str]] = []  # place and key of each task
        progress(TileProgress(0, 0, total))

        def tasks() -> Iterator[Callable[[], TileTask]]:
            nonlocal known
            for place in self._places:
                task = self.task(*place)
                key = task.key
                if store.knows(*place, key):
                    known += 1
                    continue
                given.append((place, key))
                yield partial(_same, task)

        done = 0
        for ended in workers.run(cut_tile, tasks()):
            (row, column), key = given[ended.number]
            if not isinstance(ended.result, CutTile):
                why = ended.result
                if not isinstance(why, str):
                    words = ended.why or str(why.name).lower().replace('_', ' ')
                    why = f'its worker was lost ({words}); start again, what is done is kept'
                raise InterpError(f'the tile at needle {row}, {column}: {why}')
            store.keep(row, column, key, ended.result.height, ended.result.figures)
            done += 1
            progress(TileProgress(known + done, known, total))
        return TileProgress(known + done, known, total)


def _same(task: TileTask) -> TileTask:
    return task


@cache
def _engine() -> bytes:
    """Return the text that decides the heights."""
    return b''.join(Path(__file__).with_name(name).read_bytes() for name in ENGINE)
