"""Blocks: what a part program means, in SI, one row per block (the first arrow of the flow)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Blocks:
    """
    Linear blocks of a part program, in order; row 0 is the start pose.

    A row says where the tool goes and how: along a straight line of the tool tip, the tool axis
    turning on the great circle between both orientations [B2013, Eq. 4].

    Parameters
    ----------
    tip : ndarray, shape (n, 3)
        Tool tip ``p_WT`` at the end of the block, in W [m].
    axis : ndarray, shape (n, 3)
        Unit tool axis ``o_W`` at the end of the block, from tip to spindle [-].
    rotary : ndarray, shape (n, 2)
        Rotary axes at the end of the block where the program names them, else NaN [rad].
    feedrate : ndarray, shape (n,)
        Tip speed relative to the workpiece [m/s]; infinite for rapids; NaN where ``duration``
        rules.
    duration : ndarray, shape (n,)
        Programmed duration (inverse-time feed, G93) [s], else NaN.
    rapid : ndarray of bool, shape (n,)
        True for G0.
    exact_stop : ndarray of bool, shape (n,)
        True where the tool must come to rest at the end of the block (G61, M0, program end).
    contour_tolerance, orientation_tolerance : ndarray, shape (n,)
        Largest deviation of the tool tip, and of the point at flank height [m].
    line_number : ndarray of int, shape (n,)
        Line of the source text, from 1.

    """

    tip: FloatArray
    axis: FloatArray
    rotary: FloatArray
    feedrate: FloatArray
    duration: FloatArray
    rapid: BoolArray
    exact_stop: BoolArray
    contour_tolerance: FloatArray
    orientation_tolerance: FloatArray
    line_number: IntArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    def __len__(self) -> int:
        """Count the rows, start pose included."""
        return len(self.tip)

    def __getitem__(self, rows: slice) -> Blocks:
        """Take a slice of rows."""
        return Blocks(*(getattr(self, field.name)[rows] for field in fields(self)))

    @staticmethod
    def concatenate(parts: list[Blocks]) -> Blocks:
        """Join batches end to end."""
        names = [field.name for field in fields(Blocks)]
        return Blocks(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
