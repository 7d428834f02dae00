"""L2/L1 chosen for each corner: what it is made of, and the machining time that it saves."""

from functools import partial

import numpy as np
import pytest
from programs import blocks_of, pyramid, zigzag
from scipy.spatial.transform import Rotation
from tiers import few_of
from whole_plans import path_of

from cnc_interp.core import DEG, MM, InterpError, cross
from cnc_interp.feedrate.planning_windows import FeedPlanner
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.machine_traits import MachineTraits, jerk_rates
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.corner_curve import LARGEST, LEAST, MOST, Corners, ratios_at
from cnc_interp.smoothing.lookahead import LookAhead
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import CORNER, PathSegments

HEIGHT = 30 * MM


def cycle_time(blocks, ratio, machine='xyzac'):
    """Time that the whole chain plans for some blocks."""
    transform = Transform.of(Machine.load(machine))
    planner = FeedPlanner(transform.machine)
    settings = Settings(corner_ratio=ratio, compress=False)
    pieces = planner.push(path_of(blocks, transform, settings))
    return (pieces + planner.finish())[-1].law.end_time


def used_ratios(blocks, axis_rates=None, **settings):
    """L2/L1 on both sides of the corners made of some blocks."""
    lookahead = LookAhead(Settings(flank_height=HEIGHT, **settings), MachineTraits(axis_rates))
    segments = PathSegments.concatenate([lookahead.push(blocks), lookahead.finish()])
    bottom = segments.bottom[segments.kind == CORNER]
    from_corner = np.linalg.norm(bottom - bottom[:, 2:3], axis=2)
    return from_corner[:, [0, 4]] / from_corner[:, [1, 3]]


def plane_turn(turn, **columns):
    """Two lines of 50 mm in a plane."""
    far = [50 * MM * np.cos(turn * DEG), 50 * MM * np.sin(turn * DEG), 0]
    return blocks_of([[-50 * MM, 0, 0], [0, 0, 0], far], [[0, 0, 1]] * 3, **columns)


@pytest.mark.parametrize('machine', ['xyzac', 'xyzbc'])
def test_axis_rates_are_differences_of_the_inverse_kinematics(machine):
    transform = Transform.of(Machine.load(machine))
    rng = np.random.default_rng(1)
    lean, way = rng.uniform(0.1, 1.0, 20), rng.uniform(0, 6.28, 20)
    axis = np.c_[np.sin(lean) * np.cos(way), np.sin(lean) * np.sin(way), np.cos(lean)]
    tip, step, turn = (
        rng.normal(0, 0.05, (20, 3)),
        rng.normal(size=(20, 3)),
        rng.normal(size=(20, 3)),
    )
    step /= np.linalg.norm(step, axis=1)[:, None]
    turn = 5.0 * cross(turn, axis)
    rates = jerk_rates(transform, tip, axis, step, turn) * transform.machine.max_jerk
    eps = 1e-6
    for i in range(20):
        q = []
        for x in (-eps, eps):
            o = turned_by(axis[i : i + 1], turn[i : i + 1], np.array([x]))[0]
            rotary = transform.rotary_solutions(o)[0]
            q.append(
                np.r_[transform.linear((tip[i] + x * step[i])[None], rotary[None])[0], rotary]
            )
        assert np.allclose((q[1] - q[0]) / (2 * eps), rates[i], rtol=1e-6, atol=1e-7)


def test_axis_rates_of_three_axes_are_the_direction():
    transform = Transform.of(Machine.load('xyz'))
    step = np.array([[0.6, 0.0, 0.8]])
    still = np.zeros((1, 3))
    rates = jerk_rates(transform, still, np.array([[0.0, 0.0, 1.0]]), step, still)
    assert np.allclose(rates * transform.machine.max_jerk, step)


def test_ratio_grows_with_the_turn_between_its_ends():
    for turn, expected in ((5, LEAST), (45, 1.35 + 0.65 * 2 * np.sin(22.5 * DEG)), (100, MOST)):
        assert used_ratios(plane_turn(turn)) == pytest.approx(expected)
    assert used_ratios(plane_turn(45), corner_ratio=1.75) == pytest.approx(1.75)


def test_longer_leg_where_the_axes_move_less_per_metre():
    blocks = blocks_of(
        [[-50 * MM, 0, 0], [0, 0, 0], [50 * MM, 0, 0]], [[0.2, 0, 1], [0.2, 0, 1], [3.0, 0, 1]]
    )
    rates = partial(jerk_rates, Transform.of(Machine.load('xyzac')))
    first, second = used_ratios(blocks, axis_rates=rates)[0]
    assert first > second
    assert first <= LARGEST * (1 + 1e-9)


def test_ratio_without_a_machine_does_not_depend_on_the_frame():
    blocks = zigzag(3, count=20)
    rotation = Rotation.from_rotvec([0.3, -1.0, 0.7]).as_matrix().T
    turned = blocks_of(blocks.tip @ rotation, blocks.axis @ rotation)
    assert np.allclose(used_ratios(blocks), used_ratios(turned), rtol=1e-6)


def test_ratio_is_known_where_the_axes_are_not():
    """At the pole C is undefined and its rate not finite."""
    transform = Transform.of(Machine.load('xyzac'))
    up, still = np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 2, 3))
    corners = Corners(
        np.zeros((1, 3)), up, np.array([[[-1.0, 0, 0], [0, 1.0, 0]]]), still, np.ones((1, 2))
    )
    rates = partial(jerk_rates, transform)
    assert not np.isfinite(rates(corners.tip, up, -corners.legs[:, 0], still[:, 0])).any()
    assert ratios_at(corners, HEIGHT, rates) == pytest.approx(MOST)


@pytest.mark.parametrize(
    'blocks',
    few_of(
        6,
        [
            plane_turn(40, tolerance=0.2 * MM),
            plane_turn(10),
            pyramid(),
            pyramid(-1.0),
            zigzag(1, count=8),
            zigzag(2, count=20, step=0.3 * MM),
        ],
    ),
    ids=['40 deg', '10 deg', 'pyramid', 'inward', 'long', 'short'],
)
def test_chosen_ratios_are_as_fast_as_the_best_fixed_one(blocks):
    fixed = min(cycle_time(blocks, ratio) for ratio in (1.5, 1.75, 2.0, 2.5))
    assert cycle_time(blocks, None) < 1.003 * fixed


@pytest.mark.thorough
def test_chosen_ratios_are_faster_where_corners_are_unlike():
    blocks = zigzag(1, count=40)
    fixed = min(cycle_time(blocks, ratio) for ratio in (1.5, 1.75, 2.0, 2.5))
    assert cycle_time(blocks, None) < 0.995 * fixed


@pytest.mark.parametrize('ratio', [1.0, 1.1, 5.0, float('nan')])
def test_ratio_out_of_range_is_refused(ratio):
    with pytest.raises(InterpError, match=r'is not between 1\.2 and 4'):
        Settings(corner_ratio=ratio)
