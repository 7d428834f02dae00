"""Text of a part program, read in windows to save memory; and the files of programs."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from cnc_interp.core import FloatArray, IntArray, ProgramError
from cnc_interp.core.small_files import open_named
from cnc_interp.program.text import scan

_FIRST_WINDOW, _WINDOW = 1 << 15, 1 << 18
_LONGEST_LINE = 1 << 16
#: Characters that text does not contain, except for a few from old tapes in some programs.
_CONTROL = bytes({*range(32)} - {*b'\t\n\v\f\r\x1a'})
_BYTE_ORDER_MARK = b'\xef\xbb\xbf'


@dataclass(frozen=True)
class LineStart:
    offset: int
    line: int


@dataclass(frozen=True)
class LineWindow:
    start: LineStart  #: Place of the first line.
    text: bytes  #: The lines, each with its newline.
    #: (n,): Offsets in ``text`` of the first character and of the newline of each line.
    first: IntArray
    last: IntArray
    #: (n,): Output of ``scan.scan_lines``.
    kind: NDArray[np.int8]
    code: NDArray[np.int8]
    values: FloatArray  #: (n, 11): Output of ``scan.scan_lines``.
    rare: IntArray  #: (k,): Rows of the lines that need the general reader.

    def __len__(self) -> int:
        return len(self.first)

    def line(self, row: int) -> str:
        return self.text[self.first[row] : self.last[row]].decode('utf-8', 'replace').strip()

    def next_rare(self, row: int) -> int:
        at = int(np.searchsorted(self.rare, row))
        return int(self.rare[at]) if at < len(self.rare) else len(self)

    def place(self, row: int) -> LineStart:
        if row < len(self):
            return LineStart(self.start.offset + int(self.first[row]), self.start.line + row)
        return LineStart(self.start.offset + len(self.text), self.start.line + row)

    def row_of(self, place: LineStart) -> int | None:
        row = place.line - self.start.line
        if 0 <= row < len(self) and self.place(row).offset == place.offset:
            return row
        return None


class Source:
    """The text of a program; subprograms may lie in ``folders``, as for ``open_named``."""

    def __init__(self, stream: BinaryIO, name: str, folders: Sequence[str] | None = None):
        self.name, self.folders = name, folders
        if not stream.seekable():
            stream = io.BytesIO(stream.read())
        self._stream = stream
        self.size = stream.seek(0, io.SEEK_END)
        stream.seek(0)
        head = stream.read(_FIRST_WINDOW)
        if 16 * (len(head) - len(head.translate(None, _CONTROL))) > max(len(head), 256):
            raise ProgramError('this is not text; give a part program, as text in UTF-8', name)
        self._old_lines = b'\r' in head and b'\n' not in head
        self.start = LineStart(
            len(_BYTE_ORDER_MARK) if head.startswith(_BYTE_ORDER_MARK) else 0, 1
        )
        self._window: LineWindow | None = None

    @staticmethod
    def of_text(text: str, name: str, folders: Sequence[str] | None = None) -> Source:
        return Source(io.BytesIO(text.encode('utf-8', 'replace')), name, folders)

    @staticmethod
    def of_file(path: Path, folders: Sequence[str] | None = None) -> Source:
        try:
            file = open_named(path, folders)
        except OSError as error:
            raise ProgramError(f'cannot be opened: {error.strerror}', str(path)) from error
        return Source(file, str(path), folders and [*folders, str(path.parent)])

    def close(self) -> None:
        self._stream.close()

    def share(self, place: LineStart) -> float:
        return min(1.0, place.offset / max(self.size, 1))

    def window(self, place: LineStart) -> LineWindow:
        if self._window is None or self._window.start != place:
            self._window = _scanned(place, self.lines(place))
        return self._window

    def lines(self, place: LineStart) -> bytes:
        self._stream.seek(place.offset)
        text = self._stream.read(_FIRST_WINDOW if place.line == 1 else _WINDOW)
        if not text:
            return text
        if self._old_lines:
            text = text.replace(b'\r', b'\n')
        end = text.rfind(b'\n') + 1
        if end:
            text = text[:end]
        elif place.offset + len(text) < self.size or len(text) > _LONGEST_LINE:
            text += self._stream.readline(_LONGEST_LINE)
        longest = max(map(len, text.split(b'\n')))
        if longest > _LONGEST_LINE:
            at = next(i for i, line in enumerate(text.split(b'\n')) if len(line) == longest)
            begin = text.split(b'\n')[at][:20].decode('ascii', 'replace')
            raise ProgramError(
                f'a line of more than {_LONGEST_LINE} characters; give a part program',
                self.name,
                place.line + at,
                begin,
            )
        return text if text.endswith(b'\n') else text + b'\n'

    def find(self, pattern: re.Pattern[bytes], place: LineStart) -> LineStart | None:
        while text := self.lines(place):
            if match := pattern.search(text):
                begin = text.rfind(b'\n', 0, match.start()) + 1
                return LineStart(place.offset + begin, place.line + text.count(b'\n', 0, begin))
            place = LineStart(place.offset + len(text), place.line + text.count(b'\n'))
        return None

    def line_at(self, place: LineStart) -> str:
        self._stream.seek(place.offset)
        return self._stream.readline(_LONGEST_LINE).decode('utf-8', 'replace').strip()

    def after(self, place: LineStart) -> LineStart:
        self._stream.seek(place.offset)
        text = self._stream.readline()
        return LineStart(place.offset + len(text), place.line + 1)


def _scanned(place: LineStart, text: bytes) -> LineWindow:
    count = text.count(b'\n')
    first, last = np.empty(count, np.int64), np.empty(count, np.int64)
    kind, code = np.empty(count, np.int8), np.empty(count, np.int8)
    values = np.empty((count, len(scan.COLUMNS)))
    if count:
        scan.scan_lines(np.frombuffer(text, np.uint8), first, last, kind, code, values)
    return LineWindow(
        place, text, first, last, kind, code, values, np.flatnonzero(kind == scan.RARE)
    )


#: Number of lines in which the first program line is searched for.
_HEAD_LINES = 200
_WORD = re.compile(r'\s*(?:/\s*)?(?:[GMXYZNTSF]\s*[-+.\d#\[=]|[:O]\s*\d|[(;]|$)', re.IGNORECASE)
_NAME = re.compile(
    r'<[^<>]+>\s*(?:\([^()]*\))?'  # Fanuc: a name instead of a number, and a comment
    r'|O\s*<[^<>]+>'
    r'|O(?!RI|TOL|FFN)\s*[A-Z_][\w -]*'  # Okuma, a title to fill in; not the words of Siemens
    r'|O\s*\d+(?:\s*[-_]\s*|\s+)[A-Z_][A-Z_][\w .-]*'  # a number and a title
    r'|O\s*\d+\s*[-_]\s*\w[\w .-]*'
)


def leader_lines(source: Source) -> int:
    head = source.lines(source.start).decode('utf-8', 'replace').splitlines()[:_HEAD_LINES]
    for number, line in enumerate(head):
        if line.lstrip().startswith('%'):
            return number
        if line.strip() and _WORD.match(line):
            return 0
    return 0


def is_name(line: str) -> bool:
    return _NAME.fullmatch(line) is not None


#: Suffixes of a subprogram in a file of its own, in the order in which they are tried.
SUBPROGRAM_SUFFIXES = (
    '.ngc',
    '.nc',
    '.tap',
    '.NC',
    '.TAP',
    '.spf',
    '.SPF',
    '.mpf',
    '.MPF',
    '.SUB',
    '',
)
#: Suffixes of CL data, in lower case.
CL_SUFFIXES = frozenset(('.apt', '.cl', '.cls', '.ncl', '.aptsource'))
#: Suffixes by which programs are found in a folder, in lower case.
PROGRAM_SUFFIXES = CL_SUFFIXES | {'.ngc', '.nc', '.tap', '.mpf', '.cnc', '.gcode', '.h'}
#: Names of subprograms: ``o<name>``, or a number after O or P.
_CALLED = re.compile(rb'[Oo]\s*<\s*([\w-]+)\s*>')
_NUMBER = re.compile(rb'[OoPp]\s*(\d{1,9})(?!\d)')
#: A subprogram number that is computed.
_COMPUTED = re.compile(rb'[OoPp]\s*[#\[]')


LONGEST_NAME = 240  #: Longest name of a subprogram, without its suffix [bytes].


def subprogram_file(folder: Path, stem: str) -> Path | None:
    if not re.fullmatch(r'[\w-]+', stem) or len(stem.encode()) > LONGEST_NAME:
        return None
    paths = (folder / (stem + suffix) for suffix in SUBPROGRAM_SUFFIXES)
    if found := next((path for path in paths if path.is_file()), None):
        return found
    # Heidenhain's names differ in case from those of files.
    alike = (path for path in sorted(folder.glob('*.[hH]')) if path.stem.upper() == stem.upper())
    return next(alike, None)


def called_files(
    path: Path, text: bytes, folders: Sequence[str] | None = None
) -> dict[str, bytes]:
    """Return the content of files that a program may call, by name; raises as ``open_named``."""
    found: dict[str, bytes] = {}
    waiting = [text]
    while waiting:
        for stem in sorted(_stems(waiting.pop(), path.parent)):
            file = subprogram_file(path.parent, stem)
            if file is not None and file.name != path.name and file.name not in found:
                with open_named(file, folders and [*folders, str(path.parent)]) as stream:
                    found[file.name] = stream.read()
                waiting.append(found[file.name])
    return dict(sorted(found.items()))


def _stems(text: bytes, folder: Path) -> set[str]:
    stems = {name.decode().lower() for name in _CALLED.findall(text)}
    if _COMPUTED.search(text):
        stems |= {path.stem for path in folder.glob('O[0-9]*')}
    for digits in set(_NUMBER.findall(text)):
        number = int(digits)
        # Fanuc writes the number of calls before the last four digits.
        stems |= {digits.decode(), f'O{number:04d}', f'O{number % 10_000:04d}'}
    return stems
