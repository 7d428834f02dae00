"""Check the entries of a machine file and convert them to SI units."""

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from cnc_interp.core import DEG, M_PER_MIN, MM, REV, REV_PER_MIN, FloatArray, MachineError
from cnc_interp.core.axis_limits import AxisLimits, LimitsByPlace
from cnc_interp.core.small_files import (
    LONGEST_YAML,
    UnreadableError,
    config_directory,
    is_number,
    small_text,
)
from cnc_interp.machine_model.demands import Mistakes, demand
from cnc_interp.settings.option_kinds import choices
from cnc_interp.settings.options import Settings

#: Keys of ``rotary``: the rows of ``Machine.offsets`` and ``Machine.tool_offset``.
GEOMETRY = (
    'workpiece_offset_mm',
    'secondary_offset_mm',
    'primary_offset_mm',
    'tip_to_secondary_pivot_mm',
    'secondary_to_primary_pivot_mm',
)
#: Values of a linear and of a rotary axis: key in the file -> unit of the file, in SI.
LINEAR_KEYS = {
    'velocity_m_per_min': M_PER_MIN,
    'acceleration_m_per_s2': 1.0,
    'jerk_m_per_s3': 1.0,
    'travel_mm': MM,
}
ROTARY_KEYS = {
    'velocity_rev_per_min': REV_PER_MIN,
    'acceleration_rev_per_s2': REV,
    'jerk_rev_per_s3': REV,
    'travel_deg': DEG,
}
#: Options of the program reader that a machine file may set.
CONTROL = ('dialect', 'arc_centres', 'units', 'numbers')
#: Keys that describe the speed of a control on short blocks -> plausible range.
PACE = {'velocity_jump_mm_per_s': (1e-3, 1e4), 'block_time_ms': (1e-3, 1e3)}
STOPS = 'stops_at_rapids'
SCATTER = 'scatter_percent'
#: Keys of times at rest, and of the speed at which spindle times were measured.
CHANGE, START, STOP, REVERSAL, SPEED = STANDSTILL = (
    'tool_change_s',
    'spindle_start_s',
    'spindle_stop_s',
    'spindle_reversal_s',
    'spindle_speed_rev_per_min',
)
USUAL_REVERSAL = 0.2  #: Default reversal time of a tapping spindle [s].
EXTRA_LETTERS = ('U', 'V', 'W')  #: Letters of linear extra axes.
POSITIONERS = ('E1', 'E2', 'E3')  #: Names of rotary extra axes of arms.
LOCKED_LIMITS = AxisLimits(1.0, 1.0, 1.0, (-1e-9, 1e-9))  #: Limits of a locked axis [rad, s].
SAME_PLACE = 1e-9  #: Tolerance at the ends of travel for a table of limits [m, rad].
#: Plausible ranges of velocity, acceleration and jerk limits of linear and of rotary axes, in SI.
#: Outside, a unit is wrong. Velocities: 60 mm/min to 600 m/min, 0.1 to 9549 rev/min.
PLAUSIBLE = {
    True: ((1e-3, 10.0), (0.01, 1e3), (0.05, 1e6)),
    False: ((0.01, 1e3), (0.05, 1e4), (0.3, 1e7)),
}


def section(content: dict[str, Any], name: str, known: Collection[str]) -> dict[str, Any]:
    """Return a section of the file; {} if it is missing. Raise MachineError at unknown entries."""
    given = content.get(name) or {}
    demand(isinstance(given, dict), f'may hold {", ".join(known)}', name)
    require_known(given, known, name)
    return given


def control(content: dict[str, Any]) -> dict[str, str]:
    given = section(content, 'control', CONTROL)
    known = {choice.name: choice for choice in choices(Settings)}
    for key, value in given.items():
        demand(
            value in known[key].values,
            f'must be {" or ".join(known[key].values)}',
            f'control.{key}',
        )
    return dict(given)


@dataclass(frozen=True)
class BlockPace:
    jump: float  #: Largest velocity step at a vertex [m/s].
    block_time: float  #: Shortest time for a block [s].
    jerk: float  #: Jerk limit between two vertices [m/s3].
    stops_at_rapids: bool = False  #: Whether the tool stops before and after a rapid.
    scatter: float = 0.0  #: Relative error of planned times (95 %); 0: unknown.


