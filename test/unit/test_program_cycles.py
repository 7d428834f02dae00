"""Drilling cycles of Fanuc, Siemens and CL data, and what dialects read differently."""

import numpy as np
import pytest
import yaml

from cnc_interp.core import MM, MachineError, ProgramError
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, ProgramStream, Tool, read_text
from cnc_interp.program.reading import MdiReader
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

XYZ, AC = (Transform.of(Machine.load(name)) for name in ('xyz', 'xyzac'))


def read(text, name='part.nc', geometry=XYZ, setup=None, **options):
    return read_text(text, name, geometry, Settings(feedrate=0.01, **options), setup or JobSetup())


def heights(blocks):
    """Heights at the ends of the blocks [mm], those by feed with a minus before their mark."""
    marks = np.where(blocks.rapid, 'r', 'f')
    return [
        f'{mark}{z:g}' for mark, z in zip(marks, (blocks.tip[:, 2] / MM).round(6), strict=True)
    ]


@pytest.mark.parametrize(
    ('cycle', 'wanted'),
    [
        ('CYCLE81(9,2,1,-5)', 'r3 f-5 r9'),
        ('CYCLE82(9,2,1,,7,0)', 'r3 f-5 r9'),
        ('CYCLE83(9,2,1,-5,,,3,0,,,1,1)', 'r3 f-1 r3 r-0.4 f-4 r3 r-3.4 f-5 r9'),
        ('CYCLE83(9,2,1,-5,,0,,0,0.5,,1,0)', 'r3 f0 r1 f-2 r-1 f-4 r-3 f-5 r9'),
        ('CYCLE85(9,2,1,-5,,0,100,200)', 'r3 f-5 f3 r9'),
        ('CYCLE84(9,2,1,-5,,,3,,1.5,0,500,500)', 'r3 f-5 f3 r9'),
        ('CYCLE89(9,2,1,-5)', 'r3 f-5 f3 r9'),
    ],
)
@pytest.mark.parametrize('modal', [True, False])
def test_cycles_of_siemens(cycle, wanted, modal):
    text = f'MCALL {cycle}\nX5\nMCALL\nX6' if modal else f'X5\n{cycle}\nX6'
    blocks = read('G0 X0 Y0 Z9 S500\n' + text, 'part.mpf').blocks
    assert heights(blocks)[2:-1] == wanted.split()
    np.testing.assert_allclose(blocks.tip[2:-1, :2] / MM - (5, 0), 0, atol=1e-9)


def test_holes_in_rows_and_circles():
    text = 'G0 X0 Y0 Z9\nMCALL CYCLE81 (9, 2, 1, -5)\nHOLES1(1,2,0,3,4,2)\nHOLES2(0,0,10,90,0,2)\n'
    tips = read(text + 'MCALL', 'part.mpf').blocks.tip / MM
    holes = tips[tips[:, 2] == -5.0, :2]
    np.testing.assert_allclose(holes, [[4, 2], [8, 2], [0, 10], [0, -10]], atol=1e-9)


def test_cycles_of_fanuc():
    head = 'O0001 (PART)\nG0 X0 Y0 Z5\nF100 '
    shifted = read(head + 'G99 G76 X1 Z-2 R3 I0.5').blocks.tip[1:, [0, 2]] / MM
    ends = [(1, 5), (1, 3), (1, -2), (1.5, -2), (1.5, 3), (1, 3)]
    np.testing.assert_allclose(shifted, ends, atol=1e-9)
    back = read(head + 'G98 G87 X1 Z2 R-3 I0.5').blocks.tip[1:, [0, 2]] / MM
    ends = [(1.5, 5), (1.5, -3), (1, -3), (1, 2), (1.5, 2), (1.5, 5), (1, 5)]
    np.testing.assert_allclose(back, ends, atol=1e-9)
    waits = read(head + 'G99 G88 X1 Z-2 R3').blocks
    assert waits.program_stop[waits.tip[:, 2].argmin()]
    upward = read(head + 'G99 G81 X1 Z4 R3')
    assert heights(upward.blocks)[1:] == ['r5', 'r3', 'f4', 'r3'] and 'R below Z' in str(
        upward.notices
    )
    single = read(head + 'G99 G83 X1 Z-2 R3')
    assert heights(single.blocks)[1:] == ['r5', 'r3', 'f-2', 'r3'] and 'WARNING' in str(
        single.notices
    )
    by_q = read(head + 'G98 G87 X1 Z2 R-3 Q0.5')
    np.testing.assert_allclose(by_q.blocks.tip[1:, [0, 2]] / MM, ends, atol=1e-9)
    plain = read(head + 'G98 G87 X1 Z2 R-3')
    assert heights(plain.blocks)[1:] == ['r5', 'r-3', 'f2', 'r5']
    assert 'along +X' in str(by_q.notices) and 'without a shift' in str(plain.notices)


