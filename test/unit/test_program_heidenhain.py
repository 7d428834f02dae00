"""Heidenhain plain text against the same motions as geometry."""

import numpy as np
import pytest

from cnc_interp.core import DEG, MM, ProgramError, RefusedLinesError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_program, read_text
from cnc_interp.program.geometry.frames import rotation
from cnc_interp.settings.options import Settings

XYZ, AC = (Transform.of(Machine.load(name)) for name in ('xyz', 'xyzac'))
TOOLS = JobSetup(tools={1: Tool(0.0, 2.0 * MM), 2: Tool(50.0 * MM, 2.0 * MM)})


def read(text, geometry=XYZ, setup=TOOLS):
    lines = ['BEGIN PGM T MM', *text.split('|'), 'END PGM T MM']
    whole = '\n'.join(f'{n} {line}' for n, line in enumerate(lines))
    fine = Settings(contour_tolerance=1e-3 * MM)
    return read_text(whole, 'part.h', geometry, fine, setup)


def corners(text, **options):
    """Ends of the lines of the program [mm]; arcs with their last chord only."""
    blocks = read(text, **options).blocks
    last = np.flatnonzero(np.diff(blocks.line_number, append=0))
    return blocks.tip[last] / MM


def test_lines_rapids_and_feeds():
    blocks = read('L X+0 Y+0 Z+5 R0 FMAX M3|L IX+4 IY-1 F500|L Z-1|L Z+9 FMAX M91|L X+1').blocks
    ends = [[0, 0, 5], [4, -1, 5], [4, -1, -1], [4, -1, 9], [1, -1, 9]]
    np.testing.assert_allclose(blocks.tip / MM, ends, atol=1e-9)
    assert blocks.rapid.tolist() == [True, False, False, True, False]
    np.testing.assert_allclose(blocks.feedrate[[1, 2, 4]] * 60 / MM, 500)


@pytest.mark.parametrize(
    ('arc', 'centre', 'turn'),
    [
        ('CC X+0 Y+0|C X+0 Y+10 DR+', (0, 0), 90),
        ('CC IX-10 Y+0|C X+0 Y+10 DR-', (0, 0), -270),
        ('CC X+0 Y+0|CP IPA+90 DR+', (0, 0), 90),
        ('CC X+0 Y+0|CP PA+90 IZ+3 DR-', (0, 0), -270),
        ('CR X+0 Y+10 R+10 DR+', (0, 0), 90),
        ('CR X+0 Y+10 R-10 DR-', (0, 0), -270),
        ('CT X+0 Y+10', (0, 0), 90),
        ('CC X+0 Y+0|CP IPA+450 IZ+9 DR+', (0, 0), 450),
        ('CC X+10 Y+10|C X+0 Y+10 DR+', (10, 10), 270),
    ],
)
def test_arcs_turn_about_their_centre(arc, centre, turn):
    blocks = read('L X+10 Y-5 Z+0 FMAX|L Y+0 F500|' + arc).blocks
    arm = blocks.tip[1:, :2] / MM - centre
    np.testing.assert_allclose(np.hypot(*arm.T), 10.0, atol=1e-9)
    turned = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0]))
    assert (turned[-1] - turned[0]) / DEG == pytest.approx(turn)
    np.testing.assert_allclose(blocks.tip[-1, :2] / MM, [0, 10], atol=1e-9)


def test_roundings_and_chamfers_cut_the_corner_and_the_next_line_counts_from_it():
    text = 'L X+0 Y+0 Z+0 FMAX|L X+10 F500|RND R2|L IY+10|CHF 1|L IX-10|CC X-5 Y+10|CP IPA+180 DR+'
    tips = read(text).blocks.tip / MM
    inside = tips[(tips[:, 0] > 8) & (tips[:, 1] < 2)]
    np.testing.assert_allclose(np.hypot(*(inside[:, :2] - [8, 2]).T), 2.0, atol=1e-9)
    for corner in ([8, 0], [10, 2], [10, 9], [9, 10], [0, 10], [-10, 10]):
        assert np.abs(tips[:, :2] - corner).max(axis=1).min() < 1e-9


