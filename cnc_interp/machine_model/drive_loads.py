"""What the drives of a machine can do: torque or force, and what they move and overcome."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import MachineError
from cnc_interp.machine_model.machine_entries import entries_by_axis, number, numbers

#: Keys of a drive: inertia, largest torque, Coulomb and viscous friction, all in SI.
LINEAR_KEYS = ('mass_kg', 'force_N', 'coulomb_N', 'viscous_N_s_per_m')
ROTARY_KEYS = ('inertia_kg_m2', 'torque_Nm', 'coulomb_Nm', 'viscous_Nm_s_per_rad')
#: Plausible inertias and torques.
PLAUSIBLE = (1e-6, 1e7)


@dataclass(frozen=True)
class DriveLoad:
    """Largest torque of a drive, and what needs it: |J q_ddot + B q_dot + C sign(q_dot)| <= T."""

    inertia: float  #: Mass or moment of inertia J [kg or kg m2].
    torque: float  #: Largest force or torque T [N or Nm].
    coulomb: float  #: Coulomb friction C [N or Nm].
    viscous: float  #: Viscous friction B [N s/m or Nm s/rad].

    @property
    def row(self) -> FloatArray:
        """T/J, C/J and B/J, as a table of limits has them [m or rad per s2, the same, 1/s]."""
        return np.array([self.torque, self.coulomb, self.viscous]) / self.inertia

    def least_acceleration(self, velocity: float) -> float:
        """Return the acceleration that is left at a velocity [m or rad, per s, per s2]."""
        return (self.torque - self.coulomb - self.viscous * velocity) / self.inertia


def drive_loads(
    content: dict[str, Any], names: list[str], linear: list[bool], velocities: FloatArray
) -> dict[int, DriveLoad]:
    """Read the drives that have a largest torque."""
    found = {}
    given = entries_by_axis(content, 'loads', names, 'inertia, torque and friction')
    for j, where, values in given:
        keys = LINEAR_KEYS if linear[j] else ROTARY_KEYS
        if not isinstance(values, dict) or not set(keys[:2]) <= set(values) <= set(keys):
            raise MachineError(f'give {keys[0]} and {keys[1]}; {", ".join(keys[2:])}', where)
        inertia, torque = (number(values[key], f'{where}.{key}', *PLAUSIBLE) for key in keys[:2])
        coulomb, viscous = (_friction(values.get(key, 0.0), f'{where}.{key}') for key in keys[2:])
        load = DriveLoad(inertia, torque, coulomb, viscous)
        if not load.least_acceleration(float(velocities[j])) > 0.0:
            taken = coulomb + viscous * float(velocities[j])
            raise MachineError(
                f'{torque:g} is too little: at the largest velocity friction takes {taken:g}',
                f'{where}.{keys[1]}',
            )
        found[j] = load
    return found


def _friction(value: Any, key: str) -> float:
    """Check a friction, which may be zero."""
    friction = numbers([value], 1, key)[0]
    if friction < 0.0:
        raise MachineError(f'must not be negative, not {value}', key)
    return friction
