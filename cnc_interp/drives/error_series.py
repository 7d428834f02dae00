"""What an axis is off its setpoints in slow motion, by velocity, acceleration and friction.

With the equations of ``drive_model.py``, the table follows a setpoint r of slow motion by

    x(t) = r(t - lag) + c1 r' + c2 r'' - sign(r') away,

where 1 + c1 s + c2 s^2 are the first terms of exp(lag s) G(s), G is the transfer function from
r to x, and ``away`` is what friction and backlash take. The lag is common to all axes. A lag
along the path is no error, so c1 counts relative to the other axes only. What changes faster,
modes and steps of the jerk, is in the terms left out.

Drives that are compensated get r and the feed-forward g of ``compensation.py``. With hats on the
values of the model that is inverted,

    M = (kv r + (f / f^) (D^ / H^ - kv^) r) / D,   D = kv + (1 + tau B) s + tau s^2,

and the table is H M later. With a true model this is r.
"""

import math
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.machine_model.axis_drives import AxisDrive, DriveLoad
from cnc_interp.machine_model.machine import Machine

TERMS = 3  #: Terms of the series: 1, s, s^2.


@dataclass(frozen=True)
class ErrorSeries:
    #: (n_axes,): c1 and c2 [s, s2].
    by_velocity: FloatArray
    by_acceleration: FloatArray
    away: FloatArray  #: (n_axes,): Error that stays in steady motion, against it [m or rad].
    lag: float  #: The common lag; if compensated, beyond ``Compensation.lead`` [s].


def error_series(machine: Machine, model: Machine | None = None) -> ErrorSeries:
    count = len(machine.axis_names)
    series, away = np.empty((count, TERMS)), np.empty(count)
    for j, own in enumerate(machine.driven):
        found = _as_it_is(*own) if model is None else _compensated(*own, *model.driven[j])
        series[j], away[j] = found
    lag = -0.5 * (series[:, 1].min() + series[:, 1].max())
    for j in range(count):
        series[j] = _times(series[j], _delay(-lag))
    return ErrorSeries(series[:, 1].copy(), series[:, 2].copy(), away, float(lag))


def _as_it_is(drive: AxisDrive, load: DriveLoad | None) -> tuple[FloatArray, float]:
    kv = drive.position_gain
    told = np.array([kv, drive.feed_forward, 0.0])
    series = _over(_times(told, _mode(drive)), _loops(drive, load))
    return _times(series, _delay(drive.delay)), _friction(drive, load) / kv + drive.backlash / 2


def _compensated(
    drive: AxisDrive, load: DriveLoad | None, model: AxisDrive, its_load: DriveLoad | None
) -> tuple[FloatArray, float]:
    share = drive.feed_forward / model.feed_forward
    told = share * _over(_loops(model, its_load), _mode(model))
    told[0] += drive.position_gain - share * model.position_gain
    series = _over(_times(told, _mode(drive)), _loops(drive, load))
    series = _times(series, _delay(drive.delay - model.delay))
    force = _friction(drive, load) - share * _friction(model, its_load)
    crossed = share * model.position_gain / drive.position_gain * model.backlash
    return series, force / drive.position_gain + 0.5 * (drive.backlash - crossed)


def _friction(drive: AxisDrive, load: DriveLoad | None) -> float:
    """Return tau C / J: the velocity that friction takes [m/s or rad/s]."""
    return 0.0 if load is None else drive.time_constant * load.coulomb / load.inertia


def _loops(drive: AxisDrive, load: DriveLoad | None) -> FloatArray:
    """Return kv + (1 + tau B) s + tau s^2."""
    viscous = 0.0 if load is None else load.viscous / load.inertia
    tau = drive.time_constant
    return np.array([drive.position_gain, 1.0 + tau * viscous, tau])


def _mode(drive: AxisDrive) -> FloatArray:
    if not drive.mode_frequency:
        return np.array([1.0, 0.0, 0.0])
    return np.array([1.0, 0.0, -1.0 / (2.0 * math.pi * drive.mode_frequency) ** 2])


def _delay(time: float) -> FloatArray:
    """Return the first terms of exp(-time s)."""
    return np.array([1.0, -time, 0.5 * time**2])


def _times(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.convolve(one, other)[:TERMS]


def _over(one: FloatArray, other: FloatArray) -> FloatArray:
    found = np.empty(TERMS)
    for k in range(TERMS):
        found[k] = (one[k] - found[:k] @ other[k:0:-1]) / other[0]
    return found
