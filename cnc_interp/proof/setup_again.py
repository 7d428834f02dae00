"""Offsets and tools that a plan was made with, as the parameters of LinuxCNC."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from cnc_interp.core.errors import InterpError
from cnc_interp.core.small_files import UnreadableError, parse_yaml
from cnc_interp.core.units import MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform

OFFSETS = ('G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3')
#: First parameters of the positions, and the unit of LinuxCNC's files [mm].
G28, G30, G92_ON, ACTIVE, G54, EACH, INCH = 5160, 5180, 5210, 5220, 5220, 20, 25.4
#: The parameter of the rotation of a work offset, from its first one.
ROTATION = 10


@dataclass(frozen=True)
class Setup:
    """What LinuxCNC starts with."""

    #: Numbered parameters [inch, deg].
    parameters: Mapping[int, float] = field(default_factory=dict)
    #: Length of tools by their numbers [m].
    tool_lengths: Mapping[int, float] = field(default_factory=dict)
    tool: int = 0  #: The tool in the spindle; 0: none.


def cutters_of(text: Any) -> dict[int, tuple[float, float]] | None:
    """
    Return radius and corner radius of the tools of a setup that has nothing else [m].

    A corner radius that is not known is NaN. With offsets, reference points or tool lengths, the
    result is None.
    """
    if not text:
        return {}
    try:
        content = parse_yaml(str(text)) or {}
        tools = content.get('tools', {})
        if set(content) - {'tools', 'tool'} or any(tool['length'] for tool in tools.values()):
            return None
        return {
            int(number): (
                float(tool.get('radius', 0.0)) * MM,
                float(tool.get('corner_radius', 'nan')) * MM,
            )
            for number, tool in tools.items()
        }
    except (UnreadableError, AttributeError, KeyError, TypeError, ValueError) as problem:
        raise InterpError(f'summary.json: its setup cannot be read: {problem}') from None


def setup_of(text: Any, machine: Machine) -> Setup:
    """Read the setup that stands in the summary of a plan."""
    if not text:
        return Setup()
    zero = Transform.of(machine).linear(np.zeros((1, 3)), np.zeros((1, 2)))[0] / MM
    at_zero, nowhere = dict(zip('XYZ', zero.tolist(), strict=True)), dict.fromkeys('XYZ', 0.0)
    try:
        content = parse_yaml(str(text)) or {}
        places = {G54 + EACH * i: content.get('work_offsets', {}).get(name)
                  for i, name in enumerate(OFFSETS)}  # fmt: skip
        places |= {
            first: content.get('reference_points', {}).get(name)
            for first, name in ((G28, 'G28'), (G30, 'G30'))
        }
        parameters = {
            first + 1 + i: place[letter] / INCH if letter in 'XYZ' else place[letter]
            for first, given in places.items()
            if given
            for place in [{k: v - at_zero.get(k, 0.0) for k, v in given.items()}]
            for i, letter in enumerate('XYZABC')
            if letter in place
        } | {
            first + ROTATION: given['R']
            for first, given in places.items()
            if given and 'R' in given
        }
        amounts = nowhere | content.get('g92', {})
        for i, letter in enumerate('XYZABC'):
            if amounts.get(letter):
                parameters[G92_ON + 1 + i] = amounts[letter] / (INCH if letter in 'XYZ' else 1.0)
        parameters[G92_ON] = float(content.get('g92_on', bool(content.get('g92'))))
        parameters[ACTIVE] = 1.0 + OFFSETS.index(content.get('active') or OFFSETS[0])
        lengths = {int(n): tool['length'] * MM for n, tool in content.get('tools', {}).items()}
        return Setup(parameters, lengths, int(content.get('tool', 0)))
    except (UnreadableError, AttributeError, KeyError, TypeError, ValueError) as problem:
        raise InterpError(f'summary.json: its setup cannot be read: {problem}') from None
