"""
The jerk stage: one stretch of path planned to the limits, corrected between the nodes, checked.

The interior point knows the limits at the ends of each cell only. Its law is evaluated on the true
curve at several instants of every cell; where a limit is passed in between, that cell's limit is
lowered by the excess and the stretch is solved again. What comes out has been seen to keep every
limit at all these instants, or it is not accepted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numba
import numpy as np

from cnc_interp.feedrate import grid
from cnc_interp.feedrate.interior_point import (
    BROKEN,
    follow_widths,
    node_states,
    solve,
)
from cnc_interp.feedrate.limits import limit_use
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.program.blocks import FloatArray


@dataclass(frozen=True)
class PlanOptions:
    """
    Settings of the feed planner.

    Parameters
    ----------
    passes : int
        Most corrections of one stretch.
    cell_time : tuple of float
        Shortest and longest time aimed at for a cell [s].
    share : float
        Time aimed at for a cell as a share of the stretch's.
    bend : float
        Part of a limit by which a cell may bend away from what its two ends know.
    gap : float
        Distance to the optimum at which the interior point stops, relative to the time.
    points : int
        Instants per cell at which the limits are checked.
    window_ratio : float
        Length of a planning window in stopping horizons; one horizon of it is planned again.
    window_cells : int
        Most cells of the path in one window.

    """

    passes: int = 6
    cell_time: tuple[float, float] = (2e-4, 8e-3)
    share: float = 1 / 64
    bend: float = 0.03
    gap: float = 5e-5
    points: int = 7
    window_ratio: float = 2.5
    window_cells: int = 4000


SLACK = np.array([2e-4, 1e-3, 1e-3, 2e-5])
"""Part of each limit (velocity, acceleration, jerk, feed) kept free at the nodes."""

AIM, ACCEPTED = 1.0 - 0.8 * SLACK, 1.0 - 0.2 * SLACK
"""Use that a correction aims at; largest use, at the instants checked, that counts as kept."""

AIM_KEPT, ACCEPTED_KEPT, RELAXED = 1.0 - 0.1 * SLACK, np.ones(4), 0.25 * SLACK
"""The same, and the relaxation of the limits, in cells where an older plan must stay possible."""

MOST_ITERATIONS = 80


@dataclass(frozen=True)
class Stretch:
    """
    A planned stretch: n cells, the states at their nodes and the time spent in each.

    Parameters
    ----------
    path : AxisPath
        The path on the planner's grid.
    v, a : ndarray, shape (n + 1,)
        s_dot and s_ddot at the nodes [m/s, m/s2].
    duration : ndarray, shape (n,)
        Time spent in the cells [s].
    use : float
        Largest use of any limit over all instants checked, over what is accepted.
    scale : ndarray, shape (n, 4, n_axes)
        Parts of the limits that were allowed at the nodes, corrections included.

    """

    path: AxisPath
    v: FloatArray
    a: FloatArray
    duration: FloatArray
    use: float
    scale: FloatArray

    def after(self, node: int) -> Stretch:
        """Take what follows a node."""
        return Stretch(
            cut(self.path, node, len(self.duration)),
            self.v[node:],
            self.a[node:],
            self.duration[node:],
            self.use,
            self.scale[node:],
        )

    def law(self, start_time: float, first: int, last: int) -> MotionLaw:
        """Build the law of cells first ... last - 1; cells are counted from ``first``."""
        duration = self.duration[first:last]
        time = start_time + np.concatenate([[0.0], np.cumsum(duration)])
        jerk = np.diff(self.a[first : last + 1]) / duration
        return MotionLaw(
            time=time[:-1],
            duration=duration.copy(),
            s=self.path.s[first:last].copy(),
            s_dot=self.v[first:last].copy(),
            s_ddot=self.a[first:last].copy(),
            jerk=jerk,
            cell=np.arange(last - first, dtype=np.int64),
        )


@numba.njit(cache=True)
def settle(
    h: FloatArray,
    m: FloatArray,
    width: FloatArray,
    ends: FloatArray,
    v: FloatArray,
    a: FloatArray,
    duration: FloatArray,
) -> float:
    """Bring the effective widths to rounding for fixed coefficients; returns what is left."""
    b = np.empty(len(v))
    left = 1.0
    for _ in range(60):
        node_states(m, width, ends, b, a, v)
        left = follow_widths(h, a, v, width)
        if left < 2e-15:
            break
    node_states(m, width, ends, b, a, v)
    for i in range(len(h)):
        duration[i] = 2 * width[i] / (v[i] + v[i + 1])
    return left


@numba.njit(cache=True)
def build_rows(
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    scale: FloatArray,
    jerk: FloatArray,
    acceleration: FloatArray,
) -> None:
    """Write the rows of the interior point: derivatives over the scaled limits."""
    n, n_axes = left.shape[1], left.shape[2]
    for i in range(n):
        for k in range(n_axes):
            by_jerk = 1.0 / (table[2, k] * scale[i, 2, k])
            jerk[i, 0, k, 0] = left[1, i, k] * by_jerk
            jerk[i, 0, k, 1] = 3 * left[2, i, k] * by_jerk
            jerk[i, 0, k, 2] = left[3, i, k] * by_jerk
            jerk[i, 1, k, 0] = right[1, i, k] * by_jerk
            jerk[i, 1, k, 1] = 3 * right[2, i, k] * by_jerk
            jerk[i, 1, k, 2] = right[3, i, k] * by_jerk
            smaller = scale[i, 1, k] if i == 0 else min(scale[i - 1, 1, k], scale[i, 1, k])
            acceleration[i, k, 0] = left[1, i, k] / (table[1, k] * smaller)
            acceleration[i, k, 1] = left[2, i, k] / (table[1, k] * smaller)


@numba.njit(cache=True)
def first_coefficients(h: FloatArray, bounds: FloatArray, v: FloatArray) -> FloatArray:
    """Start the interior point from the guessed speeds, a little below."""
    m = np.empty(len(h))
    for i in range(len(h)):
        middle = grid.speed_inside(h[i] / 2, h[i], v[i], v[i + 1], bounds[i])[0]
        m[i] = 0.8 * middle * middle
    return m


class Problem:
    """One stretch on its grid, with the limits that the corrections lower."""

    def __init__(
        self,
        path: AxisPath,
        table: FloatArray,
        start: tuple[float, float],
        options: PlanOptions,
        kept: FloatArray,
    ):
        self.path, self.table, self.options = path, table, options
        self.h = np.diff(path.s)
        n, n_axes = len(self.h), path.cell_left.shape[2]
        self.ends = np.array([start[0] ** 2, start[1], 0.0, 0.0])
        self.scale = np.empty((n, 4, n_axes))
        self.scale[:] = (1 - SLACK)[:, None]
        self.scale[: len(kept)] = np.minimum(kept + RELAXED[:, None], 1.0)
        self.aim, self.accepted = np.tile(AIM, (n, 1)), np.tile(ACCEPTED, (n, 1))
        self.aim[: len(kept)], self.accepted[: len(kept)] = AIM_KEPT, ACCEPTED_KEPT
        self.bounds = grid.speed_bounds(
            self.h, path.cell_left, path.cell_right, path.cell_feed, table
        )
        guess = grid.guess_speed(self.h, self.bounds, start[0], 0.0)
        self.m = first_coefficients(self.h, self.bounds, guess)
        self.jerk = np.empty((n, 2, n_axes, 3))
        self.acceleration = np.empty((n, n_axes, 2))
        self.use = np.empty((2, n, 4, n_axes))
        self.iterations = 0

    def reset_widths(self) -> FloatArray:
        """Start the effective widths: 1.5 h beside rest, else h."""
        width = self.h.copy()
        if self.ends[0] == 0.0:
            width[0] *= 1.5
        width[-1] *= 1.5
        return width

    def solve(self, m: FloatArray) -> Stretch | None:
        """Solve once with the present limits, from m, which takes the solution."""
        build_rows(
            self.path.cell_left,
            self.path.cell_right,
            self.table,
            self.scale,
            self.jerk,
            self.acceleration,
        )
        speed_scale = np.minimum(self.scale[:, 0].min(axis=1), self.scale[:, 3, 0])
        cap = (self.bounds[:, 0] * speed_scale) ** 2
        width = self.reset_widths()
        status, iterations, _ = solve(
            self.h,
            self.jerk,
            self.acceleration,
            cap,
            self.ends,
            m,
            width,
            self.options.gap,
            MOST_ITERATIONS,
            np.empty((0, 6)),
        )
        self.iterations += iterations
        if status == BROKEN:
            return None
        return self.check(m, width)

    def check(self, m: FloatArray, width: FloatArray) -> Stretch | None:
        """Turn coefficients into an exact law and see how far it uses the limits."""
        n = len(self.h)
        v, a, duration = np.empty(n + 1), np.empty(n + 1), np.empty(n)
        left = settle(self.h, m, width, self.ends, v, a, duration)
        if not (left < 1e-13 and np.all(np.isfinite(duration)) and duration.min() > 0):
            return None
        return self.measured(v, a, duration)

    def measured(self, v: FloatArray, a: FloatArray, duration: FloatArray) -> Stretch:
        """Evaluate the use of the limits by a law."""
        limit_use(
            self.h,
            self.path.cell_left,
            self.path.cell_right,
            self.path.cell_feed,
            v,
            a,
            duration,
            self.table,
            self.options.points,
            self.use,
        )
        worst = float((self.use[0].max(axis=2) / self.accepted).max())
        return Stretch(self.path, v, a, duration, worst, self.scale.copy())

    def lower(self) -> None:
        """
        Lower the limits of the cells where the last law passed them in between.

        Where the ends were not at their limit yet, the limit is brought down to their use first:
        else nothing would change.
        """
        inside, ends = self.use
        over = inside > self.accepted[:, :, None]
        reached = np.clip(ends, 0.5 * self.scale, self.scale)
        lowered = reached * self.aim[:, :, None] / np.where(over, inside, 1.0)
        self.scale = np.where(over, lowered, self.scale)

    def slowed(self, stretch: Stretch) -> Stretch | None:
        """Stretch the time of a law that starts at rest until it keeps all limits."""
        stretch = self.measured(stretch.v, stretch.a, stretch.duration)
        worst = self.use[0].max(axis=(0, 2)) / ACCEPTED * (1 + 1e-9)
        factor = max(1.0, worst[0], worst[1] ** 0.5, worst[2] ** (1 / 3), worst[3])
        if not np.isfinite(factor):
            return None
        return self.measured(stretch.v / factor, stretch.a / factor**2, stretch.duration * factor)


def plan(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float] = (0.0, 0.0),
    options: PlanOptions | None = None,
    kept: FloatArray | None = None,
) -> Stretch | None:
    """
    Plan from a state of motion to rest at the end of the path.

    Parameters
    ----------
    path : AxisPath
        Path without inner stops.
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    start : tuple of float
        s_dot and s_ddot at its start [m/s, m/s2].
    options : PlanOptions, optional
        Settings.
    kept : ndarray, shape (k, 4, n_axes), optional
        The first k cells are those of an older plan: they stay as they are and are given its
        parts of the limits and a little more, so that going on as planned remains possible.

    Returns
    -------
    Stretch or None
        A law that keeps every limit; None where none was found, which cannot happen from rest
        unless the path is not finite.

    """
    options = options or PlanOptions()
    if kept is None:
        kept = np.empty((0, 4, table.shape[1]))
    kept = kept[: len(path.s) - 1]
    fine = grid.planning_grid(
        path, table, start[0], options.cell_time, options.share, options.bend, len(kept)
    )
    problem = Problem(fine, table, start, options, kept)
    best: Stretch | None = None
    m = problem.m.copy()
    for attempt in range(options.passes + 1):
        stretch = problem.solve(m)
        if stretch is None:
            m = problem.m * 0.5 ** (attempt + 1)
            continue
        if stretch.use <= 1.0:
            return stretch
        if best is None or stretch.use < best.use:
            best = stretch
        problem.lower()
    if start[0] > 0.0:
        return None
    if best is None:
        best = problem.check(problem.m.copy(), problem.reset_widths())
    return None if best is None else problem.slowed(best)


def coarser(options: PlanOptions, factor: float) -> PlanOptions:
    """Change the cell times wanted by a factor."""
    low, high = options.cell_time
    return replace(
        options,
        cell_time=(low * factor, high * factor),
        share=options.share * factor,
        bend=options.bend * factor,
    )
