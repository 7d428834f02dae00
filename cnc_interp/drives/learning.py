"""Learn a correction of the feed-forward of compensated drives from a run of the same program.

The table missed its delayed setpoint by e. By the loops of ``drive_model.py``, the velocity
feed-forward that moves the table by e is ``f dg = kv e + (1 + tau B) e' + tau e''``, sent earlier
by the dead time. The correction is smoothed by a zero-phase low pass below the flexible mode.
If the model error exceeds the remaining error, learning would increase the error.
"""

from __future__ import annotations

import hashlib
import math
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cnc_interp.core import FloatArray, InterpError
from cnc_interp.drives.drive_model import memory_of
from cnc_interp.drives.tool_error import AHEAD, path_and_axis_errors
from cnc_interp.machine_model.axis_drives import AxisDrive
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.transform_port import Transform

#: Largest cutoff of the low pass [Hz], and its largest share of the mode's frequency [-].
CUTOFF, SHARE = 40.0, 0.65
FASTEST = 0.2  #: Largest cutoff as a share of the sampling rate; it matters for long periods [-].
#: Time for which the last setpoint is held after the program, and the time at its end in which the
#: learnt correction fades to zero [s].
HELD, FADES = 0.3, 0.2
COMES = 5e-3  #: Time in which the learnt correction fades in, before the motion starts [s].


def with_hold(setpoints: FloatArray, period: float) -> FloatArray:
    """Return setpoints (K, n_axes) without the rest before the motion; the last one is held."""
    held = np.repeat(setpoints[-1:], math.ceil(HELD / period), axis=0)
    return np.concatenate([setpoints[start_of(setpoints) :], held])


def start_of(setpoints: FloatArray) -> int:
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
    """Return the learnt feed-forward for the next run, (K, n_axes) [m, rad, per s].

    ``lead``: delay of all axes [s]; ``setpoints``: from ``with_hold``; ``feedback`` (F, n_axes):
    positions measured in the last run; its last error is held after them. ``before``: feed-forward
    of that run.
    """
    errors = late(setpoints, lead / period)[: len(feedback)] - feedback
    held = np.repeat(errors[-1:], len(setpoints) - len(errors), axis=0)
    errors = np.concatenate([errors, held])
    rates = np.zeros_like(setpoints) if before is None else before.copy()
    for j, (drive, load) in enumerate(model.driven):
        viscous = load.viscous / load.inertia if load is not None else 0.0
        e = _smooth(errors[:, j], drive, period)
        de = np.gradient(e, period)
        more = drive.position_gain * e + (1.0 + drive.time_constant * viscous) * de
        more += drive.time_constant * np.gradient(de, period)
        rates[:, j] += late((more / drive.feed_forward)[:, None], -drive.delay / period)[:, 0]
        rates[:, j] = _smooth(rates[:, j], drive, period)
    time = np.arange(len(rates)) * period
    inside = np.clip(np.minimum(time / COMES, time[::-1] / FADES), 0.0, 1.0)
    return np.asarray(rates * (0.5 - 0.5 * np.cos(np.pi * inside))[:, None])


def late(rows: FloatArray, periods: float) -> FloatArray:
    """Return rows delayed by a number of periods, interpolated linearly; the ends are held."""
    number = np.arange(len(rows))
    return np.stack([np.interp(number - periods, number, row) for row in rows.T], axis=1)


def measured_error(
    machine: Machine, period: float, lead: float, setpoints: FloatArray, feedback: FloatArray
) -> FloatArray:
    """Return errors of measured positions, (F, 2) [m, rad], for axes delayed by ``lead`` [s]."""
    transform, ahead = Transform.of(machine), math.ceil(AHEAD / period)
    before = memory_of(period, lead)
    commanded = np.concatenate(
        [
            np.repeat(setpoints[:1], before, axis=0),
            setpoints[: len(feedback) + ahead],
            np.repeat(setpoints[-1:], max(len(feedback) + ahead - len(setpoints), 0), axis=0),
        ]
    )
    path, actual = transform.forward(commanded), transform.forward(feedback)
    return np.asarray(path_and_axis_errors(*path, *actual, before + ahead))


