"""Two 5-axis portions joined by a parametrization spline: continuity by finite differences."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from whole_plans import plan_program, write_plan

from cnc_interp.commands.cli import main
from cnc_interp.convert.conversion import convert
from cnc_interp.convert.native_joins import Joins, linked
from cnc_interp.convert.native_splines import Portion
from cnc_interp.core import MM, UM, InterpError
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.native.joining import Jets

H = 30 * MM
MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
SPAN = np.array([0.0, 1.0, 0.0, 0.0])


def portions(seed, blend=1.0, bend=0.0):
    """
    Make two portions of one cubic span that meet with G2 on both curves, but at unlike speeds.

    ``blend`` is how many times faster the top curve of the second one runs than its bottom curve;
    ``bend`` turns its top curve away by an angle, so that it is not even G1.
    """
    rng = np.random.default_rng(seed)
    way = np.array([10.0, 0.0, 0.0]) * MM
    bottom = np.cumsum(way + rng.normal(0, 0.7 * MM, (4, 3)), axis=0)
    top = bottom + np.array([4.0, 6.0, 30.0]) * MM + rng.normal(0, 1.0 * MM, (4, 3))
    first = Portion(bottom, top, SPAN)
    second = []
    for points, speed in ((bottom, 1.0), (top, blend)):
        d1, d2 = 3 * (points[3] - points[2]), 6 * (points[3] - 2 * points[2] + points[1])
        across = np.cross(d1, rng.normal(size=3))
        if points is top:
            d1 = d1 + bend * across / np.linalg.norm(across) * np.linalg.norm(d1)
        # By its own parameter the curve is faster; along its length it is the same to G2.
        a, b = speed * d1, speed**2 * d2 + rng.uniform(-0.3, 0.3) * d1
        one = points[3] + a / 3
        two = 2 * one - points[3] + b / 6
        second.append(np.stack([points[3], one, two, 2 * two - one + rng.normal(0, MM, 3)]))
    return first, Portion(*second, SPAN)


def axis_by_length(pose, u, step):
    """o, o_s, o_ss at a place by one-sided differences over the arc length, from values alone."""
    at = u + step * np.arange(7)
    axis = pose(at)[1]
    fine = pose(np.linspace(at[0], at[-1], 6 * 200 + 1))[0]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(fine, axis=0), axis=1))])[::200]
    way *= np.sign(step)
    fit = np.linalg.solve(np.vander(way / way[-1], 7, increasing=True), axis)
    return fit[0], fit[1] / way[-1], 2.0 * fit[2] / way[-1] ** 2


def plainly(portion):
    """The poses of a portion with u_top = u_bottom."""

    def pose(u):
        both = portion.curve(u)
        tool = both[:, 3:] - both[:, :3]
        return both[:, :3], tool / np.linalg.norm(tool, axis=1)[:, None]

    return pose


@given(st.integers(0, 10**6), st.floats(0.85, 1.15), st.booleans())
@settings(max_examples=30)
def test_the_tool_axis_goes_on_where_both_curves_are_g2(seed, blend, septic):
    first, second = portions(seed, blend)
    try:
        made = linked(second, first.jets(True), None, H, septic=septic)
    except InterpError:
        assert abs(blend - 1.0) > 0.05  # septics overshoot sooner
        return
    before = axis_by_length(plainly(first), 1.0, -0.02)
    after = axis_by_length(made.poses, 0.0, 0.02)
    was = axis_by_length(plainly(second), 0.0, 0.02)
    gaps = [np.abs(one - other).max() for one, other in zip(before, after, strict=True)]
    jumps = [np.abs(one - other).max() for one, other in zip(before, was, strict=True)]
    assert gaps[0] < 1e-12 and gaps[1] < 1e-4 * (1.0 + jumps[1])  # per metre
    assert gaps[2] < 1.0 + 1e-3 * jumps[2]  # a curvature by differences over 0.2 mm
    assert abs(blend - 1.0) < 0.01 or jumps[1] > 0.1
    # the curves stay: tips are those of the bottom curve, tools end on the top curve
    u = np.linspace(0.0, 1.0, 101)
    tip, axis = made.poses(u)
    assert np.abs(tip - second.curve(u)[:, :3]).max() < 1e-16
    f = made.parametrization(u)
    assert (np.diff(f) > 0.0).all() and f[0] == 0.0 and abs(f[-1] - 1.0) < 1e-12
    # what is written for u_top = u_bottom is the same path
    written = plainly(made.written)(u)
    assert np.abs(written[0] - tip).max() < 1e-12
    assert H * np.linalg.norm(written[1] - axis, axis=1).max() < 1.1e-8


def test_no_other_parametrization_leaves_a_smaller_jump():
    """Where the top curve turns away, what is left of the jump is at right angles to it."""
    for seed in range(10):
        first, second = portions(seed, 1.05, bend=0.02)
        made = linked(second, first.jets(True), None, H)
        before = axis_by_length(plainly(first), 1.0, -0.02)[1]
        after = axis_by_length(made.poses, 0.0, 0.02)[1]
        was = axis_by_length(plainly(second), 0.0, 0.02)[1]
        left = np.linalg.norm(after - before)
        assert 1e-3 < left < np.linalg.norm(was - before)
        rate = second.curve(0.0, 1)[3:]
        axis = made.poses(np.zeros(1))[1][0]
        along = rate - (rate @ axis) * axis
        assert abs((after - before) @ along) < 1e-4 * left * np.linalg.norm(along)


def test_both_ends_of_a_portion_are_joined():
    first, middle = portions(3, 1.06)
    # The path after it is the path before it, mirrored: backwards the portion meets it likewise.
    back = Portion(middle.bottom[::-1], middle.top[::-1], SPAN)
    one = linked(middle, first.jets(True), None, H)
    other = linked(back, None, first.jets(True).backwards(), H)
    u = np.linspace(0.0, 1.0, 11)
    assert np.abs(1.0 - other.parametrization(1.0 - u) - one.parametrization(u)).max() < 1e-12
    both = linked(middle, first.jets(True), middle.jets(True), H)  # its own end goes on as it is
    assert np.abs(both.parametrization(u) - one.parametrization(u)).max() < 1e-9
    assert abs(both.parametrization(0.0, 1) - 1.0 / 1.06) < 1e-9


def test_a_tool_axis_that_turns_too_differently_is_refused():
    first, second = portions(1, 0.2)
    with pytest.raises(InterpError, match='no increasing'):
        linked(second, first.jets(True), None, H)


TWO = (Path(__file__).parents[2] / 'examples' / 'two_curves.mpf').read_text()


def poses_of(plan, count=4001):
    """Tip and point at flank height at equal shares of the path, and the number of stops."""
    path = AxisPath.join([piece.path for piece in plan.pieces])
    q = evaluate(path, np.linspace(path.s[0], path.s[-1], count))[0]
    tip, axis = TRANSFORM.forward(q)
    return np.hstack([tip, tip + H * axis]), int(path.stop.sum())


def test_a_program_of_two_curves_is_joined_written_read_back_and_proven(tmp_path, capsys):
    source, out = tmp_path / 'two.mpf', tmp_path / 'joined.mpf'
    source.write_text(TWO)
    words = ['--to', 'siemens-bspline', '--join', 'parametrization', '--out', str(out)]
    assert main(['convert', str(source), *words]) == 0
    told = capsys.readouterr()
    assert '2 curves joined by a parametrization spline' in told.out + told.err
    plan = plan_program(read_text(out.read_text(), 'p.mpf', TRANSFORM, Settings()), MACHINE)
    write_plan(plan, tmp_path / 'plan')
    proof = verify_plan(tmp_path / 'plan', MACHINE)
    assert proof.ok, proof.text()
    found, stops = poses_of(plan)
    assert stops == 2
    usual = plan_program(read_text(TWO, 'p.mpf', TRANSFORM, Settings()), MACHINE)
    assert plan.pieces[-1].law.end_time < 0.9 * usual.pieces[-1].law.end_time
    # Tool axes still end on the programmed top curves, wherever they slid to.
    given = read_text(TWO, 'p.mpf', TRANSFORM, Settings()).blocks
    rows = np.flatnonzero(given.on_spline)
    for part in (rows[:5], rows[4:]):
        points = np.hstack([given.tip[part], given.top[part]])
        curve = BSpline([0, 0, 0, 0, 0.5, 1, 1, 1, 1], points, 3)(np.linspace(0, 1, 4001))
        for both in curve[500:3501:500]:  # the ruling of the machine nearest to this tip
            k = int(np.linalg.norm(found[:, :3] - both[:3], axis=1).argmin())
            tip, tool = found[k, :3], (found[k, 3:] - found[k, :3]) / H
            way = curve[:, 3:] - tip
            beside = np.linalg.norm(way - (way @ tool)[:, None] * tool, axis=1)
            assert beside.min() < 5 * UM  # between samples
    assert main(['convert', str(source), '--to', 'gcode', '--join', 'parametrization']) == 2


@pytest.mark.parametrize('corner', ['paper', 'default'])
def test_corners_are_written_by_their_own_control_points(corner):
    """Section 4.1: 5 + 5 control points; read back, the motion is the same."""
    program = read_text(
        'TRAORI\nORIVECT\nG0 X0 Y0 Z0 A-12 C10\nG1 X30 A-15 C-30 F3000\nX34 Y25 A-20 C-75\n'
        'X5 Y27 A-14 C-100\nM30\n',
        'p.mpf',
        TRANSFORM,
        Settings(),
    )
    way = Settings(corner=corner, parametrization='linear')
    plan = plan_program(program, MACHINE, way)
    text = convert(program, MACHINE, way, 'siemens-bspline', 0.01 * UM).text
    assert text.count('BSPLINE') == 2 and text.count('PL=') == 8  # the first point is the tool's
    again = read_text(text, 'p.mpf', TRANSFORM, way)
    rows = np.flatnonzero(again.blocks.on_spline).reshape(2, 5)
    corners = np.flatnonzero(plan.segments.kind == plan.segments.kind.max())
    for at, i in zip(rows, corners, strict=True):
        assert np.abs(again.blocks.tip[at] - plan.segments.bottom[i, :5]).max() < 1e-12
        assert np.abs(again.blocks.top[at] - plan.segments.top[i, :5]).max() < 1e-12
    read_back = plan_program(again, MACHINE, way)
    (was, stops), (now, stops_now) = poses_of(plan), poses_of(read_back)
    assert np.abs(was - now).max() < 1e-11 and stops == stops_now
    times = [x.pieces[-1].law.end_time for x in (plan, read_back)]
    assert times[1] == pytest.approx(times[0], rel=3e-4)


def test_a_join_is_made_where_the_path_goes_straight_on_and_its_tool_axis_does_not():
    first, second = portions(0, blend=1.4)
    before, own = first.jets(at_end=True), second.jets(at_end=False)
    opened = Joins(H, UM, septic=False)._open
    assert opened(second, before, False) is before
    assert opened(second, own, False) is None and opened(second, None, False) is None
    tip = before.tip.copy()
    tip[1] = tip[1, :, [1, 2, 0]].T  # a corner of the tip, where the machine rests
    assert opened(second, Jets(tip, before.axis), False) is None
