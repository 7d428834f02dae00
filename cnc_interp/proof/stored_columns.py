"""Columns of plan files that may be longer than the memory: read and proven in chunks."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from math import prod
from typing import IO, Any, BinaryIO

import numpy as np
from numpy.typing import DTypeLike, NDArray

from cnc_interp.core.errors import InterpError

CHUNK = 1 << 14  #: Rows that are proven at a time.


class Stored:
    """A column in a file, read by a number, a slice or ``[:, slice]``, written by a slice."""

    def __init__(self, file: BinaryIO, start: int, dtype: DTypeLike, shape: tuple[int, ...]):
        self._file, self._start = file, start
        self.dtype, self.shape, self.ndim = np.dtype(dtype), shape, len(shape)

    @staticmethod
    def empty(rows: int, dtype: DTypeLike) -> Stored:
        """Return a column of zeros in a temporary file, which is gone with the column."""
        file = tempfile.TemporaryFile(buffering=0)  # noqa: SIM115
        file.truncate(rows * np.dtype(dtype).itemsize)
        return Stored(file, 0, dtype, (rows,))

    @staticmethod
    def unpacked(values: IO[bytes], dtype: DTypeLike, shape: tuple[int, ...]) -> Stored:
        """Return a column of the values of a stream, in a temporary file."""
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
        self._file.seek(self._start + key.start * self.dtype.itemsize)
        np.ascontiguousarray(rows, dtype=self.dtype).tofile(self._file)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        rows = self[:, :] if self.ndim > 2 else self[:]
        return np.asarray(rows, dtype=dtype)

    def _rows(self, first: int, count: int, tail: tuple[int, ...]) -> NDArray[Any]:
        size = prod(tail)
        self._file.seek(self._start + first * size * self.dtype.itemsize)
        values = np.fromfile(self._file, dtype=self.dtype, count=count * size)
        if len(values) != count * size:
            raise InterpError('the plan files became shorter while they were read; plan again')
        return values.reshape(count, *tail)


def spans(count: int) -> Iterator[tuple[int, int]]:
    """Yield first and last row (exclusive) of each chunk."""
    for first in range(0, count, CHUNK):
        yield first, min(first + CHUNK, count)


def held(column: Any, first: int, last: int, before: int, after: int) -> NDArray[Any]:
    """Return rows of a column with neighbours; beyond its ends the end row is repeated."""
    low, high = max(first - before, 0), min(last + after, len(column))
    edges = ((before - (first - low), after - (high - last)), *[(0, 0)] * (column.ndim - 1))
    return np.pad(column[low:high], edges, mode='edge')


def gathered(column: Any, places: NDArray[Any]) -> NDArray[Any]:
    """Return the rows of a column at some places, shape (len(places), ...)."""
    rows = np.empty((len(places), *column.shape[1:]), dtype=column.dtype)
    for first, last in spans(len(column)):
        here = np.flatnonzero((places >= first) & (places < last))
        if len(here):
            rows[here] = column[first:last][places[here] - first]
    return rows
