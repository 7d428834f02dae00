"""
AxisPath: the path in machine axes, q(s), with exact derivatives on a grid.

Between two grid points every axis is the septic polynomial that takes value, q_s, q_ss and q_sss
of both ends (eighth order in the cell's length), so the feed planner, the interpolator and the
proof read the same curve and none of them needs splines or kinematics.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.program.blocks import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class AxisPath:
    """
    Machine axes along the path, N grid points and N - 1 cells between them.

    Parameters
    ----------
    s : ndarray, shape (N,)
        Path length, strictly increasing: the tool tip's arc length, and in pure rotations flank
        height times angle [m].
    cell_left, cell_right : ndarray, shape (4, N - 1, n_axes)
        q, q_s, q_ss, q_sss at the left and right end of each cell, one-sided [m or rad, per m].
        Value, first and second derivative agree across a grid point; the third may jump. At a
        ``stop`` all derivatives may jump.
    tip, axis : ndarray, shape (N, 3)
        Tool tip [m] and unit tool axis [-] in W.
    cell_feed : ndarray, shape (N - 1,)
        Programmed feedrate in ds/dt [m/s], infinite for rapids and where only axes limit.
    cell_block : ndarray of int, shape (N - 1,)
        Row of the block being executed.
    stop : ndarray of bool, shape (N,)
        True where the motion must come to rest (first and last point of a program included).

    """

    s: FloatArray
    cell_left: FloatArray
    cell_right: FloatArray
    tip: FloatArray
    axis: FloatArray
    cell_feed: FloatArray
    cell_block: IntArray
    stop: BoolArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    @property
    def q(self) -> FloatArray:
        """Axis positions at the grid points, shape (N, n_axes) [m, rad]."""
        return np.concatenate([self.cell_left[0], self.cell_right[0, -1:]])

    @staticmethod
    def join(parts: list[AxisPath]) -> AxisPath:
        """Join pieces of one path; each begins at the grid point where the one before ends."""
        first, rest = parts[0], parts[1:]
        stop = [first.stop]
        for part in rest:
            stop[-1] = np.concatenate([stop[-1][:-1], stop[-1][-1:] | part.stop[:1]])
            stop.append(part.stop[1:])
        return AxisPath(
            s=np.concatenate([first.s] + [p.s[1:] for p in rest]),
            cell_left=np.concatenate([p.cell_left for p in parts], axis=1),
            cell_right=np.concatenate([p.cell_right for p in parts], axis=1),
            tip=np.concatenate([first.tip] + [p.tip[1:] for p in rest]),
            axis=np.concatenate([first.axis] + [p.axis[1:] for p in rest]),
            cell_feed=np.concatenate([p.cell_feed for p in parts]),
            cell_block=np.concatenate([p.cell_block for p in parts]),
            stop=np.concatenate(stop),
        )
