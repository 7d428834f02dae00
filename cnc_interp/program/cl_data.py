"""
CL data (APT cutter location files) -> targets: GOTO points with tool axis vectors.

A statement is a major word, a slash and minor words; ``$`` at the end of a line continues it,
``$$`` begins a comment. The tool axis turns on the great circle between two points.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from math import inf, nan, sqrt

from cnc_interp.errors import ProgramError
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.columns import NO_ARC, TargetColumns
from cnc_interp.program.options import Notices, ReadOptions, RotaryGeometry
from cnc_interp.program.source import Place, Source
from cnc_interp.units import INCH, MINUTE, MM

_FARTHEST = 1e5 * MM
_UNIT_VECTOR = 5e-3  # published points carry four decimals

_NUMBER = r'[-+]?(?:\d++(?:\.\d*+)?|\.\d++)(?:E[-+]?\d++)?'
_NEXT = rf'(?:\s*,\s*|\s+)({_NUMBER})'
_GOTO = re.compile(rf'GOTO\s*/?\s*({_NUMBER}){_NEXT}{_NEXT}(?:{_NEXT}{_NEXT}{_NEXT})?,?')
_STATEMENT = re.compile(r'([A-Z][A-Z0-9]*)\s*(?:/\s*(.*)|(.*))')

_SILENT = {'REMARK', 'PPRINT', 'PARTNO', 'MACHIN', 'MULTAX'}
_STOPS = {'STOP', 'OPSTOP', 'DELAY', 'DWELL'}
_LINEAR = 'output the tool path as GOTO points'
_FRAME = 'changing the coordinate system is not supported yet; output one workpiece frame'
_REFUSED = {
    'CIRCLE': f'circles are not supported yet; {_LINEAR}',
    'MOVARC': f'circles are not supported yet; {_LINEAR}',
    'ARCMOV': f'circles are not supported yet; {_LINEAR}',
    'CYCLE': f'drilling cycles are not supported yet; {_LINEAR}',
    'GODLTA': f'incremental moves are not supported yet; {_LINEAR}',
    'GOHOME': f'machine-coordinate moves are not supported yet; {_LINEAR}',
    'RETRCT': f'retract moves are not supported yet; {_LINEAR}',
    'ROTATE': f'rotary table moves are not supported yet; {_LINEAR}',
    'ROTABL': f'rotary table moves are not supported yet; {_LINEAR}',
    'ORIGIN': _FRAME,
    'TRANS': _FRAME,
    'TRACUT': _FRAME,
    'COPY': f'copied motion is not supported yet; {_LINEAR}',
    'INDEX': f'copied motion is not supported yet; {_LINEAR}',
    'MACRO': f'macros are not supported yet; {_LINEAR}',
    'CALL': f'macros are not supported yet; {_LINEAR}',
}
_OFF_ONLY = {'CUTCOM': 'cutter compensation is not supported yet; output the tool centre'}
_LENGTH_UNITS = {'MM': MM, 'MILLIM': MM, 'INCH': INCH, 'INCHES': INCH}
_FEED_UNITS = {'MMPM': MM, 'IPM': INCH, 'PERMIN': 0.0}
_NO_FEED = 'no feedrate (FEDRAT) before the first cutting GOTO; give --feed MM_PER_MIN'


class ClReader:
    """
    State of a CL file; ``blocks`` runs it over the statements.

    Parameters
    ----------
    geometry : RotaryGeometry
        Of the machine; CL data name no rotary axes, so only its presence matters here.
    options : ReadOptions
        Tolerances, and the feedrate of files without FEDRAT.
    source : Source
        The text.
    notices : Notices
        Collects what is harmless.

    """

    def __init__(
        self, geometry: RotaryGeometry, options: ReadOptions, source: Source, notices: Notices
    ):
        self.options, self.source, self.notices = options, source, notices
        self.targets = TargetColumns(geometry, options, source.name)
        self.place = source.start
        self.line_number = 0
        self.unit = MM
        self.feedrate = options.feedrate
        self.rapid = False
        self.axis = (0.0, 0.0, 1.0)

    @property
    def share(self) -> float:
        """Share of the text that has been read, 0 to 1."""
        return self.source.share(self.place)

    def blocks(self) -> Iterator[Blocks]:
        """Read all statements up to FINI and hand out the blocks, batch by batch."""
        if self.options.interpolation == 'axes':
            self._notice('interpolation', 'CL data turn the tool axis on great circles')
        for line_number, statement in self._statements(self._lines()):
            self.line_number = line_number
            match = _GOTO.fullmatch(statement)
            if match:
                self._goto(match.groups())
            elif statement.startswith('FINI'):
                break
            else:
                self._other(statement)
            yield from self.targets.take()
        yield from self.targets.finish()

    def _lines(self) -> Iterator[str]:
        """Read the lines of the source, window by window."""
        while text := self.source.lines(self.place):
            yield from text.decode('utf-8', 'replace').splitlines()
            offset = self.place.offset + len(text)
            self.place = Place(offset, self.place.line + text.count(b'\n'))

    def _statements(self, lines: Iterable[str]) -> Iterator[tuple[int, str]]:
        """Join continued lines; yield the number of the first line and the statement."""
        begun, parts = 0, ''
        number = 0
        for number, raw in enumerate(lines, start=1):
            line = raw.strip().upper()
            if '$$' in line:
                line = line[: line.index('$$')].rstrip()
            if line.endswith('$'):
                begun = begun or number
                parts += line[:-1] + ' '
                continue
            if begun:
                line, at = (parts + line).strip(), begun
                begun, parts = 0, ''
            else:
                at = number
            if line:
                yield at, line
        if begun:
            self.line_number = begun
            raise self._fault('the file ends inside a continued statement ($)')

    def _fault(self, message: str, word: str = '') -> ProgramError:
        return ProgramError(message, self.source.name, self.line_number, word[:40])

    def _notice(self, key: str, text: str) -> None:
        self.notices.once(key, self.line_number, f'{key}: {text}')

    def _goto(self, words: tuple[str | None, ...]) -> None:
        unit = self.unit
        x, y, z = (float(word or nan) * unit for word in words[:3])
        if max(abs(x), abs(y), abs(z)) > _FARTHEST:
            raise self._fault('a coordinate beyond 100,000 mm; correct it or UNITS', 'GOTO')
        if words[3] is not None:
            self.axis = self._unit_vector(*(float(word or nan) for word in words[3:]))
        rapid, self.rapid = self.rapid, False
        if rapid or self.targets.empty:
            feedrate = inf
        elif self.feedrate is None:
            raise self._fault(_NO_FEED, 'GOTO')
        else:
            feedrate = self.feedrate
        tolerances = (self.options.contour_tolerance, self.options.orientation_tolerance)
        speed = (feedrate, nan, rapid, 0.0)
        self.targets.add(
            (
                x, y, z, *self.axis, nan, nan, 0.0, 1.0, *speed, *tolerances, self.line_number,
                0.0, nan, *NO_ARC,
            )
        )  # fmt: skip

    def _unit_vector(self, i: float, j: float, k: float) -> tuple[float, float, float]:
        length = sqrt(i * i + j * j + k * k)
        if not abs(length - 1.0) <= _UNIT_VECTOR:
            raise self._fault(
                f'the tool axis is not a unit vector, its length is {length:g}; correct i, j, k',
                'GOTO',
            )
        return i / length, j / length, k / length

    def _other(self, statement: str) -> None:
        match = _STATEMENT.fullmatch(statement)
        if match is None:
            raise self._fault('not a CL statement; write MAJOR/minor', statement.split()[0])
        major, minor = match[1], (match[2] or match[3] or '').strip()
        if major == 'GOTO':
            raise self._fault(
                'expected three numbers, or six with the tool axis, between commas or spaces',
                statement,
            )
        if major in _REFUSED:
            raise self._fault(_REFUSED[major], major)
        if major in _OFF_ONLY and minor not in ('OFF', ''):
            raise self._fault(_OFF_ONLY[major], statement)
        if major == 'FROM':
            self._from(minor)
        elif major == 'RAPID':
            self.rapid = True
        elif major == 'FEDRAT':
            self._feed(minor, statement)
        elif major == 'UNITS':
            if minor not in _LENGTH_UNITS:
                raise self._fault('unknown unit; write UNITS/MM or UNITS/INCHES', statement)
            self.unit = _LENGTH_UNITS[minor]
        elif major in _STOPS:
            self._notice(major, 'exact stop; the program goes on by itself')
            self.targets.stop_here()
        elif major not in _SILENT:
            self._notice(major, 'passed on, it does not move the tool')

    def _from(self, minor: str) -> None:
        """Take FROM as the start pose; later ones only repeat where the tool is."""
        match = _GOTO.fullmatch('GOTO/' + minor)
        if match is None:
            raise self._fault('expected three or six numbers', f'FROM/{minor}')
        if self.targets.empty:
            self._goto(match.groups())

    def _feed(self, minor: str, statement: str) -> None:
        """FEDRAT/value[,unit] in either order."""
        words = minor.replace(',', ' ').split()
        numbers = [word for word in words if re.fullmatch(_NUMBER, word)]
        units = [word for word in words if word not in numbers]
        if any(word in ('MMPR', 'IPR', 'PERREV') for word in units):
            raise self._fault('feed per revolution is not supported yet; use MMPM', statement)
        if len(numbers) != 1 or any(word not in _FEED_UNITS for word in units):
            raise self._fault('write FEDRAT/value,MMPM or FEDRAT/value,IPM', statement)
        value = float(numbers[0])
        if not 0.0 < value < inf:
            raise self._fault('the feedrate must be greater than zero', statement)
        unit = (_FEED_UNITS[units[0]] if units else 0.0) or self.unit
        self.feedrate = value * unit / MINUTE