def test_radius_compensation_and_polar_lines():
    ends = corners('TOOL CALL 1 Z S9|L X-9 Y+0 Z+0 FMAX|L X+0 RL F500|L Y+20|L X-9 R0')
    np.testing.assert_allclose(ends[1:, :2], [[-2, 0], [-2, 20], [-9, 20]], atol=1e-9)
    ends = corners('L X+0 Y+0 Z+0 FMAX|CC X+5 Y+5|LP PR+10 PA+0 F500|LP IPA+90|LP PR+2')
    np.testing.assert_allclose(ends[1:, :2], [[15, 5], [5, 15], [5, 7]], atol=1e-9)


def test_q_parameters_labels_and_jumps():
    text = (
        'FN 0: Q1 = +3|Q2 = ( Q1 - 1 ) * SIN 90 ^ 2|L X+0 Y+0 Z+0 FMAX|LBL 1|L IX+Q1 FMAX|'
        'CALL LBL 1 REP 2/2|CALL LBL 7|FN 12: IF +Q1 LT +4 GOTO LBL 2|L X+99 FMAX|LBL 2|'
        'FN 1: Q3 = +Q1 + +2|L Y-Q3 FMAX|M30|LBL 7|L IY+Q2 FMAX|LBL 0'
    )
    tips = read(text).blocks.tip / MM
    wanted = [[0, 0], [3, 0], [6, 0], [9, 0], [9, 2], [9, -5]]
    np.testing.assert_allclose(tips[:, :2], wanted, atol=1e-9)


def test_cycle_200_pecks_from_the_surface_and_retracts_to_the_second_clearance():
    text = (
        'L X+0 Y+0 Z+5 FMAX|CYCL DEF 200 DRILLING~\nQ200=2 ;A~\nQ201=-6~\nQ206=100~\nQ202=4~\n'
        'Q203=-1~\nQ204=9|L X+5 FMAX M99|CYCL CALL'
    )
    blocks = read(text).blocks
    heights = [5, 5, 1, -5, 1, -4.4, -7, 8, 1, -5, 1, -4.4, -7, 8]
    np.testing.assert_allclose(blocks.tip[:, 2] / MM, heights, atol=1e-9)
    assert np.flatnonzero(~blocks.rapid).tolist() == [3, 6, 9, 12]


def test_cycle_204_bores_from_below_and_goes_through_the_hole_beside_its_axis():
    text = (
        'L X+10 Y+5 Z+50 FMAX|CYCL DEF 204 BACK~\nQ200=2~\nQ249=5~\nQ250=20~\nQ251=3.5~\n'
        'Q252=15~\nQ253=750~\nQ254=200~\nQ203=20~\nQ204=50~\nQ214=2|CYCL CALL'
    )
    blocks = read(text).blocks
    aside, heights = (
        [5, 5, 1.5, 1.5, 5, 5, 5, 1.5, 1.5, 5],
        [50, 22, 22, -17, -17, -10, -17, -17, 22, 70],
    )
    np.testing.assert_allclose(blocks.tip[:, 1:] / MM, np.transpose([aside, heights]), atol=1e-9)
    assert np.flatnonzero(blocks.feedrate * 60 / MM < 300).tolist() == [5]
    assert np.flatnonzero(blocks.exact_stop).tolist() == [5, 9]


def test_a_label_is_called_in_a_tilted_plane():
    before = 'L X+0 Y+0 Z+50 A+0 C+0 FMAX|PLANE SPATIAL SPA+30 SPB+0 SPC+0 TURN SEQ+|'
    called = f'{before}CALL LBL 1|L X+9|M30|LBL 1|L X+5 Z+40 F500|LBL 0'
    written = f'{before}L X+5 Z+40 F500|L X+9'
    tips = [read(text, geometry=AC).blocks.tip for text in (called, written)]
    np.testing.assert_array_equal(*tips)


@pytest.mark.parametrize(('climb', 'sense'), [(1, 1), (-1, -1)])
def test_cycle_208_mills_the_hole_as_a_helix_and_a_whole_turn_at_its_depth(climb, sense):
    text = (
        'TOOL CALL 1 Z|L X+10 Y+5 Z+50 FMAX M3|CYCL DEF 208 B~\nQ200=2~\nQ201=-3~\nQ206=150~\n'
        f'Q334=2~\nQ203=0~\nQ204=50~\nQ335=7~\nQ351={climb}|CYCL CALL'
    )
    tip = read(text).blocks.tip / MM
    arm = tip[2:-3, :2] - [10, 5]
    np.testing.assert_allclose(np.hypot(*arm.T), 1.5, atol=1e-6)
    turned = np.unwrap(np.arctan2(arm[:, 1], arm[:, 0])) / (2 * np.pi) * sense
    np.testing.assert_allclose(tip[2:-3, 2], np.maximum(2 - 2 * turned, -3), atol=1e-6)
    assert turned[-1] == pytest.approx(3.5)
    np.testing.assert_allclose(
        tip[[1, -3, -2, -1]], [[10, 5, z] for z in (2, -3, 2, 50)], atol=1e-9
    )


