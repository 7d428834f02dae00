"""Read plan files for checks. Columns may exceed the memory, so they are read in chunks."""

from __future__ import annotations

import math
import shutil
import struct
import tempfile
import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import IO, Any, BinaryIO
from zipfile import ZIP_STORED, BadZipFile, ZipFile

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cnc_interp.core import FloatArray, IntArray, InterpError
from cnc_interp.core.small_files import UnreadableError, read_json
from cnc_interp.core.tables import Column

Columns = Mapping[str, Any]  #: Columns by name: arrays, or ``Stored`` columns in files.

# A default makes a column optional. Where it is NaN, values may be missing. n: number of axes.
REAL, WHOLE, LOGICAL = Column(), Column((), np.int64), Column((), np.bool_)
POINT, AXES = Column((3,)), Column(('n',))
SETPOINT_COLUMNS = {
    'time': REAL,
    'position': AXES,
    'velocity': AXES,
    'acceleration': AXES,
    'block': WHOLE,
    's': REAL,
}
PATH_COLUMNS = {
    's': REAL,
    'tip': POINT,
    'axis': POINT,
    'q': AXES,
    'programmed_feed': REAL,
    'feed_limit': REAL,
    'feed': REAL,
    'block': WHOLE,
    'stop': LOGICAL,
}
BLOCK_COLUMNS = {
    'tip': POINT,
    'axis': POINT,
    'feed': REAL,
    'line': WHOLE,
    'contour_tolerance': REAL,
    'orientation_tolerance': REAL,
    'rapid': LOGICAL,
    'rotary': Column((2,), default=np.nan),
    'duration': Column(default=np.nan),
    'exact_stop': Column((), np.bool_, default=False),
    'top': Column((3,), default=np.nan),
    'knot_interval': Column(default=np.nan),
    'extra_axes': Column(('k',), default=0.0),
    'interpolation': Column((), np.int64, default=0),
    'rotary_from': Column((2,), default=np.nan),
    'program_stop': Column((), np.int64, default=0),
}
FUNCTION_COLUMNS = {
    'block': WHOLE,
    'line_number': WHOLE,
    'step': WHOLE,
    'value': REAL,
    'before_stop': LOGICAL,
    'sample': WHOLE,
}
COLLISION_COLUMNS = {
    'begin': REAL,
    'end': REAL,
    'pair': Column((2,), np.int64),
    'normal': POINT,
    'hit': LOGICAL,
    'witness': Column((6,)),
}
#: Files that only some plans have: certificates against collision, cut and remaining stock,
#: functions, and lines in step with the spindle.
SELDOM = {
    'collision': COLLISION_COLUMNS,
    'removal': {'begin': REAL, 'end': REAL, 'removed': REAL},
    'remaining': {'line': WHOLE, 'interval': Column((2,))},
    'rest': {'place': Column((3,)), 'excess': REAL},
    'functions': FUNCTION_COLUMNS,
    'followed': {
        'block': WHOLE,
        'ramp': REAL,
        'later': WHOLE,
        'angle': Column(default=np.nan),
        'position': AXES,
    },
}
# One-sided derivatives of the cells between the rows of path.npz, shape (4, N - 1, n); needed.
PATH_CELLS = ('cell_left', 'cell_right')
MAY_BE_INFINITE = frozenset(('programmed_feed', 'feed_limit', 'feed'))  #: Infinite means no limit.
LARGEST = (0.0, 1.5), (0.5, 1.2)  #: Ranges of the feed and the spindle override [-].
#: Ranges of figures that every summary must contain [s, m].
RANGES = {'interpolation_period': (1e-5, 0.1), 'flank_height': (0.0, 1e3)}
MOST_SAMPLES = 1 << 62  #: More than any plan has.
# Most columns of a file; a file longer than this [bytes] may unpack to this many times its length.
MOST_COLUMNS, SMALL, UNPACKED = 64, 1 << 26, 20
# Exceptions that the readers of archives and arrays raise for invalid files.
READING_FAULTS = (
    OSError,
    ValueError,
    EOFError,
    BadZipFile,
    zlib.error,
    struct.error,
    RuntimeError,
    TypeError,
    KeyError,
    IndexError,
    SyntaxError,
    MemoryError,
    OverflowError,
)
# Header before the content of a file in an archive; it ends with the lengths of name and extra.
LOCAL_HEADER = struct.Struct('<26sHH')
# Shorter rows have no feed [m]; accepted error of the length of a unit vector [-].
NO_LENGTH, UNIT = 1e-9, 1e-6
CHUNK = 1 << 14  #: Rows that are proven at a time.
MISSING = -1  #: Setpoint number of a function that did not act.
BY_PROBE = 'the probe has ended it'  #: First words of ``cut`` if a probe ended the motion.
BY_OPERATOR = 'the operator has ended it'  #: The same in a bag, if the operator did.


