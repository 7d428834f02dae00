"""Convert CL data (APT cutter location files) to targets: GOTO points with tool axis vectors."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from math import inf, nan, pi, sqrt
from typing import ClassVar, NamedTuple

import numpy as np

from cnc_interp.core import MINUTE, MM, MM_PER_MIN, DependsOn, FloatArray, ProgramError
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.blocks.block_modes import NONE, ActiveModes
from cnc_interp.program.blocks.functions import acting
from cnc_interp.program.blocks.targets import TargetColumns
from cnc_interp.program.geometry import arcs
from cnc_interp.program.geometry.target_row import AT_M0, NO_ARC
from cnc_interp.program.motion.cycles import RAPID, Hole
from cnc_interp.program.notices import Notices, Refusals
from cnc_interp.program.readers import cl_words
from cnc_interp.program.readers.cl_words import IDENTITY, ClFrames, moves, system_of
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.source import LineStart, Source
from cnc_interp.settings.options import Settings

_FARTHEST = 1e5 * MM
_UNIT_VECTOR = 5e-3  # published points carry four decimals

_NUMBER = r'[-+]?(?:\d+(?:\.\d*)?|\.\d+)(?:E[-+]?\d+)?'
_NEXT = rf'(?:\s*,\s*|\s+)({_NUMBER})'
_GOTO = re.compile(rf'GOTO(?:\s*/)?\s*({_NUMBER}){_NEXT}{_NEXT}(?:{_NEXT}{_NEXT}{_NEXT})?,?')
_NUMBERS = re.compile(rf'{_NUMBER}(?:\s*,\s*{_NUMBER})*')
_ALONG_ARC = re.compile(
    rf'(?:TLON\s*,\s*)?GOFWD\s*/\s*\(\s*CIRCLE\s*/\s*({_NUMBER}){_NEXT * 3}\s*\)\s*,\s*ON\s*,'
    rf'[^()]*\(\s*LINE\s*/\s*({_NUMBER}){_NEXT * 5}\s*\)'
)
_STATEMENT = re.compile(r'([A-Z][A-Z0-9_]*)\s*(?:/\s*(.*)|(.*))')

#: Marks a statement that is cut off by the end of the file.
_UNENDED = '$'

_SAME_ANGLE = 1e-9  #: Directions with a smaller difference are equal [rad].


@dataclass
class _Circle:
    centre: FloatArray
    normal: FloatArray
    radius: float
    turned: float = 0.0
    pitch: float = 0.0

    def across(self, point: FloatArray) -> FloatArray:
        arm = point - self.centre
        return np.asarray(arm - (arm @ self.normal) * self.normal)

    def off(self, point: FloatArray) -> float:
        return abs(float(np.linalg.norm(self.across(point))) - self.radius)


def _numbers_of(minor: str) -> list[float]:
    return [float(word) for word in minor.split(',')] if _NUMBERS.fullmatch(minor) else []


def _moves(minor: str) -> bool:
    numbers = _numbers_of(minor)
    return any(numbers) or not numbers


class Statement(NamedTuple):
    major: str
    minor: str
    text: str


class ClReader:
    no_feed = (
        'no feedrate (FEDRAT) before the first cutting GOTO; write it, or choose one (settings, '
        '--feed)'
    )

    def __init__(self, geometry: Transform, settings: Settings, source: Source, notices: Notices):
        self.settings, self.source, self.notices = settings, source, notices
        self.targets = TargetColumns(geometry, settings, source.name)
        self.used: set[str] = set()  # nothing of the setup
        self.place = source.start
        self.line_number = 0
        self.unit = MM
        self.feedrate = settings.feedrate
        self._tolerances = settings.contour_tolerance, settings.orientation_tolerance
        self.rapid = False
        self.axis = (0.0, 0.0, 1.0)
        self._point = (nan, nan, nan)
        self._circle: _Circle | None = None
        self._cycle: Hole | None = None
        self._heading: FloatArray | None = None  # of the next arc, by INDIRV
        self._frames = ClFrames()
        self._system = ''  # by name
        self._outputs: dict[str, str] = {}  # the last statement of each output
        self._signals = geometry.machine.signals
        self._has_macro = bool(geometry.machine.tool_change_macro)

    @property
    def share(self) -> float:
        return self.source.share(self.place) * self.targets.share

    def blocks(self) -> Iterator[Blocks]:
        if self.settings.interpolation == 'axes':
            self._notice('interpolation', 'CL data turn the tool axis on great circles')
        refused, start = Refusals(), self.targets.start
        for line_number, statement in self._statements(self._lines()):
            if start.line and not start.passes and line_number >= start.line:
                start.reach(self._state_words)
            if statement.startswith('FINI'):
                break
            self._frames.keep(line_number, statement)
            try:
                self._statement(line_number, statement)
            except ProgramError as problem:
                refused.add(problem)
                self._circle = None
            else:
                if statement.startswith('GOTO'):
                    refused.arrive()
            parts = self.targets.take()
            if not refused:
                yield from parts
        if refused:
            raise refused.error()
        yield from self.targets.finish()

    def _statement(self, line_number: int, statement: str) -> None:
        self.line_number = line_number
        match = _GOTO.fullmatch(statement)
        if match:
            self._goto(match.groups())
        else:
            self._other(statement)

    def _state_words(self) -> tuple[str, ...]:
        unit = 'MM' if self.unit == MM else 'INCHES'
        feed = () if self.feedrate is None else (f'FEDRAT/{self.feedrate / MM_PER_MIN:g},MMPM',)
        return (f'UNITS/{unit}', *feed, *self._outputs.values())

    def _lines(self) -> Iterator[str]:
        while text := self.source.lines(self.place):
            yield from text.decode('utf-8', 'replace').splitlines()
            offset = self.place.offset + len(text)
            self.place = LineStart(offset, self.place.line + text.count(b'\n'))

    def _statements(self, lines: Iterable[str]) -> Iterator[tuple[int, str]]:
        begun, parts = 0, ''
        number = 0
        in_comment = False
        for number, raw in enumerate(lines, start=1):
            line = raw.strip().upper()
            # A comment of Creo that ends in $ continues in the next line.
            was_comment, in_comment = in_comment, line.endswith('$')
            in_comment = in_comment and (was_comment or '$$->' in line)
            if was_comment:
                continue
            if '$$' in line:
                line = line[: line.index('$$')].rstrip()
            if line.endswith('$'):
                begun = begun or number
                parts += line[:-1] + ' '
                continue
            line, at = (parts + line).strip(), begun or number
            begun, parts = 0, ''
            if line:
                yield at, line
        if begun:
            yield begun, _UNENDED

    def _fault(
        self, message: str, word: str = '', depends_on: DependsOn = DependsOn.LINE
    ) -> ProgramError:
        return ProgramError(message, self.source.name, self.line_number, word[:40], depends_on)

    def _demand(
        self, holds: object, message: str, word: str = '', depends_on: DependsOn = DependsOn.LINE
    ) -> None:
        if not holds:
            raise self._fault(message, word, depends_on)

    def _notice(self, key: str, text: str) -> None:
        self.notices.once(key, self.line_number, f'{key}: {text}')

    def _goto(self, words: tuple[str | None, ...]) -> None:
        unit = self.unit
        x, y, z = (float(word or nan) * unit for word in words[:3])
        if self._frames.is_moved:
            x, y, z = self._frames.point([float(word or nan) for word in words[:3]]) * unit
        if words[3] is not None:
            self.axis = self._unit_vector([float(word or nan) for word in words[3:]], 'GOTO')
        if self._cycle is None:
            self._go(x, y, z)
        else:
            self._drill(self._cycle, np.array([x, y, z]))

    def _drill(self, hole: Hole, place: FloatArray) -> None:
        axis, kept = np.array(self.axis), self.feedrate
        self.feedrate = hole.feed or kept
        higher = cl_words.way_to(np.array(self._point), place, axis, hole.clear)
        first = [] if higher is None or self.targets.empty else [higher]
        for point in (*first, place + hole.clear * axis, place + hole.retract * axis):
            self.rapid = True
            self._go(*point)
        for level, stroke, _, stop in hole.strokes():
            self.rapid = stroke == RAPID
            self._go(*(place + level * axis))
            if stop:
                self.targets.stop_here(stop)
            if stop and hole.dwell:
                self._switch('DWELL', str(hole.dwell))
        self.feedrate, self.rapid = kept, False

    def _go(self, x: float, y: float, z: float) -> None:
        if not max(abs(x), abs(y), abs(z)) <= _FARTHEST:
            raise self._fault('a coordinate beyond 100,000 mm; correct it or UNITS', 'GOTO')
        arc = NO_ARC if self._circle is None else self._arc_to(self._circle, np.array([x, y, z]))
        self._point = x, y, z
        rapid, self.rapid = self.rapid, False
        feedrate = inf if rapid or self.targets.empty else self.feedrate
        if feedrate is None:
            raise self._fault(self.no_feed, 'GOTO', DependsOn.STATE)
        speed = (feedrate, nan, rapid, 0.0)
        self.targets.state = self._state(rapid)
        self.targets.add(
            (
                x,
                y,
                z,
                *self.axis,
                nan,
                nan,
                0.0,
                1.0,
                *speed,
                *self._tolerances,
                self.line_number,
                0.0,
                nan,
                *arc,
                *self.targets.extra_start,
            )
        )

    def _state(self, rapid: bool) -> tuple[float, float, float]:
        unit = 'UNITS/MM' if self.unit == MM else 'UNITS/INCHES'
        words = (*(['RAPID'] if rapid else []), unit, *self._outputs.values())
        number = self.targets.modes.number(words, lambda: ActiveModes(words, *self._tolerances))
        return number, NONE, NONE if self.feedrate is None else self.feedrate

    def _unit_vector(self, numbers: list[float], word: str) -> tuple[float, float, float]:
        i, j, k = self._frames.direction(numbers) if self._frames.is_moved else numbers
        what = 'normal' if word == 'CIRCLE' else 'tool axis'
        length = sqrt(i * i + j * j + k * k)
        if not abs(length - 1.0) <= _UNIT_VECTOR:
            why = f'is not a unit vector, its length is {length:g}; correct i, j, k'
            raise self._fault(f'the {what} {why}', word)
        return i / length, j / length, k / length

    def _other(self, statement: str) -> None:
        self._demand(statement != _UNENDED, 'the file ends inside a continued statement ($)')
        match = _STATEMENT.fullmatch(statement)
        if match is None:
            raise self._fault('not a CL statement; write MAJOR/minor', statement.split()[0])
        major, minor = match[1], (match[2] or match[3] or '').strip()
        if major in cl_words.OUTPUTS:
            self._outputs[major] = statement
            if self._switch(major, minor):
                return
        if major in cl_words.REFUSED and not _ALONG_ARC.fullmatch(statement):
            raise self._fault(cl_words.REFUSED[major], major)
        if major in cl_words.OFF_ONLY and minor not in cl_words.OFF and _moves(minor):
            raise self._fault(cl_words.OFF_ONLY[major], statement)
        if statement.startswith(cl_words.TEXT):
            return
        if act := self._ACTS.get(major):
            act(self, Statement(major, minor, statement))
        elif major.startswith(cl_words.INFORMATION):
            self._notice(cl_words.INFORMATION, 'information of the CAM system, no effect')
        elif major in cl_words.NO_OUTPUT and minor not in cl_words.OFF:
            self._notice(major, cl_words.NO_OUTPUT[major])
        elif major in cl_words.NOTICES:
            self._notice(major, cl_words.NOTICES[major])
        elif major not in cl_words.SILENT:
            raise self._fault(cl_words.UNKNOWN, major)

    def _refuse_point(self, said: Statement) -> None:
        raise self._fault('expected three numbers, or six with the tool axis', said.text)

    def _begin_rapid(self, _: Statement) -> None:
        self.rapid = True
        self._leave_circle()

    def _set_unit(self, said: Statement) -> None:
        self._demand(
            said.minor in cl_words.LENGTH_UNITS,
            'unknown unit; write UNITS/MM or UNITS/INCHES',
            said.text,
        )
        self.unit = cl_words.LENGTH_UNITS[said.minor]

    def _set_axis(self, said: Statement) -> None:
        numbers = self._numbers(said.minor, 3, 'write TLAXIS/i,j,k')
        self.axis = self._unit_vector(numbers, said.major)

    def _go_on_by(self, said: Statement) -> None:
        delta = self._frames.direction(self._numbers(said.minor, 3, 'write GODLTA/dx,dy,dz'))
        self._demand(
            not self.targets.empty,
            'an incremental move before the first point; write FROM or GOTO first',
            said.major,
        )
        self._go(*(at + d * self.unit for at, d in zip(self._point, delta, strict=True)))

    def _set_heading(self, said: Statement) -> None:
        heading = self._numbers(said.minor, 3, 'write INDIRV/i,j,k')
        self._heading = self._frames.direction(heading)

    def _set_cycle(self, said: Statement) -> None:
        ends = said.minor in (*cl_words.OFF, 'INIT', 'CLEAR')
        self._cycle = None if ends else cl_words.cycle_of(said.minor, self.unit, self._fault)
        if self._cycle and self._cycle.rests and 'G4' not in self._signals.words:
            self._notice(said.major, codes.DWELL)

    def _stop(self, said: Statement) -> None:
        kind, text = cl_words.STOPS[said.major]
        if kind > 1.0:
            self.targets.program_stop()
        if self.targets.stands:
            self.targets.waits_first |= kind == AT_M0
            text = codes.WAITS_FIRST if kind == AT_M0 else codes.NOT_YET
        else:
            self.targets.stop_here(kind)
        self._notice(said.major, text)

    def _enter_system(self, said: Statement) -> None:
        """Enter a coordinate system given by numbers, or by a name whose location is unknown."""
        system = system_of(_numbers_of(said.minor))
        other = self._system != said.minor if system is None else moves(system)
        self._demand(not (self._system and other), cl_words.OFF_ONLY['ORIGIN'], said.major)
        if system is None:
            self._system = said.minor
        elif self._frames.enter(system):
            self._notice(
                f'WARNING: {said.major}',
                'points of another coordinate system are converted '
                'to the first one; the part must stay clamped',
            )

    def _cut_into(self, said: Statement) -> None:
        off = said.minor in cl_words.OFF or not _moves(said.minor)
        numbers = IDENTITY if off else re.sub(r'^MATRIX\s*/|[()\s]', '', said.minor)
        if (system := system_of(_numbers_of(numbers))) is None:
            raise self._fault('these numbers do not define a coordinate system', said.major)
        self._frames.cut(system)

    def _index(self, said: Statement) -> None:
        self._demand(said.minor.isdigit(), cl_words.UNKNOWN, said.major)
        self._frames.index(int(said.minor))

    def _copy(self, said: Statement) -> None:
        if not self._frames.copy(said.minor, self._statement):
            raise self._fault(
                'write INDEX/n before and COPY/n,TRANSL,x,y,z,times, or SAME, XYROT', said.major
            )

    def _switch(self, major: str, minor: str) -> bool:
        words, given = cl_words.machine_words(major, minor)
        self._demand(
            not (self._has_macro and 'M6' in words),
            'M6 calls a subprogram on this machine, which CL data cannot do; post it as G-code',
            major,
        )
        if not words or not set(words) <= self._signals.words.keys() | {'T'}:
            return False
        for steps in acting(self._signals, words, given, self._fault):
            for number, value in steps:
                if self._signals.steps[number].rests and not self.targets.stands:
                    self.targets.stop_here()
                self.targets.change((number, value), self.line_number)
        return True

    def _numbers(self, minor: str, count: int, remedy: str) -> list[float]:
        numbers = _numbers_of(minor)
        self._demand(len(numbers) == count, remedy, minor)
        return numbers

    def _begin_circle(self, said: Statement) -> None:
        remedy = f'write CIRCLE/x,y,z,i,j,k,r; {cl_words.LINEAR}'
        numbers = _numbers_of(said.minor)
        # SolidWorks has 6, the others 7, NX with tolerances 11.
        self._demand(len(numbers) in (6, 7, 11), remedy, 'CIRCLE')
        if self._frames.is_moved:
            numbers[:3] = self._frames.point(numbers[:3]).tolist()
        self._demand(
            not self.targets.empty, 'a circle before the first point; write FROM or GOTO', 'CIRCLE'
        )
        normal, here = np.array(self._unit_vector(numbers[3:6], 'CIRCLE')), np.array(self._point)
        circle = _Circle(np.array(numbers[:3]) * self.unit, normal, 0.0)
        circle.radius = numbers[6] * self.unit if len(numbers) > 6 else circle.off(here)
        size, off = max(*np.abs(circle.centre), circle.radius), circle.off(here)
        self._demand(
            size <= _FARTHEST and circle.radius > 0.0,
            'a circle beyond 100,000 mm, or with a radius of zero; correct it',
            'CIRCLE',
        )
        self._demand(
            off <= arcs.allowed_mismatch(np.array(circle.radius)),
            f'the tool is {off / self.unit:.4g} away from this circle; correct '
            'the circle or the previous point',
            'CIRCLE',
            DependsOn.PLACE,
        )
        self._circle = circle

    def _along_arc(self, said: Statement) -> None:
        """Process TLON,GOFWD/(CIRCLE/x,y,z,r),ON,..(LINE/..,end), an arc that follows INDIRV."""
        arc = _ALONG_ARC.fullmatch(said.text)
        assert arc is not None  # others are refused
        numbers = [float(word) for word in arc.groups()]
        centre, end = (
            self._frames.point(place) * self.unit for place in (numbers[:3], numbers[-3:])
        )
        if self._heading is None or self.targets.empty:
            raise self._fault('the direction of the arc is missing; write INDIRV first', 'GOFWD')
        axis = np.array(self.axis)
        turn = float(axis @ np.cross(np.array(self._point) - centre, self._heading))
        self._demand(turn != 0.0, 'INDIRV points at the centre of the arc; correct it', 'GOFWD')
        normal = axis * np.copysign(1.0, turn)
        words = [*(centre / self.unit), *normal, numbers[3]]
        circle = ','.join(f'{word:.12f}' for word in words)
        self._begin_circle(Statement('CIRCLE', circle, said.text))
        self._go(*end)
        self._circle = self._heading = None

    def _leave_circle(self) -> None:
        if self._circle is not None and self._circle.turned > 0.0:
            self._circle = None

    def _arc_to(self, circle: _Circle, end: FloatArray) -> tuple[float, ...]:
        first, start = circle.turned == 0.0, np.array(self._point)
        before, after, off = circle.across(start), circle.across(end), circle.off(end)
        allowed = float(arcs.allowed_mismatch(np.array(circle.radius)))
        about = float(circle.normal @ np.cross(before, after))
        angle = float(np.arctan2(about, before @ after)) % (2.0 * pi)
        if first and min(angle, 2.0 * pi - angle) < _SAME_ANGLE:
            angle = 2.0 * pi
        rise = float((end - start) @ circle.normal)
        if first:
            if not off <= allowed:
                away = f'this point is {off / self.unit:.4g} away'
                raise self._fault(f'{away} from its circle; correct it', 'GOTO', DependsOn.PLACE)
            circle.pitch = rise / angle
        elif (
            off > allowed
            or abs(rise - circle.pitch * angle) > allowed
            or circle.turned + angle > 2.0 * pi + _SAME_ANGLE
        ):
            self._circle = None
            return NO_ARC
        circle.turned += angle
        return (*circle.centre, *circle.normal, angle)

    def _begin_at(self, said: Statement) -> None:
        match = _GOTO.fullmatch('GOTO/' + said.minor)
        if match is None:
            raise self._fault(
                'expected three numbers, or six with the tool axis', f'FROM/{said.minor}'
            )
        if self.targets.empty:
            self._goto(match.groups())

    def _set_feed(self, said: Statement) -> None:
        self._leave_circle()
        words = said.minor.replace(',', ' ').split()
        numbers = [word for word in words if re.fullmatch(_NUMBER, word)]
        units = [word for word in words if word not in numbers]
        self._demand(
            not any(word in ('MMPR', 'IPR', 'PERREV') for word in units),
            'feed per revolution is not supported yet; use MMPM',
            said.text,
        )
        self._demand(
            len(numbers) == 1 and all(word in cl_words.FEED_UNITS for word in units),
            'write FEDRAT/value,MMPM or FEDRAT/value,IPM',
            said.text,
        )
        value = float(numbers[0])
        self._demand(0.0 < value < inf, 'the feedrate must be greater than zero', said.text)
        unit = (cl_words.FEED_UNITS[units[0]] if units else 0.0) or self.unit
        self.feedrate = value * unit / MINUTE

    _ACTS: ClassVar[dict[str, Callable[[ClReader, Statement], None]]] = {
        'GOTO': _refuse_point,
        'FROM': _begin_at,
        'RAPID': _begin_rapid,
        'FEDRAT': _set_feed,
        **dict.fromkeys(('UNITS', 'UNIT'), _set_unit),
        'TLAXIS': _set_axis,
        'GODLTA': _go_on_by,
        'CIRCLE': _begin_circle,
        'INDIRV': _set_heading,
        **dict.fromkeys(('TLON', 'GOFWD'), _along_arc),
        'CYCLE': _set_cycle,
        **dict.fromkeys(cl_words.STOPS, _stop),
        **dict.fromkeys(('MSYS', 'CSYS'), _enter_system),
        'TRACUT': _cut_into,
        'INDEX': _index,
        'COPY': _copy,
    }
