"""Heidenhain plain text: its lines are converted to words that the G-code reader executes."""

import re
from cmath import exp, phase
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from cnc_interp.core import DEG, INCH, MINUTE, MM, DependsOn, FloatArray
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.setting_words import tolerances
from cnc_interp.program.geometry.arcs import PLANES, Corner
from cnc_interp.program.job import Tool
from cnc_interp.program.motion.block_motion import NO_CORNER
from cnc_interp.program.readers.heidenhain_frames import HeidenhainFrames
from cnc_interp.program.readers.heidenhain_holes import HeidenhainHoles
from cnc_interp.program.readers.heidenhain_words import (
    AS_CODES,
    CALL,
    CALL_FILE,
    CONDITIONS,
    CORNER,
    CYCLE,
    DECIMAL_COMMA,
    FN,
    HEAD,
    IDLE_M,
    JUMP,
    LABEL,
    OWN_M,
    PLANE,
    REFUSED_M,
    SCALES,
    SET,
    SETTING,
    TOOL_CALL,
    TURNING,
    WORD,
)
from cnc_interp.program.readers.program_reader import ProgramReader
from cnc_interp.program.text.cursor import Loop
from cnc_interp.program.text.expressions import OPERATORS, ExpressionError, formula
from cnc_interp.program.text.source import LineStart
from cnc_interp.program.text.words import BlockWords

#: Pattern of a line, and its function.
_Form = tuple[re.Pattern[str], Callable[['HeidenhainReader', re.Match[str]], None]]


