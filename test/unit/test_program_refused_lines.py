"""All refusals of a program in one reading; heads and names of programs; slow blocks."""

import pytest
from test_program_subdivision import TableAC

from cnc_interp.core import ProgramError, RefusedLinesError
from cnc_interp.program import read_text
from cnc_interp.program.notices import MOST
from cnc_interp.settings.options import Settings


def read(text, name):
    return read_text(text, name, TableAC(), Settings())


def refused(text, name='part.ngc'):
    with pytest.raises(ProgramError) as caught:
        read(text, name)
    return caught.value


def test_all_lines_are_refused_at_once_in_their_order():
    error = refused(
        'G21 G90 G1 F500\nX1 Q5\nX2\nG12.7\nX3 Q5\nFOO\nG1 X4\nX5 Q5\nY1 P9\nM30\nBAR\n'
    )
    assert isinstance(error, RefusedLinesError)
    assert str(error).splitlines() == [
        'part.ngc:2: Q5: this word has no meaning here (also lines 5, 8)',
        'part.ngc:4: G12.7: this G code is not supported; post without it',
        'part.ngc:6: FOO: the letter O where a digit is expected; write F00 with the digit 0',
    ]
    assert (error.line_number, error.word, error.source) == (2, 'Q5', 'part.ngc')
    assert [one.line_number for one in error.errors] == [2, 4, 6]


def test_one_refusal_is_told_as_it_is():
    error = refused('G1 X1 F100\nFOO\nX2\n')
    assert not isinstance(error, RefusedLinesError) and str(error).startswith('part.ngc:2: FOO')


def test_an_arc_after_a_refused_line_is_not_refused_for_its_start():
    text = 'G21 G1 F100 X0 Y0\n{}\nG2 X20 Y0 I5 J0\nG1 X30 Y0 Z0\nG2 X40 Y0 R1\n'
    alone = refused(text.format('G1 X10'))
    assert [one.line_number for one in getattr(alone, 'errors', [alone])] == [5]
    lost = refused(text.format('FOO X9'))
    assert [one.line_number for one in lost.errors] == [2, 5]


def test_a_missing_feed_or_variable_after_a_refused_line_is_not_told():
    assert refused('F-100\nG1 X0\nG1 X10\n').line_number == 1
    error = refused('G1 X0 F100\n#1=[2/0]\nX[#1]\nFOO\n')
    assert [one.line_number for one in error.errors] == [2, 4]


def test_what_depends_on_a_refused_line_is_not_judged():
    """One message for each fault: an unknown cycle, frame or compensation has no followers."""
    for first, after in (
        ('G87.3 R5 Q2', 'X9 R5'),
        ('G41.9 D1', 'G41 D1\nG1 X9\nG42'),
        ('FOO X9', 'G2 X20 Y0 I5 J0\nG91\nX1\nG2 X5 R1'),
        ('G93.1', 'G1 X5'),
    ):
        assert refused(f'G0 X0 Y0 Z0\n{first}\n{after}\nM30\n').line_number == 2
        assert not isinstance(refused(f'G0 X0\n{first}\n{after}\n'), RefusedLinesError)
    assert len(refused('G0 X0\nFOO\nBAR\n').errors) == 2


def test_an_axis_that_is_missing_is_told_once_whatever_its_words():
    text = 'R1=0\nWHILE R1<8\nG1 X=R1 B=R1 F100\nR1=R1+1\nENDWHILE\nG1 B3\nX9\nM30\n'
    told = str(refused(f'G0 X0 Y0 Z0\n{text}', 'a.mpf'))
    assert (
        told
        == 'a.mpf:4: B: the machine has no axis B, only X Y Z A C; remove the word (also line 7)'
    )


def test_a_spline_is_read_on_after_a_refused_control_point():
    start = 'TRAORI\nG1 F1000 X0 Y0 Z0\nBSPLINE SD=3\n'
    error = refused(f'{start}X5 XH=5 PL=0\nX20 Y20\nX40\n')
    assert [one.line_number for one in error.errors] == [4]
    assert 'give XH YH ZH, all three at first' in str(error)


def test_a_wrong_jump_ends_the_reading():
    error = refused('G1 X1 F100\nFOO\nGOTO 77\nBAR\n')
    assert [one.line_number for one in error.errors] == [2, 3]


def test_reading_ends_after_many_refusals():
    error = refused('G1 X1 F100\n' + ''.join(f'WORD{i}X\n' for i in range(60)))
    assert len(error.errors) == MOST
    assert str(error).endswith('there may be more; the reading ended here')
    loop = refused('#1=0\nG1 X1 F100\nWHILE [#1 LT 100000] DO1\n#1=[#1+1]\nFOO\nEND1\n')
    assert [one.line_number for one in getattr(loop, 'errors', [loop])] == [5]


