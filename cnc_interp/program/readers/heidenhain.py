"""Heidenhain plain text: its lines become words that the reader of G-code executes."""

import re
from cmath import exp, phase
from collections.abc import Callable
from typing import ClassVar

import numpy as np

from cnc_interp.core import DEG, INCH, MINUTE, MM, DependsOn, FloatArray
from cnc_interp.program.execution.context import Execution
from cnc_interp.program.execution.setting_words import tolerances
from cnc_interp.program.execution.setup_words import cutter_of
from cnc_interp.program.geometry.arcs import PLANES, Corner
from cnc_interp.program.job import Tool
from cnc_interp.program.motion.block_motion import NO_CORNER
from cnc_interp.program.motion.cycles import Hole, dwell_of, go_along, make_hole, pecks_of
from cnc_interp.program.readers.heidenhain_frames import HeidenhainFrames
from cnc_interp.program.readers.program_reader import ProgramReader
from cnc_interp.program.text.cursor import Loop
from cnc_interp.program.text.expressions import OPERATORS, ExpressionError, formula
from cnc_interp.program.text.source import LineStart
from cnc_interp.program.text.words import BlockWords

_DECIMAL_COMMA = re.compile(r'(?<=\d),(?=\d)')  #: Older controls write X+10,5.
_HEAD = re.compile(r'\s*/?\s*(?:\d+(?=\s|$))?\s*(.*?)\s*~?\s*$')
_VALUE = r'[-+]?\s*(?:Q[LR]?\d+|\d+\.?\d*|\.\d+)'
_WORD = re.compile(
    rf'(?P<code>M\d+)\b\.?|(?P<max>FMAX|F\s+MAX|F?AUTO|MB\s*MAX)|(?P<dr>DR)\s*(?P<sign>[-+])(?!\d)|(?P<radius>R[0LR](?![\d.])|R(?=\s|$))|'
    rf'(?P<name>I?(?:X|Y|Z|A|B|C|U|V|W)|I?P[AR]|[NT][XYZ]|SP[ABC]|[BN][XYZ]|EUL(?:PR|NU|ROT)|PRO(?:PR|MIN)|I?ROT|DL|DR2?|MB|LA|F|R|S)'
    rf'\s*=?\s*(?P<value>{_VALUE})|(?P<bare>[MF])(?=\s|$)|(?P<space>\s+)'
)
_TOOL_CALL = re.compile(r'TOOL\s+CALL\s*(?:("[^"]*")|(\d+))?\s*([XYZ])?\s*(.*)')
_LABEL = re.compile(r'LBL\s*(\d+|"[^"]+"|[A-Z]\w*)')
_CALL = re.compile(r'CALL\s+LBL\s*(\d+|"[^"]+"|[A-Z]\w*)\s*(?:REP\s*(\d+)\s*(?:/\s*\d+)?)?')
_CALL_FILE = re.compile(r'CALL\s+PGM\s+(?:\S*[\\/])?([\w-]+?)(?:\.H)?')
_CYCLE = re.compile(r'CYCLE?\s+DEF\s*(\d+)(?:\.(\d+))?\s*(.*)')
_SCALES = re.compile(rf'(SCL|(?:CC)?[XYZ])\s*=?\s*({_VALUE})?')
_FN = re.compile(r'FN\s*(\d+)\s*:\s*(.*)')
_JUMP = re.compile(rf'IF\s*({_VALUE})\s*([A-Z]+)\s*({_VALUE})\s*GOTO\s*LBL\s*(\d+|"[^"]+"|\w+)')
_CORNER = re.compile(rf'(RND|CHF)\s*R?\s*({_VALUE})\s*(?:F.*)?')
_SET = re.compile(r'(Q[LR]?\d+)\s*=\s*(.*)')
_PLANE = re.compile(r'PLANE\s+(\w+)\s*(.*)')
_TURNING = re.compile(
    r'\b(?:(MOVE|TURN|STAY)|SEQ\s*([-+])|DIST\s*[-+]?[\d.]+|(COORD|TABLE)\s+ROT|'
    r'F\s*MAX|F\s*[\d.]+|MB\s*[\d.]+)'
)
#: Cycles that set something, and what it means here.
_SETTING = {
    247: 'the datum is that of the work offset that is active',
    239: 'the load has no effect',
    392: 'the tuning has no effect',
}
_CONDITIONS = {9: '==', 10: '<>', 11: '>', 12: '<'}  #: Of FN 9 to FN 12.
_IDLE_M = {
    'M94',
    'M97',
    'M98',
    'M101',
    'M102',
    'M103',
    'M107',
    'M108',
    'M109',
    'M110',
    'M111',
    'M116',
    'M117',
    'M120',
    'M124',
    'M138',
    'M141',
    'M143',
    'M148',
    'M149',
}
#: Those that mean something here only.
_OWN_M = {'M13', 'M14', 'M89', 'M91', 'M99', 'M126', 'M127', 'M136', 'M137'}
#: Those that say what codes of G-code do.
_AS_CODES = {
    'M91': ['G53'],
    'M136': ['G95'],
    'M137': ['G94'],
    'M13': ['M3', 'M8'],
    'M14': ['M4', 'M8'],
}
_REFUSED_M = {
    **dict.fromkeys(
        ('M112', 'M114', 'M118', 'M130', 'M144', 'M150'),
        'this M code is not supported; post without it',
    ),
    'M92': 'counts from a point that the machine builder has set; post with M91',
}
#: Where the tool of cycle 204 moves aside, by Q214; a smaller circle is none [m].
_SIDES, _SAME = {1.0: (-1, 0), 2.0: (0, -1), 3.0: (1, 0), 4.0: (0, 1)}, 1e-9
#: How near the tool comes to the last peck, and how far it goes back to break a chip [m].
_NEAR, _BREAK = 0.6 * MM, 0.2 * MM


