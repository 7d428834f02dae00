"""Blocks of a program of any length in a temporary file; memory contains only the rows read."""

from __future__ import annotations

import tempfile
from dataclasses import fields

import numpy as np

from cnc_interp.program.blocks import Blocks

_COLUMNS = [column.name for column in fields(Blocks)]


class BlockSpool:
    """
    A growing program with length and slices, like ``Blocks``.

    The temporary file has no name. It lies in the system folder for temporary files (``TMPDIR``)
    and vanishes with the process.
    """

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 (closed by close)
        self._rows = 0
        self._record = np.dtype([])

    def append(self, blocks: Blocks) -> None:
        """
        Write more rows to the file.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program.

        Raises
        ------
        OSError
            If the disk is full.

        """
        columns = {name: getattr(blocks, name) for name in _COLUMNS}
        if not self._rows:
            self._record = np.dtype([(n, c.dtype, c.shape[1:]) for n, c in columns.items()])
        records = np.empty(len(blocks), self._record)
        for name, column in columns.items():
            records[name] = column
        self._file.seek(self._rows * self._record.itemsize)
        self._file.write(records.tobytes())
        self._rows += len(blocks)

    def __len__(self) -> int:
        """Return the number of rows, start pose included."""
        return self._rows

    def __getitem__(self, rows: slice) -> Blocks:
        """Read consecutive rows from the file."""
        first, last, _ = rows.indices(self._rows)
        size = self._record.itemsize
        self._file.seek(first * size)
        records = np.frombuffer(self._file.read(max(0, last - first) * size), self._record)
        return Blocks(*(np.ascontiguousarray(records[name]) for name in _COLUMNS))

    def close(self) -> None:
        """Close and delete the file."""
        self._file.close()

    def __enter__(self) -> BlockSpool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
