"""A second reader of part programs, for plain words only; it shares no code with the first one.

This reader rejects programs with words that it does not know, because these cannot be compared.
"""

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, ProgramError
from cnc_interp.proof.plain_klartext import Klartext
from cnc_interp.proof.plain_poses import TABLE, poses_of

#: G codes that have no effect in this reader.
IDLE_G = frozenset(
    (
        '4',
        '5',
        '5.1',
        '8',
        '41.2',
        '42.2',
        '43',
        '43.4',
        '49',
        '50',
        '50.1',
        '51',
        '51.1',
        '52',
        '54',
        '80',
        '91.1',
        '97',
        '98',
        '99',
        '500',
    )
)
TCP_ON, TCP_OFF = ('M428', 'M128', 'G43.4', 'TRAORI'), ('M429', 'M129', 'G49', 'TRAFOOF')
REFUSED_M = ('M17', 'M61', 'M70', 'M71', 'M72', 'M73', 'M98', 'M99', 'M198')
#: Words that wait for the operator; order of the M codes that act before others of their block.
STOPS, FIRST = ('M1', 'M0', 'M60'), {'M6': 0, 'M3': 1, 'M4': 1, 'M5': 1}
#: Words of outputs and inputs, with the word under which each is compared.
BY_NUMBER = {
    **{'M62': 'M64 P', 'M64': 'M64 P', 'M63': 'M65 P', 'M65': 'M65 P'},
    **{'M67': 'M68 E', 'M68': 'M68 E', 'M66': 'M66 P'},
}
DWELL, FIXED = 'dwell', 'fixed'  #: Names for the value of G4 [s], and of M50 and M51.
TAKE_P = {'G5', 'G5.1', 'G8', 'G64', 'G41.2', 'G42.2'}  #: Codes that use P themselves.
# Words of G-code after which a number follows and that move nothing.
IDLE_LETTERS = frozenset('NMSTDHPQLE')
PLANES = {'17': (0, 1, 2), '18': (2, 0, 1), '19': (1, 2, 0)}
#: Attributes of ``_State`` that each code sets.
_SETS: dict[str, dict[str, Any]] = {
    'G0': {'motion': '0'},
    'G1': {'motion': '1'},
    'G2': {'motion': '2'},
    'G3': {'motion': '3'},
    'G17': {'plane': PLANES['17']},
    'G18': {'plane': PLANES['18']},
    'G19': {'plane': PLANES['19']},
    'G20 G70': {'unit': 25.4 * MM},
    'G21 G71': {'unit': MM},
    'G60 G61 G61.1': {'rests': True},
    'G64 G641 G642 G643 G644': {'rests': False},
    'G9': {'rests_once': True},
    'G40': {'by_normals': False},
    'G90': {'absolute': True},
    'G91': {'absolute': False},
    'G93': {'inverse': True, 'per_turn': False},
    'G94': {'inverse': False, 'per_turn': False},
    'G95': {'inverse': False, 'per_turn': True},
    'ORIVECT ORICURVE': {'on_circle': True},
    'ORIAXES': {'on_circle': False},
    'M2 M30': {'ended': True},
}
SETS = {code: sets for codes, sets in _SETS.items() for code in codes.split()}
IDLE_CL = frozenset(
    (
        'PARTNO',
        'MULTAX',
        'PPRINT',
        'SPINDL',
        'COOLNT',
        'LOADTL',
        'CUTTER',
        'TOOLNO',
        'MACHIN',
        'INTOL',
        'OUTTOL',
        'TOLER',
        'FINI',
        'END',
        'REWIND',
        'PAINT',
        'FROM',
    )
)
_WORD = re.compile(r'(E\d(?=\s*=)|[A-Z])(?:(?<=\d)\s*=)?\s*([-+]?(?:\d+\.?\d*|\.\d+))\s*')
#: Words that mirror or scale X Y Z.
SCALING = {'G50', 'G50.1', 'G51', 'G51.1', 'MIRROR', 'AMIRROR', 'SCALE', 'ASCALE'}
_NAMED = re.compile(
    r'(TRAORI|TRAFOOF|A?MIRROR|A?SCALE|(?:CTOL|OTOL|ORICURVE|ORIVECT|ORIAXES)(?:\s*=\s*[\d.]+)?)\b\s*'
)


def _numbered(code: str, words: Mapping[str, float]) -> str:
    name = BY_NUMBER[code]
    until = f' L{words.get("L", 0.0):g}' if code == 'M66' else ''
    return f'{name}{words.get(name[-1], -1.0):g}{until}'


