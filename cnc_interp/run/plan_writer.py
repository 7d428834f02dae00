"""Write the plan files during planning, in constant memory."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO
from zipfile import ZipFile

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import HOUR, FloatArray, IntArray, InterpError
from cnc_interp.feedrate.limit_use import feed_limit
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, reached
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.overrides import NOMINAL, OverrideStep
from cnc_interp.run.plan_figures import PlanFigures
from cnc_interp.run.setpoints import Setpoints
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import PathSegments

if TYPE_CHECKING:
    from cnc_interp.collision.path_clearance import Certificates

Columns = Mapping[str, NDArray[Any]]
#: Columns of shape (4, cells, axes); they grow along their second dimension.
_CELLS = ('cell_left', 'cell_right')
#: Columns that have the same name in ``blocks.npz`` and in ``Blocks``.
_AS_IN_BLOCKS = (
    'contour_tolerance',
    'orientation_tolerance',
    'rapid',
    'rotary',
    'rotary_from',
    'interpolation',
    'duration',
    'exact_stop',
    'top',
    'knot_interval',
    'program_stop',
)
#: Files that only some plans have.
SELDOM = 'functions', 'followed', 'collision', 'removal', 'remaining', 'rest'
SETPOINT_COLUMNS = {name: of for name, of in Setpoints.declared.items() if of.in_plans}
#: Number of path cells, and of setpoints, that are collected before they are written.
CELLS_AT_ONCE, SETPOINTS_AT_ONCE = 4096, 1 << 14


class PlanWriter:
    """Context manager that writes the plan files of a program; they exist after ``finish``."""

    def __init__(self, directory: Path, machine: Machine, settings: Settings):
        self._directory, self._height = directory, settings.flank_height
        self._period = settings.interpolation_period
        self._machine, self._transform = machine, Transform.of(machine)
        self.figures = PlanFigures(machine, settings)
        self._created = not directory.exists()
        directory.mkdir(parents=True, exist_ok=True)
        self._spool = tempfile.TemporaryDirectory(prefix='.plan-', dir=directory)
        self._archives = {
            name: _Archive(Path(self._spool.name), name)
            for name in ('blocks', 'segments', 'path', 'setpoints', *SELDOM)
        }
        self.functions = Functions.none()
        #: Number of the setpoint at which each function acted; None if the plan was not executed.
        self.acted: IntArray | None = None
        self._tip: FloatArray | None = None  # of the last block
        self._path: tuple[AxisPath, FloatArray] | None = None  # the last cell, and its s_dot
        self._paths: list[tuple[AxisPath, FloatArray]] = []  # gathered, with their s_dot
        self._gathered = 0  # grid points of them
        self._samples: list[Setpoints] = []  # gathered

    def __enter__(self) -> PlanWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        for archive in self._archives.values():
            archive.drop()
        self._spool.cleanup()
        if kind is not None and self._created:
            with suppress(OSError):
                self._directory.rmdir()

    def blocks(self, blocks: Blocks) -> None:
        self.figures.blocks(blocks)
        self._archives['blocks'].append(block_columns(blocks, self._tip))
        self._tip = blocks.tip[-1] if len(blocks) else self._tip

    def segments(self, segments: PathSegments) -> None:
        self.figures.segments(segments)
        if len(segments):  # an empty batch has no columns of extra axes
            self._archives['segments'].append(segments.columns())

    def piece(self, piece: PlannedPiece) -> None:
        """Write the path of the next piece; InterpError if its setpoints would fill the disk."""
        axes = len(self._machine.axis_names)
        row = 8.0 * sum(axes if of.tail else 1 for of in SETPOINT_COLUMNS.values())
        needed = 2.0 * row * piece.law.end_time / self._period  # columns, then the archive
        room = shutil.disk_usage(self._directory).free + row * self.figures.samples
        if needed > room:
            raise InterpError(
                f'the motion lasts {piece.law.end_time / HOUR:.4g} h and more; its setpoints need '
                f'{needed / 1e9:.3g} GB in {self._directory}, where {room / 1e9:.3g} GB are free; '
                'use a higher feed, or a longer --period'
            )
        self.figures.piece(piece)
        self.path(piece.path, piece.law.s_dot)

    def path(self, path: AxisPath, speed: FloatArray) -> None:
        """Write the next part of the path; ``speed``: s_dot at the left end of each cell [m/s]."""
        self._paths.append((path, speed))
        self._gathered += len(path.s)
        if self._gathered >= CELLS_AT_ONCE:
            self._write_path()

    def _write_path(self) -> None:
        if not self._paths:
            return
        before = [] if self._path is None else [self._path]
        path = AxisPath.join([part for part, _ in (*before, *self._paths)])
        speed = np.concatenate([s_dot for _, s_dot in (*before, *self._paths)])
        self._paths, self._gathered = [], 0
        new = slice(0 if self._path is None else 1, len(path.s) - 1)
        self._grid(path, np.append(speed, 0.0), new)
        cells = len(path.s) - 1
        self._archives['path'].append(
            {
                'cell_left': path.cell_left[:, new.start :],
                'cell_right': path.cell_right[:, new.start :],
            }
        )
        self._path = cut(path, cells - 1, cells), speed[-1:]

    def _grid(self, path: AxisPath, feed: FloatArray, rows: slice) -> None:
        tip, axis = reached(self._transform, path.q)
        cells = path.cell_feed
        columns = {
            's': path.s,
            'tip': tip,
            'axis': axis,
            'q': path.q,
            'programmed_feed': np.minimum(np.r_[cells[:1], cells], np.r_[cells, cells[-1:]]),
            'feed_limit': feed_limit(path, self._machine.limits),
            'feed': feed,
            'block': np.r_[path.cell_block, path.cell_block[-1:]],
            'stop': path.stop,
        }
        self._archives['path'].append({name: column[rows] for name, column in columns.items()})

    def certificates(self, found: Certificates) -> None:
        self._archives['collision'].append(found.columns())

    def stock(self, columns: Mapping[str, Columns]) -> None:
        """Store the columns of the files about the remaining stock."""
        for name, found in columns.items():
            self._archives[name].append(found)

    def setpoints(self, samples: Setpoints) -> None:
        self._samples.append(samples)
        if sum(map(len, self._samples)) >= SETPOINTS_AT_ONCE:
            self._write_setpoints()

    def followed(
        self, block: int, ramp: float, later: int, angle: FloatArray, position: FloatArray
    ) -> None:
        """Store the setpoints of a recorded line in step with the spindle."""
        given = {'block': block, 'ramp': ramp, 'later': later}
        columns = {name: np.full(len(angle), value) for name, value in given.items()}
        self._archives['followed'].append(columns | {'angle': angle, 'position': position})

    def _write_setpoints(self) -> None:
        if not self._samples:
            return
        samples, self._samples = Setpoints.concatenate(self._samples), []
        self.figures.setpoints(samples)
        self._archives['setpoints'].append({n: getattr(samples, n) for n in SETPOINT_COLUMNS})

    def finish(
        self,
        source: str,
        seconds: Mapping[str, float],
        overrides: Sequence[OverrideStep] = NOMINAL,
        setup: str = '',
    ) -> dict[str, Any]:
        """Complete the plan files and return the summary; see ``PlanFigures.summary``."""
        self._write_path()
        self._write_setpoints()
        if self._path is not None:
            self._grid(self._path[0], np.zeros(2), slice(1, 2))
        self.figures.functions = self.functions
        if len(self.functions):
            acted = self.acted
            if acted is None:  # the first setpoint of each block, or the number of setpoints
                blocks = self._archives['setpoints'].rows('block')
                acted = np.searchsorted(blocks, self.functions.block)
            self._archives['functions'].append(self.functions.columns() | {'sample': acted})
        for name in SELDOM:
            if not self._archives[name].used:  # files of another plan may be there
                del self._archives[name]
                (self._directory / f'{name}.npz').unlink(missing_ok=True)
        for name, archive in self._archives.items():
            archive.save(self._directory / f'{name}.npz')
        summary = self.figures.summary(source, seconds, overrides, setup)
        text = json.dumps(summary, indent=2)
        (self._directory / 'summary.json').write_text(text + '\n', encoding='utf-8')
        return summary


class _Archive:
    def __init__(self, folder: Path, name: str):
        self._folder, self._name = folder, name
        self._columns: dict[str, _Column] = {}

    def append(self, columns: Columns) -> None:
        for name, rows in columns.items():
            if name not in self._columns:
                self._columns[name] = _Column(self._folder / f'{self._name}.{name}', rows, name)
            self._columns[name].append(rows)

    @property
    def used(self) -> bool:
        return bool(self._columns)

    def rows(self, name: str) -> NDArray[Any]:
        column, lane = self._columns[name], self._columns[name].lanes[0]
        lane.flush()
        header = column.header()
        return np.memmap(lane, header['descr'], 'r', shape=header['shape'])

    def save(self, file: Path) -> None:
        with ZipFile(file, 'w', allowZip64=True) as archive:
            for name, column in self._columns.items():
                with archive.open(f'{name}.npy', 'w', force_zip64=True) as out:
                    header = column.header()
                    np.lib.format.write_array_header_2_0(out, header)  # type: ignore[no-untyped-call]
                    for lane in column.lanes:
                        lane.seek(0)
                        shutil.copyfileobj(lane, out, 1 << 20)

    def drop(self) -> None:
        for column in self._columns.values():
            for lane in column.lanes:
                lane.close()


class _Column:
    """A growing column. If it grows along its second axis, each row has its own file (lane)."""

    def __init__(self, file: Path, like: NDArray[Any], name: str):
        self._along, self._count = int(name in _CELLS), 0
        self._shape, self._dtype = like.shape, like.dtype
        number = like.shape[0] if self._along else 1
        files = (file.with_name(f'{file.name}.{k}') for k in range(number))
        self.lanes: list[BinaryIO] = [lane.open('w+b') for lane in files]

    def append(self, rows: NDArray[Any]) -> None:
        for lane, part in zip(self.lanes, rows if self._along else [rows], strict=True):
            lane.write(np.ascontiguousarray(part, dtype=self._dtype).data)
        self._count += rows.shape[self._along]

    def header(self) -> dict[str, Any]:
        shape = list(self._shape)
        shape[self._along] = self._count
        return {'descr': self._dtype.str, 'fortran_order': False, 'shape': tuple(shape)}


def block_columns(blocks: Blocks, tip_before: FloatArray | None = None) -> dict[str, Any]:
    extra = {'extra_axes': blocks.extra} if blocks.extra.shape[1] else {}
    return extra | {
        'tip': blocks.tip,
        'axis': blocks.axis,
        'feed': effective_feed(blocks, tip_before),
        'line': blocks.line_number,
        **{name: getattr(blocks, name) for name in _AS_IN_BLOCKS},
    }


def effective_feed(blocks: Blocks, tip_before: FloatArray | None = None) -> FloatArray:
    """Return the programmed tip speed of each row, (n,) [m/s]; infinite if the tip rests."""
    before = blocks.tip[:1] if tip_before is None else tip_before[None]
    length = np.sqrt((np.diff(blocks.tip, axis=0, prepend=before) ** 2).sum(axis=1))
    timed = np.isfinite(blocks.duration) & (length > 0.0)
    feed = np.where(timed, length / np.where(timed, blocks.duration, 1.0), blocks.feedrate)
    return np.where(np.isnan(feed), np.inf, feed)
