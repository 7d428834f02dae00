"""Paths of poses past the pole, within the tolerance; recomputed from forward kinematics."""

from dataclasses import replace

import numpy as np
import pytest
from programs import blocks_of
from tiers import few_of
from whole_plans import plan_program

from cnc_interp.commands.cli import main
from cnc_interp.core import DEG, MM, BlockError, TravelError
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.kinematics.path_builder import AxisPathBuilder
from cnc_interp.machine_model.machine import Machine, find_machine_file
from cnc_interp.machine_model.machine_traits import traits_of
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import PathSegments

HEIGHT, TOLERANCE = 30 * MM, 0.02 * MM


def slanted_head():
    """A head whose tilting axis leans 45 deg: both branches do not differ by half a turn."""
    heads = Machine.load('head_head')
    direction = np.array([[0.0, 0.0, 1.0], [0.0, np.sqrt(0.5), np.sqrt(0.5)]])
    travel = heads.travel.copy()
    travel[3:5] = [-np.inf, np.inf]
    return replace(heads, rotary_direction=direction).having(travel=travel)


MACHINES = [
    *map(Machine.load, ('xyzac', 'bc_trunnion', 'head_table', 'head_head')),
    slanted_head(),
]


def tools_past(machine, distance, angles):
    """Tool axes on a great circle that passes the pole at a distance [rad]."""
    transform = Transform.of(machine)
    pole = transform.pole * np.sign(transform.tool_axis(np.zeros((1, 2)))[0] @ transform.pole)
    side = np.cross(pole, [0.3, 1.0, 0.0])
    side /= np.linalg.norm(side)
    nearest = np.cos(distance) * pole + np.sin(distance) * np.cross(pole, side)
    angles = np.asarray(angles, float)[:, None]
    return np.cos(angles) * nearest + np.sin(angles) * side


def path_of(blocks, machine, batch=1000, **options):
    """Blocks to path and segments, their deviation counted by the builder."""
    transform = Transform.of(machine)
    smoother = PathSmoother(Settings(**options), traits_of(transform))
    builder = AxisPathBuilder(transform, HEIGHT, 1e-3)
    parts = [smoother.push(blocks[i : i + batch]) for i in range(0, len(blocks), batch)]
    paths, done = [], []
    for part in [*parts, smoother.finish()]:
        paths.append(builder.push(part))
        done.append(builder.done)
    path = AxisPath.join([piece for piece in paths if piece is not None])
    return path, PathSegments.concatenate([piece for piece in done if len(piece)]), builder


def line_past(machine, distance, tilt=20 * DEG, **columns):
    tips = [[-28 * MM, 0, 0], [28 * MM, 0, 0]]
    return blocks_of(tips, tools_past(machine, distance, [-tilt, tilt]), **columns)


def gaps_at_height(path, machine, tools, ends):
    """Distance of the tool from the programmed one at the same place of the tip, at height h."""
    s = np.linspace(0.0, path.s[-1], 40001)
    tip, axis = Transform.of(machine).forward(evaluate(path, s)[0])
    share = (tip[:, 0] - ends[0]) / (ends[1] - ends[0])
    theta = np.arccos(np.clip(tools[0] @ tools[1], -1, 1))
    programmed = (
        np.sin((1 - share) * theta)[:, None] * tools[0] + np.sin(share * theta)[:, None] * tools[1]
    ) / np.sin(theta)
    return HEIGHT * np.linalg.norm(axis - programmed, axis=1)


@pytest.mark.parametrize('distance', [0.0, 0.005, 0.01, 0.03])
@pytest.mark.parametrize('machine', MACHINES, ids=lambda machine: machine.name)
def test_line_that_passes_the_pole_within_its_tolerance_goes_through_it(machine, distance):
    """The tilt changes its sign, C hardly turns, and the deviation is smooth and as told."""
    blocks = line_past(machine, distance * DEG)
    path, segments, _ = path_of(blocks, machine)
    outer = 3 + Transform.of(machine).outer
    tilt, turn = path.q[:, 7 - outer], path.q[:, outer]
    gap = gaps_at_height(path, machine, blocks.axis, blocks.tip[[0, -1], 0])
    told = segments.deviation[:, 1].max()
    assert gap.max() <= told + 1e-12 and told <= TOLERANCE * (1 + 1e-9)
    assert gap.max() == pytest.approx(HEIGHT * distance * DEG, rel=0.01, abs=1e-8)
    assert gap[[0, -1]].max() < 1e-9
    assert tilt[0] * tilt[-1] < 0 and not path.stop[1:-1].any()
    straight = machine.name != 'head_head' or machine.rotary_direction[1, 2] == 0.0
    if straight:
        assert np.ptp(turn) < 3.0 * distance / 20.0 + 1e-9
    for order in range(4):
        left, right = path.cell_right[order, :-1], path.cell_left[order, 1:]
        size = np.abs(path.cell_left[order]).max(axis=0)
        rounding = 1e-11 * 100.0**order  # an axis that rests has nothing else
        assert (np.abs(left - right) <= 1e-6 * size + rounding).all()


