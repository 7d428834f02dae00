"""
The order in which the lines of a program are read: jumps, loops, subprograms.

The common dialect: O words of LinuxCNC (``o100 sub``, ``call``, ``while``, ``if``, ``do``,
``repeat``), M98, M99 and G65 with O numbers, WHILE/DO/END, IF/GOTO and IF/THEN of Fanuc macro B,
GOTOF, GOTOB and IF of Siemens.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.errors import ProgramError
from cnc_interp.program.expressions import ExpressionError, evaluate, parse
from cnc_interp.program.source import Place, Source
from cnc_interp.program.variables import ProgramVariables

_DEEPEST_CALL = 20
_O_WORD = re.compile(
    r'O\s*(\d+|<[^<>]+>)\s*'
    r'(SUB|ENDSUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|'
    r'CONTINUE)(?![A-Z_])\s*(.*)'
)
_IF = re.compile(r'IF\s*(.*?)\s*(?<![A-Z_])(GOTO[FB]?|THEN)(?![A-Z_])\s*(.*)')
_WHILE = re.compile(r'WHILE\s*(.*?)\s*(?<![A-Z_])DO\s*(\d+)')
_END = re.compile(r'END\s*(\d+)')
_GOTO = re.compile(r'GOTO([FB]?)(?![A-Z_])\s*(.*)')
_LABEL = re.compile(r'([A-Z_][A-Z_]\w*)\s*:(?!=)\s*')
_DEFINITION = re.compile(r'DEF\s+(REAL|INT|BOOL)\s+(.*)')
_SUBPROGRAM_SUFFIXES = ('.ngc', '.nc', '.tap', '.NC', '.TAP', '')
#: Letters of G65 arguments -> local variables.
G65_ARGUMENTS = dict(
    zip('ABCIJKDEFHMQRSTUVWXYZ', (*range(1, 10), 11, 13, *range(17, 27)), strict=True)
)


@dataclass
class _Loop:
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
    loops: list[_Loop]


class Flow:
    """
    Where the reader is, and the statements that move it elsewhere.

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
        self._loops: list[_Loop] = []
        self.row, self.window, self._window_of = 0, source.window(source.start), source

    # --- reading -------------------------------------------------------------------------------

    def _go(self, place: Place) -> None:
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
                self._go(place)
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

    # --- statements ----------------------------------------------------------------------------

    def execute(self, line: str) -> str | None:
        """
        Carry out a line if it is a statement of flow.

        Parameters
        ----------
        line : str
            In upper case, without comments and line number.

        Returns
        -------
        str or None
            What of the line remains to be done (after a label or THEN); None if nothing.

        """
        head = line[0]
        if head == 'O':
            if match := _O_WORD.fullmatch(line):
                self._o_word(match[1], match[2], match[3])
                return None
        elif head == 'I' and line.startswith('IF'):
            return self._if(line)
        elif head == 'W' and (match := _WHILE.fullmatch(line)):
            self._while(f'DO{match[2]}', match[1], rb'END\s*' + match[2].encode() + rb'(?!\d)')
            return None
        elif head == 'E' and (match := _END.fullmatch(line)):
            self._again(f'DO{match[1]}', line)
            return None
        elif head == 'G' and (match := _GOTO.fullmatch(line)):
            self._jump(match[1], match[2])
            return None
        elif head == 'D' and (match := _DEFINITION.fullmatch(line)):
            self._define(match[2])
            return None
        if ':' in line and (match := _LABEL.match(line)):
            return line[match.end() :]
        return line

    def _define(self, names: str) -> None:
        """DEF REAL A=1, B."""
        for name in names.split(','):
            match = re.fullmatch(r'\s*([A-Z_]\w*)\s*(?:=(.*))?', name)
            if match is None:
                raise self.fault('write DEF REAL NAME=VALUE', name.strip() or 'DEF')
            self.variables.set_name(match[1], self._condition(match[2]) if match[2] else 0.0)

    def _condition(self, text: str) -> float:
        """Return the value of a condition."""
        try:
            (node,) = parse(text, 'condition')
            return evaluate(node, self.variables)
        except (ExpressionError, ValueError) as problem:
            raise self.fault(str(problem) or 'a condition is missing', text[:20]) from None

    def _values(self, text: str) -> list[float]:
        """Return the values of ``[...] [...]``."""
        try:
            return [evaluate(node, self.variables) for node in parse(text, 'values')]
        except ExpressionError as problem:
            raise self.fault(str(problem), text[:20]) from None

    def _if(self, line: str) -> str | None:
        """IF [...] GOTO n, IF [...] THEN ..., IF ... GOTOF label."""
        match = _IF.fullmatch(line)
        if match is None:
            raise self.fault('write IF [...] GOTO number, or IF [...] THEN #1=value', 'IF')
        if not self._condition(match[1]):
            return None
        if match[2] == 'THEN':
            return match[3] or None
        self._jump(match[2][4:], match[3])
        return None

    def _jump(self, way: str, target: str) -> None:
        """Go to a line number or label."""
        if re.fullmatch(r'[A-Z_][A-Z_]\w*', target):
            pattern = rb'(?mi)^[ \t]*(?:N\s*\d+\s*)?' + target.encode() + rb'[ \t]*:'
        else:
            value = self._condition(target.removeprefix('N'))
            if not 0 <= value < 1e9:
                raise self.fault('no line number', target)
            pattern = rb'(?mi)^[ \t/]*N[ \t]*0*%d(?!\d)' % round(value)
        search = re.compile(pattern)
        after = self.window.place(self.row + 1)
        place = self.source.find(search, after) if way != 'B' else None
        if place is None and way != 'F':
            place = self.source.find(search, self.source.start)
        if place is None or (way == 'B' and place.offset >= after.offset):
            raise self.fault('the line to jump to is not there', target or 'GOTO')
        self._loops.clear()
        self._back_or_on(place)

    def _back_or_on(self, place: Place) -> None:
        """Go to a place; jumps backwards are counted."""
        if place.offset <= self.window.place(self.row).offset:
            self._count_jump()
        self._go(place)

    def _count_jump(self) -> None:
        self._jumps_left -= 1
        if self._jumps_left < 0:
            raise self.fault(
                f'more than {self._most_jumps:,} loops or calls: this program does not end; '
                'correct its conditions'
            )

    def _skip(self, pattern: bytes, what: str) -> Place:
        """Return the line after the next one that matches."""
        place = self.source.find(
            re.compile(rb'(?mi)^[ \t/]*(?:N\s*\d+\s*)?' + pattern), self.window.place(self.row + 1)
        )
        if place is None:
            raise self.fault(f'{what} is missing', what)
        return place

    # --- loops ---------------------------------------------------------------------------------

    def _while(self, label: str, condition: str, end: bytes) -> None:
        """Enter a loop or leave it at its head."""
        place = self.window.place(self.row)
        if self._loops and self._loops[-1].label == label and self._loops[-1].begin != place:
            # The tail of O- DO.
            if self._condition(condition):
                self._back_or_on(self._loops[-1].begin)
            else:
                self._loops.pop()
                self._go(self.window.place(self.row + 1))
            return
        running = bool(self._loops) and self._loops[-1].begin == place
        if self._condition(condition):
            if not running:
                self._loops.append(_Loop(label, place))
            self._go(self.window.place(self.row + 1))
            return
        if running:
            self._loops.pop()
        self._go(self.source.after(self._skip(end, f'the end of {label}')))

    def _again(self, label: str, word: str) -> None:
        """At the end of a loop go back to its head."""
        while self._loops and self._loops[-1].label != label:
            self._loops.pop()
        if not self._loops:
            raise self.fault('this loop was not begun', word)
        self._back_or_on(self._loops[-1].begin)

    def _o_word(self, label: str, word: str, rest: str) -> None:
        """Carry out an O word of LinuxCNC."""
        name = rb'O\s*' + re.escape(label.encode()) + rb'\s*'
        following = self.window.place(self.row + 1)
        if word == 'SUB':
            self._go(self.source.after(self._skip(name + b'ENDSUB', f'O{label} ENDSUB')))
        elif word == 'CALL':
            self._call_o_word(label, rest)
        elif word in ('ENDSUB', 'RETURN'):
            if not self._calls:
                raise self.fault('this subprogram was not called', f'O{label} {word}')
            self.leave()
        elif word == 'WHILE':
            self._while(label, rest, name + b'ENDWHILE')
        elif word in ('ENDWHILE', 'CONTINUE'):
            if word == 'ENDWHILE' and rest:
                raise self.fault('write O- ENDWHILE alone', rest)
            self._again(label, f'O{label} {word}')
        elif word == 'DO':
            self._loops.append(_Loop(label, following))
            self._go(following)
        elif word == 'REPEAT':
            self._repeat(label, rest, name)
        elif word == 'ENDREPEAT':
            self._end_repeat(label)
        elif word == 'BREAK':
            while self._loops and self._loops.pop().label != label:
                pass
            end = self._skip(name + rb'(?:ENDWHILE|ENDREPEAT|WHILE)', f'the end of O{label}')
            self._go(self.source.after(end))
        else:
            self._o_if(label, word, rest, name)

    def _repeat(self, label: str, rest: str, name: bytes) -> None:
        (count, *_) = self._values(rest) or [0.0]
        if count >= 1.0:
            self._loops.append(_Loop(label, self.window.place(self.row + 1), round(count) - 1))
            self._go(self.window.place(self.row + 1))
        else:
            self._go(self.source.after(self._skip(name + b'ENDREPEAT', f'O{label} ENDREPEAT')))

    def _end_repeat(self, label: str) -> None:
        while self._loops and self._loops[-1].label != label:
            self._loops.pop()
        if not self._loops:
            raise self.fault('this loop was not begun', f'O{label} ENDREPEAT')
        loop = self._loops[-1]
        if loop.rounds > 0:
            loop.rounds -= 1
            self._back_or_on(loop.begin)
        else:
            self._loops.pop()
            self._go(self.window.place(self.row + 1))

    def _o_if(self, label: str, word: str, rest: str, name: bytes) -> None:
        """Enter the branch of an IF whose condition holds, or leave at the end of a branch."""
        if word == 'ENDIF':
            self._go(self.window.place(self.row + 1))
            return
        if word in ('ELSE', 'ELSEIF'):  # the branch before has been executed
            end = self._skip(name + b'ENDIF', f'O{label} ENDIF')
            self._go(self.source.after(end))
            return
        holds = bool(self._condition(rest))
        place = self.window.place(self.row)
        while not holds:
            self._go(place)
            place = self._skip(name + rb'(?:ELSEIF|ELSE|ENDIF)', f'O{label} ENDIF')
            self._go(place)
            line = self.window.line(self.row).upper()
            match = re.search(r'(ELSEIF|ELSE|ENDIF)(?![A-Z_])\s*([^;(]*)', line)
            holds = match is None or match[1] != 'ELSEIF' or bool(self._condition(match[2]))
        self._go(self.window.place(self.row + 1))

    # --- subprograms ---------------------------------------------------------------------------

    def _call_o_word(self, label: str, rest: str) -> None:
        if label.startswith('<'):
            pattern, stem = re.escape(label.encode()), label[1:-1].lower()
        else:
            pattern, stem = rb'0*%d' % int(label), label
        values = dict(enumerate(self._values(rest), start=1))
        pattern = rb'O\s*' + pattern + rb'\s*SUB(?![A-Z])'
        self.call(stem, pattern, 1, values, own_variables=True)

    def call_number(
        self, number: int, rounds: int, arguments: dict[int, float] | None = None
    ) -> None:
        """M98 and G65: run the subprogram that begins with an O number."""
        pattern = rb'[O:]\s*0*%d(?!\d)' % number
        self.call(f'O{number:04d}', pattern, rounds, arguments or {}, arguments is not None)

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
            self._go(self.window.place(self.row + 1))
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
            _Call(self.source, back, line, begin, rounds - 1, own_variables, self._loops)
        )
        self._loops = []
        if own_variables:
            self.variables.enter(arguments)
        self.source = source
        self._go(begin)

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
            self._loops = []
            self._go(call.begin)
            return
        self._calls.pop()
        if call.own_variables:
            self.variables.leave()
        if self.source is not call.source:
            self.source.close()
        self.source, self._loops = call.source, call.loops
        self._go(call.back)

    @property
    def in_subprogram(self) -> bool:
        """True inside a subprogram."""
        return bool(self._calls)
