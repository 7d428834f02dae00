"""Blocks: the meaning of a part program in SI units, one row per block."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray

#: Values of ``Blocks.program_stop``: continue, M0, M1.
GO_ON, STOP, OPTIONAL_STOP = 0, 1, 2
#: Values of ``Blocks.corner``: whether a stop is faster is tried, or known.
OPEN_CORNER, ROUND_CORNER, STOP_CORNER = 0, 1, 2
#: Values of ``Blocks.interpolation``: what runs linearly in a block.
POSES, ROTARY_LINEAR, AXES_LINEAR = 0, 1, 2


@dataclass(frozen=True)
class Blocks:
    """
    The blocks of a part program in order; row 0 is the start pose.

    ``interpolation`` says what a linear row interpolates. POSES: the tool tip moves on a straight
    line to the end pose, and the tool axis turns on the great circle between both orientations
    [B2013, Eq. 4]. ROTARY_LINEAR: the tip moves on a straight line, and the rotary axes run
    linearly from ``rotary_from`` to ``rotary``. AXES_LINEAR: all machine axes run linearly, the
    rotary axes likewise.

    A spline row is one control point of a pair of cubic B-splines [B2013, section 4.1].
    Consecutive spline rows form one curve. Its first row repeats the pose before it. A linear row
    or an exact stop ends the curve.
    """

    #: (n, 3): Tool tip ``p_WT`` in W at the end of the block, or control point of a spline row
    #: [m].
    tip: FloatArray
    #: (n, 3): Unit tool axis ``o_W`` in W at the end of the block, from tip to spindle [-].
    axis: FloatArray
    #: (n, 2): Rotary positions at the end of the block [rad], NaN if the program does not name
    #: them.
    rotary: FloatArray
    #: (n,): Tip speed relative to the workpiece [m/s]; infinite for rapids; NaN if ``duration`` is
    #: given.
    feedrate: FloatArray
    duration: FloatArray  #: (n,): Programmed duration (inverse-time feed, G93) [s], else NaN.
    rapid: BoolArray  #: (n,): Whether the block is a rapid (G0).
    #: (n,): Whether the tool rests at the end of the block (G61, M0, program end).
    exact_stop: BoolArray
    #: (n,): Largest deviation of the tool tip, and of the point at flank height [m].
    contour_tolerance: FloatArray
    orientation_tolerance: FloatArray
    line_number: IntArray  #: (n,): Line of the program text, counted from 1.
    #: (n, 3): Control points of the second curve on spline rows [m], else NaN.
    top: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    #: (n,): On spline rows, ``t_(i+3) - t_(i+2)`` of control point i in the clamped knots of its
    #: curve [-]. It is 0 in the first row, in the last two rows and for a repeated knot. NaN on
    #: linear rows. Without ``top`` and ``knot_interval`` all rows are linear.
    knot_interval: FloatArray = field(default_factory=lambda: np.zeros(0))
    #: (n,): STOP (M0) or OPTIONAL_STOP (M1) if the program waits for the operator at the end of
    #: the block. Such a block has an exact stop. Otherwise GO_ON, which is the default.
    program_stop: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    #: (n, k): Positions of the k extra axes of the machine (U V W) at the end of the block [m].
    #: They run linearly with the tip. The default is k = 0.
    extra: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    #: (n,): POSES, which is the default, ROTARY_LINEAR or AXES_LINEAR.
    interpolation: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    #: (n, 2): Rotary positions at the start of rows whose rotary axes run linearly, beside the tip
    #: or about the resting tip [rad], else NaN.
    rotary_from: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    #: (n,): ROUND_CORNER or STOP_CORNER if it is known which is faster at the end of the block,
    #: where the path is not smooth and need not rest. Otherwise OPEN_CORNER, which is the default.
    corner: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if len(self.knot_interval) != len(self.tip):
            object.__setattr__(self, 'top', np.full(np.shape(self.tip), np.nan))
            object.__setattr__(self, 'knot_interval', np.full(len(self.tip), np.nan))
        if len(self.program_stop) != len(self.tip):
            object.__setattr__(self, 'program_stop', np.full(len(self.tip), GO_ON))
        if len(self.extra) != len(self.tip):
            object.__setattr__(self, 'extra', np.zeros((len(self.tip), 0)))
        if len(self.interpolation) != len(self.tip):
            object.__setattr__(self, 'interpolation', np.full(len(self.tip), POSES))
            object.__setattr__(self, 'rotary_from', np.full((len(self.tip), 2), np.nan))
        if len(self.corner) != len(self.tip):
            object.__setattr__(self, 'corner', np.full(len(self.tip), OPEN_CORNER))
        for column in fields(self):
            getattr(self, column.name).flags.writeable = False

    def __len__(self) -> int:
        """Return the number of rows, start pose included."""
        return len(self.tip)

    def __getitem__(self, rows: slice | IntArray) -> Blocks:
        """Return the rows at these indices."""
        return Blocks(*(getattr(self, column.name)[rows] for column in fields(self)))

    @property
    def on_spline(self) -> BoolArray:
        """Return which rows are control points of native B-splines, shape (n,)."""
        return np.isfinite(self.knot_interval)

    @property
    def by_rotary(self) -> BoolArray:
        """Return in which rows the rotary axes run linearly, shape (n,)."""
        return np.asarray(self.interpolation != POSES)

    @staticmethod
    def concatenate(parts: list[Blocks]) -> Blocks:
        """Join batches of blocks in order."""
        parts = [part for part in parts if len(part)] or parts[:1]
        names = [column.name for column in fields(Blocks)]
        return Blocks(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))