class Stored:
    """A column in a file. Read it by index, slice or ``[:, slice]``; write it by slice."""

    def __init__(self, file: BinaryIO, start: int, dtype: DTypeLike, shape: tuple[int, ...]):
        self._file, self._start = file, start
        self.dtype, self.shape, self.ndim = np.dtype(dtype), shape, len(shape)

    @staticmethod
    def empty(rows: int, dtype: DTypeLike, tail: tuple[int, ...] = ()) -> Stored:
        file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        file.truncate(rows * math.prod(tail) * np.dtype(dtype).itemsize)
        return Stored(file, 0, dtype, (rows, *tail))

    @staticmethod
    def unpacked(values: IO[bytes], dtype: DTypeLike, shape: tuple[int, ...]) -> Stored:
        file = tempfile.TemporaryFile()  # noqa: SIM115
        shutil.copyfileobj(values, file, 1 << 20)
        file.flush()
        return Stored(file, 0, dtype, shape)

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, tuple):
            lanes, rows = key
            first, last, _ = rows.indices(self.shape[1])
            places = [lane * self.shape[1] for lane in range(*lanes.indices(len(self)))]
            tail = self.shape[2:]
            return np.stack([self._rows(k + first, max(last - first, 0), tail) for k in places])
        if isinstance(key, slice):
            first, last, step = key.indices(len(self))
            return self._rows(first, max(last - first, 0), self.shape[1:])[::step]
        return self._rows(range(len(self))[key], 1, self.shape[1:])[0]

    def __setitem__(self, key: slice, rows: NDArray[Any]) -> None:
        size = math.prod(self.shape[1:]) * self.dtype.itemsize
        self._file.seek(self._start + key.start * size)
        np.ascontiguousarray(rows, dtype=self.dtype).tofile(self._file)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:, :] if self.ndim > 2 else self[:], dtype=dtype)

    def _rows(self, first: int, count: int, tail: tuple[int, ...]) -> NDArray[Any]:
        size = math.prod(tail)
        self._file.seek(self._start + first * size * self.dtype.itemsize)
        values = np.fromfile(self._file, dtype=self.dtype, count=count * size)
        if len(values) != count * size:
            raise InterpError('the plan files became shorter while they were read; plan again')
        return values.reshape(count, *tail)


def spans(count: int) -> Iterator[tuple[int, int]]:
    for first in range(0, count, CHUNK):
        yield first, min(first + CHUNK, count)


def held(column: Any, first: int, last: int, before: int, after: int) -> NDArray[Any]:
    """Return rows [first, last) with neighbours; end rows are repeated beyond the column."""
    low, high = max(first - before, 0), min(last + after, len(column))
    edges = ((before - (first - low), after - (high - last)), *[(0, 0)] * (column.ndim - 1))
    return np.pad(column[low:high], edges, mode='edge')


def gathered(column: Any, places: NDArray[Any]) -> NDArray[Any]:
    rows = np.empty((len(places), *column.shape[1:]), dtype=column.dtype)
    for first, last in spans(len(column)):
        here = np.flatnonzero((places >= first) & (places < last))
        if len(here):
            rows[here] = column[first:last][places[here] - first]
    return rows


