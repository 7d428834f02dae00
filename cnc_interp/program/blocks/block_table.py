"""Blocks: the meaning of a part program in SI units, one row per block."""

from __future__ import annotations

import tempfile
from math import nan

import numpy as np

from cnc_interp.core import MM, BoolArray, FloatArray, IntArray, InterpError
from cnc_interp.core.tables import Table, column

GO_ON, STOP, OPTIONAL_STOP = 0, 1, 2  #: Values of ``Blocks.program_stop``: continue, M0, M1.
#: Values of ``Blocks.corner``, in order: try rounding and stopping; rounding is faster; stopping
#: is faster; the block is a piece of a longer smooth motion, such as an arc.
OPEN_CORNER, ROUND_CORNER, STOP_CORNER, WITHIN_MOTION = 0, 1, 2, 3
#: Values of ``Blocks.interpolation``: which coordinates are interpolated linearly in a block.
POSES, ROTARY_LINEAR, AXES_LINEAR = 0, 1, 2


class Blocks(Table):
    """The blocks of a part program in order; row 0 is the start pose.

    On a linear row with POSES, the tip moves straight while the tool axis follows a great circle
    [B2013, Eq. 4]. With ROTARY_LINEAR, the tip moves straight while the rotary axes move linearly
    from ``rotary_from``. With AXES_LINEAR, all machine axes move linearly. Successive spline rows,
    up to a linear row or an exact stop, are the control points of a pair of cubic B-splines
    [B2013, section 4.1]; the first control point is at the preceding pose.
    """

    #: Tool tip ``p_WT`` in W at the end of the block, or control point of a spline row [m].
    tip: FloatArray = column(3)
    #: Unit tool axis ``o_W`` in W at the end of the block, from tip to spindle [-].
    axis: FloatArray = column(3)
    #: Rotary positions at the end of the block [rad], NaN if the program does not give them.
    rotary: FloatArray = column(2)
    #: Tip speed in the workpiece [m/s]; infinite for rapids; NaN if ``duration`` is given.
    feedrate: FloatArray = column()
    duration: FloatArray = column()  #: Programmed duration (inverse-time feed, G93) [s], else NaN.
    rapid: BoolArray = column()  #: Whether the block is a rapid (G0).
    #: Whether the tool stops at the end of the block (G61, M0, program end).
    exact_stop: BoolArray = column()
    #: Allowed deviation of the tool tip, and of the point at flank height [m].
    contour_tolerance: FloatArray = column()
    orientation_tolerance: FloatArray = column()
    line_number: IntArray = column()  #: Line of the program text, counted from 1.
    #: Control points of the top curve on spline rows [m]; NaN on linear rows.
    top: FloatArray = column(3, default=nan)
    #: On spline rows, ``t_(i+3) - t_(i+2)`` of control point i in the clamped knot vector [-]; 0
    #: in the first row, in the last two rows and for a repeated knot. NaN on linear rows.
    knot_interval: FloatArray = column(default=nan)
    #: STOP (M0) or OPTIONAL_STOP (M1) if the program waits at the end of the block; else GO_ON.
    program_stop: IntArray = column(default=GO_ON)
    #: Positions of the k extra axes (U V W) at the end of the block [m]; they move linearly with
    #: the tip. If poses give the spin of an arm, the last column is the spin times flank height.
    extra: FloatArray = column('k', default=0.0)
    interpolation: IntArray = column(default=POSES)  #: POSES, ROTARY_LINEAR or AXES_LINEAR.
    #: Rotary positions at the start of rows whose rotary axes run linearly [rad], else NaN.
    rotary_from: FloatArray = column(2, default=nan)
    #: ROUND_CORNER or STOP_CORNER if it is known which one is faster at the end of a block without
    #: exact stop. WITHIN_MOTION if the motion continues smoothly. Otherwise
    #: OPEN_CORNER.
    corner: IntArray = column(default=OPEN_CORNER)

    @staticmethod
    def of_poses(
        tip: FloatArray, axis: FloatArray, feedrate: float, tolerance: float = 0.02 * MM
    ) -> Blocks:
        """Return linear blocks through tips and tool axes in W, (N, 3); row 0 is the start."""
        n = len(tip)
        length = np.linalg.norm(axis, axis=-1)
        if not (np.isfinite(tip).all() and (np.abs(length - 1.0) < 1e-6).all()):
            raise InterpError('poses need finite tips and tool axes of length 1')
        if not (feedrate > 0.0 and 0.0 < tolerance < np.inf):
            raise InterpError('feedrate [m/s] and tolerance [m] of poses must be greater than 0')
        return Blocks(
            tip=tip,
            axis=axis,
            rotary=np.full((n, 2), nan),
            feedrate=np.full(n, feedrate),
            duration=np.full(n, nan),
            rapid=np.zeros(n, dtype=bool),
            exact_stop=np.zeros(n, dtype=bool),
            contour_tolerance=np.full(n, tolerance),
            orientation_tolerance=np.full(n, tolerance),
            line_number=np.arange(1, n + 1),
        )

    @property
    def on_spline(self) -> BoolArray:
        return np.isfinite(self.knot_interval)

    @property
    def by_rotary(self) -> BoolArray:
        return np.asarray(self.interpolation != POSES)


class BlockSpool:
    """A program of any length, stored in an unnamed temporary file and sliced like ``Blocks``."""

    def __init__(self) -> None:
        self._file = tempfile.TemporaryFile()  # noqa: SIM115 (closed by close)
        self._rows = 0
        self._record = np.dtype([])

    def append(self, blocks: Blocks) -> None:
        columns = blocks.columns()
        if not self._rows:
            self._record = np.dtype([(n, c.dtype, c.shape[1:]) for n, c in columns.items()])
        records = np.empty(len(blocks), self._record)
        for name, values in columns.items():
            records[name] = values
        self._file.seek(self._rows * self._record.itemsize)
        self._file.write(records.tobytes())
        self._rows += len(blocks)

    def __len__(self) -> int:
        return self._rows

    def __getitem__(self, rows: slice) -> Blocks:
        first, last, _ = rows.indices(self._rows)
        size = self._record.itemsize
        self._file.seek(first * size)
        records = np.frombuffer(self._file.read(max(0, last - first) * size), self._record)
        return Blocks(*(np.ascontiguousarray(records[name]) for name in Blocks.declared))

    def close(self) -> None:
        self._file.close()

    def __enter__(self) -> BlockSpool:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