@dataclass(frozen=True)
class ReadMove:
    line: int  #: Line of the text; 0 if the reader does not know it.
    rapid: bool  #: Whether it is a rapid.
    end: FloatArray  #: (3,): X Y Z at its end [m].
    rotary: FloatArray  #: (2,) or (0,): Rotary positions at its end [rad].
    axis: FloatArray | None  #: (3,): Tool axis; None unless the program gives it.
    extra: FloatArray  #: (k,): Extra axes at its end [m].
    #: Feed [m/s] and duration [s]; NaN if not programmed.
    feed: float
    duration: float
    tcp: bool  #: Whether X Y Z are the tool tip; otherwise they are axis positions.
    #: The two axes in the plane of an arc, and the one normal to it.
    plane: tuple[int, int, int] = (0, 1, 2)
    centre: FloatArray | None = None  #: (2,): Centre of an arc in its plane [m].
    sweep: int = 0  #: 1 for a counter-clockwise arc, -1 for a clockwise one, 0 for a line.
    turns: int = 1  #: Number of turns of an arc; the last may be partial.
    digit: float = 0.0  #: Value of the last known digit of lengths [m]; 0 if they are exact.
    unsure: float = 0.0  #: Relative uncertainty of feed or duration in this reader [-].
    tolerance: float = float('nan')  #: Contour tolerance [m]; NaN if the settings give it.
    orientation: float = float('nan')  #: Orientation tolerance [m]; NaN if settings give it.
    stop: bool = False  #: Whether the text demands a rest at its end.
    #: Whether rotary axes have been programmed by words that are end positions of the axes. On
    #: great circles the words give only the direction of the tool.
    worded: bool = False
    #: (3,): Normal of the part, if ``end`` is the cutter contact point.
    normal: FloatArray | None = None
    #: Tool radius minus corner radius, and corner radius [m].
    cutter: tuple[float, float] = (0.0, 0.0)
    turn_feed: float = float('nan')  #: Feed of a motion of rotary axes alone [rad/s].
    length: float = 0.0  #: Tool length beyond the tip of the machine file [m].
    spin: float = float('nan')  #: Turn of the tool about its axis, if a pose gives it [rad].


