"""From the jerk stage's coefficients to an exact law: states, durations, cells of the path."""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.feedrate.jerk_rows import follow_widths, node_states
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.kinematics.axis_path import AxisPath, cut


@dataclass(frozen=True)
class Stretch:
    """
    A planned stretch down to rest: N cells of the path, in n cells of the planner.

    Parameters
    ----------
    path : AxisPath
        The path on the planner's grid.
    v, a : ndarray, shape (N + 1,)
        s_dot and s_ddot at the grid points [m/s, m/s2].
    jerk, duration : ndarray, shape (N,)
        Constant s_dddot in each cell and the time spent in it [m/s3, s].
    nodes : ndarray of int, shape (n + 1,)
        Grid points that bound the planner's cells.
    scale : ndarray, shape (n, 4, n_axes)
        Parts of the limits that were allowed to the planner's cells, corrections included.
    use : float
        Largest use of any limit over all instants checked, over what is accepted.

    """

    path: AxisPath
    v: FloatArray
    a: FloatArray
    jerk: FloatArray
    duration: FloatArray
    nodes: IntArray
    scale: FloatArray
    use: float

    def after(self, cell: int) -> Stretch:
        """Take what follows from a cell of the planner on."""
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
        )

    def law(self, start_time: float, last: int) -> MotionLaw:
        """Build the law up to a grid point of the path."""
        time = start_time + np.concatenate([[0.0], np.cumsum(self.duration[:last])])
        return MotionLaw(
            time=time[:-1],
            duration=self.duration[:last].copy(),
            s=self.path.s[:last].copy(),
            s_dot=self.v[:last].copy(),
            s_ddot=self.a[:last].copy(),
            jerk=self.jerk[:last].copy(),
            cell=np.arange(last, dtype=np.int64),
        )


@numba.njit(cache=True, nogil=True, error_model='numpy')
def settle(
    h: FloatArray,
    m: FloatArray,
    width: FloatArray,
    ends: FloatArray,
    v: FloatArray,
    a: FloatArray,
    duration: FloatArray,
) -> float:
    """
    Bring the effective widths to rounding for fixed coefficients; returns what is left.

    Then position, speed and acceleration fit from cell to cell to the last digits, which third
    differences of the emitted positions ask for: 1e-12 m is 1e-3 m/s3 at 1 ms.
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
    return left


@numba.njit(cache=True, nogil=True, error_model='numpy')
def time_at(x: float, v: float, a: float, j: float, low: float, high: float) -> float:
    """Find when v t + a t^2/2 + j t^3/6 reaches x between two times (Newton, safeguarded)."""
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


@numba.njit(cache=True, nogil=True, error_model='numpy')
def spread(
    s: FloatArray,
    nodes: IntArray,
    v_node: FloatArray,
    a_node: FloatArray,
    duration_node: FloatArray,
    v: FloatArray,
    a: FloatArray,
    jerk: FloatArray,
    duration: FloatArray,
) -> None:
    """Spread the law of the planner's cells over the cells of the path inside them."""
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
