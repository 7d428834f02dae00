"""What a program may not say: one line that names file, line, word and what to do."""

import re
from pathlib import Path

import pytest
from processor_time import bounded_processor_time
from test_program_subdivision import TableAC

from cnc_interp.core import ProgramError, SettingsError
from cnc_interp.program import read_text
from cnc_interp.program.readers import cl_words
from cnc_interp.program.text import code_tables as codes
from cnc_interp.settings.options import Settings

SYNTAX = [
    ('G0 X1 X2', 'X2', 'twice'),
    ('G0 G1 X2', 'G1', 'G0 is in the same block'),
    ('G90 G91 X2', 'G91', 'G90 is in the same block'),
    ('G0 X', 'X', 'without a number'),
    ('G0 X Y2', 'X', 'without a number'),
    ('G0 12', '12', 'without a letter'),
    ('G0 X1.2.3', 'X1.2.3', 'not a number'),
    ('G0 X1 (open', '(OPEN', 'not closed'),
    ('G0 XNAN', 'XNAN', 'unknown word'),
    ('G0 X1e9999', '1E9999', 'with an exponent'),
    ('G1 X[1+2] Y1E-3', '1E-3', 'with an exponent'),
    ('G0 X' + '9' * 400, 'X inf', '100,000 mm'),
    ('G0 Y-100001', 'Y -100001', '100,000 mm'),
    ('FROBNICATE', 'FROBNICATE', 'unknown word'),
    ('G71 U2 R1', 'G71', 'lathe'),
    ('G71 P10 Q20 W0.1', 'G71', 'lathe'),
    ('TRAOOF', 'TRAOOF', 'is it TRAFOOF'),
    ('G0 X1 I2', 'I2', 'no meaning'),
    ('G2 X1 I0.5 Q2 F9', 'Q2', 'no meaning'),
    ('G2 X1 R' + '9' * 200 + ' F9', 'G2', '1000 km'),
    ('G2 X' + '9' * 170 + ' R5 F9', 'G2', 'half the distance'),
    ('G3 X1 Y1 I' + '9' * 200 + ' F9', 'G3', '1000 km'),
    ('G0 U5', 'U', 'axis'),
    ('G0 B5', 'B', 'no axis B'),
    ('G1 X1 F0', 'F0', 'greater than zero'),
    ('G1 X1 F-5', 'F-5', 'greater than zero'),
    ('G64 P-1', 'P-1', 'greater than zero'),
    ('G64 P-0.1', 'P-0.1', 'greater than zero'),
    ('G1 X1', '', 'no feedrate'),
    ('G93\nG1 X1', '', 'G93'),
    ('G1 F60 X1\nG93\nX2', '', 'G93'),
    ('G93\nG1 X1 F60\nG94\nX2', '', 'no feedrate'),
    ('G1 X1 F60\nG93 X2 F60\nG94 X3', '', 'no feedrate'),
    ('G4 Y5', 'G4', 'two lines'),
    ('M428\nG0 C400000', 'C400000', '1000 turns'),
    ('\x00\x01', "'\\x00\\x01'", 'not text'),
]
UNSUPPORTED = [
    'G5.2 X1',
    'G7',
    'CUT3DC',
    'CUT3DFS',
    'G254',
    'G66 P1',
    'G10 L3 P1',
    'M97',
    'M430',
    'G123',
    'POCKET3(1,2)',
    'CSPLINE',
    'X=FROB(1)',
    'CIP X1 I1=2',
    'G54.2 P1',
]
FLOW = [
    ('G0 X#5', 'before it is set'),
    ('G0 X=R1', 'before it is set'),
    ('G0 X#<deep>', 'before it is set'),
    ('#5000=1', 'cannot be set'),
    ('G0 X[1/0]', 'no value'),
    ('G0 X[LN[0]]', 'no value'),
    ('G0 X[1+]', 'cannot be read'),
    ('G0 X[1', 'cannot be read'),
    ('G0 X' + '[' * 3000 + '1' + ']' * 3000, 'nested'),
    ('G0 X[' + '1+' * 3000 + '1]', 'nested'),
    ('IF [1 EQ 1] FROB', 'write IF'),
    ('IF [1 EQ 1] GOTO 77', 'no line with this number'),
    ('GOTOF NOWHERE', 'no line with this number'),
    ('N5 GOTO 5', 'does not end'),
    ('WHILE [1] DO1\nEND1', 'does not end'),
    ('WHILE [0] DO1', 'missing'),
    ('END1', 'not begun'),
    ('O1 CALL', 'not in this file'),
    ('O1 SUB', 'missing'),
    ('O1 SUB\nO2 SUB\nO2 ENDSUB\nO1 ENDSUB', 'within a subprogram'),
    ('O1 CALL\nO1 SUB\nG0 X1\nO1 ENDSUB', 'ends without M2'),
    ('O1 CONTINUE', 'not begun'),
    ('IF R0==1', 'before it is set'),
    ('ENDWHILE', 'not begun'),
    ('FOR R1=1', 'write FOR'),
    ('DEF FRAME A_B', 'write DEF REAL'),
    ('CALL "X"', 'add it'),
    ('L54', 'add it'),
    ('M72', 'M70 first'),
    ('G0 X EXISTS[###2]', 'before it is set'),
    ('O1 ENDSUB', 'not called'),
    ('O1 WHILE [1]\nO1 ENDWHILE', 'does not end'),
    ('O1 IF [0]', 'missing'),
    ('M98', 'number of the subprogram'),
    ('M98 P2', 'not in this file'),
    ('G65 P1', 'not in this file'),
    ('O7 SUB\nO7 CALL\nO7 ENDSUB\nO7 CALL', 'deep'),
]
ARCS = [
    ('G2 X1', 'needs its centre'),
    ('G1 F60 X1\nG3 X5 I1', 'distance from the centre'),
    ('G1 F60 X1\nG3 X5 R1', 'smaller than half'),
    ('G1 F60 X1\nG3 R1', 'full circle'),
    ('G1 F60 X1\nG3 X2 I1 R1', 'keep one'),
    ('G1 F60 X1\nG3 X2 I0 J0', 'at the start of the arc'),
    ('G1 F60 X1\nG3 X1 I5 P0.5', 'whole number'),
    ('G1 F60 X1\nG3 X1 I5 P501', 'whole number'),
    ('G53 G2 X1 I1', 'machine coordinates'),
]
OFFSETS_AND_CYCLES = [
    ('G28 G92 X0', 'same block'),
    ('G1 X5 NAME=2 F60', 'no such word'),
    ('G43.1 Z5\nG0 X1 H2', 'changes the tool length'),
    ('G81 X1 R2 F60', 'depth'),
    ('G81 X1 Z-2 F60', 'retract plane'),
    ('G81 X1 Z-2 R-3 F60', 'below the depth'),
    ('G83 X1 Z-2 R1 F60', 'peck'),
    ('G83 X1 Z-2 R1 Q0.0000001 F60', 'pecks'),
    ('G81 X1 Z-2 R1', 'no feedrate'),
    ('G81 G53 X1 Z-2 R1 F60', 'machine coordinates'),
    ('G81 A5 X1 Z-2 R1 F60', 'rotary words in a canned cycle'),
    ('G76 X1 Z-2 R1 F60', 'has no encoder'),
    ('G88 X1 Z-2 R1 F60', 'LinuxCNC has none'),
    ('G54.1 P0', '1 to 300'),
    ('G54.1', '1 to 300'),
    ('CYCLE81(1,2)', 'give the planes'),
    ('CYCLE81(5,9,0,3)', 'lies below'),
    ('HOLES1(0,0,0,0,5,3)', 'needs a modal cycle'),
    ('T1 T2', 'T is written twice'),
    ('G43 H99\nG43.1 Z5\nM428', 'machine file'),
    ('G0 A3=0 B3=0 C3=1', 'tool-tip programming'),
    ('M428\nG0 A3=0 B3=0 C3=0', 'zero'),
    ('M428\nG0 A5 A3=0 B3=0 C3=1', 'keep one'),
    ('CTOL=0', 'greater than zero'),
    ('CYCLE832(-1)', 'greater than zero'),
    ('G95 G1 X1 F0.1', 'spindle speed'),
]


