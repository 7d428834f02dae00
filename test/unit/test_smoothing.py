"""Corners and look-ahead: tolerances, continuity and special cases, by independent geometry."""

from dataclasses import fields
from functools import partial

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from programs import blocks_of, pyramid, zigzag
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation
from tiers import examples

from cnc_interp.core import DEG, MM, BlockError, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import MachineTraits, jerk_rates
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.connection import Curves, lacking, matching_slopes, poses
from cnc_interp.smoothing.corners.vertices import SWIVEL
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.segments import (
    CORNER,
    LINE,
    ROTATION,
    PathSegments,
    corner_jets,
    line_jets,
)

AXIS_RATES = partial(jerk_rates, Transform.of(Machine.load('xyzac')))
KNOTS = [0, 0, 0, 0, 0.5, 1, 1, 1, 1]
HEIGHT = 30 * MM


def lookahead_of(**options):
    """A look-ahead that makes no curves; options are settings or traits of the machine."""
    names = {field.name for field in fields(MachineTraits)}
    traits = {name: options.pop(name) for name in names & options.keys()}
    settings = Settings(flank_height=HEIGHT, compress=False, **options)
    return LookAhead(settings, MachineTraits(**traits))


def smooth(blocks, **options):
    """All segments of some blocks, corner by corner."""
    lookahead = lookahead_of(**options)
    return PathSegments.concatenate([lookahead.push(blocks), lookahead.finish()])


def curves(segments, i):
    """The four curves of a corner."""
    names = ('bottom', 'top', 'connection', 'parametrization')
    return tuple(getattr(segments, name)[i] for name in names)


def jets(segments, i, u, late):
    """Tip, axis and their u-derivatives of one segment, shape (2, 4, 3)."""
    if segments.kind[i] == CORNER:
        pair = corner_jets(*curves(segments, i), u, 0.75 if late else 0.25)
    else:
        pair = line_jets(segments.bottom[i], segments.axis[i], segments.rotation[i], u)
    factorial = np.array([1, 1, 2, 6])
    return np.array([[np.array(c) * factorial for c in vector] for vector in pair]).swapaxes(1, 2)


def by_length(pair):
    """Value, first and second derivative by tip arc length of tip and axis, shape (2, 3, 3)."""
    speed = np.linalg.norm(pair[0, 1])
    slope = pair[0, 1] @ pair[0, 2] / speed
    first = pair[:, 1] / speed
    second = (pair[:, 2] - first * slope) / speed**2
    return np.stack([pair[:, 0], first, second], axis=1)


def jumps(segments):
    """
    Jumps of value, first and second derivative at joins, relative to the corner's own.

    Coordinates carry rounding of their own: 1e-16 m, and 1e-14 of the axis over the corner's size.
    """
    worst = np.zeros(3)
    for i in range(len(segments) - 1):
        if segments.stop[i] or ROTATION in segments.kind[i : i + 2]:
            continue
        before = by_length(jets(segments, i, 1.0, True))
        after = by_length(jets(segments, i + 1, 0.0, False))
        corner = i if segments.kind[i] == CORNER else i + 1
        size = np.linalg.norm(segments.bottom[corner][2] - segments.bottom[corner][0])
        swing = max(np.linalg.norm(before[1, 1]), np.linalg.norm(after[1, 1])) * size
        for order in range(3):
            tip_gap, axis_gap = np.abs(after[:, order] - before[:, order]).max(axis=1)
            tip_gap = max(tip_gap - 1e-16, 0.0) * size ** (order - 1)
            axis_gap = max(axis_gap * size**order - 1e-14, 0.0) / max(swing, 1e-300)
            worst[order] = max(worst[order], tip_gap, axis_gap)
    return worst


