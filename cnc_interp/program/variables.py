"""Variables of a G-code program: numbered, named, and local in subprograms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

from cnc_interp.program.expressions import ExpressionError

#: ``#1`` to this number are local in a subprogram that is called with arguments.
MOST_LOCAL = 33
_MOST_VARIABLES = 100_000

UNSET = 'is read before it is set; set it in the program'


class ProgramVariables:
    """The variables of a program, and the system variables that it can read."""

    def __init__(self, system: Callable[[], Mapping[int, float]]):
        self._system = system
        self._numbers: dict[int, float] = {}
        self._names: dict[str, float] = {}
        self._locals: list[tuple[dict[int, float], dict[str, float]]] = []

    def follow(self, before: ProgramVariables) -> None:
        """Take over the global variables of another program."""
        self._numbers, self._names = dict(before._numbers), dict(before._names)

    def enter(self, arguments: Mapping[int, float]) -> None:
        """Begin a subprogram with its own local variables."""
        self._locals.append((dict(arguments), {}))

    def leave(self) -> None:
        """Return to the local variables of the caller."""
        self._locals.pop()

    def state(self) -> tuple[Any, ...]:
        """Return a copy of all values, for ``stands_as``."""
        return deepcopy((self._numbers, self._names, self._locals)) + (dict(self._system()),)

    def stands_as(self, before: tuple[Any, ...]) -> bool:
        """Tell whether all values, those of the system too, are again as they were."""
        now = self._numbers, self._names, self._locals
        return now == before[:3] and dict(self._system()) == before[3]

    def number(self, index: int) -> float:
        """Return ``#index``; local variables of a subprogram are 0 until they are set."""
        if self._locals and 1 <= index <= MOST_LOCAL:
            return self._locals[-1][0].get(index, 0.0)
        if index in self._numbers:
            return self._numbers[index]
        if index >= 5000 and index in (system := self._system()):
            return system[index]
        raise ExpressionError(f'#{index} {UNSET}')

    def set_number(self, index: int, value: float) -> None:
        """Set ``#index`` to a value."""
        if self._locals and 1 <= index <= MOST_LOCAL:
            self._locals[-1][0][index] = value
            return
        if index == 0 or index >= 5000:
            raise ExpressionError(f'#{index} cannot be set from a program; use #100 to #4999')
        self._numbers[index] = value

    def named(self, name: str) -> float:
        """Return the value of a named variable."""
        names = self._table(name)
        if name in names:
            return names[name]
        shown = f'#{name}' if name.startswith('<') else name
        raise ExpressionError(f'{shown} {UNSET}')

    def set_name(self, name: str, value: float) -> None:
        """Set a named variable to a value."""
        names = self._table(name)
        if len(names) >= _MOST_VARIABLES:
            raise ExpressionError(f'more than {_MOST_VARIABLES:,} variables; use fewer names')
        names[name] = value

    def exists(self, name: str) -> bool:
        """Tell whether a name is known."""
        return name in self._table(name)

    def _table(self, name: str) -> dict[str, float]:
        """Return the table of a name: local for ``#<name>``, global for the others."""
        local = name.startswith('<') and not name.startswith('<_')
        return self._locals[-1][1] if self._locals and local else self._names
