"""Convert G-code to words line by line; ``plain_lines.py`` converts many plain lines at once."""

from __future__ import annotations

import re

import numpy as np

from cnc_interp.core import INCH
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.readers.plain_lines import SHORTEST, move_along
from cnc_interp.program.readers.program_reader import ProgramReader
from cnc_interp.program.text import scan
from cnc_interp.program.text.expressions import ExpressionError
from cnc_interp.program.text.source import is_name, leader_lines
from cnc_interp.program.text.words import split_words, without_comments

_NUMBER_AND_SKIP = re.compile(r'(?:[N:]\s*\d+(?:\.\d*)?\s*)?(/\d?\s*)?(?:N\s*\d+(?:\.\d*)?\s*)?')
#: A length or an angle without a decimal point; codes of units and of canned cycles.
#: Names are matched as well, so that their letters are kept.
_NO_POINT = re.compile(r'<[^<>]*>|[A-Z_]{2,}\w*|([ABCIJKQRUVWXYZ])\s*([-+]?\d+)(?![\d.]|\s*=)')
#: Comments with messages to the operator, and parameters in them.
_MESSAGE = re.compile(r'\(\s*(?:DEBUG|PRINT|MSG)\s*,([^)]*)\)', re.IGNORECASE)
_PARAMETER = re.compile(r'#(\d+|<[^<>]+>)')
_UNIT, _CYCLE = re.compile(r'G2[01](?!\d)'), re.compile(r'G(?:7[346]|8[1-9])(?!\d)')


_TEXT = re.compile(rb'(?m)^[ \t]*[^\s%\0\x1a]')


class GcodeReader(ProgramReader):
    def __init__(self, at: Execution):
        super().__init__(at)
        self._percent_seen = False
        self._leader = leader_lines(at.flow.main)

    def read_lines(self, first: int, end: int) -> None:
        window = self.flow.window
        rows = first + np.flatnonzero(window.kind[first:end] == scan.PLAIN)
        if len(rows) >= SHORTEST and self.flow.source is self.flow.main:
            lines = window.start.line + rows
            if move_along(self.at, window.code[rows], window.values[rows], lines):
                self.flow.row = end
                return
        for row in rows:
            self.flow.row = int(row)
            self.read_line(window.line(row))
            if self.flow.ended:
                return
        self.flow.row = end

    def read_line(self, raw: str) -> None:
        if self.flow.main_line <= self._leader:
            self.notice('text before %', 'it does not belong to the program')
            return
        line = without_comments(raw.upper(), self.fault)
        if '(' in raw and (said := _MESSAGE.search(raw)):
            self._say(said[1])
        if not line:
            return
        if line[0] == '%' and line[-1] != '*':
            if self._percent_seen or not self.targets.empty:
                self.flow.ended = True
                source, here = self.flow.source, self.flow.window.place(self.flow.row)
                if after := source.find(_TEXT, source.after(here)):
                    self.notice(
                        '%',
                        f'ends the program; what follows from line {after.line} on is not read',
                    )
            self._percent_seen = True
            return
        head = _NUMBER_AND_SKIP.match(line)
        if head and head.end():
            if head[1]:
                if self.settings.skip_blocks:
                    return
                self.notice('/', 'lines that begin with a slash are executed')
            line = line[head.end() :]
        self.in_flow = True
        rest = self.flow.execute(line) if line else None
        self.in_flow = False
        self.refuse_if(
            rest and rest[-1] == '*',
            '* ends a block in DIN/ISO of Heidenhain, where G30 and G31 are the '
            'blank; post for Fanuc or as plain text',
            '*',
        )
        if rest and self.settings.numbers == 'increments':
            rest = self._with_points(rest)
        if rest and not (rest[0] in 'O<' and self.targets.empty and is_name(rest)):
            self.execute(split_words(rest, self.at.variables, self.fault))

    def _say(self, text: str) -> None:

        def value(match: re.Match[str]) -> str:
            name, known = match[1].upper(), self.at.variables
            try:
                return f'{known.number(int(name)) if name.isdigit() else known.named(name):.6g}'
            except ExpressionError:
                return match[0]

        text = _PARAMETER.sub(value, text).strip()
        if self.mover.probed and not self.at.is_live:
            text += ' (before the probe answers)'
        self.mover.notices.once(text, self.flow.line_number, text)

    def _with_points(self, line: str) -> str:
        """Rewrite lengths and angles in increments as numbers with a decimal point."""
        unit = _UNIT.search(line)
        inch = unit[0].endswith('0') if unit else self.mover.unit == INCH
        counts = self.at.cycle is not None or _CYCLE.search(line)  # K of a cycle

        def written(match: re.Match[str]) -> str:
            letter = match[1]
            if letter is None or (letter == 'K' and counts):
                return match[0]
            number = int(match[2])
            return f'{letter}{number * (1e-4 if inch and letter not in "ABC" else 1e-3):.4f}'

        return _NO_POINT.sub(written, line)