def refused(text, start='G0 X0\n'):
    with pytest.raises(ProgramError) as caught:
        read_text(start + text, 'part.ngc', TableAC(), Settings(most_jumps=100))
    assert '\n' not in str(caught.value) and str(caught.value).startswith('part.ngc:')
    return caught.value


@pytest.mark.parametrize(('text', 'word', 'part'), SYNTAX)
def test_faulty_blocks_are_named(text, word, part):
    error = refused(text)
    assert error.line_number == 2 + text.count('\n')
    assert part in str(error)
    assert error.word == word[:40]


@pytest.mark.parametrize('text', UNSUPPORTED)
def test_unsupported_constructs_are_refused_with_a_remedy(text):
    error = refused(text)
    assert error.line_number == 2 and error.word
    assert 'support' in str(error) or 'unknown word' in str(error)


@pytest.mark.parametrize(('text', 'part'), FLOW + ARCS + OFFSETS_AND_CYCLES)
def test_what_cannot_be_done_is_named(text, part):
    assert part in str(refused(text))


def test_axis_words_need_a_motion_code_first():
    error = refused('X5', start='')
    assert error.line_number == 1 and 'G0 or G1' in str(error)


def test_the_work_offset_must_not_change():
    error = refused('G55\nG0 X1\nG55\nG54\nG0 X2')
    assert (error.line_number, error.word) == (5, 'G54') and 'G55' in str(error)


