"""Other planners for the same path: a stop at every corner, toppra slowed, copp-py's TOPP3."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from figures import Stopwatch
from optimum import time_grid
from toppra.algorithm import TOPPRA
from toppra.constraint import DiscretizationType, JointAccelerationConstraint, LinearConstraint
from toppra.interpolator import AbstractGeometricPath

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.feedrate.speed_guess import FASTEST, speed_bounds
from cnc_interp.kinematics.axis_path import AxisPath, evaluate
from cnc_interp.machine_model.machine import Machine, limits_of
from cnc_interp.problems import stretches

PERIOD = 1e-3
#: Jerk by third differences of setpoints that counts as kept: the limit and its rounding.
KEPT = 1.001


def largest_jerk(path: AxisPath, speed: FloatArray, max_jerk: FloatArray) -> tuple[float, float]:
    """Duration [s] of a law of constant s_ddot per cell, and its setpoints' jerk / limit."""
    h = np.diff(path.s)
    duration = 2 * h / np.maximum(speed[:-1] + speed[1:], 1e-12)
    at = np.concatenate([[0.0], np.cumsum(duration)])
    t = np.arange(-3, math.ceil(at[-1] / PERIOD) + 4) * PERIOD
    cell = np.clip(np.searchsorted(at, t, side='right') - 1, 0, len(h) - 1)
    dt = np.clip(t - at[cell], 0.0, duration[cell])
    slope = np.diff(speed) / duration
    s = path.s[cell] + dt * (speed[cell] + dt * slope[cell] / 2)
    q = evaluate(path, np.clip(s, path.s[0], path.s[-1]))[0]
    jerk = np.abs(np.diff(q, 3, axis=0)).max(axis=0) / PERIOD**3
    return float(at[-1]), float((jerk / max_jerk).max())


class GridPath(AbstractGeometricPath):  # type: ignore[misc]
    """An AxisPath in the interface of toppra; it can be evaluated only at the grid points."""

    def __init__(self, path: AxisPath):
        self.s = path.s
        self.jets = np.concatenate([path.cell_left, path.cell_right[:, -1:]], axis=1)

    def __call__(self, path_positions: Any, order: int = 0) -> FloatArray:
        """Return q (order 0), q_s (order 1) or q_ss (order 2) at grid points."""
        found = np.searchsorted(self.s, np.asarray(path_positions) - 1e-15)
        row: FloatArray = self.jets[order, np.minimum(found, len(self.s) - 1)]
        return row

    @property
    def dof(self) -> int:
        """Return the number of axes."""
        return int(self.jets.shape[2])

    @property
    def path_interval(self) -> FloatArray:
        """Return the path positions of start and end, shape (2,) [m]."""
        return self.s[[0, -1]]


class SpeedConstraint(LinearConstraint):  # type: ignore[misc]
    """Upper limit of s_dot at every grid point, from feed and axis velocities [m/s]."""

    def __init__(self, cap: FloatArray):
        super().__init__()
        self.cap = cap

    def compute_constraint_params(self, path: Any, gridpoints: Any, *args: Any) -> Any:
        """Return the bounds 0 <= s_dot^2 <= cap^2; all other terms of toppra are None."""
        bound = np.column_stack([np.zeros_like(self.cap), self.cap**2])
        return None, None, None, None, None, None, bound


def toppra_law(path: AxisPath, table: FloatArray) -> FloatArray | None:
    """
    Plan from rest to rest by toppra alone, without jerk limits [PP2018].

    Returns s_dot^2 at the grid points, shape (N,) [m2/s2]; None if toppra finds no solution.
    """
    h = np.diff(path.s)
    packed = Limits.constant(*table).table
    fast = speed_bounds(h, path.cell_left, path.cell_right, path.cell_feed, packed)[:, 0]
    cap = np.minimum(np.append(fast, FASTEST), np.append(FASTEST, fast))
    rows = JointAccelerationConstraint(
        np.column_stack([-table[1], table[1]]), DiscretizationType.Collocation
    )
    problem = TOPPRA(
        [SpeedConstraint(cap), rows],
        GridPath(path),
        gridpoints=path.s,
        solver_wrapper='seidel',
    )
    _, s_dot, _ = problem.compute_parameterization(0.0, 0.0)
    if s_dot is None or not np.all(np.isfinite(s_dot)):
        return None
    squared: FloatArray = np.asarray(s_dot, dtype=np.float64) ** 2
    return squared


