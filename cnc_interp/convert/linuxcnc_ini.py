"""A machine file from the INI file of a LinuxCNC machine."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf, isfinite
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cnc_interp.convert.linuxcnc_files import Ini, comp_file, number, read_ini
from cnc_interp.core import DEG, M_PER_MIN, MM, REV, REV_PER_MIN, UM, MachineError
from cnc_interp.machine_model.demands import demand
from cnc_interp.machine_model.geometric_errors import error_table
from cnc_interp.machine_model.machine import from_mapping

JERK = 10.0  #: Jerk where the INI has none, over the acceleration [1/s].
#: Rotary axes of each known kinematics module; the first axis carries the second one.
KINEMATICS = {'trivkins': '', 'xyzac-trt-kins': 'AC', 'xyzbc-trt-kins': 'BC'}
#: Rotary axes of a machine without a transformation; the first one carries the second one.
ROTARY = ('', 'A', 'B', 'C', 'AB', 'AC', 'BC')
EXTRA = {'U': 'X', 'V': 'Y', 'W': 'Z'}  #: Extra axes, and along which axes they run.
LARGEST_ERROR = 100.0  #: A larger limit of the following error stops no axis [mm, deg].
ABOUT = {'A': [1, 0, 0], 'B': [0, 1, 0], 'C': [0, 0, 1]}
#: Keys of ``[AXIS_L]`` and ``[JOINT_N]`` that are ignored, and why.
OF_AXES = {
    'BACKLASH': 'play is not compensated',
    'MIN_FERROR': 'the limit of the following error does not depend on the velocity',
    'HOME': 'an axis stays where it found its switch',
    'HOME_FINAL_VEL': 'an axis stays where it found its switch',
    'HOME_LATCH_VEL': 'an axis leaves its switch with 1 % of its velocity',
    'HOME_ABSOLUTE_ENCODER': 'absolute encoders are not read',
    'HOME_IS_SHARED': 'each axis needs a switch of its own',
    'LOCKING_INDEXER': 'an axis is not unlocked before it turns',
    'WRAPPED_ROTARY': 'a rotary axis turns to the angle that is programmed',
    'VOLATILE_HOME': 'an axis keeps its place without power',
    'OFFSET_AV_RATIO': 'there are no external offsets',
}
#: Keys of other sections that are ignored, and why.
ELSEWHERE = {
    ('EMCIO', 'TOOL_CHANGE_POSITION'): 'enter it as G30, and write tool_change_macro: tool_change',
    ('EMCIO', 'TOOL_CHANGE_QUILL_UP'): 'move Z up in the program, or in a macro before M6',
    ('EMCIO', 'TOOL_CHANGE_AT_G30'): 'write G30 before M6',
    ('EMCIO', 'TOOL_CHANGE_WITH_SPINDLE_ON'): 'M6 stops the spindle (signals)',
    ('EMCIO', 'RANDOM_TOOLCHANGER'): 'tools have fixed pockets',
    ('RS274NGC', 'REMAP'): 'for M6 write tool_change_macro, for other codes functions of signals',
    ('RS274NGC', 'RS274NGC_STARTUP_CODE'): 'write its words into the program',
    ('RS274NGC', 'USER_M_PATH'): 'M100 to M199 cannot call programs; write functions of signals',
    ('TRAJ', 'MAX_LINEAR_ACCELERATION'): 'the limits are those of the axes',
    ('TRAJ', 'MAX_ACCELERATION'): 'the limits are those of the axes',
    ('TRAJ', 'MAX_ANGULAR_ACCELERATION'): 'the limits are those of the axes',
    ('TRAJ', 'MAX_LINEAR_JERK'): 'the limits are those of the axes',
    ('HAL', 'POSTGUI_HALFILE'): 'it connects a user interface that cnc_interp does not run',
}


@dataclass
class Import:
    ini: Ini
    notes: list[str] = field(default_factory=list)  #: What was assumed.
    ignored: dict[str, list[str]] = field(default_factory=dict)  #: Ignored keys, by the reason.

    def ignore(self, reason: str, key: str) -> None:
        keys = self.ignored.setdefault(reason, [])
        keys += [key] if key not in keys else []


def machine_from_ini(path: Path) -> tuple[str, list[str], list[str]]:
    """Return the text of a machine file, what was assumed, and what was ignored.

    Raises MachineError with the file and the key.
    """
    found = Import(read_ini(path))
    try:
        content = _content(found)
        from_mapping(content)
    except MachineError as problem:
        raise MachineError(f'{path}: {problem}') from None
    ignored = [f'{", ".join(keys)}: {reason}' for reason, keys in found.ignored.items()]
    notes = [*found.notes, *(f'ignored: {line}' for line in ignored)]
    head = [f'# From {path.name} of LinuxCNC.', *(f'# {note}.' for note in notes)]
    told = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=150)
    return '\n'.join([*head, told]), found.notes, ignored


def _content(found: Import) -> dict[str, Any]:
    ini, notes = found.ini, found.notes
    name, joints = ini.kinematics[0], ini.joints
    demand(
        name in KINEMATICS, f'{name} is not known; known: {", ".join(KINEMATICS)}', 'KINEMATICS'
    )
    letters = set(joints)
    rotary = KINEMATICS[name] or ''.join(sorted(letters & set(ABOUT)))
    extra = sorted(letters & set(EXTRA)) if name == 'trivkins' else []
    demand(
        letters == {*'XYZ', *rotary, *extra} and (rotary in ROTARY),
        f'{name} with {joints or "no axes"}: the axes must be XYZ{KINEMATICS[name]}'
        + ('' if KINEMATICS[name] else ' with at most two of A, B, C, and U, V, W')
        + '; write the file from an example in config/machines',
        'COORDINATES',
    )
    linear, angular = ini.unit('LINEAR_UNITS', 'mm'), ini.unit('ANGULAR_UNITS', 'deg')
    axes = {
        letter: _Axis(found, letter, joints, angular if letter in ABOUT else linear)
        for letter in (*'XYZ', *rotary, *extra)
    }
    content: dict[str, Any] = {
        'name': str(dict(ini.sections.get('EMC', ())).get('MACHINE', 'linuxcnc')),
        'signals': 'milling',
        'control': {'dialect': 'linuxcnc'},
    }
    if name != 'trivkins':
        content['rotary'] = _table(name, rotary, found, linear / MM)
    elif rotary:
        content['rotary'] = _tables(rotary, notes)
    if extra:
        content['extra'] = {letter: {'along': EXTRA[letter]} for letter in extra}
    content['limits'] = {letter: axis.limits() for letter, axis in axes.items()}
    errors = {letter: axis.following_error() for letter, axis in axes.items()}
    if errors := {letter: error for letter, error in errors.items() if error is not None}:
        content['following_errors'] = errors
    tables = {letter: axis.errors() for letter, axis in axes.items()}
    if tables := {letter: table for letter, table in tables.items() if table is not None}:
        content['errors'] = tables
    _name_ignored(found, joints)
    return content | _homing(axes)


def _name_ignored(found: Import, joints: str) -> None:
    ini = found.ini
    for section, pairs in ini.sections.items():
        kind, _, which = section.partition('_')
        for key, value in pairs:
            idle = value.split('#')[0].strip().rstrip('.0') in ('', 'NO', 'FALSE', '-')
            reason = OF_AXES.get(key) if kind in ('AXIS', 'JOINT') else None
            reason = ELSEWHERE.get((section, key), reason)
            if reason and not idle:
                number = int(which) if which.isdigit() else -1
                letter = joints[number] if 0 <= number < len(joints) else which
                found.ignore(reason, f'{key} of {letter}' if kind != section else key)


class _Axis:
    """An axis: its sections ``[AXIS_L]`` and ``[JOINT_N]``."""

    def __init__(self, found: Import, letter: str, joints: str, unit: float):
        ini, self.found, self.letter, self.unit = found.ini, found, letter, unit
        self.straight = letter not in ABOUT
        self.size = unit / (MM if self.straight else DEG)
        own = [n for n, joint in enumerate(joints) if joint == letter]
        self.motors = [dict(reversed(ini.sections.get(f'JOINT_{n}', ()))) for n in own]
        self.sources = [dict(reversed(ini.sections.get(f'AXIS_{letter}', ()))), *self.motors]

    def values(self, key: str, need: bool = True) -> list[float]:
        found = [number(source[key], self.letter, key) for source in self.sources if key in source]
        demand(not need or found, f'missing in [AXIS_{self.letter}] and its [JOINT_n]', key)
        return found

    def of_motor(self, key: str, usual: float = 0.0, motor: int = 0) -> float:
        source = self.motors[motor]
        return number(source[key], self.letter, key) if key in source else usual

    def limits(self) -> dict[str, Any]:
        """Return the narrowest limits in the sections of the axis; note an assumed jerk."""
        unit, straight, found = self.unit, self.straight, self.found
        speed, turn = (M_PER_MIN, 1.0) if straight else (REV_PER_MIN, REV)
        largest = [min(self.values('MAX_VELOCITY')) * unit]
        for key in ('VELOCITY', f'{"LINEAR" if straight else "ANGULAR"}_VELOCITY'):
            # No axis moves faster than the path may.
            text = found.ini.get('TRAJ', f'MAX_{key}')
            largest += [number(text, '[TRAJ]', key) * unit] if text else []
        velocity = min((each for each in largest if each > 0.0), default=0.0)
        if velocity < largest[0]:
            found.notes.append(f'velocity of {self.letter}: that of [TRAJ], which is lower')
        acceleration = min(self.values('MAX_ACCELERATION')) * unit
        told = [jerk for jerk in self.values('MAX_JERK', need=False) if jerk > 0.0]  # 0: no limit
        if not told:
            text = f'taken as acceleration times {JERK:g}/s'
            found.notes.append(f'jerk of {self.letter}: none in the INI, {text}')
        jerk = min(told) * unit if told else JERK * acceleration
        kind, per = ('m', 'm') if straight else ('rev', 'rev')
        row: dict[str, Any] = {
            f'velocity_{kind}_per_min': _rounded(velocity / speed),
            f'acceleration_{per}_per_s2': _rounded(acceleration / turn),
            f'jerk_{per}_per_s3': _rounded(jerk / turn),
        }
        low, high = self.travel
        if isfinite(low) or isfinite(high):
            row['travel_mm' if straight else 'travel_deg'] = [low, high]
        return row

    @property
    def travel(self) -> tuple[float, float]:
        """The travel of the axis [mm or deg], infinite where it has no limit."""
        low, high = self.values('MIN_LIMIT', False), self.values('MAX_LIMIT', False)
        ends = max(low, default=-inf), min(high, default=inf)
        return _rounded(ends[0] * self.size), _rounded(ends[1] * self.size)

    def following_error(self) -> float | None:
        error = min(self.values('FERROR', need=False), default=0.0) * self.size
        if error > LARGEST_ERROR:
            self.found.ignore('limits nothing', f'FERROR of {self.letter}')
            return None
        return _rounded(error) if error > 0.0 else None

    def errors(self) -> dict[str, list[float]] | None:
        """Return the errors of the screw from the COMP_FILE; None if it is missing or invalid."""
        motor, key = self.motors[0], f'COMP_FILE of {self.letter}'
        name = motor.get('COMP_FILE', '').partition('#')[0].strip()
        if not name:
            return None
        try:
            demand(self.letter in 'XYZ' and len(self.motors) == 1, 'for one motor of X, Y or Z')
            at, ahead, back = comp_file(self.found.ini.path.parent / name)
            trims = (
                self.of_motor('COMP_FILE_TYPE') != 0.0
            )  # values to add; otherwise positions reached
            error = -0.5 * (ahead + back) if trims else 0.5 * (ahead + back) - at
            table = {
                'at_mm': [_rounded(x * self.size) for x in at],
                f'E{self.letter * 2}_um': [_rounded(x * self.size * MM / UM) for x in error],
            }
            travel = np.array(self.travel) * MM
            error_table(table, self.letter, travel, np.zeros(6), Path())
        except MachineError as problem:
            self.found.ignore(str(problem), key)
            return None
        if (ahead != back).any():
            self.found.notes.append(f'{key}: the mean of both directions; the rest is play')
        return table

    def switch(self) -> float | None:
        """Return the position of the reference switch [mm or deg]; None if there is none."""
        search, at = self.of_motor('HOME_SEARCH_VEL'), self.of_motor('HOME_OFFSET') * self.size
        low, high = self.travel
        if not search:
            return None
        if not (low < at < high and isfinite(high - low)):
            self.found.ignore(
                'its switch must lie within the limits; see homing in docs/your_machine.md',
                f'HOME_OFFSET of {self.letter}',
            )
            return None
        if (search > 0.0) != (at - low >= high - at):
            self.found.ignore(
                'homing searches for the switch towards the nearer end of the travel',
                f'HOME_SEARCH_VEL of {self.letter}',
            )
            return None
        return _rounded(at)


def _homing(axes: Mapping[str, _Axis]) -> dict[str, Any]:
    switches = {letter: axis.switch() for letter, axis in axes.items()}
    known = {letter: at for letter, at in switches.items() if at is not None}
    if not known:
        return {}
    order: dict[float, list[str]] = {}
    for letter in known:
        sequence = abs(axes[letter].of_motor('HOME_SEQUENCE', inf))
        order.setdefault(sequence, []).append(letter)
    homing: dict[str, Any] = {
        'switches': known,
        'order': [order[sequence] for sequence in sorted(order)],
    }
    yes = ('YES', 'TRUE', '1', 'Y')
    index = {
        letter: at
        for letter, at in known.items()
        if axes[letter].motors[0].get('HOME_USE_INDEX', '').upper() in yes
        and len(axes[letter].motors) == 1
    }
    squared = [letter for letter in known if len(axes[letter].motors) > 1]
    homing |= ({'index': index} if index else {}) | ({'squared': squared} if squared else {})
    return {'homing': homing}


def _rounded(value: float) -> float:
    return float(f'{value:.9g}')


def _tables(rotary: str, notes: list[str]) -> dict[str, Any]:
    """Return the geometry of one or two tables; a single table also gets a locked head axis."""
    rows: list[dict[str, Any]] = [
        {'name': each, 'about': ABOUT[each], 'carries': 'workpiece'} for each in rotary
    ]
    offsets = ['workpiece_offset_mm', 'secondary_offset_mm', 'primary_offset_mm']
    if len(rotary) == 1:
        other = 'B' if rotary == 'A' else 'A'
        rows.append({'name': other, 'about': ABOUT[other], 'carries': 'tool', 'locked': True})
        del offsets[1]
        notes.append(f'{rotary}: taken as a table whose axis is at 0 0 0 (primary_offset_mm)')
    else:
        notes.append(
            f'{rotary}: taken as tables, {rotary[0]} carries {rotary[1]}; their axes are at '
            '0 0 0 (secondary_offset_mm, primary_offset_mm)'
        )
    places = {key: [0.0] * 3 for key in offsets}
    return {'primary': rows[0], 'secondary': rows[1], **places}


def _table(name: str, rotary: str, found: Import, size: float) -> dict[str, Any]:
    """Return the geometry of a tilting rotary table; its pins may be set by HALCMD."""
    across = {'A': 'y', 'B': 'x'}[rotary[0]]
    pins = {f'{across}-offset': 0.0, 'z-offset': 0.0} | {f'{c}-rot-point': 0.0 for c in 'xyz'}
    commands = ' \n'.join(found.ini.all('HAL', 'HALCMD'))
    for pin in pins:
        words = re.search(rf'\bset[ps]\s+(?:{name}\.|:?){pin}\s+([-+.\d]+)', commands)
        if words:
            pins[pin] = number(words[1], name, pin) * size
        else:
            found.notes.append(f'{name}.{pin}: not in the INI, taken as 0')
    found.notes.append(f'{name}: conventional-directions taken as off')
    point = [pins[f'{c}-rot-point'] for c in 'xyz']
    offset = [0.0, 0.0, pins['z-offset']]
    offset['xyz'.index(across)] = pins[f'{across}-offset']
    primary, secondary = (
        {'name': letter, 'about': ABOUT[letter], 'carries': 'workpiece'} for letter in rotary
    )
    return {
        'primary': primary,
        'secondary': secondary,
        'workpiece_offset_mm': [0.0 - x for x in point],
        'secondary_offset_mm': [0.0 - x for x in offset],
        'primary_offset_mm': [x + y for x, y in zip(point, offset, strict=True)],
    }