def block_pace(content: dict[str, Any], jerk: float) -> BlockPace | None:
    given = content.get('look_ahead')
    if given is None:
        return None
    demand(
        isinstance(given, dict) and set(given) - {STOPS, SCATTER} == set(PACE),
        f'must hold {" and ".join(PACE)}, and may {STOPS} and {SCATTER}',
        'look_ahead',
    )
    stops = given.get(STOPS, False)
    demand(isinstance(stops, bool), 'must be true or false', f'look_ahead.{STOPS}')
    jump, time = (number(given[k], f'look_ahead.{k}', *PACE[k]) * 1e-3 for k in PACE)
    scatter = 0.0
    if SCATTER in given:
        scatter = 0.01 * number(given[SCATTER], f'look_ahead.{SCATTER}', 1e-3, 100.0)
    return BlockPace(jump, time, jerk, stops, scatter)


@dataclass(frozen=True)
class Standstill:
    """Times at rest. A spindle is assumed to accelerate at constant power."""

    tool_change: float = 0.0  #: Time of a tool change [s].
    #: Time to start and to stop the spindle, over the change of its squared speed [s/(rev/min)2].
    start: float = 0.0
    stop: float = 0.0
    reversal: float = 0.0  #: Reversal time of a tapping spindle [s].
    #: Speed at which start and stop times were measured [rev/min]; 0: not measured.
    speed: float = 0.0


def standstill(content: dict[str, Any]) -> Standstill:
    given = section(content, 'standstill', STANDSTILL)
    least = {SPEED: 1.0}
    found = {
        key: number(value, f'standstill.{key}', least.get(key, 1e-3), 1e6)
        for key, value in given.items()
    }
    speed = found.get(SPEED, 0.0)
    demand(
        speed > 0.0 or not {START, STOP} & set(found),
        'missing; the speed at which start and stop of the spindle were measured',
        f'standstill.{SPEED}',
    )
    start, stop = (found[key] / speed**2 if key in found else 0.0 for key in (START, STOP))
    usual = USUAL_REVERSAL if given else 0.0
    return Standstill(found.get(CHANGE, 0.0), start, stop, found.get(REVERSAL, usual), speed)


@dataclass(frozen=True)
class Macro:
    name: str  #: Label of its key on the page.
    lines: tuple[str, ...]  #: Lines of G-code, executed one after the other.

    @property
    def moves(self) -> bool:
        """Whether any line of the macro may move an axis."""
        return not all(_STILL.fullmatch(line.upper()) for line in self.lines)


#: Lines without motion: S, T, dwells, and M codes except M6 and calls.
_STILL = re.compile(r'(?:\s*(?:M(?!0*6\b|98\b|198\b)\d+|[ST]\d+(?:\.\d+)?|G0?4\s*[PX][\d.]+))+\s*')
MOST_MACROS, LONGEST_MACRO = 24, 40
TOOL_CHANGE = 'tool_change_macro'  #: Key of the entry for the subprogram of M6.


def macros(content: dict[str, Any]) -> tuple[Macro, ...]:
    given = content.get('macros') or {}
    demand(
        isinstance(given, dict) and len(given) <= MOST_MACROS,
        f'must be a mapping of at most {MOST_MACROS} names',
        'macros',
    )
    found = []
    for name, told in given.items():
        lines = [told] if isinstance(told, str) else told
        texts = isinstance(lines, list) and all(isinstance(line, str) for line in lines)
        demand(
            texts and lines and all(line.strip() for line in lines),
            'must be a line of G-code, or a list of lines',
            f'macros.{name}',
        )
        demand(
            len(lines) <= LONGEST_MACRO and not any('\n' in line for line in lines),
            f'at most {LONGEST_MACRO} lines; call a subprogram for more',
            f'macros.{name}',
        )
        found.append(Macro(str(name), tuple(line.strip() for line in lines)))
    return tuple(found)


