"""The words of CL data, with reasons for rejected ones; drilling cycles and frames.

``CYCLE/DRILL,FEDTO,d,MMPM,f,RAPTO,c,RTRCTO,r`` drills at the next GOTO points until ``CYCLE/OFF``.
The first system of MSYS or CSYS is that of the workpiece; points in others are converted to it.
"""

import re
from collections.abc import Callable, Sequence

import numpy as np

from cnc_interp.core import DEG, INCH, MINUTE, MM, FloatArray, ProgramError
from cnc_interp.machine_model.signals import DWELL
from cnc_interp.program.geometry.frames import rotation
from cnc_interp.program.geometry.target_row import AT_M0, AT_M1
from cnc_interp.program.motion.cycles import Hole, pecks_of
from cnc_interp.program.text import code_tables as codes

#: Words that are followed by text to the end of the line.
TEXT = ('PARTNO', 'PPRINT', 'REMARK', 'INSERT', 'LETTER', 'TPRINT')
#: Words without effect on the motion, ignored without a notice.
SILENT = {'MACHIN', 'MULTAX', 'INTOL', 'OUTTOL', 'TOLER', 'CUTTER', 'NOPOST', 'CLPRNT', 'END'}
#: Words that do not move the tool; they give one notice.
HARMLESS = {
    'AUTOPS',
    'AUXFUN',
    'CAMERA',
    'CLAMP',
    'CLEARP',
    'COOLNT',
    'DISPLY',
    'LEADER',
    'LINTOL',
    'LOAD',
    'LOADTL',
    'MAXDP',
    'MCHTOL',
    'MFG',
    'NUMPTS',
    'OPSKIP',
    'OPTOOL',
    'PAINT',
    'PLABEL',
    'PLOT',
    'PPFUN',
    'PPWORD',
    'PREFUN',
    'PRINT',
    'REWIND',
    'SAFETY',
    'SELCTL',
    'SELECT',
    'SEQNO',
    'SETUP',
    'SPINDL',
    'TLDATA',
    'TOOL',
    'TOOLNO',
    'TRNTYP',
    'TURRET',
}
_FRAME = 'changing the coordinate system is not supported; output one workpiece frame'
#: Words that are rejected unless they switch something off or contain only zeros.
OFF_ONLY = {'ORIGIN': _FRAME, 'TRANS': _FRAME}
NOTICES = {
    **dict.fromkeys((*HARMLESS, *OFF_ONLY), 'no effect, it does not move the tool'),
    'CUTCOM': 'the points are tool tips, as CL data have them; the wear of the cutter is not '
    'compensated',
}
INFORMATION = 'CSI_'  #: Words with this beginning are information of a CAM system.
#: Words that switch outputs or name the tool; a start in the middle reports their state.
OUTPUTS = {'COOLNT', 'DELAY', 'DWELL', 'LOADTL', 'SPINDL', 'TOOLNO'}
#: Words that stop: the kind of stop (``TargetColumns.stop_here``), and the text of the notice.
STOPS = {
    'STOP': (AT_M0, codes.STOP_M['M0']),
    'OPSTOP': (AT_M1, codes.STOP_M['M1']),
    'DELAY': (1.0, codes.DWELL),
    'DWELL': (1.0, codes.DWELL),
}
LINEAR = 'output the tool path as GOTO points'
_DRIVEN = f'motion along part surfaces is not supported; {LINEAR}'
REFUSED = {
    **dict.fromkeys(
        ('MOVARC', 'ARCMOV'), f'arcs are supported as CIRCLE/x,y,z,i,j,k,r; or {LINEAR}'
    ),
    'GOHOME': f'machine-coordinate moves are not supported; {LINEAR}',
    'RETRCT': f'retract moves are not supported; {LINEAR}',
    **dict.fromkeys(('ROTATE', 'ROTABL'), f'rotary table moves are not supported; {LINEAR}'),
    'ROTHED': f'rotary head moves are not supported; {LINEAR}',
    **dict.fromkeys(('MACRO', 'CALL'), f'macros are not supported; {LINEAR}'),
    'PROBE': f'probing is not supported; {LINEAR}',
    **dict.fromkeys(
        (
            'GO',
            'GOFWD',
            'GOBACK',
            'GOLFT',
            'GORGT',
            'GOUP',
            'GODOWN',
            'INDIRP',
            'TLON',
            'TLLFT',
            'TLRGT',
            'PSIS',
            'DNTCUT',
        ),
        _DRIVEN,
    ),
}
OFF = {'', 'OFF', 'NOMORE'}
UNKNOWN = 'unknown word; write $$ before it if it does not move the tool'
LENGTH_UNITS = {'MM': MM, 'MILLIM': MM, 'INCH': INCH, 'INCHES': INCH}
FEED_UNITS = {'MMPM': MM, 'IPM': INCH, 'PERMIN': 0.0}


