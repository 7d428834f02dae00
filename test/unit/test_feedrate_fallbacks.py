"""What the feed planner does when something goes wrong; each fault injected where it arises."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from feedrate_paths import (
    XYZAC,
    line_path,
    polyline_path,
    sampled_ratios,
    scaled,
)

from cnc_interp.core import PlanningError
from cnc_interp.feedrate import jerk_stage
from cnc_interp.feedrate.interior_point import BROKEN, STALLED
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import (
    CONVERGED,
    DIVIDED,
    NOT_CONVERGED,
    FeedPlanner,
    PlannedPiece,
    plan_path,
)
from cnc_interp.kinematics.axis_path import AxisPath

CORNER = np.array([[0, 0, 0], [0.03, 0, 0], [0.03, 0.02, 0], [0.05, 0.02, 0.01]], dtype=float)
SHORT = PlanOptions(window_cells=120)


def arc(blocks: int) -> AxisPath:
    """Blocks of 0.5 mm along a helix."""
    angle = np.arange(blocks) * 0.5e-3 / 0.03
    points = np.column_stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), 1e-3 * angle])
    return polyline_path(points, 0.05, cells=4, tolerance=1e-5, amplitude=0.5)


def assert_sound(piece: PlannedPiece, path: AxisPath) -> None:
    """Within all limits, to the end of the path, in one continuous motion."""
    assert sampled_ratios(piece.path, piece.law, XYZAC).max() <= 1.001
    assert piece.path.s[-1] == path.s[-1]
    end = piece.law.evaluate(np.array([np.inf]))
    assert abs(end[0][0] - path.s[-1]) < 1e-12 and abs(end[1][0]) < 1e-12


@pytest.mark.parametrize('status', [BROKEN, STALLED])
@pytest.mark.parametrize('period', [0, 2, 5])
def test_a_solver_that_fails_in_motion_leaves_the_older_plan(monkeypatch, status, period):
    """The interior point breaks down in every moving window, or in all but every n-th."""
    solve, windows = jerk_stage.solve_cells, []

    def failing(*arguments):
        ends, m = arguments[3], arguments[5].m
        if ends[0] == 0.0:
            return solve(*arguments)
        if not windows or not np.array_equal(windows[-1], ends):
            windows.append(ends.copy())
        if period and len(windows) % period == 0:
            return solve(*arguments)
        m[1:-1] *= 3.0  # what it leaves behind is worthless
        return status

    monkeypatch.setattr(jerk_stage, 'solve_cells', failing)
    path = arc(120)
    piece = plan_path(path, XYZAC, SHORT)
    assert len(windows) > 2
    assert_sound(piece, path)


def test_a_grid_too_coarse_is_refined(monkeypatch):
    """Cells of 50 ms cannot keep what bends inside them; half of them and less can."""
    asked, plan = [], jerk_stage.plan

    def counting(path, table, start, options, *rest):
        stretch = plan(path, table, start, options, *rest)
        asked.append((start[0] > 0.0, options.share, stretch is not None))
        return stretch

    monkeypatch.setattr(jerk_stage, 'plan', counting)
    coarse = PlanOptions(cell_time=(5e-2, 0.2), bend=0.8, passes=0, window_cells=100)
    path = arc(120)
    piece = plan_path(path, XYZAC, coarse)
    refused = [share for moving, share, found in asked if moving and not found]
    assert coarse.share in refused
    assert any(found and share < coarse.share for _, share, found in asked)
    assert_sound(piece, path)


def past_the_pole(distance: float) -> AxisPath:
    """Turn C as a tool axis that passes the pole at a distance does: by atan(s / distance)."""
    path = line_path(0.04, 0.05, cells=400)
    left, right = path.cell_left.copy(), path.cell_right.copy()
    for jet, s in ((left, path.s[:-1]), (right, path.s[1:])):
        x = (s - 0.02) / distance
        r = 1.0 / (1.0 + x * x)
        jet[:, :, 4] = np.arctan(x), r, -2 * x * r**2, (6 * x * x - 2) * r**3
        jet[:, :, 4] /= distance ** np.arange(4)[:, None]
    return replace(path, cell_left=left, cell_right=right)


@pytest.mark.parametrize('distance', [1e-2, 1e-3, 2e-4])
def test_near_the_pole_the_feed_drops_and_limits_hold(distance):
    path = past_the_pole(distance)
    piece = plan_path(path, XYZAC)
    assert_sound(piece, path)
    slowest = np.interp(0.02, piece.law.s, piece.law.s_dot)
    # C alone could not turn faster than V there
    assert slowest <= XYZAC.max_velocity[4] * distance * 1.001
    if distance < 1e-3:
        assert slowest < 0.01


def spoiled(path: AxisPath, what: str, cell: int) -> AxisPath:
    """Spoil one cell of a path, and count its blocks from 7."""
    left, feed, s = path.cell_left.copy(), path.cell_feed.copy(), path.s.copy()
    if what == 'jet':
        left[3, cell, 0] = np.nan
    elif what == 'feed':
        feed[cell] = 0.0
    else:
        s[cell + 1] = s[cell]
    return AxisPath(
        s,
        left,
        path.cell_right.copy(),
        path.tip.copy(),
        path.axis.copy(),
        feed,
        path.cell_block.copy() + 7,
        path.stop.copy(),
    )


@pytest.mark.parametrize('what', ['jet', 'feed', 'length'])
@pytest.mark.parametrize('cell', [0, 3, 20])
def test_what_cannot_be_driven_is_refused_after_a_stop_before_it(what, cell):
    path = spoiled(polyline_path(CORNER), what, cell)
    planner = FeedPlanner(XYZAC)
    message = f'block {path.cell_block[cell]} '
    pieces = []
    if cell:
        pieces = planner.push(path)
        before = PlannedPiece.join(pieces)
        assert before.path.s[-1] == path.s[cell]
        assert sampled_ratios(before.path, before.law, XYZAC).max() <= 1.001
        with pytest.raises(PlanningError, match=message):
            planner.finish()
    with pytest.raises(PlanningError, match=message):
        planner.push(path)


def test_a_start_that_cannot_stop_in_time_is_refused_with_its_state():
    path = line_path(1e-3, 0.05)
    with pytest.raises(PlanningError, match=r's_dot 0\.04 m/s.* block 0'):
        plan_path(path, XYZAC, start=(0.04, 0.0))
    # ten times as far, it can
    piece = plan_path(line_path(0.1, 0.05), XYZAC, start=(0.04, 0.0))
    assert piece.law.s_dot[0] == 0.04


@pytest.mark.thorough
def test_a_law_from_rest_is_slowed_where_corrections_do_not_end(monkeypatch):
    """From rest, driving all of it slower always helps."""
    monkeypatch.setattr(jerk_stage.StretchProblem, 'lower_limits', lambda self: None)
    path = polyline_path(CORNER)
    tight = scaled(XYZAC, 1, 1, 0.3)
    coarse = PlanOptions(cell_time=(5e-2, 0.2), bend=0.8)
    piece = plan_path(path, tight, coarse)
    assert sampled_ratios(piece.path, piece.law, tight).max() <= 1.001
    assert piece.path.s[-1] == path.s[-1]


def test_after_driving_to_the_older_stop_planning_goes_on(monkeypatch):
    """Restart from the rest that an older plan reached, then full speed again."""
    solve, failed = jerk_stage.solve_cells, []

    def failing(*arguments):
        if arguments[3][0] > 0.0 and len(failed) < 60:
            failed.append(1)
            return BROKEN
        return solve(*arguments)

    monkeypatch.setattr(jerk_stage, 'solve_cells', failing)
    path = arc(160)
    piece = plan_path(path, XYZAC, SHORT)
    assert len(failed) == 60
    assert_sound(piece, path)
    rests = np.flatnonzero(piece.law.s_dot[1:] == 0.0)
    assert len(rests) >= 1
    assert piece.law.s_dot[rests[-1] + 1 :].max() > 0.005


def test_a_window_that_does_not_converge_is_divided_by_a_rest(monkeypatch):
    """Long stretches end three times too slow; rests in the corners are faster."""
    plan = jerk_stage.plan

    def failing(path, *rest):
        law = plan(path, *rest)
        if len(path.s) <= 20:
            return law
        return replace(
            law,
            v=law.v / 3,
            a=law.a / 9,
            jerk=law.jerk / 27,
            duration=3 * law.duration,
            converged=False,
        )

    path = polyline_path(CORNER, 0.05)
    best = plan_path(path, XYZAC)
    monkeypatch.setattr(jerk_stage, 'plan', failing)
    piece = plan_path(path, XYZAC)
    assert best.solved == CONVERGED and piece.solved == DIVIDED
    assert_sound(piece, path)
    assert 1 <= np.count_nonzero(piece.law.s_dot[1:] == 0.0) <= 3
    assert best.law.end_time < piece.law.end_time < 1.5 * best.law.end_time


def test_a_limit_falls_with_every_correction():
    """Also where what is left of the excess is less than the slack."""
    stretch = object.__new__(jerk_stage.StretchProblem)
    stretch.scale = np.full((1, 4, 1), 0.999)
    stretch.aim, stretch.accepted = jerk_stage.AIM[None], jerk_stage.ACCEPTED[None]
    stretch.factor, stretch.changed = np.full(1, jerk_stage.EXCESS_FACTOR), np.zeros(1, dtype=bool)
    for _ in range(PlanOptions.passes):
        before = stretch.scale.copy()
        within = jerk_stage.ACCEPTED + 0.1 * jerk_stage.SLACK
        stretch.use = np.stack([np.broadcast_to(within[:, None], (1, 4, 1)), before])
        stretch.lower_limits()
        assert (stretch.scale < before).all()


def test_a_law_that_has_not_converged_is_told(monkeypatch):
    solve = jerk_stage.solve_cells
    monkeypatch.setattr(jerk_stage, 'solve_cells', lambda *rest: max(solve(*rest), STALLED))
    path = polyline_path(CORNER, 0.05)
    piece = plan_path(path, XYZAC)
    assert piece.solved == NOT_CONVERGED
    assert_sound(piece, path)
