"""The feed planner against ruckig, against itself, and against its limits."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from feedrate_paths import (
    XYZAC,
    Limits,
    first_axes,
    line_path,
    polyline_path,
    random_polyline,
    sampled_ratios,
    scaled,
)

from cnc_interp.feedrate.jerk_stage import plan
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import AxisPath, cut

ruckig = pytest.importorskip('ruckig')

CORNER = np.array([[0, 0, 0], [0.03, 0, 0], [0.03, 0.02, 0], [0.05, 0.02, 0.01]], dtype=float)


def stroke_time(length: float, feed: float) -> float:
    """Time of the time-optimal rest-to-rest stroke of the X axis."""
    inp, out = ruckig.InputParameter(1), ruckig.Trajectory(1)
    inp.current_position, inp.target_position = [0.0], [length]
    inp.max_velocity = [min(feed, XYZAC.max_velocity[0])]
    inp.max_acceleration, inp.max_jerk = [XYZAC.max_acceleration[0]], [XYZAC.max_jerk[0]]
    ruckig.Ruckig(1).calculate(inp, out)
    return float(out.duration)


def assert_within_limits(piece: PlannedPiece, limits: Limits, most: float = 1.0005) -> None:
    assert sampled_ratios(piece.path, piece.law, limits).max() <= most


def spiral(blocks: int, noise: float = 0.0) -> AxisPath:
    """Blocks of 0.5 mm along a circle, with as much noise as asked."""
    angle = np.arange(blocks) * 0.5e-3 / 0.03
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), 1e-3 * angle])
    points += noise * np.random.default_rng(1).normal(size=points.shape)
    return polyline_path(points, 0.05, cells=4, tolerance=1e-5, amplitude=0.5)


#: Length [m] and feed [m/s] of strokes; where they take longer than 20 s they are cruise only.
STROKES = [
    (length, feed)
    for length in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0, 10.0)
    for feed in (np.inf, 0.05, 0.001)
    if length / feed <= 20
]


@pytest.mark.parametrize(('length', 'feed'), STROKES)
@pytest.mark.parametrize('cells', [1, 7])
def test_strokes_take_the_time_of_ruckig(length, feed, cells):
    piece = plan_path(line_path(length, feed, cells), XYZAC)
    best = stroke_time(length, feed)
    assert best * (1 - 1e-6) <= piece.law.end_time <= best * 1.002
    assert_within_limits(piece, XYZAC)


@pytest.mark.parametrize('jerk', [1.0, 1000.0])
@pytest.mark.parametrize('length', [2e-13, 5.6e-12, 1e-10, 1e-8])
def test_what_is_left_a_hair_before_a_stop_is_planned(length, jerk):
    """A hold may end there; all takes less than a cell of the grid otherwise does."""
    path, limits = line_path(1.0), scaled(XYZAC, 1.0, 1000.0, jerk)
    orders = np.array([length, 1.0, 1.0, 1.0])[:, None, None]
    cells = orders * path.cell_left, orders * path.cell_right
    hair = replace(path, s=length * path.s, cell_left=cells[0], cell_right=cells[1])
    best = np.cbrt(32.0 * length / limits.max_jerk[0])
    assert best * (1 - 1e-6) <= plan_path(hair, limits).law.end_time <= best * 1.013


def test_slow_feed_on_a_short_stroke():
    """A window of the slow cruise once consisted of nothing but ramps."""
    piece = plan_path(line_path(1e-5, 1e-5), XYZAC)
    assert piece.law.end_time <= 1.002 * stroke_time(1e-5, 1e-5)


@pytest.mark.parametrize('seed', range(12))
def test_random_corners_keep_all_limits(seed):
    rng = np.random.default_rng(seed)
    points = random_polyline(rng, int(rng.integers(2, 9)))
    feed = 10 ** rng.uniform(-3, -0.5, len(points) - 1) if seed % 3 == 0 else np.inf
    n_axes = 3 if seed % 4 == 3 else 5
    limits = first_axes(XYZAC, n_axes)
    path = polyline_path(
        points, feed, cells=int(rng.integers(4, 12)), n_axes=n_axes, amplitude=rng.uniform(0, 1)
    )
    piece = plan_path(path, limits)
    assert_within_limits(piece, limits)
    assert np.all(np.diff(piece.law.time) > 0)
    t = np.arange(0, piece.law.end_time, 2e-3)
    _, s_dot, _, _ = piece.law.evaluate(t)
    feed_there = piece.path.cell_feed[piece.law.cell[piece.law.piece_at(t)]]
    assert np.all(s_dot <= feed_there * (1 + 1e-5))


def test_feed_steps_up_and_down_are_obeyed_at_the_border():
    feed = np.array([0.05, 0.0005, 0.08])
    path = polyline_path(CORNER, feed, amplitude=0.0)
    piece = plan_path(path, XYZAC)
    assert_within_limits(piece, XYZAC)
    ends = np.append(piece.law.s_dot[1:], 0.0)
    assert np.all(np.maximum(piece.law.s_dot, ends) <= piece.path.cell_feed * (1 + 1e-5))


def test_inner_stops_are_rests():
    path = polyline_path(CORNER, 0.05, stops=(1, 2))
    piece = plan_path(path, XYZAC)
    assert_within_limits(piece, XYZAC)
    at = np.searchsorted(piece.law.s, path.s[np.flatnonzero(path.stop)[1:-1]])
    np.testing.assert_array_equal(piece.law.s_dot[at], 0.0)
    np.testing.assert_array_equal(piece.law.s_ddot[at], 0.0)


def test_axes_that_never_move_and_rotary_only_moves():
    path = line_path(0.05, 0.05)
    left, right = path.cell_left.copy(), path.cell_right.copy()
    left[:, :, 4], right[:, :, 4] = left[:, :, 0] / 0.03, right[:, :, 0] / 0.03
    left[:, :, 0] = right[:, :, 0] = 0.0
    turn = AxisPath(
        path.s.copy(),
        left,
        right,
        path.tip.copy(),
        path.axis.copy(),
        np.full(len(path.s) - 1, np.inf),
        path.cell_block.copy(),
        path.stop.copy(),
    )
    piece = plan_path(turn, XYZAC)
    assert_within_limits(piece, XYZAC)
    assert sampled_ratios(piece.path, piece.law, XYZAC)[2, 4] > 0.9


def test_cells_of_every_length():
    points = np.zeros((9, 3))
    points[:, 0] = np.cumsum([0, 1e-7, 0.1, 3e-9, 1e-6, 2e-8, 1e-3, 5e-8, 0.05])
    piece = plan_path(polyline_path(points, 0.05, amplitude=0.0), XYZAC)
    assert_within_limits(piece, XYZAC)
    whole = polyline_path(points[[0, -1]], 0.05, amplitude=0.0)
    assert piece.law.end_time <= 1.001 * plan_path(whole, XYZAC).law.end_time


def test_leftover_cells_of_nanometres_between_corners():
    """Noise of 2 um on dense blocks leaves cells of 1e-9 m; the planner once gave up there."""
    piece = plan_path(spiral(120, 2e-6), XYZAC)
    assert_within_limits(piece, XYZAC)
    assert np.median(piece.law.s_dot) > 0.01


def test_steady_cruise_takes_few_cells():
    """Where the feed alone limits, longer cells lose nothing: the time is still ruckig's."""
    path = line_path(5.0, 0.05, 500)
    law = plan_path(path, XYZAC).law
    assert law.end_time <= 1.0003 * stroke_time(5.0, 0.05)
    assert len(law) < 5 * 500