def tool_change_macro(content: dict[str, Any], folder: Path) -> str:
    """Return the subprogram that M6 calls. The entry holds it or names a file; '' if missing."""
    given = content.get(TOOL_CHANGE, '')
    demand(isinstance(given, str), 'must be the name of a subprogram, or its lines', TOOL_CHANGE)
    if not given or '\n' in given:
        return str(given)
    name = given if given.endswith('.ngc') else f'{given}.ngc'
    folders = folder, config_directory() / 'subprograms'
    file = next((each / name for each in folders if (each / name).is_file()), folder / name)
    try:
        return small_text(file, LONGEST_YAML)
    except (OSError, UnreadableError) as problem:
        told = getattr(problem, 'strerror', None) or problem
        raise MachineError(f'{file} cannot be read: {told}', TOOL_CHANGE) from None


def extra_axes(content: dict[str, Any]) -> dict[str, FloatArray]:
    found = {}
    for name, values in section(content, 'extra', EXTRA_LETTERS).items():
        along: Any = values.get('along') if isinstance(values, dict) else None
        demand(along in ('X', 'Y', 'Z'), "must be 'X', 'Y' or 'Z'", f'extra.{name}.along')
        found[str(name)] = np.eye(3)['XYZ'.index(along)]
    return found


def is_locked(rotary: dict[str, Any], name: str) -> bool:
    axes = (rotary[key] for key in ('primary', 'secondary'))
    return any(axis.get('name') == name and axis.get('locked') is True for axis in axes)


def entry(rotary: dict[str, Any], axis: str, where: str, key: str) -> Any:
    demand(
        isinstance(rotary.get(axis), dict) and key in rotary[axis],
        'missing',
        f'{where}.{axis}.{key}',
    )
    return rotary[axis][key]


def linear_geometry(content: dict[str, Any]) -> dict[str, Any]:
    offsets = np.zeros((3, 3))
    offsets[0] = vector(content, 'workpiece_zero_mm', optional=True)
    return {
        'rotary_direction': np.array([[1.0, 0, 0], [0, 0, 1.0]]),
        'rotary_on_head': (False, False),
        'offsets': offsets,
        'tool_offset': np.zeros((2, 3)),
        'singular_cone': 0.0,
    }


def needed_offsets(on_head: Collection[bool], locked: bool) -> list[str]:
    """Return the keys under ``rotary`` that the layout of the rotary axes requires."""
    table = [] if all(on_head) else [k for k in GEOMETRY[:3] if k != GEOMETRY[1] or not locked]
    return table + list(GEOMETRY[3:] if any(on_head) and not locked else ())


def _direction(rotary: dict[str, Any], key: str) -> FloatArray:
    about = np.asarray(numbers(entry(rotary, key, 'rotary', 'about'), 3, f'rotary.{key}.about'))
    demand(np.linalg.norm(about) > 0.0, 'must not be zero', f'rotary.{key}.about')
    return about / np.linalg.norm(about)


def _on_head(rotary: dict[str, Any], key: str) -> bool:
    carries = entry(rotary, key, 'rotary', 'carries')
    where = f'rotary.{key}.carries'
    demand(carries in ('workpiece', 'tool'), "must be 'workpiece' or 'tool'", where)
    return bool(carries == 'tool')


def rotary_geometry(rotary: dict[str, Any]) -> dict[str, Any]:
    mistakes, both = Mistakes(), ('primary', 'secondary')
    directions = [mistakes.read(_direction, rotary, key) for key in both]
    on_head = [mistakes.read(_on_head, rotary, key) for key in both]
    mistakes.report()
    locked = any(rotary[key].get('locked') is True for key in ('primary', 'secondary'))
    tilt = rotary.get('singular_cone_deg', 0.02)
    cone = number(tilt, 'rotary.singular_cone_deg', 1e-4, 30.0) * DEG
    demand(
        abs(directions[0] @ directions[1]) <= 0.999,
        'primary and secondary must not be parallel',
        'rotary.secondary.about',
    )
    demand(
        abs(directions[1 if all(on_head) else int(on_head[1])][2]) <= 0.999,
        'the axis next to the tool must tilt it away from +Z',
        'rotary',
    )
    needed = needed_offsets(on_head, locked)
    rows = [mistakes.read(vector, rotary, key, key not in needed) for key in GEOMETRY]
    if set(needed) - set(rotary):
        mistakes.found.append(MachineError(f'this layout needs {", ".join(needed)}', 'rotary'))
    mistakes.report()
    return {
        'rotary_direction': np.array(directions),
        'rotary_on_head': (on_head[0], on_head[1]),
        'offsets': np.array(rows[:3]),
        'tool_offset': np.array(rows[3:]),
        'singular_cone': cone,
    }


