"""The N-buffer in tiles: a worker gets needles and the motion near them, and returns heights."""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

from cnc_interp.cam.heights import TILE, Figures, HeightStore
from cnc_interp.cam.nbuffer import Device, cut_part
from cnc_interp.cam.needles import MotionPieces, NeedleGrid, Needles, patches
from cnc_interp.core import FloatArray, InterpError

#: Files whose text decides the heights of a tile.
ENGINE = ('needle_cuts.py', 'nbuffer.py', 'heights.py', 'needles.py', 'warp_cuts.py')


@dataclass(frozen=True)
class TileTask:
    #: Place of the first needle.
    row: int
    column: int
    needles: Needles  #: The needles.
    sweep: MotionPieces  #: Pieces of motion that can reach them.
    device: Device  #: What cuts.

    @property
    def key(self) -> str:
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
    height: FloatArray  #: (rows, columns): Heights; ``TOP`` where nothing was cut [m].
    figures: Figures  #: Their figures.


class TileWorkers(Protocol):
    """Who cuts tiles; the pools of `batch` do."""

    def run(
        self, function: Callable[[TileTask], CutTile | str],
        arguments: Iterator[Callable[[], TileTask]],
    ) -> Iterator[Any]: ...  # fmt: skip


@dataclass(frozen=True)
class TileProgress:
    #: Tiles with heights, those of an earlier start among them, and all.
    done: int
    known: int
    total: int

    @property
    def share(self) -> float:
        return (self.done - self.known) / max(1, self.total - self.known)


def cut_tile(task: TileTask) -> CutTile | str:
    """Cut a tile; returns a sentence if the device is missing."""
    try:
        height = cut_part(task.needles, task.sweep, task.device)
    except InterpError as problem:
        return str(problem)
    return CutTile(height, Figures.of(height, task.row, task.column))


def cut_tiles(
    grid: NeedleGrid, sweep: MotionPieces, workers: TileWorkers, store: HeightStore,
    progress: Callable[[TileProgress], None], device: Device = 'cpu',
) -> TileProgress:  # fmt: skip
    """Cut all tiles that the store does not know; each is written as soon as it is cut."""
    rows, columns = grid.shape
    places, known, done = list(patches(rows, columns, TILE, TILE)), 0, 0
    given: list[tuple[int, int, str]] = []  # place and key of each task
    progress(TileProgress(0, 0, len(places)))

    def tasks() -> Iterator[Callable[[], TileTask]]:
        nonlocal known
        for row, column in places:
            ends = min(row + TILE, rows), min(column + TILE, columns)
            needles = grid.needles(slice(row, ends[0]), slice(column, ends[1]))
            task = TileTask(row, column, needles, sweep.near(*needles.ball), device)
            key = task.key
            if store.knows(row, column, key):
                known += 1
                continue
            given.append((row, column, key))
            yield lambda task=task: task  # type: ignore[misc]

    for ended in workers.run(cut_tile, tasks()):
        row, column, key = given[ended.number]
        if not isinstance(ended.result, CutTile):
            why = ended.result
            if not isinstance(why, str):
                words = ended.why or str(why.name).lower().replace('_', ' ')
                why = f'its worker was lost ({words}); start again, what is done is kept'
            raise InterpError(f'the tile at needle {row}, {column}: {why}')
        store.keep(row, column, key, ended.result.height, ended.result.figures)
        done += 1
        progress(TileProgress(known + done, known, len(places)))
    return TileProgress(known + done, known, len(places))


@cache
def _engine() -> bytes:
    return b''.join(Path(__file__).with_name(name).read_bytes() for name in ENGINE)
