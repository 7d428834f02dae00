"""The meaning of each code: a setting, harmless, or rejected with a reason."""

import re

from cnc_interp.program.notices import WARNING

# Words that switch tool-tip programming (TCP), of several controls.
TCP_ON = {'M428', 'M128', 'G43.4', 'G43.5', 'G234', 'TRAORI', '#TRAFO ON'}
TCP_OFF = {'M429', 'M129', 'G49', 'TRAFOOF', '#TRAFO OFF'}
# Tool-tip modes that are a kind of tool length; a plain tool length (G43) ends them.
TCP_BY_LENGTH = {'G43.4', 'G43.5', 'G234'}
LENGTH = {'G43', 'G44', 'G43.1', 'G49'}
#: Codes with which H selects a tool length.
LENGTH_CODES = LENGTH | TCP_BY_LENGTH
TCP_ON_WORDS = 'M428, M128, G43.4, G43.5, G234, TRAORI or #TRAFO ON'

THREAD_CYCLE = 'G76 of LinuxCNC'
EXTRUDING = {'G1', 'G2', 'G3', 'G92'}  #: Codes with which E is the filament of a printer.
RADIUS = {'G40', 'G41', 'G41.1', 'G41.2', 'G42', 'G42.1', 'G42.2'}
#: Siemens words that select the compensation of G41 and G42: in the plane, or along normals.
RADIUS_KEYS = {'CUT2D': False, 'CUT3DF': True}
CYCLES = {'G73', 'G74', 'G76', 'G84.2', 'G84.3', *(f'G{number}' for number in range(81, 90))}

#: Notice of a spindle start without an output for it; the tool moves nevertheless.
NO_SPINDLE = (
    f'{WARNING}the spindle is NOT started, the machine file has no output for it; write '
    'signals: milling there, or start the spindle by hand before the tool cuts'
)
NO_COOLANT = (
    f'{WARNING}the coolant is NOT switched on, the machine file has no output for it; write '
    'signals: milling there, or switch it on by hand'
)
NO_LENGTH = (
    'the tool table has no length of this tool; enter it, touch the tool off or measure it '
    '(tools on the page, cnc-interp tools, --setup)'
)
NO_LENGTHS = (
    f'{WARNING}no tool lengths are known (--setup), they are taken as zero; a machine rejects '
    'this program until its tools are in the table'
)
#: Variables of positions that the subprogram of M6 may use; the setup must define these.
PLACES_OF_MACRO = {'#518': 'G30', '#538': 'G59.3'}
NO_PLACE = 'the subprogram of M6 goes to {}, which is not set; enter it in the setup (--setup)'
#: Notices of M codes on a machine without an output for them.
NO_OUTPUT = {'M3': NO_SPINDLE, 'M4': NO_SPINDLE, 'M7': NO_COOLANT, 'M8': NO_COOLANT}
NO_NUMBER = (
    f'{WARNING}NOT executed, the machine file has no signal for {{}}; declare it under signals, '
    'as digital_out_0, analog_out_0, digital_in_0'
)
#: Advice if a word of M62 to M68, or of M66, is missing.
NO_SUCH_NUMBER = (
    'give the number of the output as P, with M67 and M68 as E',
    'give the number of the input as P, and what to wait for as L3 (on) or L4 (off)',
)
HARMLESS_G: dict[str, str] = {
    **dict.fromkeys(('G15', 'G13.1', 'G40.1', 'G54.2', 'G255'), 'nothing to switch off'),
    'G62': 'no effect, F is kept in corners, too',
    'G103': 'no effect, the look-ahead covers the whole program',
    'G187': 'no effect, the path is always smoothed within the tolerances',
    'G96': 'no effect, the spindle is not driven',
    'G97': 'no effect',
    **dict.fromkeys(('G450', 'G451'), 'the cutter rolls around outer corners'),
    **dict.fromkeys(('G601', 'G602', 'G603'), 'no effect, exact stops are always exact'),
}