def test_some_limit_is_always_at_work():
    piece = plan_path(polyline_path(CORNER, 0.05), XYZAC)
    law, path = piece.law, piece.path
    jets = path.cell_left[:, law.cell]
    v, a, j = law.s_dot[:, None], law.s_ddot[:, None], law.jerk[:, None]
    use = np.column_stack(
        [
            np.abs(jets[1] * v) / XYZAC.max_velocity,
            np.abs(jets[2] * v**2 + jets[1] * a) / XYZAC.max_acceleration,
            np.abs(jets[3] * v**3 + 3 * jets[2] * v * a + jets[1] * j) / XYZAC.max_jerk,
            law.s_dot / path.cell_feed,
        ]
    )
    busy = np.max(use, axis=1) > 0.95
    assert np.sum(law.duration[busy]) > 0.9 * law.end_time


def test_doubling_the_grid_gains_little():
    for seed in (1, 2, 7):
        path = polyline_path(random_polyline(np.random.default_rng(seed), 4), 0.08)
        table = XYZAC.table
        coarse, fine = plan(path, table), plan(path, table, options=PlanOptions().finer())
        assert coarse is not None and fine is not None
        assert coarse.duration.sum() <= 1.005 * fine.duration.sum()


def test_windows_lose_next_to_nothing():
    path = spiral(300)
    whole = plan(path, XYZAC.table)
    assert whole is not None
    piece = plan_path(path, XYZAC)
    assert_within_limits(piece, XYZAC)
    assert piece.law.end_time <= 1.001 * whole.duration.sum()


def test_the_same_bits_however_the_path_arrives():
    path = spiral(250)
    once = plan_path(path, XYZAC)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        at = np.unique(rng.integers(1, len(path.s) - 1, 40))
        borders = [0, *at.tolist(), len(path.s) - 1]
        planner = FeedPlanner(XYZAC)
        pieces = []
        for first, last in itertools.pairwise(borders):
            pieces += planner.push(cut(path, first, last))
        pieces += planner.finish()
        assert len(pieces) > 2
        joined = PlannedPiece.join(pieces)
        np.testing.assert_array_equal(joined.law.time, once.law.time)
        np.testing.assert_array_equal(joined.law.jerk, once.law.jerk)
        np.testing.assert_array_equal(joined.path.s, once.path.s)
