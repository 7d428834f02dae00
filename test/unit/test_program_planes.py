"""Tilted working planes: forms, orientations on all machines, what stays, refusals."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiers import few_of

from cnc_interp.core import DEG, MM, ProgramError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, ProgramStream, Tool, read_text
from cnc_interp.program.text.source import Source
from cnc_interp.settings.options import Settings

FIVE_AXES = [
    'xyzac',
    'xyzbc',
    'bc_trunnion',
    'head_head',
    'head_table',
    'xyzac_trt',
    'xyzbc_trt',
    'xyzacw',
]
START = 'G21 G90\nG0 X0 Y0 Z50\n'


def endless(name):
    """A machine without ends of travel."""
    machine = Machine.load(name)
    travel = np.tile([-np.inf, np.inf], (len(machine.axis_names), 1))
    return Transform.of(machine.having(travel=travel))


AC = endless('xyzac')


def read(text, geometry=AC):
    return read_text(START + text, 'part.ngc', geometry, Settings())


def last(text, geometry=AC):
    """Tool tip [mm] and tool axis in W, rotary positions [deg], of the last block."""
    blocks = read(text, geometry).blocks
    assert np.isfinite(blocks.rotary[-1]).all()
    np.testing.assert_allclose(
        geometry.tool_axis(blocks.rotary[-1:])[0], blocks.axis[-1], atol=1e-12
    )
    return blocks.tip[-1] / MM, blocks.axis[-1], blocks.rotary[-1] / DEG


def turned(order, *angles):
    """A rotation: capital letters turn about the turned axes, small ones about axes at rest."""
    return Rotation.from_euler(order, angles, degrees=True).as_matrix()


ORIGIN, POINT = np.array([10.0, 20.0, 30.0]), np.array([1.0, 2.0, 3.0])
FORMS = {
    'G68.2 X10 Y20 Z30 I30 J20 K10': turned('ZXZ', 30, 20, 10),
    'G68.2 P0 Q323 X10 Y20 Z30 I30 J20 K10': turned('ZYZ', 30, 20, 10),
    'G68.2 P1 X10 Y20 Z30 I30 J20 K10': turned('xyz', 30, 20, 10),
    'G68.2 P1 Q321 X10 Y20 Z30 I30 J20 K10': turned('zyx', 10, 20, 30),
    'G68.2 P0 X10 Y20 Z30 I30 J20 R10': turned('ZXZ', 30, 20, 10),
    'G68.2 P2 Q1 X10 Y20 Z30\nG68.2 P2 Q2 X15 Y20 Z30\nG68.2 P2 Q3 X12 Y26 Z36': turned('X', 45),
    'G68.2 P2 Q0 X10 Y20 Z30\nG68.2 P2 Q1\nG68.2 P2 Q2 Y5\nG68.2 P2 Q3 X-7 Z7': turned(
        'ZX', 90, 45
    ),
    'G68.2 P3 Q1 X10 Y20 Z30 I0 J1 K0\nG68.2 P3 Q2 I1 J0 K1': turned('ZX', 90, 45),
    'G68.2 P4 X10 Y20 Z30 I0 J25 K40': turned('XZ', 25, 40),
    'G68.2 P4 X10 Y20 Z30 I-15 J0 K40': turned('YZ', -15, 40),
    'G68.2 X10 Y20 Z30 I30 J20\nG68.4 K10': turned('ZXZ', 30, 20, 10),
    'G68.2 X10 Y20 Z30 I30 J20\nG68 X0 Y0 R10': turned('ZXZ', 30, 20, 10),
    'CYCLE800(0,"TC",0,57,10,20,30,30,20,10,0,0,0,1)': turned('XYZ', 30, 20, 10),
    'CYCLE800(0,"TC",0,27,10,20,30,30,20,10,0,0,0,1)': turned('ZYX', 30, 20, 10),
    'CYCLE800(0,"TC",0,39,10,20,30,30,20,10,0,0,0,-1)': turned('ZXY', 30, 20, 10),
    'CYCLE800(0,"TC",0,64,10,20,30,30,20,0,0,0,0,1)': turned('ZY', 30, 20),
    'ROT X0\nTRANS X10 Y20 Z30\nAROT X20 Y0 Z10': turned('ZX', 10, 20),
}


@pytest.mark.parametrize('geometry', [AC, endless('head_table')], ids=['table', 'head and table'])
@pytest.mark.parametrize('form', FORMS)
def test_each_form_gives_its_frame_and_turns_the_tool_upright(form, geometry):
    orient = '' if 'CYCLE800' in form else 'G53.1\n'
    tip, axis, _ = last(f'{form}\n{orient}G0 X1 Y2 Z3', geometry)
    np.testing.assert_allclose(tip, ORIGIN + FORMS[form] @ POINT, atol=1e-9)
    np.testing.assert_allclose(axis, FORMS[form][:, 2], atol=1e-12)


def test_a_second_shift_of_cycle800_is_along_the_turned_axes():
    tip, *_ = last('CYCLE800(0,"",0,57,10,20,30,0,90,0,1,2,3,1)\nG0 X1 Y2 Z3')
    np.testing.assert_allclose(tip, ORIGIN + turned('Y', 90) @ (2 * POINT), atol=1e-9)
    tip, *_ = last(
        'CYCLE800(0,"",0,57,10,20,30,30,0,0,0,0,0,1)\n'
        'CYCLE800(0,"",1,57,1,2,3,0,20,0,0,0,0,1)\nG0 X1 Y2 Z3'
    )
    first = turned('X', 30)
    np.testing.assert_allclose(
        tip, ORIGIN + first @ POINT + first @ turned('Y', 20) @ POINT, atol=1e-9
    )


@pytest.mark.parametrize('name', few_of(3, FIVE_AXES))
def test_orientations_all_round_are_reached_on_every_machine(name):
    geometry, grid = endless(name), [(i, j) for i in range(0, 360, 30) for j in range(0, 360, 30)]
    text = ''.join(
        f'G69\nG68.2 X10 Y20 Z30 I{i} J{j} K10\nG53.1\nG0 X1 Y2 Z{3 + n}\n'
        for n, (i, j) in enumerate(grid)
    )
    blocks = read(text, geometry).blocks
    moves = {int(line): row for row, line in enumerate(blocks.line_number)}
    rows = [moves[2 + 4 * (n + 1)] for n in range(len(grid))]
    turn = Rotation.from_euler('ZXZ', [[i, j, 10] for i, j in grid], degrees=True).as_matrix()
    points = np.array([[1.0, 2.0, 3.0 + n] for n in range(len(grid))])
    tips = ORIGIN + np.einsum('nij,nj->ni', turn, points)
    np.testing.assert_allclose(blocks.tip[rows] / MM, tips, atol=1e-9)
    np.testing.assert_allclose(geometry.tool_axis(blocks.rotary[rows]), turn[:, :, 2], atol=1e-9)


@pytest.mark.parametrize('form', FORMS)
def test_a_start_at_a_line_tells_the_plane_in_words_that_set_it(form):
    line = 4 + form.count('\n')
    source = Source.of_text(f'{START}{form}\nG0 X1 Y2 Z3\n', 'part.ngc')
    stream = ProgramStream(source, AC, Settings(from_line=line))
    stream.read()
    words = next(word for word in stream.start.found().words if word.startswith('G68.2'))
    tip, axis, _ = last(f'{words}\nG53.1\nG0 X1 Y2 Z3')
    np.testing.assert_allclose(tip, ORIGIN + FORMS[form] @ POINT, atol=1e-6)
    np.testing.assert_allclose(axis, FORMS[form][:, 2], atol=1e-8)


def test_what_stays_while_the_tool_turns():
    plane = 'G68.2 X10 Y20 Z30 I30 J20\n'
    before = read('G0 X3 A0 C0').blocks
    stands = AC.linear(before.tip[-1:], before.rotary[-1:])
    axes = read(f'G0 X3 A0 C0\n{plane}G53.1').blocks
    np.testing.assert_allclose(AC.linear(axes.tip[-1:], axes.rotary[-1:]), stands, atol=1e-12)
    tip = read(f'G0 X3\n{plane}G53.6').blocks
    np.testing.assert_allclose(tip.tip[-1], before.tip[-1], atol=1e-12)
    np.testing.assert_allclose(tip.axis[-1], axes.axis[-1], atol=1e-12)
    assert tip.rapid[-1] and axes.rapid[-1]
    to, axis, _ = last(f'G0 X3\n{plane}G53.3 X1 Y2 Z3')
    np.testing.assert_allclose(to, ORIGIN + turned('ZX', 30, 20) @ POINT, atol=1e-9)
    np.testing.assert_allclose(axis, axes.axis[-1], atol=1e-12)
    followed = read('G0 X3\nCYCLE800(0,"",10,57,10,20,30,20,0,0,0,0,0,1)').blocks
    np.testing.assert_allclose(followed.tip[-1], before.tip[-1], atol=1e-12)


def test_the_solution_is_the_nearest_or_the_one_that_was_asked_for():
    plane = 'G68.2 I30 J20\n'
    for choice, sign in (('P1', 1.0), ('P2', -1.0)):
        _, _, rotary = last(f'{plane}G53.1 {choice}\nG0 X1')
        assert rotary[0] == pytest.approx(sign * 20.0)
    for direction in (1, -1):
        _, _, rotary = last(f'CYCLE800(0,"",0,27,0,0,0,30,0,20,0,0,0,{direction})\nG0 X1')
        assert rotary[0] == pytest.approx(direction * 20.0)
    _, _, rotary = last(f'G0 A18 C150\n{plane}G53.1\nG0 X1')
    assert rotary == pytest.approx([20.0, 150.0])
    _, _, rotary = last(f'G0 C725\n{plane}G53.1\nG0 X1')
    assert abs(rotary[1] - 725.0) < 180.0
    # Upright, C may stand anywhere, so it stays.
    _, _, rotary = last('G0 C33\nG68.2 X5\nG53.1\nG0 X1')
    assert rotary == pytest.approx([0.0, 33.0])


def test_the_travel_decides_where_only_one_solution_is_within_it():
    machine = Machine.load('xyzac')
    travel = machine.travel.copy()
    travel[3] = np.array([-5.0, 90.0]) * DEG
    short = Transform.of(machine.having(travel=travel))
    for choice in ('', 'P2'):
        program = read(f'G68.2 I30 J20\nG53.1 {choice}\nG0 X1', short)
        assert program.blocks.rotary[-1, 0] == pytest.approx(20.0 * DEG)
        assert any('beyond the travel' in notice for notice in program.notices) == bool(choice)
    with pytest.raises(ProgramError, match=r'G53\.1: the machine cannot reach the tool axis'):
        read('G68.2 J120\nG53.1\nG0 X1', short)


def test_the_plane_of_the_tool():
    tip, axis, _ = last('G0 A25 C40\nG68.3 X10 Y20 Z30\nG0 X1 Y2 Z3')
    normal = AC.tool_axis(np.array([[25.0, 40.0]]) * DEG)[0]
    along = np.cross([0, 0, 1], normal)
    along /= np.linalg.norm(along)
    frame = np.stack([along, np.cross(normal, along), normal], axis=1)
    np.testing.assert_allclose(tip, ORIGIN + frame @ POINT, atol=1e-9)
    np.testing.assert_allclose(axis, normal, atol=1e-12)
    here = read('G0 X5 A25 C40').blocks
    tip, *_ = last('G0 X5 A25 C40\nG68.3\nG0 X0 Y0 Z0')
    np.testing.assert_allclose(tip, here.tip[-1] / MM, atol=1e-9)


def test_the_plane_ends_and_nothing_moves_then():
    ended = 'G68.2 X10 Y20 Z30 I30 J20\nG53.1\nG0 X1 Y2 Z3\n'
    stands = read(ended).blocks
    point = AC.linear(stands.tip[-1:], stands.rotary[-1:])[0]
    for end in ('G69', 'CYCLE800()'):
        blocks = read(f'{ended}{end}\nG91 G0 Z7').blocks
        after = AC.linear(blocks.tip[-1:], blocks.rotary[-1:])[0]
        np.testing.assert_allclose((after - point) / MM, [0, 0, 7], atol=1e-9)


def test_3_plus_2_and_simultaneous_motion_follow_each_other():
    plane = 'G68.2 X10 Y20 Z30 I30 J20\nG53.1\n'
    frame = turned('ZX', 30, 20)
    for on, off in (('TRAORI', 'TRAFOOF'), ('G43.4 H0', 'G49'), ('M128', 'M129')):
        text = f'{plane}{on}\nG1 X1 Y2 Z3 A30 C10 F1000\n{off}\nG1 X4 Y2 Z3'
        blocks = read(text).blocks
        np.testing.assert_allclose(blocks.tip[-1] / MM, ORIGIN + frame @ [4, 2, 3], atol=1e-9)
        # Rotary words have turned the tool away from the plane; it stays so.
        assert blocks.rotary[-1] / DEG == pytest.approx([30.0, 10.0])
    blocks = read(f'TRAORI\n{plane}G0 X1 Y2 Z3\nG69\nG0 X5 Y5 Z5').blocks
    np.testing.assert_allclose(blocks.tip[-1] / MM, [5, 5, 5], atol=1e-9)


def test_arcs_and_cycles_lie_in_the_plane():
    plane = 'G68.2 X10 Y20 Z30 I30 J50\nG53.1\nG0 X0 Y0 Z5\n'
    frame = turned('ZX', 30, 50)
    arc = read(f'{plane}G1 Z0 F1000\nG2 X20 I10').blocks
    there = (arc.tip / MM - ORIGIN) @ frame
    rows = arc.line_number == 7
    assert rows.sum() > 20
    np.testing.assert_allclose(there[rows, 2], 0.0, atol=1e-9)
    np.testing.assert_allclose(np.hypot(there[rows, 0] - 10, there[rows, 1]), 10.0, atol=1e-9)
    holes = read(f'{plane}G81 X3 Y4 Z-6 R1 F500\nG80').blocks
    there = (holes.tip / MM - ORIGIN) @ frame
    assert there[:, 2].min() == pytest.approx(-6.0)
    deepest = there[int(there[:, 2].argmin())]
    np.testing.assert_allclose(deepest[:2], [3, 4], atol=1e-9)


def test_many_plain_lines_are_read_in_the_plane():
    lines = ''.join(f'X{n % 50} Y{n}\n' for n in range(300))
    blocks = read(f'G68.2 X10 Y20 Z30 I30 J50\nG53.1\nG0 X0 Y0 Z0\nG1 F900\n{lines}').blocks
    there = (blocks.tip[-1] / MM - ORIGIN) @ turned('ZX', 30, 50)
    np.testing.assert_allclose(there, [299 % 50, 299, 0], atol=1e-9)


def test_before_the_first_motion_the_tool_begins_upright_on_the_plane():
    blocks = read_text(
        'G68.2 X10 Y20 Z30 J20\nG53.1\nG0 X1 Y2 Z3\nG1 X2 F100', 'part.ngc', AC, Settings()
    ).blocks
    np.testing.assert_allclose(blocks.tip[0] / MM, ORIGIN + turned('X', 20) @ POINT, atol=1e-9)
    assert len(blocks) == 2


@pytest.mark.parametrize(
    ('text', 'part'),
    [
        ('G68.2 P2 Q1 X1\nG68.2 P2 Q2 X2\nG53.1', 'the plane of G68.2 is not complete'),
        ('G68.2 P2 Q1 X1\nG0 X1', 'the plane of G68.2 is not complete'),
        ('G68.2 P2 Q1\nG68.2 P2 Q2 X2\nG68.2 P2 Q3 X3', 'these words give no plane'),
        ('G68.2 P3 Q1 I1\nG68.2 P3 Q2 I1 K1', 'not at right angles'),
        ('G68.2 P7', 'P7: P must be'),
        ('G68.2 P0 Q311', 'Q311: the order of rotations'),
        ('G68.2 P2 Q9', 'Q9: Q must be'),
        ('G68 X0 Y0', 'G68: give the angle R'),
        ('G68.3 X1', 'G68.3: give X, Y and Z'),
        ('G68.2 J20\nG53.1 P4', 'P4: P must be 0, 1 or 2'),
        ('CYCLE800(0,"",0,192,0,0,0,1,0,0,0,0,0,1)', 'CYCLE800: rotary positions cannot'),
        ('CYCLE800(0,"",0,64,0,0,0,1,0,9,0,0,0,1)', 'CYCLE800: solid angles are two'),
        ('CYCLE800(0,"",0,155,0,0,0,1,0,9,0,0,0,1)', 'CYCLE800: give the angles axis by axis'),
        ('CYCLE800(0,"",0,1,0,0,0,1,0,9,0,0,0,1)', 'CYCLE800: give the angles axis by axis'),
        ('CYCLE800(0,"",0,-8,0,0,0,1,0,9,0,0,0,1)', 'CYCLE800: give the angles axis by axis'),
        ('CYCLE800(0,"",0,57,0,0,0,1,0,0,0,0,0,0)', 'CYCLE800: the direction must be'),
        ('G68.2 J20\nG53.1\nG53 G0 Z0', 'machine coordinates'),
    ],
)
def test_what_gives_no_plane_is_refused(text, part):
    with pytest.raises(ProgramError, match=part):
        read(f'{text}\nG0 X1')


def test_a_machine_without_rotary_axes_takes_frames_that_stand_upright():
    xyz = Transform.of(Machine.load('xyz'))
    blocks = read('G68.2 X10 Y20 Z30 K90\nG53.1\nG0 X1 Y2 Z3', xyz).blocks
    np.testing.assert_allclose(blocks.tip[-1] / MM, [8, 21, 33], atol=1e-9)
    with pytest.raises(ProgramError, match='no rotary axes'):
        read('G68.2 J20\nG53.1', xyz)


@pytest.mark.parametrize('name', FIVE_AXES)
def test_the_example_is_milled_upright_on_every_machine(name):
    geometry = Transform.of(Machine.load(name))
    path = Path(__file__).parents[2] / 'examples' / 'tilted_faces.ngc'
    blocks = read_text(path.read_text(), path.name, geometry, Settings()).blocks
    cuts = blocks.axis[~blocks.rapid.astype(bool)]
    np.testing.assert_allclose(cuts[:, 2], np.cos(25.0 * DEG), atol=1e-12)
    directions = np.round(np.degrees(np.arctan2(cuts[:, 1], cuts[:, 0])) % 360.0) % 360.0
    assert set(directions) == {0.0, 90.0, 180.0, 270.0}


@pytest.mark.parametrize('mode', [185, 182])
def test_projected_angles_are_seen_in_the_old_planes(mode):
    """X of the plane seen along Y, and the trace of its Y seen along X, have these angles."""
    about_x, about_y = 25.0, -40.0
    first, second = (about_x, about_y) if mode == 185 else (about_y, about_x)
    swivel = f'CYCLE800(0,"",0,{mode},0,0,0,{first},{second},0,0,0,0,1)'
    x = last(f'{swivel}\nG0 X1 Y0 Z0')[0]
    normal = last(f'{swivel}\nG0 X0 Y0 Z1')[0]
    assert np.degrees(np.arctan2(-x[2], x[0])) == pytest.approx(about_y)
    assert x[1] == pytest.approx(0, abs=1e-12)
    trace = np.cross(normal, [1, 0, 0])
    assert np.degrees(np.arctan2(trace[2], trace[1])) == pytest.approx(about_x)


def test_a_plane_lies_in_a_turned_work_offset():
    zero = AC.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0] / MM
    offset = f'G10 L2 P1 X{zero[0] + 5:.6f} Y{zero[1]:.6f} Z{zero[2]:.6f} R35\n'
    outside = Rotation.from_euler('Z', 35, degrees=True)
    plane = 'G68.2 X1 Y2 Z3 I20 J30 K10\nG53.1\n'
    tip, axis, _ = last(f'{offset}{plane}G0 X4 Y5 Z6')
    inner, inner_axis, _ = last(f'{plane}G0 X4 Y5 Z6')
    np.testing.assert_allclose(tip, [5, 0, 0] + outside.apply(inner), atol=1e-5)
    np.testing.assert_allclose(axis, outside.apply(inner_axis.copy()), atol=1e-9)
    # The plane on which the tool stands now is the same one, from where it stands.
    tool, upright, _ = last(f'{offset}G0 A30 C20\nG68.3 X1 Y2 Z3\nG0 X0 Y0 Z7')
    np.testing.assert_allclose(tool, [5, 0, 0] + outside.apply([1, 2, 3]) + 7 * upright, atol=1e-5)


@pytest.mark.parametrize('code', ['G43.4 H7', 'G43 H7\nG68.2 I0 J40 K0\nG53.1', 'G43 H7\nTRAORI'])
def test_a_tool_length_counts_along_the_tool_that_rests(code):
    """The tip of the longer tool is where the words say; the blocks have that of the shorter."""
    setup = JobSetup(tools={7: Tool(0.06), 8: Tool(0.02)})
    siemens = 'TRAORI' in code
    text = f'G21 G90 F900\nG0 A40 C0\n{code}\nG0 X10 Y20 Z30\nG1 X12 Y21 Z25'
    settings = Settings(dialect='siemens' if siemens else 'fanuc')
    machine = Transform.of(Machine.load('xyzac'))
    long, short = (
        read_text(words, 'a.nc', machine, settings, setup).blocks
        for words in (text, text.replace('H7', 'H8'))
    )
    along = long.axis[-2:]
    assert along[-1][2] < 0.8
    tips = long.tip[-2:] - 0.06 * along
    np.testing.assert_allclose(tips, short.tip[-2:] - 0.02 * along, atol=1e-12)
    axes = [machine.linear(blocks.tip[-2:], blocks.rotary[-2:]) for blocks in (long, short)]
    np.testing.assert_allclose(axes[0] - axes[1], [[0, 0, 0.04]] * 2, atol=1e-12)
    if 'G68.2' not in code:
        np.testing.assert_allclose(tips * 1e3, [[10, 20, 30], [12, 21, 25]], atol=1e-9)
        for turn, place in (('X0 A50', [0, 21, 25]), ('A50', [12, 21, 25]), ('C90', [12, 21, 25])):
            blocks = read_text(f'{text}\n{turn}', 'a.nc', machine, settings, setup).blocks
            tip = blocks.tip[-1] - 0.06 * blocks.axis[-1]
            np.testing.assert_allclose(tip * 1e3, place, atol=1e-9)
    with pytest.raises(ProgramError, match='on LinuxCNC'):
        read_text('G43 H7\nM428', 'a.nc', machine, settings, setup)
