"""A run from a line: the path is that of the full run, and so is the motion from the next rest."""

from pathlib import Path

import numpy as np
import pytest

from cnc_interp.core import InterpError, ProgramError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import ProgramStream, read_text
from cnc_interp.program.text.source import Source
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.program_again import compare_with_text
from cnc_interp.proof.verify import verify
from cnc_interp.run.path_chain import PathChain
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.run.start_place import StartFinder, approach, approach_inside, way_inside
from cnc_interp.settings.options import Settings

XYZAC = Machine.load('xyzac')
BC = Machine.load('xyzbc')
#: Corners, a rest in the middle (line 7), a dense curve (lines 9 to 88), an arc.
PROGRAM = (
    'G21 G90 G64 P0.02\nTRAORI\nG0 X0 Y0 Z0 A10 C20\nG1 X20 Y0 A15 C40 F3000\n'
    'X20 Y20 A5 C60\nX0 Y20\nG9 X0 Y0\nX10 Y-10\n'
    + ''.join(
        f'X{10 + 20 * np.sin(k / 40):.4f} Y{-10 - k / 4:.4f} A{5 + k / 20:.3f}\n'
        for k in range(1, 81)
    )
    + 'X60\nG2 X70 Y-20 I0 J10\nG1 X0 Y0\nM30\n'
)


def planned(folder, text=PROGRAM, machine=XYZAC, **choices):
    settings = Settings(**choices)
    source = Source.of_text(text, '<text>')
    stream = ProgramStream(source, Transform.of(machine), settings)
    plan_to_files(stream, machine, folder, settings)
    return read_plan(folder).in_memory()


@pytest.fixture(scope='module')
def whole(tmp_path_factory):
    return planned(tmp_path_factory.mktemp('whole'))


@pytest.mark.parametrize('line', [5, 6, 8, 30, 61, 90])
def test_path_and_motion_are_those_of_the_full_run(tmp_path, whole, line):
    inside = planned(tmp_path, from_line=line)
    start = inside.summary['start']
    assert start['first_line'] == line and verify(inside, XYZAC).ok

    # The setpoints: each one lies on the path of the full run.
    where = inside.setpoints['s']
    expected = np.column_stack(
        [on_path(whole.path, where, axis) for axis in range(inside.position.shape[1])]
    )
    assert np.abs(inside.position - expected).max() < 1e-9

    # The law joins that of the full run: the same speed at the same place after a while.
    speed, ours = np.gradient(whole.setpoints['s']), np.gradient(where)
    there = np.interp(where, whole.setpoints['s'], speed)
    apart = np.flatnonzero(np.abs(ours - there) > 1e-3 * there.max() + 1e-9)
    assert where[apart].max(initial=0.0) - where[0] < 0.02


def on_path(path, s, axis):
    """Evaluate one axis of the septics of a plan's path by Hermite's conditions, shape (K,)."""
    cell = np.clip(np.searchsorted(path['s'], s, side='right') - 1, 0, len(path['s']) - 2)
    h = np.diff(path['s'])[cell]
    u = (s - path['s'][cell]) / h
    found = np.zeros(len(s))
    powers = h[:, None] ** np.arange(4)
    left = path['cell_left'][:, cell, axis].T * powers
    right = path['cell_right'][:, cell, axis].T * powers
    for k in range(4):
        found += left[:, k] * hermite(k)(u) + right[:, k] * (-1) ** k * hermite(k)(1.0 - u)
    return found


def hermite(k):
    """Return the septic with k-th derivative 1 at 0, and all others up to the third 0 at 0, 1."""
    rows = np.zeros((8, 8))
    for j in range(4):
        rows[j, j] = np.prod(np.arange(1, j + 1))
        for n in range(j, 8):
            rows[4 + j, n] = np.prod(np.arange(n - j + 1, n + 1))
    return np.polynomial.Polynomial(np.linalg.solve(rows, np.eye(8)[k]))


@pytest.mark.parametrize('line', [5, 6, 8, 30, 61, 90])
def test_the_path_from_there_on_has_the_bits_of_the_full_path(line):
    settings, transform = Settings(from_line=line), Transform.of(XYZAC)
    stream = ProgramStream(Source.of_text(PROGRAM, '<text>'), transform, settings)
    finder, chain = (
        StartFinder(transform, settings.flank_height, stream.start),
        PathChain(transform, settings),
    )
    parts, executed = [], []
    for blocks in stream:
        finder.blocks(blocks)
        parts.append(chain.push(blocks).path)
        executed.append(finder.path(parts[-1]))
    parts.append(chain.finish().path)
    executed.append(finder.path(parts[-1], last=True))
    whole, inside = (
        AxisPath.join([p for p in found if p is not None]) for found in (parts, executed)
    )
    after = np.flatnonzero(whole.s > inside.s[0])
    count = len(after)
    assert count > 10 and np.array_equal(inside.s[-count:], whole.s[after])
    for name in ('cell_left', 'cell_right'):
        ours, full = getattr(inside, name), getattr(whole, name)
        assert np.array_equal(ours[:, 1 - count :], full[:, 1 - count :])
    tip, axis = transform.forward(inside.q[:1])
    row = finder.found().block.row
    vertex = read_text(PROGRAM, '<text>', transform, Settings()).blocks[row - 1 : row]
    assert np.linalg.norm(tip - vertex.tip) <= vertex.contour_tolerance[0]
    off = settings.flank_height * np.linalg.norm(axis - vertex.axis)
    assert off <= vertex.orientation_tolerance[0]


