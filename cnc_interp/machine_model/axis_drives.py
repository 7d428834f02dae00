"""The section ``drives`` of a machine file: how the drive of each axis follows its setpoints."""

from dataclasses import dataclass
from typing import Any, NamedTuple

from cnc_interp.core import ARCSEC, DEG, MM, UM
from cnc_interp.core.axis_limits import AxisLimits, DriveLoad
from cnc_interp.machine_model.demands import demand
from cnc_interp.machine_model.machine_entries import (
    entries_by_axis,
    number,
    numbers,
    require_known,
)

#: Keys of a drive: inertia, largest force or torque, Coulomb and viscous friction, in SI units.
LINEAR_KEYS = ('mass_kg', 'force_N', 'coulomb_N', 'viscous_N_s_per_m')
ROTARY_KEYS = ('inertia_kg_m2', 'torque_Nm', 'coulomb_Nm', 'viscous_Nm_s_per_rad')
PLAUSIBLE = (1e-6, 1e7)  #: Plausible range of inertias, forces and torques [SI].


def drive_loads(
    content: dict[str, Any], names: list[str], linear: list[bool], limits: list[AxisLimits]
) -> dict[int, DriveLoad]:
    found = {}
    given = entries_by_axis(content, 'loads', names, 'inertia, torque and friction')
    for j, where, values in given:
        keys = LINEAR_KEYS if linear[j] else ROTARY_KEYS
        demand(
            isinstance(values, dict) and set(keys[:2]) <= set(values) <= set(keys),
            f'give {keys[0]} and {keys[1]}; {", ".join(keys[2:])}',
            where,
        )
        inertia, torque = (number(values[key], f'{where}.{key}', *PLAUSIBLE) for key in keys[:2])
        coulomb, viscous = (_friction(values.get(key, 0.0), f'{where}.{key}') for key in keys[2:])
        load = DriveLoad(inertia, torque, coulomb, viscous)
        fastest = limits[j].max_velocity
        demand(
            load.least_acceleration(fastest) > 0.0,
            f'{torque:g} is too little: at the largest velocity friction takes '
            f'{coulomb + viscous * fastest:g}',
            f'{where}.{keys[1]}',
        )
        found[j] = load
    return found


def _friction(value: Any, key: str) -> float:
    friction = numbers([value], 1, key)[0]
    demand(friction >= 0.0, f'must not be negative, not {value}', key)
    return friction


@dataclass(frozen=True)
class AxisDrive:
    """The drive of one axis (``drives/drive_model.py``); with the defaults it is ideal."""

    position_gain: float = 100.0  #: ``kv`` of the position loop [1/s].
    feed_forward: float = 1.0  #: Share ``f`` of the setpoint velocity that is fed forward [-].
    time_constant: float = 2e-3  #: Lag ``tau`` of the velocity loop [s].
    delay: float = 0.0  #: Dead time of the setpoints [s].
    static: float = 0.0  #: Friction at rest; 0 if it equals the Coulomb friction [N or Nm].
    #: Velocity at which the excess of static over Coulomb friction is down to 1/e [m/s or rad/s].
    stribeck_velocity: float = 0.0
    backlash: float = 0.0  #: Play between motor and table [m or rad].
    #: Frequency (0: no mode) and damping of a flexible mode between motor and table [Hz, -].
    mode_frequency: float = 0.0
    mode_damping: float = 0.0
    resolution: float = 0.0  #: Step of the measuring system at the table, 0 for none [m or rad].

    @property
    def lag(self) -> float:
        """Approximate lag of the axis behind its setpoint [s]."""
        return 1.0 / self.position_gain + self.time_constant + self.delay


IDEAL = AxisDrive()  #: Drive of an axis without an entry in the file.


class Entry(NamedTuple):
    field: str  #: Field of ``AxisDrive``.
    #: Key in the file for a linear and for a rotary axis; both end with the unit.
    linear: str
    rotary: str
    #: The units of the file, in SI.
    linear_unit: float
    rotary_unit: float
    #: Smallest and largest plausible value, in the unit of the file.
    low: float
    high: float


#: Entries of a drive, in the order of the file; the first ``NEEDED`` are required.
ENTRIES = (
    Entry('position_gain', 'position_gain_per_s', 'position_gain_per_s', 1.0, 1.0, 1.0, 1e3),
    Entry('feed_forward', 'feed_forward', 'feed_forward', 1.0, 1.0, 0.0, 1.2),
    Entry('time_constant', 'velocity_lag_ms', 'velocity_lag_ms', 1e-3, 1e-3, 0.1, 100.0),
    Entry('delay', 'delay_ms', 'delay_ms', 1e-3, 1e-3, 0.0, 50.0),
    Entry('static', 'static_N', 'static_Nm', 1.0, 1.0, 0.0, 1e7),
    Entry('stribeck_velocity', 'stribeck_mm_per_s', 'stribeck_deg_per_s', MM, DEG, 0.0, 1e3),
    Entry('backlash', 'backlash_um', 'backlash_arcsec', UM, ARCSEC, 0.0, 5e3),
    Entry('mode_frequency', 'mode_Hz', 'mode_Hz', 1.0, 1.0, 0.0, 500.0),
    Entry('mode_damping', 'mode_damping', 'mode_damping', 1.0, 1.0, 0.0, 1.0),
    Entry('resolution', 'resolution_um', 'resolution_arcsec', UM, ARCSEC, 0.0, 100.0),
)
NEEDED = 3


def key_and_unit(entry: Entry, linear: bool) -> tuple[str, float]:
    return (entry.linear, entry.linear_unit) if linear else (entry.rotary, entry.rotary_unit)


def axis_drives(
    content: dict[str, Any], names: list[str], linear: list[bool], loads: dict[int, DriveLoad]
) -> dict[int, AxisDrive]:
    given = entries_by_axis(content, 'drives', names, 'the values of its drive')
    return {j: _drive(values, where, linear[j], loads.get(j)) for j, where, values in given}


def _drive(values: Any, where: str, linear: bool, load: DriveLoad | None) -> AxisDrive:
    keys = [key_and_unit(entry, linear) for entry in ENTRIES]
    needed = [key for key, _ in keys[:NEEDED]]
    demand(
        isinstance(values, dict) and set(needed) <= set(values), f'give {", ".join(needed)}', where
    )
    require_known(values, dict(keys), where)
    found = {}
    for entry, (key, unit) in zip(ENTRIES, keys, strict=True):
        if key not in values:
            continue
        value = numbers([values[key]], 1, f'{where}.{key}')[0]
        demand(
            entry.low <= value <= entry.high,
            f'{value:g} is outside {entry.low:g} ... {entry.high:g}; is the unit right?',
            f'{where}.{key}',
        )
        found[entry.field] = value * unit
    drive = AxisDrive(**found)
    static, _ = key_and_unit(ENTRIES[4], linear)
    stribeck, _ = key_and_unit(ENTRIES[5], linear)
    demand(
        not drive.static or (load is not None and load.coulomb <= drive.static),
        'must be at least the Coulomb friction under loads',
        f'{where}.{static}',
    )
    demand(
        bool(drive.static) == bool(drive.stribeck_velocity),
        f'give {static} and {stribeck}, or neither',
        where,
    )
    demand(
        not drive.mode_frequency or drive.mode_damping > 0.0,
        'must be positive',
        f'{where}.mode_damping',
    )
    return drive
