"""Stops along the path: from every moment of a law, within the limits, and how long they take."""

from __future__ import annotations

import numpy as np
import pytest
from feedrate_paths import XYZAC, Limits, first_axes, line_path, polyline_path, random_polyline
from tiers import few_of

from cnc_interp.core import FloatArray
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.kinematics.axis_path import AxisPath, evaluate, refine
from cnc_interp.run.motion_plan import MotionStream
from cnc_interp.run.setpoints import Chunk, Wait

ruckig = pytest.importorskip('ruckig')

#: Time by which a stop may be longer than on a straight line [s].
LONGER = 0.4
#: Time between the moments that are tried [s].
EVERY = 0.02

XY = first_axes(XYZAC, 2)
SOFT = Limits.constant(np.full(2, 1.0), np.full(2, 0.3), np.full(2, 50.0))


def circle(radius: float, turns: float, feed: float) -> AxisPath:
    """Two axes on a circle, with exact derivatives in every cell."""
    cells = int(200 * turns)
    s = np.linspace(0.0, 2 * np.pi * radius * turns, cells + 1)
    phase = s[None] / radius + np.array([0.0, -np.pi / 2])[:, None]
    jet = np.array([np.cos(phase + k * np.pi / 2) * radius ** (1 - k) for k in range(4)])
    jet = jet.transpose(0, 2, 1).copy()
    stop = np.zeros(cells + 1, dtype=bool)
    stop[[0, -1]] = True
    return AxisPath(
        s=s,
        cell_left=jet[:, :-1].copy(),
        cell_right=jet[:, 1:].copy(),
        tip=np.column_stack([jet[0], np.zeros(cells + 1)]),
        axis=np.tile([0.0, 0.0, 1.0], (cells + 1, 1)),
        cell_feed=np.full(cells, feed),
        cell_block=np.zeros(cells, dtype=np.int64),
        stop=stop,
    )


def straight_stop(path: AxisPath, state: tuple[float, float, float], limits: Limits) -> float:
    """Time of ruckig's stop from the same speed and acceleration along the tangent [s]."""
    q_s = np.abs(evaluate(path, np.array([state[0]]))[1][0])
    with np.errstate(divide='ignore'):
        acceleration, jerk = (limits.max_acceleration / q_s).min(), (limits.max_jerk / q_s).min()
    inp, out = ruckig.InputParameter(1), ruckig.Trajectory(1)
    inp.control_interface = ruckig.ControlInterface.Velocity
    inp.current_velocity, inp.current_acceleration = [state[1]], [state[2]]
    inp.max_acceleration, inp.max_jerk = [max(acceleration, abs(state[2]))], [jerk]
    ruckig.Ruckig(1).calculate(inp, out)
    return float(out.duration)


def use_of_limits(piece: PlannedPiece, limits: Limits) -> float:
    """Largest use of a limit, from the derivatives of the true curve at many instants."""
    law = piece.law
    time = np.sort(np.concatenate([law.time, np.linspace(law.time[0], law.end_time, 2000)]))
    row = law.piece_at(time)
    s, v, a, j = (x[:, None] for x in law.evaluate(time, row))
    _, q_s, q_ss, q_sss = evaluate(piece.path, s[:, 0], law.cell[row])
    velocity, acceleration = q_s * v, q_ss * v**2 + q_s * a
    jerk = q_sss * v**3 + 3 * q_ss * v * a + q_s * j
    return max(
        (np.abs(velocity) / limits.max_velocity).max(),
        (np.abs(acceleration) / limits.max_acceleration).max(),
        (np.abs(jerk) / limits.max_jerk).max(),
    )


def longer_than_straight(piece: PlannedPiece, limits: Limits) -> FloatArray:
    """
    Time to rest from every moment of a law, less the time on a straight line [s].

    From a moment without a stop the motion goes on as planned to the next one.
    """
    law, table = piece.law, limits.table
    times = np.arange(0.0, law.end_time, EVERY)
    states = np.array(law.evaluate(times)[:3]).T
    rest, longer = law.end_time, []
    for time, values in zip(times[::-1], states[::-1], strict=True):
        state = tuple(values.tolist())
        stop = stop_law(piece.path, state, table, float(time))
        if stop is not None:
            rest = stop.law.end_time
            assert use_of_limits(stop, limits) <= 1.0
            s, v, a, _ = stop.law.evaluate(np.array([time, rest]))
            assert (s[0], v[0], a[0]) == pytest.approx(state, rel=1e-12, abs=1e-12)
            assert abs(v[1]) < 1e-9 and abs(a[1]) < 1e-6
            assert s[1] == pytest.approx(stop.path.s[-1], abs=1e-11)
        if state[1] > 0.0:
            longer.append(rest - time - straight_stop(piece.path, state, limits))
    return np.array(longer)


