"""Native 5-axis B-splines: read, joined by the general connection, planned, proven."""

import json
from dataclasses import fields, replace
from itertools import pairwise
from math import comb
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import BSpline
from whole_plans import path_of, plan_program, write_plan

from cnc_interp.core import DEG, MM, BlockError, ProgramError, jet
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import read_text
from cnc_interp.program.blocks import Blocks
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.proof.programmed_path import _rows_reached, with_chords
from cnc_interp.proof.verify import verify_plan
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.native.joining import Jets, connected, line_jets, span_jets
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import LINE, SPLINE, PathSegments, spline_jets

MACHINE = Machine.load('xyzac')
TRANSFORM = Transform.of(MACHINE)
H = 30 * MM
FLANK = Path(__file__).parents[3] / 'shared' / 'data' / 'flank_path_2022.json'


def bezier(points, u):
    d = len(points) - 1
    return sum(comb(d, i) * u**i * (1 - u) ** (d - i) * points[i] for i in range(d + 1))


def read(text):
    return read_text(text, 'p.mpf', TRANSFORM, Settings())


def control_points(rng, count=8, step=6.0):
    """Control points of a gentle curve [mm], tilted off the pole, and the second points."""
    turn = np.cumsum(rng.uniform(-0.5, 0.5, count))
    tip = np.cumsum(step * np.c_[np.cos(turn), np.sin(turn), rng.uniform(-0.2, 0.2, count)], 0)
    lean = 0.35 + 0.08 * rng.uniform(-1, 1, (count, 2))
    tool = np.c_[lean, np.ones(count)]
    tool *= (20.0 / np.linalg.norm(tool, axis=1))[:, None]
    return tip - tip[0], tip - tip[0] + tool


def program(tip, top, intervals, before='', after='', feed=3000):
    """Write a program: G0 to the first control point, lines before, the curve, lines after."""

    def words(point, second):
        return 'X{:.9f} Y{:.9f} Z{:.9f} XH={:.9f} YH={:.9f} ZH={:.9f}'.format(*point, *second)

    lines = ['TRAORI', 'ORICURVE', f'F{feed}']
    lines += [before or f'G0 {words(tip[0], top[0])}', 'BSPLINE SD=3']
    for point, second, interval in zip(tip[1:], top[1:], intervals, strict=True):
        lines.append(f'{words(point, second)} PL={interval:g}')
    return '\n'.join([*lines, after, 'M30\n'])


def curve_of(blocks):
    """Evaluate the spline rows by SciPy: a function u -> (tip, top), and its last knot."""
    on = blocks.on_spline
    knots = np.concatenate([np.zeros(3), np.cumsum(blocks.knot_interval[on])])
    spline = BSpline(np.append(knots, knots[-1]), np.hstack([blocks.tip[on], blocks.top[on]]), 3)
    return spline, knots


def smoothed(blocks, batch=None, **options):
    smoother = PathSmoother(Settings(flank_height=H, **options), MachineTraits())
    step = batch or len(blocks)
    parts = [smoother.push(blocks[i : i + step]) for i in range(0, len(blocks), step)]
    parts = [part for part in [*parts, smoother.finish()] if len(part)]
    return PathSegments.concatenate(parts)


def jets_of(segments, i, at_end):
    """Jets of one segment's end: of splines by the kernels of the kinematics."""
    if segments.kind[i] == LINE:
        way = segments.bottom[i, 1] - segments.bottom[i, 0]
        length = np.linalg.norm(way)
        axis = turned_by(segments.axis[i], segments.rotation[i], 1.0 if at_end else 0.0)
        place = segments.bottom[i, 1 if at_end else 0]
        return line_jets(
            *(x[None] for x in (place, way / length, axis)), segments.rotation[i][None] / length
        )
    u = 1.0 if at_end else 0.0
    p, o = spline_jets(segments.bottom[i], segments.top[i], segments.connection[i], u)
    dp = [(c[1], 2 * c[2], 3 * c[3], 0.0) for c in p]
    speed = jet.square_root(jet.dot(tuple(dp), tuple(dp)))
    tip = np.array([jet.by_arc_length(c, speed) for c in p])
    axis = np.array([jet.by_arc_length(c, speed) for c in o])
    return Jets(tip.T[:, None], axis.T[:, None])