def toppra_slowed(path: AxisPath, limits: Machine | Limits, count: int = 300) -> float:
    """
    Cycle time of toppra alone, its accelerations scaled down until jerk holds [s].

    Jerk is what the setpoints show at 1 ms; one factor for all axes and the whole stretch, found
    by bisection of its logarithm to 2 %.
    """
    total = 0.0
    for stretch in stretches(path):
        motion = plan_path(stretch, limits).law
        s = np.append(motion.s, stretch.s[-1])
        grid = time_grid(stretch, np.append(motion.time, motion.end_time), s, count)
        good, bad, best = 1e-6, 1.0, math.nan
        while bad / good > 1.02:
            middle = math.sqrt(good * bad)
            table = limits_of(limits).by_order.copy()
            table[1] *= middle
            squared = toppra_law(grid, table)
            kept = False
            if squared is not None:
                lasts, jerk = largest_jerk(grid, np.sqrt(squared), table[2])
                kept = jerk <= KEPT
            good, bad = (middle, bad) if kept else (good, middle)
            if kept:
                best = lasts
        total += best
    return total


@dataclass(frozen=True)
class SecondOpinion:
    """copp-py's answer: cycle time, CPU seconds, excess of a limit at its own stations."""

    time: float
    computing: float
    excess: float


def topp3(
    path: AxisPath, limits: Machine | Limits, count: int = 600, rounds: int = 4
) -> SecondOpinion:
    """
    Plan with copp-py: TOPP2, then TOPP3-SOCP linearised ``rounds`` times about the round before.

    The stations are a fine grid of the same path (``count`` 0: the path's own), with the jerk rows
    of both sides at each; the programmed feed bounds s_dot^2. Path length is counted in units in
    which the largest speed is 1 and every row is divided by its limit, else its solver gives up.
    ``computing`` counts the solves only.
    """
    import copp_py as copp

    total, computing, worst = 0.0, 0.0, -math.inf
    table = limits_of(limits).by_order
    options = copp.clarabel.ClarabelOptions(allow_insufficient_progress=True)
    for stretch in stretches(path):
        motion = plan_path(stretch, limits).law
        unit = float(motion.s_dot.max())
        s = np.append(motion.s, stretch.s[-1])
        times = np.append(motion.time, motion.end_time)
        grid = time_grid(stretch, times, s, count) if count else stretch
        n = len(grid.s)
        powers = unit ** np.arange(4)[:, None, None]
        left = np.concatenate([grid.cell_left, grid.cell_right[:, -1:]], axis=1) * powers
        right = np.concatenate([grid.cell_left[:, :1], grid.cell_right], axis=1) * powers
        one, none = np.ones_like(left[0]), np.zeros_like(left[0])
        station = (grid.s - grid.s[0]) / unit
        rows = copp.Constraints(left.shape[2])
        rows.append_s(station)
        feed = np.minimum(np.r_[grid.cell_feed, np.inf], np.r_[np.inf, grid.cell_feed])
        speed = np.minimum(feed / unit, 1e3)
        axes = (table[0] / np.maximum(np.abs(left[1]), 1e-9)).min(axis=1)
        rows.add_constraint_1st(np.minimum(speed, axes)[:, None] ** 2, 0)
        for side in (left, right):
            for sign in (1.0, -1.0):
                q1, q2, q3 = sign * side[1:]
                rows.add_constraint_2nd(q2 / table[1], q1 / table[1], one, 0)
                j = table[2]
                rows.add_constraint_3rd(q3 / j, 3 * q2 / j, q1 / j, none, one, 0)
        watch = Stopwatch()
        second = copp.solver.topp2_ra.Problem(rows, (0, n - 1), (0.0, 0.0))
        a, b = np.asarray(copp.solver.topp2_ra.solve(second)), None
        for _ in range(rounds):
            problem = copp.solver.topp3_socp.Problem(
                rows, a, num_stationary_max=1, b_linearization=b
            )
            profile = copp.solver.topp3_socp.solve(problem, options)
            a, b = profile.a, profile.b
        computing += watch.seconds()
        worst = max(worst, *rows.exceed_topp3(profile))
        profile.force_positive_a(station)
        total += float(copp.interpolation.s_to_t_topp3(station, profile)[0])
    return SecondOpinion(total, computing, worst)