#: Harmless codes with words that give them another meaning, by code: the letters, and the reason.
_AXES = 'XYZABCUVW'
OTHER_MEANING: dict[str, tuple[str, str]] = {
    'G15': ('H', 'with H it is the work offset of Okuma; write G54 to G59'),
    'G255': ('H', 'is not supported with H; write G255 alone'),
    'G40.1': (_AXES, 'write G40.1 in a block of its own'),
}
#: Work offsets with H: on Okuma H is a tool length, elsewhere the two words are unrelated.
OKUMA_LENGTH = 'with H it is a tool length of Okuma; write G43 H, or H in another block'
#: Treatment of G10 words that controls interpret differently.
G10_CONFLICTS = {
    'incremental': 'with G91 Fanuc adds to the value, LinuxCNC sets it; write G90 first',
    'L2 P0': 'P0 is the active work offset on LinuxCNC, the external one on Fanuc; write P1 to P9',
    'tool R': 'R is the radius on LinuxCNC, the value (length) on Fanuc; write L1 with Z and R',
}

#: Switches of a control's look-ahead, and their words: G05 P10000, G05.1 Q1, G08 P1.
LOOK_AHEAD = {'G5': 'P', 'G5.1': 'QR', 'G8': 'P'}
SPLINE_LETTERS = frozenset('XYZIJ')  #: With these letters, a code of ``LOOK_AHEAD`` is a spline.

_LINEAR = 'post the program with linear moves'
_FRAME = 'changing the coordinate system is not supported this way; post in one workpiece frame'
TURNING = ('G70', 'G71', 'G72', 'G73')  #: Cycles of a lathe if they have P Q or U.
REFUSED_G: dict[str, str] = {
    **dict.fromkeys(('G5', 'G5.1', 'G5.2', 'G5.3'), f'spline moves are not supported; {_LINEAR}'),
    'G7': 'diameter programming is not supported; post with radii',
    'G254': 'dynamic work offsets are not supported; post with G234, or in the workpiece frame',
    'G66': 'modal macro calls are not supported; call with G65',
    'G500': 'cancels all zero offsets; post in a work offset, G54 to G59',
    **dict.fromkeys(('G110', 'G111'), f'polar coordinates are not supported; {_LINEAR}'),
}

#: Notices of stops before the first motion, M1 and M0.
NOT_YET = 'no wait before the first motion'
WAITS_FIRST = 'the machine waits for cycle start before it goes to the start of the path'
DWELL = 'exact stop; the dwell time is not kept'
ANY_DWELL = 'P may be s or ms, so its time is not kept; choose --dialect or write X'
#: Notices of arcs that fit in one interpretation only, by keys of ``arcs.FAULTS``.
CENTRES_TOLD = {
    8: 'taken as position of the centre: no other reading fits the arcs (--arc-centres absolute)',
    9: 'taken from centre to start: no other reading fits the arcs (--arc-centres reversed)',
}
_WAITS = 'waits for cycle start; a plan stops there and continues'
STOP_M = {'M0': _WAITS, 'M1': f'with optional stop on: {_WAITS}', 'M60': _WAITS}
END_M = {'M2', 'M30'}
#: Ends of a subprogram; M codes that stop, call, return or end.
RETURN_M = {'M17', 'M99'}
ACTING_M = END_M | STOP_M.keys() | RETURN_M | {'M61', 'M98'}
#: M codes that act before the others of their block, in this order.
FIRST_M = {'M6': 0, 'M3': 1, 'M4': 1, 'M5': 1}
#: Outputs that M codes switch, with the code that is active afterwards.
OUTPUTS: dict[str, dict[str, str]] = {
    **{code: {'spindle': code} for code in ('M3', 'M4', 'M5')},
    'M7': {'mist': 'M7'},
    'M8': {'coolant': 'M8'},
    'M9': {'mist': '', 'coolant': 'M9'},
}
STATE_M = {'M70', 'M71', 'M72', 'M73'}
REFUSED_M: dict[str, str] = {
    **dict.fromkeys(('M96', 'M97'), 'these subprogram calls are not supported; call with M98'),
    'M430': 'these kinematics are not supported; use M428 (TCP) or M429',
}

