"""How much of their tolerances the segments of a program use; memory does not grow with it."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.differences import ROUNDING
from cnc_interp.core.errors import BlockError
from cnc_interp.core.units import UM
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.segments import PathSegments


class ToleranceUse:
    """
    Compares the certified deviations of segments with the tolerances of their blocks.

    Where tolerances change, or native splines begin or end, a mark is kept: the row, both
    tolerances from there on, and whether the rows are control points.
    """

    def __init__(self) -> None:
        self._marks = np.zeros((0, 4))
        self._lines = np.zeros(0, dtype=np.int64)
        self._rows = 0
        self.largest = np.zeros(2)

    def blocks(self, blocks: Blocks) -> None:
        """Add further rows of the program."""
        rows = self._rows + np.arange(len(blocks))
        told = np.column_stack(
            [rows, blocks.contour_tolerance, blocks.orientation_tolerance, blocks.on_spline]
        )
        known = self._marks[-1:, 1:] if len(self._marks) else np.full((1, 3), np.nan)
        changed = np.diff(told[:, 1:], axis=0, prepend=known).astype(bool).any(axis=1)
        self._marks = np.concatenate([self._marks, told[changed]])
        self._lines = np.concatenate([self._lines, blocks.line_number[changed]])
        self._rows += len(blocks)

    def segments(self, segments: PathSegments) -> BoolArray:
        """Check further segments, whose blocks are known; return which are of native splines."""
        if not len(segments):
            return np.zeros(0, dtype=np.bool_)
        place = np.searchsorted(self._marks[:, 0], segments.block, 'right') - 1
        share = segments.deviation / self._marks[place, 1:3].min(axis=1)
        self.largest = np.maximum(self.largest, share.max(axis=0))
        native: BoolArray = self._marks[place[:, 1], 3] > 0.0
        self._marks, self._lines = self._marks[place.min() :], self._lines[place.min() :]
        return native

    def require(self, segments: PathSegments) -> None:
        """Check segments; raise BlockError with the line if one leaves its tolerances."""
        lines, marks = self._lines, self._marks
        self.segments(segments)
        if (self.largest <= ROUNDING).all():
            return
        place = np.searchsorted(marks[:, 0], segments.block, 'right') - 1
        tolerance: FloatArray = marks[place, 1:3].min(axis=1)
        at, kind = np.unravel_index(
            int(np.argmax(segments.deviation / tolerance)), tolerance.shape
        )
        raise BlockError(
            f'the rounded path leaves the {("contour", "orientation")[kind]} tolerance: '
            f'{segments.deviation[at, kind] / UM:.4g} um of {tolerance[at, kind] / UM:.4g} um; '
            'plan with --no-compress, and report the program',
            int(lines[place[at, 1]]),
        )
