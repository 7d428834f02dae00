"""
Exchange files of STEP (ISO 10303-21): instances as records, each read when it is asked for.

    #10=CARTESIAN_POINT('',(0.,1.,2.));
    #11=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from cnc_interp.cam.surface import SurfaceError

Kind = TypeVar('Kind')
Tokens = list[tuple[str, str]]

# Each pattern matches a text in one way only, so that a malformed file is refused in linear time.
COMMENT = r'/\*[^*]*\*+(?:[^/*][^*]*\*+)*/'
SPACE = rf'\s*(?:{COMMENT}\s*)*'
#: A part of a statement; the semicolon ends the statement, in strings and comments it does not.
PART = re.compile(rf"[^;'/]+|'[^']*'|{COMMENT}|/(?!\*)|;")
INSTANCE = re.compile(rf'{SPACE}#(\d{{1,18}}){SPACE}=')
BEGIN = re.compile(rf'{SPACE}ISO-10303-21{SPACE};')
END = re.compile(rf'{SPACE}END-ISO-10303-21{SPACE};')
TOKEN = re.compile(
    SPACE
    + r"""(?:(?P<text>'[^']*(?:''[^']*)*'(?!')|"[0-9A-F]*")
    |(?P<number>[+-]?\d+(?:\.\d*)?(?:E[+-]?\d+)?)
    |\#(?P<reference>\d{1,18})|\.(?P<enumeration>\w+)\.|(?P<keyword>!?[A-Z_]\w*)|(?P<sign>[(),;$*]))""",
    re.IGNORECASE | re.VERBOSE,
)


class Reference(int):
    """The number of another instance."""


class Enumeration(str):
    """A word between full stops; ``T`` and ``F`` are the truth values."""

    __slots__ = ()


@dataclass(frozen=True)
class Record:
    """
    The parameters of one keyword of an instance.

    Parameters
    ----------
    keyword : str
        Entity type, upper case.
    values : tuple
        float, str, `Reference`, `Enumeration`, None for ``$`` and ``*``, tuples of these. Of a
        typed parameter, as in ``LENGTH_MEASURE(1.)``, the value.
    file : StepFile
        Its file.
    number : int
        Number of its instance.

    """

    keyword: str
    values: tuple[Any, ...]
    file: StepFile
    number: int

    def fault(self, message: str) -> SurfaceError:
        """Return an error that names the place."""
        return SurfaceError(f'{self.file.place(self.number)}: {message}')

    def get(self, index: int, kind: type[Kind]) -> Kind:
        """Return a parameter that must be of this kind."""
        (value,) = self._all(self.values[index : index + 1] or (None,), index, kind)
        return value

    def items(self, index: int, kind: type[Kind]) -> list[Kind]:
        """Return a parameter that must be a list of this kind."""
        return self._all(self.get(index, tuple), index, kind)

    def rows(self, index: int, kind: type[Kind]) -> list[list[Kind]]:
        """Return a parameter that must be a list of lists of one length."""
        rows = [self._all(row, index, kind) for row in self.items(index, tuple)]
        if len({len(row) for row in rows}) != 1:
            raise self.fault(f'{self.keyword} has rows of different lengths')
        return rows

    def _all(self, values: tuple[Any, ...], index: int, kind: type[Kind]) -> list[Kind]:
        if not all(isinstance(value, kind) for value in values):
            name = {float: 'number', tuple: 'list', str: 'text'}.get(kind, kind.__name__.lower())
            raise self.fault(f'parameter {index + 1} of {self.keyword} must hold a {name}')
        return list(values)


class StepFile:
    """
    The instances of an exchange file.

    Raises
    ------
    SurfaceError
        If the file cannot be opened, is not STEP, ends early, or an instance is malformed.

    """

    def __init__(self, path: Path):
        self.path = path
        try:
            self._text = path.read_text(encoding='latin-1')
        except OSError as error:
            raise SurfaceError(f'{path}: cannot be opened: {error.strerror}') from error
        if not BEGIN.match(self._text):
            raise SurfaceError(f'{path}: is not STEP: it does not begin with ISO-10303-21;')
        self._statements: dict[int, tuple[int, int]] = {}
        end = 0
        for start, end in _statements(self._text):
            if END.match(self._text, start, end):
                return
            if name := INSTANCE.match(self._text, start, end):
                self._statements[int(name[1])] = name.end(), end
        line = len(self._text[:end].splitlines()) + 1
        raise SurfaceError(
            f'{path}:{line}: the file ends early: END-ISO-10303-21; is missing after this place'
        )

    def fault(self, message: str) -> SurfaceError:
        """Return an error that names the file."""
        return SurfaceError(f'{self.path}: {message}')

    def having(self, keyword: str) -> Iterator[int]:
        """Find the instances with a keyword, in the order of the file."""
        word = re.compile(rf'(?<![\w-]){keyword}{SPACE}\(', re.IGNORECASE)
        for number, (start, end) in self._statements.items():
            if word.search(self._text, start, end) and keyword in self.records(number):
                yield number

    def records(self, number: int, wanted_by: Record | None = None) -> dict[str, Record]:
        """Read one instance: its records by keyword, several for a complex one."""
        if number not in self._statements:
            raise (wanted_by or self).fault(f'there is no instance #{number}')
        tokens = list(self._tokens(number))[::-1]
        try:
            found = [_record(tokens)] if tokens[-1][0] == 'keyword' else _list(tokens, _record)
            records = {word: Record(word, values, self, number) for word, values in found}
            if tokens != [('sign', ';')]:
                raise ValueError
        except (ValueError, IndexError, RecursionError) as error:
            raise SurfaceError(
                f'{self.place(number)}: is not of the form KEYWORD(...);'
            ) from error
        return records

    def place(self, number: int) -> str:
        """Return file, line and number of an instance, for errors."""
        line = self._text.count('\n', 0, self._statements[number][0]) + 1
        return f'{self.path}:{line}: #{number}'

    def _tokens(self, number: int) -> Iterator[tuple[str, str]]:
        """Cut a statement into kinds and texts."""
        start, end = self._statements[number]
        while start < end:
            found = TOKEN.match(self._text, start, end)
            if not found:
                near = ' '.join(self._text[start:end].split())[:20]
                raise SurfaceError(f'{self.place(number)}: cannot be read at {near!r}')
            start = found.end()
            yield next(
                (kind, text) for kind, text in found.groupdict().items() if text is not None
            )


def _statements(text: str) -> Iterator[tuple[int, int]]:
    """Find where each statement of a text begins and ends; the semicolon belongs to it."""
    start = end = 0
    while part := PART.match(text, end):
        end = part.end()
        if part.group() == ';':
            yield start, end
            start = end


# The parsers below take from the end of the reversed tokens.


def _list(tokens: Tokens, item: Callable[[Tokens], Kind]) -> tuple[Kind, ...]:
    """Take items in parentheses; commas may stand between them."""
    if tokens.pop() != ('sign', '('):
        raise ValueError
    items = []
    while tokens[-1] != ('sign', ')'):
        items.append(item(tokens))
        if tokens[-1] == ('sign', ','):
            tokens.pop()
    tokens.pop()
    return tuple(items)


def _record(tokens: Tokens) -> tuple[str, tuple[Any, ...]]:
    """Take a keyword and its parameters."""
    kind, text = tokens.pop()
    if kind != 'keyword':
        raise ValueError
    return text.upper(), _list(tokens, _value)


def _value(tokens: Tokens) -> Any:
    """Take one parameter."""
    kind, text = tokens[-1]
    if kind == 'keyword':
        return _record(tokens)[1][0]
    if text == '(':
        return _list(tokens, _value)
    tokens.pop()
    if kind == 'number' and np.isfinite(float(text)):
        return float(text)
    if kind == 'reference':
        return Reference(text)
    if kind == 'enumeration':
        return Enumeration(text.upper())
    if kind == 'text':
        return text[1:-1].replace("''", "'")
    if text in ('$', '*'):
        return None
    raise ValueError
