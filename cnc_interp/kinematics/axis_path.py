"""The path in machine axes q(s): in each cell the septic with q, q_s, q_ss, q_sss of both ends."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit

UNSEEN = 1e-12  #: Steps of an axis below this are rounding noise [m, rad].


class PathCells(NamedTuple):
    """The parts of a path that kernels need: s (N,), both ends of cells, and feeds (N - 1,)."""

    s: FloatArray
    left: FloatArray
    right: FloatArray
    feed: FloatArray


@dataclass(frozen=True)
class AxisPath:
    """Machine axes along the path, N grid points and N - 1 cells between them."""

    #: (N,): Path length, strictly increasing: the tool tip's arc length, and in pure rotations
    #: flank height times angle [m].
    s: FloatArray
    #: (4, N - 1, n_axes): q, q_s, q_ss, q_sss at the left and right end of each cell, one-sided [m
    #: or rad, per m]. Value, first and second derivative agree across a grid point; the third may
    #: jump. At a ``stop`` all derivatives may jump.
    cell_left: FloatArray
    cell_right: FloatArray
    #: (N, 3): Tool tip [m] and unit tool axis [-] in W.
    tip: FloatArray
    axis: FloatArray
    #: (N - 1,): Programmed feedrate as ds/dt [m/s]; infinite if only the axes limit the speed.
    cell_feed: FloatArray
    cell_block: IntArray  #: (N - 1,): Row of the block being executed.
    stop: BoolArray  #: (N,): Whether the motion must rest there, as at both ends.

    def __post_init__(self) -> None:
        for column in vars(self).values():
            column.flags.writeable = False

    @property
    def cells(self) -> PathCells:
        return PathCells(self.s, self.cell_left, self.cell_right, self.cell_feed)

    @property
    def q(self) -> FloatArray:
        """Axis positions at the grid points, shape (N, n_axes) [m, rad]."""
        return np.concatenate([self.cell_left[0], self.cell_right[0, -1:]])

    @staticmethod
    def join(parts: list[AxisPath]) -> AxisPath:
        """Join pieces of one path; each begins at the grid point where the one before ends."""
        if len(parts) == 1:
            return parts[0]
        columns = {
            name: np.concatenate([getattr(p, name)[k > 0 :] for k, p in enumerate(parts)])
            for name in OF_POINTS
        }
        joints = np.cumsum([len(p.cell_feed) for p in parts[:-1]])
        columns['stop'][joints] |= [p.stop[0] for p in parts[1:]]
        for name in OF_CELLS:
            axis = 1 if name in BY_ENDS else 0
            columns[name] = np.concatenate([getattr(p, name) for p in parts], axis=axis)
        return AxisPath(**columns)


OF_POINTS = 's', 'tip', 'axis', 'stop'  #: Columns with a row for each grid point.
BY_ENDS = 'cell_left', 'cell_right'  #: Columns with cells along the second axis.
OF_CELLS = *BY_ENDS, 'cell_feed', 'cell_block'


@njit(cache=True, nogil=True)
def septic_coefficients(left: FloatArray, right: FloatArray, h: float, out: FloatArray) -> None:
    """Write the eight coefficients in u = (s - s_left)/h of one axis on one cell.

    The first four are the Taylor cubic of the left end. The others cancel its misfits d0..d3 (of
    value, h q_s, h^2 q_ss, h^3 q_sss) at the right end. A misfit that differs from the smoothest
    course by less than the rounding of q and s is replaced by the value on that course, because
    short cells amplify it by 210/h^3. If axes move far while s hardly changes, misfits above
    ``UNSEEN`` are genuine.
    """
    h2, h3 = h * h, h * h * h
    q0, q1, q2, q3 = left[0], left[1] * h, left[2] * h2 / 2, left[3] * h3 / 6
    d1 = right[1] * h - q1 - 2 * q2 - 3 * q3
    d2 = right[2] * h2 - 2 * q2 - 6 * q3
    d3 = right[3] * h3 - 6 * q3
    d0 = right[0] - q0 - q1 - q2 - q3
    rounding = 2e-15 * (abs(q0) + abs(right[0])) + min(1e-14 * abs(left[1]), UNSEEN)
    if abs(d2 - d3 / 2) <= rounding:
        d2 = d3 / 2
    if abs(d1 - (d2 / 2 - d3 / 12)) <= rounding:
        d1 = d2 / 2 - d3 / 12
    if abs(d0 - (d1 / 2 - d2 / 10 + d3 / 120)) <= rounding:
        d0 = d1 / 2 - d2 / 10 + d3 / 120
    out[0], out[1], out[2], out[3] = q0, q1, q2, q3
    out[4] = 35 * d0 - 15 * d1 + 2.5 * d2 - d3 / 6
    out[5] = -84 * d0 + 39 * d1 - 7 * d2 + d3 / 2
    out[6] = 70 * d0 - 34 * d1 + 6.5 * d2 - d3 / 2
    out[7] = -20 * d0 + 10 * d1 - 2 * d2 + d3 / 6


@njit(cache=True, nogil=True)
def septic_jet(c: FloatArray, u: float, h: float) -> tuple[float, float, float, float]:
    """Return value and three derivatives by s of a septic in u = (s - s_left)/h (Horner)."""
    value, first, second, third = c[7], 0.0, 0.0, 0.0
    for k in range(6, -1, -1):
        third = third * u + second
        second = second * u + first
        first = first * u + value
        value = value * u + c[k]
    h2 = h * h
    return value, first / h, 2 * second / h2, 6 * third / (h2 * h)


@njit(cache=True, nogil=True)
def evaluate_cells(
    s_grid: FloatArray,
    cell_left: FloatArray,
    cell_right: FloatArray,
    along: FloatArray,
    cell: IntArray,
) -> FloatArray:
    """Evaluate q and three derivatives in cells, (4, M, n_axes), ``along`` from their starts."""
    n_axes = cell_left.shape[2]
    out = np.empty((4, len(along), n_axes))
    coefficients = np.empty((n_axes, 8))
    known = -1
    for m in range(len(along)):
        i = cell[m]
        h = s_grid[i + 1] - s_grid[i]
        if i != known:
            for k in range(n_axes):
                septic_coefficients(cell_left[:, i, k], cell_right[:, i, k], h, coefficients[k])
            known = i
        u = along[m] / h
        for k in range(n_axes):
            if 0.0 < u < 1.0:
                q, q_s, q_ss, q_sss = septic_jet(coefficients[k], u, h)
                out[0, m, k], out[1, m, k], out[2, m, k], out[3, m, k] = q, q_s, q_ss, q_sss
                continue
            end = cell_right if u >= 1.0 else cell_left
            for order in range(4):
                out[order, m, k] = end[order, i, k]
    return out


def evaluate(
    path: AxisPath, s: FloatArray, cell: IntArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return q(s) and three derivatives by s, (M, n_axes) each; q is constant beyond the ends.

    ``cell`` (M,): the cells of the places, because a grid point belongs to two cells.
    """
    s = np.asarray(s, dtype=np.float64)
    if cell is None:
        found = np.searchsorted(path.s, s, side='right') - 1
        cell = np.clip(found, 0, len(path.s) - 2).astype(np.int64)
    jets = evaluate_cells(path.s, path.cell_left, path.cell_right, s - path.s[cell], cell)
    return jets[0], jets[1], jets[2], jets[3]


