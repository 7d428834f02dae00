"""The words of CL data: supported, harmless, and refused with a reason."""

from __future__ import annotations

import re

from cnc_interp.core.units import INCH, MM
from cnc_interp.program import codes
from cnc_interp.program.target_row import AT_M0, AT_M1

#: Words that are followed by text to the end of the line.
TEXT = ('PARTNO', 'PPRINT', 'REMARK', 'INSERT', 'LETTER', 'TPRINT')
#: Words without effect on the motion, ignored without a notice.
SILENT = {'MACHIN', 'MULTAX', 'INTOL', 'OUTTOL', 'TOLER', 'CUTTER', 'NOPOST', 'CLPRNT', 'END'}
#: Words that do not move the tool; they give one notice.
HARMLESS = {
    'AUTOPS', 'AUXFUN', 'CAMERA', 'CLAMP', 'CLEARP', 'COOLNT', 'DISPLY', 'LEADER', 'LINTOL',
    'LOAD', 'LOADTL', 'MAXDP', 'MCHTOL', 'MFG', 'NUMPTS', 'OPSKIP', 'OPTOOL', 'PAINT', 'PLABEL',
    'PLOT', 'PPFUN', 'PPWORD', 'PREFUN', 'PRINT', 'REWIND', 'SAFETY', 'SELCTL', 'SELECT', 'SEQNO',
    'SETUP', 'SPINDL', 'TLDATA', 'TOOL', 'TOOLNO', 'TRNTYP', 'TURRET',
}  # fmt: skip
INFORMATION = 'CSI_'  #: Words with this beginning are information of a CAM system.
#: Words that switch outputs of the machine or name the tool: what a start in the middle tells.
OUTPUTS = {'COOLNT', 'LOADTL', 'SPINDL', 'TOOLNO'}
#: Words that stop: the kind of stop (``TargetColumns.stop_here``), and the text of the notice.
STOPS = {
    'STOP': (AT_M0, codes.STOP_M['M0']),
    'OPSTOP': (AT_M1, codes.STOP_M['M1']),
    'DELAY': (1.0, codes.DWELL),
    'DWELL': (1.0, codes.DWELL),
}
LINEAR = 'output the tool path as GOTO points'
_FRAME = 'changing the coordinate system is not supported; output one workpiece frame'
_DRIVEN = f'motion along part surfaces is not supported; {LINEAR}'
REFUSED = {
    'MOVARC': f'arcs are supported as CIRCLE/x,y,z,i,j,k,r; or {LINEAR}',
    'ARCMOV': f'arcs are supported as CIRCLE/x,y,z,i,j,k,r; or {LINEAR}',
    'GOHOME': f'machine-coordinate moves are not supported; {LINEAR}',
    'RETRCT': f'retract moves are not supported; {LINEAR}',
    'ROTATE': f'rotary table moves are not supported; {LINEAR}',
    'ROTABL': f'rotary table moves are not supported; {LINEAR}',
    'ROTHED': f'rotary head moves are not supported; {LINEAR}',
    'MACRO': f'macros are not supported; {LINEAR}',
    'CALL': f'macros are not supported; {LINEAR}',
    'PROBE': f'probing is not supported; {LINEAR}',
    **dict.fromkeys(
        ('GO', 'GOFWD', 'GOBACK', 'GOLFT', 'GORGT', 'GOUP', 'GODOWN', 'INDIRP', 'TLON',
         'TLLFT', 'TLRGT', 'PSIS', 'DNTCUT'), _DRIVEN),
}  # fmt: skip
#: Words that are refused unless they switch something off or contain only zeros.
OFF_ONLY = {
    'ORIGIN': _FRAME,
    'TRANS': _FRAME,
}
OFF = {'', 'OFF', 'NOMORE'}
UNKNOWN = 'unknown word; write $$ before it if it does not move the tool'
LENGTH_UNITS = {'MM': MM, 'MILLIM': MM, 'INCH': INCH, 'INCHES': INCH}
FEED_UNITS = {'MMPM': MM, 'IPM': INCH, 'PERMIN': 0.0}


def machine_words(major: str, minor: str) -> tuple[list[str], dict[str, float]]:
    fields = [field.strip() for field in minor.split(',')]
    numbers = [float(field) for field in fields if re.fullmatch(r'\d+\.?\d*', field)]
    if major == 'SPINDL':
        given = {'S': numbers[0]} if numbers else {}
        turns = 'M4' if 'CCLW' in fields else 'M3'
        return (['M5'], {}) if minor in OFF else ([*given, turns], given)
    if major == 'COOLNT':
        return (['M9'] if minor in OFF else ['M7' if 'MIST' in fields else 'M8']), {}
    return (['T', 'M6'], {'T': numbers[0]}) if major == 'LOADTL' and numbers else ([], {})
