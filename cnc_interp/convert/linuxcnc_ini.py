"""A machine file from the INI file of a LinuxCNC machine."""

import re
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

import yaml

from cnc_interp.core import DEG, INCH, M_PER_MIN, MM, REV, REV_PER_MIN, MachineError
from cnc_interp.machine_model.demands import demand
from cnc_interp.machine_model.machine import from_mapping

JERK = 10.0  #: Jerk where the INI has none, over the acceleration [1/s].
#: Names of units in ``[TRAJ]`` [m, rad].
UNITS = {
    'mm': MM,
    'metric': MM,
    'inch': INCH,
    'in': INCH,
    'imperial': INCH,
    'deg': DEG,
    'degree': DEG,
    'rad': 1.0,
    'radian': 1.0,
    'grad': 0.9 * DEG,
    'gon': 0.9 * DEG,
}
#: Kinematics that are known: rotary axes, the first one carries the second one.
KINEMATICS = {'trivkins': '', 'xyzac-trt-kins': 'AC', 'xyzbc-trt-kins': 'BC'}
ABOUT = {'A': [1, 0, 0], 'B': [0, 1, 0], 'C': [0, 0, 1]}
Sections = dict[str, list[tuple[str, str]]]


def machine_from_ini(path: Path) -> tuple[str, list[str]]:
    """Return the text of a machine file and what was assumed; MachineError names file and key."""
    try:
        sections = _sections(path.read_text(encoding='utf-8', errors='replace'))
    except OSError as problem:
        raise MachineError(f'{path}: cannot be opened: {problem.strerror}') from None
    try:
        content, notes = _content(sections)
        from_mapping(content)
    except MachineError as problem:
        raise MachineError(f'{path}: {problem}') from None
    head = [f'# From {path.name} of LinuxCNC.', *(f'# {note}.' for note in notes)]
    told = yaml.safe_dump(content, sort_keys=False, default_flow_style=None, width=150)
    return '\n'.join([*head, told]), notes


def _sections(text: str) -> Sections:
    """Read an INI; keys may repeat, and a comment begins a line."""
    found: Sections = {}
    section = ''
    for line in text.splitlines():
        line = line.strip()
        if line[:1] == '[':
            section = line[1:].partition(']')[0].strip().upper()
        elif line[:1] not in ('', '#', ';') and '=' in line:
            key, _, value = line.partition('=')
            found.setdefault(section, []).append((key.strip().upper(), value.strip()))
    return found


def _content(ini: Sections) -> tuple[dict[str, Any], list[str]]:
    traj, kins = dict(ini.get('TRAJ', ())), dict(ini.get('KINS', ()))
    demand(
        'KINEMATICS' in kins, 'no KINEMATICS in [KINS]; give the INI file of LinuxCNC 2.8 or later'
    )
    name, *words = kins['KINEMATICS'].split()
    demand(
        name in KINEMATICS, f'{name} is not known; known: {", ".join(KINEMATICS)}', 'KINEMATICS'
    )
    given = next((w.partition('=')[2] for w in words if w.startswith('coordinates=')), '')
    joints = (given or traj.get('COORDINATES', '')).replace(' ', '').upper()
    rotary = KINEMATICS[name]
    letters = list(dict.fromkeys(joints))
    if name == 'trivkins' and (fourth := set(letters) - set('XYZ')) in ({'A'}, {'B'}):
        (rotary,) = fourth
    demand(
        sorted(letters) == sorted(f'XYZ{rotary}'),
        f'{name} with {joints or "no axes"}: known are XYZ{rotary or ", XYZA and XYZB"}; '
        'write the file from an example in config/machines',
        'COORDINATES',
    )
    linear, angular = _unit(traj, 'LINEAR_UNITS', 'mm'), _unit(traj, 'ANGULAR_UNITS', 'deg')
    notes: list[str] = []
    limits = {}
    for letter in (*'XYZ', *rotary):
        straight = letter in 'XYZ'
        sources = [ini.get(f'AXIS_{letter}', ())] + [
            ini.get(f'JOINT_{n}', ()) for n, joint in enumerate(joints) if joint == letter
        ]
        limits[letter], jerk_known = _limits(
            letter, [dict(source) for source in sources], linear if straight else angular, straight
        )
        if not jerk_known:
            told = f'taken as acceleration times {JERK:g}/s'
            notes.append(f'jerk of {letter}: none in the INI, {told}')
    content: dict[str, Any] = {
        'name': str(dict(ini.get('EMC', ())).get('MACHINE', 'linuxcnc')),
        'signals': 'milling',
        'control': {'dialect': 'linuxcnc'},
    }
    if len(rotary) == 1:
        content['rotary'] = _turntable(rotary, notes)
    elif rotary:
        content['rotary'] = _table(name, rotary, ini.get('HAL', []), linear / MM, notes)
    return content | {'limits': limits}, notes