def _smooth(values: FloatArray, drive: AxisDrive, period: float) -> FloatArray:
    from scipy.signal import butter, sosfiltfilt

    below = SHARE * drive.mode_frequency if drive.mode_frequency else CUTOFF
    cutoff = min(CUTOFF, below, FASTEST / period)
    sections = butter(2, cutoff, fs=1.0 / period, output='sos')
    beside = min(round(1.0 / (cutoff * period)), len(values) - 1)
    return np.asarray(sosfiltfilt(sections, values, padtype='constant', padlen=beside))


ARRAYS = ('setpoint', 'rate', 'period', 'error', 'axes', 'machine', 'model')  #: In the file.
SAME_PERIOD = 1e-12  #: A period that differs by less is the same [s].


@dataclass(frozen=True)
class LearntMotion:
    """The setpoints of a program, and the learnt feed-forward of each."""

    #: (K, n_axes): Setpoints without the rest before the motion; the last one is held [m, rad].
    setpoint: FloatArray
    rate: FloatArray  #: (K, n_axes): Added feed-forward; 0 in first and last row [m, rad, per s].
    period: float  #: Interpolation period [s].
    error: FloatArray  #: (R, 2): Largest and mean error of the tip in each learnt run [m].
    axes: str  #: Names of the axes, with spaces between.
    #: Hashes of the files of the machine and of the model that compensates it.
    machine: str
    model: str

    def save(self, path: Path) -> None:
        try:
            with path.open('wb') as file:
                np.savez_compressed(file, **{name: getattr(self, name) for name in ARRAYS})
        except OSError as fault:
            raise InterpError(f'{path}: cannot be written ({fault.strerror})') from None

    @staticmethod
    def load(path: Path) -> LearntMotion:
        try:
            with np.load(path, allow_pickle=False) as file:
                found = {name: file[name] for name in ARRAYS}
            motion = LearntMotion(
                np.ascontiguousarray(found['setpoint'], dtype=float),
                np.ascontiguousarray(found['rate'], dtype=float),
                float(found['period']),
                np.asarray(found['error'], dtype=float),
                *(str(found[name]) for name in ('axes', 'machine', 'model')),
            )
        except OSError as fault:
            why = fault.strerror or 'not a file that `learn` wrote'
            raise InterpError(f'{path}: cannot be read ({why})') from None
        except (ValueError, TypeError, KeyError, EOFError, MemoryError, zipfile.BadZipFile):
            raise InterpError(f'{path}: is not a file that `learn` wrote') from None
        rows, shape = motion.setpoint, (len(motion.setpoint), len(motion.axes.split()))
        sound = rows.shape == motion.rate.shape == shape and len(rows) > 1
        sound = sound and motion.error.ndim == 2 and motion.error.shape[1] == 2
        if not (sound and all(np.isfinite(x).all() for x in (rows, motion.rate, motion.error))):
            raise InterpError(f'{path}: is not a file that `learn` wrote')
        if motion.rate[0].any() or motion.rate[-1].any():
            raise InterpError(f'{path}: does not begin and end with 0; learn again')
        return motion


def hash_of(name: str) -> str:
    """Return the hash of a machine file, given by path or name; MachineError if there is none."""
    return hashlib.sha256(find_machine_file(name).read_bytes()).hexdigest()


def learnt_for(path: Path, machine: str, model: str, period: float) -> LearntMotion:
    """Load learnt motion; InterpError unless it was learnt for this machine, model and period."""
    if not model:
        raise InterpError(
            'learnt: this corrects a compensated run; name its model with --compensate'
        )
    motion, again = LearntMotion.load(path), 'record runs with it and learn again'
    known = Machine.load(machine)
    if motion.axes != ' '.join(known.axis_names) or motion.machine != hash_of(machine):
        raise InterpError(f'{path}: was learnt on another machine than {machine}; {again}')
    if motion.model != hash_of(model):
        raise InterpError(f'{path}: was learnt with another model than {model}; {again}')
    if abs(motion.period - period) > SAME_PERIOD:
        told = f'{motion.period * 1e3:g} ms, not {period * 1e3:g} ms'
        raise InterpError(f'{path}: was learnt with a period of {told}; {again}')
    if np.any(np.abs(motion.rate) > known.max_velocity):
        raise InterpError(f'{path}: adds more than the largest velocity of an axis; learn again')
    return motion