@dataclass(frozen=True)
class ReferenceSwitches:
    #: Axis -> position of its switch [m, rad]. The switch is pressed from there to the nearer end
    #: of the travel.
    switches: Mapping[str, float] = field(default_factory=dict)
    #: Axis -> position of the index pulse after the release of its switch [m, rad].
    index: Mapping[str, float] = field(default_factory=dict)
    #: Gantry axes; each has two motors with a switch for each motor.
    squared: tuple[str, ...] = ()
    groups: tuple[tuple[str, ...], ...] = ()  #: Axes that home together, in order.
    required: bool = False  #: Whether programs require that all these axes are homed.


def homing(
    content: dict[str, Any], travel: dict[str, tuple[FloatArray, float]]
) -> ReferenceSwitches:
    if content.get('homing') is None:
        return ReferenceSwitches()
    given = section(content, 'homing', ('switches', 'index', 'squared', 'order', 'required'))
    order, required = given.get('order'), given.get('required', False)
    demand(isinstance(required, bool), 'must be true or false', 'homing.required')
    found, index = _on_travel(given, 'switches', travel), dict[str, float]()
    if 'index' in given:
        index = _on_travel(given, 'index', {name: travel[name] for name in found})
    squared = given.get('squared', [])
    demand(
        isinstance(squared, list) and set(map(str, squared)) <= set(found) - set(index),
        'must list axes of switches that have no index',
        'homing.squared',
    )
    groups = [[name] for name in found] if order is None else order
    lists = isinstance(groups, list) and all(isinstance(group, list) for group in groups)
    demand(
        lists and sorted(str(name) for group in groups for name in group) == sorted(found),
        'must name each axis of switches once, such as [[Z], [X, Y]]',
        'homing.order',
    )
    return ReferenceSwitches(found, index, tuple(squared), tuple(map(tuple, groups)), required)


def _on_travel(
    given: dict[str, Any], section: str, travel: dict[str, tuple[FloatArray, float]]
) -> dict[str, float]:
    found, places = {}, given.get(section, {})
    demand(
        isinstance(places, dict) and places,
        'must give axes with positions, such as {Z: 480.0}',
        f'homing.{section}',
    )
    for name, value in places.items():
        key = f'homing.{section}.{name}'
        demand(
            name in travel and np.isfinite(travel[name][0]).all(),
            'the machine has no axis of this name with a travel',
            key,
        )
        (low, high), unit = travel[name]
        found[name] = numbers([value], 1, key)[0] * unit
        demand(low < found[name] < high, 'must lie within the travel', key)
    return found


def following_errors(
    content: dict[str, Any], names: list[str], linear: list[bool]
) -> dict[int, float]:
    given = entries_by_axis(content, 'following_errors', names, 'a largest following error')
    return {
        i: number(value, where, 1e-6, 1e3) * (MM if linear[i] else DEG)
        for i, where, value in given
    }


def axis_limits(limits: dict[str, Any], name: str, linear: bool) -> AxisLimits:
    values: Any = limits.get(name)
    demand(
        isinstance(values, dict), 'missing; give velocity, acceleration, jerk', f'limits.{name}'
    )
    units = LINEAR_KEYS if linear else ROTARY_KEYS
    mistakes, found = Mistakes(), []
    mistakes.read(require_known, values, units, f'limits.{name}')
    *limit_keys, travel_key = units
    for key, (low, high) in zip(limit_keys, PLAUSIBLE[linear], strict=True):
        where, unit = f'limits.{name}.{key}', units[key]
        with mistakes:
            demand(key in values, 'missing', where)
            found.append(number(values[key], where, low / unit, high / unit) * unit)
    low, high = -np.inf, np.inf
    with mistakes:
        if travel_key in values:
            ends, where = values[travel_key], f'limits.{name}.{travel_key}'
            lists = isinstance(ends, list) and len(ends) == 2
            given = [x for x in ends if x not in (-np.inf, np.inf)] if lists else ends
            numbers(given, len(given) if lists else 2, where)
            demand(ends[0] < ends[1], 'must be [lowest, highest]', where)
            low, high = (x * units[travel_key] for x in ends)
    mistakes.report()
    return AxisLimits(found[0], found[1], found[2], (low, high))


