"""Branches, loops and jumps: one machine that executes those of all dialects.

A structure has a head and an end, as IF and ENDIF. The end of a loop leads back to its head, which
decides whether it goes on. ``flow.py`` tells how each dialect writes the words.
"""

from __future__ import annotations

import re

from cnc_interp.program.cursor import Cursor, Loop, Structure
from cnc_interp.program.expressions import ExpressionError, evaluate, parse
from cnc_interp.program.source import LineStart

#: The last word of each structure by its first one, and the reverse. WHILE also ends DO.
ENDS = {'IF': 'ENDIF', 'WHILE': 'ENDWHILE', 'FOR': 'ENDFOR', 'LOOP': 'ENDLOOP', 'DO': 'WHILE',
        'REPEAT': '(?:UNTIL|ENDREPEAT)'}  # fmt: skip
HEADS = {'ENDWHILE': 'WHILE', 'ENDFOR': 'FOR', 'ENDLOOP': 'LOOP', 'UNTIL': 'REPEAT',
         'ENDREPEAT': 'REPEAT'}  # fmt: skip
BETWEEN = {'ELSEIF', 'ELSE', 'ENDIF'}  #: Words of IF after its head.
_NUMBER = r'[ \t/]*(?:N\s*\d+\s*)?'
_FOR = re.compile(r'(\w+)\s*=(.*?)(?<!\w)TO(?!\w)(.*)')
_BRANCH = re.compile(r'(ELSEIF|ELSE|ENDIF)(?![A-Z_])\s*([^;(]*)')


class Structures(Cursor):
    def condition(self, text: str) -> float:
        try:
            (node,) = parse(text, 'condition')
            return evaluate(node, self.variables)
        except (ExpressionError, ValueError) as problem:
            raise self.fault(str(problem) or 'a condition is missing', text[:20]) from None

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
                self.go(end)
            else:
                self.loops.pop()
                self.after(end)
        elif word in ENDS and not ends_do:
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
        """Begin a loop, or its next round; go on after its end if there is none."""
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
        """Enter the first branch of an IF whose condition is true, or leave the IF."""
        place, holds = self.window.place(self.row), bool(self.condition(rest))
        while not holds:
            place = self.end_of('IF', what, place, 'ELSEIF|ELSE')
            self.go(place)
            match = _BRANCH.search(self.window.line(self.row).upper())
            holds = match is None or match[1] != 'ELSEIF' or bool(self.condition(match[2]))
        self.on()

    def end_of(
        self, head: str, what: Structure, place: LineStart | None = None, between: str = ''
    ) -> LineStart:
        """Return the line with the end of a structure, or with a word between, after a place."""
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
            raise self.fault('no line with this number or label; correct the jump target',
                             target or 'GOTO')  # fmt: skip
        self._keep_loops(place)
        self.back_or_on(place)

    def _keep_loops(self, target: LineStart) -> None:
        """Leave the loops in which the target of a jump does not lie."""
        for count, loop in enumerate(self.loops):
            if (
                loop.what is None
                or loop.begin.offset >= target.offset
                or (self.end_of(loop.word, loop.what, loop.begin).offset < target.offset)
            ):
                del self.loops[count:]
                return
