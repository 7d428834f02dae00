"""The line at which a run starts, found while the whole program is read."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, ProgramError


@dataclass(frozen=True)
class StartBlock:
    line: int  #: Requested line.
    row: int  #: Row of ``Blocks`` with the first motion at or after that line.
    #: How often the line is executed, and the requested execution, counted from 1.
    passes: int
    which: int
    words: tuple[str, ...]  #: Modal state at that line, as the words that set it.


class StartLine:
    """Counts how often the start line is reached, and finds the row at which the run starts.

    ``line``: the start line, 0 for the top; ``which``: the execution of that line, 0 for the only
    one; ``row``: the row if already known.
    """

    def __init__(self, line: int, which: int, source: str, row: int | None = None):
        self.line, self._which, self.source = line, max(which, 1), source
        self._named = which > 0
        self.passes = 0
        self._words: tuple[str, ...] = ()
        self._row = row
        self._rows = 0  # that were seen

    def reach(self, words: Callable[[], tuple[str, ...]]) -> None:
        """Count an execution of the start line; ``words`` returns the modal state as words."""
        self.passes += 1
        if self.passes == self._which:
            self._words = words()

    def see(self, passes: FloatArray) -> None:
        if self._row is None and len(passes) and passes[-1] >= self._which:
            self._row = self._rows + int(np.searchsorted(passes, self._which))
        self._rows += len(passes)

    @property
    def row(self) -> int | None:
        """Row of the first motion after the start line, at least 1; None until it is read."""
        return None if self._row is None else max(self._row, 1)

    def found(self) -> StartBlock:
        count, which = self.passes, self._which
        if not count:
            raise self._fault('the program does not execute this line; start at another one')
        if which > count:
            raise self._fault(f'executed {count} times only; choose pass 1 to {count} (--pass)')
        if count > 1 and not self._named:
            raise self._fault(f'executed {count} times; choose pass 1 to {count} (--pass)')
        if self.row is None or self.row >= self._rows:
            raise self._fault('no motion follows this line; start before it')
        return StartBlock(self.line, self.row, count, which, self._words)

    def _fault(self, message: str) -> ProgramError:
        return ProgramError(message, self.source, self.line)
