"""AxisPath: derivatives, joins, whole turns, the pole, travel; checked from forward kinematics."""

import copy
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from programs import blocks_of, pyramid, spline_segments, zigzag

from cnc_interp.core import DEG, MM, BlockError, SingularityError, TravelError
from cnc_interp.kinematics.axis_path import AxisPath, evaluate, evaluate_cells
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.kinematics.path_checks import check_travel
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_program, read_text
from cnc_interp.run.path_chain import PathChain, segments_of
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.lookahead import LookAhead

AC = Transform.of(Machine.load('xyzac'))


def path_of(blocks, transform=AC, batch=1000, **options):
    """Blocks to AxisPath on a machine, batch by batch."""
    pole = tuple(transform.pole) if transform.machine.has_rotary else None
    lookahead = LookAhead(Settings(**options), MachineTraits(pole=pole))
    builder = AxisPathBuilder(transform, 0.03, 1e-3)
    parts = [lookahead.push(blocks[i : i + batch]) for i in range(0, len(blocks), batch)]
    pieces = [builder.push(part) for part in [*parts, lookahead.finish()]]
    return AxisPath.join([piece for piece in pieces if piece is not None])


@pytest.mark.parametrize('name', ['xyzac', 'xyzbc'])
@pytest.mark.parametrize('blocks', [pyramid(), pyramid(-1.0), zigzag(1), zigzag(2, step=0.3 * MM)])
def test_axes_put_tip_and_axis_where_the_path_says(name, blocks):
    transform = Transform.of(Machine.load(name))
    path = path_of(blocks, transform)
    tip, axis = transform.forward(path.q)
    assert np.abs(tip - path.tip).max() < 1e-12
    assert np.abs(axis - path.axis).max() < 1e-12
    assert np.abs(path.tip[-1] - blocks.tip[-1]).max() < 1e-15


@pytest.mark.parametrize('blocks', [pyramid(), zigzag(1), zigzag(2, step=0.3 * MM)])
def test_derivatives_are_those_of_the_axes(blocks):
    """Inside each cell, q_s, q_ss, q_sss are the finite differences of q one order below."""
    path = path_of(blocks)
    h = np.diff(path.s)
    cells = np.arange(len(h))
    inside = [evaluate(path, path.s[:-1] + share * h, cells) for share in (0.45, 0.5, 0.55)]
    for order in (1, 2, 3):
        slope = (inside[2][order - 1] - inside[0][order - 1]) / (0.1 * h[:, None])
        size = np.abs(inside[1][order]).max(axis=0) + 1e-9
        noise = 1e-13 / h[:, None] ** order
        assert (np.abs(slope - inside[1][order]) < 2e-3 * size + noise).all()


@pytest.mark.parametrize('blocks', [pyramid(), zigzag(1), zigzag(2, step=0.3 * MM)])
def test_joins_are_continuous_to_the_second_derivative(blocks):
    path = path_of(blocks)
    going = ~path.stop[1:-1]
    for order in range(3):
        left, right = path.cell_right[order, :-1][going], path.cell_left[order, 1:][going]
        size = np.abs(path.cell_left[order]).max(axis=0)
        assert (np.abs(left - right) <= 1e-9 * size).all()


@pytest.mark.parametrize('way', ['linear', 'paper'])
def test_tool_rests_where_an_inexact_connection_has_a_kink(way):
    """A finite jump of q_s is an endless jerk: the path must stop there, and only there."""
    path = path_of(zigzag(3, tolerance=1 * MM), parametrization=way, top='tolerance')
    gap = np.abs(path.cell_right[1, :-1] - path.cell_left[1, 1:]).max(axis=1)
    assert path.stop[1:-1][gap > 1e-3].all() and (gap > 1e-3).any()
    assert not path_of(zigzag(3, tolerance=1 * MM)).stop[1:-1].any()


@pytest.mark.parametrize('options', [{}, {'parametrization': 'linear', 'top': 'tolerance'}])
def test_kinks_are_seen_between_segments_that_come_one_by_one(options):
    segments = segments_of(zigzag(3, tolerance=1 * MM), AC, Settings(**options))
    whole = AxisPathBuilder(AC, 0.03, 1e-3).push(segments)
    builder = AxisPathBuilder(AC, 0.03, 1e-3)
    pieces = [builder.push(segments[i : i + 1]) for i in range(len(segments))]
    joined = AxisPath.join([piece for piece in pieces if piece is not None])
    assert np.array_equal(whole.stop, joined.stop)
    assert whole.stop[1:-1].any() == bool(options)