def largest_jumps(segments):
    """Jumps of p, p_s, p_ss and o, o_s, o_ss, o_sss at every join, relative to the largest."""
    count = len(segments)
    ends = [jets_of(segments, i, True) for i in range(count)]
    begins = [jets_of(segments, i, False) for i in range(count)]
    found = []
    for name, orders in (('tip', 3), ('axis', 4)):
        values = [np.stack([getattr(j, name)[:, 0] for j in side]) for side in (ends, begins)]
        gap = np.abs(values[0][:-1] - values[1][1:]).max(axis=2)
        size = np.maximum(*(np.abs(v).max(axis=(0, 2)) for v in values))
        found.append((gap / np.maximum(size, 1e-3))[:, :orders])
    return np.hstack(found)


def random_portions(rng, count=200):
    """Quintic Bezier curves in about one direction, the tool tilted."""
    bottom = 5 * MM * np.cumsum(rng.normal([0.2, 0, 0], 0.05, (count, 6, 3)), axis=1)
    top = bottom + H * (np.array([0.2, 0.1, 1.0]) + rng.normal(0, 0.01, (count, 6, 3)))
    return bottom, top


@pytest.mark.parametrize('points', [6, 8])
def test_general_connection_makes_any_two_portions_continuous(points):
    """Section 2.6: o, o_s, o_ss (o_sss with the septic) by the tip's arc length, and p to p_ss."""
    rng = np.random.default_rng(3)
    one, other = random_portions(rng), random_portions(rng)
    none = np.zeros((len(one[0]), points, 3))
    ends = span_jets(one[0][:, ::-1], one[1][:, ::-1], none).backwards()
    bottom = other[0] + (ends.tip[0] - other[0][:, 0])[:, None]
    top = other[1] - other[0][:, :1] + ends.tip[0][:, None]
    top += (bottom[:, 0] + 1.1 * H * ends.axis[0] - top[:, 0])[:, None]
    made = connected(bottom, top, ends, None, H, points)
    begins = span_jets(made.bottom, top, made.connection)
    for k in range(3):
        assert np.abs(begins.tip[k] - ends.tip[k]).max() < 1e-9 * np.abs(ends.tip[k]).max()
    for k in range(points // 2):
        assert np.abs(begins.axis[k] - ends.axis[k]).max() < 1e-9 * np.abs(ends.axis[k]).max()
    # the far end stays as it was
    for k in range(3):
        for was, now in zip(
            (lambda j: (j.tip[k], j.axis[k]))(span_jets(bottom[:, ::-1], top[:, ::-1], none)),
            (lambda j: (j.tip[k], j.axis[k]))(
                span_jets(made.bottom[:, ::-1], top[:, ::-1], made.connection[:, ::-1])
            ),
            strict=True,
        ):
            assert np.abs(was - now).max() <= 1e-9 * np.abs(was).max()
    for i in range(0, len(bottom), 20):  # the bounds bound
        for u in np.linspace(0, 1, 33):
            p0, p1 = bezier(bottom[i], u), bezier(made.bottom[i], u)
            t0 = bezier(top[i], u)
            tools = [t0 - p0, t0 + bezier(made.connection[i], u) - p1]
            o0, o1 = (tool / np.linalg.norm(tool) for tool in tools)
            gap = np.linalg.norm(p1 - p0), np.linalg.norm(p1 - p0 + H * (o1 - o0))
            assert (np.array(gap) <= made.deviation[i] + 1e-12).all()


def test_jets_are_those_of_the_kernels():
    rng = np.random.default_rng(4)
    bottom, top = random_portions(rng, 20)
    connection = rng.normal(0, 0.1 * MM, (20, 8, 3))
    connection[:, [0, -1]] = 0.0
    jets = span_jets(bottom, top, connection)
    segments = smoothed(read(program(*control_points(rng), [1] * 7)).blocks)
    for i in range(20):
        some = replace(
            segments[:1], bottom=bottom[i][None], top=top[i][None], connection=connection[i][None]
        )
        exact = jets_of(some, 0, at_end=False)
        for k in range(4):
            assert (
                np.abs(jets.tip[k, i] - exact.tip[k, 0]).max() < 1e-9 * np.abs(exact.tip[k]).max()
            )
            assert (
                np.abs(jets.axis[k, i] - exact.axis[k, 0]).max()
                < 1e-9 * np.abs(exact.axis[k]).max()
            )


@pytest.mark.parametrize('intervals', [[1] * 7, [0.3, 2, 1, 0.5, 4, 0, 0], [1, 2, 0, 3, 1, 9, 9]])
def test_segments_are_the_programmed_curve(intervals):
    tip, top = control_points(np.random.default_rng(1))
    blocks = read(program(tip, top, intervals)).blocks
    assert (blocks.knot_interval[-2:] == 0).all()  # the end is clamped whatever PL says there
    spline, knots = curve_of(blocks)
    segments = smoothed(blocks)
    assert (segments.kind == SPLINE).all()
    breaks = np.unique(knots)
    if len(segments) == len(breaks) - 1:
        for i, (a, b) in enumerate(pairwise(breaks)):
            for u in np.linspace(0, 1, 7):
                both = spline(min(a + u * (b - a), breaks[-1] * (1 - 1e-16)))
                assert np.abs(bezier(segments.bottom[i], u) - both[:3]).max() < 1e-12
                assert np.abs(bezier(segments.top[i], u) - both[3:]).max() < 1e-12
    assert np.abs(segments.bottom[0, 0] - tip[0] * MM).max() < 1e-12
    assert np.abs(segments.bottom[-1, 5] - tip[-1] * MM).max() < 1e-12


def with_lines(rng, bend=0.0):
    """Line, curve, line; the lines leave the curve's tangents by an angle at random [rad]."""
    tip, top = control_points(rng)
    out = tip[0] - tip[1], tip[-1] - tip[-2]
    ends = []
    for at, way in ((0, out[0]), (-1, out[1])):
        way = 20.0 * way / np.linalg.norm(way) + 20.0 * bend * rng.normal(size=3)
        tool = top[at] - tip[at] + rng.normal(0, 0.5, 3)
        ends.append((tip[at] + way, tip[at] + way + tool))
    text = 'G0 X{:.9f} Y{:.9f} Z{:.9f} XH={:.9f} YH={:.9f} ZH={:.9f}\n'.format(
        *ends[0][0], *ends[0][1]
    ) + 'G1 X{:.9f} Y{:.9f} Z{:.9f} XH={:.9f} YH={:.9f} ZH={:.9f}'.format(*tip[0], *top[0])
    last = 'G1 X{:.9f} Y{:.9f} Z{:.9f} XH={:.9f} YH={:.9f} ZH={:.9f}'.format(
        *ends[1][0], *ends[1][1]
    )
    return program(tip, top, [1] * 5 + [0, 0], before=text, after=last)


@pytest.mark.parametrize('septic', [False, True])
@pytest.mark.parametrize('seed', range(6))
def test_lines_and_curves_flow_into_each_other(seed, septic):
    blocks = read(with_lines(np.random.default_rng(seed))).blocks
    segments = smoothed(blocks, septic=septic)
    assert segments.kind[0] == segments.kind[-1] == LINE
    assert not segments.stop[:-1].any()
    jumps = largest_jumps(segments)
    # Where walls twist against each other the join takes 0.1 mm: rounding of 1e-17 m shows there.
    assert jumps[:, :6].max() < 1e-8
    assert not septic or jumps[[0, -1], 6].max() < 1e-8
    assert (segments.deviation <= 0.5 * 0.02 * MM).all()


def test_true_corners_between_line_and_curve_are_exact_stops():
    blocks = read(with_lines(np.random.default_rng(2), bend=0.5)).blocks
    segments = smoothed(blocks)
    assert segments.stop[0] and segments.stop[-1]
    assert segments.stop.sum() == 3 and segments.kind[np.flatnonzero(segments.stop)[1]] == SPLINE


def test_repeated_knots_go_on_where_the_curve_does():
    """Three equal knots are a corner unless the control points lie on one line."""
    tip, top = control_points(np.random.default_rng(5))
    intervals = [1, 0, 0, 1, 0, 0]
    corner = read(program(tip[:7], top[:7], intervals)).blocks
    assert smoothed(corner).stop.tolist()[:-1].count(True) == 1
    tip[4], top[4] = 2 * tip[3] - tip[2], 2 * top[3] - top[2]
    smooth = smoothed(read(program(tip[:7], top[:7], intervals)).blocks)
    assert not smooth.stop[:-1].any()
    assert largest_jumps(smooth)[:, :6].max() < 1e-9


@pytest.mark.parametrize('batch', [1, 2, 3, 5])
def test_segments_do_not_depend_on_how_control_points_arrive(batch):
    for seed in range(3):
        blocks = read(with_lines(np.random.default_rng(seed))).blocks
        whole, pieces = smoothed(blocks), smoothed(blocks, batch)
        for field in fields(PathSegments):
            one, other = getattr(whole, field.name), getattr(pieces, field.name)
            assert one.tobytes() == other.tobytes(), field.name


def test_rotary_words_of_the_first_pose_choose_the_turns_of_a_spline():
    tip, top = control_points(np.random.default_rng(3))

    def q_of(first):
        blocks = read(program(tip, top, np.ones(len(tip) - 1), first)).blocks
        return path_of(blocks, TRANSFORM, Settings()).q

    plain = q_of('')
    words = zip('XYZAC', [*tip[0], *(plain[0, 3:] / DEG + [0.0, 360.0])], strict=True)
    turned = q_of('G0 ' + ' '.join(f'{name}{value:.9f}' for name, value in words))
    assert np.abs(turned - plain - [0.0, 0.0, 0.0, 0.0, 2.0 * np.pi]).max() < 1e-9


def test_rows_carry_line_feed_and_stop():
    tip, top = control_points(np.random.default_rng(1))
    text = program(tip, top, [1] * 7).replace('PL=1\n', 'PL=1 F1200\n', 1)
    text = text.replace('M30', 'M0\nG1 X0 Y0 Z0 XH=0 YH=5 ZH=20\nM30')
    blocks = read(text).blocks
    assert blocks.line_number[blocks.on_spline].tolist() == [6, *range(6, 13)]
    assert np.allclose(blocks.feedrate[2:9], 0.02)
    assert blocks.exact_stop[blocks.on_spline].tolist() == [False] * 7 + [True]
    segments = smoothed(blocks)
    spline = segments.kind == SPLINE
    assert segments.block[spline].tolist() == [[2, 2], [3, 3], [4, 4], [5, 5], [6, 8]]
    assert segments.line_number[spline].tolist() == [6, 7, 8, 9, 10]
    assert segments.stop[spline].tolist() == [False] * 4 + [True]


HEAD = 'TRAORI\nF600\nG0 X0 Y0 Z0 XH=0 YH=2 ZH=10\n'
POINTS = ''.join(f'X{5 * i} Y{i * i % 3} XH={5 * i}\n' for i in range(1, 6))


@pytest.mark.parametrize(
    ('text', 'line', 'word'),
    [
        (HEAD + 'BSPLINE SD=2\n' + POINTS, 4, 'only cubic'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5 PW=0.5\n', 5, 'PW=1'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5 PL=-1\n', 5, 'must not be negative'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5 PL=0\n', 5, 'first interval'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5 PL=1 PL=2\n', 5, 'written twice'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5\nX9 XH=9\nG1 X20\n', 7, 'at least 4 control points'),
        (HEAD + 'BSPLINE SD=3\nX5 Y0 Z10 XH=5 YH=0 ZH=10\n', 5, 'a point above'),
        (HEAD + 'BSPLINE SD=3\nX5\nX9 XH=9 YH=0 ZH=10\n', 6, 'or in none'),
        (HEAD + 'BSPLINE SD=3\nX0 Y0 Z0 XH=5 YH=0 ZH=10\n', 5, 'differs from that of the tool'),
        (HEAD + 'BSPLINE SD=3\nX5 XH=5 A10\n', 5, 'rotary words in a spline'),
        (HEAD + 'G1 X5 PL=1\n', 4, 'write BSPLINE first'),
        (HEAD + 'G93\nBSPLINE SD=3\n', 5, 'G93'),
        ('TRAORI\nBSPLINE SD=3\n', 2, 'move there first'),
        ('F600\nG0 X0 Y0 Z0\nBSPLINE SD=3\n', 3, 'TRAORI'),
        ('G0 X0 XH=0 YH=2 ZH=10\n', 1, 'TRAORI'),
        (
            HEAD + 'BSPLINE SD=3\nX5 XH=5 PL=1\nX9 XH=9 PL=0\nX12 XH=12 PL=0\nX14 XH=14 PL=0\n'
            'X16 XH=16 PL=1\nX18 XH=18\nX20 XH=20\n',
            9,
            'interrupt the spline',
        ),
        (HEAD + 'BSPLINE SD=3\n' + POINTS.replace('\n', ' PL=1\n', 2), None, None),
    ],
)
def test_faulty_programs_are_refused_by_line(text, line, word):
    if line is None:
        assert read(text).blocks.on_spline.sum() == 6
        return
    with pytest.raises(ProgramError, match=word) as caught:
        read(text)
    assert caught.value.line_number == line


def test_splines_without_second_points_keep_the_tool_axis():
    blocks = read(
        'TRAORI\nF600\nG0 X0 Y0 Z0 A20 C30\nBSPLINE SD=3\nX5 Y1\nX9 Y2\nX12 Y5\nX14 Y9\n'
        'G1 X20 A20 C31\nM30\n'
    ).blocks
    after = np.flatnonzero(blocks.on_spline)[-1] + 1
    assert np.abs(blocks.axis[:after] - blocks.axis[0]).max() < 1e-15
    # the rotary axes run on from where the curve has left them
    assert np.allclose(np.degrees(blocks.rotary[after:, 0]), 20.0, atol=1e-9)
    assert (np.degrees(blocks.rotary[after:, 1]) > 30.0).all()


def test_curves_that_are_none_are_refused_in_the_stream_too():
    tip, top = control_points(np.random.default_rng(1))
    blocks = read(program(tip, top, [1] * 7)).blocks
    columns = {field.name: getattr(blocks, field.name) for field in fields(Blocks)}

    def changed(**values):
        return Blocks(**{**columns, **values})

    moved = blocks.tip.copy()
    moved[:1] += MM
    still = blocks.tip.copy()
    still[1:6] = still[1]
    torn = blocks.knot_interval.copy()
    torn[3:6] = 0.0
    open_end = blocks.knot_interval.copy()
    open_end[-1] = 1.0
    for bad, word in (
        (changed(tip=moved), 'does not begin where the tool is'),
        (changed(tip=still, top=blocks.top - blocks.tip + still), 'rests in a part of this'),
        (changed(knot_interval=torn), 'interrupt the spline'),
        (changed(knot_interval=open_end), 'last two knot intervals'),
        (blocks[:4], 'at least 4 control points'),
    ):
        with pytest.raises(BlockError, match=word):
            smoothed(bad)


def test_line_curve_line_is_planned_without_rest_and_proven(tmp_path):
    plan = plan_program(read(with_lines(np.random.default_rng(1))), MACHINE)
    write_plan(plan, tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.text()
    assert np.load(tmp_path / 'path.npz')['stop'].sum() == 2


@pytest.mark.parametrize(
    ('feed', 'rise'), [(600, 0.0025), (60_000, 0.5)], ids=['slow and flat', 'fast and bent']
)
def test_proof_follows_any_curve(feed, rise, tmp_path):
    # A flat curve's chords lie further apart than samples; at speed the first sample, and the
    # first point of the path, lie deep inside the curve.
    text = f"""TRAORI
G0 X0 Y0 Z0 XH=0 YH=0 ZH=30
G1 X30 F{feed} XH=30
BSPLINE SD=3 X32 XH=32 PL=1
X36 XH=36 PL=1
X40 Y{4 * rise} XH=40 YH={4 * rise} PL=0
X42 Y{6 * rise} XH=42 YH={6 * rise} PL=0
G1 X72 Y{36 * rise} XH=72 YH={36 * rise}
M30
"""
    write_plan(plan_program(read(text), MACHINE), tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.text()
    plan = read_plan(tmp_path).in_memory()
    chords = with_chords(plan, MACHINE).in_memory()
    tips, reached = chords.blocks['tip'], chords.block
    longest = np.linalg.norm(np.diff(tips[2:-1], axis=0), axis=1).max()
    curve = (reached >= 2) & (reached < len(tips) - 1)
    assert curve.any()
    gaps = TRANSFORM.forward(plan.position[curve])[0] - tips[reached[curve]]
    assert np.linalg.norm(gaps, axis=1).max() < longest


@pytest.mark.parametrize('what', ['tip', 'top'])
def test_proof_sees_a_path_off_the_curve(tmp_path, what):
    plan = plan_program(read(with_lines(np.random.default_rng(1))), MACHINE)
    write_plan(plan, tmp_path)
    file = tmp_path / 'blocks.npz'
    columns = dict(np.load(file))
    columns[what][5] += 0.1 * MM  # one control point other than executed
    np.savez(file, **columns)
    proof = verify_plan(tmp_path, MACHINE)
    word = 'contour deviation' if what == 'tip' else 'orientation deviation'
    assert not proof.ok and any(word in failure for failure in proof.failures)


@pytest.mark.skipif(not FLANK.is_file(), reason='no shared data beside the repository')
def test_published_flank_path_is_planned_and_proven(tmp_path):
    data = json.loads(FLANK.read_text())
    knots = np.array(data['knots'])
    text = program(
        np.array(data['control_points_bottom']),
        np.array(data['control_points_top']),
        knots[4:11] - knots[3:10],
    )
    plan = plan_program(read(text), MACHINE)
    write_plan(plan, tmp_path)
    proof = verify_plan(tmp_path, MACHINE)
    assert proof.ok, proof.text()
    # the curve of the publication, evaluated by SciPy, is where the tool went
    spline = BSpline(knots, data['control_points_bottom'], 3)
    curve = spline(np.linspace(0, 1, 200001)) * MM
    way = np.linalg.norm(np.diff(curve, axis=0), axis=1).sum()
    assert plan.setpoints.s[-1] == pytest.approx(way, rel=1e-6)


def test_poses_on_a_curve_that_comes_back_are_no_farther_than_they_moved():
    """There and back on one line: the nearest row of all would be a row of the way back."""
    x = np.r_[np.arange(11), np.arange(9, -1, -1)] * MM
    curve = np.c_[x, np.zeros((21, 5))]
    poses = np.c_[np.array([1.1, 3.2, 6.9, 9.8, 7.1, 0.2, 0.1]) * MM, np.zeros((7, 5))]
    moved = np.array([1.1, 2.1, 3.7, 2.9, 3.2, 6.9, 0.1]) * MM
    assert _rows_reached(curve, poses, moved, 0).tolist() == [1, 3, 7, 10, 13, 20, 20]
