"""CL data: GOTO points, units, feed, continuation lines, and what is refused."""

import numpy as np
import pytest
from test_program_subdivision import TableAC

from cnc_interp.errors import ProgramError
from cnc_interp.program import ReadOptions, read_text


def read(text, **options):
    return read_text(text, 'part.apt', TableAC(), ReadOptions(**options))


@pytest.mark.parametrize(
    'line',
    [
        'GOTO/1,-2.5,3,0,0.6,0.8', 'GOTO / 1.0, -2.5 , 3.,  0.0, .6, 0.8', 'goto/1 -2.5 3 0 .6 .8',
        'GOTO 1 -2.5 3 0 .6 .8', 'GOTO/1,-2.5,3, $\n 0,0.6,0.8', 'GOTO/1,-2.5,$\n3,0,$\n.6,0.8',
        'GOTO/1,-25E-1,3,0,0.6,0.8 $$ comment', 'GOTO/1,-2.5,3,0,0.6,0.8\r',
    ],
)  # fmt: skip
def test_spellings_of_one_point(line):
    program = read(f'PARTNO X\nFEDRAT/60,MMPM\nGOTO/0,0,0\n{line}\nFINI')
    blocks = program.blocks
    assert program.dialect == 'cl'
    np.testing.assert_allclose(blocks.tip[1] * 1e3, [1, -2.5, 3])
    np.testing.assert_allclose(blocks.axis, [[0, 0, 1], [0, 0.6, 0.8]])
    assert blocks.line_number.tolist() == [3, 4]
    assert np.isnan(blocks.rotary).all()
    assert blocks.feedrate[1] == pytest.approx(1e-3)


def test_three_numbers_keep_the_axis():
    blocks = read('GOTO/0,0,0,1,0,0\nRAPID\nGOTO/1,0,0\n').blocks
    np.testing.assert_allclose(blocks.axis, [[1, 0, 0], [1, 0, 0]])


@pytest.mark.parametrize(
    ('words', 'feed'),
    [
        ('FEDRAT/60,MMPM', 1e-3),
        ('FEDRAT / 60.0 , IPM', 0.0254),
        ('FEDRAT/IPM,60', 0.0254),
        ('FEDRAT/60', 0.0254),
        ('FEDRAT/60,PERMIN', 0.0254),
    ],
)
def test_feed_units(words, feed):
    blocks = read(f'UNITS/INCHES\nGOTO/0,0,0\n{words}\nGOTO/1,0,0\nGOTO/2,0,0').blocks
    np.testing.assert_allclose(blocks.feedrate[1:], feed)
    np.testing.assert_allclose(blocks.tip[:, 0], [0, 0.0254, 0.0508])


def test_rapid_is_for_the_next_point_only():
    blocks = read('FEDRAT/60\nGOTO/0,0,0\nRAPID\nGOTO/1,0,0\nGOTO/2,0,0').blocks
    assert blocks.rapid.tolist() == [False, True, False]
    np.testing.assert_allclose(blocks.feedrate[1:], [np.inf, 1e-3])


def test_axes_are_normalised_and_repeated_points_merged():
    text = 'FEDRAT/60\nGOTO/0,0,0,0,0,1\nGOTO/0,0,0,0,0,1.0001\nGOTO/1,0,0,0,0.6,0.803'
    blocks = read(text).blocks
    assert len(blocks) == 2
    np.testing.assert_allclose(np.linalg.norm(blocks.axis, axis=1), 1.0, atol=1e-15)


def test_stops_from_and_notices():
    text = (
        'REMARK a\nPPWORD/A,1\nPPWORD/B,2\nSPINDL/RPM,100\nMULTAX/ON\nFROM/0,0,9\nRAPID\n'
        'GOTO/0,0,0\nSTOP\nFEDRAT/60\nGOTO/1,0,0\nCOOLNT/OFF\nCUTCOM/OFF\nFINI\nGOTO/bad'
    )
    program = read(text)
    np.testing.assert_allclose(program.blocks.tip[:, 2] * 1e3, [9, 0, 0])
    assert program.blocks.exact_stop.tolist() == [False, True, True]
    words = [notice.split(':')[1].strip() for notice in program.notices]
    assert words == ['PPWORD', 'SPINDL', 'STOP', 'COOLNT', 'CUTCOM']


def test_feed_of_files_without_fedrat():
    assert read('GOTO/0,0,0\nGOTO/1,0,0', feedrate=0.02).blocks.feedrate[1] == 0.02


@pytest.mark.parametrize(
    ('text', 'line', 'part'),
    [
        ('GOTO/1,2', 2, 'three numbers'),
        ('GOTO/1,2,nan', 2, 'three numbers'),
        ('GOTO/1,2,3,0,1', 2, 'three numbers'),
        ('GOTO/1,2,1E999', 2, '100,000 mm'),
        ('GOTO/1,2,3,0,0,0', 2, 'unit vector'),
        ('GOTO/1,2,3,0,0,1.006', 2, 'unit vector'),
        ('GOTO/1,2,3,0,0,1E200', 2, 'unit vector'),
        ('GOTO/1,2,3', 2, '--feed MM_PER_MIN'),
        ('FEDRAT/60\nGOTO/1,2,3,0,0,-1', 3, '180 deg'),
        ('FEDRAT/0', 2, 'greater than zero'),
        ('FEDRAT/60,MMPR', 2, 'per revolution'),
        ('FEDRAT/60,KNOTS', 2, 'MMPM'),
        ('FEDRAT/IPM', 2, 'FEDRAT/value'),
        ('UNITS/MILES', 2, 'UNITS/MM'),
        ('CUTCOM/LEFT', 2, 'cutter compensation'),
        ('CIRCLE/1,2,3', 2, 'circles'),
        ('CYCLE/DRILL,5', 2, 'cycles'),
        ('GODLTA/1,2,3', 2, 'incremental'),
        ('12 monkeys', 2, 'MAJOR/minor'),
        ('GOTO/1,2,$', 2, 'continued'),
    ],
)
def test_refusals_name_the_line(text, line, part):
    with pytest.raises(ProgramError) as caught:
        read('GOTO/0,0,0,0,0,1\n' + text)
    assert caught.value.line_number == line
    assert part in str(caught.value) and str(caught.value).startswith(f'part.apt:{line}: ')