def limits_by_position(
    content: dict[str, Any],
    names: list[str],
    linear: list[bool],
    limits: list[AxisLimits],
) -> dict[int, LimitsByPlace]:
    given = entries_by_axis(content, 'limits_by_position', names, 'positions and limits')
    return {i: _places(values, where, linear[i], limits[i]) for i, where, values in given}


def entries_by_axis(
    content: dict[str, Any], section: str, names: list[str], holds: str
) -> Iterator[tuple[int, str, Any]]:
    given = content.get(section) or {}
    demand(isinstance(given, dict), f'must name axes, each with {holds}', section)
    for name, values in given.items():
        where = f'{section}.{name}'
        demand(name in names, f'the machine has no such axis (axes: {" ".join(names)})', where)
        yield names.index(name), where, values


def _places(values: Any, where: str, linear: bool, limits: AxisLimits) -> LimitsByPlace:
    largest = limits.max_velocity, limits.max_acceleration, limits.max_jerk
    travel = limits.travel
    units = LINEAR_KEYS if linear else ROTARY_KEYS
    *limit_keys, travel_key = units
    place_key = travel_key.replace('travel', 'at')
    demand(
        isinstance(values, dict) and isinstance(values.get(place_key), list),
        f'give {place_key}: the positions, and limits there',
        where,
    )
    require_known(values, (place_key, *limit_keys), where)
    count = len(values[place_key])
    place = np.array(numbers(values[place_key], count, f'{where}.{place_key}')) * units[travel_key]
    demand(
        count >= 2 and (np.diff(place) > 0.0).all(),
        'must be increasing positions, at least two',
        f'{where}.{place_key}',
    )
    demand(
        np.isfinite(travel).all(), f'the axis is endless; give it {travel_key} under limits', where
    )
    low, high = (end / units[travel_key] for end in travel)
    demand(
        place[0] <= travel[0] + SAME_PLACE and place[-1] >= travel[1] - SAME_PLACE,
        f'does not cover the travel {low:g} ... {high:g}',
        f'{where}.{place_key}',
    )
    table = np.array([np.full(count, one) for one in largest] + [place])
    for row, key in enumerate(limit_keys):
        if key not in values:
            continue
        unit, least = units[key], PLAUSIBLE[linear][row][0]
        at = f'{where}.{key}'
        for column, value in enumerate(numbers(values[key], count, at)):
            demand(
                value * unit <= largest[row] * (1.0 + 1e-12),
                f'{value:g} is above {largest[row] / unit:g}, the one under limits',
                at,
            )
            table[row, column] = number(value, at, least / unit, np.inf) * unit
    return LimitsByPlace(*table)


def require_known(values: dict[str, Any], known: Collection[str], where: str) -> None:
    for key in values:
        demand(key in known, f'unknown; known: {", ".join(known)}', f'{where}.{key}')


def number(value: Any, key: str, low: float, high: float) -> float:
    demand(is_number(value), f'must be a number, not {value!r}', key)
    demand(value > 0.0, f'must be positive, not {value}', key)
    demand(
        low <= value <= high, f'{value} is outside {low:g} ... {high:g}; is the unit right?', key
    )
    return float(value)


def numbers(value: Any, count: int, key: str) -> list[float]:
    demand(
        isinstance(value, list) and len(value) == count, f'must be a list of {count} numbers', key
    )
    for x in value:
        demand(is_number(x), f'must hold numbers, not {x!r}', key)
    return [float(x) for x in value]


def vector(rotary: dict[str, Any], key: str, optional: bool) -> FloatArray:
    """Return an offset [m] from its entry in mm; 0 if it is optional and missing."""
    if key not in rotary:
        demand(optional, 'missing; three numbers in mm', f'rotary.{key}')
        return np.zeros(3)
    return np.asarray(numbers(rotary[key], 3, f'rotary.{key}')) * MM
