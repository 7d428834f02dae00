"""MotionLaw: the position s as a closed-form function of time; Stretch, the law of one part."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.tables import Table, column
from cnc_interp.feedrate.jerk_rows import follow_widths, node_states
from cnc_interp.kinematics.axis_path import AxisPath, cut, septic_coefficients, septic_jet


class MotionLaw(Table):
    """The motion along the path as K consecutive pieces of constant jerk.

    ``s(t) = s + s_dot dt + s_ddot dt^2 / 2 + jerk dt^3 / 6`` with ``0 <= dt <= duration``. s,
    s_dot and s_ddot are continuous between pieces.
    """

    time: FloatArray = column()  #: Start time of each piece [s].
    duration: FloatArray = column()  #: Duration of each piece [s].
    #: State at the start of each piece [m, m/s, m/s2].
    s: FloatArray = column()
    s_dot: FloatArray = column()
    s_ddot: FloatArray = column()
    jerk: FloatArray = column()  #: Constant ``s_dddot`` of each piece [m/s3].
    cell: IntArray = column()  #: Index of the AxisPath cell that contains the piece.

    @property
    def end_time(self) -> float:
        return float(self.time[-1] + self.duration[-1])

    def piece_at(self, time: FloatArray) -> IntArray:
        """Return the piece of each time [s]; times outside the law have the first or the last."""
        found = np.searchsorted(self.time, time, side='right') - 1
        return np.clip(found, 0, len(self.time) - 1).astype(np.int64)

    def evaluate(
        self, time: FloatArray, piece: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return s and three derivatives at times [s], held outside; ``piece``: ``piece_at``."""
        t = np.asarray(time, dtype=np.float64)
        k = self.piece_at(t) if piece is None else piece
        dt = np.clip(t - self.time[k], 0.0, self.duration[k])
        v, a, j = self.s_dot[k], self.s_ddot[k], self.jerk[k]
        moved = dt * (v + dt * (a / 2 + dt * (j / 6)))
        return self.s[k] + moved, v + dt * (a + dt * (j / 2)), a + dt * j, j


def axis_motion(
    path: AxisPath, law: MotionLaw, time: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, IntArray, FloatArray]:
    """Return q(t): the motion of the axes by a law along its path.

    Parameters
    ----------
    time : FloatArray
        (K,): increasing times; beyond its ends the motion rests [s].

    Returns
    -------
    tuple of arrays
        Positions and three derivatives by time, (K, n_axes) each [m or rad, per s, ...]; rows of
        the blocks, (K,); places on the path, (K,) [m].

    """
    rows = law.time, law.duration, law.s, law.s_dot, law.s_ddot, law.jerk, law.cell
    out, cell, s = _axis_motion(rows, path.s, path.cell_left, path.cell_right, time)
    return out[0], out[1], out[2], out[3], path.cell_block[cell], s


