"""Flow words of the Siemens 840D: IF ELSE, loops, CASE, jumps, DEF with arrays, subprograms."""

from __future__ import annotations

import re

from cnc_interp.program.cursor import Cursor, Loop
from cnc_interp.program.expressions import ExpressionError, evaluate, parse
from cnc_interp.program.files import subprogram_file
from cnc_interp.program.source import LineStart

#: First and last word of each structure.
ENDS = {'IF': 'ENDIF', 'WHILE': 'ENDWHILE', 'FOR': 'ENDFOR', 'LOOP': 'ENDLOOP', 'REPEAT': 'UNTIL'}
_HEADS = {end: head for head, end in ENDS.items()}
_KEYWORD = re.compile(
    r'(IF|ELSE|ENDIF|WHILE|ENDWHILE|FOR|ENDFOR|LOOP|ENDLOOP|REPEAT|UNTIL|CASE|DEF|PROC|EXTERN|RET|'
    r'GOTOS)(?!\w|\s*[=:\[])\s*(.*)'
)
#: What stands before the words of a line: its number, and a label.
_BEFORE = r'[ \t/]*(?:N\s*\d+\s*)?(?:[A-Z_][A-Z_]\w*\s*:(?!=)\s*)?'
_FOR = re.compile(r'(\w+)\s*=(.*?)(?<!\w)TO(?!\w)(.*)')
_CASE = re.compile(r'(.*?)(?<!\w)OF(?!\w)(.*)')
_BRANCH = re.compile(r'\s*(.*?)\s*(GOTO[FBC]?)\s+(\w+)')
_TYPE = re.compile(r'(REAL|INT|BOOL|CHAR|STRING\s*\[\s*\d+\s*\]|AXIS|FRAME)\s+(.*)')
_NAME = re.compile(r'\s*([A-Z_]\w*)\s*(?:\[([^\]]*)\])?\s*(?:=(.*))?')
_COMMAS = re.compile(r',(?![^(\[]*[)\]])(?![^"]*"(?:[^"]*"[^"]*")*[^"]*$)')
_CALL = re.compile(r'(?:CALL\s*"([^"]+)"|([A-Z_][A-Z_]\w*|L\d+))\s*(?:P\s*=?\s*(\d+))?')
_MOST_ELEMENTS = 10_000  #: More elements of an array are not set to 0 one by one.


