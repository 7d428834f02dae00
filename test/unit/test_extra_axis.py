"""A sixth, linear axis W along Z: from words to setpoints, with TCP on and off, and the proof."""

import copy
from dataclasses import replace

import numpy as np
import pytest
import yaml
from whole_plans import plan_program, write_plan

from cnc_interp.core import DEG, MM, MachineError, ProgramError, StreamError
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine, find_machine_file, from_mapping
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import BlockSpool
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.verify import verify
from cnc_interp.run.run_state import RunId
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import CORNER, SPLINE

MACHINE = Machine.load('xyzacw')
TRANSFORM = Transform.of(MACHINE)
CONTENT = yaml.safe_load(find_machine_file('xyzacw').read_text())
Z, W = 2, 5

TCP_ON = """G21 G90 G94
TRAORI
G0 X0 Y0 Z10 A10 C30
G1 Z0 F3000
X40 W10
X40 Y30 W-5
X10 Y30
X10 Y10 W8
W-8
X20 Y10 A15 C40 W0
X30 Y25
M30
"""
TCP_OFF = """G21 G90 G94
G0 X0 Y0 Z0 W0
G1 X30 Z12 W-6 F3000
X30 Y20 W10
W2
Z20
M30
"""


def read(text, machine=MACHINE):
    return read_text(text, 'part.ngc', Transform.of(machine), Settings())


def planned(text, machine=MACHINE):
    return plan_program(read(text, machine), machine, Settings())


@pytest.fixture(scope='module')
def plan():
    return planned(TCP_ON)


def test_words_become_positions_that_stay_until_the_next_word():
    blocks = read('G21\nG0 X0 W5\nG1 X10 F600\nG91 W-2\nX1\nG90 W1\nM30').blocks
    assert np.allclose(blocks.extra[:, 0], np.array([5, 5, 3, 3, 1]) * MM)


def test_a_machine_without_the_axis_refuses_its_word_in_one_line():
    with pytest.raises(ProgramError) as refusal:
        read('G21\nG0 X0\nG1 W10 F600\nM30', Machine.load('xyzac'))
    assert 'the machine has no axis W' in str(refusal.value)
    assert refusal.value.line_number == 3
    assert '\n' not in str(refusal.value)


def test_the_tip_stands_at_machine_z_plus_w():
    rng = np.random.default_rng(3)
    q = np.c_[rng.uniform(-0.2, 0.2, (40, 3)), rng.uniform(-1, 1, (40, 2)), np.zeros(40)]
    w = rng.uniform(-0.1, 0.1, 40)
    moved = q.copy()
    moved[:, Z], moved[:, W] = q[:, Z] - w, w
    for first, second in zip(TRANSFORM.forward(q), TRANSFORM.forward(moved), strict=True):
        assert np.abs(first - second).max() < 1e-15


def test_every_derivative_of_the_path_is_that_of_its_positions(plan):
    path = AxisPathBuilder(TRANSFORM, 30 * MM, 1e-3).push(plan.segments)
    assert path.cell_left.shape[2] == 6
    tip, axis = TRANSFORM.forward(path.q)
    assert np.abs(tip - path.tip).max() < 1e-9
    assert np.abs(axis - path.axis).max() < 1e-9
    on = np.flatnonzero(~path.stop[1:-1])
    jump = path.cell_right[:3, :-1][:, on] - path.cell_left[:3, 1:][:, on]
    assert np.abs(jump[0]).max() < 1e-9
    assert np.abs(jump[1]).max() < 1e-8  # W and Z join lines and corners without a kink
    assert np.abs(jump[2]).max() < 1e-4
    assert (plan.segments.kind == CORNER).sum() >= 4


def test_w_is_smooth_on_a_rounded_corner_and_within_the_tolerance_of_its_word(plan):
    segments = plan.segments
    corner = segments.extra[segments.kind == CORNER][:, :, 0]
    middle = (corner[:, 1] + 2.0 * corner[:, 2] + corner[:, 3]) / 4.0
    assert np.abs(middle - corner[:, 2]).max() <= 0.02 * MM * (1 + 1e-9)
    assert np.abs(np.diff(corner[:, :5], 2, axis=1)).max() > 1e-6  # rates differ, yet no stop


def test_where_w_moves_alone_the_tip_rests_and_f_is_its_speed(plan):
    row = int(np.flatnonzero(plan.program.blocks.line_number == 9)[0])
    inside = plan.setpoints.block == row
    position = plan.setpoints.position[inside]
    tip, _ = TRANSFORM.forward(position)
    assert np.ptp(tip, axis=0).max() < 1e-9
    assert np.ptp(position[:, W]) > 15 * MM
    assert np.abs(position[:, Z] + position[:, W] - position[0, Z] - position[0, W]).max() < 1e-9
    assert np.abs(plan.setpoints.velocity[inside, W]).max() == pytest.approx(0.05, rel=1e-3)


@pytest.mark.parametrize('text', [TCP_ON, TCP_OFF], ids=['tcp on', 'tcp off'])
def test_plans_are_proven_and_a_missed_word_is_not(text, tmp_path):
    made = planned(text)
    write_plan(made, tmp_path)
    files = read_plan(tmp_path)
    assert files.position.shape[1] == 6
    with np.load(tmp_path / 'segments.npz') as archive:
        assert np.array_equal(archive['extra'], made.segments.extra)
    proof = verify(files, MACHINE)
    assert proof.ok, proof.failures
    assert proof.largest('word missed by W').ratio <= 1.0
    wrong = files.blocks['extra_axes'].copy()
    wrong[2] += 0.05 * MM
    proof = verify(replace(files, blocks={**files.blocks, 'extra_axes': wrong}), MACHINE)
    assert any('word missed by W' in failure for failure in proof.failures)


