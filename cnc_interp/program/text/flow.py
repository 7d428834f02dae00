"""Subprograms, and the statements of all dialects that change the order of lines.

All structures are executed in the same way: a loop returns to its head and may begin a new round.
"""

import re
from dataclasses import replace
from math import floor, inf

from cnc_interp.program.text.cursor import Cursor, Loop, Structure
from cnc_interp.program.text.expressions import MOST_LOCAL, ExpressionError, evaluate, parse
from cnc_interp.program.text.source import LineStart, subprogram_file
from cnc_interp.program.text.words import BlockWords

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
#: Form of the structure words of Siemens, and of IF, which may fit on one line.
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
_AXIS_NAME = re.compile(r'(?<![\w"])[XYZABCUVW](?![\w"])')
_MOST_ELEMENTS = 10_000  #: Largest number of array elements that are set to 0 one by one.
#: The last word of each structure by its first one, and the reverse. WHILE also ends DO.
ENDS = {
    'IF': 'ENDIF',
    'WHILE': 'ENDWHILE',
    'FOR': 'ENDFOR',
    'LOOP': 'ENDLOOP',
    'DO': 'WHILE',
    'REPEAT': '(?:UNTIL|ENDREPEAT)',
}
HEADS = {
    'ENDWHILE': 'WHILE',
    'ENDFOR': 'FOR',
    'ENDLOOP': 'LOOP',
    'UNTIL': 'REPEAT',
    'ENDREPEAT': 'REPEAT',
}
BETWEEN = {'ELSEIF', 'ELSE', 'ENDIF'}  #: Words of IF after its head.
_NUMBER = r'[ \t/]*(?:N\s*\d+\s*)?'
_FOR = re.compile(r'(\w+)\s*=(.*?)(?<!\w)TO(?!\w)(.*)')
_BRANCH_WORD = re.compile(r'(ELSEIF|ELSE|ENDIF)(?![A-Z_])\s*([^;(]*)')

#: A subprogram call: number, repetitions, and the arguments of G65 (None for M98).
Call = tuple[int, int, dict[int, float] | None]


