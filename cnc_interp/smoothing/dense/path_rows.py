"""Rows: the output of the compressor; each row is a line or a part of a curve."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.columns import Table, column
from cnc_interp.program.blocks import Blocks


class Spans(Table):
    """Spans of curves in path order; each is a quintic Bezier curve over [0, 1]."""

    #: Bezier points of the tool tip, and of a second point on the tool axis [m].
    bottom: FloatArray = column(6, 3)
    top: FloatArray = column(6, 3)
    feed: FloatArray = column(2)  #: Programmed ds/dt in the first and second half [m/s].
    block: IntArray = column(2)  #: Program rows in the middle of the first and second half.
    line_number: IntArray = column()  #: Program line in the middle of the second half.
    #: Bounds of contour and orientation deviation from the program [m].
    deviation: FloatArray = column(2)
    room: FloatArray = column()  #: What the deviation leaves of the orientation tolerance [m].


class Rows(Table):
    """Lines and curves that replace the blocks. Row 0 of a program is the start pose."""

    #: End pose and programmed data of each row. Tolerances are reduced by ``used``.
    blocks: Blocks
    row: IntArray = column()  #: Program row in which, or at whose end, the row ends.
    #: Contour and orientation deviation of a line from the blocks that it replaces [m].
    used: FloatArray = column(2)
    #: Whether a curve joins the previous row smoothly at the start of this row.
    smooth: BoolArray = column()
    leads: BoolArray = column()  #: Whether the row is a line at whose end a curve begins smoothly.
    count: IntArray = column()  #: Number of spans of the row; 0 for a line.
    spans: Spans  #: Spans of all rows.

    def __getitem__(self, rows: slice) -> Rows:  # type: ignore[override]
        """Return a slice of the rows with their spans."""
        first, last, _ = rows.indices(len(self))
        ends = np.concatenate([[0], np.cumsum(self.count)])
        return Rows(
            self.blocks[rows], self.row[rows], self.used[rows], self.smooth[rows],
            self.leads[rows], self.count[rows], self.spans[ends[first] : ends[max(first, last)]],
        )  # fmt: skip

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