def test_words_of_posts_that_set_something_leave_the_motion_as_it_is():
    text = (
        'CYCL DEF 392 ATC~\nQ240=0~\nQ241=1|TOOL CALL "D4" Z S9 DL+0 DR+0|L X+0 Y+0 Z+5 FMAX|'
        'CYCL DEF 201 REAMING~\nQ200=2~\nQ201=-6~\nQ206=100~\nQ208= MAX~\nQ203=0~\nQ204=9|'
        'L FMAX M99'
    )
    setup = JobSetup(tools={4: Tool(3.0 * MM, remark='d4')})
    blocks = read(text, setup=setup).blocks
    np.testing.assert_allclose(blocks.tip[:, 2] / MM, [8, 5, -3, 12], atol=1e-9)
    assert blocks.rapid.tolist() == [True, True, False, True]
    with pytest.raises(ProgramError, match='this name'):
        read(text)


def test_datum_shift_rotation_and_planes():
    shift = 'CYCL DEF 7.0 DATUM|CYCL DEF 7.1 X+10|CYCL DEF 7.2 IY+5|'
    ends = corners(shift + 'L X+0 Y+0 Z+0 FMAX|CYCL DEF 10.0 ROT|CYCL DEF 10.1 ROT+90|L X+1 FMAX')
    np.testing.assert_allclose(ends, [[10, 5, 0], [10, 6, 0]], atol=1e-9)
    turned = 'L X+0 Y+0 Z+50 A+0 C+0 FMAX|PLANE SPATIAL SPA+0 SPB+30 SPC+0 TURN FMAX SEQ-|'
    blocks = read(shift + turned + 'L X+0 Y+0 Z+10 FMAX|L X+5 F100', geometry=AC).blocks
    c, s = np.cos(30 * DEG), np.sin(30 * DEG)
    np.testing.assert_allclose(blocks.axis[-1], [s, 0, c], atol=1e-9)
    ends = [[10 + 10 * s, 5, 10 * c], [10 + 10 * s + 5 * c, 5, 10 * c - 5 * s]]
    np.testing.assert_allclose(blocks.tip[-2:] / MM, ends, atol=1e-9)


PART = (
    'L X+5 Y+6 Z+3 FMAX|L X+20 F600|CC X+20 Y+16|C X+30 Y+16 DR+|L IY+10|CR X+40 Y+36 R+10 DR-|'
    'CC X+40 Y+16|LP PR+10 PA+90|L X+50 Y+26|RND R2|L X+50 Y+0'
)


@pytest.mark.parametrize(
    ('head', 'factor', 'moved'),
    [
        ('CYCL DEF 8.0 MIRROR IMAGE|CYCL DEF 8.1 X', [-1, 1, 1], [0, 0, 0]),
        ('CYCL DEF 8.1 X Y', [-1, -1, 1], [0, 0, 0]),
        ('CYCL DEF 8.1 X|CYCL DEF 8.1', [1, 1, 1], [0, 0, 0]),
        ('CYCL DEF 7.1 X+10|CYCL DEF 8.1 X', [-1, 1, 1], [10, 0, 0]),
        (
            'CYCL DEF 7.1 Y+10|CYCL DEF 11.0 SCALING|CYCL DEF 11.1 SCL0.5',
            [0.5, 0.5, 0.5],
            [0, 10, 0],
        ),
        ('CYCL DEF 26.1 X2 Y2 CCX+15 CCY-20', [2, 2, 1], [-15, 20, 0]),
        ('CYCL DEF 26.1 Z3|CYCL DEF 8.1 Y', [1, -1, 3], [0, 0, 0]),
        ('CYCL DEF 11.1 SCL 3|CYCL DEF 11.1 SCL 1', [1, 1, 1], [0, 0, 0]),
    ],
)
def test_cycles_8_11_and_26_mirror_and_scale_places_arcs_and_corners(head, factor, moved):
    """All points of lines and arcs are those of the part, mirrored or scaled about the datum."""
    plain, found = read(PART).blocks, read(f'{head}|{PART}').blocks
    first = np.flatnonzero(np.diff(plain.line_number, append=0))
    last = np.flatnonzero(np.diff(found.line_number, append=0))
    wanted = plain.tip[first] / MM * factor + moved
    np.testing.assert_allclose(found.tip[last] / MM, wanted, atol=1e-9)
    shift = 1 + head.count('|')
    for line, centre in ((5, (20, 16)), (7, (40, 26))):
        arc = found.tip[found.line_number == line + shift] / MM
        assert len(arc) > 3
        away = np.linalg.norm(arc[:, :2] - (np.array(centre) * factor[:2] + moved[:2]), axis=1)
        np.testing.assert_allclose(away, 10 * abs(factor[0]), atol=1e-9)
    np.testing.assert_allclose(found.feedrate[-1] * 60 / MM, 600)