_SIEMENS_CYCLE = 'cycles are not supported in this form; post the cycle as G0 and G1 moves'
# Reasons by the beginning of the word; the first match counts.
REFUSED_KEYS: dict[str, str] = {
    'CUT2': 'write CUT2D; the compensation turns with the frame',
    'CUT3': 'the only supported compensation in space is CUT3DF with normals A5= B5= C5=',
    **dict.fromkeys(('POCKET', 'SLOT', 'LONGHOLE', 'CYCLE'), _SIEMENS_CYCLE),
    **dict.fromkeys(('ROTS', 'AROTS'), f'space angles are not supported; {_FRAME}'),
    **dict.fromkeys(
        ('ASPLINE', 'CSPLINE'),
        'BSPLINE is the only supported native spline; post with linear moves',
    ),
    'POLY': 'native polynomials are not supported; post with linear moves',
    'CIP': 'arcs by three points are not supported; give I, J, K',
    'CT': 'tangential arcs are not supported; give I, J, K',
    **dict.fromkeys(('CALL', 'SUB'), 'subprograms are called by M98, G65, O- CALL, or their name'),
    'DEF': 'write DEF REAL NAME=VALUE',
    'GOTO': 'write GOTO with a line number or a label',
    'IF': 'write IF [...] GOTO number, or IF [...] THEN #1=value',
    'WHILE': 'write WHILE [...] DO1, WHILE condition, or O1 WHILE [...]',
    'FOR': 'write FOR NAME = first TO last',
    'REPEATB': 'a section is repeated by a label; write REPEAT and UNTIL',
}
HARMLESS_KEYS = {
    'ACC',
    'ACCLIMA',
    'ADISPOS',
    'BRISK',
    'CDOF',
    'CDOF2',
    'CDON',
    'CFC',
    'CFIN',
    'CFTCP',
    'COMPCAD',
    'COMPCURV',
    'COMPOF',
    'COMPON',
    'COMPSURF',
    'CUTCONOF',
    'CUTCONON',
    'DIAMOF',
    'DISPLOF',
    'DRIVE',
    'DYNFINISH',
    'DYNNORM',
    'DYNPOS',
    'DYNROUGH',
    'DYNSEMIFIN',
    'EXTERN',
    'FCUB',
    'FFWOF',
    'FFWON',
    'FGROUP',
    'FIFOCTRL',
    'FLIN',
    'FNORM',
    'FGREF',
    'G0RT',
    'JERKLIMA',
    'KONT',
    'MMC',
    'MSG',
    'NORM',
    'ORIEULER',
    'ORIRPY',
    'ORISOF',
    'ORISON',
    'ORIWKS',
    'PROC',
    'RTLIOF',
    'RTLION',
    'SAVE',
    'SETAL',
    'SETMS',
    'SOFT',
    'SPATH',
    'SPCOF',
    'SPCON',
    'SPOS',
    'STARTFIFO',
    'STOPFIFO',
    'STOPRE',
    'UPATH',
    'VELOLIMA',
    'WALIMOF',
    'WALIMON',
    'WORKPIECE',
}
#: Harmless codes with letters of their own, which move nothing.
IDLE_LETTERS = {'G187': 'PE', 'G103': 'P', 'G54.2': 'P'}
#: Names of Siemens that are set in a block and do not move the tool; so are S1= and M1=.
HARMLESS_NAMES = {'SPOS', 'SPOSA', 'LIMS', 'ADIS', 'ADISPOS', 'STOLF', 'DISCL', 'FGREF'}
#: Siemens names that change path or feed, with advice.
REFUSED_NAMES: dict[str, str] = {
    **dict.fromkeys(
        ('AR', 'I1', 'J1', 'K1', 'AP', 'RP', 'A2', 'B2', 'C2'),
        'this word is not supported; give the end point and I, J, K',
    ),
    'LEAD': 'lead and tilt are not supported; give the tool axis as A3= B3= C3=',
    'TILT': 'lead and tilt are not supported; give the tool axis as A3= B3= C3=',
    'FZ': 'the feed per tooth is not supported; write the feed as F',
    **dict.fromkeys(
        ('FRC', 'FRCM', 'FB', 'OVR', 'OVRRAP'), 'this feed is not supported; write the feed as F'
    ),
}
UNKNOWN_NAME = 'no such word; correct it, or set the variable in a block of its own'
NO_SUCH_AXIS = 'no axis has this name; write the axis as a letter'

_CYCLE = re.compile(r'CYCLE(?:8\d|840|800|832)')


def refused_key(key: str) -> str:
    if key in RADIUS_KEYS or key in ('ROT', 'AROT', 'HOLES1', 'HOLES2') or _CYCLE.fullmatch(key):
        return ''
    return next((why for head, why in REFUSED_KEYS.items() if key.startswith(head)), '')
