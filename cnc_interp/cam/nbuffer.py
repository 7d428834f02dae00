"""N-buffer: needles along the normals of a surface, cut by the moving mill.

The distance of a point of the needle ``B + h n`` from the convex mill is a convex function of h.
Newton's method from below therefore converges monotonically to the height at which the needle
enters. The result is the signed height of the material: scallop, excess or gouge.
"""

import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.heights import TILE, Figures, HeightStore, deviations, is_cut
from cnc_interp.cam.needle_cuts import TOP, NeedleGroups, PieceColumns, cut
from cnc_interp.cam.needles import MotionPieces, NeedleGrid, Needles, patches
from cnc_interp.core import BoolArray, FloatArray, InterpError

GROUPS = 16  #: Groups of needles in each direction of a part that is cut at once.


@dataclass(frozen=True)
class Heights:
    needles: Needles  #: The needles.
    #: (rows, columns): Signed height above the surface; ``TOP`` where nothing was cut [m].
    height: FloatArray

    @property
    def cut(self) -> BoolArray:
        return is_cut(self.on_face)

    @property
    def on_face(self) -> FloatArray:
        """Heights, NaN on needles that are not on the face, shape (rows, columns) [m]."""
        counted = self.needles.counted
        return self.height if counted is None else np.where(counted, self.height, np.nan)

    def statistics(self) -> dict[str, float]:
        figures = Figures.of(self.on_face)
        return figures.statistics(deviations(self.on_face, figures.mean))


def cut_needles(
    needles: Needles,
    cutter: Cutter,
    tip: FloatArray,
    axis: FloatArray,
    progress: Callable[[float], None] = lambda _: None,
) -> Heights:
    sweep = MotionPieces.of(cutter, tip, axis)
    rows, columns = needles.shape
    height = np.empty(needles.shape)
    tall, wide = (GROUPS * n for n in needles.group_size())
    for i, j in patches(rows, columns, tall, wide):
        part = slice(i, i + tall), slice(j, j + wide)
        here = needles.part(*part)
        height[part] = cut_part(here, sweep.near(*here.ball))
        done = min(i + tall, rows) * columns if j + wide >= columns else i * columns + tall * j
        progress(min(1.0, done / height.size))
    return Heights(needles, height)


def cut_part(needles: Needles, sweep: MotionPieces) -> FloatArray:
    needle = np.concatenate([needles.base, needles.normal], axis=2).reshape(-1, 6)
    height = np.full(len(needle), TOP)
    columns = sweep.first, sweep.middle, sweep.last, sweep.slack, sweep.rough, sweep.batch
    groups, pieces = NeedleGroups(needle, *needles.groups()), PieceColumns(*columns)
    cut(groups, pieces, sweep.search, (sweep.cutter.tool_radius, sweep.skin), height)
    return height.reshape(needles.shape)


#: Files whose text decides the heights of a tile.
ENGINE = ('needle_cuts.py', 'nbuffer.py', 'heights.py', 'needles.py')


@dataclass(frozen=True)
class TileTask:
    #: Place of the first needle.
    row: int
    column: int
    needles: Needles  #: The needles.
    sweep: MotionPieces  #: Pieces of motion that can reach them.

    @property
    def key(self) -> str:
        digest = hashlib.sha256(_engine())
        cutter, sweep = self.sweep.cutter, self.sweep
        digest.update(repr((self.row, self.column, cutter)).encode())
        for values in (
            self.needles.base,
            self.needles.normal,
            sweep.first,
            sweep.last,
            sweep.rough,
            sweep.batch,
        ):
            digest.update(values.tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class CutTile:
    height: FloatArray  #: (rows, columns): Heights; ``TOP`` where nothing was cut [m].
    figures: Figures  #: Their figures.


class TileWorkers(Protocol):
    """Runs the cutting of tiles in processes, as the pools of `batch` do."""

    def run(
        self,
        function: Callable[[TileTask], CutTile],
        arguments: Iterator[Callable[[], TileTask]],
    ) -> Iterator[Any]: ...


#: Returns the workers that cut tiles: those of the scheduler at an address, or processes here.
Pool = Callable[[str | None, int], TileWorkers]


@dataclass(frozen=True)
class TileProgress:
    #: Number of tiles with heights, of those from an earlier start, and of all tiles.
    done: int
    known: int
    total: int

    @property
    def share(self) -> float:
        return (self.done - self.known) / max(1, self.total - self.known)


def cut_tile(task: TileTask) -> CutTile:
    height = cut_part(task.needles, task.sweep)
    return CutTile(height, Figures.of(height, task.row, task.column))


def cut_tiles(
    grid: NeedleGrid,
    sweep: MotionPieces,
    workers: TileWorkers,
    store: HeightStore,
    progress: Callable[[TileProgress], None],
) -> TileProgress:
    """Cut all tiles that the store does not have; each is written as soon as it is cut."""
    rows, columns = grid.shape
    places, known, done = list(patches(rows, columns, TILE, TILE)), 0, 0
    given: list[tuple[int, int, str]] = []  # place and key of each task
    progress(TileProgress(0, 0, len(places)))

    def tasks() -> Iterator[Callable[[], TileTask]]:
        nonlocal known
        for row, column in places:
            ends = min(row + TILE, rows), min(column + TILE, columns)
            needles = grid.needles(slice(row, ends[0]), slice(column, ends[1]))
            task = TileTask(row, column, needles, sweep.near(*needles.ball))
            key = task.key
            if store.knows(row, column, key):
                known += 1
                continue
            given.append((row, column, key))
            yield lambda task=task: task  # type: ignore[misc]

    for ended in workers.run(cut_tile, tasks()):
        row, column, key = given[ended.number]
        if not isinstance(ended.result, CutTile):
            words = ended.why or str(ended.result.name).lower().replace('_', ' ')
            why = f'its worker was lost ({words}); start again; finished tiles are kept'
            raise InterpError(f'the tile at needle {row}, {column}: {why}')
        store.keep(row, column, key, ended.result.height, ended.result.figures)
        done += 1
        progress(TileProgress(known + done, known, len(places)))
    return TileProgress(known + done, known, len(places))


@cache
def _engine() -> bytes:
    return b''.join(Path(__file__).with_name(name).read_bytes() for name in ENGINE)
