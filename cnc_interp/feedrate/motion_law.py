"""MotionLaw: s(t), in closed form piece by piece (the arrow from feedrate to interpolator)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray


@dataclass(frozen=True)
class MotionLaw:
    """
    The motion along the path as K consecutive pieces of constant jerk.

    On a piece that starts at ``time``,
    ``s(t) = s + s_dot dt + s_ddot dt^2 / 2 + jerk dt^3 / 6`` with ``0 <= dt <= duration``;
    s, s_dot and s_ddot are continuous from piece to piece, only the jerk jumps.

    Parameters
    ----------
    time : ndarray, shape (K,)
        Start of each piece since the start of the motion [s].
    duration : ndarray, shape (K,)
        Length of each piece [s].
    s, s_dot, s_ddot : ndarray, shape (K,)
        State at the start of each piece [m, m/s, m/s2].
    jerk : ndarray, shape (K,)
        Constant ``s_dddot`` of each piece [m/s3].
    cell : ndarray of int, shape (K,)
        Cell of the AxisPath in which the piece lies.

    """

    time: FloatArray
    duration: FloatArray
    s: FloatArray
    s_dot: FloatArray
    s_ddot: FloatArray
    jerk: FloatArray
    cell: IntArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    def __len__(self) -> int:
        """Count the pieces."""
        return len(self.time)

    @property
    def end_time(self) -> float:
        """Time at the end of the last piece [s]."""
        return float(self.time[-1] + self.duration[-1])

    def piece_at(self, time: FloatArray) -> IntArray:
        """Find the piece in which each time lies; the first or last one outside the law."""
        found = np.searchsorted(self.time, time, side='right') - 1
        return np.clip(found, 0, len(self.time) - 1).astype(np.int64)

    def evaluate(
        self, time: FloatArray, piece: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """
        Evaluate the motion at many times, in closed form.

        Parameters
        ----------
        time : ndarray, shape (M,)
            Times on the law's clock [s]; held at the law's two ends outside of it.
        piece : ndarray of int, shape (M,), optional
            Piece of each time where the caller knows it (``piece_at``).

        Returns
        -------
        s, s_dot, s_ddot, s_dddot : ndarray, shape (M,)
            Path position and its time derivatives [m, m/s, m/s2, m/s3].

        """
        t = np.asarray(time, dtype=np.float64)
        k = self.piece_at(t) if piece is None else piece
        dt = np.clip(t - self.time[k], 0.0, self.duration[k])
        v, a, j = self.s_dot[k], self.s_ddot[k], self.jerk[k]
        s = self.s[k] + dt * (v + dt * (a / 2 + dt * (j / 6)))
        return s, v + dt * (a + dt * (j / 2)), a + dt * j, j

    @staticmethod
    def join(parts: list[MotionLaw]) -> MotionLaw:
        """Join laws that follow each other in time and path, their cells counted alike."""
        names = [field.name for field in fields(MotionLaw)]
        return MotionLaw(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))
