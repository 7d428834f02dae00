"""The position of the reader in a program: its line, and the active subprogram calls."""

import re
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from cnc_interp.core import DependsOn, InterpError, ProgramError
from cnc_interp.core.small_files import config_directory
from cnc_interp.program.text.expressions import ProgramVariables
from cnc_interp.program.text.source import LineStart, Source, subprogram_file

_DEEPEST_CALL = 20
_PERCENT = re.compile(rb'(?m)^[ \t]*%')
_HEAD = rb'(?mi)^[ \t]*(?:N\s*\d+\s*)?'


@dataclass(frozen=True)
class Structure:
    """The words of a control structure in a dialect, with patterns of the text around them."""

    label: str = ''  #: Identifier, as the number of an O word; empty if structures nest.
    before: str = ''
    after: str = r'(?![A-Z_])'
    #: Patterns of its first and last word, if they differ from ``flow.py``.
    head: str = ''
    end: str = ''


@dataclass
class Loop:
    label: str
    begin: LineStart  #: The line of its head.
    rounds: int = 0  #: Remaining rounds, including the present one.
    word: str = ''  #: Its first word, and the form of its words.
    what: Structure | None = None


@dataclass
class _Call:
    source: Source
    back: LineStart
    line: int
    begin: LineStart
    rounds: int
    own_variables: bool
    loops: list[Loop]
    #: State saved by M70 or M73, and whether the end of the subprogram restores it.
    saved: Any = None
    restores: bool = False
    rest: Any = None  #: Words of the calling line that are executed after a macro of M6.


