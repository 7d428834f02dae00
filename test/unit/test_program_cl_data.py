"""CL data: GOTO points, units, feed, continuation lines, and what is refused."""

import numpy as np
import pytest
from test_program_subdivision import TableAC

from cnc_interp.core import MM, ProgramError
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings


def read(text, **options):
    return read_text(text, 'part.apt', TableAC(), Settings(**options))


@pytest.mark.parametrize(
    'line',
    [
        'GOTO/1,-2.5,3,0,0.6,0.8',
        'GOTO / 1.0, -2.5 , 3.,  0.0, .6, 0.8',
        'goto/1 -2.5 3 0 .6 .8',
        'GOTO 1 -2.5 3 0 .6 .8',
        'GOTO/1,-2.5,3, $\n 0,0.6,0.8',
        'GOTO/1,-2.5,$\n3,0,$\n.6,0.8',
        'GOTO/1,-25E-1,3,0,0.6,0.8 $$ comment',
        'GOTO/1,-2.5,3,0,0.6,0.8\r',
    ],
)
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


def test_incremental_moves_and_a_tool_axis_that_stays():
    blocks = read('FEDRAT/60\nGOTO/1,2,3\nTLAXIS/0,.6,.8\nGODLTA/1,0,-1\nGOTO/0,0,0\n').blocks
    np.testing.assert_allclose(blocks.tip * 1e3, [[1, 2, 3], [2, 2, 2], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(blocks.axis[1:], [[0, 0.6, 0.8]] * 2)


@pytest.mark.parametrize(
    ('circle', 'ends', 'sense', 'turned', 'rise'),
    [
        ('CIRCLE/0,0,0,0,0,1,10', ['0,10,0'], 1, 90, 0),
        ('CIRCLE/0,0,0, $\n 0,0,-1,10', ['0,10,0'], -1, 270, 0),
        ('CIRCLE/0,0,0,0,0,1,10', ['10,0,0'], 1, 360, 0),
        ('CIRCLE/0,0,0,0,0,1,10', ['0,10,0', '-10,0,0', '0,-10,0'], 1, 270, 0),
        ('CIRCLE/0,0,0,0,0,1,10\nREMARK x', ['0,10,1', '-10,0,2'], 1, 180, 2),
        ('CIRCLE/0,0,0,0,0,-1,10', ['10,0,-2'], -1, 360, -2),
    ],
)
def test_points_on_a_circle_are_reached_along_it(circle, ends, sense, turned, rise):
    points = '\n'.join(f'GOTO/{end}' for end in ends)
    text = f'FEDRAT/60\nGOTO/10,0,0\n{circle}\n{points}\nFEDRAT/90\nGOTO/10,0,50\nFINI'
    blocks = read(text, contour_tolerance=1e-5).blocks
    tip = blocks.tip[:-1] * 1e3
    np.testing.assert_allclose(np.hypot(tip[:, 0], tip[:, 1]), 10, atol=1e-9)
    angle = np.unwrap(np.arctan2(tip[:, 1], tip[:, 0]))
    assert (np.sign(np.diff(angle)) == sense).all()
    assert angle[-1] == pytest.approx(sense * np.radians(turned))
    np.testing.assert_allclose(tip[:, 2], rise * angle / angle[-1], atol=1e-9)
    sagitta = 10e-3 * (1 - np.cos(np.diff(angle) / 2))
    assert sagitta.max() <= 0.1 * 1e-5
    assert (blocks.line_number[-1], blocks.feedrate[-1]) == (text.count('\n'), 1.5e-3)


@pytest.mark.parametrize('point', ['0,-9,0', '10,0.1,0', '-10,0,5'])
def test_a_point_off_the_circle_or_beyond_its_turn_is_reached_straight(point):
    text = f'FEDRAT/60\nGOTO/10,0,0\nCIRCLE/0,0,0,0,0,1,10\nGOTO/10,-0.1,0\nGOTO/{point}'
    blocks = read(text, contour_tolerance=1e-5).blocks
    assert blocks.line_number.tolist().count(5) == 1


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
        ('GOTO/1,2,3', 2, '--feed'),
        ('FEDRAT/60\nGOTO/1,2,3,0,0,-1', 3, '180 deg'),
        ('FEDRAT/0', 2, 'greater than zero'),
        ('FEDRAT/60,MMPR', 2, 'per revolution'),
        ('FEDRAT/60,KNOTS', 2, 'MMPM'),
        ('FEDRAT/IPM', 2, 'FEDRAT/value'),
        ('UNITS/MILES', 2, 'UNITS/MM'),
        ('CIRCLE/1,2,3', 2, 'CIRCLE/x,y,z,i,j,k,r'),
        ('CIRCLE/1,0,0,0,0,1,2', 2, '1 away from this circle'),
        ('CIRCLE/1,0,0,0,0,1,0', 2, 'a radius of zero'),
        ('CIRCLE/1,0,0,0,0,2,1', 2, 'unit vector'),
        ('FEDRAT/60\nCIRCLE/1,0,0,0,0,1,1\nFEDRAT/70\nGOTO/3,0,0', 5, '1 away from its circle'),
        ('CYCLE/DRILL,5', 2, 'a number without a word'),
        ('CYCLE/DRILL,FEDTO', 2, 'a number is missing'),
        ('CYCLE/THREAD,5', 2, 'this cycle'),
        ('CYCLE/DRILL,RAPTO,5', 2, 'its depth'),
        ('GODLTA/5', 2, 'GODLTA/dx,dy,dz'),
        ('GODLTA/1,2,3', 2, '--feed'),
        ('GODLTA/1,2,1E999', 2, '100,000 mm'),
        ('TLAXIS/NORMPS', 2, 'TLAXIS/i,j,k'),
        ('TLAXIS/1,1,1', 2, 'unit vector'),
        ('COPY/1,SAME,3', 2, 'INDEX'),
        ('TLON,GOFWD/(CIRCLE/0,0,0,1)', 2, 'part surfaces'),
        ('TRANS/0,0,1', 2, 'coordinate system'),
        ('MSYS/0,0,0\nMSYS/0,0,1', 3, 'coordinate system'),
        ('MODE/INCR', 2, 'unknown word'),
        ('GOFAR/1', 2, 'unknown word'),
        ('12 monkeys', 2, 'MAJOR/minor'),
        ('GOTO/1,2,$', 2, 'continued'),
    ],
)
def test_refusals_name_the_line(text, line, part):
    with pytest.raises(ProgramError) as caught:
        read('GOTO/0,0,0,0,0,1\n' + text)
    assert caught.value.line_number == line
    assert part in str(caught.value) and str(caught.value).startswith(f'part.apt:{line}: ')


