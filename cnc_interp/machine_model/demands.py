"""Check entries of a machine file, and collect all mistakes of the file."""

from collections.abc import Callable
from typing import Any

from cnc_interp.core import MachineError


def demand(holds: object, text: str, key: str = '') -> None:
    """Raise MachineError with ``text`` about entry ``key`` unless ``holds`` is true."""
    if not holds:
        raise MachineError(text, key)


class Mistakes:
    """Collects the MachineErrors of independent entries; as a context manager it catches them."""

    def __init__(self) -> None:
        self.found = list[MachineError]()

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, problem: object, trace: object) -> bool:
        if isinstance(problem, MachineError):
            self.found.append(problem)
        return isinstance(problem, MachineError)

    def read(self, reader: Callable[..., Any], *arguments: Any) -> Any:
        """Return ``reader(*arguments)``; after a MachineError, collect it and return None."""
        with self:
            return reader(*arguments)
        return None

    def report(self) -> None:
        """If there are mistakes, raise one MachineError with a line for each."""
        if self.found:
            problem = MachineError('\n'.join(dict.fromkeys(map(str, self.found))))
            problem.key = self.found[0].key
            raise problem
