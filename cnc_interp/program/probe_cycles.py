"""The probing cycles in config/subprograms, as lines by hand call them."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from math import isfinite

from cnc_interp.core import InterpError
from cnc_interp.core.ros_share import config_directory

NAMES = ('surface', 'edge', 'bore', 'boss', 'angle', 'tool')
_TEXT = re.compile(r'\((.*)\)')
_PARAMETER = re.compile(r'\(#\d+ (\w+) = (\S+): (.*) \[(.*)\]\)')


@dataclass(frozen=True)
class Parameter:
    name: str
    default: float
    text: str
    unit: str


@dataclass(frozen=True)
class Cycle:
    name: str
    text: str  #: What it finds, and what it sets.
    parameters: tuple[Parameter, ...]

    def line(self, values: Mapping[str, float]) -> str:
        """Return the line by hand that runs it; InterpError for a value that it does not know."""
        known = {parameter.name: parameter.default for parameter in self.parameters}
        for name, value in values.items():
            if name not in known or not isfinite(value):
                text = f'{self.name}: {name} {value:g} is not possible'
                raise InterpError(f'{text}; give numbers for {", ".join(known)}')
        given = {**known, **values}
        return f'O<probe_{self.name}> CALL ' + ' '.join(f'[{v:.6g}]' for v in given.values())


@cache
def cycles() -> dict[str, Cycle]:
    found = {}
    for name in NAMES:
        file = config_directory() / 'subprograms' / f'probe_{name}.ngc'
        first, *lines = file.read_text(encoding='utf-8').splitlines()
        parameters = tuple(
            Parameter(match[1], float(match[2]), match[3], match[4])
            for match in map(_PARAMETER.fullmatch, lines)
            if match
        )
        text = _TEXT.fullmatch(first)
        assert text is not None
        found[name] = Cycle(name, text[1], parameters)
    return found