def test_a_rotation_counts_on_under_a_scale_and_increments_add_up():
    text = 'CYCL DEF 11.1 SCL2|CYCL DEF 10.1 ROT+30|CYCL DEF 10.1 IROT+60|L X+3 Y+0 Z+0 FMAX'
    np.testing.assert_allclose(corners(text), [[0, 6, 0]], atol=1e-9)
    text = 'CYCL DEF 10.1 ROT+90|CYCL DEF 8.1 X|L X+3 Y+1 Z+0 FMAX|CYCL DEF 8.1|L X+3 FMAX'
    np.testing.assert_allclose(corners(text), [[-1, -3, 0], [-1, 3, 0]], atol=1e-9)


def test_holes_are_scaled_with_their_depth():
    text = (
        'CYCL DEF 11.1 SCL2|CYCL DEF 200 D~\nQ200=1~\nQ201=-3~\nQ206=100~\nQ203=0~\nQ204=5|'
        'L X+4 Y+0 Z+5 FMAX M99'
    )
    blocks = read(text).blocks
    np.testing.assert_allclose(blocks.tip[:, 2] / MM, [10, 2, -6, 10], atol=1e-9)
    np.testing.assert_allclose(blocks.tip[:, 0] / MM, 8, atol=1e-9)


@pytest.mark.parametrize(('angle', 'choice'), [(0.0, ''), (30.0, 'SEQ-'), (-20.0, 'SEQ+')])
def test_words_turn_the_axes_to_a_plane_and_m140_draws_the_tool_back_along_itself(angle, choice):
    plane = f'PLANE SPATIAL SPA+{angle} SPB+0 SPC+0 STAY {choice} TABLE ROT|'.replace('+-', '-')
    blocks = read(
        f'M140 MB MAX|L X+0 Y+0 A+0 C+40 FMAX|L Z+5 FMAX|{plane}L A+Q120 C+Q122 R0 FMAX M126|'
        'L X+3 Y+4 Z+6 FMAX|M140 MB 2.5 F60|L M140 MB MAX|M5',
        geometry=AC,
    ).blocks
    turn = rotation(0, angle * DEG)
    for tip, wanted in zip(blocks.tip[-3:-1], ([3, 4, 6], [3, 4, 8.5]), strict=True):
        np.testing.assert_allclose(tip / MM, turn @ wanted, atol=1e-9)
    np.testing.assert_allclose(blocks.axis[-1], turn[:, 2], atol=1e-9)
    np.testing.assert_allclose(blocks.feedrate[-2], 1.0 * MM)
    drawn = blocks.tip[-1] - turn @ [3 * MM, 4 * MM, 6 * MM]
    np.testing.assert_allclose(np.cross(drawn, turn[:, 2]), 0.0, atol=1e-12)
    z = AC.linear(blocks.tip[[0, -1]], blocks.rotary[[0, -1]])[:, 2]
    np.testing.assert_allclose(z, AC.machine.travel[2, 1], atol=2e-6)
    if not angle:  # the table lays X of the plane along X of the machine
        np.testing.assert_allclose(blocks.rotary[-1], 0.0, atol=1e-9)