class HeidenhainReader(ProgramReader):
    def __init__(self, at: Execution):
        super().__init__(at)
        self.variables = at.variables
        self.centre = 0j  # CC in the plane [m]
        self.heading: complex | None = None  # of the last motion at its end, in the plane
        self.shortest = False  # M126
        self.modal_cycle = False  # M89
        self.defining = False  # whether lines with Q belong to the cycle before
        self.in_comment = False  # whether a comment continues from the previous line
        self._frames = HeidenhainFrames(self.mover, at.plane)
        self._holes = HeidenhainHoles(at, self.execute)

    def read_lines(self, first: int, end: int) -> None:
        for row in range(first, end):
            self.flow.row, self.flow.jumped = row, False
            self.read_line(self.flow.window.line(row))
            if self.flow.ended or self.flow.jumped:
                return
        self.flow.row = end

    def read_line(self, raw: str) -> None:
        text = raw.upper().split(';')[0] if '"' not in raw else raw.upper()
        if raw.lstrip().startswith('/') and self.settings.skip_blocks:
            return
        match = HEAD.fullmatch(DECIMAL_COMMA.sub('.', text))
        line = match[1] if match else ''
        numbered = bool(re.match(r'\s*/?\s*\d', raw))
        goes_on = raw.rstrip().endswith('~')  # a comment, or a cycle, in the next line
        if not line or (self.in_comment and not numbered):
            self.in_comment = goes_on
            return
        try:
            if self.defining and not numbered and self._assign(line):
                return
            self.defining = False
            self.in_flow = True
            passed = self._passes(line, self._FLOW)
            self.in_flow = False
            if not passed and not self._passes(line, self._STATEMENTS):
                raise self.fault(
                    'this word of Heidenhain is not supported; post it as L and C',
                    line[:20],
                    DependsOn.LINE,
                )
        except ExpressionError as problem:
            raise self.fault(str(problem), line[:20]) from None
        finally:
            self.in_comment = goes_on and numbered and ';' in raw and not self.defining

    def _value(self, text: str) -> float:
        return formula(text, self.variables)

    def _number(self, text: str) -> float:
        try:
            return float(text)
        except ValueError:
            raise self.fault(
                'not a number; write digits with one point, such as 0.5', text, DependsOn.LINE
            ) from None

    def _passes(self, line: str, forms: tuple[_Form, ...]) -> bool:
        """Execute a line in one of several forms; return False if it has another form."""
        for pattern, act in forms:
            if match := pattern.fullmatch(line):
                act(self, match)
                return True
        return False

    def _assign(self, line: str) -> bool:
        return self._passes(line, ((SET, HeidenhainReader._set),))

    def _set(self, match: re.Match[str]) -> None:
        rapid = self.defining and match[2] in ('MAX', 'FMAX')
        self.variables.set_name(match[1], np.inf if rapid else self._value(match[2]))

    def _pass_label(self, match: re.Match[str]) -> None:
        if match[1] == '0' and self.flow.depth:
            self.flow.leave()

    def _call_file(self, match: re.Match[str]) -> None:
        self.flow.call_file(match[1], 1)

    def _end(self, _: re.Match[str]) -> None:
        if self.flow.depth and self.flow.source is not self.flow.main:
            self.flow.leave()
        else:
            self.flow.ended = self.at.finished = True

    def _pattern(self, label: str) -> bytes:
        number = rb'0*%d(?!\d)' % int(label) if label.isdigit() else re.escape(label.encode())
        return rb'(?:\d+\s+)?LBL\s*' + number

    def _label(self, label: str) -> LineStart:
        source = self.flow.source
        pattern = re.compile(rb'(?mi)^[ \t/]*' + self._pattern(label))
        place = source.find(pattern, source.start)
        if place is None:
            raise self.fault('no such label; correct it', f'LBL {label}')
        return place

    def _call(self, match: re.Match[str]) -> None:
        flow, (label, repeats) = self.flow, match.groups()
        if repeats is None:
            flow.call(f'LBL {label}', self._pattern(label), 1, {}, own_variables=False)
            return
        key = f'LBL {label} {flow.line_number}'
        if not (flow.loops and flow.loops[-1].label == key):
            flow.loops.append(Loop(key, self._label(label), int(repeats)))
        loop = flow.loops[-1]
        if loop.rounds > 0:
            loop.rounds -= 1
            flow.back_or_on(loop.begin)
        else:
            flow.loops.pop()

    def _function(self, match: re.Match[str]) -> None:
        number, rest = int(match[1]), match[2]
        if sign := CONDITIONS.get(number):
            jump = JUMP.fullmatch(rest)
            if jump is None:
                raise self.fault('write IF +Q1 EQU +Q2 GOTO LBL 1', f'FN {number}')
            if OPERATORS[sign](self._value(jump[1]), self._value(jump[3])):
                place = self._label(jump[4])
                self.flow.loops.clear()
                self.flow.back_or_on(place)
        elif number > 13 or not self._assign(rest):
            raise self.fault(
                'only FN 0 to FN 13 without SYSREAD are supported', f'FN {number}', DependsOn.LINE
            )

    def _begin(self, match: re.Match[str]) -> None:
        self.mover.unit = INCH if match[1] else MM

    def _idle(self, _: re.Match[str]) -> None:
        """Skip a line without effect."""

    def _stop(self, match: re.Match[str]) -> None:
        self._move('L', match[1], stop='M0')

    def _call_cycle(self, match: re.Match[str]) -> None:
        self._move('L', match[1])
        self._holes.drill()

    def _switch_tcp(self, match: re.Match[str]) -> None:
        self.refuse_if(
            not match[1] and 'SPAT' in match[2],
            'angles in space are not supported; post with AXIS POS',
            'TCPM',
            DependsOn.LINE,
        )
        self.execute(BlockWords(m=['M129' if match[1] else 'M128']))

    def _corner(self, match: re.Match[str]) -> None:
        # The previous line has already read it.
        self.demand(
            self.mover.held is not None,
            'belongs between two lines, L or LP, in the plane',
            match[1],
        )

    def _motion(self, match: re.Match[str]) -> None:
        self._move(match[1], match[2])

    def _line(self, match: re.Match[str]) -> None:
        """Process a line along one axis, or without motion."""
        self._move('L', match[0])

    def _words(self, text: str) -> tuple[dict[str, float], list[str], str]:
        values: dict[str, float] = {}
        found: list[str] = []
        turn, at = '', 0
        while at < len(text):
            match = WORD.match(text, at)
            if match is None:
                raise self.fault(
                    'this word is not supported here', text[at:].split()[0], DependsOn.LINE
                )
            at = match.end()
            if match['code'] or match['radius']:
                found.append(f'M{int(match["code"][1:])}' if match['code'] else match['radius'])
            elif match['max']:
                word = match['max']
                found.append('FMAX' if 'MAX' in word and word[0] == 'F' else word[:2])
            elif match['dr']:
                turn = match['sign']
            elif match['name']:
                values[match['name']] = self._value(match['value'].replace(' ', ''))
        return values, found, turn

    def _move(self, kind: str, text: str, stop: str = '') -> None:
        values, found, turn = self._words(text)
        if kind == 'CC':
            centre, given, unit = self.mover.here(), self._place(values), self.mover.unit
            for letter in {'X', 'Y', 'Z'} & given.keys():
                centre['XYZ'.index(letter)] = given[letter] * unit
            self.centre = self._flat(centre)
            return
        if 'M140' in found:
            found.remove('M140')
            size, feed, back = self.mover.unit, values.pop('F', 0.0), values.pop('MB', 0.0)
            self.refuse_if(
                self._place(values) or ('MB' not in found and not back > 0.0),
                'write a block of its own, M140 MB MAX or M140 MB 50',
                'M140',
            )
            self.mover.draw_back(back * size if back else None, feed * size / MINUTE)
            found = [word for word in found if word != 'MB']
        words = BlockWords(m=[code for code in found if code[0] == 'M'] + ([stop] if stop else []))
        drills = 'M99' in words.m
        self._machine_words(words, values, found)
        place = self._place(values)
        if kind == 'LP' or kind == 'CP':
            self._polar(values, place, kind == 'CP', words, turn)
        for letter, value in place.items():
            words.put(letter, value)
        if 'F' in values and 'M128' not in words.m:
            words.put('F', values['F'])
        for name, letter in (('TX', 'A3'), ('TY', 'B3'), ('TZ', 'C3')):
            if name in values:
                words.sets.append((letter, values[name]))
        self.refuse_if(
            kind == 'LN' and not words.sets and self.mover.tcp,
            'the tool direction is missing; post TX TY TZ',
            'LN',
        )
        moves = bool(place or words.sets)
        if moves:
            words.g.insert(0, 'G0' if 'FMAX' in found else 'G1')
        if kind in ('C', 'CP', 'CR', 'CT'):
            self.refuse_if(
                kind != 'CT' and not turn, 'the direction is missing; write DR+ or DR-', kind
            )
            words.g[:1] = [self._arc(kind, values, words, turn)]
        self._frames.before(place.keys(), 'G53' in words.g)
        start = self._flat(self.mover.here())
        straight = moves and kind in ('L', 'LP')
        if straight and words.g[0] != 'G0':
            self.mover.corner = self._coming_corner()
        self.execute(words)
        self._frames.after()
        if straight:
            way = self._flat(self.mover.here()) - start
            self.heading = way / abs(way) if abs(way) > 1e-9 else self.heading
        if drills or (self.modal_cycle and place and kind in ('L', 'LP')):
            self._holes.drill()

    def _machine_words(
        self, words: BlockWords, values: dict[str, float], found: list[str]
    ) -> None:
        for code in words.m[:]:
            self.demand(
                code not in REFUSED_M,
                REFUSED_M.get(code, ''),
                code,
                DependsOn.LINE,
            )
            if code in IDLE_M or code in OWN_M:
                words.m.remove(code)
            if code in IDLE_M:
                self.notice(code, 'no effect, it does not move the tool')
            elif code in ('M126', 'M127'):
                self.shortest = code == 'M126'
            elif code in ('M89', 'M99'):
                self.modal_cycle = code == 'M89'
            for other in AS_CODES.get(code, ()):
                (words.g if other[0] == 'G' else words.m).append(other)
        for word in found:
            if word in ('R0', 'R') and self.mover.radius_code:
                words.g.append('G40')
            elif word in ('RL', 'RR') and self.mover.radius_code != f'G4{1 + (word == "RR")}':
                words.g.append(f'G4{1 + (word == "RR")}')
        self.refuse_if(
            'DR' in values or 'DL' in values, 'is allowed in TOOL CALL only', 'DR', DependsOn.LINE
        )
        if self.shortest:
            words.ways |= dict.fromkeys(self.mover.rotary_letters, 'DC')

    def _place(self, values: dict[str, float]) -> dict[str, float]:
        found = {letter: values[letter] for letter in 'XYZABCUVW' if letter in values}
        for letter, here in self.mover.in_words(self.mover.here()).items():
            if f'I{letter}' in values:
                found[letter] = here + values[f'I{letter}']
        return found

    def _flat(self, point: FloatArray) -> complex:
        a, b, _ = PLANES[self.mover.plane]
        return complex(point[a], point[b])

    def _polar(
        self,
        values: dict[str, float],
        place: dict[str, float],
        on_arc: bool,
        words: BlockWords,
        turn: str,
    ) -> None:
        unit, arm = self.mover.unit, self._flat(self.mover.here()) - self.centre
        radius, angle = abs(arm), phase(arm)
        if 'PR' in values:
            radius = values['PR'] * unit
        radius += values.get('IPR', 0.0) * unit
        if 'PA' in values:
            angle = values['PA'] * DEG
        if 'IPA' in values:
            angle += values['IPA'] * DEG
            whole = abs(values['IPA']) / 360.0
            if on_arc and whole > 1.0 + 1e-9:
                turns = int(np.ceil(whole - 1e-9))
                words.put('P', float(turns), f'IPA{values["IPA"]:g}')
            self.refuse_if(
                on_arc and turn and (values['IPA'] < 0.0) != (turn == '-'),
                'IPA and DR turn in different directions; correct one',
                'CP',
            )
        end = self.centre + radius * exp(1j * angle)
        a, b, _ = PLANES[self.mover.plane]
        place['XYZ'[a]], place['XYZ'[b]] = end.real / unit, end.imag / unit

    def _arc(self, kind: str, values: dict[str, float], words: BlockWords, turn: str) -> str:
        a, b, _ = PLANES[self.mover.plane]
        unit, start = self.mover.unit, self._flat(self.mover.here())
        if kind == 'CR':
            self.demand('R' in values, 'the radius is missing; write R', 'CR')
            words.put('R', values['R'])
            self.heading = None
            return 'G3' if turn == '+' else 'G2'
        centre, ccw = self.centre, turn == '+'
        here = self.mover.here()
        end = complex(*(words.values.get('XYZ'[i], here[i] / unit) * unit for i in (a, b)))
        if kind == 'CT':
            if self.heading is None or abs(end - start) < 1e-9:
                raise self.fault('CT needs a preceding line or arc about CC', 'CT')
            side = ((end - start) * self.heading.conjugate()).imag
            self.demand(abs(side) >= 1e-9, 'the end lies on the tangent; write L', 'CT')
            ccw = side > 0.0
            centre = start + abs(end - start) ** 2 / (2.0 * side) * 1j * self.heading
        arm = end - centre
        self.heading = arm / abs(arm) * (1j if ccw else -1j) if abs(arm) > 1e-9 else None
        for letter, value in zip(('IJK'[a], 'IJK'[b]), (centre.real, centre.imag), strict=True):
            words.put(letter, value / unit, f'CC {value / unit:g}')
            words.ways[letter] = 'AC'
        return 'G3' if ccw else 'G2'

    def _coming_corner(self) -> Corner:
        place = self.flow.window.place(self.flow.row + 1)
        text = HEAD.fullmatch(self.flow.source.line_at(place).upper().split(';')[0])
        match = CORNER.fullmatch(text[1]) if text else None
        if match is None:
            return NO_CORNER
        kind = 'CHR' if match[1] == 'CHF' else 'RND'  # CHF is measured along the lines here
        return Corner(kind, self._value(match[2]) * self.mover.unit)

    def _tool_call(self, match: re.Match[str]) -> None:
        number, named = match[2], (match[1] or '').strip('"')
        values, _, _ = self._words(match[4])
        self.demand(
            not any(values.get(name) for name in ('DL', 'DR', 'DR2')),
            'DL and DR are not supported; put them into the setup',
            'TOOL CALL',
            DependsOn.LINE,
        )
        words = BlockWords(g=[{'Z': 'G17', 'Y': 'G18', 'X': 'G19'}[match[3] or 'Z']])
        tools = self.mover.setup.tools
        if named:
            number = next((str(n) for n in tools if tools[n].remark.upper() == named), None)
            if number is None and tools:
                raise self.fault('no tool of the setup has this name as its remark', named)
            words.m.append('M6')
        if number is not None:
            words.put('T', float(number), f'TOOL CALL {number}')
            words.m[:] = ['M6']
            if tools or int(number) == 0:
                words.g.append('G43' if int(number) else 'G49')
        for name in 'SF':
            if name in values:
                words.put(name, values[name])
        self.execute(words)
        tool, unit = self.mover.setup.tools.get(self.at.tool, Tool()).worn, self.mover.unit
        for name, size in (('Q108', tool.radius), ('Q114', tool.length)):
            self.variables.set_name(name, size / unit)

    def _define_cycle(self, match: re.Match[str]) -> None:
        number, part, rest = int(match[1]), match[2], match[3]
        define = self._CYCLES.get(number)
        if define is None or (number in self._OF_PARTS and not part):
            raise self.fault(
                'this cycle is not supported; post it as L and C',
                f'CYCL DEF {number}',
                DependsOn.LINE,
            )
        define(self, number, part, rest)

    def _define_frame(self, number: int, part: str, rest: str) -> None:
        frames = self._frames
        if part == '0':
            frames.angles = {}
            return
        act = {7: frames.shift, 10: frames.rotate, 19: frames.add_angles}[number]
        act(self._words(rest)[0])

    def _define_scale(self, number: int, part: str, rest: str) -> None:
        if part == '0':
            return
        words = SCALES.findall(rest)
        left = SCALES.sub('', rest).strip()
        self.demand(not left, 'this word is not supported here', left, DependsOn.LINE)
        frames = self._frames
        act = {8: frames.mirror, 11: frames.scale_all, 26: frames.scale_axes}[number]
        act({name: self._value(value or '0') for name, value in words})

    def _define_dwell(self, _: int, part: str | None, rest: str) -> None:
        if part != '0':
            self.mover.targets.stop_here()
            found = re.search(r'([\d.]+)\s*$', rest)
            self.at.rest_for('CYCL DEF 9', self._number(found[1]) if found else 0.0)

    def _define_tolerance(self, _: int, __: str | None, rest: str) -> None:
        if told := re.match(r'(?:T|TOL\w*)\s*([\d.]+)', rest):
            tolerances(self.at, 'CYCL DEF 32', self._number(told[1]) or None, None)

    def _define_setting(self, number: int, *_: object) -> None:
        if number in SETTING:
            self.defining = True
            self.notice(f'CYCL DEF {number}', SETTING[number])

    def _define_hole(self, number: int, part: str | None, rest: str) -> None:
        self.defining = number >= 200
        self._holes.define(number, part, rest)

    def _tilt(self, match: re.Match[str]) -> None:
        kind, rest = match.groups()
        how = {name for found in TURNING.finditer(rest) for name in found.groups() if name}
        values, _, _ = self._words(TURNING.sub(' ', rest))
        choice = 1 if '+' in how else 2 if '-' in how else 0
        way = next((word for word in ('MOVE', 'TURN', 'STAY') if word in how), '')
        self._frames.tilt(kind, values, way, choice, 'TABLE' in how)
        for letter, angle in zip(self.mover.rotary_letters, self._frames.found, strict=False):
            self.variables.set_name(f'Q12{"ABC".index(letter)}', angle / DEG)

    #: Functions that define each cycle; cycles of older controls have a line for each part.
    _OF_PARTS: ClassVar = {7, 8, 10, 11, 19, 26}
    _CYCLES: ClassVar[dict[int, Callable[..., None]]] = {
        **dict.fromkeys((7, 10, 19), _define_frame),
        **dict.fromkeys((8, 11, 26), _define_scale),
        **dict.fromkeys((12, 13, *SETTING), _define_setting),
        **dict.fromkeys((1, 2, 240, *range(200, 209)), _define_hole),
        9: _define_dwell,
        32: _define_tolerance,
    }
    #: Functions of the line patterns: those that change the order of lines, and all others.
    _FLOW: ClassVar[tuple[_Form, ...]] = (
        (LABEL, _pass_label),
        (CALL, _call),
        (CALL_FILE, _call_file),
        (FN, _function),
        (SET, _set),
        (re.compile(r'END PGM.*'), _end),
    )
    _STATEMENTS: ClassVar[tuple[_Form, ...]] = (
        (re.compile(r'BEGIN PGM(?:.*\b(IN(?:CH)?)|.*)'), _begin),
        (CYCLE, _define_cycle),
        (TOOL_CALL, _tool_call),
        (PLANE, _tilt),
        (re.compile(r'(?:BLK FORM|TOOL DEF|\*|PRINT|STRUCTURE).*'), _idle),
        (re.compile(r'STOP\s*(.*)'), _stop),
        (re.compile(r'CYCL\s+CALL\s*(?:POS)?\s*(.*)'), _call_cycle),
        (re.compile(r'FUNCTION\s+(RESET\s+)?TCPM\b(.*)'), _switch_tcp),
        (CORNER, _corner),
        (re.compile(r'(LN|LP|L|CC|CP|CR|CT|C)(?![A-Z])\s*(.*)'), _motion),
        (re.compile(r'(?:I?[XYZABCUVW]\s*[-+Q\d.]|R[0LR]?\s|[SMF]\s*(?:\d|MAX|$)).*'), _line),
    )
