"""Statements that change the order of lines, as each dialect writes them; and subprograms.

O words of LinuxCNC are ``o100 sub``, ``call``, ``while``, ``if``, ``do`` and ``repeat``. Fanuc
has M98, M99 and G65 with O numbers, WHILE/DO/END, IF/GOTO and IF/THEN. Siemens has IF ELSE, loops,
CASE, jumps, DEF with arrays, and calls by name. ``structures.py`` executes them.
"""

from __future__ import annotations

import re
from dataclasses import replace
from math import floor, inf

from cnc_interp.program.cursor import Structure
from cnc_interp.program.expressions import ExpressionError, evaluate, parse
from cnc_interp.program.files import subprogram_file
from cnc_interp.program.structures import BETWEEN, ENDS, HEADS, Structures
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
#: How Siemens writes the words of structures, and IF, which may be one line.
_NESTED = Structure(before=r'(?:[A-Z_][A-Z_]\w*\s*:(?!=)\s*)?', after=r'(?!\w|[ \t]*[=:\[])')
_NESTED_IF = replace(_NESTED, head=r'IF(?![^;\n]*(?<!\w)(?:GOTO|THEN))')
_KEYWORD = re.compile(
    r'(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|REPEAT|UNTIL|CASE|DEF|PROC|EXTERN|RET|'
    r'GOTOS)(?!\w|\s*[=:\[])\s*(.*)'
)
_CASE = re.compile(r'(.*?)(?<!\w)OF(?!\w)(.*)')
_BRANCH = re.compile(r'\s*(.*?)\s*(GOTO[FBC]?)\s+(\w+)')
_TYPE = re.compile(r'(REAL|INT|BOOL|CHAR|STRING\s*\[\s*\d+\s*\]|AXIS|FRAME)\s+(.*)')
_NAME = re.compile(r'\s*([A-Z_]\w*)\s*(?:\[([^\]]*)\])?\s*(?:=(.*))?')
_COMMAS = re.compile(r',(?![^(\[]*[)\]])(?![^"]*"(?:[^"]*"[^"]*")*[^"]*$)')
_CALL = re.compile(r'(?:CALL\s*"([^"]+)"|([A-Z_][A-Z_]\w*|L\d+))\s*(?:P\s*=?\s*(\d+))?')
_MOST_ELEMENTS = 10_000  #: More elements of an array are not set to 0 one by one.