def test_cl_data_are_refused_at_once_too():
    error = refused(
        'FEDRAT/500\nGOTO/0,0,0\nFOO/1\nGOTO/0,0,0,0,0,2\nCIRCLE/1,0,0,0,0,1,7\nGOTO/3,0,0\n'
        'MACRO/1\nGOTO/1,$\n',
        'part.cl',
    )
    assert [one.line_number for one in error.errors] == [3, 4, 7, 8]


def test_many_different_refusals_end_with_a_table_of_their_words():
    text = 'G21\nG0 X0 Y0 Z0\n' + 'G7\n' * 3 + 'FOO\nG1 X1 Q5 F9\nBAR\nG66 P1\n'
    assert (
        str(refused(text)).splitlines()[-1]
        == '6 refused lines: G7 in 3, FOO in 1, BAR in 1, G66 in 1'
    )
    assert 'refused lines' not in str(refused(text.replace('G66 P1\n', '').replace('FOO', '')))


def test_words_of_cam_systems():
    program = read(
        'UNIT/INCHES\nCSI_OPERATION/3\nCSI_STOCK/1\nTRNTYP/2\nCSYS/1,0,0,0,0,1,0,0,0,0,1,0\n'
        'CSYS/1,0,0,0,1,0,0,0,1,0,0,0\nCSYS/MILL_1\nCSYS/MILL_1\nFEDRAT/10\nGOTO/1,0,0\n'
        'GOTO/2,0,0\n',
        'part.cl',
    )
    assert program.blocks.tip[-1, 0] == pytest.approx(0.0508)
    assert [notice.split(':')[1].strip() for notice in program.notices] == ['CSI_', 'TRNTYP']
    for second in ('CSYS/MILL_2', 'CSYS/1,0,0,5,0,1,0,0,0,0,1,0', 'CSYS/1,2,3'):
        error = refused(f'CSYS/MILL_1\nFEDRAT/10\nGOTO/1,0,0\n{second}\nGOTO/2,0,0\n', 'a.cl')
        assert error.line_number == 4


@pytest.mark.parametrize(
    'head',
    [
        '%\n<SHAFT_1>\n',
        '%\nO<SHAFT-1>\n',
        'O1234 SHAFT 1\n',
        'OSHAFT1\n',
        'O1234-A\n',
        'O1234(SHAFT)\n',
        '%_N_SHAFT_MPF\n;$PATH=/_N_MPF_DIR\n',
        '% SHAFT\n',
        'LISTING OF SHAFT.NC: 12 LINES\n*****\n\n%\nO1\n',
    ],
)
def test_heads_and_names(head):
    program = read(head + 'G21 G1 F100 X1\nX2\nM30\n', 'part.nc')
    assert program.blocks.tip[-1, 0] == pytest.approx(0.002)
    assert len(program.notices) == head.startswith('LISTING')


def test_text_before_a_last_percent_is_the_program():
    assert refused('LISTING\nG1 X1 F100\n%\n').line_number == 1


def test_a_block_of_hours_is_told():
    notices = read('G93 G1 X1 F1\nX2 F0.005\nX3 F1\n', 'part.ngc').notices
    assert notices == ('line 2: G93: F0.005 makes a block last 3.33 h; F is in blocks per minute',)
    assert not read('G93 G1 X1 F1\nX2 F0.02\n', 'part.ngc').notices


@pytest.mark.thorough
def test_text_that_cannot_be_read_on_does_not_hide_what_was_refused_before():
    lines = 'X1\n' * 200_000
    error = str(refused(f'G21 G90 G94\nG0 X0 Y0 Z0\nG1 Xfoo F100\n{lines}{"X" * 200_000}\n'))
    assert 'part.ngc:3: XFOO' in error.upper().replace('PART.NGC', 'part.ngc')
    assert 'a line of more than' in error


def test_a_program_of_days_is_refused_by_its_slowest_line():
    error = refused('G21 G1 X1 F100\nX2\nX9400 F1\nX0 F3000\nM30\n')
    assert error.line_number == 3 and 'takes more than 100 h' in error.message
    assert '157 h' in error.message
    many = 'X900 F10\nX0\n' * 40  # each takes 1.5 h
    assert refused(f'G1 X0 F10\n{many}').line_number == 2
    assert refused('G1 X0 F10\nG93 X1 F0.0001\n').line_number == 2
    assert len(read(f'G1 X0 F10\n{many[:220]}', 'part.ngc').blocks) > 30