@dataclass(frozen=True)
class PlanFiles:
    """A plan: the program (blocks), the path and every setpoint, all in SI units."""

    setpoints: Columns  #: K rows of ``setpoints.npz`` [s, m or rad, per s, per s2].
    path: Columns  #: Grid of the planner, with the columns of ``path.npz``; empty for a bag.
    blocks: Columns  #: Program rows, the start pose first, with all optional columns present.
    summary: Mapping[str, Any]  #: Contents of ``summary.json``.
    #: Functions of the program, and the number of the setpoint at which each acted (``sample``).
    functions: Columns = field(
        default_factory=lambda: {name: of.filled(0) for name, of in FUNCTION_COLUMNS.items()}
    )
    #: Certificates of clearances, and hits; empty without a scene.
    collision: Columns = field(default_factory=dict)
    #: Pieces of motion that cut the stock, and the remaining material on its lines.
    removal: Columns = field(default_factory=dict)
    remaining: Columns = field(default_factory=dict)
    rest: Columns = field(default_factory=dict)  #: Excess material at points of the part.
    #: Setpoints of lines in step with the spindle and its ``angle`` [rev]; only records have them.
    followed: Columns = field(default_factory=dict)

    def in_memory(self) -> PlanFiles:
        setpoints, path = (
            {name: np.asarray(column) for name, column in columns.items()}
            for columns in (self.setpoints, self.path)
        )
        return replace(self, setpoints=setpoints, path=path)

    def part(self, first: int, last: int) -> PlanFiles:
        columns = {name: column[first:last] for name, column in self.setpoints.items()}
        return replace(self, setpoints=columns)

    @property
    def settings(self) -> Mapping[str, Any]:
        told = self.summary.get('settings')
        return told if isinstance(told, dict) else {}

    @property
    def starts_inside(self) -> bool:
        """Whether the run started inside the program; row 0 is then the end of a skipped row."""
        return bool(self.summary.get('start'))

    @property
    def cut(self) -> str:
        """Text that says where a record ends early; empty if the program is complete."""
        return str(self.summary.get('cut', ''))

    @property
    def by_probe(self) -> bool:
        """Whether the motion ends at rest because a probe has answered."""
        return self.cut.startswith(BY_PROBE)

    @property
    def ends_at_rest(self) -> bool:
        return self.by_probe or self.cut.startswith(BY_OPERATOR)

    @property
    def position(self) -> FloatArray:
        return self.setpoints['position']

    @property
    def block(self) -> IntArray:
        return self.setpoints['block']

    @property
    def period(self) -> float:
        return float(self.summary['interpolation_period'])

    @property
    def flank_height(self) -> float:
        return float(self.summary['flank_height'])


def read_plan(directory: Path) -> PlanFiles:
    """Read and check the plan files of a directory; InterpError names what is wrong."""
    if not directory.is_dir():
        raise InterpError(f'{directory}: no such directory; give one written by cnc-interp plan')
    summary = _read_summary(directory / 'summary.json')
    setpoints = _read_columns(directory / 'setpoints.npz', SETPOINT_COLUMNS)
    path = _read_columns(directory / 'path.npz', PATH_COLUMNS)
    blocks = _read_columns(directory / 'blocks.npz', BLOCK_COLUMNS)
    if setpoints['position'].shape[1] != path['q'].shape[1]:
        text = 'setpoints.npz and path.npz have different numbers of axes'
        raise _unsound(directory, text)
    if len(setpoints['position']) < 2 or len(path['s']) < 2 or len(blocks['tip']) < 2:
        raise InterpError(f'{directory}: the plan contains no motion; plan another program')
    cells = (4, len(path['s']) - 1, path['q'].shape[1])
    for name in PATH_CELLS:
        found = path.get(name, np.zeros(0))
        real = found.dtype.kind == 'f' and found.shape == cells
        if not real or not all(np.isfinite(found[:, a:b]).all() for a, b in spans(cells[1])):
            text = f'column {name} has shape {found.shape} of {found.dtype}, expected {cells} of'
            raise _unsound(directory / 'path.npz', f'{text} finite float64')
    for name, columns in (('setpoints.npz', setpoints), ('path.npz', path)):
        rows = columns['block']
        ends = [(rows[a:b].min(), rows[a:b].max()) for a, b in spans(len(rows))]
        least, most = min(low for low, _ in ends), max(high for _, high in ends)
        if least < 0 or most >= len(blocks['tip']):
            rows_known = f'blocks.npz has rows 0 to {len(blocks["tip"]) - 1}'
            text = f'block runs from {least} to {most}, but {rows_known}; plan the program again'
            raise InterpError(f'{directory / name}: {text}')
    if fault := _nonsense(blocks):
        raise _unsound(directory / 'blocks.npz', fault)
    plan = PlanFiles(setpoints, path, blocks, summary)
    seldom = {
        name: _read_columns(file, columns)
        for name, columns in SELDOM.items()
        if (file := directory / f'{name}.npz').exists()
    }
    return replace(plan, **seldom)


