"""Tests of the interior point method by itself, and of the speed that it begins with."""

from __future__ import annotations

import numpy as np
import pytest
from feedrate_paths import XYZAC, polyline_path, random_polyline

from cnc_interp.feedrate.barrier_rows import Iterate
from cnc_interp.feedrate.grid import planning_grid
from cnc_interp.feedrate.interior_point import SOLVED, _blend, solve
from cnc_interp.feedrate.jerk_rows import build_rows
from cnc_interp.feedrate.jerk_stage import StretchProblem
from cnc_interp.feedrate.planner_tuning import KeptCells, PlanOptions
from cnc_interp.feedrate.speed_guess import guess_speed


def iterations(lines: int) -> int:
    """Solve a random polyline from rest to rest; return how many iterations it took."""
    path = polyline_path(random_polyline(np.random.default_rng(0), lines))
    table, rest, options = XYZAC.table, (0.0, 0.0), PlanOptions()
    kept = KeptCells(np.empty(0), np.empty((0, 4, 5)), np.empty(0))
    grid = planning_grid(
        path, table, rest, options.cell_time, options.share, options.bend, kept.ends
    )
    stretch = StretchProblem(grid, table, rest, options, kept)
    rows = np.zeros((5, 9, len(stretch.h)))
    build_rows(stretch.left, stretch.right, table, stretch.scale, rows)
    caps = np.repeat(grid.bounds[:, 4:5] ** 2, 2, axis=1)
    status, count, _ = solve(
        stretch.h,
        rows,
        caps,
        stretch.ends,
        Iterate(stretch.m, stretch.reset_widths(), stretch.slack, stretch.dual),
        False,
        options.gap,
        80,
    )
    assert status == SOLVED
    return int(count)


def test_a_long_stretch_takes_hardly_more_iterations_than_a_short_one():
    """Each part has its own step length: with one for all, it was 23 and 35."""
    assert iterations(150) <= iterations(8) + 4


def test_the_speed_that_is_guessed_is_below_the_bounds_of_both_cells():
    bounds = np.array([[9.0, slowest, 9.0, 1e9, 9.0, 9.0] for slowest in (1.0, 0.4, 0.4, 1.0)])
    speed = guess_speed(np.ones(4), bounds, 0.0, 0.0)
    assert speed.tolist() == [0.0, 0.9 * 0.4, 0.9 * 0.4, 0.9 * 0.4, 0.0]


def test_step_lengths_lie_on_lines_between_the_middles_of_their_parts():
    values, edges, found = np.array([1.0, 3.0, 2.0]), np.array([0, 4, 8, 12]), np.empty((2, 3, 4))
    for k in range(3):
        _blend(values, edges, k, False, found[0, k])
        _blend(values, edges, k, True, found[1, k])
    cells = np.arange(12) + 0.5
    assert found[0].ravel() == pytest.approx(np.interp(cells, [2, 6, 10], values))
    # Or at a border the smaller of both.
    assert found[1].ravel() == pytest.approx(np.interp(cells, [2, 4, 6, 8, 10], [1, 1, 3, 2, 2]))