class Flow(Structures):
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
            self.run_word(_numbered(match[2]), 'WHILE', match[1])
            return None
        if head == 'E' and (match := _END.fullmatch(line)):
            self.run_word(_numbered(match[1]), 'ENDWHILE', '')
            return None
        if head == 'G' and (match := _GOTO.fullmatch(line)):
            self.jump(match[1], match[2])
            return None
        named = line[1:2].isalpha() or line[1:2] == '_' or head == 'L'
        return None if named and self._siemens(line) else line

    def _values(self, text: str) -> list[float]:
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

    def _o_word(self, label: str, word: str, rest: str) -> None:
        self.has_o_words = True
        if label[0] in '[#':
            label = f'{self.condition(label):.0f}'
        number = label.lstrip('0') if label.isdigit() else ''
        before = r'O\s*' + ('0*' + number if number else re.escape(label)) + r'\s*'
        what = Structure(f'O{label}', before)
        if word == 'SUB':
            self._pass_sub(what)
        elif word == 'CALL':
            self._call_o_word(label, rest)
        elif word in ('ENDSUB', 'RETURN'):
            if not self.depth:
                raise self.fault('this subprogram was not called; move it after M2, or call it',
                                 f'O{label} {word}')  # fmt: skip
            value = self._values(rest)
            self.leave()
            self.returned = (value[0], 1.0) if value else (0.0, 0.0)
        elif word == 'ENDWHILE' and rest:
            raise self.fault('write O- ENDWHILE alone', rest)
        else:
            self.run_word(what, word, rest)

    def _pass_sub(self, what: Structure) -> None:
        """Go on after a subprogram, which may not contain another."""
        end = self.end_of('SUB', replace(what, end=r'END\s*SUB'))
        inner = self.source.find(_INNER_SUB, self.window.place(self.row + 1))
        if self.depth or (inner is not None and inner.offset < end.offset):
            raise self.fault('a subprogram within a subprogram; write one after the other',
                             f'{what.label} SUB')  # fmt: skip
        self.after(end)

    # --- words of Siemens ----------------------------------------------------------------------

    def _siemens(self, line: str) -> bool:
        if self._calls_by_name(line):
            return True
        match = _KEYWORD.fullmatch(line)
        if match is None or (match[1] in ('IF', 'CASE') and match[2] == ''):
            return False
        word, rest = match[1], match[2].strip()
        if word == 'REPEAT' and rest:
            raise self.fault('a section is repeated by a label; write REPEAT and UNTIL', word)
        if word in ('IF', *BETWEEN):
            self.run_word(_NESTED_IF, word, rest)
        elif word in ENDS or word in HEADS:
            self.run_word(_NESTED, word, rest)
        elif word == 'CASE':
            self._case(rest)
        elif word == 'DEF':
            self._define(rest)
        elif word == 'RET' and self.depth:
            self.leave()
        elif word == 'RET':
            self.ended = True
        elif word == 'GOTOS':
            self.loops.clear()
            self.back_or_on(self.source.start)
        return True

    def _case(self, rest: str) -> None:
        """Process CASE (value) OF 1 GOTOF A 2 GOTOF B DEFAULT GOTOF C."""
        match = _CASE.fullmatch(rest)
        if match is None:
            raise self.fault('write CASE (value) OF 1 GOTOF A DEFAULT GOTOF B', 'CASE')
        value = self.condition(match[1])
        for constant, way, target in _BRANCH.findall(match[2]):
            if constant == 'DEFAULT' or self.condition(constant) == value:
                self.jump(way[4:], target)
                return
        self.on()

    def _define(self, rest: str) -> None:
        """Process DEF REAL A=1, B[3]=SET(1,2,3): define variables."""
        match = _TYPE.fullmatch(rest)
        if match is None or match[1] in ('AXIS', 'FRAME'):
            raise self.fault('write DEF REAL NAME=VALUE; INT, BOOL, CHAR and STRING work, too',
                             'DEF')  # fmt: skip
        for part in _COMMAS.split(match[2]):
            found = _NAME.fullmatch(part)
            if found is None:
                raise self.fault('write DEF REAL NAME=VALUE', part.strip() or 'DEF')
            name, sizes, value = found.groups()
            if match[1].startswith('STRING') or (value or '').strip().startswith('"'):
                continue  # texts move nothing; a number that is read from one is not set
            if sizes is None:
                self.variables.set_name(name, self.condition(value) if value else 0.0)
            else:
                self._define_array(name, sizes, value)

    def _define_array(self, name: str, sizes: str, value: str | None) -> None:
        counts = [int(self.condition(size)) for size in sizes.split(',')]
        indices = ['']
        for count in counts:
            if not 0 < count * len(indices) <= _MOST_ELEMENTS:
                raise self.fault(f'an array of more than {_MOST_ELEMENTS} elements', name)
            indices = [f'{before},{i}' for before in indices for i in range(count)]
        given = re.fullmatch(r'\s*(?:SET)?\s*\((.*)\)\s*', value or '()')
        parts = _COMMAS.split(given[1] if given else value or '')
        values = [self.condition(text) for text in parts if text.strip()]
        if len(values) > len(indices):
            raise self.fault('more values than elements; correct the size', name)
        for index, number in zip(indices, values + [0.0] * len(indices), strict=False):
            self.variables.set_name(f'{name}[{index[1:]}]', number)

    def _calls_by_name(self, line: str) -> bool:
        match = _CALL.fullmatch(line)
        if match is None or (match[2] or '') in (*ENDS, *HEADS, *BETWEEN, 'RET', 'GOTOS'):
            return False
        name = (match[1] or match[2]).removeprefix('_N_').removesuffix('_SPF')
        folder = self.folder
        stem = next((s for s in (name, name.lower()) if subprogram_file(folder, s)), None)
        if stem is None:
            if match[1] or (name[0] == 'L' and name[1:].isdigit()):
                raise self.fault(f'the subprogram {name} is not in the folder of the program; '
                                 'add it', line)  # fmt: skip
            return False
        self.call_file(stem, int(match[3] or 1))
        return True

    # --- subprograms ---------------------------------------------------------------------------

    def _call_o_word(self, label: str, rest: str) -> None:
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


def _numbered(number: str) -> Structure:
    return Structure(f'DO{number}', '', r'(?!\d)', rf'WHILE.*DO\s*{number}', rf'END\s*{number}')
