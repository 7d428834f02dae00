"""Part program -> Program: finds the dialect, reads the lines, hands out blocks and notices."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from io import StringIO
from itertools import chain, islice
from pathlib import Path

from cnc_interp.errors import ProgramError
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.cl_data import ClReader
from cnc_interp.program.gcode import GcodeReader
from cnc_interp.program.options import Notices, ReadOptions, RotaryGeometry

_HEAD_LINES = 2000
_CL_SUFFIXES = {'.apt', '.cl', '.cls', '.ncl', '.aptsource'}
_CL_LINE = re.compile(
    r'\s*(?:(?:GOTO|FROM)\s*/?\s*[-+.\d]'
    r'|(?:FEDRAT|LOADTL|MULTAX|PPWORD|SPINDL|UNITS|TOOL PATH)\s*/|(?:PARTNO|FINI)\b)',
    re.IGNORECASE,
)
_GCODE_LINE = re.compile(
    r'\s*(?:/\s*)?(?:%|(?:N\s*\d+\s*)?[GMXYZ]\s*[-+.\d]|:\d|O\d)', re.IGNORECASE
)
_HEIDENHAIN_LINE = re.compile(r'\s*\d+\s+BEGIN\s+PGM\b', re.IGNORECASE)


@dataclass(frozen=True)
class Program:
    """
    A part program, read.

    Parameters
    ----------
    blocks : Blocks
        Row 0 is the start pose, then one row per linear piece of motion.
    notices : tuple of str
        Harmless things that were passed on or simplified, each with its first line.
    source : str
        File name, or ``<text>``.
    dialect : {'gcode', 'cl'}
        How the text was read.

    """

    blocks: Blocks
    notices: tuple[str, ...]
    source: str
    dialect: str


def read_program(path: Path, geometry: RotaryGeometry, options: ReadOptions) -> Program:
    """
    Read a part program from a file, line by line.

    Raises
    ------
    ProgramError
        If the file cannot be opened or its text cannot be read; nothing is skipped silently.

    """
    try:
        with path.open(encoding='utf-8-sig', errors='replace') as lines:
            return _read(lines, str(path), geometry, options)
    except OSError as error:
        raise ProgramError(f'cannot be opened: {error.strerror}', str(path)) from error


def read_text(text: str, source: str, geometry: RotaryGeometry, options: ReadOptions) -> Program:
    """
    Read a part program from a string.

    Examples
    --------
    >>> program = read_text('G1 X10 F600', '<text>', machine, ReadOptions())
    >>> program.blocks.tip
    array([[0.01, 0.  , 0.  ]])

    """
    return _read(StringIO(text, newline=None), source, geometry, options)


def _read(
    lines: Iterable[str], source: str, geometry: RotaryGeometry, options: ReadOptions
) -> Program:
    rest = iter(lines)
    head = list(islice(rest, _HEAD_LINES))
    dialect = _dialect(head, source)
    notices = Notices()
    reader_class = ClReader if dialect == 'cl' else GcodeReader
    reader = reader_class(geometry, options, source, notices)
    reader.read(chain(head, rest))
    return Program(reader.targets.finish(), notices.texts(), source, dialect)


def _dialect(head: list[str], source: str) -> str:
    """Tell the dialect from the first line that only one of them can have."""
    for number, line in enumerate(head, start=1):
        if _HEIDENHAIN_LINE.match(line):
            raise ProgramError(
                'Heidenhain plain text is not supported; post as G-code or CL data',
                source,
                number,
                'BEGIN PGM',
            )
        if _CL_LINE.match(line):
            return 'cl'
        if _GCODE_LINE.match(line):
            return 'gcode'
    return 'cl' if Path(source).suffix.lower() in _CL_SUFFIXES else 'gcode'