def test_corner_is_the_cubic_b_spline_of_eq_1():
    segments = smooth(pyramid())
    i = int(np.flatnonzero(segments.kind == CORNER)[0])
    curve = BSpline(KNOTS, segments.bottom[i], 3)
    for u in (0.0, 0.2, 0.4999, 0.5001, 0.77, 1.0):
        pair = jets(segments, i, u, u > 0.5)
        for order in range(4):
            assert np.allclose(pair[0, order], curve(u, order), rtol=1e-9, atol=1e-12)
    for u in (0.1, 0.5, 0.9):
        tip, tool = (rows[0] for rows in poses(Curves(*(c[None] for c in curves(segments, i))), u))
        pair = jets(segments, i, u, u > 0.5)
        assert np.allclose(tip, pair[0, 0]) and np.allclose(tool, pair[1, 0])


def test_eq_3_contour_error_of_a_plane_corner():
    """eps = L1 cos(alpha/2) / 2 uses the whole tolerance where the lines are long."""
    for turn in (10, 60, 90, 130):
        far = [np.cos(turn * DEG) * 50 * MM, np.sin(turn * DEG) * 50 * MM, 0]
        segments = smooth(blocks_of([[-50 * MM, 0, 0], [0, 0, 0], far], [[0, 0, 1]] * 3))
        i = int(np.flatnonzero(segments.kind == CORNER)[0])
        l1 = np.linalg.norm(segments.bottom[i][1] - segments.bottom[i][2])
        eps = 0.5 * l1 * np.cos((180 - turn) / 2 * DEG)
        assert eps == pytest.approx(0.02 * MM, rel=1e-9)
        assert np.linalg.norm(BSpline(KNOTS, segments.bottom[i], 3)(0.5)) == pytest.approx(eps)
        assert segments.deviation[i, 0] == pytest.approx(eps)


@pytest.mark.parametrize('blocks', [pyramid(), pyramid(-1.0), zigzag(3), zigzag(4, step=0.5 * MM)])
@pytest.mark.parametrize('top', ['in_step', 'tolerance'])
@pytest.mark.parametrize('septic', [False, True])
def test_exact_connection_is_smooth_for_both_top_curves(blocks, top, septic):
    segments = smooth(blocks, top=top, septic=septic)
    assert jumps(segments).max() < 1e-9
    assert (segments.deviation <= 0.02 * MM * (1 + 1e-6)).all()
    i = int(np.flatnonzero(segments.kind == CORNER)[0])
    if top == 'tolerance':  # knots coincide: f(0.5) = 0.5
        middle = jets(segments, i, 0.5, False), jets(segments, i, 0.5, True)
        assert np.allclose(middle[0][1, :3], middle[1][1, :3], rtol=1e-6, atol=1e-6)


def third_by_length(pair):
    """Third derivative by tip arc length of tip and axis, shape (2, 3)."""
    p1, p2, p3 = pair[0, 1:]
    v = np.linalg.norm(p1)
    v1 = p1 @ p2 / v
    v2 = (p2 @ p2 + p1 @ p3 - v1 * v1) / v
    first = pair[:, 1] / v
    second = (pair[:, 2] - first * v1) / v**2
    return (pair[:, 3] - 3 * second * v * v1 - first * v2) / v**3


def test_septic_continues_the_third_derivative_of_the_axis():
    """Of the axis, whose third derivative by arc length the bottom curve alone would break."""
    for septic, most in ((True, 1e-8), (False, np.inf)):
        segments = smooth(pyramid(), septic=septic)
        worst = 0.0
        for i in np.flatnonzero(segments.kind == CORNER):
            before = third_by_length(jets(segments, i - 1, 1.0, True))[1]
            after = third_by_length(jets(segments, i, 0.0, False))[1]
            size = np.linalg.norm(segments.bottom[i][2] - segments.bottom[i][0])
            rate = np.linalg.norm(segments.rotation[i - 1]) / segments.length[i - 1]
            worst = max(worst, np.linalg.norm(after - before) * size**2 / rate)
        assert worst < most
        if not septic:
            assert worst > 1e-6


