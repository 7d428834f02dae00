"""The sizes of corners, and how long rows of lines and curves would take with them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.corners import corner
from cnc_interp.smoothing.corners.corner import PAPER_RATIO, Corners, Style
from cnc_interp.smoothing.corners.ratio import ratios_at
from cnc_interp.smoothing.corners.vertices import (
    ROUND,
    Legs,
    axis_corners,
    classify,
    corners_at,
)
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.emission import Emission
from cnc_interp.smoothing.motion_time import segment_times

#: A line shorter than this share of its block goes to the corners [-].
LEFT_OVER = 0.05
#: The same with the paper's corners, which are enlarged by rounding errors only [-].
ROUNDING = 1e-9


class Rounding:
    """Chooses the sizes of corners for the settings of a run."""

    def __init__(self, settings: Settings, machine: MachineTraits):
        self._settings, self._machine = settings, machine
        self.style = Style.of(settings)
        self._ratio = settings.corner_ratio
        if self._ratio is None and self.style.literal:
            self._ratio = PAPER_RATIO

    def times(self, alternatives: list[Rows]) -> FloatArray:
        """
        Estimate how long the machine takes for several paths from rest to rest [s].

        The paths are rounded as one, with a stop at both ends of each. The lines that lead from
        one to the next do not count.
        """
        parts = []
        for k, rows in enumerate(alternatives):
            row = np.full(len(rows), k)
            exact = rows.blocks.exact_stop.copy()
            row[0], exact[0], exact[-1] = -1, True, True
            blocks = replace(rows.blocks, exact_stop=exact)
            spans = replace(rows.spans, block=np.full_like(rows.spans.block, k))
            parts.append(replace(rows, blocks=blocks, row=row, spans=spans))
        rows = Rows.concatenate(parts)
        height, last = self._settings.flank_height, len(rows) - 1
        legs = Legs.of(rows.blocks, self._machine, height)
        vertex = classify(rows, legs, height, self._machine)
        inner, outer = self.size(rows, legs, vertex)
        self.share_left_overs(legs, outer, last)
        emission = Emission(rows, legs, vertex, inner, outer, self.style, self._machine)
        segments = emission.segments(last)
        times = segment_times(segments, self._machine)
        return np.bincount(segments.block[:, 1] + 1, times, len(alternatives) + 1)[1:]

    def size(self, lines: Rows, legs: Legs, vertex: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return L1, shape (n,), and L2, shape (n, 2), of every vertex [m]; 0 without a corner."""
        inner, outer = np.zeros(len(lines)), np.zeros((len(lines), 2))
        rows = np.flatnonzero(vertex == ROUND)
        rows = self._size_in_axes(lines, legs, rows, inner, outer)
        if len(rows):
            corners = corners_at(
                lines.blocks, legs, rows, self._machine, self._settings.flank_height
            )
            half = self._available(lines, legs, rows)
            ratios = self._ratios(corners)
            start = corner.initial_lengths(corners, half, ratios, self.style.literal)
            inner[rows], outer[rows], _, _ = corner.fit(corners, *start, self.style, ratios)
        return inner, outer

    @staticmethod
    def _available(lines: Rows, legs: Legs, rows: IntArray) -> FloatArray:
        """Return how much of the lines before and after corners they may use, (n, 2) [m]."""
        # A line with a curve at its other end belongs to one corner only.
        alone = np.stack([lines.smooth[rows], lines.leads[rows + 1]], axis=1)
        half = np.stack([legs.length[rows - 1], legs.length[rows]], axis=1)
        return np.where(alone, half, 0.5 * half)

    def _size_in_axes(
        self, lines: Rows, legs: Legs, rows: IntArray, inner: FloatArray, outer: FloatArray
    ) -> IntArray:
        """Write L1 and L2 of corners in coordinates; return the other corners."""
        height, jerk = self._settings.flank_height, self._machine.max_jerk
        corners = axis_corners(lines, legs, height, self._machine, rows)
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

    def share_left_overs(self, legs: Legs, outer: FloatArray, known: int) -> None:
        """Enlarge corners to cover the rest of a line that is too short to keep."""
        used = outer[:known, 1] + outer[1 : known + 1, 0]
        length = legs.length[:known]
        rest = length - used
        share = ROUNDING if self.style.literal else LEFT_OVER
        stretch = (rest < share * length) & (used > 0.0)
        factor = np.where(stretch, length / np.where(used > 0.0, used, 1.0), 1.0)
        outer[:known, 1] *= factor
        outer[1 : known + 1, 0] *= factor
