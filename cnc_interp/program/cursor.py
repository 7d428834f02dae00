"""
Where the reader of a program is: its line, and the subprograms that called it.

Jumps backwards and calls are counted, so that a program without end is refused.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.core.errors import ProgramError
from cnc_interp.program.source import Place, Source
from cnc_interp.program.variables import ProgramVariables

_DEEPEST_CALL = 20
_SUBPROGRAM_SUFFIXES = ('.ngc', '.nc', '.tap', '.NC', '.TAP', '')


@dataclass
class Loop:
    """A loop that is running: its label, where it begins, the rounds it still has."""

    label: str
    begin: Place
    rounds: int = 0


@dataclass
class _Call:
    """A subprogram that is running: where its caller goes on, and how often it is repeated."""

    source: Source
    back: Place
    line: int
    begin: Place
    rounds: int
    own_variables: bool
    loops: list[Loop]


class Cursor:
    """
    A place in a program and its subprograms.

    Parameters
    ----------
    source : Source
        The program.
    variables : ProgramVariables
        For conditions and arguments.
    most_jumps : int
        Backward jumps after which the program counts as endless.

    """

    def __init__(self, source: Source, variables: ProgramVariables, most_jumps: int):
        self.main = self.source = source
        self.variables = variables
        self.ended = self.jumped = False
        self._jumps_left = self._most_jumps = most_jumps
        self._calls: list[_Call] = []
        self.loops: list[Loop] = []
        self.row, self.window, self._window_of = 0, source.window(source.start), source

    def go(self, place: Place) -> None:
        """Go on at a place of the present source."""
        row = self.window.row_of(place) if self._window_of is self.source else None
        if row is None:
            self.window, self._window_of, row = self.source.window(place), self.source, 0
        self.row, self.jumped = row, True

    def here(self) -> bool:
        """Load the next lines; False at the end of the program."""
        while not self.ended:
            if self.row < len(self.window):
                return True
            place = self.window.place(self.row)
            if len(self.window):
                self.go(place)
            elif self._calls:
                self.leave()
            else:
                self.ended = True
        return False

    @property
    def line_number(self) -> int:
        """Number of the present line in its file."""
        return self.window.start.line + self.row

    @property
    def main_line(self) -> int:
        """Number of the present line of the main program: the line of a call to another file."""
        for call in reversed(self._calls):
            if call.source is self.main and self.source is not self.main:
                return call.line
        return self.line_number

    @property
    def share(self) -> float:
        """Share of the main program's text that lies behind, 0 to 1."""
        for call in self._calls:
            if call.source is self.main:
                return self.main.share(call.back)
        return self.main.share(self.window.place(self.row))

    def fault(self, message: str, word: str = '') -> ProgramError:
        """Make an error that names file and line."""
        return ProgramError(message, self.source.name, self.line_number, word[:40])

    def close(self) -> None:
        """Close all files."""
        for call in self._calls:
            call.source.close()
        self.source.close()
        self.main.close()

    def back_or_on(self, place: Place) -> None:
        """Go to a place; jumps backwards are counted."""
        if place.offset <= self.window.place(self.row).offset:
            self._count_jump()
        self.go(place)

    def _count_jump(self) -> None:
        self._jumps_left -= 1
        if self._jumps_left < 0:
            raise self.fault(
                f'more than {self._most_jumps:,} loops or calls: this program does not end; '
                'correct its conditions'
            )

    def call(
        self,
        stem: str,
        pattern: bytes,
        rounds: int,
        arguments: dict[int, float],
        own_variables: bool,
    ) -> None:
        """Run a subprogram of this file, or of a file of its own beside it."""
        if rounds < 1:
            self.go(self.window.place(self.row + 1))
            return
        if len(self._calls) >= _DEEPEST_CALL:
            raise self.fault(f'calls are nested more than {_DEEPEST_CALL} deep', stem)
        self._count_jump()
        back, line = self.window.place(self.row + 1), self.line_number
        search = re.compile(rb'(?mi)^[ \t]*(?:N\s*\d+\s*)?' + pattern)
        source, begin = self.source, self.source.find(search, self.source.start)
        if begin is None:
            source = self._file_beside(stem)
            begin = source.find(search, source.start) or Place(0, 0)
        begin = source.after(begin) if begin.line else source.start
        self._calls.append(
            _Call(self.source, back, line, begin, rounds - 1, own_variables, self.loops)
        )
        self.loops = []
        if own_variables:
            self.variables.enter(arguments)
        self.source = source
        self.go(begin)

    def _file_beside(self, stem: str) -> Source:
        """Open a subprogram's own file."""
        folder = Path(self.main.name).parent
        for suffix in _SUBPROGRAM_SUFFIXES:
            path = folder / (stem + suffix)
            if re.fullmatch(r'[\w-]+', stem) and path.is_file():
                return Source.of_file(path)
        raise self.fault(
            f'the subprogram {stem} is neither in this file nor beside it; add it', stem
        )

    def leave(self) -> None:
        """Return from a subprogram, or run it once more."""
        call = self._calls[-1]
        if call.rounds > 0:
            call.rounds -= 1
            self._count_jump()
            self.loops = []
            self.go(call.begin)
            return
        self._calls.pop()
        if call.own_variables:
            self.variables.leave()
        if self.source is not call.source:
            self.source.close()
        self.source, self.loops = call.source, call.loops
        self.go(call.back)

    @property
    def in_subprogram(self) -> bool:
        """True inside a subprogram."""
        return bool(self._calls)