def test_paper_parametrization_removes_most_of_the_kink_that_linear_leaves():
    """Jump of o_s where the corners begin, with the paper's top curve [Fig. 6]."""
    kink = {}
    for name in ('linear', 'paper', 'exact'):
        segments = smooth(
            pyramid(tolerance=1 * MM), top='tolerance', parametrization=name, corner_ratio=1.4
        )
        gaps = []
        for i in np.flatnonzero(segments.kind == CORNER):
            if segments.kind[i - 1] != LINE:
                continue
            before = by_length(jets(segments, i - 1, 1.0, True))[1, 1]
            gaps.append(np.linalg.norm(before - by_length(jets(segments, i, 0.0, False))[1, 1]))
        kink[name] = max(gaps)
    assert kink['exact'] < 1e-9 < kink['paper'] < 0.2 * kink['linear']


def test_unknown_way_to_make_a_corner_is_refused():
    with pytest.raises(InterpError, match="'cubic' is unknown; choose auto or exact"):
        Settings(parametrization='cubic')


def programmed_poses(blocks, row, count=2000):
    """Tips and top points along the block that ends at a row."""
    shares = np.linspace(0.0, 1.0, count)[:, None]
    start = blocks.axis[row - 1].copy()
    turn = np.cross(start, blocks.axis[row])
    sine = np.linalg.norm(turn)
    if sine > 0:
        turn *= np.arctan2(sine, start @ blocks.axis[row]) / sine
    tips = (1 - shares) * blocks.tip[row - 1] + shares * blocks.tip[row]
    return tips, tips + HEIGHT * Rotation.from_rotvec(turn * shares).apply(start)


def distance(point, polyline):
    """Distance of a point from a dense polyline."""
    start, step = polyline[:-1], np.diff(polyline, axis=0)
    share = np.clip(((point - start) * step).sum(1) / (step**2).sum(1), 0, 1)
    return np.linalg.norm(start + share[:, None] * step - point, axis=1).min()


@pytest.mark.parametrize(
    'blocks', [pyramid(), zigzag(5), zigzag(6, step=1 * MM, tolerance=0.2 * MM)]
)
def test_deviations_are_bounds_within_tolerance_by_dense_sampling(blocks):
    segments = smooth(blocks)
    allowed = blocks.contour_tolerance[0] * (1 + 1e-6)
    assert segments.deviation.max() <= allowed
    for i in np.flatnonzero(segments.kind == CORNER):
        rows = segments.block[i]
        programmed = [programmed_poses(blocks, row) for row in rows]
        for u in np.linspace(0, 1, 41):
            tip, tool = jets(segments, i, u, u > 0.5)[:, 0]
            tip_gap = min(distance(tip, tips) for tips, _ in programmed)
            top_gap = min(distance(tip + HEIGHT * tool, tops) for _, tops in programmed)
            assert tip_gap <= segments.deviation[i, 0] + 1e-10
            assert top_gap <= segments.deviation[i, 1] + 1e-10