class Flow(Cursor):
    def execute(self, line: str) -> str | None:
        """Execute a flow statement; return the rest of the line after a label or THEN."""
        if ':' in line and (match := _LABEL.match(line)):
            line = line[match.end() :]
            if not line:
                return None
        head = line[0]
        if head == 'O' and (match := _O_WORD.fullmatch(line)):
            self._o_word(match[1], ''.join(match[2].split()), match[3])
            return None
        if head == 'I' and (match := _IF.fullmatch(line)):
            holds = self.condition(match[1])
            if holds and match[2] == 'THEN':
                return match[3] or None
            if holds:
                self.jump(match[2][4:], match[3])
            return None
        if head == 'W' and (match := _WHILE.fullmatch(line)):
            self.demand(
                not match[3],
                f'nothing may follow DO{match[2]}; write it into the next line',
                match[3],
            )
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
            self.demand(
                self.depth,
                'this subprogram was not called; move it after M2, or call it',
                f'O{label} {word}',
            )
            value = self._values(rest, 'values')
            self.leave()
            self.returned = (value[0], 1.0) if value else (0.0, 0.0)
        elif word == 'ENDWHILE' and rest:
            raise self.fault('write O- ENDWHILE alone', rest)
        else:
            self.run_word(what, word, rest)

    def _pass_sub(self, what: Structure) -> None:
        end = self.end_of('SUB', replace(what, end=r'END\s*SUB'))
        inner = self.source.find(_INNER_SUB, self.window.place(self.row + 1))
        if self.depth or (inner is not None and inner.offset < end.offset):
            raise self.fault(
                'a subprogram within a subprogram; write one after the other', f'{what.label} SUB'
            )
        self.after(end)

    def _siemens(self, line: str) -> bool:
        if self._calls_by_name(line):
            return True
        match = _KEYWORD.fullmatch(line)
        if match is None or (match[1] in ('IF', 'CASE') and match[2] == ''):
            return False
        word, rest = match[1], match[2].strip()
        self.refuse_if(
            word == 'REPEAT' and rest,
            'a section is repeated by a label; write REPEAT and UNTIL',
            word,
        )
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
        match = _TYPE.fullmatch(rest)
        if match is None or match[1] == 'FRAME':
            raise self.fault(
                'write DEF REAL NAME=VALUE; INT, BOOL, CHAR, STRING and AXIS work, too', 'DEF'
            )
        for part in _COMMAS.split(match[2]):
            found = _NAME.fullmatch(part)
            if found is None:
                raise self.fault('write DEF REAL NAME=VALUE', part.strip() or 'DEF')
            name, sizes, value = found.groups()
            if match[1] == 'AXIS' and value:
                value = _AXIS_NAME.sub(r'"\g<0>"', value)
            if sizes is None:
                self.variables.set_name(name, self.condition(value) if value else 0.0)
            else:
                self._define_array(name, sizes, value)

    def _define_array(self, name: str, sizes: str, value: str | None) -> None:
        counts = [int(self.condition(size)) for size in sizes.split(',')]
        indices = ['']
        for count in counts:
            self.demand(
                0 < count * len(indices) <= _MOST_ELEMENTS,
                f'an array of more than {_MOST_ELEMENTS} elements; make it smaller',
                name,
            )
            indices = [f'{before},{i}' for before in indices for i in range(count)]
        given = re.fullmatch(r'\s*(SET|REP)?\s*\((.*)\)\s*', value or '()')
        parts = _COMMAS.split(given[2] if given else value or '')
        values = [self.condition(text) for text in parts if text.strip()]
        if given and given[1] == 'REP':
            values = values[:1] * len(indices)
        self.demand(
            len(values) <= len(indices),
            'more values than the array has elements; correct its size',
            name,
        )
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
            self.refuse_if(
                match[1] or (name[0] == 'L' and name[1:].isdigit()),
                f'the subprogram {name} is not in the folder of the program; add it',
                line,
            )
            return False
        self.call_file(stem, int(match[3] or 1))
        return True

    def _call_o_word(self, label: str, rest: str) -> None:
        if label.startswith('<'):
            pattern, stem = re.escape(label.encode()), label[1:-1].lower().replace(' ', '')
        else:
            pattern, stem = rb'0*%d' % int(label), label
        values = dict(enumerate(self._values(rest, 'values'), start=1))
        pattern = rb'O\s*' + pattern + rb'\s*SUB(?![A-Z])'
        self.call(stem, pattern, 1, values, own_variables=True)

    def call_number(
        self, number: int, rounds: int, arguments: dict[int, float] | None = None
    ) -> None:
        pattern = rb'[O:]\s*0*%d(?!\d)' % number
        by_value = arguments is not None
        self.call(f'O{number:04d}', pattern, rounds, arguments or {}, by_value, vacant=True)

    def call_of(self, words: BlockWords) -> Call | None:
        """Return number, rounds and arguments of a subprogram call (M98 P, G65 P), or None."""
        values = words.values
        if 'G65' not in words.g and 'M98' not in words.m:
            return None
        word = 'G65' if 'G65' in words.g else 'M98'
        number, rounds = values.pop('P', inf), values.pop('L', None)
        whole = 0 <= number < 1e8 and number == floor(number)
        self.demand(whole, 'the number of the subprogram is missing; write P1000', word)
        if rounds is None:  # Fanuc: P21000 calls O1000 twice
            rounds, number = divmod(number, 10000) if number > 9999 else (1, number)
        self.demand(
            0 <= rounds <= 9999, 'a subprogram is repeated 0 to 9999 times', f'L{rounds:g}'
        )
        arguments = None
        if word == 'G65':
            arguments = self._arguments_of(words)
        return int(number), int(max(rounds, 1) if word == 'G65' else rounds), arguments

    def _arguments_of(self, words: BlockWords) -> dict[int, float]:
        """Return the arguments of G65 by variable; repeated I J K become #7 #8 #9, and so on."""
        given = [letter for letter in words.values if letter in G65_ARGUMENTS]
        found = {G65_ARGUMENTS[letter]: words.values.pop(letter) for letter in given}
        later, before = 0, ''
        for letter, value in words.arguments:
            if letter not in G65_ARGUMENTS:
                continue
            if letter in 'IJK':
                later += 3 * bool(before and letter <= before)
                before = letter
            number = G65_ARGUMENTS[letter] + later * (letter in 'IJK')
            self.demand(
                number <= MOST_LOCAL, 'more than ten sets of I J K; pass fewer arguments', letter
            )
            found[number] = value
        return found

    def condition(self, text: str) -> float:
        return self._values(text, 'condition')[0]

    def _values(self, text: str, kind: str) -> list[float]:
        try:
            return [evaluate(node, self.variables) for node in parse(text, kind)]
        except ExpressionError as problem:
            raise self.fault(str(problem), text[:20]) from None

    def on(self) -> None:
        self.go(self.window.place(self.row + 1))

    def after(self, place: LineStart) -> None:
        self.go(self.source.after(place))

    def run_word(self, what: Structure, word: str, rest: str) -> None:
        loop = self.loops[-1] if self.loops else None
        ends_do = word == 'WHILE' and loop and loop.what == what and loop.word == 'DO'
        if word == 'IF':
            self._choose_branch(what, rest)
        elif word == 'ENDIF':
            self.on()
        elif word in BETWEEN:  # the end of the branch that was executed
            self.after(self.end_of('IF', what))
        elif word in ('BREAK', 'CONTINUE'):
            loop = self._loop_of(what, word)
            end = self.end_of(loop.word, what)
            if word == 'CONTINUE':
                self.continued = loop.word == 'DO'
                self.go(end)
            else:
                self.loops.pop()
                self.after(end)
        elif word in ENDS and not ends_do:
            self.refuse_if(
                word == 'REPEAT' and what.label and self.continued,
                'LinuxCNC repeats too often after a continue in a DO loop; write WHILE',
                f'{what.label} REPEAT',
            )
            self.continued = self.continued and word != 'WHILE'
            self._enter(what, word, rest)
        else:
            loop = self._loop_of(what, word)
            if (ends_do or word == 'UNTIL') and bool(self.condition(rest)) is (word == 'UNTIL'):
                self.loops.pop()
                self.on()
            else:
                self.back_or_on(loop.begin)

    def _loop_of(self, what: Structure, word: str) -> Loop:
        while self.loops and not (
            self.loops[-1].what == what and HEADS.get(word) in (None, self.loops[-1].word)
        ):
            self.loops.pop()
        if not self.loops:
            shown = f'{what.label} {word}'.strip()
            raise self.fault('this loop was not begun; add its first line', shown)
        return self.loops[-1]

    def _enter(self, what: Structure, word: str, rest: str) -> None:
        """Begin a loop or its next round; continue after its end if there is no further round."""
        here = self.window.place(self.row)
        running = any(loop.begin == here for loop in self.loops)
        while running and self.loops[-1].begin != here:
            self.loops.pop()
        holds, rounds = True, 0
        if word == 'WHILE':
            holds = bool(self.condition(rest))
        elif word == 'FOR':
            match = _FOR.fullmatch(rest)
            if match is None:
                raise self.fault('write FOR NAME = first TO last', 'FOR')
            name, first, last = match.groups()
            value = self.variables.named(name) + 1.0 if running else self.condition(first)
            self.variables.set_name(name, value)
            holds = value <= self.condition(last)
        elif word == 'REPEAT' and rest:
            count = 0.0 if running else self.condition(rest)
            rounds = self.loops[-1].rounds - 1 if running else round(count) * (count >= 1.0)
            holds = rounds > 0
        if not running:
            self.loops.append(Loop(f'{what.label} {word}', here, rounds, word, what))
        self.loops[-1].rounds = rounds
        if holds:
            self.on()
        else:
            self.loops.pop()
            self.after(self.end_of(word, what))

    def _choose_branch(self, what: Structure, rest: str) -> None:
        place, holds = self.window.place(self.row), bool(self.condition(rest))
        while not holds:
            place = self.end_of('IF', what, place, 'ELSEIF|ELSE')
            self.go(place)
            match = _BRANCH_WORD.search(self.window.line(self.row).upper())
            holds = match is None or match[1] != 'ELSEIF' or bool(self.condition(match[2]))
        self.on()

    def end_of(
        self, head: str, what: Structure, place: LineStart | None = None, between: str = ''
    ) -> LineStart:
        end = what.end or ENDS[head]
        words = f'(?:(?P<head>{what.head or head})|(?P<between>{between or "(?!)"})|{end})'
        pattern = re.compile(f'(?mi)^{_NUMBER}{what.before}{words}{what.after}')
        find, depth = re.compile(pattern.pattern.encode()), 0
        found = self.source.find(find, self.source.after(place or self.window.place(self.row)))
        while found is not None:
            match = pattern.match(self.source.line_at(found))
            if match and match['head']:
                depth += 1
            elif match and not depth:
                return found
            elif match and not match['between']:
                depth -= 1
            found = self.source.find(find, self.source.after(found))
        shown = f'{what.label} {head}'.strip()
        raise self.fault(f'the end of {shown} is missing; add it', shown)

    def jump(self, way: str, target: str) -> None:
        name = re.fullmatch(r'[A-Z_][A-Z_]\w*', target)
        if name and not self.variables.exists(target):
            pattern = rb'(?mi)^[ \t/]*(?:N\s*\d+\s*)?' + target.encode() + rb'[ \t]*:'
        else:
            value = self.condition(re.sub(r'^[N:](?=\d)', '', target))
            self.demand(0 <= value < 1e9, 'not a line number; write for example GOTO 100', target)
            pattern = rb'(?mi)^[ \t/]*[N:][ \t]*0*%d(?!\d)' % round(value)
        search = re.compile(pattern)
        after = self.window.place(self.row + 1)
        place = self.source.find(search, after) if way != 'B' else None
        if place is None and way != 'F':
            place = self.source.find(search, self.source.start)
        if place is None and way == 'C':
            return  # no alarm: the program continues
        if place is None or (way == 'B' and place.offset >= after.offset):
            raise self.fault(
                'no line with this number or label; correct the jump target', target or 'GOTO'
            )
        self._keep_loops(place)
        self.back_or_on(place)

    def _keep_loops(self, target: LineStart) -> None:
        for count, loop in enumerate(self.loops):
            if (
                loop.what is None
                or loop.begin.offset >= target.offset
                or (self.end_of(loop.word, loop.what, loop.begin).offset < target.offset)
            ):
                del self.loops[count:]
                return


def _numbered(number: str) -> Structure:
    return Structure(f'DO{number}', '', r'(?!\d)', rf'WHILE.*DO\s*{number}', rf'END\s*{number}')
