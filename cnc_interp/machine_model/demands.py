"""Check requirements of machine file entries, and collect all mistakes of a file."""

from collections.abc import Callable
from typing import Any

from cnc_interp.core import MachineError


def demand(holds: object, text: str, key: str = '') -> None:
    """Raise MachineError about the entry ``key`` unless a condition holds."""
    if not holds:
        raise MachineError(text, key)


class Mistakes:
    """Collects mistakes of independent entries; as a context it continues after a mistake."""

    def __init__(self) -> None:
        self.found = list[MachineError]()

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, problem: object, trace: object) -> bool:
        if isinstance(problem, MachineError):
            self.found.append(problem)
        return isinstance(problem, MachineError)

    def read(self, reader: Callable[..., Any], *arguments: Any) -> Any:
        """Return the result of a reader for an entry; None after a mistake."""
        with self:
            return reader(*arguments)
        return None

    def report(self) -> None:
        """Raise MachineError with a line for each mistake, if there are any."""
        if self.found:
            problem = MachineError('\n'.join(dict.fromkeys(map(str, self.found))))
            problem.key = self.found[0].key
            raise problem
