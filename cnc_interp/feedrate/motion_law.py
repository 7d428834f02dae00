"""MotionLaw: s(t), in closed form piece by piece (the arrow from feedrate to interpolator)."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.program.blocks import FloatArray, IntArray


@dataclass(frozen=True)
class MotionLaw:
    """
    The motion along the path as K consecutive pieces, each lasting ``duration``.

    With ``b = s_dot^2`` quadratic in s on a piece, ``s_dddot = k s_dot`` where ``k = b''/2``: a
    linear equation with the closed form ``s_dot(t) = v cosh(r t) + (a/r) sinh(r t)``, r^2 = k
    (cosine and sine for k < 0). Pieces from or to rest have constant jerk instead, because there
    b grows as s^(4/3).

    Parameters
    ----------
    time : ndarray, shape (K,)
        Start of each piece since the start of the motion [s].
    duration : ndarray, shape (K,)
        Length of each piece [s].
    s, s_dot, s_ddot : ndarray, shape (K,)
        State at the start of each piece [m, m/s, m/s2].
    rate : ndarray, shape (K,)
        ``k`` of ``s_dddot = k s_dot`` [1/s2].
    jerk : ndarray, shape (K,)
        Constant ``s_dddot`` of pieces from or to rest, else 0 [m/s3].
    cell : ndarray of int, shape (K,)
        Cell of the AxisPath in which the piece lies.

    """

    time: FloatArray
    duration: FloatArray
    s: FloatArray
    s_dot: FloatArray
    s_ddot: FloatArray
    rate: FloatArray
    jerk: FloatArray
    cell: IntArray

    def __post_init__(self) -> None:
        for field in fields(self):
            getattr(self, field.name).flags.writeable = False

    @property
    def end_time(self) -> float:
        """Time at the end of the last piece [s]."""
        return float(self.time[-1] + self.duration[-1])

    @staticmethod
    def join(parts: list[MotionLaw]) -> MotionLaw:
        """Join laws that follow each other in time and path."""
        names = [field.name for field in fields(MotionLaw)]
        return MotionLaw(*(np.concatenate([getattr(p, n) for p in parts]) for n in names))