@pytest.mark.parametrize(
    ('speed', 'acceleration'), [(0.1, 0.0), (0.3, 0.5), (0.02, -0.1), (1e-4, 0.0), (0.2, 1.5)]
)
def test_on_a_line_a_stop_takes_the_time_of_ruckig(speed, acceleration):
    path = line_path(1.0)
    state = (0.0, speed, acceleration)
    stop = stop_law(path, state, XYZAC.table, 0.0)
    assert use_of_limits(stop, XYZAC) < 1.0
    best = straight_stop(path, state, XYZAC)
    assert best < stop.law.end_time < 1.05 * best


@pytest.mark.parametrize(
    ('limits', 'what'), [(XY, 'jerk'), (SOFT, 'acceleration')], ids=['jerk', 'acceleration']
)
def test_a_law_round_a_circle_can_be_stopped_anywhere(limits, what):
    path = circle(0.02, 4, 1.0)
    piece = plan_path(path, limits)
    longer = longer_than_straight(piece, limits)
    assert longer.max() < LONGER + EVERY
    without = plan_path(path, limits, PlanOptions(reserve=0.0))
    assert piece.law.end_time < 1.011 * without.law.end_time
    if what == 'jerk':
        # without the reserve there is hardly a stop in three quarters of the motion
        assert np.median(longer_than_straight(without, limits)) > LONGER


def test_tails_stay_short_in_a_law_at_the_jerk_limit():
    """They were up to 20,000 setpoints long, and filled the memory."""
    period = 1e-3
    stream = MotionStream(XY, period)
    stream.push(circle(0.02, 8, 1.0))
    stream.end_leg(Wait.END)
    chunks: list[Chunk] = []
    while not chunks or chunks[-1].wait is not Wait.END:
        if stream.current.can_sample:
            chunks += stream.current.sample()
        else:
            stream.current.plan()
    straight = 2 * np.sqrt(max(np.linalg.norm(c.samples.velocity[-1]) for c in chunks) / 5.0)
    assert max(len(chunk.tail) for chunk in chunks) * period < straight + LONGER + 2 * EVERY


@pytest.mark.parametrize('seed', few_of(4, range(4)))
def test_rounded_corners_can_be_stopped_in_between(seed):
    path = polyline_path(random_polyline(np.random.default_rng(seed), 12))
    longer = longer_than_straight(plan_path(path, XYZAC), XYZAC)
    assert longer.max() < LONGER + EVERY


@pytest.mark.parametrize('seed', few_of(3, range(3)))
def test_the_reserve_costs_nothing_where_braking_is_possible(seed):
    path = polyline_path(random_polyline(np.random.default_rng(seed), 12))
    kept = plan_path(path, XYZAC)
    without = plan_path(path, XYZAC, PlanOptions(reserve=0.0))
    assert np.array_equal(kept.law.s_dot, without.law.s_dot)


def test_a_stop_that_ends_within_rounding_of_a_border_has_no_cell_after_it():
    """In the smallest motions a border may lie anywhere in the last picometres of a stop."""
    table, plain, late = XYZAC.table, line_path(0.2, 0.05), 0
    for v in np.geomspace(1e-8, 1e-6, 12):
        state = (0.1, float(v), 0.0)
        whole = stop_law(plain, state, table, 0.0)
        if whole is None:
            continue
        for gap in np.linspace(1e-13, 3e-12, 30):
            border = whole.path.s[-1] - gap
            stop = stop_law(refine(plain, np.array([border])), state, table, 0.0)
            if stop is not None:
                assert stop.law.cell.max() <= len(stop.path.s) - 2
                late += stop.path.s[-1] == border
    assert late > 10, 'stops that end at the border'