@dataclass(frozen=True)
class ReadCall:
    """A function or a program stop of the text, placed between motions where it acts."""

    line: int  #: Line of the text; 0 if the reader does not know it.
    word: str
    #: Values of its letters (S, T, P, Q, ``DWELL``); several if the text is ambiguous.
    given: Mapping[str, tuple[float, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class PlainSettings:
    """Settings that a program text does not contain."""

    feed: float | None = None  #: Feed of a program without F [m/s].
    skip: bool = False  #: Whether lines that begin with a slash are left out.
    #: Radius, corner radius and length of the tools, by their numbers [m].
    tools: Mapping[int, tuple[float, float, float]] = field(default_factory=dict)
    tool: int = 0  #: The tool in the spindle.
    height: float = float('nan')  #: Flank height, at which an angle of tolerance counts [m].
    #: Words that act after the motion of their block.
    after: Collection[str] = ('M2', 'M5', 'M9', 'M30')
    by_hand: bool = True  #: Whether the operator changes the tool at M6.
    dwells: tuple[float, ...] = (1.0,)  #: Possible units of an integer P in a dwell [s].
    #: (k,): Extra axes before the first word that names them [m or rad]; NaN is not compared.
    beside: tuple[float, ...] = ()


def read_plainly(
    text: str, name: str, axis_names: tuple[str, ...], settings: PlainSettings | None = None
) -> list[ReadMove | ReadCall]:
    """Read motions, functions and program stops in the order in which they act."""
    settings = settings or PlainSettings()
    state = _State(name, axis_names, settings)
    cl_data = re.search(r'^\s*(GOTO|FEDRAT|PARTNO|UNITS)\b\s*/?', text, re.MULTILINE) is not None
    klartext = None
    if TABLE.match(text):
        for pose in poses_of(text.upper().splitlines(), state.feed, state.refuse):
            state.line, state.here[:3], state.tool, state.spin, state.feed = pose
            state.add(0, None)
        return state.read
    if re.search(r'^\s*(?:\d+\s+)?BEGIN PGM\b', text, re.MULTILINE | re.IGNORECASE):
        klartext = Klartext(state.refuse, bool(settings.tools))
    for number, line in enumerate(text.splitlines(), start=1):
        state.line = number
        if cl_data:
            state.statement(line.strip().upper())
        elif klartext:
            for each in klartext.lines(line.upper(), state.coordinates()):
                state.block(each)
        elif not (settings.skip and line.lstrip().startswith('/')):
            state.block(line.upper())
        if state.ended:
            break
    return state.read


class _State:
    def __init__(self, name: str, axis_names: tuple[str, ...], settings: PlainSettings):
        self.settings, self.height, self.turns = settings, settings.height, 1
        self.rests = self.rests_once = self.worded = self.on_circle = False
        self.tools, self.cutter = settings.tools, (0.0, 0.0)
        self.by_normals, self.normal, self.length = False, np.zeros(3), 0.0
        self.name, self.names, self.line = name, axis_names, 0
        self.read: list[ReadMove | ReadCall] = []
        self.last = -1  # the place of the last motion among them
        self.speed, self.per_turn = 0.0, False
        self.tool_number = self.in_spindle = float(settings.tool)
        self.here = np.zeros(len(axis_names))  # in m and rad
        self.here[len(axis_names) - len(settings.beside) :] = settings.beside
        self.tool: FloatArray | None = None
        self.spin = float('nan')
        self.motion, self.plane, self.unit = '', PLANES['17'], MM
        self.absolute, self.inverse, self.tcp = True, False, False
        self.feed = float('nan') if settings.feed is None else settings.feed
        self.turn_feed = self.feed / MM * DEG
        self.ended = False
        self.tolerance = self.orientation = float('nan')
        #: Positions of the mirrors of axes; scales of the axes and the fixed point of scaling.
        self.mirrors: dict[int, float] = {}
        self.scales, self.about = np.ones(3), np.zeros(3)
        self.shift = np.zeros(3)  # by G52
        # After a switch of the tool-tip control, only the first reader knows where the tip is.
        self.unknown: set[str] = set()

    def refuse(self, word: str) -> ProgramError:
        return ProgramError(
            f'{word}: the second reader knows plain words only; this program cannot be compared',
            self.name,
            self.line,
        )

    def block(self, line: str) -> None:
        line = re.sub(r'\([^()]*\)|;.*', ' ', line).strip()
        if line in ('', '%') or re.fullmatch(r'O\d+', line):
            return
        words: dict[str, float] = {}
        idle: dict[str, float] = {}
        codes, rest = [], line.lstrip('/')
        while rest:
            named, word = _NAMED.match(rest), _WORD.match(rest)
            if named:
                codes.append(re.split(r'[\s=]', named[1])[0])
                if codes[-1] == 'CTOL':
                    self.tolerance = float(named[1].split('=')[1]) * self.unit
                elif codes[-1] == 'OTOL':
                    self.orientation = float(named[1].split('=')[1]) * DEG * self.height
            elif word:
                letter, value = word[1], float(word[2])
                if letter == 'G' or letter == 'M':
                    codes.append(f'{letter}{value:g}')
                elif letter in (*self.names, *'IJKRF'):
                    if letter in words:
                        raise self.refuse(f'{letter} twice')
                    words[letter] = value
                elif letter in IDLE_LETTERS:
                    idle[letter] = value
                else:
                    raise self.refuse(f'{letter}{word[2]}')
            else:
                raise self.refuse(rest.split()[0])
            rest = rest[(named or word).end() :]  # type: ignore[union-attr]
        was_per_turn = self.per_turn
        self.measure(codes, idle.get('H'))
        self.codes(codes)
        self.speed = self.speed if 'G4' in codes else idle.get('S', self.speed)
        self.tool_number = float(round(min(abs(idle.get('T', self.tool_number)), 1e6)))
        functions = [('G95' if self.per_turn else 'G94')] * (self.per_turn != was_per_turn)
        functions += [letter for letter in 'ST' if letter in idle and 'G4' not in codes]
        found = [code for code in codes if code[0] == 'M' and code not in STOPS]
        found = [_numbered(code, idle) if code in BY_NUMBER else code for code in found]
        if 'M6' in found:
            if self.settings.by_hand and self.tool_number == self.in_spindle:
                found.remove('M6')  # the operator has nothing to do
            self.in_spindle = self.tool_number
        functions += sorted(found, key=lambda code: FIRST.get(code, 2))
        fixed = float(idle.get('P', 1.0) == 0.0)
        letters = {'S': self.speed, 'T': self.tool_number, FIXED: fixed}
        if 'M19' in found:
            idle['R'] = words.pop('R', 0.0)
        letters |= {letter: idle[letter] for letter in 'PQR' if letter in idle}
        given = {letter: (value,) for letter, value in letters.items()}
        later = [each for each in functions if each in self.settings.after]
        for each in functions:
            if each not in later:
                self.call(each, given)
        self.act(line, codes, words, idle)
        for each in later:
            self.call(each, given)
        for code in codes:
            if code in STOPS:
                self.rest()
                self.call(code)

    def call(self, word: str, given: Mapping[str, tuple[float, ...]] | None = None) -> None:
        self.read.append(ReadCall(self.line, word, given or {}))

    def dwell(self, line: str) -> None:
        found = re.search(r'([PXFSU])\s*(\d*\.?\d*)', line)
        letter, text = found.groups() if found else ('', '')
        counts = self.settings.dwells if letter == 'P' and '.' not in text else (1.0,)
        counts = (60.0 / max(self.speed, 1.0),) if letter == 'S' else counts
        self.rest()
        self.call('G4', {DWELL: tuple(float(text or 0.0) * count for count in counts)})

    def act(
        self, line: str, codes: list[str], words: dict[str, float], idle: dict[str, float]
    ) -> None:
        if 'G4' in codes:
            self.dwell(line)
            return
        if {'G5', 'G5.1'} & set(codes) and {'X', 'Y', 'Z', 'I', 'J'} & set(words):
            raise self.refuse('a spline')
        if 'G5.1' in codes:
            words.pop('R', None)  # a grade of smoothing
        if 'G64' in codes:
            found = re.search(r'P\s*(\d*\.?\d*)', line)
            self.tolerance = float(found[1]) * self.unit if found else 0.0
            self.tolerance = self.orientation = self.tolerance or float('nan')
        if {'G41.2', 'G42.2'} & set(codes):
            self.take_cutter(line, words)
        if self.by_normals and {'I', 'J', 'K'} & set(words):
            given = np.array([words.pop(letter, 0.0) for letter in 'IJK'])
            self.normal = given / np.linalg.norm(given)
        for code in SCALING & set(codes):
            self.scale(code, words, line)
        if 'G52' in codes:
            for k, letter in enumerate('XYZ'):
                self.shift[k] = words.pop(letter, self.shift[k] / self.unit) * self.unit
        if 'F' in words:
            self.turn_feed = words['F'] * DEG / 60.0
            self.feed = words.pop('F') * (1.0 if self.inverse else self.unit / 60.0)
        self.turns = 1
        if not TAKE_P & set(codes):
            self.turns = int(idle.get('P', 1.0))
        self.worded = self.worded or not {'A', 'B', 'C'}.isdisjoint(words)
        if words:
            self.move(words)
        self.rests_once = False

    def scale(self, code: str, words: dict[str, float], line: str) -> None:
        if self.tcp:
            raise self.refuse(f'{code} with tool-tip programming')
        given = {k: words.pop(axis) for k, axis in enumerate('XYZ') if axis in words}
        places = {k: value * self.unit for k, value in given.items()}
        factors = dict(re.findall(r'([PIJK])\s*([-+]?[\d.]+)', line))
        if code in ('MIRROR', 'SCALE'):
            self.mirrors, self.scales, self.about = {}, np.ones(3), np.zeros(3)
        if code == 'G51':
            here = self.coordinates()
            self.about = np.array([places.get(k, here['XYZ'[k]] * self.unit) for k in range(3)])
            counts = {k: float(v) * (1.0 if '.' in v else 1e-3) for k, v in factors.items()}
            self.scales = np.array([counts.get(k, counts.get('P', 1.0)) for k in 'IJK'])
        elif code in ('G50', 'G50.1'):
            for k in given or dict(self.mirrors) if code == 'G50.1' else ():
                self.mirrors.pop(k, None)
            if code == 'G50':
                self.scales, self.about = np.ones(3), np.zeros(3)
        elif code.endswith('SCALE'):
            self.scales = self.scales * [given.get(k, 1.0) for k in range(3)]
        elif code == 'G51.1':
            self.mirrors = self.mirrors | places
        else:  # an axis that is mirrored twice is not
            self.mirrors = dict.fromkeys(self.mirrors.keys() ^ given.keys(), 0.0)
        for letter in factors:
            words.pop(letter, None)

    def factor(self) -> FloatArray:
        sides = [-1.0 if k in self.mirrors else 1.0 for k in range(3)]
        return np.asarray(self.scales * sides)

    def offset(self) -> FloatArray:
        """Return the program zero after mirroring, scaling and shifting [m]."""
        mirrored = np.array([2.0 * self.mirrors.get(k, 0.0) for k in range(3)])
        return np.asarray(self.shift + self.about + self.scales * (mirrored - self.about))

    def coordinates(self) -> dict[str, float]:
        """Return the current program coordinates, in the unit of the program and deg."""
        lengths = (self.here[:3] - self.offset()) / self.factor() / self.unit
        return dict(zip(self.names, [*lengths, *self.here[3:] / DEG], strict=True))

    def rest(self) -> None:
        move = self.read[self.last] if self.last >= 0 else None
        if isinstance(move, ReadMove):
            self.read[self.last] = replace(move, stop=True)

    def take_cutter(self, line: str, words: dict[str, float]) -> None:
        found = {letter: re.search(rf'{letter}\s*(\d+\.?\d*)', line) for letter in 'DQP'}
        number = int(float(found['D'][1])) if found['D'] else -1
        if number not in self.tools:
            raise self.refuse('G41.2 without D of a tool')
        radius, corner, _ = self.tools[number]
        corner = words.pop('R') * self.unit if 'R' in words else corner
        if found['Q'] and found['P']:
            radius -= float(found['Q'][1]) * self.unit
            corner -= float(found['P'][1]) * self.unit
        self.by_normals, self.cutter = True, (radius - corner, corner)

    def measure(self, codes: list[str], number: float | None) -> None:
        """Read the tool length of G43.4 H; G43 with a length is rejected."""
        known = {0: (0.0, 0.0, 0.0), **self.tools}
        named = 0 if number is None else int(number)
        if {'G43', 'G43.4'} & set(codes) and named not in known:
            raise self.refuse(f'H{named}')
        before, length = self.length, known[named][2] if named in known else 0.0
        if ('G43' in codes or (number and 'G43.4' not in codes)) and length:
            raise self.refuse('G43 with a tool length')
        if 'G43.4' in codes:
            self.length = length
        if {'G43', 'G49', *TCP_OFF} & set(codes):
            self.length = 0.0
        if self.length != before:
            self.unknown = set('XYZ') if self.here[3:].any() else {'Z'}

    def codes(self, codes: list[str]) -> None:
        for code in codes:
            known = code[0] != 'G' or code in SETS or code[1:] in IDLE_G
            if code in REFUSED_M or not known:
                raise self.refuse(code)
            vars(self).update(SETS.get(code, {}))
            if code in (*TCP_ON, *TCP_OFF):
                changes = self.last >= 0 and self.tcp is not (code in TCP_ON)
                if changes and self.here[3:].any():
                    self.unknown = set('XYZ')
                self.tcp = code in TCP_ON

    def move(self, words: dict[str, float]) -> None:
        start, end = self.here, self.here.copy()
        for letter, value in words.items():
            if letter in self.names:
                k = self.names.index(letter)
                size = DEG if letter[0] in 'ABCE' else self.unit
                factor, zero = (self.factor()[k], self.offset()[k]) if k < 3 else (1.0, 0.0)
                end[k] = factor * value * size + (zero if self.absolute else start[k])
        arc = self.motion in ('2', '3')
        if self.unknown and (arc or not (self.absolute and self.unknown <= set(words))):
            what = 'an arc' if arc else 'X Y Z not named'
            raise self.refuse(f'{what} after a switch of the tool-tip control')
        self.unknown = set()
        if not self.motion:
            raise self.refuse('axis words before G0 or G1')
        if self.last < 0 and (arc or (self.motion == '1' and not self.absolute)):
            motion, self.motion = self.motion, '0'  # from the position of the tool
            self.add(0, None)
            self.motion = motion
        self.here, sweep = end, {'2': -1, '3': 1}.get(self.motion, 0)
        sweep *= int(np.prod(np.sign(self.factor()[list(self.plane[:2])])))
        if sweep and words.keys().isdisjoint('IJKR'):
            raise self.refuse('an arc without I J K and R')
        self.add(sweep, self.centre(words, start, end, sweep) if sweep else None)

    def centre(
        self, words: dict[str, float], start: FloatArray, end: FloatArray, sweep: int
    ) -> FloatArray:
        a, b, _ = self.plane
        if 'R' not in words:
            away = np.array([words.get('IJK'[k], 0.0) * self.unit for k in (a, b)])
            away *= self.factor()[[a, b]]
            gap = abs(np.linalg.norm(start[[a, b]] + away - end[[a, b]]) - np.linalg.norm(away))
            if gap > max(0.1 * MM, 0.01 * float(np.linalg.norm(away))):
                raise self.refuse('an arc whose I J K are not the vector from its start')
            return np.asarray(start[[a, b]] + away)
        chord = end[[a, b]] - start[[a, b]]
        size = abs(float(self.factor()[a])) * self.unit
        radius, half = words['R'] * size, 0.5 * float(np.linalg.norm(chord))
        height = np.sqrt(max(radius**2 - half**2, 0.0)) / max(half, 1e-12)
        side = sweep * (1.0 if radius > 0.0 else -1.0)
        across = 0.5 * np.array([-chord[1], chord[0]])
        return np.asarray(start[[a, b]] + 0.5 * chord + side * height * across)

    def statement(self, text: str) -> None:
        text = text.split('$$')[0].strip()
        word, _, rest = (part.strip() for part in text.partition('/'))
        if not word or word.split()[0] in IDLE_CL:
            self.switch(word, rest)
            self.ended = self.ended or word in ('FINI', 'END')
            return
        if text.endswith('$'):
            raise self.refuse('$')
        fields = re.split(r'[,\s]+', rest.strip(', '))
        numbers = [float(field) for field in fields if re.fullmatch(r'[-+.\dE]+', field)]
        if word == 'UNITS' and fields[:1] in (['MM'], ['INCHES'], ['IN']):
            self.unit = MM if fields[0] == 'MM' else 25.4 * MM
        elif word == 'FEDRAT' and len(numbers) == 1 and set(fields[1:]) <= {'MMPM', 'IPM'}:
            self.feed, self.motion = numbers[0] * self.unit / 60.0, '1'
        elif word == 'RAPID':
            self.motion = '0'
        elif word == 'TLAXIS' and len(numbers) == 3:
            self.tool = np.array(numbers)
        elif word == 'GOTO' and len(numbers) in (3, 6):
            self.here = self.here.copy()
            self.here[:3] = np.array(numbers[:3]) * self.unit
            if len(numbers) == 6:
                self.tool = np.array(numbers[3:])
            if self.tool is None:
                self.tool = np.array([0.0, 0.0, 1.0])
            self.add(0, None)
            self.motion = '1'
        else:
            raise self.refuse(text[:40])

    def switch(self, word: str, rest: str) -> None:
        """Read the functions of a statement of CL data."""
        number, off = re.match(r'\d+\.?\d*', rest), rest == 'OFF'
        value = (float(number[0]),) if number else ()
        if word == 'SPINDL':
            turns = 'M5' if off else 'M4' if 'CCLW' in rest else 'M3'
            for each in (['S'] if value else []) + [turns]:
                self.call(each, {'S': value})
        elif word == 'COOLNT':
            self.call('M9' if off else 'M7' if 'MIST' in rest else 'M8')
        elif word == 'LOADTL' and value:
            for each in 'T', 'M6':
                self.call(each, {'T': value})

    def add(self, sweep: int, centre: FloatArray | None) -> None:
        rapid = self.motion == '0'
        rotary = sum(letter in 'ABC' for letter in self.names)
        tool = None if self.tool is None else self.tool / np.linalg.norm(self.tool)
        timed = self.inverse and not rapid
        turn = self.speed if self.per_turn else 1.0
        self.last = len(self.read)
        self.read.append(
            ReadMove(
                self.line,
                rapid,
                self.here[:3].copy(),
                self.here[3 : 3 + rotary].copy(),
                tool,
                self.here[3 + rotary :].copy(),
                float('nan') if timed or rapid else self.feed * turn,
                60.0 / self.feed if timed else float('nan'),
                self.tcp or tool is not None,
                self.plane,
                centre,
                sweep,
                self.turns if sweep else 1,
                tolerance=self.tolerance,
                orientation=self.orientation,
                stop=self.rests or self.rests_once,
                worded=self.worded and not (self.on_circle and self.tcp),
                normal=self.normal if self.by_normals else None,
                cutter=self.cutter,
                turn_feed=self.turn_feed * turn,
                length=self.length,
                spin=self.spin,
            )
        )