#: Notices of statements on a machine without an output for them.
NO_OUTPUT = {'SPINDL': codes.NO_SPINDLE, 'COOLNT': codes.NO_COOLANT}


def machine_words(major: str, minor: str) -> tuple[list[str], dict[str, float]]:
    fields = [field.strip() for field in minor.split(',')]
    numbers = [float(field) for field in fields if re.fullmatch(r'\d+\.?\d*', field)]
    if major == 'SPINDL':
        given = {'S': numbers[0]} if numbers else {}
        turns = 'M4' if 'CCLW' in fields else 'M3'
        return (['M5'], {}) if minor in OFF else ([*given, turns], given)
    if major == 'COOLNT':
        return (['M9'] if minor in OFF else ['M7' if 'MIST' in fields else 'M8']), {}
    if major in ('DELAY', 'DWELL') and numbers and 'REV' not in fields:
        return ['G4'], {DWELL: numbers[0]}
    return (['T', 'M6'], {'T': numbers[0]}) if major == 'LOADTL' and numbers else ([], {})


#: Kinds of cycles: with retract at feed, with pecks, and with a dwell.
_FEED_OUT, _PECKING = {'TAP', 'BORE', 'REAM', 'BORE8'}, {'DEEP', 'DEEP2', 'BRKCHP', 'CHIPBR'}
KINDS = {'DRILL', 'FACE', 'CSINK', 'CDRILL', 'SPOTDRILL', *_FEED_OUT, *_PECKING}
_VALUES = {
    'FEDTO': 'depth',
    'DEPTH': 'depth',
    'RAPTO': 'clear',
    'CLEAR': 'clear',
    'RTRCTO': 'retract',
    'RETURN': 'retract',
    'MMPM': 'feed',
    'IPM': 'feed',
    'STEP': 'peck',
    'INCR': 'peck',
    '1STPECK': 'peck',
    'SUBPECK': 'next',
    'DWELL': 'dwell',
}
_NEAR = 0.5 * MM  #: Gap above the last peck at which a rapid ends [m].


def cycle_of(minor: str, unit: float, fault: Callable[[str, str], ProgramError]) -> Hole:
    kind, *words = [word.strip() for word in minor.split(',')]
    if kind not in KINDS:
        raise fault('this cycle is not supported; output the tool path as GOTO points', kind)
    found: dict[str, float] = {}
    feed_unit = unit
    while words:
        word = words.pop(0)
        if word not in _VALUES:
            why = 'a number without a word' if re.fullmatch(r'[-+.\dE]+', word) else 'not known'
            raise fault(f'{why} in a cycle; write FEDTO, RAPTO, RTRCTO and MMPM', word or kind)
        if not words or not re.fullmatch(r'[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?', words[0]):
            raise fault('a number is missing in the cycle', word)
        found[_VALUES[word]] = float(words.pop(0))
        feed_unit = FEED_UNITS.get(word) or feed_unit
    if 'depth' not in found:
        raise fault('the cycle needs its depth FEDTO', kind)
    depth, clear, first, following = (
        abs(found.get(name, 0.0)) * unit for name in ('depth', 'clear', 'peck', 'next')
    )
    pecks: list[float] = []
    if kind in _PECKING:
        pecks = pecks_of(
            0.0,
            -depth,
            first or depth,
            lambda text: fault(text, kind),
            lambda *_: following or first,
        )
    return Hole(
        clear,
        -depth,
        max(abs(found.get('retract', 0.0)) * unit, clear),
        pecks,
        gap=_NEAR,
        rests=found.get('dwell', 0.0) > 0.0,
        dwell=found.get('dwell', 0.0),
        out=clear if kind in _FEED_OUT else None,
        feed=found.get('feed', 0.0) * feed_unit / MINUTE,
    )