def test_texts_without_motion_are_refused():
    for text in ('', '(nothing)', 'G21\nM30', '%\n%'):
        with pytest.raises(ProgramError, match='no motion'):
            read_text(text, 'part.ngc', TableAC(), Settings())


@pytest.mark.parametrize('code', ['G53 Z0', 'G28'])
def test_machine_coordinates_with_tool_tip_programming_have_two_readings(code):
    with pytest.raises(ProgramError, match='axis positions on Fanuc, tip positions on LinuxCNC'):
        read_text(f'G0 X0 A9\nM428\n{code}', 'part.nc', TableAC(), Settings())


@pytest.mark.parametrize(
    'bad', [{'contour_tolerance': 0.0}, {'feedrate': -1.0}, {'flank_height': float('nan')}]
)
def test_options_must_be_greater_than_zero(bad):
    with pytest.raises(SettingsError, match=next(iter(bad))):
        Settings(**bad)


def test_a_line_of_a_million_characters_fails_at_once():
    for text in ('X' + '1' * 1000000 + 'Q', '(' * 1000000, 'Y' * 1000000, '1' * 1000000):
        assert len(str(refused(text))) < 200


@pytest.mark.parametrize(
    ('name', 'head', 'body'),
    [
        *(('part.ngc', head, ' ') for head in ('X', 'G1 X1', 'IF', 'WHILE', 'O1', 'A3=', 'GOTO')),
        *(('part.ngc', head, '1') for head in ('X', 'G', '#', 'WHILE')),
        *(('part.ngc', head, 'IF ') for head in ('', 'IF', 'WHILE')),
        *(('part.ngc', '', body) for body in ('(', 'X ', '"', 'A=', 'DO ', '[#', '-1', 'É')),
        *(('part.apt', 'GOTO', body) for body in (' ', '1', ' 1', ', ', '/')),
        *(('part.apt', 'FEDRAT/', body) for body in (' ', '/', '1,')),
    ],
)
def test_the_longest_lines_take_time_in_proportion_to_their_length(name, head, body):
    """Processor time is bounded: a quadratic pattern takes more than 10 s, a linear one 0.1 s."""
    start = 'GOTO/0,0,0\n' if name == 'part.apt' else 'G0 X0\n'
    text = start + (head + body * 65_000)[:65_000] + '!\n'

    with bounded_processor_time(5.0), pytest.raises(ProgramError):
        read_text(text, name, TableAC(), Settings(most_jumps=100))


def test_the_documentation_names_every_word_that_is_refused_by_name():
    page = Path(__file__).parents[2] / 'docs' / 'operate' / 'programs.md'
    named = set(re.findall(r'[A-Z]+[\d.]*\d|[A-Z]+', page.read_text(encoding='utf-8')))
    words = {
        *codes.REFUSED_G,
        *codes.REFUSED_M,
        *codes.REFUSED_KEYS,
        *cl_words.REFUSED,
        *cl_words.OFF_ONLY,
    }
    assert not words - named
