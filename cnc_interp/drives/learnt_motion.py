"""What runs of a program have taught, and its file."""

from __future__ import annotations

import hashlib
import zipfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import InterpError
from cnc_interp.machine_model.machine import Machine, find_machine_file

#: Arrays of the file.
ARRAYS = ('setpoint', 'rate', 'period', 'error', 'axes', 'machine', 'model')
#: A period that differs by less is the same [s].
SAME_PERIOD = 1e-12


@dataclass(frozen=True)
class LearntMotion:
    """The setpoints of a program, and what is added to the feed-forward of each."""

    #: (K, n_axes): Setpoints from the first motion on; the last one is held for a while [m, rad].
    setpoint: FloatArray
    #: (K, n_axes): What is added to the velocity feed-forward; 0 in the first and last row [m,
    #: rad, per s].
    rate: FloatArray
    period: float  #: Interpolation period [s].
    #: (R, 2): Largest and mean error of the tip in each run that was learnt [m].
    error: FloatArray
    axes: str  #: Names of the axes, with spaces between.
    #: Hashes of the files of the machine and of the model that compensates it.
    machine: str
    model: str

    def save(self, path: Path) -> None:
        """Write the file."""
        try:
            with path.open('wb') as file:
                np.savez_compressed(file, **{name: getattr(self, name) for name in ARRAYS})
        except OSError as fault:
            raise InterpError(f'{path}: cannot be written ({fault.strerror})') from None

    @staticmethod
    def load(path: Path) -> LearntMotion:
        """
        Read a file.

        Raises
        ------
        InterpError
            If it is no such file.

        """
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
    """
    Return the hash of a machine file, given by path or name.

    Raises
    ------
    MachineError
        If there is none.

    """
    return hashlib.sha256(find_machine_file(name).read_bytes()).hexdigest()


def learnt_for(path: Path, machine: str, model: str, period: float) -> LearntMotion:
    """
    Load what was learnt for a machine, its model and a period.

    Parameters
    ----------
    path : Path
        File that `learn` wrote.
    machine, model : str
        Machine, and machine whose drives are the model: names or files.
    period : float
        Interpolation period [s].

    Raises
    ------
    InterpError
        If it was learnt for another one, or there is no model.

    """
    if not model:
        raise InterpError('learnt: is added to compensation; name its model with --compensate')
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