def test_arc_length_is_that_of_the_tip():
    path = path_of(pyramid())
    s = np.interp(np.linspace(0, len(path.s) - 1, 100001), np.arange(len(path.s)), path.s)
    tip, _ = AC.forward(evaluate(path, s)[0])
    assert np.linalg.norm(np.diff(tip, axis=0), axis=1).sum() == pytest.approx(
        path.s[-1], rel=1e-8
    )


@pytest.mark.parametrize('seed', range(4))
def test_spline_is_followed_with_its_derivatives(seed):
    """Tip and axis are those of the curve; C4 in u means that q_sss too runs through the joins."""
    segments, curve = spline_segments(seed)
    path = AxisPathBuilder(AC, 0.03, 1e-3).push(segments)
    tip, axis = AC.forward(path.q)
    u = np.linspace(5.0, 5.0 + len(segments), 20001)
    tips, tops = curve(u)[:, :3], curve(u)[:, 3:]
    axes = (tops - tips) / np.linalg.norm(tops - tips, axis=1)[:, None]
    nearest = np.linalg.norm(tip[:, None] - tips[None, ::20], axis=2).argmin(axis=1) * 20
    for i, at in enumerate(nearest):
        near = slice(max(at - 30, 0), at + 31)
        gap = np.linalg.norm(tip[i] - tips[near], axis=1)
        assert gap.min() < 0.6 * np.linalg.norm(np.diff(tips, axis=0), axis=1).max()
        assert np.abs(axis[i] - axes[near][gap.argmin()]).max() < 1e-5
    assert path.s[-1] == pytest.approx(
        np.linalg.norm(np.diff(tips, axis=0), axis=1).sum(), rel=1e-6
    )
    for order in range(4):
        left, right = path.cell_right[order, :-1], path.cell_left[order, 1:]
        assert np.abs(left - right).max() <= 1e-8 * np.abs(path.cell_left[order]).max()
    h = np.diff(path.s)
    cells = np.arange(len(h))
    inside = [evaluate(path, path.s[:-1] + share * h, cells) for share in (0.45, 0.5, 0.55)]
    for order in (1, 2, 3):
        slope = (inside[2][order - 1] - inside[0][order - 1]) / (0.1 * h[:, None])
        size = np.abs(inside[1][order]).max(axis=0) + 1e-9
        assert (np.abs(slope - inside[1][order]) < 5e-3 * size).all()


def test_curve_whose_tip_rests_is_refused():
    segments, _ = spline_segments(0)
    resting = replace(segments, bottom=np.repeat(segments.bottom[:, :1], 6, axis=1))
    with pytest.raises(BlockError, match='the tip rests on a curve while the tool axis turns'):
        AxisPathBuilder(AC, 0.03, 1e-3).push(resting)


def test_same_path_however_it_is_cut():
    blocks = zigzag(8, count=40)
    whole, pieces = path_of(blocks), path_of(blocks, batch=3)
    assert np.array_equal(whole.cell_left, pieces.cell_left)
    assert np.array_equal(whole.s, pieces.s)


def test_rotary_axes_are_never_wrapped():
    """Three times around a cone: C runs through three whole turns."""
    turn = np.linspace(0, 6 * np.pi, 73)
    axes = np.c_[0.5 * np.sin(turn), 0.5 * np.cos(turn), np.ones(73)]
    tips = np.c_[20 * MM * np.sin(turn), 20 * MM * np.cos(turn), np.zeros(73)]
    path = path_of(blocks_of(tips, axes))
    assert abs(path.q[-1, 4] - path.q[0, 4]) == pytest.approx(6 * np.pi, abs=1e-9)
    assert np.abs(np.diff(path.q[:, 4])).max() < 0.2


def test_programmed_start_chooses_branch_and_turn():
    axes = [[0, np.sin(-0.5), np.cos(-0.5)]] * 2
    rotary = np.full((2, 2), np.nan)
    for start in ([-0.5, 4 * np.pi], [0.5, np.pi], [0.5, -np.pi]):
        rotary[0] = start
        path = path_of(blocks_of([[0, 0, 0], [10 * MM, 0, 0]], axes, rotary=rotary.copy()))
        assert np.allclose(path.q[:, 3:], start)


def test_three_axis_path_on_the_pole_keeps_c():
    path = path_of(blocks_of([[0, 0, 0], [30 * MM, 0, 0], [30 * MM, 20 * MM, 0]], [[0, 0, 1]] * 3))
    assert np.abs(path.q[:, 3:]).max() == 0.0
    assert np.abs(path.cell_left[1:, :, 3:]).max() == 0.0