def test_zeros_end_a_datum_shift_in_a_plane_too():
    plane = 'PLANE SPATIAL SPA+30 SPB+0 SPC+0 TURN SEQ+|'
    text = f'L X+0 Y+0 Z+9 A+0 C+0 FMAX|CYCL DEF 7.1 X+5|{plane}CYCL DEF 7.1 X0|L X+1 Y+0 Z+0 FMAX'
    np.testing.assert_allclose(read(text, geometry=AC).blocks.tip[-1] / MM, [1, 0, 0], atol=1e-9)
    with pytest.raises(ProgramError, match='datum shift in a tilted plane'):
        read(f'L X+0 A+0 C+0 FMAX|{plane}CYCL DEF 7.0 D|CYCL DEF 7.1 X2', geometry=AC)


def test_ln_turns_the_tool_with_tool_tip_programming():
    text = 'L X+0 Y+0 Z+50 A+0 C+0 FMAX|M128|LN X+1 Y+0 Z+50 NX0 NY0 NZ1 TX0 TY0.6 TZ0.8 F100|M129'
    blocks = read(text, geometry=AC).blocks
    np.testing.assert_allclose(blocks.axis[-1], [0, 0.6, 0.8], atol=1e-9)
    np.testing.assert_allclose(blocks.tip[-1] / MM, [1, 0, 50], atol=1e-9)


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('C X+1 Y+1', 'DR'),
        ('CR X+1 DR+', 'radius'),
        ('CT X+1 Y+1', 'CT needs'),
        ('CC X+0 Y+5|CP IPA-90 DR+', 'different directions'),
        ('RND R1|L X+1', 'between two lines'),
        ('L X+5 F9|RND R9|L Y+3', 'does not fit'),
        ('L X+5 Z-1 F9|RND R1|L Y+3', 'lines in the plane'),
        ('CALL LBL 9', 'not in this file'),
        ('CALL LBL 9 REP 2', 'no such label'),
        ('FN 18: SYSREAD Q1 = ID270', 'SYSREAD'),
        ('L X+Q9 F9', 'before it is set'),
        ('Q1 = 1 / 0', 'no value'),
        ('Q1 = (2', 'cannot be read'),
        ('CYCL DEF 11.1 SCL 0', 'a scale must be from'),
        ('CYCL DEF 8.1 A', 'A: this word is not supported'),
        ('CYCL DEF 26.1 X2|CC X+5 Y+0|C X+10 Y+0 DR+ F9', 'different scales'),
        ('CYCL DEF 8.1 X|CYCL DEF 7.1 X5', 'write CYCL DEF 8.1 without axes'),
        ('CYCL DEF 8.1 X|CYCL DEF 10.1 ROT+30', 'CYCL DEF 10: axes are mirrored'),
        ('CYCL DEF 8.1 X|CYCL DEF 26.1 X2 CCX+1', 'a mirrored axis and a centre'),
        ('CYCL DEF 8.1 Z|CYCL DEF 200 D~\nQ201=-1~\nQ206=9|CYCL CALL', 'CYCL DEF 200: axes are'),
        ('L X+0 Z+50 FMAX|CYCL DEF 204 X|CYCL CALL', 'Q214 from 1 to 4'),
        (
            'TOOL CALL 1 Z|L X+0 Z+9 FMAX|CYCL DEF 208 X~\nQ201=-3~\nQ334=2~\nQ335=17|CYCL CALL',
            'twice as wide',
        ),
        ('TOOL CALL 1 Z|L X+0 Z+9 FMAX|CYCL DEF 208 X~\nQ201=-3~\nQ335=7|CYCL CALL', 'Q334'),
        ('CYCL CALL', 'no cycle'),
        ('CYCL DEF 251 POCKET', 'not supported'),
        ('L X+1 M140 MB2', 'block of its own'),
        ('L M140', 'MB MAX'),
        ('M140 MB MAX', 'no travel'),
        ('PLANE SPATIAL SPA+0 SPB+30 SPC+0 TURN FMAX', 'no rotary axes'),
        ('APPR LT X+1', 'APPR'),
        ('TOOL CALL 1 Z DR+0.1', 'DR'),
        ('PLANE POINTS P1X+0', 'not supported'),
        ('X+5 FMIX', 'not supported'),
        ('TOOL CALL 9 Z', 'no length'),
        ('LBL 1|CALL LBL 1', 'deep'),
    ],
)
def test_what_cannot_be_done_is_refused_with_its_line(text, part):
    with pytest.raises(ProgramError, match=part):
        read('L X+0 Y+0 Z+0 FMAX|' + text)


