"""Statements that change the order of lines: jumps, loops, subprograms.

O words of LinuxCNC are ``o100 sub``, ``call``, ``while``, ``if``, ``do`` and ``repeat``. Fanuc
has M98, M99 and G65 with O numbers, WHILE/DO/END, IF/GOTO and IF/THEN. ``siemens_flow.py`` has the
words of Siemens.
"""

from __future__ import annotations

import re
from math import floor, inf

from cnc_interp.program.cursor import Loop
from cnc_interp.program.expressions import ExpressionError, evaluate, parse
from cnc_interp.program.siemens_flow import SiemensFlow
from cnc_interp.program.source import LineStart
from cnc_interp.program.words import BlockWords

# One line may have 65,536 characters. So no two neighbours of a pattern match the same spaces.
_O_WORD = re.compile(
    r'O\s*(\d+|<[^<>]+>|\[.*?\]|#+(?:\d+|<[^<>]+>|\[.*?\]))\s*'
    r'(SUB|END\s*SUB|CALL|RETURN|IF|ELSEIF|ELSE|ENDIF|WHILE|ENDWHILE|DO|REPEAT|ENDREPEAT|BREAK|'
    r'CONTINUE)(?![A-Z_])\s*(.*)'
)
_IF = re.compile(r'IF(.*?)(?<![A-Z_])(GOTO[FBC]?|THEN)(?![A-Z_])\s*(.*)')
_WHILE = re.compile(r'WHILE(.*?)(?<![A-Z_])DO\s*(\d+)\s*(.*)')
_END = re.compile(r'END\s*(\d+)')
_GOTO = re.compile(r'GOTO([FBC]?)(?![A-Z_])\s*(.*)')
_LABEL = re.compile(r'([A-Z_][A-Z_]\w*)\s*:(?!=)\s*')
_INNER_SUB = re.compile(rb'(?mi)^[ \t/]*(?:N\s*\d+\s*)?O\s*(?:\d+|<[^<>]+>)\s*SUB(?![A-Z_])')
#: Letters of G65 arguments and the local variables that they set.
G65_ARGUMENTS = dict(
    zip('ABCIJKDEFHMQRSTUVWXYZ', (*range(1, 10), 11, 13, *range(17, 27)), strict=True)
)


