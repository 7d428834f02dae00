"""Rows: the output of the compressor; each row is a line or a part of a curve."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, norm
from cnc_interp.core.tables import Table, column
from cnc_interp.program.blocks import Blocks

TOLERANCES = 'contour_tolerance', 'orientation_tolerance'
#: A block that moves less counts as not moving [m]; angles count at flank height. Travel and turn
#: together displace the point at flank height by less than 1 nm, which the proof ignores.
STANDSTILL = 0.5e-9


def way_between(before: Blocks, after: Blocks, height: float) -> FloatArray:
    """Return the distance of poses: of tip, tool axis, rotary and extra axes, shape (n,) [m].

    If only the rotary positions at the end are known, the distance is infinite.
    """
    begin = np.where(np.isnan(before.rotary), after.rotary_from, before.rotary)
    turn = np.abs(after.rotary - begin)
    turn = np.where(np.isnan(after.rotary), 0.0, np.where(np.isnan(turn), np.inf, turn))
    ways = (
        norm(after.tip - before.tip),
        height * norm(after.axis - before.axis),
        height * turn.max(axis=1),
        np.abs(after.extra - before.extra).max(axis=1, initial=0.0),
    )
    return np.asarray(np.max(ways, axis=0))


def settled(blocks: Blocks, before: Blocks, height: float) -> Blocks:
    """Move the end of each block without motion to the end of the block before it.

    So the next block continues from that end without a step. Small steps may add up to a motion,
    so distances are measured from the last end that moved. The next block takes the smaller
    tolerances of both, because their corners have become one. ``before`` has the last two rows of
    the previous call; the returned rows begin with them.
    """
    rows = Blocks.concatenate([before, blocks])
    still = np.append(False, way_between(rows[:-1], rows[1:], height) < STANDSTILL)
    # The first control point of a spline is the tool's position; the others are not end poses.
    still[1:] &= ~(rows.on_spline[1:] & rows.on_spline[:-1])
    ends = {name: getattr(rows, name).copy() for name in ('tip', 'axis', 'extra', 'rotary')}
    tolerances = {name: getattr(rows, name).copy() for name in TOLERANCES}
    begin, top = rows.rotary_from.copy(), rows.top.copy()
    for i in range(1, len(rows) if still.any() else 0):
        if still[i - 1]:  # the end before has changed
            last = replace(rows[i - 1 : i], **{name: end[i - 1 : i] for name, end in ends.items()})
            way = way_between(last, rows[i : i + 1], height)[0]
            still[i] = way < STANDSTILL and not rows.on_spline[i - 1]
            for tolerance in tolerances.values():
                tolerance[i] = min(tolerance[i - 1], tolerance[i])
        if still[i]:
            top[i] += ends['tip'][i - 1] - ends['tip'][i]
            for end in ends.values():
                known = np.isfinite(end[i]) & np.isfinite(end[i - 1])
                end[i] = np.where(known, end[i - 1], end[i])
    before_it = ends['rotary'][:-1]
    near = np.abs(begin[1:] - before_it) * height < STANDSTILL
    begin[1:] = np.where(near, before_it, begin[1:])
    if not still.any() and np.array_equal(begin, rows.rotary_from, equal_nan=True):
        return rows
    return replace(rows, rotary_from=begin, top=top, **ends, **tolerances)


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
    room: FloatArray = (
        column()
    )  #: Part of the orientation tolerance that the deviation leaves [m].


class Rows(Table):
    """Lines and curves that replace the blocks. Row 0 of a program is the start pose."""

    #: End pose and programmed data of each row. Tolerances are reduced by ``used``.
    blocks: Blocks
    row: IntArray = column()  #: Program row that contains the end of this row.
    #: Contour and orientation deviation of a line from the blocks that it replaces [m].
    used: FloatArray = column(2)
    #: Whether a curve joins the previous row smoothly at the start of this row.
    smooth: BoolArray = column()
    leads: BoolArray = column()  #: Whether the row is a line at whose end a curve begins smoothly.
    count: IntArray = column()  #: Number of spans of the row; 0 for a line.
    spans: Spans  #: Spans of all rows.

    def __getitem__(self, rows: slice) -> Rows:  # type: ignore[override]
        first, last, _ = rows.indices(len(self))
        ends = np.concatenate([[0], np.cumsum(self.count)])
        return Rows(
            self.blocks[rows],
            self.row[rows],
            self.used[rows],
            self.smooth[rows],
            self.leads[rows],
            self.count[rows],
            self.spans[ends[first] : ends[max(first, last)]],
        )

    def moving(self, height: float) -> Rows:
        """Return rows without lines that do not move; their exact stops go to the row before."""
        line = (self.count == 0) & ~self.smooth & ~self.leads
        way = way_between(self.blocks[:-1], self.blocks[1:], height)
        at = np.flatnonzero(np.append(True, ~line[1:] | (way >= STANDSTILL)))
        if len(at) >= len(self):
            return self
        stop = np.logical_or.reduceat(self.blocks.exact_stop, at)
        return Rows(
            replace(self.blocks[at], exact_stop=stop),
            self.row[at],
            self.used[at],
            self.smooth[at],
            self.leads[at],
            self.count[at],
            self.spans,
        )

    @staticmethod
    def plain(blocks: Blocks, first: int) -> Rows:
        """Return blocks as unchanged lines; ``first`` is the program row of the first block."""
        n = len(blocks)
        no = np.zeros(n, dtype=bool)
        return Rows(
            blocks,
            first + np.arange(n),
            np.zeros((n, 2)),
            no,
            no,
            np.zeros(n, dtype=np.int64),
            Spans.none(),
        )
