"""The least time of any motion: against linear programs, closed forms, and every law planned."""

from __future__ import annotations

import math
import subprocess
import sys

import numpy as np
import pytest
from feedrate_paths import XYZAC, line_path, polyline_path, random_polyline
from scipy.optimize import linprog
from scipy.sparse import csr_array, vstack

from cnc_interp.feedrate.backward_pass import BackwardPass
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, plan_path
from cnc_interp.feedrate.time_bound import time_bound
from cnc_interp.kinematics.axis_path import cut, evaluate_cells, refine

TABLE = XYZAC.table


def bound_of(path):
    return time_bound(path, np.arange(len(path.s)), TABLE, 0.0, True)


def random_path(seed, corners=3, feed=0.1):
    return polyline_path(random_polyline(np.random.default_rng(seed), corners), feed)


def linear_program_time(path):
    """
    Time of the fastest motion with s_dot^2 linear in s on a fine grid, by one linear program.

    Velocities and accelerations are kept at both ends and in the middle of each cell.
    """
    n, h = len(path.s) - 1, np.diff(path.s)
    rows, rooms = [], []
    cap = np.full(n + 1, np.inf)
    for u in (0.0, 0.5, 1.0):
        jets = evaluate_cells(path.s, path.cell_left, path.cell_right, u * h, np.arange(n))
        for k in range(path.cell_left.shape[2]):
            q_s, q_ss = jets[1][:, k], jets[2][:, k]
            # q_s (b1 - b0) / 2h + q_ss ((1 - u) b0 + u b1), and both ends of velocity
            a = np.concatenate([-q_s / (2 * h) + (1 - u) * q_ss, q_s / (2 * h) + u * q_ss])
            at = np.tile(np.arange(n), 2), np.concatenate([np.arange(n), np.arange(n) + 1])
            block = csr_array((a / TABLE[1, k], at), shape=(n, n + 1))
            rows += [block, -block]
            rooms += [np.ones(2 * n)]
            with np.errstate(divide='ignore'):
                fast = (TABLE[0, k] / q_s) ** 2
            cap[:-1] = np.minimum(cap[:-1], fast)
            cap[1:] = np.minimum(cap[1:], fast)
    cap[:-1] = np.minimum(cap[:-1], path.cell_feed**2)
    cap[1:] = np.minimum(cap[1:], path.cell_feed**2)
    cap[0] = cap[-1] = 0.0
    found = linprog(
        -np.ones(n + 1), vstack(rows), np.concatenate(rooms), bounds=[(0.0, c) for c in cap]
    )
    v = np.sqrt(found.x)
    return float((2 * h / (v[:-1] + v[1:])).sum())


@pytest.mark.parametrize('seed', range(6))
def test_no_linear_program_finds_a_faster_motion_and_it_comes_near(seed):
    path = random_path(seed)
    least = bound_of(plan_path(path, XYZAC).path).time.sum()
    even = np.linspace(0.0, 1.0, 601)
    fine = path.s[-1] * (3 * even**2 - 2 * even**3)
    other = linear_program_time(refine(path, np.setdiff1d(fine, path.s)))
    assert 0.97 * other < least <= other


@pytest.mark.parametrize('feed', [0.02, 0.3, math.inf])
@pytest.mark.parametrize('cells', [1, 7])
def test_the_bound_of_a_stroke_is_its_trapezoid(feed, cells):
    length, fastest, rate = 0.3, XYZAC.max_velocity[0], XYZAC.max_acceleration[0]
    v = min(feed, fastest, math.sqrt(length * rate))
    least = bound_of(plan_path(line_path(length, feed, cells), XYZAC).path).time.sum()
    trapezoid = v / rate + length / v
    assert 0.99 * trapezoid < least <= trapezoid * (1 + 1e-9)


@pytest.mark.parametrize('seed', range(12))
def test_no_law_is_faster_in_any_cell(seed):
    path = random_path(seed, corners=6)
    piece = plan_path(path, XYZAC)
    bound = bound_of(piece.path)
    law = piece.law
    assert (law.s_dot**2 <= bound.squared[:-1] * (1 + 1e-9) + 1e-15).all()
    assert (law.duration >= bound.time * (1 - 1e-9)).all()
    assert 0.3 * law.end_time < piece.least_time < law.end_time


def test_windows_count_no_part_twice():
    path = random_path(3, corners=40)
    whole = plan_path(path, XYZAC, PlanOptions(window_cells=100_000, window_ratio=1e9))
    parts = plan_path(path, XYZAC, PlanOptions(window_cells=150))
    assert 0.99 * whole.least_time < parts.least_time < 1.001 * whole.least_time


def test_the_same_bound_however_the_path_arrives():
    path = random_path(5, corners=30)
    once = plan_path(path, XYZAC)
    planner, last = FeedPlanner(XYZAC), len(path.s) - 1
    pieces = []
    for first in range(0, last, 17):
        pieces += planner.push(cut(path, first, min(first + 17, last)))
    pieces += planner.finish()
    assert sum(piece.least_time for piece in pieces) == pytest.approx(once.least_time, rel=1e-12)


def test_the_law_is_the_same_without_the_bound():
    path = random_path(2)
    one, other = plan_path(path, XYZAC), plan_path(path, XYZAC, PlanOptions(bound=False))
    np.testing.assert_array_equal(one.law.time, other.law.time)
    assert other.least_time == 0.0


def test_a_step_is_begun_as_fast_as_its_end_allows():
    half, cap = np.full((1, 1), 0.5), np.array([100.0, 100.0])
    solver = BackwardPass(half, half, cap)  # |b_0 - b_1| / 2 <= 1
    assert [solver.largest(0, end) for end in (4.0, 99.0)] == pytest.approx([6.0, 100.0], rel=1e-5)


def test_toppra_comes_without_its_plots():
    ask = 'import sys, cnc_interp.feedrate.time_bound; print("matplotlib" in sys.modules)'
    said = subprocess.run([sys.executable, '-c', ask], capture_output=True, text=True, check=True)
    assert said.stdout.strip() == 'False'
