"""Axis positions (no tool-tip programming), offsets, machine coordinates, directions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import JobSetup, Tool, read_text
from cnc_interp.program.blocks import AXES_LINEAR, POSES
from cnc_interp.settings.options import Settings

AC = Transform.of(Machine.load('xyzac'))
#: Axis positions of the workpiece zero, from the machine file.
ZERO = np.array([40.0, -70.0 + 0.15, 60.0 + 80.0])


def read(text, geometry=AC, setup=None, **options):
    return read_text(text, 'part.ngc', geometry, Settings(**options), setup)


def axes_at(blocks):
    """Axis positions of blocks whose rotary positions are known [mm, deg]."""
    linear = np.array(
        [AC.linear(p[None], r[None])[0] for p, r in zip(blocks.tip, blocks.rotary, strict=True)]
    )
    return np.c_[linear * 1e3, np.degrees(blocks.rotary)]


def test_words_are_axis_positions_and_run_linearly():
    blocks = read('G0 X10 Y5 Z3 A30 C20\nG1 X40 Y-5 Z9 A60 C200 F1000').blocks
    q = axes_at(blocks)
    start = np.r_[np.array([10, 5, 3]) + ZERO, 30, 20]
    end = np.r_[np.array([40, -5, 9]) + ZERO, 60, 200]
    np.testing.assert_allclose(q, [start, end], atol=1e-9)
    assert blocks.interpolation.tolist() == [POSES, AXES_LINEAR]
    np.testing.assert_allclose(np.degrees(blocks.rotary_from[1]), start[3:], atol=1e-12)


def test_an_arc_with_a_rotary_word_is_an_arc_of_the_axes():
    blocks = read('G0 X10 Y0 A0 C0\nG2 X-10 I-10 A40 C90 F1000').blocks
    q = axes_at(blocks) - np.r_[ZERO, 0, 0]
    assert len(q) > 20 and (blocks.interpolation[1:] == AXES_LINEAR).all()
    np.testing.assert_allclose(np.hypot(q[:, 0], q[:, 1]), 10.0, atol=1e-9)
    share = np.linspace(0.0, 1.0, len(q))[:, None]
    np.testing.assert_allclose(q[:, 3:], share * [40, 90], atol=1e-9)
    # Chords leave the arc by a tenth of the tolerance at most.
    sagitta = 10.0 * (1.0 - np.cos(0.5 * np.pi / (len(q) - 1)))
    assert 0.0005 < sagitta <= 0.002
    assert np.nansum(blocks.duration) == pytest.approx(10 * np.pi / 1000 * 60)


def test_a_tilted_plane_is_milled_in_straight_blocks():
    text = 'G0 A30 C45\nG0 X0 Y0 Z0\nG1 X20 F1000\nY20\nX0 A30 C45\nG2 Y0 J-10'
    blocks = read(text).blocks
    lines = blocks.line_number
    assert [int((lines == n).sum()) for n in (3, 4, 5)] == [1, 1, 1]
    q = axes_at(blocks)[:, :3] - ZERO
    at = {n: q[np.flatnonzero(lines == n)[-1]] for n in (3, 4, 5, 6)}
    np.testing.assert_allclose(at[5], [0, 20, 0], atol=1e-9)
    np.testing.assert_allclose(at[6], [0, 0, 0], atol=1e-9)
    arc = q[lines == 6]
    np.testing.assert_allclose(np.hypot(arc[:, 0], arc[:, 1] - 10), 10, atol=1e-9)
    np.testing.assert_allclose(arc[:, 2], 0, atol=1e-9)


def test_feed_with_axis_positions_is_of_xyz_or_of_the_turn():
    blocks = read('G0 X0 A0\nG1 X10 A40 F600\nG1 A0 F600\nG1 X20').blocks
    for line, seconds in ((2, 1.0), (3, 40 / 600 * 60)):
        pieces = blocks.line_number == line
        assert blocks.duration[pieces].sum() == pytest.approx(seconds)
        assert np.isnan(blocks.feedrate[pieces]).all()
    assert blocks.feedrate[-1] == pytest.approx(0.01)


def test_tip_programming_switched_where_the_axes_stand():
    text = 'G0 X10 A30 C90\nM428\nG91 G0 X1\nM429\nG0 X1'
    blocks = read(text).blocks
    first, second, third = blocks.tip
    np.testing.assert_allclose(second - first, [1e-3, 0, 0], atol=1e-15)
    q = axes_at(blocks[:1])[0]
    np.testing.assert_allclose(q, np.r_[ZERO + [10, 0, 0], 30, 90], atol=1e-9)
    before = AC.linear(second[None], np.radians([[30, 90]]))[0]
    after = AC.linear(third[None], np.radians([[30, 90]]))[0]
    np.testing.assert_allclose(after - before, [1e-3, 0, 0], atol=1e-15)


def test_machine_coordinates():
    blocks = read('G0 X0 Y0 Z0\nG0 G53 Z200\nG53 X0 Y0\nG53 A20 C-30\nSUPA X1\nG0 X5').blocks
    rotary = np.nan_to_num(blocks.rotary)
    ends = np.flatnonzero(np.diff(blocks.line_number, append=-1))
    q = AC.linear(blocks.tip[ends], rotary[ends]) * 1e3
    np.testing.assert_allclose(q[1], [ZERO[0], ZERO[1], 200], atol=1e-9)
    np.testing.assert_allclose(q[2:4], [[0, 0, 200], [0, 0, 200]], atol=1e-9)
    np.testing.assert_allclose(np.degrees(rotary[ends[3]]), [20, -30])
    np.testing.assert_allclose(q[4], [1, 0, 200], atol=1e-9)
    np.testing.assert_allclose(q[5], [ZERO[0] + 5, 0, 200], atol=1e-9)


def test_reference_points():
    setup = JobSetup(reference_points={'G30': {'X': 0.1, 'C': 1.0}})
    text = 'G0 X0 Y0 Z0\nG91 G28 Z5\nG90 G30 X1 Y2\nG28'
    blocks = read(text, setup=setup).blocks
    q = AC.linear(blocks.tip, np.nan_to_num(blocks.rotary)) * 1e3
    np.testing.assert_allclose(q[0], ZERO)
    np.testing.assert_allclose(q[1], ZERO + [0, 0, 5])
    np.testing.assert_allclose(q[2], [ZERO[0], ZERO[1], 0], atol=1e-9)
    np.testing.assert_allclose(q[3], [ZERO[0] + 1, ZERO[1] + 2, 0], atol=1e-9)
    np.testing.assert_allclose(q[4], [100, 0, 0], atol=1e-9)
    np.testing.assert_allclose(q[5], [0, 0, 0], atol=1e-9)
    assert blocks.rapid.all()


OFFSETS = JobSetup(
    work_offsets={
        'G54': {'X': 0.04, 'Y': -0.06985, 'Z': 0.14},
        'G55': {'X': 0.05, 'Y': -0.06985, 'Z': 0.14, 'C': np.radians(10)},
    },
    tools={1: Tool(0.02), 2: Tool(0.05)},
)


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('G54 G0 X1 Y2 Z3', [1, 2, 3]),
        ('G55 G0 X1 Y2 Z3', [11, 2, 3]),
        ('G0 X1\nG92 X0 Y0\nG0 X1 Y2', [2, 2, 0]),
        ('G0 X1\nG92 X0\nG92.1\nG0 X1', [1, 0, 0]),
        ('G0 X1\nG92 X0\nG92.2\nG0 X3\nG92.3\nG0 X3', [4, 0, 0]),
        ('G52 X5\nG0 X1', [6, 0, 0]),
        ('G52 X5\nG52 X0\nG0 X1', [1, 0, 0]),
        ('G10 L2 P1 X41 Y-69.85\nG54 G0 X1 Y0', [2, 0, 0]),
        ('G54 G0 X5\nG10 L20 P1 X1\nG0 X2', [6, 0, 0]),
        ('G43 H1 G0 Z3', [0, 0, 23]),
        ('T2 M6\nG43 G0 Z3', [0, 0, 53]),
        ('G44 H1 G0 Z3', [0, 0, -17]),
        ('G43.1 Z7\nG0 Z3', [0, 0, 10]),
        ('G43 H1 G0 Z3\nG49\nG0 X1', [1, 0, 23]),
        ('TRANS X1 Y2\nATRANS X1\nG0 X1 Y1', [3, 3, 0]),
        ('ROT Z90\nG0 X1 Y2', [-2, 1, 0]),
        ('TRANS X10\nAROT Z90\nATRANS X1\nG0 X1 Y2', [8, 2, 0]),
        ('AROT X90\nG0 X1 Y2 Z3', [1, -3, 2]),
        ('ROT RPL=90\nG0 X1 Y2', [-2, 1, 0]),
        ('TRANS X10\nTRANS\nG0 X1', [1, 0, 0]),
        ('ROT Z90\nCYCLE800()\nG0 X1', [1, 0, 0]),
        ('G0 X1 (one)\nG91 X=AC(5) Y=IC(2)', [5, 2, 0]),
    ],
)
def test_offsets_and_frames(text, wanted):
    tip = read(text, setup=OFFSETS).blocks.tip[-1] * 1e3
    np.testing.assert_allclose(tip, wanted, atol=1e-9)


def test_an_offset_of_a_rotary_axis():
    blocks = read('G55\nG0 C0\nG0 C20', setup=OFFSETS).blocks
    np.testing.assert_allclose(np.degrees(blocks.rotary[[0, -1], 1]), [10, 30])


@pytest.mark.parametrize(
    ('text', 'wanted'),
    [
        ('G0 C350\nG0 C10', 10),
        ('G0 C350\nG0 C=DC(10)', 370),
        ('G0 C350\nG0 C=ACN(10)', 10),
        ('G0 C10\nG0 C=ACN(350)', -10),
        ('G0 C10\nG0 C=ACP(0)', 360),
        ('G0 C179\nG1 C-179 F100', -179),
    ],
)
def test_the_way_a_rotary_axis_turns(text, wanted):
    assert np.degrees(read(text).blocks.rotary[-1, 1]) == pytest.approx(wanted)


def test_the_shortest_way_and_the_trap_of_180_deg():
    text = 'M428\nG0 X0 A20 C170\nG1 X1 C-170 F100\nX2 C-160\nX3 C170'
    programmed = read(text)
    assert np.degrees(programmed.blocks.rotary[-1, 1]) == pytest.approx(170)
    assert any('more than 180 deg' in notice for notice in programmed.notices)
    shortest = read(text, rotary_sense='shortest')
    ends = np.flatnonzero(np.diff(shortest.blocks.line_number, append=-1))
    np.testing.assert_allclose(
        np.degrees(shortest.blocks.rotary[ends, 1]), [170, 190, 200, 170], atol=1e-9
    )
    assert not any('180' in notice for notice in shortest.notices)


@pytest.mark.parametrize(('on', 'words'), [('TRAORI', 'A3=1 B3=0 C3=1'), ('G43.5 H1', 'I1 J0 K1')])
def test_tool_directions(on, words):
    blocks = read(f'{on}\nG0 X0 A0 C0\nG1 X5 {words} F600\nX6\nG1 X7 A0 C0').blocks
    s = np.sqrt(0.5)
    line = blocks.line_number
    np.testing.assert_allclose(blocks.axis[line == 3][-1], [s, 0, s])
    np.testing.assert_allclose(blocks.axis[line == 4][-1], [s, 0, s])
    assert np.isnan(blocks.rotary[line == 3]).all()
    np.testing.assert_allclose(blocks.axis[-1], [0, 0, 1], atol=1e-15)


def test_tool_directions_turn_with_the_frame_and_end_at_traofoof():
    blocks = read('TRAORI\nG0 X0 A0 C0\nROT Z90\nG1 X1 A3=1 B3=0 C3=1 F600\nTRAFOOF\nG0 A0').blocks
    s = np.sqrt(0.5)
    at = np.flatnonzero(blocks.line_number == 4)[-1]
    np.testing.assert_allclose(blocks.axis[at], [0, s, s], atol=1e-12)
    np.testing.assert_allclose(np.degrees(blocks.rotary[-1]), [0, 0], atol=1e-9)
    np.testing.assert_allclose(blocks.axis[-1], [0, 0, 1], atol=1e-12)


@pytest.mark.parametrize(
    ('text', 'contour', 'orientation'),
    [
        ('CTOL=0.05', 5e-5, 2e-5),
        ('OTOL=0.1', 2e-5, 0.03 * np.radians(0.1)),
        ('G642 CTOL=0.05', 5e-5, 2e-5),
        ('CYCLE832(0.04,1,1)', 4e-5, 4e-5),
        ('CYCLE832(0.04,1,1)\nCYCLE832()', 2e-5, 2e-5),
    ],
)
def test_tolerances_of_siemens(text, contour, orientation):
    blocks = read(f'{text}\nG0 X1').blocks
    assert blocks.contour_tolerance[0] == pytest.approx(contour)
    assert blocks.orientation_tolerance[0] == pytest.approx(orientation)


WORDS = st.fixed_dictionaries(
    {},
    optional={letter: st.integers(-9000, 9000).map(lambda n: n / 100) for letter in 'XYZAC'},
)


@settings(max_examples=40)
@given(
    lines=st.lists(st.tuples(st.sampled_from(['G0', 'G1', '']), WORDS), min_size=8, max_size=20),
    tcp=st.booleans(),
    incremental=st.booleans(),
    sense=st.sampled_from(['programmed', 'shortest']),
)
def test_runs_of_plain_lines_mean_what_their_lines_mean(lines, tcp, incremental, sense):
    """A word in lower case brackets makes a line rare: it is then read on its own."""
    head = [
        'G92 A5 C-30',
        'M428' if tcp else 'M429',
        'G0 X0 F500',
        'G91' if incremental else 'G90',
    ]
    plain = [code + ''.join(f' {k}{v}' for k, v in words.items()) for code, words in lines]
    rare = [code + ''.join(f' {k}[{v}]' for k, v in words.items()) for code, words in lines]
    first, second = (
        read('\n'.join(head + body), rotary_sense=sense).blocks for body in (plain, rare)
    )
    for name in first.__dataclass_fields__:
        np.testing.assert_allclose(
            getattr(first, name), getattr(second, name), rtol=0, atol=1e-12, err_msg=name
        )


def test_rotary_words_after_a_tool_direction_start_where_the_axes_stand():
    """Linear rotary axes out of A3 B3 C3 began at the rotary words before it."""
    text = 'TRAORI\nG0 X0 Y0 Z0 A10 C0\nG1 F600 X5 A3=0 B3=0.5 C3=1\nX10 A40 C60\n'
    blocks = read_text(text, 't.ngc', Transform.of(Machine.load('xyzac')), Settings()).blocks
    tilt = np.degrees(np.arccos(blocks.axis[blocks.line_number == 4, 2]))
    assert len(tilt) > 1 and tilt[0] > np.degrees(np.arctan(0.5))


def test_start_pose_by_a_tool_direction_names_no_rotary_positions():
    text = 'TRAORI\nG0 X0 Y0 Z0 A3=0 B3=0.5 C3=1\nG1 F600 X5\n'
    blocks = read_text(text, 't.ngc', Transform.of(Machine.load('xyzac')), Settings()).blocks
    assert np.isnan(blocks.rotary).all()
    assert blocks.axis[0] == pytest.approx([0.0, 5**-0.5, 2 * 5**-0.5])


def dense(count, fast=True):
    """Short blocks with A, read as a run of plain lines or line by line."""
    u = np.arange(count)
    x, a = 0.4 * u, 20.0 + 15.0 * np.sin(u / 60.0)
    extra = '' if fast else ' (one)'
    rows = [f'X{p:.4f} A{q:.4f}{extra}' for p, q in zip(x, a, strict=True)]
    return 'G1 F6000\n' + '\n'.join(rows)


def test_dense_blocks_become_poses_however_they_are_read():
    start = 'G0 X0 Y0 Z0 A20 C0\nG1 X-40 A-20 F1000\nX-20 A0.5\nX-5 A20\n'
    end = '\nG1 X900 A60 C90\nM30'
    blocks = read(start + dense(500) + end).blocks
    kinds = blocks.interpolation.tolist()
    last = max(i for i, kind in enumerate(kinds[:-1]) if kind == AXES_LINEAR)
    assert 30 < last < 40 and kinds[-1] == AXES_LINEAR
    assert kinds[5:last] == [AXES_LINEAR] * (last - 5)
    other = read(start + dense(500, fast=False) + end).blocks
    for name in blocks.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(blocks, name), getattr(other, name), name)


@pytest.mark.parametrize(
    ('dialect', 'unit', 'seconds'),
    [
        ('fanuc', 'G21', [6.0, 4.8, 3.6, np.hypot(20 * np.pi, 80) * 0.12]),
        ('fanuc', 'G20', [6.0, 4.8, 3.6, np.hypot(20 * np.pi, 80) * 0.12]),
        ('linuxcnc', 'G21', [3.6, 4.8, 3.6, 20 * np.pi * 0.12]),
        ('auto', 'G21', [3.6, 4.8, 3.6, 20 * np.pi * 0.12]),
    ],
)
def test_on_fanuc_degrees_count_in_the_feed_as_millimetres(dialect, unit, seconds):
    text = f'{unit}\nG0 X0 Y0 A0\nG1 X30 A40 F500\nA0\nX0\nG2 X0 Y0 I10 A80\n'
    program = read_text(
        text, 'part.nc', Transform.of(Machine.load('xyza')), Settings(dialect=dialect)
    )
    blocks = program.blocks
    # A line with one kind of axis may have a feed instead.
    step = np.linalg.norm(np.diff(blocks.tip, axis=0, prepend=0.0), axis=1)
    time = np.where(np.isfinite(blocks.duration), blocks.duration, step / blocks.feedrate)
    found = [time[blocks.line_number == line].sum() for line in (3, 4, 5, 6)]
    np.testing.assert_allclose(found, seconds)
    told = any('degrees count' in notice for notice in program.notices)
    assert told == (dialect == 'auto')
