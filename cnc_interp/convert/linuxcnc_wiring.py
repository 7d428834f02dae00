"""The joints of a LinuxCNC machine, as its INI file describes them."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from cnc_interp.convert.hal_board import Resolve
from cnc_interp.convert.linuxcnc_files import UNITS, Ini, number
from cnc_interp.core import DEG, INCH, MM
from cnc_interp.machine_model.machine import Machine

#: Pins of LinuxCNC, by the names of the outputs and inputs that replace them.
PINS = {
    'spindle_forward': 'spindle.0.forward',
    'spindle_reverse': 'spindle.0.reverse',
    'spindle_at_speed': 'spindle.0.at-speed',
    'spindle_angle': 'spindle.0.revs',
    'spindle_orient': 'spindle.0.orient',
    'spindle_orient_angle': 'spindle.0.orient-angle',
    'spindle_oriented': 'spindle.0.is-oriented',
    'coolant_flood': 'iocontrol.0.coolant-flood',
    'coolant_mist': 'iocontrol.0.coolant-mist',
    'tool_change': 'iocontrol.0.tool-change',
    'tool_changed': 'iocontrol.0.tool-changed',
    'probe': 'motion.probe-input',
} | {
    f'{kind}_{way}_{k}': f'motion.{kind}-{way}-{k:02d}'
    for kind in ('digital', 'analog')
    for way in ('out', 'in')
    for k in range(64)
}


@dataclass(frozen=True)
class Wiring:
    """The joints of a machine; only ``joints`` is required."""

    joints: str  #: Letter of the axis of each joint, as ``XYZ``.
    units: Mapping[str, float] = field(default_factory=dict)  #: HAL's unit of an axis [mm, deg].
    #: Of each joint: position of its switch, and its largest following error, in HAL's units.
    switches: Mapping[int, float] = field(default_factory=dict)
    errors: Mapping[int, float] = field(default_factory=dict)
    locked: str = ''  #: Axes without a motor.
    resolve: Resolve = str


def wiring_of(
    machine: Machine, ini: Ini | None, joints: str | None, units: str | None
) -> tuple[Wiring, list[str]]:
    """Return what is known about the joints of a machine, and what was assumed."""
    locked = ''.join(axis.name for axis in machine.axes if axis.locked)
    own = ''.join(name for name in machine.axis_names if name not in locked)
    joints = (joints or (ini.joints if ini else own)).upper()
    if ini is None:
        told = [] if units else ['assumed: lengths in the HAL files are in mm (--units)']
        size = INCH / MM if units == 'inch' else 1.0
        return Wiring(
            joints, {a.name: size for a in machine.axes if a.linear}, locked=locked
        ), told
    linear, angular = ini.unit('LINEAR_UNITS', 'mm') / MM, ini.unit('ANGULAR_UNITS', 'deg') / DEG
    linear = linear if units is None else UNITS[units] / MM
    numbers = [
        {
            k: number(text, letter, key)
            for k, letter in enumerate(joints)
            if (text := ini.get(f'JOINT_{k}', key))
        }
        for key in ('HOME_OFFSET', 'FERROR')
    ]

    def resolve(word: str) -> str:
        section, _, key = word.removeprefix('[').partition(']')
        return ini.get(section, key.strip('()')) if key else word

    found = {a.name: round(linear if a.linear else angular, 9) for a in machine.axes}
    names = ini.all('HAL', 'POSTGUI_HALFILE')
    told = [f'not read: {", ".join(names)}, for the user interface'] if names else []
    return Wiring(joints, found, numbers[0], numbers[1], locked, resolve), told
