"""
The model of the simulated drives: how an axis follows its setpoints.

Every axis is a position loop with velocity feed-forward around a velocity loop that answers as a
first-order lag,

    x' = v,    tau v' = kv (r - x) + f r' - v,

so X/R = (f s + kv) / (tau s^2 + s + kv): stable for all kv, tau > 0, damping 1 / (2 sqrt(kv tau)).
On a ramp of speed V it lags by (1 - f) V / kv, under constant acceleration a by tau a / kv more.
Between two setpoints the drive interpolates r and r' linearly (first-order hold). The step over
one period is then exact, by the matrix exponential, whatever the period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import carray, cfunc, njit, types

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import StreamError
from cnc_interp.machine.native import pointer


@dataclass(frozen=True)
class DriveModel:
    """
    Parameters of the drives, the same for all axes.

    Parameters
    ----------
    position_gain : float
        ``kv`` [1/s].
    feed_forward : float
        Share ``f`` of the setpoint's velocity that is fed forward, 0 to 1.
    time_constant : float
        Lag ``tau`` of the velocity loop [s].

    """

    position_gain: float = 100.0
    feed_forward: float = 1.0
    time_constant: float = 2e-3

    def __post_init__(self) -> None:
        for name in ('position_gain', 'time_constant'):
            if not 0.0 < getattr(self, name) < np.inf:
                raise StreamError(f'{name} of the drives must be positive')
        if not 0.0 <= self.feed_forward <= 1.0:
            raise StreamError('feed_forward of the drives must lie between 0 and 1')

    @property
    def lag(self) -> float:
        """How far an axis follows behind its setpoint, about [s]."""
        return 1.0 / self.position_gain + self.time_constant

    def discretise(self, period: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """
        Solve one period exactly for inputs (r, r') that run linearly.

        Returns
        -------
        transition, held, rising : ndarray, shape (2, 2)
            ``z+ = transition z + held u + rising (u+ - u)`` with ``z = (x, v)``.

        """
        from scipy.linalg import expm  # takes a tenth of a second that other nodes need not wait

        kv, f, tau = self.position_gain, self.feed_forward, self.time_constant
        # z' = A z + B u, u' = constant: one exponential of the three stacked.
        stacked = np.zeros((6, 6))
        stacked[0, 1] = 1.0
        stacked[1, :4] = np.array([-kv, -1.0, kv, f]) / tau
        stacked[2:4, 4:6] = np.eye(2) / period
        step = expm(stacked * period)
        return step[:2, :2].copy(), step[:2, 2:4].copy(), step[:2, 4:6].copy()


@njit(cache=True, nogil=True)
def drive(
    transition: FloatArray,
    held: FloatArray,
    rising: FloatArray,
    axes: FloatArray,
    setpoint: FloatArray,
    velocity: FloatArray,
    setpoints: FloatArray,
    velocities: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """
    Advance the drives over rows of setpoints; all axes are alike.

    Parameters
    ----------
    transition, held, rising : ndarray, shape (2, 2)
        One period of the model, see ``DriveModel.discretise``.
    axes : ndarray, shape (2, n_axes)
        Actual position and velocity at the start [m, rad, per s].
    setpoint, velocity : ndarray, shape (n_axes,)
        Setpoint at the start and its velocity [m, rad, per s].
    setpoints, velocities : ndarray, shape (K, n_axes)
        Setpoints at the end of each period and their velocities [m, rad, per s].

    Returns
    -------
    position, velocity : ndarray, shape (K, n_axes)
        Actual axes at the end of each period [m, rad, per s].

    """
    x, v = np.empty_like(setpoints), np.empty_like(setpoints)
    for j in range(setpoints.shape[1]):
        state = axes[0, j], axes[1, j], setpoint[j], velocity[j]
        for i in range(len(setpoints)):
            r, f = setpoints[i, j], velocities[i, j]
            x[i, j], v[i, j] = _step(transition, held, rising, state, r, f)
            state = x[i, j], v[i, j], r, f
    return x, v


@njit(cache=True, nogil=True)
def _step(
    transition: FloatArray,
    held: FloatArray,
    rising: FloatArray,
    state: tuple[float, float, float, float],
    r: float,
    f: float,
) -> tuple[float, float]:
    """Advance one axis by one period from (x, v, r, f) to the setpoint (r, f); return (x, v)."""
    x0, v0, r0, f0 = state
    dr, df = r - r0, f - f0
    # Relative to the last setpoint, so that rounding does not depend on where the axis is.
    gap = x0 - r0
    x = (
        r0 + transition[0, 0] * gap + transition[0, 1] * v0
        + held[0, 1] * f0 + rising[0, 0] * dr + rising[0, 1] * df
    )  # fmt: skip
    v = (
        transition[1, 0] * gap + transition[1, 1] * v0
        + held[1, 1] * f0 + rising[1, 0] * dr + rising[1, 1] * df
    )  # fmt: skip
    return x, v


#: Words of the model in the memory of ``drive_once``; then come x, v, r, f of the axes.
MODEL_WORDS = 12


@cfunc(types.int64(*[types.uintp] * 3, types.int64), cache=True)
def drive_once(memory: int, setpoint: int, feedback: int, n: int) -> int:
    """Advance all axes by one period; see ``drives.CycleDrives``."""
    model = carray(pointer(memory), (3, 2, 2))
    states = carray(pointer(memory + 8 * MODEL_WORDS), (4, n))
    wanted, actual = carray(pointer(setpoint), (2, n)), carray(pointer(feedback), (2, n))
    for j in range(n):
        state = states[0, j], states[1, j], states[2, j], states[3, j]
        r, f = wanted[0, j], wanted[1, j]
        x, v = _step(model[0], model[1], model[2], state, r, f)
        states[0, j], states[1, j], states[2, j], states[3, j] = x, v, r, f
        actual[0, j], actual[1, j] = x, v
    return 0