def test_points_of_other_coordinate_systems_and_copies():
    head = 'UNITS/MM\nFEDRAT/400,MMPM\n'
    turned = 'CSYS/0,-1,0,50,1,0,0,0,0,0,1,2\n'  # X along Y, at 50 0 2
    first = read(head + turned + 'GOTO/1,2,3,0,0,1\nGOTO/4,2,3\n').blocks
    np.testing.assert_allclose(first.tip / MM, [[1, 2, 3], [4, 2, 3]], atol=1e-9)
    for second in (turned, 'CSYS/0,1,0,-1,0,0,0,0,1,50,0,2\n', 'MSYS/50,0,2,0,1,0,-1,0,0\n'):
        points = 'GOTO/1,2,3,1,0,0\nTLAXIS/0,0,1\nGODLTA/1,0,0\n'
        program = read(f'{head}MSYS/0,0,0,1,0,0,0,1,0\nGOTO/0,0,0,0,0,1\n{second}{points}')
        tips, axes = program.blocks.tip[[0, -2, -1]] / MM, program.blocks.axis[-2:]
        np.testing.assert_allclose(tips, [[0, 0, 0], [48, 1, 5], [48, 2, 5]], atol=1e-9)
        np.testing.assert_allclose(axes, [[0, 1, 0], [0, 0, 1]], atol=1e-9)
        assert 'must stay clamped' in str(program.notices)
    moved = read(
        head + 'GOTO/0,0,0\nTRACUT/1,0,0,5,0,1,0,0,0,0,1,0\nGOTO/1,0,0\nTRACUT/NOMORE\nGOTO/2,0,0'
    )
    np.testing.assert_allclose(moved.blocks.tip[:, 0] / MM, [0, 6, 2], atol=1e-9)
    for copy, wanted in (
        ('TRANSL,10,0,0,2', [(0, 0), (1, 0), (11, 0), (21, 0), (3, 3)]),
        ('XYROT,90,1', [(0, 0), (1, 0), (0, 1), (3, 3)]),
        ('SAME', [(0, 0), (1, 0), (0, 0), (1, 0), (3, 3)]),
    ):
        inner = 'GOTO/0,0,0\n' if copy == 'SAME' else ''
        text = f'{head}GOTO/0,0,0\nINDEX/1\n{inner}GOTO/1,0,0\nCOPY/1,{copy}\nGOTO/3,3,0\n'
        np.testing.assert_allclose(read(text).blocks.tip[:, :2] / MM, wanted, atol=1e-9)