@pytest.mark.parametrize('share', [0.3, 0.9])
def test_tip_stays_on_its_line_and_the_poses_are_those_of_the_axes(share):
    machine = MACHINES[0]
    blocks = line_past(machine, share * TOLERANCE / HEIGHT)
    path, _, _ = path_of(blocks, machine)
    tip, axis = Transform.of(machine).forward(path.q)
    assert np.abs(tip - path.tip).max() < 1e-12 and np.abs(axis - path.axis).max() < 1e-12
    middle = evaluate(path, np.linspace(0.0, path.s[-1], 5001))[0]
    tip, _ = Transform.of(machine).forward(middle)
    assert np.abs(tip[:, 1:]).max() < 1e-9


@pytest.mark.parametrize('count', [113, 1121])
def test_short_blocks_past_the_pole_are_proven(count, tmp_path, capsys):
    """1,120 blocks of 0.05 mm, which become a few spans; `check` said "wrong row number"."""
    lines = [
        f'GOTO/{x:.9f},0,0,{i:.12f},{j:.12f},{k:.12f}'
        for x, (i, j, k) in zip(
            np.linspace(0, 56, count),
            tools_past(MACHINES[0], 0.01 * DEG, np.linspace(-20, 20, count) * DEG),
        )
    ]
    (tmp_path / 'pass.apt').write_text('\n'.join([lines[0], 'FEDRAT/3000', *lines[1:]]))
    assert main(['plan', str(tmp_path / 'pass.apt'), '--out', str(tmp_path / 'plan')]) == 0
    assert main(['check', str(tmp_path / 'plan')]) == 0, capsys.readouterr().out


@pytest.mark.parametrize('seed', [0, 1, 4])
def test_the_axes_do_not_jump_where_segments_join(seed):
    """C turns by 9,000 rad/m and more. Lengths exact to 1e-14 m only would show as jerk."""
    path, _, _ = path_of(wandering(seed), MACHINES[0])
    assert np.abs(path.cell_left[1, :, 4]).max() > 8000.0
    jump = np.abs(path.cell_right[0, :-1] - path.cell_left[0, 1:])
    assert jump[:, :3].max() < 3e-14 and jump[:, 3:].max() < 3e-13


def test_line_out_of_reach_of_the_pole_passes_beside_it():
    machine = MACHINES[0]
    path, segments, _ = path_of(line_past(machine, 1.1 * TOLERANCE / HEIGHT), machine)
    assert np.ptp(path.q[:, 4]) > 175 * DEG and (path.q[:, 3] * path.q[0, 3] > 0).all()
    assert segments.deviation[:, 1].max() == 0.0


