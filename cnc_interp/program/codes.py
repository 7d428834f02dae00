"""What each code means to a reader that runs linear blocks: a setting, harmless, or refused."""

from __future__ import annotations

from cnc_interp.units import INCH, MM

# Codes of one modal group set the same attribute of the reader, so two of them contradict.
SETTINGS: dict[str, tuple[str, object]] = {
    'G0': ('rapid', True),
    'G1': ('rapid', False),
    'G20': ('unit', INCH),
    'G21': ('unit', MM),
    'G90': ('incremental', False),
    'G91': ('incremental', True),
    'G93': ('inverse_time', True),
    'G94': ('inverse_time', False),
    'G60': ('stop_always', True),
    'G61': ('stop_always', True),
    'G61.1': ('stop_always', True),
    'G64': ('stop_always', False),
    'G9': ('stop_once', True),
}

# How tool-tip programming (TCP) is switched; the words of several controls.
TCP_ON = {'M428', 'G43.4', 'G234', 'TRAORI', '#TRAFO ON'}
TCP_OFF = {'M429', 'G49', 'TRAFOOF', '#TRAFO OFF'}
# A plain tool length takes the place of a tool-tip mode that is itself a kind of tool length.
TCP_BY_LENGTH = {'G43.4', 'G234'}
LENGTH = {'G43', 'G44', 'G49'}
TCP_SWITCHES = TCP_ON | TCP_OFF
TCP_ON_WORDS = 'M428, G43.4, G234, TRAORI or #TRAFO ON'

WORK_OFFSETS = {'G54', 'G55', 'G56', 'G57', 'G58', 'G59', 'G59.1', 'G59.2', 'G59.3'}

_LENGTH = 'the tool tip is programmed, so the tool length changes nothing here'
_PLANE = 'planes matter to arcs only'
_OFF = 'nothing to switch off'
HARMLESS_G: dict[str, str] = {
    'G8': _OFF,
    'G15': _OFF,
    'G17': _PLANE,
    'G18': _PLANE,
    'G19': _PLANE,
    'G40': _OFF,
    'G43': _LENGTH,
    'G44': _LENGTH,
    'G49': _LENGTH,
    'G50': _OFF,
    'G69': _OFF,
    'G80': _OFF,
    'G90.1': 'arc centres matter to arcs only',
    'G91.1': 'arc centres matter to arcs only',
    'G97': 'passed on',
    'G98': 'the retract level matters to cycles only',
    'G99': 'the retract level matters to cycles only',
}

_LINEAR = 'post the program with linear moves'
_CYCLE = 'drilling cycles are not supported yet; post the cycle as G0 and G1 moves'
_RADIUS = 'cutter radius compensation is not supported yet; post the path of the tool centre'
_FRAME = 'changing the coordinate system is not supported yet; post in one workpiece frame'
_MACHINE = (
    'machine-coordinate moves are not supported yet; remove the line or write the move in '
    'workpiece coordinates'
)
_REVOLUTION = 'feed per revolution is not supported yet; post with G94 or G93'
REFUSED_G: dict[str, str] = {
    'G2': f'clockwise arcs (G2) are not supported yet; {_LINEAR}',
    'G3': f'counter-clockwise arcs (G3) are not supported yet; {_LINEAR}',
    'G5': f'spline moves are not supported yet; {_LINEAR}',
    'G5.1': f'spline moves are not supported yet; {_LINEAR}',
    'G5.2': f'spline moves are not supported yet; {_LINEAR}',
    'G7': 'diameter programming is not supported; post with radii',
    'G10': 'writing offsets from a program is not supported yet; set them before the program',
    'G16': 'polar coordinates are not supported yet; post with X and Y',
    'G28': _MACHINE,
    'G30': _MACHINE,
    'G33': 'thread cutting is not supported',
    'G38.2': 'probing is not supported',
    'G41': _RADIUS,
    'G42': _RADIUS,
    'G43.1': 'a tool length written in the program is not supported yet; use G43.4 or M428',
    'G43.5': 'tool vectors with G43.5 are not supported yet; use G43.4 with rotary words',
    'G51': 'scaling is not supported yet; post at full size',
    'G52': _FRAME,
    'G53': _MACHINE,
    'G54.1': _FRAME,
    'G54.2': _FRAME,
    'G65': 'macro calls are not supported yet; post without subprograms',
    'G66': 'macro calls are not supported yet; post without subprograms',
    'G68': _FRAME,
    'G68.2': _FRAME,
    'G92': _FRAME,
    'G95': _REVOLUTION,
    'G96': 'constant surface speed is not supported; give S in rev/min with G97',
}
REFUSED_G.update({f'G{number}': _CYCLE for number in (73, 74, 76, *range(81, 90))})

STOP_M = {'M0', 'M1', 'M60'}
END_M = {'M2', 'M30'}
_SUBPROGRAM = 'subprograms are not supported yet; post everything into one program'
REFUSED_M: dict[str, str] = {
    **dict.fromkeys(('M96', 'M97', 'M98', 'M99'), _SUBPROGRAM),
    **dict.fromkeys(('M71', 'M72', 'M73'), 'restoring modal state is not supported yet'),
    'M430': 'these kinematics are not supported; use M428 (TCP) or M429',
}

_VARIABLE = 'variables, jumps and loops are not supported yet; post with plain numbers'
_SIEMENS_CYCLE = 'cycles are not supported yet; post the cycle as G0 and G1 moves'
# By the beginning of the word; the first that fits is taken.
REFUSED_KEYS: dict[str, str] = {
    'CYCLE': _SIEMENS_CYCLE,
    'MCALL': _SIEMENS_CYCLE,
    'HOLES': _SIEMENS_CYCLE,
    'POCKET': _SIEMENS_CYCLE,
    'SUPA': _MACHINE,
    'TRANS': _FRAME,
    'ATRANS': _FRAME,
    'ROT': _FRAME,
    'AROT': _FRAME,
    'SCALE': _FRAME,
    'ASCALE': _FRAME,
    'MIRROR': _FRAME,
    'AMIRROR': _FRAME,
    'BSPLINE': 'native splines are not supported yet; post with linear moves',
    'CIP': f'arcs are not supported yet; {_LINEAR}',
    'CALL': _SUBPROGRAM,
    'SUB': _SUBPROGRAM,
    'DEF': _VARIABLE,
    'GOTO': _VARIABLE,
    'IF': _VARIABLE,
    'WHILE': _VARIABLE,
    'FOR': _VARIABLE,
    'REPEAT': _VARIABLE,
    'LOOP': _VARIABLE,
}
HARMLESS_KEYS = {
    'MSG', 'STOPRE', 'COMPON', 'COMPOF', 'COMPCAD', 'COMPCURV', 'FFWON', 'FFWOF', 'SOFT', 'BRISK',
    'DRIVE', 'FNORM', 'DIAMOF', 'CFC', 'CFTCP', 'CFIN', 'ORIWKS', 'SPOS', 'RTLION', 'RTLIOF',
}  # fmt: skip
INTERPOLATION_KEYS = {'ORIVECT': True, 'ORIAXES': False}


def refused_key(key: str) -> str:
    """Say why a word of several letters is refused, empty if it is not."""
    return next((why for head, why in REFUSED_KEYS.items() if key.startswith(head)), '')