@njit(cache=True, nogil=True)
def _between(
    s: FloatArray,
    cell_right: FloatArray,
    tip: FloatArray,
    axis: FloatArray,
    at: IntArray,
    new: BoolArray,
    way: FloatArray,
    left: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return right ends of cells, tips and tool axes at points ``way`` after old points ``at``."""
    right, tips, axes = np.empty_like(left), np.empty((len(at), 3)), np.empty((len(at), 3))
    for i, p in enumerate(at):
        if i > 0:
            right[:, i - 1] = cell_right[:, at[i - 1]]
        tips[i], axes[i] = tip[p], axis[p]
        if new[i]:
            right[:, i - 1] = left[:, i]
            for rows, old in ((tips, tip), (axes, axis)):
                rows[i] = (old[p + 1] - old[p]) / (s[p + 1] - s[p]) * way[i] + old[p]
            axes[i] /= np.sqrt((axes[i] ** 2).sum())
    return right, tips, axes


def refine(path: AxisPath, s_new: FloatArray) -> AxisPath:
    """Insert grid points at path positions [m] without changing q(s).

    Tip and tool axis of the new points lie on chords.
    """
    inside = (s_new > path.s[0]) & (s_new < path.s[-1])
    s = np.unique(np.concatenate([path.s, s_new[inside]]))
    if len(s) == len(path.s):
        return path
    at = np.searchsorted(path.s, s, 'right') - 1
    cell, new = at[:-1], s > path.s[at]
    way = s - path.s[at]
    left = evaluate_cells(path.s, path.cell_left, path.cell_right, way[:-1], cell)
    old = path.s, path.cell_right, path.tip, path.axis
    right, tip, axis = _between(*old, at, new, way, left)
    feed, block = path.cell_feed[cell], path.cell_block[cell]
    return AxisPath(s, left, right, tip, axis, feed, block, path.stop[at] & ~new)


def cut(path: AxisPath, first: int, last: int) -> AxisPath:
    if first == 0 and last == len(path.s) - 1:
        return path
    columns = {name: getattr(path, name)[first : last + 1].copy() for name in OF_POINTS}
    for name in OF_CELLS:
        cells = getattr(path, name)
        columns[name] = (cells[:, first:last] if name in BY_ENDS else cells[first:last]).copy()
    return AxisPath(**columns)