def test_great_circle_through_the_pole_changes_the_sign_of_a_and_keeps_c():
    lean = 10 * DEG
    axes = [[0, np.sin(lean), np.cos(lean)], [0, -np.sin(lean), np.cos(lean)]]
    path = path_of(blocks_of([[0, 0, 0], [30 * MM, 0, 0]], axes))
    assert np.allclose(path.q[[0, -1], 3], [lean, -lean], atol=1e-12)
    assert np.ptp(path.q[:, 4]) == 0.0
    assert np.abs(AC.forward(path.q)[1] - path.axis).max() < 1e-12


def test_c_turns_under_the_moving_tip_before_the_tool_leaves_the_pole_sideways():
    """Tool upright, C at 0; then the tool leans toward +X, which needs C at +-90 deg."""
    tips = [[0, 0, 0], [20 * MM, 0, 0], [40 * MM, 0, 0]]
    rotary = np.full((3, 2), np.nan)
    rotary[0] = 0.0
    path = path_of(blocks_of(tips, [[0, 0, 1], [0, 0, 1], [0.3, 0, 1]], rotary=rotary))
    c, upright = path.q[:, 4], path.tip[:, 0] < 19 * MM
    assert c[0] == 0.0 and abs(c[-1]) == pytest.approx(np.pi / 2)
    assert np.ptp(c[upright]) > 60 * DEG and not path.stop[1:-1].any()
    tip, axis = AC.forward(path.q)
    assert np.abs(tip - path.tip).max() < 1e-12 and np.abs(axis - path.axis).max() < 1e-12


@pytest.mark.parametrize('turns', [0, 3])
def test_c_turns_at_rest_if_the_tool_leaves_the_pole_after_a_stop(turns):
    tips = [[0, 0, 0], [20 * MM, 0, 0], [40 * MM, 0, 0]]
    stop = [False, True, False]
    rotary = np.full((3, 2), np.nan)
    rotary[0] = 0.0, 2.0 * np.pi * turns
    axes = [[0, 0, 1], [0, 0, 1], [0.3, 0, 1]]
    path = path_of(blocks_of(tips, axes, rotary=rotary, exact_stop=stop))
    turning = np.abs(path.tip[:, 0] - 20 * MM) < 1e-12
    assert np.ptp(path.q[turning, 4]) == pytest.approx(np.pi / 2)
    assert path.stop[np.flatnonzero(turning)[[0, -1]]].all()


def test_first_pose_that_names_no_rotary_positions_has_c_where_the_tool_will_leave_the_pole():
    path = path_of(blocks_of([[0, 0, 0], [40 * MM, 0, 0]], [[0, 0, 1], [0.3, 0, 1]]))
    assert np.ptp(path.q[:, 4]) < 1e-9 and abs(path.q[0, 4]) == pytest.approx(np.pi / 2)


def test_programmed_turn_about_the_tool_axis_is_kept():
    """C through 360 deg at A = 0 moves nothing in the workpiece frame, and is done."""
    rotary = np.array([[0, 0], [0, 2 * np.pi], [0, 2 * np.pi]], float)
    blocks = blocks_of([[0, 0, 0], [0, 0, 0], [10 * MM, 0, 0]], [[0, 0, 1]] * 3, rotary=rotary)
    path = path_of(blocks)
    assert path.q[-1, 4] == 2 * np.pi
    assert np.abs(AC.forward(path.q)[0] - path.tip).max() < 1e-12


def test_turning_tool_too_close_to_the_pole_is_refused():
    """A great circle that passes the pole at 0.01 deg."""
    near = 0.01 * DEG
    axes = [[near, 0.2, 1], [near, -0.2, 1]]
    narrow = 0.9 * near * 30 * MM  # the pole is out of its reach
    with pytest.raises(SingularityError, match=r'line 2: .* 0\.02 deg .* axis C'):
        path_of(blocks_of([[0, 0, 0], [30 * MM, 0, 0]], axes, tolerance=narrow))
    axes = [[10 * near, 0.2, 1], [10 * near, -0.2, 1]]
    path = path_of(blocks_of([[0, 0, 0], [30 * MM, 0, 0]], axes))
    assert np.ptp(path.q[:, 4]) > 175 * DEG


def test_pose_out_of_travel_is_refused_naming_axis_and_value():
    tips = [[0, 0, 0], [480 * MM, 0, 0]]
    with pytest.raises(TravelError, match=r'line 2: axis X .* 520\.000 mm, .* -500 \.\.\. 500 mm'):
        path_of(blocks_of(tips, [[0, 0, 1]] * 2))