def _unsound(file: Path, text: str) -> InterpError:
    return InterpError(f'{file}: {text}; plan again')


def _nonsense(blocks: Columns) -> str:
    tip, duration = blocks['tip'], blocks['duration']
    length = np.linalg.norm(np.diff(tip, axis=0, prepend=tip[:1]), axis=1)
    endless = np.isinf(blocks['feed']) & ~blocks['rapid'] & ~np.isfinite(duration)
    endless &= (length > NO_LENGTH) & (blocks['interpolation'] == 0)
    size = np.linalg.norm(blocks['axis'], axis=1)
    faults = {
        'the feed must be positive': ~(blocks['feed'] > 0.0) & np.isnan(duration),
        'only a rapid has no feed': endless,
        'the duration must be positive': duration <= 0.0,
        'the contour tolerance must be positive': blocks['contour_tolerance'] <= 0.0,
        'the orientation tolerance must be positive': blocks['orientation_tolerance'] <= 0.0,
        'the tool axis must be a unit vector': np.abs(size - 1.0) > UNIT,
        'program_stop must be 0, 1 or 2': ~np.isin(blocks['program_stop'], (0, 1, 2)),
        'a program stop needs an exact stop': (blocks['program_stop'] != 0)
        & ~np.asarray(blocks['exact_stop'], dtype=np.bool_),
        'interpolation must be 0, 1 or 2': ~np.isin(blocks['interpolation'], (0, 1, 2)),
        'interpolation > 0 needs rotary and rotary_from': (blocks['interpolation'] != 0)
        & ~np.isfinite(np.hstack([blocks['rotary'], blocks['rotary_from']])).all(axis=1),
    }
    for text, where in faults.items():
        if text.startswith(('the feed', 'only', 'the duration')):
            where[0] = False  # the start pose has no feed
        if where.any():
            return f'line {blocks["line"][int(np.argmax(where))]}: {text}'
    return ''


def _read_summary(file: Path) -> Mapping[str, Any]:
    try:
        summary = read_json(file)
    except (OSError, UnreadableError) as fault:
        raise _unsound(file, f'cannot be read ({_reason(fault)})') from fault
    known = summary if isinstance(summary, dict) else {}
    for key, (low, high) in RANGES.items():
        value = known.get(key)
        if not isinstance(value, int | float) or not low <= value <= high:
            raise InterpError(f'{file}: {key} must be from {low:g} to {high:g}, not {value!r}')
    if wrong := _wrong_overrides(summary.get('overrides', [[0, 1.0, 1.0]])):
        raise InterpError(f'{file}: {wrong}')
    return summary


def _wrong_overrides(steps: Any) -> str:
    if not isinstance(steps, list) or not steps:
        return 'overrides must be a list that is not empty'
    before = -1
    for step in steps:
        real = isinstance(step, list) and len(step) == 3
        if not real or not all(isinstance(value, int | float) for value in step):
            return f'a step of the overrides must be three numbers, not {step!r}'
        within = [
            low <= share <= high for share, (low, high) in zip(step[1:], LARGEST, strict=True)
        ]
        if not all(within) or not before < step[0] < MOST_SAMPLES or step[0] != int(step[0]):
            return f'a step of the overrides cannot be {step!r}'
        before = step[0]
    return '' if steps[0][0] == 0 else 'the overrides must begin with setpoint 0'