@pytest.mark.parametrize(
    'turn', ['STAY|L X+1 FMAX', 'STAY|L X+1 A+30 C+0 FMAX', 'TURN|L A+0 FMAX|L X+1']
)
def test_moves_in_a_plane_on_which_the_tool_does_not_stand_upright_are_refused(turn):
    with pytest.raises(ProgramError, match='does not stand upright'):
        read('L X+0 Y+0 Z+0 FMAX|PLANE SPATIAL SPA+30 SPB+0 SPC+0 ' + turn, geometry=AC)


def test_words_of_the_machine_and_rotary_words_move_their_axes_alone_on_a_plane():
    plane = 'PLANE SPATIAL SPA+30 SPB+0 SPC+0 TURN SEQ+|L Z+20 FMAX|L Z+90 FMAX M91'
    text = f'L X+0 Y+0 Z+9 A+0 C+0 FMAX|{plane}|L X+3 Y+4 FMAX|L A+0 FMAX'
    blocks = read(text, geometry=AC).blocks
    q = AC.linear(blocks.tip[3:], np.nan_to_num(blocks.rotary[[3, 3, 5]]))
    np.testing.assert_allclose(q[0, 2], 90 * MM, atol=1e-9)
    turn = rotation(0, 30 * DEG)
    here = (turn.T @ blocks.tip[3:5].T).T
    np.testing.assert_allclose(here[1, :2] / MM, [3, 4], atol=1e-9)
    np.testing.assert_allclose(here[1, 2], here[0, 2], atol=1e-9)
    before = AC.linear(blocks.tip[4:5], blocks.rotary[3:4])
    np.testing.assert_allclose(q[2], before[0], atol=1e-9)


@pytest.mark.parametrize('cycle', ['9.1 DWELL .', '9.1 DWELL 1.2.3', '32.1 T.'])
def test_a_point_without_digits_in_an_old_cycle_is_refused(cycle):
    """It ended in a ValueError of Python; mutated programs found it."""
    text = f'0 BEGIN PGM A MM\n1 L X+0 FMAX\n2 CYCL DEF {cycle}\n3 L X+5 F500\n4 END PGM A MM\n'
    with pytest.raises(ProgramError, match=r':3: .*not a number'):
        read_text(text, 'dwell.h', Transform.of(Machine.load('xyzac')))


def test_a_comment_goes_on_and_a_program_is_called_whatever_its_case(tmp_path):
    (tmp_path / 'part.h').write_text(
        '0 BEGIN PGM PART MM\n1 ;THIS COMMENT GOES ON~\n X+99~\n to here\n2 L X+0 Y+0 FMAX\n'
        '3 CALL PGM Step.H\n4 L X+7 FMAX ; goes on~\n and on\n5 FOO ; (a fault~\n of one line)\n'
        '6 END PGM PART MM\n'
    )
    (tmp_path / 'Step.H').write_text('0 BEGIN PGM STEP MM\n1 L Y+5 FMAX\n2 END PGM STEP MM\n')
    with pytest.raises(ProgramError, match=':9: FOO') as refusal:
        read_program(tmp_path / 'part.h', XYZ, Settings())
    assert not isinstance(refusal.value, RefusedLinesError)
    text = (tmp_path / 'part.h').read_text().replace('FOO', 'M8')
    (tmp_path / 'part.h').write_text(text)
    blocks = read_program(tmp_path / 'part.h', XYZ, Settings()).blocks
    np.testing.assert_allclose(blocks.tip[:, :2] / MM, [[0, 0], [0, 5], [7, 5]], atol=1e-9)


def test_the_size_of_the_tool_is_in_q108_and_q114():
    text = 'TOOL CALL 1 Z S500|L X+0 FMAX|L X+Q108 Y+Q114 FMAX|TOOL CALL 2 Z|L Y+Q114 FMAX'
    lines = ['BEGIN PGM T MM', *text.split('|'), 'END PGM T MM']
    blocks = read_text('\n'.join(lines), 'a.h', XYZ, Settings(), TOOLS).blocks
    np.testing.assert_allclose(blocks.tip[-2:, :2] / MM, [[2, 0], [2, 50]], atol=1e-9)
