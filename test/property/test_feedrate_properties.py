"""Any path, any limits, any state: the emitted samples keep every limit."""

from __future__ import annotations

import hashlib
import itertools
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from feedrate_paths import (
    XYZAC,
    Limits,
    line_path,
    polyline_path,
    random_polyline,
    sampled_ratios,
    scaled,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tiers import examples, few_of

from cnc_interp.core import PlanningError
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate, refine

PERIOD = 1e-3


def tried(few: int, many: int) -> settings:
    """Settings of one property: the same examples in every run."""
    return settings(
        max_examples=examples(few, many),
        derandomize=True,
        suppress_health_check=[HealthCheck.too_slow],
    )


@st.composite
def problems(draw, most_corners: int = 6) -> tuple[AxisPath, Limits, np.random.Generator]:
    """Draw paths of 0.1 um to 1 m, with limits up to a factor 10^4 apart between the axes."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    corners = draw(st.integers(0, most_corners))
    longest = 10.0 ** draw(st.floats(-4, -0.7))
    feed = draw(st.one_of(st.just(np.inf), st.floats(-3, -0.3).map(lambda x: 10.0**x)))
    spread = draw(st.floats(0, 2))
    factors = 10 ** rng.uniform(-spread, spread, (3, 5))
    limits = Limits.constant(
        XYZAC.max_velocity * factors[0],
        XYZAC.max_acceleration * factors[1],
        XYZAC.max_jerk * factors[2],
    )
    stops = (1,) if corners and draw(st.booleans()) else ()
    amplitude = draw(st.floats(0, 1.5))
    points = random_polyline(rng, corners, longest)
    return polyline_path(points, feed, amplitude=amplitude, stops=stops), limits, rng


def plan_in_parts(
    path: AxisPath, limits: Limits, options: PlanOptions, rng: np.random.Generator
) -> PlannedPiece:
    """Plan a path that arrives in random parts."""
    inner = rng.integers(1, len(path.s) - 1, 10) if len(path.s) > 2 else []
    borders = np.unique(np.r_[0, inner, len(path.s) - 1]).astype(int).tolist()
    planner = FeedPlanner(limits, options)
    pieces = []
    for first, last in itertools.pairwise(borders):
        pieces += planner.push(cut(path, first, last))
    return PlannedPiece.join(pieces + planner.finish())


def assert_sound(piece: PlannedPiece, path: AxisPath, limits: Limits) -> None:
    assert sampled_ratios(piece.path, piece.law, limits, PERIOD).max() <= 1.001
    assert abs(piece.law.evaluate(np.array([np.inf]))[0][0] - path.s[-1]) < 1e-12


@tried(12, 500)
@given(problems())
def test_samples_keep_every_limit(problem):
    path, limits, _ = problem
    assert_sound(plan_path(path, limits), path, limits)


@tried(8, 250)
@given(problems(), st.integers(8, 200))
def test_samples_keep_every_limit_in_short_windows(problem, cells):
    """Windows far shorter than a stop: every plan begins in motion, much is driven as planned."""
    path, limits, rng = problem
    piece = plan_in_parts(path, limits, PlanOptions(window_cells=cells), rng)
    assert_sound(piece, path, limits)


def use_at_any_instant(piece: PlannedPiece, limits: Limits) -> float:
    """Largest use of a limit by velocity, acceleration, jerk and feed, every 10 us."""
    time = np.arange(0.0, piece.law.end_time, 1e-5)
    at = piece.law.piece_at(time)
    s, v, a, j = (x[:, None] for x in piece.law.evaluate(time, at))
    cell = piece.law.cell[at]
    _, q_s, q_ss, q_sss = evaluate(piece.path, s[:, 0], cell)
    moved = (
        (q_s * v, limits.max_velocity),
        (q_ss * v**2 + q_s * a, limits.max_acceleration),
        (q_sss * v**3 + 3 * q_ss * v * a + q_s * j, limits.max_jerk),
        (v, piece.path.cell_feed[cell, None]),
    )
    return max(float((np.abs(value) / limit).max()) for value, limit in moved)


@tried(10, 300)
@given(problems(), st.sampled_from([50, 4000]))
def test_no_limit_is_exceeded_between_the_instants_that_the_planner_looks_at(problem, cells):
    path, limits, _ = problem
    piece = plan_path(path, limits, PlanOptions(window_cells=cells))
    assert use_at_any_instant(piece, limits) <= 1.0 + 1e-9


def rest_of(path: AxisPath, s: float) -> AxisPath:
    """Take the path from a position on."""
    fine = refine(path, np.array([s]))
    return cut(fine, int(np.searchsorted(fine.s, s)), len(fine.s) - 1)


def across(old: PlannedPiece, new: PlannedPiece, time: float, limits: Limits) -> float:
    """Largest use of a limit by third differences where one law takes over from another."""
    ticks = np.arange(0, time + new.law.end_time + 4 * PERIOD, PERIOD)
    before, after = ticks[ticks <= time][-400:], ticks[ticks > time]
    q = np.concatenate(
        [
            evaluate(old.path, old.law.evaluate(before)[0])[0],
            evaluate(new.path, new.law.evaluate(after - time)[0])[0],
        ]
    )
    table = limits.max_velocity, limits.max_acceleration, limits.max_jerk
    return max(
        float((np.abs(np.diff(q - q[0], order, axis=0)) / PERIOD**order / limit).max(initial=0.0))
        for order, limit in enumerate(table, start=1)
    )


def test_going_on_from_a_state_of_motion():
    """
    From any state of a law that keeps 99 % of the limits there is a law, no slower than that one.

    A law that uses the last per cent as well may be the only law from its states: near a stop any
    other law passes the stop. There, and hardly ever, a start is refused.
    """
    planned, refused = Counter(), Counter()

    @tried(40, 400)
    @given(problems(), st.floats(0.001, 0.999))
    def goes_on(problem, share):
        path, limits, _ = problem
        path = cut(path, 0, int(np.flatnonzero(path.stop)[1]))
        for part in (0.99, 1.0):
            old = plan_path(path, scaled(limits, part, part, part))
            time = share * old.law.end_time
            s, v, a, _ = (float(x[0]) for x in old.law.evaluate(np.array([time])))
            rest = rest_of(path, s)
            try:
                new = plan_path(rest, limits, start=(v, a))
            except PlanningError:
                refused[part] += 1
                continue
            planned[part] += 1
            assert new.law.s_dot[0] == v and new.law.s_ddot[0] == a
            assert across(old, new, time, limits) <= 1.001
            assert new.law.end_time <= 1.005 * (old.law.end_time - time) + 1e-6

    goes_on()
    print(f'planned {planned}, refused {refused}')
    assert refused[0.99] <= 0.01 * (planned[0.99] + refused[0.99])
    assert refused[1.0] <= 0.03 * (planned[1.0] + refused[1.0])


@tried(8, 250)
@given(
    problems(4),
    st.sampled_from([0, 1, 2, slice(None)]),
    st.sampled_from([*range(5), slice(None)]),
    st.floats(0.1, 4.0),
)
def test_relaxing_limits_never_costs_time(problem, order, axis, factor):
    path, limits, _ = problem
    table = np.array([limits.max_velocity, limits.max_acceleration, limits.max_jerk])
    table[order, axis] *= 10.0**factor
    strict = plan_path(path, limits).law.end_time
    assert plan_path(path, Limits.constant(*table)).law.end_time <= 1.001 * strict


@pytest.mark.parametrize(
    ('length', 'cells'), few_of(5, [1e-4, 0.06, 0.5], [2, 3, 7, 50, 1000, 10_000])
)
def test_a_line_cut_in_pieces_takes_the_same_time(length, cells):
    once = plan_path(line_path(length, 0.1), XYZAC)
    many = plan_path(line_path(length, 0.1, cells), XYZAC)
    assert np.isclose(many.law.end_time, once.law.end_time, rtol=1e-3)
    assert sampled_ratios(many.path, many.law, XYZAC).max() <= 1.001


DIGEST = """
import hashlib, sys
import numpy as np
sys.path.insert(0, sys.argv[1])
from feedrate_paths import XYZAC, polyline_path, random_polyline
from cnc_interp.feedrate.planning_windows import plan_path
digest = hashlib.sha256()
for seed in range(5):
    points = random_polyline(np.random.default_rng(seed), 5)
    law = plan_path(polyline_path(points, 0.05), XYZAC).law
    for column in (law.time, law.s, law.s_dot, law.s_ddot, law.jerk):
        digest.update(column.tobytes())
print(digest.hexdigest())
"""


@pytest.mark.thorough
def test_the_same_bits_in_another_process():
    digest = hashlib.sha256()
    for seed in range(5):
        points = random_polyline(np.random.default_rng(seed), 5)
        law = plan_path(polyline_path(points, 0.05), XYZAC).law
        for column in (law.time, law.s, law.s_dot, law.s_ddot, law.jerk):
            digest.update(column.tobytes())
    unit = str(Path(__file__).parents[1] / 'unit')
    found = subprocess.run(
        [sys.executable, '-c', DIGEST, unit],
        env={**os.environ, 'PYTHONHASHSEED': '1'},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.strip() == digest.hexdigest()
