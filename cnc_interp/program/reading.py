"""Part program -> blocks: finds the dialect, reads the text, hands out blocks and notices."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from cnc_interp.core.errors import ProgramError
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.cl_data import ClReader
from cnc_interp.program.gcode import GcodeReader
from cnc_interp.program.job import JobSetup
from cnc_interp.program.notices import Notices
from cnc_interp.program.rotary_geometry import RotaryGeometry
from cnc_interp.program.source import Source
from cnc_interp.settings.choices import Settings

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


class ProgramStream:
    """
    A part program that is read while its blocks are taken; its length does not matter.

    Iterating hands out batches of blocks: their first row is the start pose, the others are pieces
    of motion, in order, as if they were cut out of ``Program.blocks``.

    Parameters
    ----------
    source : Source
        The text.
    geometry : RotaryGeometry
        The machine.
    settings : Settings
        The user's choices.
    setup : JobSetup, optional
        Work offsets, tool lengths and reference points; None: those of the file that the settings
        name.

    Raises
    ------
    ProgramError
        If the setup file cannot be read. While iterating, as soon as something cannot be read:
        nothing is skipped silently.

    """

    def __init__(
        self,
        source: Source,
        geometry: RotaryGeometry,
        settings: Settings,
        setup: JobSetup | None = None,
    ):
        if setup is None:
            setup = JobSetup.load(settings.setup) if settings.setup else JobSetup()
        self._source, self.source = source, source.name
        self.dialect = _dialect(source)
        self._notices = Notices()
        self._reader: ClReader | GcodeReader
        if self.dialect == 'cl':
            self._reader = ClReader(geometry, settings, source, self._notices)
        else:
            self._reader = GcodeReader(geometry, settings, setup, source, self._notices)

    def __iter__(self) -> Iterator[Blocks]:
        """Read on; the text is closed at the end."""
        try:
            yield from self._reader.blocks()
        finally:
            self._source.close()

    @property
    def notices(self) -> tuple[str, ...]:
        """Harmless things that were passed on or simplified so far."""
        return self._notices.texts()

    @property
    def share(self) -> float:
        """Share of the text that has been read, 0 to 1."""
        return self._reader.share

    def read(self) -> Program:
        """Read to the end."""
        blocks = Blocks.concatenate(list(self))
        return Program(blocks, self.notices, self.source, self.dialect)


def open_program(
    path: Path, geometry: RotaryGeometry, settings: Settings, setup: JobSetup | None = None
) -> ProgramStream:
    """
    Open a part program for reading block by block.

    Raises
    ------
    ProgramError
        If the file cannot be opened, or is of an unsupported kind.

    """
    return ProgramStream(Source.of_file(path), geometry, settings, setup)


def read_program(
    path: Path, geometry: RotaryGeometry, settings: Settings, setup: JobSetup | None = None
) -> Program:
    """
    Read a part program from a file.

    Raises
    ------
    ProgramError
        If the file cannot be opened or its text cannot be read; nothing is skipped silently.

    """
    return open_program(path, geometry, settings, setup).read()


def read_text(
    text: str,
    source: str,
    geometry: RotaryGeometry,
    settings: Settings,
    setup: JobSetup | None = None,
) -> Program:
    """
    Read a part program from a string.

    Examples
    --------
    >>> program = read_text('G1 X10 F600', '<text>', machine, Settings())
    >>> program.blocks.tip
    array([[0.01, 0.  , 0.  ]])

    """
    return ProgramStream(Source.of_text(text, source), geometry, settings, setup).read()


def _dialect(source: Source) -> str:
    """Tell the dialect from the first line that only one of them can have."""
    head = source.lines(source.start).decode('utf-8', 'replace').splitlines()[:_HEAD_LINES]
    for number, line in enumerate(head, start=1):
        if _HEIDENHAIN_LINE.match(line):
            raise ProgramError(
                'Heidenhain plain text is not supported; post as G-code or CL data',
                source.name,
                number,
                'BEGIN PGM',
            )
        if _CL_LINE.match(line):
            return 'cl'
        if _GCODE_LINE.match(line):
            return 'gcode'
    return 'cl' if Path(source.name).suffix.lower() in _CL_SUFFIXES else 'gcode'