@pytest.mark.parametrize(
    ('cycle', 'wanted'),
    [
        ('DRILL,FEDTO,6,MMPM,100,RAPTO,3,RTRCTO,8,DWELL,0', 'r8 r3 f-6 r8'),
        ('DRILL,RAPTO,3,FEDTO,-6,MMPM,100', 'r3 f-6 r3'),
        (
            'DEEP2,FEDTO,6,1STPECK,4,SUBPECK,3,MMPM,100,RAPTO,3,RTRCTO,8',
            'r8 r3 f-4 r3 r-3.5 f-6 r8',
        ),
        ('BORE,DEPTH,6,MMPM,100,CLEAR,3', 'r3 f-6 f3'),
    ],
)
def test_cycles_of_cl_data(cycle, wanted):
    text = (
        f'UNITS/MM\nRAPID\nGOTO/0,0,20\nCYCLE/{cycle}\nGOTO/5,0,0\nGOTO/9,0,0\nCYCLE/OFF\nRAPID\n'
    )
    blocks = read(text + 'GOTO/0,0,20\nFINI', 'part.apt').blocks
    found = heights(blocks)
    assert found[1 : 1 + len(wanted.split())] == wanted.split()
    assert (blocks.tip[:, 2] < -1e-3 * 5.9).sum() == 2
    np.testing.assert_allclose(blocks.feedrate[~blocks.rapid] * 60 / MM, 100)


def test_cl_arcs_of_solidworks_nx_and_catia():
    head = 'PARTNO/1\nUNITS/MM\nRAPID\nGOTO/10,0,0\nFEDRAT/400,MMPM\n'
    for arc in (
        'CIRCLE/0,0,0,0,0,-1\nGOTO/0,10,0',
        'CIRCLE/0,0,0,0,0,-1,10,.1,.2,.3,.4\nGOTO/0,10,0',
        'INDIRV/0,-1,0\nTLON,GOFWD/(CIRCLE/0,0,0,$\n10),ON,2,INTOF,(LINE/0,0,0,$\n0,10,0)',
    ):
        tips = read(f'{head}{arc}\nGOTO/0,20,0\nFINI', 'part.apt').blocks.tip[:-1] / MM
        np.testing.assert_allclose(np.hypot(*tips[:, :2].T), 10.0, atol=1e-9)
        turned = np.unwrap(np.arctan2(tips[:, 1], tips[:, 0]))
        assert np.degrees(turned[-1]) == pytest.approx(-270)


def test_the_dialect_is_told_by_words_by_the_suffix_or_by_choice():
    entry = 'G0 X-9 Y0 Z0\nG41 D1\nG1 X0 Y0 F900\nY-9\n'
    tools = JobSetup(tools={1: Tool(0.0, 2.0 * MM)})
    for name, text, own in (
        ('a.nc', entry, False),
        ('a.ngc', entry, True),
        ('a.nc', entry + '#<a>=1\n', True),
        ('a.ngc', 'R1=3\n' + entry, False),
        ('a.nc', 'O1234 (X)\n' + entry, False),
        ('a.ngc', 'R1=3\n#<a>=1\n' + entry, False),
    ):
        tips = read(text, name, setup=tools).blocks.tip / MM
        np.testing.assert_allclose(tips[1, :2], [0, 2] if own else [2, 0], atol=1e-9)
    tips = read(entry, 'a.nc', setup=tools, dialect='linuxcnc').blocks.tip / MM
    np.testing.assert_allclose(tips[1, :2], [0, 2], atol=1e-9)


