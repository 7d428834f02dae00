"""
The look-ahead: blocks in, smooth segments out, the same however the blocks arrive.

Runs of short blocks are made into curves first (``compressor.py``). A vertex between two of the
blocks that are left becomes one of three things: a corner (rounded), a stop (the tool
rests there), or nothing (the path goes straight on). A corner is final when the next one is
sized, because the line between them may be so short that both take what is left of it.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.corners import corner
from cnc_interp.smoothing.corners.corner import Corners, Style
from cnc_interp.smoothing.corners.ratio import ratios_at
from cnc_interp.smoothing.corners.vertices import (
    ROUND,
    Legs,
    classify,
    corners_at,
    refuse_reversals,
)
from cnc_interp.smoothing.dense.compressor import Compressor
from cnc_interp.smoothing.dense.rows import Rows
from cnc_interp.smoothing.emission import Emission, no_segments
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.segments import PathSegments

#: A line shorter than this share of its block goes to the corners [-].
LEFT_OVER = 0.05


class LookAhead:
    """
    Round the corners of a stream of blocks.

    Parameters
    ----------
    settings : Settings
        The user's choices.
    machine : MachineTraits
        What smoothing must know of the machine.
    row : int
        Row in the program of the first block to come.
    joined : bool
        Whether a native spline ends at the first pose, so that the first block stays a line.

    """

    def __init__(
        self, settings: Settings, machine: MachineTraits, row: int = 0, joined: bool = False
    ):
        self._settings, self._machine = settings, machine
        self._style = Style.of(settings)
        self._none = no_segments(self._style)
        self._compressor = Compressor(settings, machine, row, joined)
        self._rows: Rows | None = None
        self._outer_before = 0.0  # L2 of the corner at the first kept vertex, unstretched

    def push(self, blocks: Blocks) -> PathSegments:
        """
        Take further blocks and return the segments that are final.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program; the very first row is the start pose.

        Returns
        -------
        PathSegments
            Possibly empty.

        Raises
        ------
        BlockError
            If a block's tool axis reverses (no plane of rotation).

        """
        return self._take(self._compressor.push(blocks), final=False)

    def finish(self, joined: bool = False) -> PathSegments:
        """
        Return the remaining segments; the tool rests at the end.

        With ``joined`` the last block stays a line, for a native spline goes on from it.
        """
        return self._take(self._compressor.finish(joined), final=True)

    def _take(self, rows: Rows, final: bool) -> PathSegments:
        """Emit every line and curve whose both end vertices are final."""
        if self._rows is not None:
            rows = Rows.concatenate([self._rows, rows])
        self._rows, blocks = rows, rows.blocks
        if len(blocks) < 2:
            return self._none
        legs = Legs.of(blocks)
        refuse_reversals(rows, legs)
        vertex = classify(rows, legs, self._settings.flank_height, self._machine)
        inner, outer = self._size(rows, legs, vertex)
        outer[0, 1] = self._outer_before
        # A vertex is final when its own corner is sized and its neighbour's too (left-overs).
        last = len(blocks) - 1 if final else len(blocks) - 3
        if last < 1:
            return self._none
        own_share = float(outer[last, 1])
        self._share_left_overs(legs, outer, len(blocks) - 1 if final else last + 1)
        segments = Emission(rows, legs, vertex, inner, outer, self._style).segments(last)
        self._outer_before = own_share
        self._rows = rows[last:]
        return segments

    def _size(self, lines: Rows, legs: Legs, vertex: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return L1, shape (n,), and both L2, shape (n, 2), of every vertex; 0 without corner."""
        inner, outer = np.zeros(len(lines)), np.zeros((len(lines), 2))
        rows = np.flatnonzero(vertex == ROUND)
        if len(rows):
            corners = corners_at(lines.blocks, legs, rows)
            # a line that a curve joins belongs to its only corner
            alone = np.stack([lines.smooth[rows], lines.leads[rows + 1]], axis=1)
            half = np.stack([legs.length[rows - 1], legs.length[rows]], axis=1)
            half = np.where(alone, half, 0.5 * half)
            ratios = self._ratios(corners)
            start = corner.first_lengths(corners, half, ratios)
            inner[rows], outer[rows], _, _ = corner.fit(corners, *start, self._style, ratios)
        return inner, outer

    def _ratios(self, corners: Corners) -> FloatArray:
        """Return L2/L1 on both sides of corners, shape (n, 2): as told, or chosen for each."""
        ratio = self._settings.corner_ratio
        if ratio is not None:
            return np.full((len(corners.tip), 2), ratio)
        return ratios_at(corners, self._settings.flank_height, self._machine.axis_rates)

    def _share_left_overs(self, legs: Legs, outer: FloatArray, known: int) -> None:
        """Stretch the corners over lines that are too short to be worth keeping."""
        used = outer[:known, 1] + outer[1 : known + 1, 0]
        length = legs.length[:known]
        rest = length - used
        stretch = (rest < LEFT_OVER * length) & (used > 0.0)
        factor = np.where(stretch, length / np.where(used > 0.0, used, 1.0), 1.0)
        outer[:known, 1] *= factor
        outer[1 : known + 1, 0] *= factor