def test_without_tcp_w_is_an_axis_position_like_x():
    made = planned(TCP_OFF)
    first = made.setpoints.block == 1
    position = made.setpoints.position[first]
    zero = made.setpoints.position[0]
    share = (position[:, 0] - zero[0]) / (30 * MM)
    early = share < 0.9  # before the corner at its end
    for axis, way in ((Z, 12 * MM), (W, -6 * MM)):
        assert np.abs(position[early, axis] - zero[axis] - share[early] * way).max() < 1e-9
    last = made.setpoints.position[-1] - zero
    assert np.allclose(last[[0, 1, 2, 5]], np.array([30, 20, 20, 2]) * MM, atol=1e-9)


def test_tool_tip_programming_goes_on_from_where_w_stands():
    text = 'G21\nG0 X0 Y0 Z0 A20 C10 W7\nTRAORI\nG1 X5 F600\nTRAFOOF\nG1 X9 Z-3 W7\nM30'
    blocks = read(text).blocks
    at = TRANSFORM.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
    start = np.array([[*at, 20 * DEG, 10 * DEG, 7 * MM]])
    assert np.abs(blocks.tip[0] - TRANSFORM.forward(start)[0][0]).max() < 1e-12
    assert np.abs(blocks.tip[1] - [5 * MM, *blocks.tip[0, 1:]]).max() < 1e-12
    end = np.array([[at[0] + 9 * MM, 0, at[2] - 3 * MM, 20 * DEG, 10 * DEG, 7 * MM]])
    end[0, 1] = TRANSFORM.linear(blocks.tip[1:2], np.array([[20 * DEG, 10 * DEG]]))[0, 1]
    assert np.abs(blocks.tip[-1] - TRANSFORM.forward(end)[0][0]).max() < 1e-12


def test_a_boring_mill_without_rotary_axes_moves_w_too(tmp_path):
    content = {
        'name': 'mill',
        'extra': CONTENT['extra'],
        'limits': {name: CONTENT['limits'][name] for name in 'XYZW'},
    }
    mill = from_mapping(content)
    assert mill.axis_names == ('X', 'Y', 'Z', 'W')
    assert mill.is_linear.all() and not mill.has_rotary
    made = planned(TCP_OFF, mill)
    write_plan(made, tmp_path)
    proof = verify(read_plan(tmp_path), mill)
    assert proof.ok, proof.failures
    assert np.allclose(made.setpoints.position[-1], np.array([30, 20, 20, 2]) * MM, atol=1e-9)


def test_short_blocks_become_a_curve_only_where_w_rests():
    u = np.linspace(0.0, 2.0, 120)
    points = [f'X{30 * np.cos(v):.4f} Y{30 * np.sin(v):.4f}' for v in u]
    still = 'G21\nTRAORI\nG0 X30 Y0 W4\nG1 F3000\n' + '\n'.join(points) + '\nM30'
    moving = 'G21\nTRAORI\nG0 X30 Y0 W4\nG1 F3000\n' + '\n'.join(
        f'{point} W{4 + 3 * v:.4f}' for point, v in zip(points, u, strict=True)
    )
    curves = planned(still).segments
    assert (curves.kind == SPLINE).any()
    assert np.abs(curves.extra[curves.kind == SPLINE] - 4 * MM).max() == 0.0
    assert not (planned(moving + '\nM30').segments.kind == SPLINE).any()


def test_blocks_keep_their_extra_positions_in_the_spool():
    blocks = read(TCP_ON).blocks
    with BlockSpool() as spool:
        spool.append(blocks)
        assert np.array_equal(spool[2:6].extra, blocks.extra[2:6])


@pytest.mark.parametrize(
    ('name', 'values', 'key'),
    [
        ('Q', {'along': 'Z'}, 'extra.Q'),
        ('W', {'along': 'A'}, 'extra.W.along'),
        ('W', None, 'extra.W.along'),
        ('V', {'along': 'Y'}, 'limits.V'),
    ],
)
def test_a_wrong_extra_axis_is_refused_naming_the_key(name, values, key):
    content = copy.deepcopy(CONTENT)
    content['extra'] = {'W': {'along': 'Z'}, name: values}
    with pytest.raises(MachineError, match=key.replace('.', r'\.')):
        from_mapping(content)


def test_messages_carry_extra_positions_bit_for_bit(plan):
    pytest.importorskip('cnc_interp_msgs', reason='needs the message package')
    from cnc_interp.wire.message_checks import check_block, check_segment
    from cnc_interp.wire.path_messages import (
        block_messages,
        blocks_from,
        segment_messages,
        segments_from,
    )

    blocks = block_messages(plan.program.blocks, RunId('p'), 0, 30 * MM, True)
    segments = segment_messages(plan.segments, RunId('p'), 0, 30 * MM, True)
    for block in blocks:
        check_block(block, 1)
    for segment in segments:
        check_segment(segment, 1)
    assert np.array_equal(blocks_from(blocks).extra, plan.program.blocks.extra)
    assert np.array_equal(segments_from(segments).extra, plan.segments.extra)
    for check, message in ((check_block, blocks[1]), (check_segment, segments[1])):
        with pytest.raises(StreamError, match='extra_axes'):
            check(message, 0)
        message.extra_axes[0] = np.nan
        with pytest.raises(StreamError, match='extra_axes'):
            check(message, 1)