def way_to(
    here: FloatArray, place: FloatArray, axis: FloatArray, retract: float
) -> FloatArray | None:
    """Return the point to which a tool below the retract level of a hole must first rise."""
    below = float((place - here) @ axis) + retract
    across = float(np.linalg.norm(np.cross(place - here, axis)))
    return here + below * axis if below > 1e-9 and across > 1e-9 else None


#: Largest accepted error of right angles between the axes of a system [-].
_ROUNDED = 1e-4
_COPY = re.compile(r'(\d+)\s*(?:,\s*(SAME|TRANSL|XYROT|YZROT|ZXROT)\s*((?:,\s*[-+.\dE]+\s*)*))?')
_MOST_COPIES = 10_000  #: Largest number of copies of a program part.

IDENTITY = '1,0,0,0,0,1,0,0,0,0,1,0'  #: A system that moves nothing.


def system_of(numbers: Sequence[float]) -> tuple[FloatArray, FloatArray] | None:
    """Return the axes, (3, 3) by columns, and origin of a system; None if it is not one."""
    rows = np.array(numbers)
    if len(rows) == 9:
        x, y = rows[3:6], rows[6:]
        found = [(np.stack([x, y, np.cross(x, y)], axis=1), rows[:3])]
    elif len(rows) == 12:
        whole = rows.reshape(3, 4)
        found = [(whole[:, :3], whole[:, 3]), (rows[:9].reshape(3, 3).T, rows[9:])]
    else:
        return None
    for axes, origin in found:
        if np.abs(axes.T @ axes - np.eye(3)).max() < _ROUNDED and np.linalg.det(axes) > 0.0:
            left, _, right = np.linalg.svd(axes)
            return np.asarray(left @ right), origin
    return None


def moves(system: tuple[FloatArray, FloatArray]) -> bool:
    return bool(np.abs(system[0] - np.eye(3)).max() > 1e-9 or np.abs(system[1]).max() > 1e-9)


class ClFrames:
    def __init__(self) -> None:
        self._first: tuple[FloatArray, FloatArray] | None = None
        self._system = self._cut = self._copied = np.eye(3), np.zeros(3)
        self.is_moved = False  # whether points are not as they are written
        self._marks: dict[int, int] = {}  # INDEX by number: the first statement after it
        self.kept: list[tuple[int, str]] = []  # statements since the first INDEX

    def enter(self, system: tuple[FloatArray, FloatArray]) -> bool:
        self._first = axes, origin = self._first or system
        self._system = axes.T @ system[0], axes.T @ (system[1] - origin)
        self._note()
        return moves(self._system)

    def cut(self, system: tuple[FloatArray, FloatArray]) -> None:
        self._cut = system
        self._note()

    def _note(self) -> None:
        parts = (self._system, self._cut, self._copied)
        self.is_moved = any(moves(part) for part in parts)

    def point(self, point: Sequence[float]) -> FloatArray:
        found = np.array(point)
        for axes, origin in (self._cut, self._copied, self._system):
            found = axes @ found + origin
        return found

    def direction(self, direction: Sequence[float]) -> FloatArray:
        found = np.array(direction)
        return self._system[0] @ self._copied[0] @ self._cut[0] @ found if self.is_moved else found

    def index(self, number: int) -> None:
        self._marks[number] = len(self.kept)

    def keep(self, line_number: int, statement: str) -> None:
        if self._marks and not statement.startswith(('COPY', 'INDEX')):
            self.kept.append((line_number, statement))

    def copy(self, minor: str, run: Callable[[int, str], None]) -> bool:
        match = _COPY.fullmatch(minor)
        if match is None or int(match[1]) not in self._marks:
            return False
        given = [float(word) for word in (match[3] or '').split(',') if word.strip()]
        *values, times = given or [1.0]
        kind = match[2] or 'SAME'
        if len(values) != {'SAME': 0, 'TRANSL': 3}.get(kind, 1) or not 0 < times <= _MOST_COPIES:
            return False
        turn, shift = np.eye(3), np.zeros(3)
        if kind == 'TRANSL':
            shift = np.array(values)
        elif kind != 'SAME':
            turn = rotation({'YZROT': 0, 'ZXROT': 1, 'XYROT': 2}[kind], values[0] * DEG)
        before, part = self._copied, self.kept[self._marks.pop(int(match[1])) :]
        for _ in range(int(times)):
            axes, origin = self._copied
            self._copied = turn @ axes, turn @ origin + shift
            self._note()
            for number, statement in part:
                run(number, statement)
        self._copied = before
        self._note()
        return True
