"""MotionLaw: the path position s as a closed-form function of time, piece by piece."""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.columns import Table, column


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
        return self.s[k] + self.moved(t, k), v + dt * (a + dt * (j / 2)), a + dt * j, j

    def moved(self, time: FloatArray, piece: IntArray) -> FloatArray:
        """Return the path length since the start of the pieces [m] at times [s]."""
        dt = np.clip(time - self.time[piece], 0.0, self.duration[piece])
        v, a, j = self.s_dot[piece], self.s_ddot[piece], self.jerk[piece]
        return np.asarray(dt * (v + dt * (a / 2 + dt * (j / 6))))
