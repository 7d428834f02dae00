"""
Mutated programs: a reader answers with blocks or with ProgramError, soon, and with nothing else.

``CNC_INTERP_EXAMPLES=1000000`` tries so many programs; a failing program is shown by its seed.
"""

import io
import random
import signal
import warnings
from pathlib import Path

import numpy as np
from tiers import examples

from cnc_interp.core import ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.reading import ProgramStream
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

SHARED = Path(__file__).parents[3] / 'shared' / 'programs'
EXAMPLES = Path(__file__).parents[2] / 'examples'
COUNT = examples(150, 20_000)
#: Programs are read for one of these machines.
GEOMETRIES = [Transform.of(Machine.load(name)) for name in ('xyzac', 'xyzbc', 'xyz')]
#: Nothing that is read here is longer than some hundred lines.
MOST_SECONDS, MOST_BLOCKS = 300, 200_000
GCODE = """\
%
O1000 (HEAD)
G21 G90 G94 G17 G40 G49 G54 G64 P0.01
T1 M6
G0 G43 H1 Z50
#1=10
#<size>=[#1*2+SIN[30]]
R1=5
R2=R1*2
G0 X0 Y0 A0 C0 S1000 M3
G1 X#1 Y[#<size>/4] F500
G2 X20 Y0 R10
G3 X0 Y0 I-10 J0 Z-1
G18 G2 X5 Z-1 I2.5 K0
G17 M428
G1 X5 Y5 Z1 A10 C90 F1000
TRAORI
G1 X1 Y2 Z3 A3=0.1 B3=0 C3=1
TRAFOOF
G93 G1 X7 F60
G94 F300
G98 G81 X1 Y1 Z-5 R2 L2
G83 X3 Z-9 R2 Q1.5
G80 G91 G28 Z0
G90 G52 X1
G4 P0.1
G92 X0 Y0
O10 while [#1 GT 0]
G1 X#1
#1=[#1-1]
O10 endwhile
IF [#1 EQ 0] GOTO 90
G0 X100
N90 WHILE [#1 LT 3] DO1
#1=#1+1
END1
M98 P2000 L2
O20 call [1] [2]
/G1 X3
N100 G1 X=IC(5) Y=AC(2)
M30
O20 sub
G1 X#1 Y#2
O20 endsub
O2000
G1 Z1
M99
%
"""
CL = """\
PARTNO / TEST
UNITS / MM
MULTAX / ON
LOADTL / 1
FROM / 0,0,10,0,0,1
RAPID
GOTO / 1,2,3,0,0,1
FEDRAT / 500,MMPM
GOTO / 10,0,0, $
 0,0.6,0.8
$$ a remark
GOTO / 20,0,0,0.6,0,0.8
CIRCLE / 20,5,0, $
0,0,1,5
GOTO / 25,5,0
GOTO / 20,10,2
OPSTOP
TLAXIS / 0,0,1
GODLTA / 1,0,0
TRANS / 0,0,0
GOTO / 5 , 5 , 5
FINI
"""
#: What mutations put in: words with a meaning, and bytes with none.
PIECES = [
    *b'G2 G3 G41 G68 G91 G93 G95 G43.5 I1 R R-1 X X1e9 X.. F0 F-1 A720 C1e6 # #99999999'.split(),
    *b'[ ] [[ 1/0 SQRT[-1] ** 9**9**9 EXP[999] O10 GOTOB M99 while[1] L999999 K P99999'.split(),
    *b'BSPLINE PL=1 XH=1 CYCLE832(1) % ( ) ; \\ = =IC( $ $$ GOTO/ GOTO/1,2 UNITS/INCHES'.split(),
    *b'M0 M1 STOP TLAXIS/0,1,0 GODLTA/1,1,1 CIRCLE/1,1,1,0,0,1,1 1E400 G64 Q1'.split(),
    *b'nan inf .5 - --1 , \x00 \xff \xc2\xb0'.split(),
    *(b'GOTO 1', b'M98 P1000', b'\r', b'\n', b'\t', b'1' * 400),
]


def seeds():
    """The texts that mutations start from."""
    texts = [GCODE.encode(), CL.encode()]
    files = sorted(EXAMPLES.glob('*.*'))
    if SHARED.is_dir():
        files += [
            next(f for f in sorted(d.iterdir()) if f.name != 'SOURCE')
            for d in sorted(SHARED.iterdir())
        ]
    for file in files:
        if file.suffix not in ('.py', '.png', '.md', '.json', '.yaml'):
            lines = file.read_bytes().splitlines(keepends=True)
            said = [line for line in lines if not line.startswith((b'PPWORD', b'REMARK'))]
            texts.append(b''.join(said[:61]))
    return texts


def mutated(random_, texts):
    """Change a text in a few places."""
    text = bytearray(random_.choice(texts))
    for _ in range(random_.choice((1, 2, 3, 8))):
        at, kind = random_.randrange(len(text) + 1), random_.randrange(7)
        if kind == 0:
            text[at:at] = random_.choice(PIECES)
        elif kind == 1:
            text[at : at + random_.randrange(1, 9)] = b''
        elif kind == 2:
            text[at : at + 1] = bytes([random_.randrange(256)])
        elif kind == 3:
            text[at : at + 1] = random_.choice(b'0123456789.-+XYZACIJKRFGMNO#[]').to_bytes(
                1, 'big'
            )
        elif kind == 4:
            lines = bytes(text).split(b'\n')
            i, j = random_.randrange(len(lines)), random_.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
            text = bytearray(b'\n'.join(lines))
        elif kind == 5:
            other = random_.choice(texts)
            begin = random_.randrange(len(other))
            text[at:at] = other[begin : begin + random_.randrange(1, 60)]
        else:
            text = text[:at]
    return bytes(text)


def answer(text, geometry=GEOMETRIES[0]):
    """Read a text as a node would: how many blocks, or why not."""
    options = Settings(feedrate=0.01, most_jumps=300)
    count = 0
    try:
        for blocks in ProgramStream(Source(io.BytesIO(text), 'fuzz'), geometry, options):
            count += len(blocks)
            for column in (blocks.tip, blocks.axis, blocks.contour_tolerance):
                assert np.isfinite(column).all()
            assert not (np.isnan(blocks.feedrate) & np.isnan(blocks.duration)).any()
            assert np.abs(np.linalg.norm(blocks.axis, axis=1) - 1.0).max(initial=0.0) < 1e-9
            if count > MOST_BLOCKS:
                return count, ''
    except ProgramError as problem:
        told = str(problem).split('\n')[: len(getattr(problem, 'errors', ' '))]
        assert all(line.startswith('fuzz') for line in told)
        return count, str(problem)
    return count, ''


def too_long(*_):
    raise AssertionError('reading hangs')


def test_mutated_programs_are_read_or_refused():
    texts = seeds()
    before = signal.signal(signal.SIGALRM, too_long)
    read = refused = 0
    for text in texts:
        answer(text)  # kernels are compiled, without an alarm
    assert not answer(GCODE.encode())[1] and not answer(CL.encode())[1]
    try:
        for seed in range(COUNT):
            text = mutated(random.Random(seed), texts)
            signal.alarm(MOST_SECONDS)
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter('error')
                    _, why = answer(text, GEOMETRIES[seed % 3])
            except Exception as problem:
                raise AssertionError(
                    f'seed {seed}: {type(problem).__name__}: {problem}'
                ) from problem
            read, refused = read + (not why), refused + bool(why)
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)
    # The mutations reach both ends of the readers.
    assert read > COUNT // 20 and refused > COUNT // 20