def _unit(traj: Mapping[str, str], key: str, usual: str) -> float:
    text = traj.get(key, usual)
    if text.lower() in UNITS:
        return UNITS[text.lower()]
    raise MachineError(f'{text!r} is no unit; known: {", ".join(UNITS)}', f'[TRAJ]{key}')


def _limits(
    letter: str, sources: list[dict[str, str]], unit: float, straight: bool
) -> tuple[dict[str, Any], bool]:
    """Return the limits of an axis, the narrowest of its sections, and whether jerk is known."""

    def values(key: str, need: bool = True) -> list[float]:
        found = [_number(source[key], letter, key) for source in sources if key in source]
        demand(not need or found, f'missing in [AXIS_{letter}] and its [JOINT_n]', key)
        return found

    speed, turn = (M_PER_MIN, 1.0) if straight else (REV_PER_MIN, REV)
    velocity = min(values('MAX_VELOCITY')) * unit
    acceleration = min(values('MAX_ACCELERATION')) * unit
    told = [jerk for jerk in values('MAX_JERK', need=False) if jerk > 0.0]  # 0: no limit there
    jerk = min(told) * unit if told else JERK * acceleration
    kind, per = ('m', 'm') if straight else ('rev', 'rev')
    row: dict[str, Any] = {
        f'velocity_{kind}_per_min': _rounded(velocity / speed),
        f'acceleration_{per}_per_s2': _rounded(acceleration / turn),
        f'jerk_{per}_per_s3': _rounded(jerk / turn),
    }
    low, high = values('MIN_LIMIT', need=False), values('MAX_LIMIT', need=False)
    if low and high:
        size = unit / (MM if straight else DEG)
        ends = [_rounded(max(low) * size), _rounded(min(high) * size)]
        row['travel_mm' if straight else 'travel_deg'] = ends
    return row, bool(told)


def _number(text: str, letter: str, key: str) -> float:
    try:
        value = float(text.split('#')[0].split(';')[0])
    except ValueError:
        value = float('nan')
    demand(isfinite(value), f'must be a number, not {text!r}', f'{key} of {letter}')
    return value


def _rounded(value: float) -> float:
    return float(f'{value:.9g}')


def _turntable(letter: str, notes: list[str]) -> dict[str, Any]:
    """Return the geometry of a fourth axis, beside a tilt of the head that is locked."""
    notes.append(f'{letter}: taken as a table; where its axis lies (primary_offset_mm) as 0 0 0')
    other = 'B' if letter == 'A' else 'A'
    return {
        'primary': {'name': letter, 'about': ABOUT[letter], 'carries': 'workpiece'},
        'secondary': {'name': other, 'about': ABOUT[other], 'carries': 'tool', 'locked': True},
        'workpiece_offset_mm': [0.0] * 3,
        'primary_offset_mm': [0.0] * 3,
    }


def _table(
    name: str, rotary: str, hal: list[tuple[str, str]], size: float, notes: list[str]
) -> dict[str, Any]:
    """Return the geometry of a tilting rotary table; its pins may be set by HALCMD."""
    across = {'A': 'y', 'B': 'x'}[rotary[0]]
    pins = {f'{across}-offset': 0.0, 'z-offset': 0.0} | {f'{c}-rot-point': 0.0 for c in 'xyz'}
    commands = ' \n'.join(value for key, value in hal if key == 'HALCMD')
    for pin in pins:
        found = re.search(rf'\bset[ps]\s+(?:{name}\.|:?){pin}\s+([-+.\d]+)', commands)
        if found:
            pins[pin] = _number(found[1], name, pin) * size
        else:
            notes.append(f'{name}.{pin}: not in the INI, taken as 0')
    notes.append(f'{name}: conventional-directions taken as off')
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