def test_a_septic_that_ends_at_the_end_of_travel_is_within_it_though_its_bezier_values_are_not():
    machine, lines = Machine.load('xyzac'), np.array([7])
    low = machine.travel[0, 0]

    def checked(last_but_three):
        points = low + np.array([0.5, 0.5, 0.5, -0.01, last_but_three, 0.0, 0.0, 0.0])
        ends = np.zeros((2, 1, 4, 5))
        for end, side in zip(ends, (points, points[::-1]), strict=True):
            jet = [np.diff(side[: k + 1], k)[0] * (1, 7, 42, 210)[k] for k in range(4)]
            end[0, :, 0] = jet
        ends[1] *= np.array([1.0, -1.0, 1.0, -1.0])[:, None]
        check_travel(machine, np.ones(1), *ends, lines)

    checked(0.01)
    with pytest.raises(TravelError, match='line 7: axis X'):
        checked(0.0)


HIDDEN = {
    'rotary words, TCP on': 'M428\nG0 X0 Y240 Z0 A0 C0\nG1 X10 C170 F2000\nG1 X0 C0',
    'poses': 'G0 X0 Y240 Z0 A10 C0\nM428\nG1 X20 Y230 C170 F2000',
    'corner of axes, TCP off': 'G0 X0 Y0 Z0 A0 C0\nG1 X50 Y20 Z-5 A20 F2000\nX80 Y10 Z7 A10 C20',
    'past the pole': 'TRAORI\nG0 X-280 A3=0 B3=0.36 C3=1\nG1 X28 A3=0.0003 B3=-0.36 C3=1 F3000',
}


@pytest.mark.parametrize('name', HIDDEN)
def test_travel_counts_between_the_ends_of_cells(name):
    """An axis that turns back inside a cell left its travel unseen, by up to a millimetre."""
    free = AC.machine.having(travel=np.array([[-np.inf, np.inf]] * 5))
    text = 'G21 G90 G94\n' + HIDDEN[name] + '\nM30\n'

    def course(machine):
        transform = Transform.of(machine)
        chain = PathChain(transform, Settings())
        program = read_text(text, 'part.ngc', transform, Settings())
        parts = [chain.push(program.blocks), chain.finish()]
        path = AxisPath.join([part.path for part in parts if part.path is not None])
        return path, program.blocks.line_number[path.cell_block]

    path, lines = course(free)
    u = np.linspace(0.0, 1.0, 201)
    cell = np.arange(len(path.s) - 1).repeat(len(u))
    along = (np.diff(path.s)[:, None] * u).ravel()
    q = evaluate_cells(path.s, path.cell_left, path.cell_right, along, cell)[0]
    q = q.reshape(-1, len(u), 5)
    checked = 0
    for k, side in itertools.product(range(5), (-1.0, 1.0)):
        inside, ends = (side * q[:, :, k]).max(axis=1), (side * path.q[:, k]).max()
        if inside.max() - ends < 1e-7:
            continue
        checked += 1
        for limit, refused in ((0.5 * (inside.max() + ends), True), (inside.max() + 1e-6, False)):
            travel = free.travel.copy()
            travel[k, 1 if side > 0 else 0] = side * limit
            narrow = free.having(travel=travel)
            if not refused:
                course(narrow)
                continue
            with pytest.raises(TravelError) as refusal:
                course(narrow)
            assert refusal.value.line_number == lines[np.argmax(inside > limit)]
            assert refusal.value.axis == free.axis_names[k]
            assert side * refusal.value.value == pytest.approx(inside.max(), abs=1e-5)
    assert checked > 0


def test_tilted_tool_on_a_3_axis_machine_is_refused():
    plain = Transform.of(Machine.load('xyz'))
    tips = [[0, 0, 0], [10 * MM, 0, 0]]
    assert path_of(blocks_of(tips, [[0, 0, 1]] * 2), plain).q.shape[1] == 3
    with pytest.raises(BlockError, match='needs rotary axes'):
        path_of(blocks_of(tips, [[0, 0.1, 1]] * 2), plain)


def test_start_out_of_rotary_travel_is_refused():
    machine = copy.copy(AC.machine)
    travel = machine.travel.copy()
    travel[3] = [-5 * DEG, 5 * DEG]
    narrow = Transform.of(machine.having(travel=travel))
    with pytest.raises(BlockError, match='no rotary position of machine xyzac within its travel'):
        path_of(pyramid(), narrow)


def test_a_part_far_from_its_zero_is_cut_no_finer():
    """The last digits of metres must not pass for a shape: they were cut down to nothing."""
    file = Path(__file__).parents[3] / 'shared/programs/creo-finition-ncl/finition.ncl'
    if not file.exists():
        pytest.skip('the collection of real programs is not at hand')
    heads = Transform.of(Machine.load('head_head'))
    blocks = read_program(file, heads, Settings()).blocks[520:545]
    path = path_of(blocks, heads)
    assert np.diff(path.s).min() > 1e-6
    assert len(path.s) < 20 * len(blocks)