def wandering(seed, count=9):
    """Blocks of poses that lie on the pole, within the tolerance of it, or farther away."""
    rng = np.random.default_rng(seed)
    tilt = rng.choice([0.0, 1e-3, 0.03, 0.2, 20.0], count) * rng.uniform(0.3, 1.0, count) * DEG
    turn = rng.uniform(0.0, 2.0 * np.pi, count)
    axes = np.c_[np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
    steps = rng.uniform(-0.5, 0.5, (count, 3)) * [0.2, 1.0, 0.3] + [1.0, 0.0, 0.0]
    tips = np.cumsum(steps * rng.choice([0.8, 6.0, 25.0], (count, 1)), axis=0) * MM
    return blocks_of(tips - tips.mean(axis=0), axes)


@pytest.mark.parametrize('seed', range(6))
def test_poses_around_the_pole_are_no_stops_and_the_axes_run_smoothly(seed):
    machine = MACHINES[0]
    blocks = wandering(seed)
    path, segments, _ = path_of(blocks, machine)
    assert not path.stop[1:-1].any()
    assert (segments.deviation[:, 1] <= TOLERANCE * (1 + 1e-6)).all()
    for order in range(3):
        left, right = path.cell_right[order, :-1], path.cell_left[order, 1:]
        assert np.abs(left - right).max() <= 1e-6 * np.abs(path.cell_left[order]).max()
    tip, axis = Transform.of(machine).forward(path.q[[0, -1]])
    assert np.abs(tip - blocks.tip[[0, -1]]).max() < 1e-9
    assert np.abs(axis - blocks.axis[[0, -1]]).max() < 1e-9


@pytest.mark.parametrize('seed', few_of(4, range(4)))
def test_same_passages_however_the_blocks_arrive(seed):
    blocks = wandering(seed, 20)
    whole, of_whole, _ = path_of(blocks, MACHINES[0])
    pieces, of_pieces, _ = path_of(blocks, MACHINES[0], batch=2)
    assert np.array_equal(whole.cell_left, pieces.cell_left)
    assert np.array_equal(whole.s, pieces.s)
    assert np.array_equal(of_whole.deviation, of_pieces.deviation)


def test_upright_tool_is_not_held_back_for_ever():
    """A long 3-axis part on the pole comes out while it is pushed, up to a few centimetres."""
    machine = MACHINES[0]
    tips = np.c_[np.arange(60) * 4 * MM, np.zeros(60), np.zeros(60)] - [120 * MM, 0, 0]
    blocks = blocks_of(tips, [[0, 0, 1]] * 60)
    smoother = PathSmoother(Settings(compress=False), traits_of(Transform.of(machine)))
    path = AxisPathBuilder(Transform.of(machine), HEIGHT, 1e-3).push(smoother.push(blocks))
    assert path.s[-1] > 150 * MM


def test_after_an_upright_stop_the_outer_axis_turns_the_shorter_way():
    tilt, turn = np.array([20, 0, 20]) * DEG, np.array([30, 30, 110]) * DEG
    axes = np.c_[np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
    tips = np.arange(3)[:, None] * [30 * MM, 0.0, 0.0]
    path, _, _ = path_of(blocks_of(tips, axes, exact_stop=[False, True, False]), MACHINES[1])
    assert np.ptp(path.q[:, 4]) == pytest.approx(80 * DEG)


def test_travel_that_forbids_the_sign_of_the_tilt_turns_c_instead_without_a_stop():
    machine = MACHINES[0]
    travel = machine.travel.copy()
    travel[3] = [-5 * DEG, 120 * DEG]
    narrow = machine.having(travel=travel)
    for distance in (0.0, 0.01 * DEG):
        path, segments, builder = path_of(line_past(narrow, distance), narrow)
        assert path.q[:, 3].min() > -1 * DEG and np.ptp(path.q[:, 4]) > 150 * DEG
        assert not path.stop[1:-1].any() and builder.passages.forbidden == [2]
        assert segments.deviation[:, 1].max() <= TOLERANCE * (1 + 1e-9)


def named_start(machine, blocks, sign):
    """The same blocks; the start names the solution whose tilt has this sign."""
    transform = Transform.of(machine)
    pair = max(transform.rotary_solutions(blocks.axis[0]), key=lambda q: sign * q[0])
    rotary = np.full((len(blocks), 2), np.nan)
    rotary[0] = pair
    return replace(blocks, rotary=rotary)


def test_tilt_passes_the_pole_to_the_side_that_its_travel_allows():
    machine = MACHINES[0]
    travel = machine.travel.copy()
    travel[3] = [-10 * DEG, 110 * DEG]
    uneven = machine.having(travel=travel)
    tips = [[-28 * MM, 0, 0], [28 * MM, 0, 0]]
    tools = tools_past(machine, 0.01 * DEG, [-8 * DEG, 20 * DEG])
    path, _, builder = path_of(named_start(machine, blocks_of(tips, tools), -1), uneven)
    assert path.q[0, 3] < -7 * DEG and path.q[-1, 3] > 19 * DEG
    assert np.ptp(path.q[:, 4]) < 1 * DEG and not builder.passages.forbidden
    path, _, builder = path_of(named_start(machine, blocks_of(tips, tools), 1), uneven)
    assert path.q[:, 3].min() > -1 * DEG and np.ptp(path.q[:, 4]) > 150 * DEG
    assert builder.passages.forbidden == [2] and not path.stop[1:-1].any()
    # Beyond the travel without a pole between: refused, with axis and value.
    tools = tools_past(machine, 0.01 * DEG, [8 * DEG, 20 * DEG])
    with pytest.raises(TravelError, match=r'axis A would have to go to -20\.000 deg, outside'):
        path_of(named_start(machine, blocks_of(tips, tools), -1), uneven)


@pytest.mark.parametrize('end', ['A-20 C-1.57', 'A20 C178.4'])
def test_rotary_words_that_tool_directions_do_not_lead_to_are_refused(end):
    """The direction passes the pole at 0.25 deg: A stays positive. A-20 was taken as reached."""
    tilt = np.tan(20 * DEG)
    text = f"""TRAORI
        G0 X0 Y0 Z0 A20 C0
        G1 X56 A3=0.01 B3={-tilt:.9f} C3=1 F3000
        X60 {end}"""
    transform = Transform.of(MACHINES[0])
    program = read_text(text, 'words.mpf', transform, Settings())
    with pytest.raises(BlockError, match=r'rotary words ask for A-20.* reach A20.* C178') as found:
        plan_program(program, MACHINES[0])
    assert found.value.line_number == 4


def test_plan_says_why_the_motion_slows_down_at_the_pole(tmp_path, capsys):
    text = find_machine_file('xyzac').read_text()
    (tmp_path / 'narrow.yaml').write_text(text.replace('[-120.0, 120.0]', '[-5.0, 120.0]'))
    tools = tools_past(MACHINES[0], 0.0, [-20 * DEG, 20 * DEG])
    lines = [f'GOTO/{x},0,0,{i:.9f},{j:.9f},{k:.9f}' for x, (i, j, k) in zip((0, 56), tools)]
    (tmp_path / 'pass.apt').write_text('\n'.join([lines[0], 'FEDRAT/3000', lines[1]]))
    arguments = [str(tmp_path / 'pass.apt'), '--machine', str(tmp_path / 'narrow.yaml')]
    assert main(['plan', *arguments, '--out', str(tmp_path / 'plan')]) == 0
    told = capsys.readouterr().err
    assert 'line 3: the tool passes the pole, where A would change its sign' in told
    assert 'C makes half a turn instead' in told