@njit(cache=True, nogil=True, error_model='numpy')
def _axis_motion(
    law: tuple[FloatArray, ...],
    grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    time: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:
    start, duration, s, s_dot, s_ddot, s_dddot, cells = law
    n_axes = left.shape[2]
    out, place = np.empty((4, len(time), n_axes)), np.empty(len(time))
    cell = np.empty(len(time), dtype=np.int64)
    coefficients = np.empty((n_axes, 8))
    row, known, h = 0, -1, 0.0
    for m in range(len(time)):
        while row + 1 < len(start) and start[row + 1] <= time[m]:
            row += 1
        i = cells[row]
        if i != known:
            known, h = i, grid[i + 1] - grid[i]
            for k in range(n_axes):
                septic_coefficients(left[:, i, k], right[:, i, k], h, coefficients[k])
        dt = min(max(time[m] - start[row], 0.0), duration[row])
        j = s_dddot[row]
        moved = dt * (s_dot[row] + dt * (s_ddot[row] / 2 + dt * (j / 6)))
        v, a = s_dot[row] + dt * (s_ddot[row] + dt * (j / 2)), s_ddot[row] + dt * j
        cell[m], place[m] = i, s[row] + moved
        u = (s[row] - grid[i] + moved) / h  # from the start of the cell: it rounds less
        for k in range(n_axes):
            if 0.0 < u < 1.0:
                q, q_s, q_ss, q_sss = septic_jet(coefficients[k], u, h)
            else:
                end = right if u >= 1.0 else left
                q, q_s, q_ss, q_sss = end[0, i, k], end[1, i, k], end[2, i, k], end[3, i, k]
            out[0, m, k] = q
            out[1, m, k] = q_s * v  # Eq. 6
            out[2, m, k] = q_ss * (v * v) + q_s * a  # Eq. 7
            out[3, m, k] = q_sss * v**3 + 3.0 * q_ss * v * a + q_s * j  # Eq. 8
    return out, cell, place


class CellLaw(NamedTuple):
    """A law on the grid of a path, in the form of ``Stretch``."""

    v: FloatArray
    a: FloatArray
    jerk: FloatArray
    duration: FloatArray


@dataclass(frozen=True)
class Stretch:
    """A planned part of the path that ends at rest: N path cells in n planner cells."""

    path: AxisPath  #: The path on the grid of the planner.
    #: (N + 1,): s_dot and s_ddot at the grid points [m/s, m/s2].
    v: FloatArray
    a: FloatArray
    #: (N,): Constant s_dddot in each path cell [m/s3], and the time spent in it [s].
    jerk: FloatArray
    duration: FloatArray
    nodes: IntArray  #: (n + 1,): Grid points at which the planner cells begin and end.
    scale: FloatArray  #: (n, 4, n_axes): Parts of each limit that a planner cell may use [-].
    use: float  #: Largest use of a limit at the checked instants, divided by the accepted use [-].
    converged: bool = True  #: Whether the solver came to the optimum; if not, far perhaps.
    #: (2, n): Parts of the limit on the error at the tool that the rows of tip and axis got [-].
    tool: FloatArray | None = None
    tool_use: float = 0.0  #: Largest error by the simulated drives, over its limit [-].

    @property
    def coefficients(self) -> FloatArray:
        """Coefficients of the planner cells, (n,) [m2/s2]: v^2 + a H, H the effective width."""
        v, a = self.v[self.nodes], self.a[self.nodes]
        width = np.add.reduceat(self.duration, self.nodes[:-1]) * (v[:-1] + v[1:]) / 2
        return np.maximum(v[:-1] ** 2 + a[:-1] * width, np.finfo(np.float64).tiny)

    def after(self, cell: int) -> Stretch:
        first = int(self.nodes[cell])
        return Stretch(
            path=cut(self.path, first, len(self.duration)),
            v=self.v[first:],
            a=self.a[first:],
            jerk=self.jerk[first:],
            duration=self.duration[first:],
            nodes=self.nodes[cell:] - first,
            scale=self.scale[cell:],
            use=self.use,
            converged=self.converged,
            tool=None if self.tool is None else self.tool[:, cell:],
            tool_use=self.tool_use,
        )

    def law(self, start_time: float, last: int) -> MotionLaw:
        time = start_time + np.concatenate([[0.0], np.cumsum(self.duration[:last])])
        state = self.path.s[:last], self.v[:last], self.a[:last], self.jerk[:last]
        return MotionLaw(time[:-1], self.duration[:last], *state, np.arange(last))


@njit(cache=True, nogil=True, error_model='numpy')
def settle_widths(
    h: FloatArray,
    m: FloatArray,
    width: FloatArray,
    ends: FloatArray,
    v: FloatArray,
    a: FloatArray,
    duration: FloatArray,
) -> float:
    """Iterate the widths to rounding: at 1 ms, an error of 1e-12 m appears as 1e-3 m/s3.

    Returns what is left, infinite if a cell takes no time, or no finite one.
    """
    b = np.empty(len(v))
    left = 1.0
    for _ in range(60):
        node_states(m, width, ends, b, a, v)
        left = follow_widths(h, a, v, width)
        if left < 2e-15:
            break
    node_states(m, width, ends, b, a, v)
    for i in range(len(h)):
        duration[i] = 2 * width[i] / (v[i] + v[i + 1])
        if not 0.0 < duration[i] < np.inf:
            left = np.inf
    return left


@njit(cache=True, nogil=True, error_model='numpy')
def time_at(x: float, v: float, a: float, j: float, low: float, high: float) -> float:
    """Solve v t + a t^2/2 + j t^3/6 = x for t between two times (Newton with bisection)."""
    t = 0.5 * (low + high)
    for _ in range(80):
        off = t * (v + t * (a / 2 + t * j / 6)) - x
        if off > 0.0:
            high = t
        else:
            low = t
        speed = v + t * (a + t * j / 2)
        new = t - off / speed if speed > 0.0 else 0.5 * (low + high)
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-16 * high:
            return new
        t = new
    return t


@njit(cache=True, nogil=True, error_model='numpy')
def spread_law(
    s: FloatArray,
    nodes: IntArray,
    v_node: FloatArray,
    a_node: FloatArray,
    duration_node: FloatArray,
) -> CellLaw:
    """Spread the law of the planner cells between ``nodes`` over the path cells inside them."""
    v, a = np.empty(len(s)), np.empty(len(s))
    jerk, duration = np.empty(len(s) - 1), np.empty(len(s) - 1)
    for i in range(len(nodes) - 1):
        first, last = nodes[i], nodes[i + 1]
        total = duration_node[i]
        j = (a_node[i + 1] - a_node[i]) / total
        v[first], a[first] = v_node[i], a_node[i]
        before = 0.0
        for c in range(first, last):
            jerk[c] = j
            if c + 1 == last:
                duration[c] = total - before
                continue
            t = time_at(s[c + 1] - s[first], v_node[i], a_node[i], j, before, total)
            v[c + 1] = v_node[i] + t * (a_node[i] + t * j / 2)
            a[c + 1] = a_node[i] + t * j
            duration[c] = t - before
            before = t
    v[nodes[-1]], a[nodes[-1]] = v_node[-1], a_node[-1]
    return CellLaw(v, a, jerk, duration)