def _read_columns(file: Path, declared: Mapping[str, Column]) -> dict[str, Any]:
    try:
        _check_lengths(file)
        with np.load(file, allow_pickle=False) as archive:
            wanted = {*declared, *(PATH_CELLS if 'q' in declared else ())}
            unknown = sorted(set(archive.files) - wanted)
            if unknown:
                raise _unsound(file, f'unknown column {unknown[0]!r}')
            whole = declared in (BLOCK_COLUMNS, *SELDOM.values())
            stored = {} if whole else _stored(file)
            columns = {
                name: stored[name] if name in stored else archive[name] for name in archive.files
            }
    except READING_FAULTS as fault:
        raise _unsound(file, f'cannot be read ({_reason(fault)})') from fault
    missing = [n for n, of in declared.items() if of.default is None and n not in columns]
    if missing:
        raise _unsound(file, f'column {missing[0]} is missing')
    first = columns[next(iter(declared))]
    rows = len(first) if first.ndim else 1
    for name, of in declared.items():
        if name not in columns:
            columns[name] = of.filled(rows)
        column = columns[name]
        if not of.fits(column.shape, rows):
            text = f'column {name} has shape {column.shape}, expected {of.shape_text(rows)}'
            raise _unsound(file, text)
        kinds = {np.int64: 'iu', np.bool_: 'b'}.get(of.kind, 'iuf')
        if column.dtype.kind not in kinds:
            raise _unsound(file, f'column {name} holds {column.dtype}, which it cannot')
        for begin, end in spans(rows):
            values = column[begin:end]
            if name in MAY_BE_INFINITE:
                bad = np.isnan(values) & (file.name != 'blocks.npz')  # timed blocks have no feed
            else:
                missing_allowed = of.default is not None and np.isnan(of.default)
                bad = np.isinf(values) if missing_allowed else ~np.isfinite(values)
            if bad.any():
                row = begin + int(np.argwhere(bad)[0][0])
                raise _unsound(file, f'column {name} is not finite in row {row}')
        if not isinstance(column, Stored) or column.dtype != of.kind:
            columns[name] = np.asarray(column).astype(of.kind, copy=False)
    return columns


def _stored(file: Path) -> dict[str, Stored]:
    found = {}
    content = file.open('rb', buffering=0)
    with ZipFile(file) as archive:
        for member in archive.infolist():
            name = member.filename.removesuffix('.npy')
            if member.compress_type != ZIP_STORED:
                with archive.open(member) as column:
                    shape, in_columns, kind = _array_header(column)
                    if _plain(shape, in_columns, kind):
                        found[name] = Stored.unpacked(column, kind, shape)
                continue
            content.seek(member.header_offset)
            local = content.read(LOCAL_HEADER.size)
            if len(local) < LOCAL_HEADER.size or not local.startswith(b'PK\3\4'):
                raise ValueError(f'{member.filename} is not at the place that the archive states')
            start = member.header_offset + LOCAL_HEADER.size + sum(LOCAL_HEADER.unpack(local)[1:])
            with archive.open(member) as column:
                shape, in_columns, kind = _array_header(column)
                start += column.tell()
                while column.read(1 << 20):  # at its end, its checksum is compared
                    pass
            end = start + math.prod(shape) * kind.itemsize
            if _plain(shape, in_columns, kind) and end <= file.stat().st_size:
                found[name] = Stored(content, start, kind, shape)
    return found


def _plain(shape: tuple[int, ...], in_columns: bool, kind: np.dtype[Any]) -> bool:
    plain = kind in (np.float64, np.int64, np.bool_) and (len(shape) < 2 or not in_columns)
    return plain and len(shape) > 0


def _array_header(column: IO[bytes]) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = np.lib.format.read_magic(column)  # type: ignore[no-untyped-call]
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError('an array has an unknown format')
    return read(column)  # type: ignore[no-untyped-call]


def _check_lengths(file: Path) -> None:
    file.stat()
    if not file.is_file():
        raise ValueError('it is not a file')
    with ZipFile(file) as archive:
        members = archive.infolist()
        size = sum(member.file_size for member in members)
        if len(members) > MOST_COLUMNS or size > max(SMALL, UNPACKED * file.stat().st_size):
            raise ValueError(f'it would unpack to {len(members)} columns and {size} bytes')
        for member in members:
            with archive.open(member) as column:
                shape, _, kind = _array_header(column)
                told = math.prod(shape) * kind.itemsize
                if kind.hasobject or min(shape, default=1) < 0:
                    raise ValueError(f'{member.filename} does not hold numbers')
                if column.tell() + told != member.file_size:
                    raise ValueError(f'{member.filename} does not have the length that it states')


def _reason(fault: Exception) -> str:
    if isinstance(fault, FileNotFoundError):
        return 'missing'
    return ' '.join(str(fault).split())[:80] or type(fault).__name__