def test_the_machine_tells_whose_control_it_has():
    content = yaml.safe_load(find_machine_file('xyz').read_text())
    told = {'dialect': 'fanuc', 'arc_centres': 'reversed', 'units': 'inch'}
    machine = Transform.of(from_mapping(content | {'control': told}))
    text = 'X1 Y0\nG3 X0 Y1 I1 J0 F9\n'
    blocks = read(text, geometry=machine).blocks
    np.testing.assert_allclose(np.hypot(*blocks.tip[:, :2].T), 25.4 * MM, rtol=1e-9)
    with pytest.raises(ProgramError, match='--arc-centres reversed'):
        read(text, geometry=machine, arc_centres='start')
    assert ProgramStream(Source.of_text(text, 'a'), machine, Settings()).read_as == (
        'read as Fanuc and its kin: as chosen',
    )
    for wrong in ({'dialect': 'basic'}, {'unit': 'mm'}, 'fanuc'):
        with pytest.raises(MachineError):
            from_mapping(content | {'control': wrong})


def test_numbers_without_a_point_count_increments_where_the_control_does():
    text = (
        'G21\nG0 X10 Y-0002500 Z5.\nX[1+1]\nG99 G81 X1000 Z-2000 R1000 K2 F100\nG80\n'
        'G20 X19685\n#1=3\nX#1 Y1.\n'
    )
    content = yaml.safe_load(find_machine_file('xyz').read_text())
    machine = Transform.of(from_mapping(content | {'control': {'numbers': 'increments'}}))
    tips = read(text, geometry=machine).blocks.tip / MM
    np.testing.assert_allclose(tips[0], [0.01, -2.5, 5], atol=1e-9)
    assert tips[:, 2].min() == pytest.approx(-2)
    np.testing.assert_allclose(tips[-2:, 0], [1.9685 * 25.4, 3 * 25.4], atol=1e-9)
    told = {'dialect': 'fanuc', 'numbers': 'increments', 'units': 'inch'}
    line = MdiReader(Transform.of(from_mapping(content | {'control': told})), Settings()).line(
        'X10000', np.zeros(3), JobSetup()
    )
    assert line.read().blocks.tip[-1, 0] == pytest.approx(25.4 * MM - line.reader.mover.zero[0])


def test_taps_come_back_as_the_control_has_it():
    text = 'G0 X0 Y0 Z9\nG98 G84 X1 Z-2 R3 F900'
    assert heights(read(text).blocks)[1:] == ['r9', 'r3', 'f-2', 'f3', 'r9']
    assert heights(read(text, dialect='linuxcnc').blocks)[1:] == ['r9', 'r3', 'f-2', 'f9']
    with pytest.raises(ProgramError, match='wrong axis'):
        read(text.replace('G98', 'G18 G98'), dialect='linuxcnc')


def test_corners_and_angles_of_siemens():
    head = 'G0 X0 Y0 Z0 F900\nG1 X10 '
    rounded = read(head + 'RND=2\nY10', 'a.mpf').blocks.tip[1:-1, :2] / MM
    np.testing.assert_allclose(np.hypot(*(rounded - [8, 2]).T), 2.0)
    np.testing.assert_allclose(rounded[[0, -1]], [[8, 0], [10, 2]], atol=1e-9)
    for word, cut in (('CHR=2', 2.0), ('CHF=2', np.sqrt(2.0))):
        tips = read(f'{head}{word}\nY10', 'a.mpf').blocks.tip[1:, :2] / MM
        np.testing.assert_allclose(tips, [[10 - cut, 0], [10, cut], [10, 10]], atol=1e-9)
    modal = read('RNDM=2\n' + head + '\nX10 Y10\nX0\nRNDM=0\nG1 Y0', 'a.mpf').blocks
    assert (np.bincount(modal.line_number)[[3, 4, 5, 7]] > [9, 9, 9, 0]).all()
    np.testing.assert_allclose(modal.tip[-2:] / MM, [[0, 8, 0], [0, 0, 0]], atol=1e-9)
    angled = read(head + 'ANG=30\nY10 ANG=45', 'a.mpf').blocks.tip[1:, :2] / MM
    y = 10 * np.tan(np.pi / 6)
    np.testing.assert_allclose(angled, [[10, y], [20 - y, 10]])
    for wrong in ('RND=2\nM30', 'RND=2\nX20', 'CHR=11\nY10', 'Y1 ANG=3', 'RND=1\nG2 X0 Y0 CR=9'):
        with pytest.raises(ProgramError, match=r'(RND|CHR|ANG): '):
            read(head + wrong, 'a.mpf')


