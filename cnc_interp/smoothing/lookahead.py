"""The look-ahead: from blocks to smooth segments.

Runs of short blocks first become curves (``compressor.py``). Then each vertex between the
remaining blocks is classified: a corner is rounded, at a stop the tool rests, and otherwise the
path continues straight. Where a stop is faster than a rounded corner, the tool rests, too
(``stop_choice.py``). A corner is final when the size of the next corner is known, because both may
have to share a short line between them. The result does not depend on how the blocks are divided
into batches.
"""

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners import corner_curve, vertices
from cnc_interp.smoothing.corners.corner_curve import PAPER_RATIO, Corners, Style, ratios_at
from cnc_interp.smoothing.corners.vertices import Legs
from cnc_interp.smoothing.dense.compressor import Compressor
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.emission import Emission
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.smoothing.stop_choice import Choice, StopChoice

LEFT_OVER = 0.05  #: If a line is shorter than this share of its block, corners cover it [-].
#: The same for the paper's corners: they cover rounding errors only [-].
ROUNDING = 1e-9


class LookAhead:
    def __init__(
        self,
        settings: Settings,
        machine: MachineTraits,
        choice: Choice | None = None,
        row: int = 0,
        joined: bool = False,
        stops: list[int] | None = None,
    ):
        self._settings, self._machine = settings, machine
        self._style = Style.of(settings)
        self._ratio = settings.corner_ratio
        if self._ratio is None and self._style.literal:
            self._ratio = PAPER_RATIO
        self._rows: Rows | None = None
        # Corners made for comparison stay corners.
        choice = None if settings.compares_corners else choice
        self._compressor = Compressor(settings, machine, choice, row, joined)
        stops = [] if stops is None else stops
        self._choice = StopChoice(choice, machine, settings.flank_height, stops)
        self._outer_before = 0.0  # L2 after the first kept vertex, before left-overs are shared

    def push(self, blocks: Blocks) -> PathSegments:
        return self._take(self._compressor.push(blocks), final=False)

    def finish(self, joined: bool = False) -> PathSegments:
        return self._take(self._compressor.finish(joined), final=True)

    def whole(self, blocks: Blocks) -> PathSegments:
        """Return the segments of all blocks at once; ``push`` and ``finish`` give the same."""
        rows = [self._compressor.push(blocks), self._compressor.finish()]
        return self._take(Rows.concatenate(rows), final=True)

    def _take(self, rows: Rows, final: bool) -> PathSegments:
        if self._rows is not None:
            rows = Rows.concatenate([self._rows, rows])
        rows = rows.moving(self._settings.flank_height)
        self._rows, blocks = rows, rows.blocks
        if len(blocks) < 2:
            return PathSegments.none()
        legs = Legs.of(blocks, self._machine, self._settings.flank_height)
        vertices.refuse_reversals(rows, legs)
        vertex = vertices.classify(rows, legs, self._settings.flank_height, self._machine)
        decided = self._choice.decide(rows, legs, vertex, final)
        inner, outer = self._size(rows, legs, vertex)
        outer[0, 1] = self._outer_before
        # A vertex is final when its own corner and the next one have their size (left-overs).
        last = len(blocks) - 1 if final else min(len(blocks) - 3, decided - 2)
        if last < 1:
            return PathSegments.none()
        own_share = float(outer[last, 1])
        self._share_left_overs(legs, outer, len(blocks) - 1 if final else last + 1)
        segments = Emission(rows, legs, vertex, inner, outer, self._style, self._machine).segments(
            last
        )
        self._outer_before = own_share
        self._rows = rows[last:]
        self._choice.keep(rows, vertex, last)
        return segments

    def _size(self, lines: Rows, legs: Legs, vertex: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return L1, shape (n,), and L2, shape (n, 2), of every vertex [m]; 0 without a corner."""
        inner, outer = np.zeros(len(lines)), np.zeros((len(lines), 2))
        rows = np.flatnonzero(vertex == vertices.ROUND)
        rows = self._size_in_axes(lines, legs, rows, inner, outer)
        if len(rows):
            corners = vertices.corners_at(
                lines.blocks, legs, rows, self._machine, self._settings.flank_height
            )
            half = self._available(lines, legs, rows)
            ratios = self._ratios(corners)
            start = corner_curve.initial_lengths(corners, half, ratios, self._style.literal)
            inner[rows], outer[rows], _, _ = corner_curve.fit(corners, *start, self._style, ratios)
        return inner, outer

    @staticmethod
    def _available(lines: Rows, legs: Legs, rows: IntArray) -> FloatArray:
        """Return the length that corners may use of the lines on both sides, (n, 2) [m]."""
        # A line with a curve at its other end belongs to one corner only.
        alone = np.stack([lines.smooth[rows], lines.leads[rows + 1]], axis=1)
        half = np.stack([legs.length[rows - 1], legs.length[rows]], axis=1)
        return np.where(alone, half, 0.5 * half)

    def _size_in_axes(
        self, lines: Rows, legs: Legs, rows: IntArray, inner: FloatArray, outer: FloatArray
    ) -> IntArray:
        height, jerk = self._settings.flank_height, self._machine.max_jerk
        corners = vertices.axis_corners(lines, legs, height, self._machine, rows)
        if corners is None or jerk is None or not len(corners.row):
            return rows
        own = corners.row
        lengths = self._available(lines, legs, own)
        inner[own], outer[own] = corners.sizes(lengths, self._ratio, jerk)
        return rows[~np.isin(rows, own)]

    def _ratios(self, corners: Corners) -> FloatArray:
        """Return L2/L1 on both sides of corners, shape (n, 2): the setting, or the best value."""
        if self._ratio is not None:
            return np.full((len(corners.tip), 2), self._ratio)
        return ratios_at(corners, self._settings.flank_height, self._machine.axis_rates)

    def _share_left_overs(self, legs: Legs, outer: FloatArray, known: int) -> None:
        """Enlarge corners to cover the rest of a line if it is too short for a segment."""
        used = outer[:known, 1] + outer[1 : known + 1, 0]
        length = legs.length[:known]
        rest = length - used
        share = ROUNDING if self._style.literal else LEFT_OVER
        stretch = (rest < share * length) & (used > 0.0)
        factor = np.where(stretch, length / np.where(used > 0.0, used, 1.0), 1.0)
        outer[:known, 1] *= factor
        outer[1 : known + 1, 0] *= factor
