"""Rows: the output of the compressor; each row is a line or a part of a curve."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.program.blocks import Blocks


@dataclass(frozen=True)
class Spans:
    """Spans of curves in path order; each is a quintic Bezier curve over [0, 1]."""

    #: (n, 6, 3): Bezier points of the tool tip, and of a second point on the tool axis [m].
    bottom: FloatArray
    top: FloatArray
    feed: FloatArray  #: (n, 2): Programmed ds/dt in the first and second half [m/s].
    block: IntArray  #: (n, 2): Program rows in the middle of the first and second half.
    line_number: IntArray  #: (n,): Program line in the middle of the second half.
    #: (n, 2): Bounds of contour and orientation deviation from the program [m].
    deviation: FloatArray
    room: FloatArray  #: (n,): What the deviation leaves of the orientation tolerance [m].

    def __len__(self) -> int:
        """Return the number of spans."""
        return len(self.bottom)

    def __getitem__(self, rows: slice) -> Spans:
        """Return a slice of the spans."""
        return Spans(*(getattr(self, field.name)[rows] for field in fields(self)))

    @staticmethod
    def concatenate(parts: list[Spans]) -> Spans:
        """Join batches of spans in order."""
        names = [field.name for field in fields(Spans)]
        return Spans(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    @staticmethod
    def none() -> Spans:
        """Return an empty batch of spans."""
        whole, real = np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2))
        points = np.zeros((0, 6, 3))
        return Spans(points, points, real, whole, whole[:, 0], real, real[:, 0])


@dataclass(frozen=True)
class Rows:
    """Lines and curves that replace the blocks. Row 0 of a program is the start pose."""

    #: End pose and programmed data of each row. Tolerances are reduced by ``used``.
    blocks: Blocks
    row: IntArray  #: (n,): Program row in which, or at whose end, the row ends.
    #: (n, 2): Contour and orientation deviation of a line from the blocks that it replaces [m].
    used: FloatArray
    #: (n,): Whether a curve joins the previous row smoothly at the start of this row.
    smooth: BoolArray
    leads: BoolArray  #: (n,): Whether the row is a line at whose end a curve begins smoothly.
    count: IntArray  #: (n,): Number of spans of the row; 0 for a line.
    spans: Spans  #: Spans of all rows.

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.row)

    def __getitem__(self, rows: slice) -> Rows:
        """Return a slice of the rows with their spans."""
        first, last, _ = rows.indices(len(self))
        ends = np.concatenate([[0], np.cumsum(self.count)])
        return Rows(
            self.blocks[rows], self.row[rows], self.used[rows], self.smooth[rows],
            self.leads[rows], self.count[rows], self.spans[ends[first] : ends[max(first, last)]],
        )  # fmt: skip

    @staticmethod
    def concatenate(parts: list[Rows]) -> Rows:
        """Join batches of rows in order."""
        return Rows(
            blocks=Blocks.concatenate([part.blocks for part in parts]),
            row=np.concatenate([part.row for part in parts]),
            used=np.concatenate([part.used for part in parts]),
            smooth=np.concatenate([part.smooth for part in parts]),
            leads=np.concatenate([part.leads for part in parts]),
            count=np.concatenate([part.count for part in parts]),
            spans=Spans.concatenate([part.spans for part in parts]),
        )

    @staticmethod
    def plain(blocks: Blocks, first: int) -> Rows:
        """Return blocks as unchanged lines; ``first`` is the program row of the first block."""
        n = len(blocks)
        no = np.zeros(n, dtype=bool)
        return Rows(
            blocks, first + np.arange(n), np.zeros((n, 2)), no, no,
            np.zeros(n, dtype=np.int64), Spans.none(),
        )  # fmt: skip

    @staticmethod
    def line(block: Blocks, row: int, used: FloatArray, smooth: bool, leads: bool) -> Rows:
        """
        Return one line.

        Parameters
        ----------
        block : Blocks
            One row: end pose and programmed data of the line.
        row : int
            Program row at whose end the line ends.
        used : ndarray, shape (2,)
            Contour and orientation deviation of the line from the program [m].
        smooth, leads : bool
            Whether a curve joins smoothly at the start, and at the end.

        Returns
        -------
        Rows
            One row.

        """
        return Rows(
            block, np.array([row]), used[None].copy(), np.array([smooth]), np.array([leads]),
            np.zeros(1, dtype=np.int64), Spans.none(),
        )  # fmt: skip

    @staticmethod
    def curve(block: Blocks, spans: Spans, smooth: bool) -> Rows:
        """Return one part of a curve; ``block`` has its end pose."""
        return Rows(
            block, spans.block[-1:, 1].copy(), np.zeros((1, 2)), np.array([smooth]),
            np.zeros(1, dtype=bool), np.array([len(spans)]), spans,
        )  # fmt: skip

    @staticmethod
    def none() -> Rows:
        """Return an empty batch of rows."""
        real, no = np.zeros(0), np.zeros(0, dtype=bool)
        lines = np.zeros(0, dtype=np.int64)
        points = np.zeros((0, 3))
        blocks = Blocks(points, points, np.zeros((0, 2)), real, real, no, no, real, real, lines)
        return Rows.plain(blocks, 0)