class SiemensFlow(Cursor):
    """A cursor that executes the flow words of Siemens."""

    def siemens(self, line: str) -> bool:
        """Execute a line if it is a flow statement of Siemens."""
        if self._calls_by_name(line):
            return True
        match = _KEYWORD.fullmatch(line)
        if match is None or (match[1] in ('IF', 'CASE') and match[2] == ''):
            return False
        word, rest = match[1], match[2].strip()
        if word in ('IF', 'WHILE', 'FOR'):
            self._enter(word, rest)
        elif word == 'LOOP' or word == 'REPEAT':
            if rest:
                raise self.fault('a section is repeated by a label; write REPEAT and UNTIL', word)
            self._begin(word)
        elif word == 'ELSE':
            self.after(self._matching('IF'))
        elif word == 'ENDIF':
            self.on()
        elif word in _HEADS:
            self._close(word, rest)
        elif word == 'CASE':
            self._case(rest)
        elif word == 'DEF':
            self._define(rest)
        elif word == 'RET':
            self._return_or_end()
        elif word == 'GOTOS':
            self.loops.clear()
            self.back_or_on(self.source.start)
        return True

    def condition(self, text: str) -> float:
        """Return the value of a condition or expression."""
        try:
            (node,) = parse(text, 'condition')
            return evaluate(node, self.variables)
        except (ExpressionError, ValueError) as problem:
            raise self.fault(str(problem) or 'a condition is missing', text[:20]) from None

    def on(self) -> None:
        """Continue with the next line."""
        self.go(self.window.place(self.row + 1))

    def after(self, place: LineStart) -> None:
        """Continue with the line after a place."""
        self.go(self.source.after(place))

    # --- structures ----------------------------------------------------------------------------

    def _matching(self, head: str, other: str = '') -> LineStart:
        """Return the line with the end of the structure that begins here, or with another word."""
        end = ENDS[head]
        missing = self.fault(f'{end} is missing; add it', head)
        words = f'{head}|{end}|{other}' if other else f'{head}|{end}'
        pattern = re.compile(rf'(?mi)^{_BEFORE}(?:{words})(?!\w|[ \t]*[=:\[])'.encode())
        here, depth = self.window.place(self.row), 0
        place = self.source.find(pattern, self.source.after(here))
        while place is not None:
            text = self.source.line_at(place).upper().split(';')[0]
            word = re.match(rf'{_BEFORE}({words})', text)
            single = head == 'IF' and re.search(r'(?<!\w)(?:GOTO|THEN)', text)
            if word and word[1] == head and not single:
                depth += 1
            elif word and word[1] != head and not depth:
                return place
            elif word and word[1] == end:
                depth -= 1
            place = self.source.find(pattern, self.source.after(place))
        raise missing

    def _begin(self, word: str) -> bool:
        """Note that a loop begins here; return whether it is running already."""
        place = self.window.place(self.row)
        running = any(loop.begin == place for loop in self.loops)
        while running and self.loops[-1].begin != place:
            self.loops.pop()
        if not running:
            self.loops.append(Loop(word, place))
        self.on()
        return running

    def _enter(self, word: str, rest: str) -> None:
        """Process IF, WHILE and FOR."""
        if word == 'IF':
            if self.condition(rest):
                self.on()
            else:
                self.after(self._matching('IF', 'ELSE'))
            return
        here = self.window.place(self.row)
        running = any(loop.begin == here for loop in self.loops)
        if word == 'WHILE':
            holds = bool(self.condition(rest))
        else:
            match = _FOR.fullmatch(rest)
            if match is None:
                raise self.fault('write FOR NAME = first TO last', 'FOR')
            name, first, last = match.groups()
            value = self.variables.named(name) + 1.0 if running else self.condition(first)
            self.variables.set_name(name, value)
            holds = value <= self.condition(last)
        if holds:
            self._begin(word)
            return
        while running and self.loops.pop().begin != here:
            pass
        self.after(self._matching(word))

    def _close(self, word: str, rest: str) -> None:
        """Process the end of a loop: jump back to its head, or go on after UNTIL."""
        loop = self.loop_of(_HEADS[word], word)
        if word == 'UNTIL' and self.condition(rest):
            self.loops.pop()
            self.on()
        else:
            self.back_or_on(loop.begin)

    def loop_of(self, label: str, word: str) -> Loop:
        """Return the running loop with a label, and leave those within it."""
        while self.loops and self.loops[-1].label != label:
            self.loops.pop()
        if not self.loops:
            raise self.fault('this loop was not begun; add its first line', word)
        return self.loops[-1]

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

    def jump(self, way: str, target: str) -> None:
        """Jump to a line number or a label."""
        name = re.fullmatch(r'[A-Z_][A-Z_]\w*', target)
        if name and not self.variables.exists(target):
            pattern = rb'(?mi)^[ \t/]*(?:N\s*\d+\s*)?' + target.encode() + rb'[ \t]*:'
        else:
            value = self.condition(re.sub(r'^[N:](?=\d)', '', target))
            if not 0 <= value < 1e9:
                raise self.fault('not a line number; write for example GOTO 100', target)
            pattern = rb'(?mi)^[ \t/]*[N:][ \t]*0*%d(?!\d)' % round(value)
        search = re.compile(pattern)
        after = self.window.place(self.row + 1)
        place = self.source.find(search, after) if way != 'B' else None
        if place is None and way != 'F':
            place = self.source.find(search, self.source.start)
        if place is None and way == 'C':
            return  # no alarm: the program goes on
        if place is None or (way == 'B' and place.offset >= after.offset):
            raise self.fault(
                'no line with this number or label; correct the jump target', target or 'GOTO'
            )
        self._keep_loops(place)
        self.back_or_on(place)

    def _keep_loops(self, target: LineStart) -> None:
        """Leave the loops in which the target of a jump does not lie."""
        here = self.window.place(self.row)
        for count, loop in enumerate(self.loops):
            inside = loop.label in ENDS and loop.begin.offset < target.offset
            if inside:
                self.go(loop.begin)
                inside = target.offset <= self._matching(loop.label).offset
                self.go(here)
            if not inside:
                del self.loops[count:]
                return

    # --- variables and subprograms -------------------------------------------------------------

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
        """Set all elements of an array, in their order, to values or to 0."""
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
        """Execute a subprogram call by its name, L and a number, or CALL "NAME"."""
        match = _CALL.fullmatch(line)
        if match is None or (match[2] or '') in (*ENDS, *_HEADS, 'ELSE', 'RET', 'GOTOS'):
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

    def _return_or_end(self) -> None:
        """Process RET: return from a subprogram, or end the program."""
        if self.depth:
            self.leave()
        else:
            self.ended = True
