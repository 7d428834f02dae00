"""The words of Heidenhain plain text, and the meaning of words without a value."""

import re

DECIMAL_COMMA = re.compile(r'(?<=\d),(?=\d)')  #: Older controls write X+10,5.
HEAD = re.compile(r'\s*/?\s*(?:\d+(?=\s|$))?\s*(.*?)\s*~?\s*$')
VALUE = r'[-+]?\s*(?:Q[LR]?\d+|\d+\.?\d*|\.\d+)'
WORD = re.compile(
    rf'(?P<code>M\d+)\b\.?|(?P<max>FMAX|F\s+MAX|F?AUTO|MB\s*MAX)|(?P<dr>DR)\s*(?P<sign>[-+])(?!\d)|(?P<radius>R[0LR](?![\d.])|R(?=\s|$))|'
    rf'(?P<name>I?(?:X|Y|Z|A|B|C|U|V|W)|I?P[AR]|[NT][XYZ]|SP[ABC]|[BN][XYZ]|EUL(?:PR|NU|ROT)|PRO(?:PR|MIN)|I?ROT|DL|DR2?|MB|LA|F|R|S)'
    rf'\s*=?\s*(?P<value>{VALUE})|(?P<bare>[MF])(?=\s|$)|(?P<space>\s+)'
)
TOOL_CALL = re.compile(r'TOOL\s+CALL\s*(?:("[^"]*")|(\d+))?\s*([XYZ])?\s*(.*)')
LABEL = re.compile(r'LBL\s*(\d+|"[^"]+"|[A-Z]\w*)')
CALL = re.compile(r'CALL\s+LBL\s*(\d+|"[^"]+"|[A-Z]\w*)\s*(?:REP\s*(\d+)\s*(?:/\s*\d+)?)?')
CALL_FILE = re.compile(r'CALL\s+PGM\s+(?:\S*[\\/])?([\w-]+?)(?:\.H)?')
CYCLE = re.compile(r'CYCLE?\s+DEF\s*(\d+)(?:\.(\d+))?\s*(.*)')
SCALES = re.compile(rf'(SCL|(?:CC)?[XYZ])\s*=?\s*({VALUE})?')
FN = re.compile(r'FN\s*(\d+)\s*:\s*(.*)')
JUMP = re.compile(rf'IF\s*({VALUE})\s*([A-Z]+)\s*({VALUE})\s*GOTO\s*LBL\s*(\d+|"[^"]+"|\w+)')
CORNER = re.compile(rf'(RND|CHF)\s*R?\s*({VALUE})\s*(?:F.*)?')
SET = re.compile(r'(Q[LR]?\d+)\s*=\s*(.*)')
PLANE = re.compile(r'PLANE\s+(\w+)\s*(.*)')
TURNING = re.compile(
    r'\b(?:(MOVE|TURN|STAY)|SEQ\s*([-+])|DIST\s*[-+]?[\d.]+|(COORD|TABLE)\s+ROT|'
    r'F\s*MAX|F\s*[\d.]+|MB\s*[\d.]+)'
)
#: Cycles that only set values, with the notice for each.
SETTING = {
    247: 'the datum is that of the work offset that is active',
    239: 'the load has no effect',
    392: 'the tuning has no effect',
}
CONDITIONS = {9: '==', 10: '<>', 11: '>', 12: '<'}  #: Conditions of FN 9 to FN 12.
IDLE_M = {
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
#: M codes with a meaning only in this dialect.
OWN_M = {'M13', 'M14', 'M89', 'M91', 'M99', 'M126', 'M127', 'M136', 'M137'}
#: M codes that correspond to codes of G-code.
AS_CODES = {
    'M91': ['G53'],
    'M136': ['G95'],
    'M137': ['G94'],
    'M13': ['M3', 'M8'],
    'M14': ['M4', 'M8'],
}
REFUSED_M = {
    **dict.fromkeys(
        ('M112', 'M114', 'M118', 'M130', 'M144', 'M150'),
        'this M code is not supported; post without it',
    ),
    'M92': 'counts from a point that the machine builder has set; post with M91',
}