def test_letters_that_posts_leave_out_of_arcs():
    for text in (
        'G3 X0 Y10 I-10 J0 F900\nX-20 Y10',
        'G2 X0 Y-10 R10 F900\nG2 X-10 Y0',
        'G3 I-10 J0 F900\nX0 Y10',
    ):
        program = read('G0 X10 Y0 Z0\n' + text)
        assert 'arcs without I J K' in str(program.notices)
        with pytest.raises(ProgramError, match='needs its centre'):
            read('G0 X10 Y0 Z0\n' + text, dialect='linuxcnc')
    round_y = read('G0 X10 Y3 Z0\nG2 X0 Z10 I-10 K0 F900').blocks.tip / MM
    np.testing.assert_allclose(np.hypot(round_y[:, 0], round_y[:, 2]), 10)
    assert (round_y[:, 1] == 3).all()


def test_machine_coordinates_while_tool_tip_programming_is_on():
    text = 'G0 X1 Y2 Z3 A30 C0\nM428\nG0 X1 Y2 Z3\nG53 G0 Z50'
    zero = AC.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    fanuc = read(text, geometry=AC, dialect='fanuc').blocks
    before, after = AC.linear(fanuc.tip[-2:], fanuc.rotary[-2:])
    np.testing.assert_allclose(after[:2], before[:2], atol=1e-12)
    assert after[2] / MM == pytest.approx(50)
    tip = read(text, geometry=AC, dialect='linuxcnc').blocks.tip[-1]
    np.testing.assert_allclose(tip / MM, [1, 2, 50 - zero[2] / MM], atol=1e-9)


def test_words_of_one_control():
    assert read('X1', 'a.mpf').blocks.tip[0, 0] / MM == 1
    shifted = read('G1 X1\nTRANS X100\nX=IC(1)\nX=IC(2)', 'a.mpf').blocks.tip[:, 0] / MM
    np.testing.assert_allclose(shifted, [1, 102, 104], atol=1e-9)
    lengths = JobSetup(tools={1: Tool(5 * MM), 2: Tool(9 * MM)})
    heights = read('O0001 (A)\nG0 X0 Z0\nG43 H1 Z1\nX1 H2 Z1', setup=lengths).blocks.tip[:, 2] / MM
    np.testing.assert_allclose(heights, [0, 6, 10], atol=1e-9)
    extended = JobSetup(work_offsets={'G54.1 P7': {'X': 3 * MM}})
    assert read('G0 X0\nG54.1 P7\nX1', setup=extended).blocks.tip[-1, 0] / MM == pytest.approx(4)
    program = read('G0 X0\nT1 T2 M6\nG91 G28 Z0\nG187 P1 E0.1\nG103 P1\nG50.1\nX1', setup=lengths)
    assert program.blocks.tip[-1, 0] / MM == 1
    told = read('G0 X0 Y0\nG2 X50 I[25-0.0099*SQRT[2]]', 'a.nc')
    assert 'as a control accepts it' in str(told.notices)
    with pytest.raises(ProgramError, match=r'absolute centres: write G90\.1'):
        read('G0 X70 Y50\nG3 X50 Y70 I50 J50', 'a.nc')


def test_polar_coordinates_of_fanuc_are_radius_and_angle_about_the_zero():
    text = (
        'G0 X1 Y0 Z5\nG52 X10\nG99 G81 G16 X20 Y0 Z-2 R5 F100\nY90\nG91 Y90 Z-7 R0 K2\nG80\n'
        'G90 G0 X4\nG15\nX5 Y6\nG18 G16 Z3 X90\n'
    )
    tips = read(text, dialect='fanuc').blocks.tip * 1e3
    holes = [p[:2] for p in tips if p[2] == pytest.approx(-2)]
    np.testing.assert_allclose(holes, [(30, 0), (10, 20), (-10, 0), (10, -20)], atol=1e-9)
    np.testing.assert_allclose(tips[-3:], [[10, -4, 5], [15, 6, 5], [13, 6, 0]], atol=1e-9)
    for wrong in ('G16\nG28 X0', 'G16 G91 X5'):
        with pytest.raises(ProgramError, match=r'write G15 first|write it with G90'):
            read(f'G0 X1 Y0\n{wrong}', dialect='fanuc')