#: A form of a line, and what it does.
_Form = tuple[re.Pattern[str], Callable[['HeidenhainReader', re.Match[str]], None]]


class HeidenhainReader(ProgramReader):
    def __init__(self, at: Execution):
        super().__init__(at)
        self.variables = at.variables
        self.centre = 0j  # CC in the plane [m]
        self.heading: complex | None = None  # of the last motion at its end, in the plane
        self.shortest = False  # M126
        self.modal_cycle = False  # M89
        self.cycle = 0  # number of the cycle that is defined
        self.defining = False  # whether lines with Q belong to the cycle before
        self.in_comment = False  # whether the line before was one that goes on
        self._frames = HeidenhainFrames(self.mover, at.plane)

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
        match = _HEAD.fullmatch(_DECIMAL_COMMA.sub('.', text))
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
                'not a number; write digits with one point, as 0.5', text, DependsOn.LINE
            ) from None

    def _passes(self, line: str, forms: tuple[_Form, ...]) -> bool:
        """Execute a line that has one of some forms; False if it has none of them."""
        for pattern, act in forms:
            if match := pattern.fullmatch(line):
                act(self, match)
                return True
        return False

    def _assign(self, line: str) -> bool:
        return self._passes(line, ((_SET, HeidenhainReader._set),))

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
        if sign := _CONDITIONS.get(number):
            jump = _JUMP.fullmatch(rest)
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
        """Pass a line that moves nothing."""

    def _stop(self, match: re.Match[str]) -> None:
        self._move('L', match[1], stop='M0')

    def _call_cycle(self, match: re.Match[str]) -> None:
        self._move('L', match[1])
        self._drill()

    def _switch_tcp(self, match: re.Match[str]) -> None:
        self.refuse_if(
            not match[1] and 'SPAT' in match[2],
            'angles in space are not supported; post with AXIS POS',
            'TCPM',
            DependsOn.LINE,
        )
        self.execute(BlockWords(m=['M129' if match[1] else 'M128']))

    def _corner(self, match: re.Match[str]) -> None:
        # The line before has looked for it.
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
            match = _WORD.match(text, at)
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
            self._drill()

    def _machine_words(
        self, words: BlockWords, values: dict[str, float], found: list[str]
    ) -> None:
        for code in words.m[:]:
            self.demand(
                code not in _REFUSED_M,
                _REFUSED_M.get(code, ''),
                code,
                DependsOn.LINE,
            )
            if code in _IDLE_M or code in _OWN_M:
                words.m.remove(code)
            if code in _IDLE_M:
                self.notice(code, 'no effect, it does not move the tool')
            elif code in ('M126', 'M127'):
                self.shortest = code == 'M126'
            elif code in ('M89', 'M99'):
                self.modal_cycle = code == 'M89'
            for other in _AS_CODES.get(code, ()):
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
                raise self.fault('CT needs a line or an arc about CC before', 'CT')
            side = ((end - start) * self.heading.conjugate()).imag
            self.demand(abs(side) >= 1e-9, 'the end lies on the line before; write L', 'CT')
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
        text = _HEAD.fullmatch(self.flow.source.line_at(place).upper().split(';')[0])
        match = _CORNER.fullmatch(text[1]) if text else None
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
        words = _SCALES.findall(rest)
        left = _SCALES.sub('', rest).strip()
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
        if number in _SETTING:
            self.defining = True
            self.notice(f'CYCL DEF {number}', _SETTING[number])

    def _define_hole(self, number: int, part: str | None, rest: str) -> None:
        self.cycle, self.defining = number, number >= 200
        self._old_cycle(part, rest)

    def _old_cycle(self, part: str | None, rest: str) -> None:
        names = {'SET UP': 'Q200', 'DEPTH': 'Q201', 'PECKG': 'Q202', 'DWELL': 'Q211', 'F': 'Q206'}
        if part == '0':
            for name in ('Q203', 'Q204', 'Q210', 'Q211', 'Q202'):
                self.variables.set_name(name, 0.0)
        for word, name in names.items():
            if part not in (None, '0') and (found := re.fullmatch(rf'{word}\s*(\S+)', rest)):
                self.variables.set_name(name, self._value(found[1]))

    def _drill(self) -> None:
        mover, unit, axis = self.mover, self.mover.unit, PLANES[self.mover.plane][2]
        self.demand(self.cycle, 'no cycle is defined; write CYCL DEF', 'CYCL CALL')
        if mover.frames.factor[axis] < 0.0 or self.cycle in (204, 208):
            mover.demand_no_scale(f'CYCL DEF {self.cycle}')

        def of(name: str) -> float:
            return self.variables.named(name) if self.variables.exists(name) else 0.0

        if self.cycle in (204, 208):
            self._bore(of)
            return
        self.refuse_if(
            self.cycle == 240 and of('Q343'),
            'a depth by the diameter is not supported; write Q201',
            'Q343',
        )
        surface = of('Q203') * unit if self.cycle >= 200 else float(mover.here()[axis])
        if self.cycle < 200:
            surface -= of('Q200') * unit  # the tool stands on the clearance
        bottom, retract = surface + of('Q201') * unit, surface + of('Q200') * unit
        self.demand(
            bottom < retract, 'the depth Q201 must be below the surface', f'CYCL DEF {self.cycle}'
        )
        clear, step = surface + max(of('Q204'), of('Q200')) * unit, of('Q202') * unit
        pecks: list[float] = []
        if self.cycle in (1, 200, 203, 205) and step > 0.0:
            less, least = of('Q212') * unit, of('Q205') * unit
            pecks = pecks_of(
                surface,
                bottom,
                step,
                lambda text: self.fault(text, 'Q202'),
                lambda stroke, _: max(stroke - less, least, 1e-6),
            )
        taps = self.cycle in (2, 206, 207)
        if taps:
            mover.tell_tapping(f'CYCL DEF {self.cycle}')
        reams = self.cycle == 201 and of('Q208') < np.inf
        breaks = self.cycle in (203, 205) and (of('Q213') > 0.0 or of('Q257') > 0.0)
        here = mover.here()
        go_along(mover, here, axis, retract, feed_given=True)
        feed = of('Q206') * unit / MINUTE
        if self.cycle == 207:
            feed = abs(of('Q239')) * unit * mover.spindle_speed / MINUTE
        hole = Hole(
            retract,
            bottom,
            clear,
            pecks,
            breaks,
            of('Q256') * unit or _BREAK if breaks else _NEAR,
            rests=of('Q211') > 0.0 or taps,
            dwell=dwell_of(mover, f'CYCL DEF {self.cycle}', of('Q211')),
            out=retract if taps or reams else None,
            feed=feed,
            feed_out=of('Q208') * unit / MINUTE if reams else None,
            reverse=('M3' if of('Q239') < 0.0 else 'M4') if taps else '',
        )
        make_hole(mover, hole, here, axis)

    def _bore(self, of: Callable[[str], float]) -> None:
        """Bore back (204), the tool beside the axis on its way; mill a hole (208)."""
        mover, unit, (a, b, axis) = self.mover, self.mover.unit, PLANES[self.mover.plane]
        name, kept, here = f'CYCL DEF {self.cycle}', mover.feedrate, mover.here()
        surface, gap = of('Q203') * unit, of('Q200') * unit
        retract, clear = surface + gap, surface + max(of('Q204') * unit, gap)

        def go(place: FloatArray, level: float, feed: str = '') -> None:
            mover.feedrate = of(feed) * unit / MINUTE if feed else np.inf
            self.demand(mover.feedrate > 0.0, f'the feed {feed} is missing', name)
            go_along(mover, place, axis, level, True, mover.feedrate == np.inf)

        aside, depth = here.copy(), of('Q249' if self.cycle == 204 else 'Q201') * unit
        if self.cycle == 204:
            side = _SIDES.get(of('Q214'))
            if side is None or not depth > 0.0:
                raise self.fault('write Q214 from 1 to 4, and the depth Q249 above 0', name)
            aside[[a, b]] += np.array(side) * of('Q251') * unit
            edge = surface - (of('Q250') + of('Q252')) * unit
            for place, level, feed in (
                (here, retract, ''),
                (aside, retract, 'Q253'),
                (aside, edge - gap, 'Q253'),
                (here, edge - gap, 'Q253'),
                (here, edge + depth, 'Q254'),
            ):
                go(place, level, feed)
            mover.targets.stop_here()
            for place, level in ((here, edge - gap), (aside, edge - gap), (aside, retract)):
                go(place, level, 'Q253')
        else:
            cutter = cutter_of(self.at, BlockWords()).radius
            radius, pitch = 0.5 * of('Q335') * unit - cutter, of('Q334') * unit
            self.demand(
                radius >= 0.0 and depth < 0.0 < pitch,
                'write Q335 not below the diameter of the tool, Q334 above 0, and Q201 below 0',
                name,
            )
            self.refuse_if(
                radius > cutter and not of('Q342') > 0.0,
                'the hole is more than twice as wide as the tool; write Q342',
                name,
            )
            self.notice(name, 'begins above the hole, at the side of the first axis')
            aside[a] += radius
            go(here, retract)
            go(aside, retract, 'Q206')
            turns = (gap - depth) / pitch
            climbs = (of('Q351') >= 0.0) == (self.at.outputs.get('spindle') != 'M4')
            angle = turns * 2j * np.pi * (1 if climbs else -1)
            rim = aside.copy()
            rim[a], rim[b] = here[a] + radius * exp(angle).real, here[b] + radius * exp(angle).imag
            rim[axis] = surface + depth
            if radius > _SAME:
                for times in (np.ceil(turns - 1e-9), 1.0):
                    words = BlockWords(
                        g=['G3' if climbs else 'G2'], ways=dict.fromkeys('IJK', 'AC')
                    )
                    words.values = {'XYZ'[i]: rim[i] / unit for i in range(3)} | {
                        'P': float(times)
                    }
                    words.values |= {'IJK'[i]: here[i] / unit for i in (a, b)}
                    words.texts = dict.fromkeys(words.values, name)
                    self.execute(words)
            go(here, surface + depth, 'Q206')
            go(here, retract)
        go(here, clear)
        mover.feedrate = kept

    def _tilt(self, match: re.Match[str]) -> None:
        kind, rest = match.groups()
        how = {name for found in _TURNING.finditer(rest) for name in found.groups() if name}
        values, _, _ = self._words(_TURNING.sub(' ', rest))
        choice = 1 if '+' in how else 2 if '-' in how else 0
        way = next((word for word in ('MOVE', 'TURN', 'STAY') if word in how), '')
        self._frames.tilt(kind, values, way, choice, 'TABLE' in how)
        for letter, angle in zip(self.mover.rotary_letters, self._frames.found, strict=False):
            self.variables.set_name(f'Q12{"ABC".index(letter)}', angle / DEG)

    #: What defines each cycle; those of older controls have a line for each of their parts.
    _OF_PARTS: ClassVar = {7, 8, 10, 11, 19, 26}
    _CYCLES: ClassVar[dict[int, Callable[..., None]]] = {
        **dict.fromkeys((7, 10, 19), _define_frame),
        **dict.fromkeys((8, 11, 26), _define_scale),
        **dict.fromkeys((12, 13, *_SETTING), _define_setting),
        **dict.fromkeys((1, 2, 240, *range(200, 209)), _define_hole),
        9: _define_dwell,
        32: _define_tolerance,
    }
    #: What lines of each form do: those that change the order of lines, and all others.
    _FLOW: ClassVar[tuple[_Form, ...]] = (
        (_LABEL, _pass_label),
        (_CALL, _call),
        (_CALL_FILE, _call_file),
        (_FN, _function),
        (_SET, _set),
        (re.compile(r'END PGM.*'), _end),
    )
    _STATEMENTS: ClassVar[tuple[_Form, ...]] = (
        (re.compile(r'BEGIN PGM(?:.*\b(IN(?:CH)?)|.*)'), _begin),
        (_CYCLE, _define_cycle),
        (_TOOL_CALL, _tool_call),
        (_PLANE, _tilt),
        (re.compile(r'(?:BLK FORM|TOOL DEF|\*|PRINT|STRUCTURE).*'), _idle),
        (re.compile(r'STOP\s*(.*)'), _stop),
        (re.compile(r'CYCL\s+CALL\s*(?:POS)?\s*(.*)'), _call_cycle),
        (re.compile(r'FUNCTION\s+(RESET\s+)?TCPM\b(.*)'), _switch_tcp),
        (_CORNER, _corner),
        (re.compile(r'(LN|LP|L|CC|CP|CR|CT|C)(?![A-Z])\s*(.*)'), _motion),
        (re.compile(r'(?:I?[XYZABCUVW]\s*[-+Q\d.]|R[0LR]?\s|[SMF]\s*(?:\d|MAX|$)).*'), _line),
    )
