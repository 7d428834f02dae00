"""Entries of a machine file, checked and turned into SI units."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import MachineError
from cnc_interp.core.units import DEG, M_PER_MIN, MM, REV, REV_PER_MIN

#: Every value of an axis: key in the file -> (unit in SI, for linear and for rotary axes).
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
#: Letters that an extra axis may have.
EXTRA_LETTERS = ('U', 'V', 'W')
#: Limits of a locked axis, which no motion reaches, and its travel [rad, s].
LOCKED_LIMITS = ([1.0, 1.0, 1.0], [-1e-9, 1e-9])
#: Plausible size of velocity, acceleration and jerk limits in SI; beyond them a unit is wrong.
PLAUSIBLE = ((1e-6, 1e3), (1e-4, 1e5), (1e-3, 1e7))


def extra_axes(content: dict[str, Any]) -> dict[str, FloatArray]:
    """Read letters and directions of the extra axes, in the order of the file."""
    given = content.get('extra') or {}
    if not isinstance(given, dict):
        raise MachineError('must name axes U, V or W, each with along: X, Y or Z', 'extra')
    found = {}
    for name, values in given.items():
        if name not in EXTRA_LETTERS:
            raise MachineError(f'an extra axis is U, V or W, not {name}', f'extra.{name}')
        along = values.get('along') if isinstance(values, dict) else None
        if along not in ('X', 'Y', 'Z'):
            raise MachineError("must be 'X', 'Y' or 'Z'", f'extra.{name}.along')
        found[str(name)] = np.eye(3)['XYZ'.index(along)]
    return found


def is_locked(rotary: dict[str, Any], name: str) -> bool:
    """Tell whether a rotary axis is locked, as the second one of a 4-axis machine."""
    axes = (rotary[key] for key in ('primary', 'secondary'))
    return any(axis.get('name') == name and axis.get('locked') is True for axis in axes)


def entry(rotary: dict[str, Any], axis: str, where: str, key: str) -> Any:
    """Return one value of a rotary axis; raise an error that names it if it is missing."""
    if not isinstance(rotary.get(axis), dict) or key not in rotary[axis]:
        raise MachineError('missing', f'{where}.{axis}.{key}')
    return rotary[axis][key]


def linear_geometry(content: dict[str, Any]) -> dict[str, Any]:
    """Read where the workpiece zero of a machine without rotary axes lies."""
    offsets = np.zeros((3, 3))
    offsets[0] = vector(content, 'workpiece_zero_mm', optional=True)
    return {
        'rotary_direction': np.array([[1.0, 0, 0], [0, 0, 1.0]]),
        'rotary_on_head': (False, False),
        'offsets': offsets,
        'tool_offset': np.zeros((2, 3)),
        'singular_cone': 0.0,
    }


def rotary_geometry(rotary: dict[str, Any]) -> dict[str, Any]:
    """Read directions, carriers and offsets of the rotary axes."""
    directions, on_head = [], []
    for key in ('primary', 'secondary'):
        direction = entry(rotary, key, 'rotary', 'about')
        about = np.asarray(numbers(direction, 3, f'rotary.{key}.about'))
        if not np.linalg.norm(about) > 0.0:
            raise MachineError('must not be zero', f'rotary.{key}.about')
        directions.append(about / np.linalg.norm(about))
        carries = entry(rotary, key, 'rotary', 'carries')
        if carries not in ('workpiece', 'tool'):
            raise MachineError("must be 'workpiece' or 'tool'", f'rotary.{key}.carries')
        on_head.append(carries == 'tool')
    locked = any(rotary[key].get('locked') is True for key in ('primary', 'secondary'))
    tilt = rotary.get('singular_cone_deg', 0.02)
    cone = number(tilt, 'rotary.singular_cone_deg', 1e-4, 30.0) * DEG
    if abs(directions[0] @ directions[1]) > 0.999:
        raise MachineError('primary and secondary must not be parallel', 'rotary.secondary.about')
    if abs(directions[1 if all(on_head) else int(on_head[1])][2]) > 0.999:
        raise MachineError('the axis next to the tool must tilt it away from +Z', 'rotary')
    return {
        'rotary_direction': np.array(directions),
        'rotary_on_head': (on_head[0], on_head[1]),
        'offsets': np.array(
            [
                vector(
                    rotary,
                    f'{key}_offset_mm',
                    optional=all(on_head) or (key == 'secondary' and locked),
                )
                for key in ('workpiece', 'secondary', 'primary')
            ]
        ),
        'tool_offset': np.array(
            [
                vector(rotary, f'{key}_mm', optional=locked or not any(on_head))
                for key in ('tip_to_secondary_pivot', 'secondary_to_primary_pivot')
            ]
        ),
        'singular_cone': cone,
    }


def axis_limits(
    limits: dict[str, Any], name: str, linear: bool
) -> tuple[list[float], list[float]]:
    """Read velocity, acceleration, jerk and travel of one axis in SI."""
    values = limits.get(name)
    if not isinstance(values, dict):
        raise MachineError('missing; give velocity, acceleration, jerk', f'limits.{name}')
    units = LINEAR_KEYS if linear else ROTARY_KEYS
    for key in values:
        if key not in units:
            raise MachineError(f'unknown; known: {", ".join(units)}', f'limits.{name}.{key}')
    *limit_keys, travel_key = units
    found = []
    for key, (low, high) in zip(limit_keys, PLAUSIBLE, strict=True):
        if key not in values:
            raise MachineError('missing', f'limits.{name}.{key}')
        unit = units[key]
        found.append(number(values[key], f'limits.{name}.{key}', low / unit, high / unit) * unit)
    travel = [-np.inf, np.inf]
    if travel_key in values:
        low_high = numbers(values[travel_key], 2, f'limits.{name}.{travel_key}')
        if not low_high[0] < low_high[1]:
            raise MachineError('must be [lowest, highest]', f'limits.{name}.{travel_key}')
        travel = [x * units[travel_key] for x in low_high]
    return found, travel


def number(value: Any, key: str, low: float, high: float) -> float:
    """Check one positive number against the range in which its unit makes sense."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not np.isfinite(value):
        raise MachineError(f'must be a number, not {value!r}', key)
    if value <= 0.0:
        raise MachineError(f'must be positive, not {value}', key)
    if not low <= value <= high:
        raise MachineError(f'{value} is outside {low:g} ... {high:g}; is the unit right?', key)
    return float(value)


def numbers(value: Any, count: int, key: str) -> list[float]:
    """Check a list of finite numbers."""
    if not isinstance(value, list) or len(value) != count:
        raise MachineError(f'must be a list of {count} numbers', key)
    for x in value:
        if isinstance(x, bool) or not isinstance(x, (int, float)) or not np.isfinite(x):
            raise MachineError(f'must hold numbers, not {x!r}', key)
    return [float(x) for x in value]


def vector(rotary: dict[str, Any], key: str, optional: bool) -> FloatArray:
    """Read an offset in mm; zero where it is optional and missing."""
    if key not in rotary:
        if optional:
            return np.zeros(3)
        raise MachineError('missing; three numbers in mm', f'rotary.{key}')
    return np.asarray(numbers(rotary[key], 3, f'rotary.{key}')) * MM
