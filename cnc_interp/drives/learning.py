"""
What is added to the feed-forward of compensated drives after a run of the same program.

The table was off its late setpoint by e. With the loops of ``drive_model.py`` the velocity
feed-forward that moves it by e is

    f dg = kv e + (1 + tau B) e' + tau e'',

sent earlier by the dead time. It is added to what that run had, and all of it is smoothed by a low
pass without phase: where the model is wrong by more than the error that is left, learning would
make the error larger. That is so near the flexible mode, so the cutoff stays below it.
"""

from __future__ import annotations

import math

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.drives.drive_model import memory_of
from cnc_interp.drives.tool_error import AHEAD, path_and_axis_errors
from cnc_interp.machine_model.axis_drives import IDEAL, AxisDrive
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform

#: Largest cutoff of the low pass [Hz], and its largest share of the frequency of the mode.
CUTOFF, SHARE = 40.0, 0.65
#: Cutoff over the sampling rate, at most: for long periods.
FASTEST = 0.2
#: Time for which the last setpoint is held after the program, and its end in which the learnt
#: part fades to zero [s].
HELD, FADES = 0.3, 0.2
#: Time in which the learnt part comes at the start; it precedes the motion [s].
COMES = 5e-3


def with_hold(setpoints: FloatArray, period: float) -> FloatArray:
    """
    Return the setpoints of a program from its first motion, and the last one held after them.

    Parameters
    ----------
    setpoints : ndarray, shape (K, n_axes)
        Setpoints of a program [m, rad].
    period : float
        Interpolation period [s].

    Returns
    -------
    ndarray, shape (K', n_axes)
        Row 1 differs from row 0.

    """
    held = np.repeat(setpoints[-1:], math.ceil(HELD / period), axis=0)
    return np.concatenate([setpoints[start_of(setpoints) :], held])


def start_of(setpoints: FloatArray) -> int:
    """Return the last row before the first motion."""
    differs = np.flatnonzero(np.any(setpoints[1:] != setpoints[0], axis=1))
    return int(differs[0]) if len(differs) else len(setpoints) - 1


def learnt_rates(
    model: Machine,
    period: float,
    lead: float,
    setpoints: FloatArray,
    feedback: FloatArray,
    before: FloatArray | None = None,
) -> FloatArray:
    """
    Return what is added to the velocity feed-forward in the next run.

    Parameters
    ----------
    model : Machine
        The model by which that run was compensated.
    period, lead : float
        Interpolation period, and the time by which all axes are late [s].
    setpoints : ndarray, shape (K, n_axes)
        Setpoints from ``with_hold`` [m, rad].
    feedback : ndarray, shape (F, n_axes)
        Measured positions at the first of them; the error is held from there on [m, rad].
    before : ndarray, shape (K, n_axes), optional
        What was added in that run [m or rad, per s].

    Returns
    -------
    ndarray, shape (K, n_axes)
        The first and the last row are 0 [m or rad, per s].

    """
    errors = late(setpoints, lead / period)[: len(feedback)] - feedback
    held = np.repeat(errors[-1:], len(setpoints) - len(errors), axis=0)
    errors = np.concatenate([errors, held])
    rates = np.zeros_like(setpoints) if before is None else before.copy()
    for j in range(setpoints.shape[1]):
        drive = model.drives.get(j, IDEAL)
        load = model.loads.get(j) if j in model.drives else None
        viscous = load.viscous / load.inertia if load is not None else 0.0
        e = _smooth(errors[:, j], drive, period)
        de = np.gradient(e, period)
        tau = drive.time_constant
        more = drive.position_gain * e + (1.0 + tau * viscous) * de
        more += tau * np.gradient(de, period)
        rates[:, j] += late((more / drive.feed_forward)[:, None], -drive.delay / period)[:, 0]
        rates[:, j] = _smooth(rates[:, j], drive, period)
    time = np.arange(len(rates)) * period
    inside = np.clip(np.minimum(time / COMES, time[::-1] / FADES), 0.0, 1.0)
    return np.asarray(rates * (0.5 - 0.5 * np.cos(np.pi * inside))[:, None])


def late(rows: FloatArray, periods: float) -> FloatArray:
    """Return rows later by some periods, linear between them; the ends are held."""
    number = np.arange(len(rows))
    return np.stack([np.interp(number - periods, number, row) for row in rows.T], axis=1)


def cutoff_of(drive: AxisDrive, period: float) -> float:
    """Return the cutoff of what an axis learns [Hz]."""
    below = SHARE * drive.mode_frequency if drive.mode_frequency else CUTOFF
    return min(CUTOFF, below, FASTEST / period)


def measured_error(
    machine: Machine, period: float, lead: float, setpoints: FloatArray, feedback: FloatArray
) -> FloatArray:
    """
    Return the errors of measured positions at the tool, as ``tool_error`` has those of a model.

    Parameters
    ----------
    period, lead : float
        Interpolation period, and the time by which all axes are late [s].
    setpoints, feedback : ndarray, shape (K, n_axes), (F, n_axes)
        Setpoints from rest, and measured positions at the first of them [m, rad].

    Returns
    -------
    ndarray, shape (F, 2)
        Distance of the tip from its path [m], angle of the tool axis [rad].

    """
    transform, ahead = Transform.of(machine), math.ceil(AHEAD / period)
    before = memory_of(period, lead)
    commanded = np.concatenate([
        np.repeat(setpoints[:1], before, axis=0), setpoints[: len(feedback) + ahead],
        np.repeat(setpoints[-1:], max(len(feedback) + ahead - len(setpoints), 0), axis=0),
    ])  # fmt: skip
    path, actual = transform.forward(commanded), transform.forward(feedback)
    return np.asarray(path_and_axis_errors(*path, *actual, before + ahead))


def _smooth(values: FloatArray, drive: AxisDrive, period: float) -> FloatArray:
    """Return values after a low pass, forwards and backwards."""
    from scipy.signal import butter, sosfiltfilt

    cutoff = cutoff_of(drive, period)
    sections = butter(2, cutoff, fs=1.0 / period, output='sos')
    beside = min(round(1.0 / (cutoff * period)), len(values) - 1)
    return np.asarray(sosfiltfilt(sections, values, padtype='constant', padlen=beside))