class Flow(SiemensFlow):
    """A cursor that executes the statements which move it."""

    # --- statements ----------------------------------------------------------------------------

    def execute(self, line: str) -> str | None:
        """Execute a flow statement; return what is left of the line after a label or THEN."""
        if ':' in line and (match := _LABEL.match(line)):
            line = line[match.end() :]
            if not line:
                return None
        head = line[0]
        if head == 'O' and (match := _O_WORD.fullmatch(line)):
            self._o_word(match[1], ''.join(match[2].split()), match[3])
            return None
        if head == 'I' and (match := _IF.fullmatch(line)):
            return self._if(match)
        if head == 'W' and (match := _WHILE.fullmatch(line)):
            if match[3]:
                raise self.fault(f'nothing may follow DO{match[2]}; write it into the next line',
                                 match[3])  # fmt: skip
            self._while(f'DO{match[2]}', match[1], rb'END\s*' + match[2].encode() + rb'(?!\d)')
            return None
        if head == 'E' and (match := _END.fullmatch(line)):
            self.back_or_on(self.loop_of(f'DO{match[1]}', line).begin)
            return None
        if head == 'G' and (match := _GOTO.fullmatch(line)):
            self.jump(match[1], match[2])
            return None
        named = line[1:2].isalpha() or line[1:2] == '_' or head == 'L'
        return None if named and self.siemens(line) else line

    def _values(self, text: str) -> list[float]:
        """Return the values of ``[...] [...]``."""
        try:
            return [evaluate(node, self.variables) for node in parse(text, 'values')]
        except ExpressionError as problem:
            raise self.fault(str(problem), text[:20]) from None

    def _if(self, match: re.Match[str]) -> str | None:
        """Process IF [...] GOTO n, IF [...] THEN ... and IF ... GOTOF label."""
        if not self.condition(match[1]):
            return None
        if match[2] == 'THEN':
            return match[3] or None
        self.jump(match[2][4:], match[3])
        return None

    def _skip(self, pattern: bytes, what: str) -> LineStart:
        """Return the place of the next line that matches; raise if there is none."""
        place = self.source.find(
            re.compile(rb'(?mi)^[ \t/]*(?:N\s*\d+\s*)?' + pattern), self.window.place(self.row + 1)
        )
        if place is None:
            raise self.fault(f'{what} is missing; add it', what)
        return place

    # --- loops ---------------------------------------------------------------------------------

    def _while(self, label: str, condition: str, end: bytes) -> None:
        """Enter a loop, or leave it if its condition is false."""
        place = self.window.place(self.row)
        if self.loops and self.loops[-1].label == label and self.loops[-1].begin != place:
            # This is the closing WHILE of O- DO.
            if self.condition(condition):
                self.back_or_on(self.loops[-1].begin)
            else:
                self.loops.pop()
                self.on()
            return
        running = bool(self.loops) and self.loops[-1].begin == place
        if self.condition(condition):
            if not running:
                self.loops.append(Loop(label, place))
            self.on()
            return
        if running:
            self.loops.pop()
        self.after(self._skip(end, f'the end of {label}'))

    def _o_word(self, label: str, word: str, rest: str) -> None:
        """Execute an O word of LinuxCNC."""
        self.has_o_words = True
        if label[0] in '[#':
            label = f'{self.condition(label):.0f}'
        number = label.lstrip('0') if label.isdigit() else ''
        name = rb'O\s*' + (b'0*' + number.encode() if number else re.escape(label.encode()))
        name += rb'\s*'
        shown = f'O{label} {word}'
        if word == 'SUB':
            self._pass_sub(name, label)
        elif word == 'CALL':
            self._call_o_word(label, rest)
        elif word in ('ENDSUB', 'RETURN'):
            if not self.depth:
                raise self.fault(
                    'this subprogram was not called; move it after M2, or call it', shown
                )
            value = self._values(rest)
            self.leave()
            self.returned = (value[0], 1.0) if value else (0.0, 0.0)
        elif word == 'WHILE':
            self._while(label, rest, name + b'ENDWHILE')
        elif word == 'ENDWHILE':
            if rest:
                raise self.fault('write O- ENDWHILE alone', rest)
            self.back_or_on(self.loop_of(label, shown).begin)
        elif word == 'DO':
            self.on()
            self.loops.append(Loop(label, self.window.place(self.row)))
        elif word == 'REPEAT':
            self._repeat(label, rest, name)
        elif word == 'ENDREPEAT':
            self._end_repeat(label)
        elif word in ('BREAK', 'CONTINUE'):
            self._break_or_continue(label, word, name)
        else:
            self._o_if(label, word, rest, name)

    def _pass_sub(self, name: bytes, label: str) -> None:
        """Go on after a subprogram, which may not contain another."""
        end = self._skip(name + rb'END\s*SUB', f'O{label} ENDSUB')
        inner = self.source.find(_INNER_SUB, self.window.place(self.row + 1))
        if self.depth or (inner is not None and inner.offset < end.offset):
            raise self.fault('a subprogram within a subprogram; write one after the other',
                             f'O{label} SUB')  # fmt: skip
        self.after(end)

    def _break_or_continue(self, label: str, word: str, name: bytes) -> None:
        """Process BREAK, and CONTINUE: the next round begins, if there is one."""
        self.loop_of(label, f'O{label} {word}')
        ends = rb'(?:ENDWHILE|ENDREPEAT|WHILE)(?![A-Z_])'
        end = self._skip(name + ends, f'the end of O{label}')
        if word == 'CONTINUE':
            self.go(end)
        else:
            self.loops.pop()
            self.after(end)

    def _repeat(self, label: str, rest: str, name: bytes) -> None:
        """Enter a REPEAT loop with its number of rounds, or skip it."""
        (count, *_) = self._values(rest) or [0.0]
        if count >= 1.0:
            self.loops.append(Loop(label, self.window.place(self.row + 1), round(count) - 1))
            self.on()
        else:
            self.after(self._skip(name + b'ENDREPEAT', f'O{label} ENDREPEAT'))

    def _end_repeat(self, label: str) -> None:
        """Process ENDREPEAT: begin the next round, or leave the loop."""
        loop = self.loop_of(label, f'O{label} ENDREPEAT')
        if loop.rounds > 0:
            loop.rounds -= 1
            self.back_or_on(loop.begin)
        else:
            self.loops.pop()
            self.on()

    def _o_if(self, label: str, word: str, rest: str, name: bytes) -> None:
        """Enter the branch of an IF whose condition is true; at its end, leave the IF."""
        if word == 'ENDIF':
            self.on()
            return
        if word in ('ELSE', 'ELSEIF'):  # the end of the branch that was executed
            self.after(self._skip(name + b'ENDIF', f'O{label} ENDIF'))
            return
        holds = bool(self.condition(rest))
        place = self.window.place(self.row)
        while not holds:
            self.go(place)
            place = self._skip(name + rb'(?:ELSEIF|ELSE|ENDIF)', f'O{label} ENDIF')
            self.go(place)
            line = self.window.line(self.row).upper()
            match = re.search(r'(ELSEIF|ELSE|ENDIF)(?![A-Z_])\s*([^;(]*)', line)
            holds = match is None or match[1] != 'ELSEIF' or bool(self.condition(match[2]))
        self.on()

    # --- subprograms ---------------------------------------------------------------------------

    def _call_o_word(self, label: str, rest: str) -> None:
        """Call a subprogram of LinuxCNC with positional arguments."""
        if label.startswith('<'):
            pattern, stem = re.escape(label.encode()), label[1:-1].lower().replace(' ', '')
        else:
            pattern, stem = rb'0*%d' % int(label), label
        values = dict(enumerate(self._values(rest), start=1))
        pattern = rb'O\s*' + pattern + rb'\s*SUB(?![A-Z])'
        self.call(stem, pattern, 1, values, own_variables=True)

    def call_number(
        self, number: int, rounds: int, arguments: dict[int, float] | None = None
    ) -> None:
        """Process M98 and G65: run the subprogram that begins with an O number."""
        pattern = rb'[O:]\s*0*%d(?!\d)' % number
        by_value = arguments is not None
        self.call(f'O{number:04d}', pattern, rounds, arguments or {}, by_value, vacant=True)

    def call_of(self, words: BlockWords) -> tuple[int, int, dict[int, float] | None] | None:
        """Return number, rounds and arguments of a subprogram call (M98 P, G65 P), or None."""
        values = words.values
        if 'G65' not in words.g and 'M98' not in words.m:
            return None
        word = 'G65' if 'G65' in words.g else 'M98'
        number, rounds = values.pop('P', inf), values.pop('L', None)
        if not 0 <= number < 1e8 or number != floor(number):
            raise self.fault('the number of the subprogram is missing; write P1000', word)
        if rounds is None:  # Fanuc: P21000 calls O1000 twice
            rounds, number = divmod(number, 10000) if number > 9999 else (1, number)
        if not 0 <= rounds <= 9999:
            raise self.fault('a subprogram is repeated 0 to 9999 times', f'L{rounds:g}')
        arguments = None
        if word == 'G65':
            arguments = {
                G65_ARGUMENTS[letter]: values.pop(letter)
                for letter in list(values)
                if letter in G65_ARGUMENTS
            }
        return int(number), int(max(rounds, 1) if word == 'G65' else rounds), arguments