@settings(max_examples=examples(15, 150))
@given(
    turn=st.floats(1.0, 175.9),
    lengths=st.tuples(st.floats(-5.5, -0.5), st.floats(-5.5, -0.5)),
    swings=st.tuples(st.floats(0.0, 40.0), st.floats(0.0, 40.0)),
    ways=st.tuples(st.floats(0.0, 6.28), st.floats(0.0, 6.28)),
    tolerance=st.floats(-6.0, -2.4),
)
def test_any_corner_stays_in_tolerance_and_smooth(turn, lengths, swings, ways, tolerance):
    """Angles 1-176 deg, lengths 3 um - 0.3 m, rotations to 40 deg, tolerance 1 um - 4 mm."""
    a, b = 10.0 ** lengths[0], 10.0 ** lengths[1]
    assume(max(swings[0] * DEG / a, swings[1] * DEG / b) < 0.999 * SWIVEL)
    corner_axis = np.array([0.3, -0.2, 0.9])
    corner_axis /= np.linalg.norm(corner_axis)
    across = np.cross(corner_axis, [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    axes = [
        Rotation.from_rotvec(
            Rotation.from_rotvec(way * corner_axis).apply(across) * swing * DEG
        ).apply(corner_axis)
        for way, swing in zip(ways, swings, strict=True)
    ]
    far = b * np.array([np.cos(turn * DEG), np.sin(turn * DEG), 0.0])
    blocks = blocks_of(
        [[-a, 0, 0], [0, 0, 0], far], [axes[0], corner_axis, axes[1]], tolerance=10.0**tolerance
    )
    segments = smooth(blocks)
    corners = np.flatnonzero(segments.kind == CORNER)
    assert len(corners) == 1
    assert (segments.deviation[corners] <= 10.0**tolerance * (1 + 1e-6)).all()
    assert jumps(segments).max() < 1e-9


@pytest.mark.parametrize('options', [{}, {'axis_rates': AXIS_RATES}, {'corner_ratio': 1.75}])
def test_same_segments_however_the_blocks_arrive(options):
    blocks = zigzag(8, count=60, step=2 * MM)
    whole = smooth(blocks, **options)
    rng = np.random.default_rng(0)
    for _ in range(5):
        lookahead, parts, row = lookahead_of(**options), [], 0
        while row < len(blocks):
            count = int(rng.integers(1, 9))
            parts.append(lookahead.push(blocks[row : row + count]))
            row += count
        pieces = PathSegments.concatenate([*parts, lookahead.finish()])
        for name in ('kind', 'bottom', 'top', 'connection', 'axis', 'rotation', 'length', 'block'):
            assert np.array_equal(getattr(whole, name), getattr(pieces, name), equal_nan=True)


def test_collinear_blocks_pass_straight_through():
    tips = np.c_[np.linspace(0, 30 * MM, 4), np.zeros((4, 2))]
    lean = np.linspace(0.1, 0.4, 4)
    segments = smooth(blocks_of(tips, np.c_[np.sin(lean), np.zeros(4), np.cos(lean)]))
    assert (segments.kind == LINE).all()
    assert not segments.stop[:-1].any()


def test_change_of_rotation_rate_alone_gets_a_corner_in_orientation():
    tips = np.c_[[0.0, 10 * MM, 20 * MM], np.zeros((3, 2))]
    lean = np.array([0.1, 0.1, 0.3])
    segments = smooth(blocks_of(tips, np.c_[np.sin(lean), np.zeros(3), np.cos(lean)]))
    corner = np.flatnonzero(segments.kind == CORNER)
    assert len(corner) == 1
    assert np.abs(segments.bottom[corner][..., 1:]).max() == 0.0
    assert 0.0 < segments.deviation[corner[0], 1] <= 0.02 * MM * (1 + 1e-9)
    assert jumps(segments).max() < 1e-9


def test_reversal_and_exact_stop_rest_at_the_vertex():
    tips = np.array([[0, 0, 0], [10, 0, 0], [0, 0.1, 0], [0, 10, 0]]) * MM
    segments = smooth(blocks_of(tips, [[0, 0, 1]] * 4, exact_stop=[False, False, True, True]))
    assert (segments.kind == LINE).all() and segments.stop.all()
    assert np.array_equal(segments.bottom[:, 1], tips[1:])


def test_pure_rotation_rests_before_and_after():
    tips = np.array([[0, 0, 0], [10, 0, 0], [10, 0, 0], [20, 0, 0]]) * MM
    lean = np.array([0.2, 0.2, 0.5, 0.5])
    segments = smooth(blocks_of(tips, np.c_[np.sin(lean), np.zeros(4), np.cos(lean)]))
    assert list(segments.kind) == [LINE, ROTATION, LINE] and segments.stop.all()
    assert segments.length[1] == pytest.approx(HEIGHT * 0.3)
    assert np.isinf(segments.feed[1]).all()


@pytest.mark.parametrize('way, rests', [(1e-3, True), (0.014, True), (0.016, False)])
def test_a_tip_that_hardly_moves_under_a_rotation_rests_before_and_after(way, rests):
    """0.3 rad over 15 um are 20 rad/mm: rotary axes at 20 rev/min move the tip at 0.1 mm/s."""
    tips = np.array([[0, 0, 0], [10, 0, 0], [10, way, 0], [20, way, 0]]) * MM
    lean = np.array([0.2, 0.2, 0.5, 0.5])
    segments = smooth(blocks_of(tips, np.c_[np.sin(lean), np.zeros(4), np.cos(lean)]))
    assert segments.stop[:-1].all() if rests else not segments.stop[:-1].any()
    assert (list(segments.kind) == [LINE] * 3) == rests


@pytest.mark.parametrize('swing, sharpest', [(0.0, 178.0), (0.1, 176.0)])
def test_turns_up_to_almost_a_reversal_are_rounded(swing, sharpest):
    """Beyond, a stop is as fast; a tool axis that turns makes it so earlier."""
    for turn in (sharpest - 0.1, sharpest + 0.1):
        far = [10 * MM * np.cos(turn * DEG), 10 * MM * np.sin(turn * DEG), 0]
        axes = [[0, 0, 1], [0, 0, 1], [np.sin(swing), 0, np.cos(swing)]]
        segments = smooth(blocks_of([[-10 * MM, 0, 0], [0, 0, 0], far], axes))
        assert bool(segments.stop[0]) == (turn > sharpest)
        assert (segments.kind == CORNER).any() == (turn < sharpest)
        assert jumps(segments).max() < 1e-9 or turn > sharpest


def test_inverse_time_gives_length_over_duration():
    tips = np.array([[0, 0, 0], [10, 0, 0], [10, 5, 0]]) * MM
    nan = np.nan
    segments = smooth(
        blocks_of(tips, [[0, 0, 1]] * 3, duration=[nan, 0.5, 0.1], feedrate=[nan, nan, nan])
    )
    corner = np.flatnonzero(segments.kind == CORNER)[0]
    assert np.allclose(segments.feed[corner], [0.02, 0.05])


def test_short_left_over_goes_to_the_corners():
    """Two half-segment corners leave no sliver of line between them."""
    tips = np.array([[0, 0, 0], [10, 0, 0], [10, 0.05, 0], [20, 0.05, 0]]) * MM
    segments = smooth(blocks_of(tips, [[0, 0, 1]] * 4))
    assert list(segments.kind) == [LINE, CORNER, CORNER, LINE]
    assert np.allclose(segments.bottom[1][4], segments.bottom[2][0], atol=1e-15)


def test_vertex_on_the_pole_is_rounded_and_leaves_room_to_reach_it():
    """The curve passes the pole at most as far as it may still be moved."""
    tips = np.array([[0, 0, 0], [10, 0, 0], [10, 10, 0]]) * MM
    axes = [[0, 0.2, 1], [0, 0, 1], [0.2, 0, 1]]
    segments = smooth(blocks_of(tips, axes), pole=(0.0, 0.0, 1.0))
    assert list(segments.kind) == [LINE, CORNER, LINE] and not segments.stop[:-1].any()
    assert (segments.deviation[:, 1] + segments.room <= 0.02 * MM * (1.0 + 1e-9)).all()
    assert segments.deviation[1, 1] < 0.9 * segments.room[1]


def test_antiparallel_axes_are_refused_with_the_line():
    tips = np.array([[0, 0, 0], [10, 0, 0]]) * MM
    with pytest.raises(BlockError, match='line 2: the tool axis reverses'):
        smooth(blocks_of(tips, [[0, 0, 1], [0, 0, -1]]))


def test_slopes_that_match_leave_no_jump_along_the_top_curve_in_each_order():
    """What is left of each derivative of D is at right angles to C_top' [B2013, B.3-B.5]."""
    rng = np.random.default_rng(2)
    b, c, o = rng.normal(size=(3, 3, 20, 3))
    axis = rng.normal(size=(20, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    rho = rng.uniform(0.5, 2.0, (20, 1))
    f1, f2, f3 = (f[:, None] for f in matching_slopes(b, c, axis, o, rho))
    d = (
        c[0] * f1 - b[0],
        c[1] * f1**2 + c[0] * f2 - b[1],
        c[2] * f1**3 + 3.0 * c[1] * f1 * f2 + c[0] * f3 - b[2],
    )
    across = c[0] - (c[0] * axis).sum(axis=1)[:, None] * axis
    for rest in lacking(d, axis, o, rho):
        assert np.abs((rest * across).sum(axis=1)).max() < 1e-9 * np.abs(rest).max()
