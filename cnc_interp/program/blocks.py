"""Blocks: what a part program means, in SI, one row per block (the first arrow of the flow)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray

#: Values of ``Blocks.program_stop``: go on, M0, M1.
GO_ON, STOP, OPTIONAL_STOP = 0, 1, 2


@dataclass(frozen=True)
class Blocks:
    """
    Blocks of a part program, in order; row 0 is the start pose.

    A linear row says where the tool goes and how: along a straight line of the tool tip, the tool
    axis turning on the great circle between both orientations [B2013, Eq. 4]. A spline row is one
    control point of a pair of cubic B-splines, as in native programs [B2013, section 4.1]:
    consecutive spline rows make one curve. Its first row repeats the pose before it, its last one
    is followed by a linear row or has an exact stop.

    Parameters
    ----------
    tip : ndarray, shape (n, 3)
        Tool tip ``p_WT`` at the end of the block, in W; control point of spline rows [m].
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
    top : ndarray, shape (n, 3)
        Control points of the second curve, on the tool axis, of spline rows [m]; else NaN.
    knot_interval : ndarray, shape (n,)
        Spline rows: ``t_(i+3) - t_(i+2)`` of control point i in the clamped knots of its curve, so
        0 in the first row, in the last two and for a repeated knot [-]. NaN on linear rows.
        Without ``top`` and ``knot_interval`` all rows are linear.
    program_stop : ndarray of int, shape (n,)
        STOP (M0) or OPTIONAL_STOP (M1) where the operator is waited for at the end of the block,
        which has an exact stop then, else GO_ON; without it all are GO_ON.

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
    top: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    knot_interval: FloatArray = field(default_factory=lambda: np.zeros(0))
    program_stop: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if len(self.knot_interval) != len(self.tip):
            object.__setattr__(self, 'top', np.full(np.shape(self.tip), np.nan))
            object.__setattr__(self, 'knot_interval', np.full(len(self.tip), np.nan))
        if len(self.program_stop) != len(self.tip):
            object.__setattr__(self, 'program_stop', np.full(len(self.tip), GO_ON))
        for column in fields(self):
            getattr(self, column.name).flags.writeable = False

    def __len__(self) -> int:
        """Count the rows, start pose included."""
        return len(self.tip)

    def __getitem__(self, rows: slice | IntArray) -> Blocks:
        """Take some of the rows."""
        return Blocks(*(getattr(self, column.name)[rows] for column in fields(self)))

    @property
    def on_spline(self) -> BoolArray:
        """True for the rows that are control points of native B-splines, shape (n,)."""
        return np.isfinite(self.knot_interval)

    @staticmethod
    def concatenate(parts: list[Blocks]) -> Blocks:
        """Join batches end to end."""
        names = [column.name for column in fields(Blocks)]
        return Blocks(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
