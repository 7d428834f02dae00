"""Make a machine file by questions; each answer is checked by the reader of machine files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import deepcopy
from typing import Any

import yaml

from cnc_interp.core import MachineError
from cnc_interp.core.small_files import read_yaml
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping

#: Layouts, and the bundled machine whose values are proposed.
LAYOUTS = {
    'X Y Z alone': 'vmc',
    'one rotary axis in the table': 'xyza',
    'two rotary axes in the table': 'xyzac',
    'one rotary axis in the head, one in the table': 'head_table',
    'two rotary axes in the head': 'head_head',
}
ASKED = 'workpiece_zero_mm', 'rotary', 'limits'  #: Sections whose values are asked for.


def _leaves(content: dict[str, Any], *keys: str) -> Iterator[tuple[str, ...]]:
    for key in content if keys else filter(content.__contains__, ASKED):
        value = content[key]
        if isinstance(value, dict):
            yield from _leaves(value, *keys, key)
        else:
            yield (*keys, key)


def _put(content: dict[str, Any], place: tuple[str, ...], value: Any) -> dict[str, Any]:
    """Return the content with a new value at ``place``; limits are renamed with their axis."""
    changed = deepcopy(content)
    holder = changed
    for key in place[:-1]:
        holder = holder[key]
    old, holder[place[-1]] = holder[place[-1]], value
    if place[-1] == 'name' and len(place) > 1:
        limits = changed['limits']
        changed['limits'] = {value if k == old else k: v for k, v in limits.items()}
    return changed


def ask_machine(ask: Callable[[str], str], tell: Callable[[str], None]) -> dict[str, Any]:
    """Return the content of a machine file.

    ``ask`` shows a question and returns the answer, '' to accept the proposal; ``tell`` shows why
    an answer is rejected.
    """
    for number, layout in enumerate(LAYOUTS, 1):
        tell(f'{number}  {layout}')
    choice = ''
    while choice not in {str(number) for number in range(1, len(LAYOUTS) + 1)}:
        choice = ask('layout [3]: ') or '3'
    bundled = read_yaml(find_machine_file(list(LAYOUTS.values())[int(choice) - 1]))
    kept = 'name', 'signals', *ASKED
    content = {key: bundled[key] for key in kept if key in bundled}
    content['name'] = ask('name of the machine [my_machine]: ') or 'my_machine'
    for k in range(len([*_leaves(content)])):
        # The name of an axis may have changed since.
        content = _answered(content, [*_leaves(content)][k], ask, tell)
    return content


def _answered(
    content: dict[str, Any],
    place: tuple[str, ...],
    ask: Callable[[str], str],
    tell: Callable[[str], None],
) -> dict[str, Any]:
    proposed: Any = content
    for key in place:
        proposed = proposed[key]
    while answer := ask(f'{" ".join(place[-2:])} [{proposed}]: '):
        try:
            changed = _put(content, place, yaml.safe_load(answer))
            from_mapping(changed)
        except (MachineError, yaml.YAMLError, TypeError) as problem:
            tell(f'  {problem}')
            continue
        return changed
    return content


def shown(machine: Machine) -> list[str]:
    """Return a description of a machine, with a line for each axis."""
    lines = []
    for axis in machine.axes:
        size, unit = axis.shown_size, axis.shown_unit
        low, high = (f'{end / size:g}' for end in axis.travel)
        travel = 'endless' if axis.endless else f'{low} to {high} {unit}'
        lines.append(
            f'{axis.name}  {travel};  {axis.max_velocity / size:g} {unit}/s, '
            f'{axis.max_acceleration / size:g} {unit}/s2, {axis.max_jerk / size:g} {unit}/s3'
        )
    if machine.has_rotary:
        names = machine.axis_names[3:5]
        rows = zip(names, machine.rotary_direction, machine.rotary_on_head, strict=True)
        for name, about, on_head in rows:
            carried = 'tool' if on_head else 'workpiece'
            lines.append(f'{name} turns the {carried} about {about.round(4).tolist()}')
    return lines