def test_from_the_next_rest_on_the_motion_is_the_same(tmp_path, whole):
    inside = planned(tmp_path, from_line=6)
    rest = whole.path['s'][1:-1][whole.path['stop'][1:-1]][0]
    laws = []
    for plan in (inside, whole):
        s = np.asarray(plan.path['s'])
        after = s >= rest
        laws.append((s[after], np.asarray(plan.path['feed'])[after]))
    assert np.array_equal(laws[0][0], laws[1][0]) and np.array_equal(laws[0][1], laws[1][1])


def test_inside_a_native_spline_the_start_is_refused(tmp_path):
    text = (
        'TRAORI\nORICURVE\nG1 X5 Y0 Z0 XH=0 YH=0 ZH=15 F3000\nBSPLINE SD=3\n'
        'X-10 Y20 Z0 XH=-15 YH=20 ZH=15 PL=0.2\nX10 Y20 Z0 XH=5 YH=25 ZH=15 PL=0.2\n'
        'X20 Y30 Z0 XH=15 YH=35 ZH=15 PL=0.2\nX30 Y30 Z0 XH=30 YH=35 ZH=15 PL=0\n'
        'G1 X40 Y30 Z0 XH=40 YH=35 ZH=15\nM30\n'
    )
    with pytest.raises(ProgramError, match='inside the spline that begins in line'):
        planned(tmp_path / 'a', text, from_line=7)
    assert verify(planned(tmp_path / 'b', text, from_line=9), XYZAC).ok


def test_a_second_reader_is_not_asked_about_a_part_of_the_program(tmp_path):
    program = tmp_path / 'p.ngc'
    program.write_text(PROGRAM, encoding='utf-8')
    with pytest.raises(InterpError, match='compare a plan from its top'):
        compare_with_text(planned(tmp_path / 'plan', from_line=5), XYZAC, Path(program))


@pytest.mark.parametrize('machine', [XYZAC, BC, Machine.load('bc_trunnion')])
def test_the_approach_leaves_and_comes_along_the_tool(machine):
    transform, random = Transform.of(machine), np.random.default_rng(7)
    for _ in range(50):
        size = np.array([0.05, 0.05, 0.05, 0.3, 0.3])
        stands, place = random.uniform(-size, size), random.uniform(-size, size)
        points = way_inside(transform, stands, place, 0.01)
        low, high = machine.travel.T
        assert ((points >= low - 1e-9) & (points <= high + 1e-9)).all()
        for first, last in ((0, 1), (2, 3), (3, 4)):
            tip, axis = transform.forward(points[[first, last]])
            way, sign = tip[1] - tip[0], 1.0 if first == 0 else -1.0
            assert np.abs(axis[0] - axis[1]).max() < 1e-12
            assert np.allclose(way, sign * np.linalg.norm(way) * axis[0], atol=1e-12)
        path = approach_inside(transform, 0.03, stands, place, 0.01, 0.008)
        assert isinstance(path, AxisPath) and path.s[-1] == 0.0 and path.stop.all()
        assert np.array_equal(path.q[-1], place) and path.cell_feed[-1] == 0.008


def test_a_tool_that_keeps_its_direction_is_positioned_above_both_ends():
    transform = Transform.of(XYZAC)
    low, high = np.array([0.0, 0.0, 0.0, 0.0, 0.0]), np.array([0.1, 0.0, 0.05, 0.0, 0.0])
    for a, b in ((low, high), (high, low)):
        points = way_inside(transform, a, b, 0.01)
        assert points[1, 2] == points[2, 2] == pytest.approx(0.06)


@pytest.mark.parametrize('exponent', range(-17, -5))
def test_a_machine_that_stands_at_the_start_but_for_rounding_can_run(exponent):
    """Ways of some 1e-11 m or rad were refused: no motion within the axis limits."""
    transform = Transform.of(Machine.load('xyzac'))
    limits = limits_at(transform.machine, 1e-3)
    there = np.array([0.0123, -0.0456, 0.0314, -0.7, 1.9])
    for axes in ([1, 0, 0, 0, 0], [0, 0, 0, 1, 0], [0.3, -1, 0.2, 0, 0.5]):
        stands = there + 10.0**exponent * np.array(axes)
        for way in (
            approach(transform, 0.03, stands, there),
            approach_inside(transform, 0.03, stands, there, 0.05, 0.01),
        ):
            if way is not None:
                piece = plan_path(way, limits)
                assert np.abs(piece.path.cell_right[0, -1] - there).max() < 1e-8