class Cursor:
    def __init__(self, source: Source, variables: ProgramVariables, most_jumps: int):
        self.main = self.source = source
        self.folder = Path(source.name).parent
        self.variables = variables
        self.ended = self.jumped = False
        self._jumps, self._most_jumps = 0, most_jumps
        self._seen: tuple[Any, tuple[Any, ...]] = None, ()  # control and variables at a jump
        self._calls: list[_Call] = []
        self.loops: list[Loop] = []
        self.saved: Any = None  # what M70 saved in the main program
        self.ran_out = False  # whether the text ended before the program did
        self.restoring: Any = None  # what the last subprogram saved by M73
        self.rest: Any = None  # words that follow the macro of M6 that has ended
        self.has_o_words = False  # whether a flow word of LinuxCNC was executed
        self.continued = False  # whether CONTINUE was executed in a DO loop of LinuxCNC
        self.returned = 0.0, 0.0  # the value of the last O- RETURN, and whether it gave one
        self.row, self.window, self._window_of = 0, source.window(source.start), source

    def go(self, place: LineStart) -> None:
        row = self.window.row_of(place) if self._window_of is self.source else None
        if row is None:
            self.window, self._window_of, row = self.source.window(place), self.source, 0
        self.row, self.jumped = row, True

    def here(self) -> bool:
        while not self.ended:
            if self.row < len(self.window):
                return True
            place = self.window.place(self.row)
            if len(self.window):
                self.go(place)
            elif self._calls:
                self.leave()
            else:
                self.ended = self.ran_out = True
        return False

    @property
    def line_number(self) -> int:
        return self.window.start.line + self.row

    @property
    def main_line(self) -> int:
        for call in reversed(self._calls):
            if call.source is self.main and self.source is not self.main:
                return call.line
        return self.line_number

    @property
    def share(self) -> float:
        for call in self._calls:
            if call.source is self.main:
                return self.main.share(call.back)
        return self.main.share(self.window.place(self.row))

    def fault(
        self, message: str, word: str = '', depends_on: DependsOn = DependsOn.STATE
    ) -> ProgramError:
        line = self.line_number
        return ProgramError(message, self.source.name, line, word[:40], depends_on)

    def demand(
        self, holds: object, message: str, word: str = '', depends_on: DependsOn = DependsOn.STATE
    ) -> None:
        """Reject the line unless a condition holds."""
        if not holds:
            raise self.fault(message, word, depends_on)

    def refuse_if(
        self, fails: object, message: str, word: str = '', depends_on: DependsOn = DependsOn.STATE
    ) -> None:
        self.demand(not fails, message, word, depends_on)

    def close(self) -> None:
        for call in self._calls:
            call.source.close()
        self.source.close()
        self.main.close()

    def back_or_on(self, place: LineStart) -> None:
        if place.offset <= self.window.place(self.row).offset:
            self._count_jump()
        self.go(place)

    def _count_jump(self) -> None:
        self._jumps += 1
        control = (
            self.source.name,
            self.line_number,
            [(loop.begin, loop.rounds) for loop in self.loops],
            [(call.line, call.rounds) for call in self._calls],
        )
        # Brent's search for a cycle: a program that returns to an earlier state never ends.
        if control == self._seen[0] and self.variables.stands_as(self._seen[1]):
            why = 'this loop does not end, because nothing changes in it'
            raise self.fault(f'{why}; correct its condition')
        if self._jumps & (self._jumps - 1) == 0:
            self._seen = control, self.variables.state()
        if self._jumps > self._most_jumps:
            why = f'more than {self._most_jumps:,} loops or calls: this program does not end'
            raise self.fault(f'{why}; correct its conditions')

    def call(
        self,
        stem: str,
        pattern: bytes,
        rounds: int,
        arguments: dict[int, float],
        own_variables: bool,
        vacant: bool = False,
    ) -> None:
        if rounds < 1:
            self.go(self.window.place(self.row + 1))
            return
        self.demand(
            len(self._calls) < _DEEPEST_CALL,
            f'calls are nested more than {_DEEPEST_CALL} deep; use fewer levels',
            stem,
        )
        self._count_jump()
        back = self.window.place(self.row + 1)
        search = re.compile(_HEAD + pattern)
        source, begin = self.source, self.source.find(search, self.source.start)
        if begin is None or begin.offset > self._last_percent(source):
            source = self._file_beside(stem)
            begin = source.find(search, source.start)
        if own_variables:
            self.variables.enter(arguments, vacant=vacant)
        self._go_into(source, begin, back, rounds - 1, own_variables)

    def _go_into(
        self,
        source: Source,
        begin: LineStart | None,
        back: LineStart,
        rounds: int,
        own_variables: bool,
        rest: Any = None,
    ) -> None:
        begin = source.after(begin) if begin else source.start
        at = self.source, back, self.line_number
        self._calls.append(_Call(*at, begin, rounds, own_variables, self.loops, rest=rest))
        self.loops, self.source = [], source
        self.go(begin)

    def call_macro(self, text: str, name: str, rest: Any, state: Any) -> None:
        """Call a macro within a line with the other words ``rest``; its end restores ``state``."""
        source = Source.of_text(text, name)
        begin = source.find(re.compile(_HEAD + rb'O\s*(?:\d+|<[^<>]+>)\s*SUB'), source.start)
        self.variables.enter({}, vacant=False)
        self._go_into(source, begin, self.window.place(self.row), 0, True, rest)
        self.save(state, restores=True)

    @property
    def in_macro(self) -> bool:
        return any(call.rest is not None for call in self._calls)

    def _last_percent(self, source: Source) -> float:
        first = source.find(_PERCENT, source.start)
        second = first and source.find(_PERCENT, source.after(first))
        return inf if second is None else second.offset

    def save(self, state: Any, restores: bool) -> None:
        if not self._calls:
            self.saved = state
        else:
            self._calls[-1].saved, self._calls[-1].restores = state, restores

    @property
    def saved_state(self) -> Any:
        return self._calls[-1].saved if self._calls else self.saved

    def call_file(self, stem: str, rounds: int) -> None:
        self.call(stem, rb'(?!)', rounds, {}, own_variables=False)

    def _file_beside(self, stem: str) -> Source:
        path = subprogram_file(self.folder, stem)
        if path is None and (own := subprogram_file(config_directory() / 'subprograms', stem)):
            return Source.of_file(own)
        if path is None:
            raise self.fault(
                f'the subprogram {stem} is not in this file or its folder; add it', stem
            )
        try:
            return Source.of_file(path, self.main.folders)
        except InterpError as problem:
            raise self.fault(f'the subprogram {stem}: {problem}', stem) from None

    def leave(self) -> None:
        call = self._calls[-1]
        if call.rounds > 0:
            call.rounds -= 1
            self._count_jump()
            self.loops = []
            self.go(call.begin)
            return
        self._calls.pop()
        self.rest = call.rest
        if call.restores:
            self.restoring = call.saved
        if call.own_variables:
            self.variables.leave()
        if self.source is not call.source:
            self.source.close()
        self.source, self.loops = call.source, call.loops
        self.go(call.back)

    @property
    def depth(self) -> int:
        return len(self._calls)
