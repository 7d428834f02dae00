"""MotionLaw: the path position s as a closed-form function of time, piece by piece."""

from __future__ import annotations

import numpy as np
from numba import njit

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.columns import Table, column
from cnc_interp.kinematics.axis_path import AxisPath, septic_coefficients, septic_jet


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
    law: tuple[FloatArray, ...], grid: FloatArray, left: FloatArray, right: FloatArray,
    time: FloatArray,
) -> tuple[FloatArray, IntArray, FloatArray]:  # fmt: skip
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
