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

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.grid import PlanGrid, planning_grid
from cnc_interp.feedrate.interior_point import BROKEN, SOLVED, solve
from cnc_interp.feedrate.limits import limit_use
from cnc_interp.feedrate.speed_guess import speed_inside
from cnc_interp.feedrate.stretch import Stretch, settle, spread
from cnc_interp.kinematics.axis_path import AxisPath


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
    toppra : bool
        Start the jerk stage below the ceiling of the toppra stage.

    """

    passes: int = 6
    cell_time: tuple[float, float] = (2e-4, 6e-3)
    share: float = 1 / 64
    bend: float = 0.005
    gap: float = 5e-5
    points: int = 7
    window_ratio: float = 2.5
    window_cells: int = 4000
    toppra: bool = False

    def finer(self) -> PlanOptions:
        """Ask for half the cell times, and for a start below toppra's ceiling."""
        return replace(
            self,
            cell_time=(self.cell_time[0] / 2, self.cell_time[1] / 2),
            share=self.share / 2,
            bend=self.bend / 2,
            toppra=True,
        )


@dataclass(frozen=True)
class Kept:
    """
    The first cells of a stretch as an older plan had them, so that it stays possible.

    Parameters
    ----------
    ends : ndarray, shape (k,)
        Where they end [m].
    scale : ndarray, shape (k, 4, n_axes)
        Parts of the limits that they were given.

    """

    ends: FloatArray
    scale: FloatArray


SLACK = np.array([2e-4, 1e-3, 1e-3, 2e-5])
"""Part of each limit (velocity, acceleration, jerk, feed) kept free at the nodes."""

AIM, ACCEPTED = 1.0 - 0.8 * SLACK, 1.0 - 0.2 * SLACK
"""Use that a correction aims at; largest use, at the instants checked, that counts as kept."""

AIM_KEPT, ACCEPTED_KEPT, RELAXED = 1.0 - 0.1 * SLACK, np.ones(4), 0.25 * SLACK
"""The same, and the relaxation of the limits, in cells where an older plan must stay possible."""

OVERDONE = 1.3
"""Factor on the excess that a correction takes away: its neighbours take over a part of it."""

NEAR = 0.7
"""Part that must be left of every limit after a correction, else the next start is a cold one."""

MOST_ITERATIONS = 80

AROUND = 1
"""Cells on either side over which the first guess is smoothed."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def build_rows(
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    scale: FloatArray,
    rows: FloatArray,
) -> None:
    """Write the rows of the interior point: derivatives over the scaled limits."""
    n, n_axes = left.shape[1], left.shape[2]
    for i in range(n):
        for k in range(n_axes):
            by_jerk = 1.0 / (table[2, k] * scale[i, 2, k])
            rows[i, 0, 0, k] = left[1, i, k] * by_jerk
            rows[i, 0, 1, k] = 3 * left[2, i, k] * by_jerk
            rows[i, 0, 2, k] = left[3, i, k] * by_jerk
            rows[i, 1, 0, k] = right[1, i, k] * by_jerk
            rows[i, 1, 1, k] = 3 * right[2, i, k] * by_jerk
            rows[i, 1, 2, k] = right[3, i, k] * by_jerk
            smaller = scale[i, 1, k] if i == 0 else min(scale[i - 1, 1, k], scale[i, 1, k])
            rows[i, 2, 0, k] = left[1, i, k] / (table[1, k] * smaller)
            rows[i, 2, 1, k] = left[2, i, k] / (table[1, k] * smaller)
            rows[i, 2, 2, k] = 0.0


@numba.njit(cache=True, nogil=True, error_model='numpy')
def first_coefficients(h: FloatArray, bounds: FloatArray, v: FloatArray) -> FloatArray:
    """
    Start the interior point from the guessed speeds: their least, then their mean around a cell.

    No law follows the corners of the guess; a start that does takes a third more iterations.
    """
    n = len(h)
    squared, least, m = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        middle = speed_inside(h[i] / 2, h[i], v[i], v[i + 1], bounds[i])[0]
        squared[i] = middle * middle
    for i in range(n):
        least[i] = squared[max(i - AROUND, 0) : i + AROUND + 1].min()
    for i in range(n):
        m[i] = least[max(i - AROUND, 0) : i + AROUND + 1].mean()
    return m


class Problem:
    """One stretch on its grid, with the limits that the corrections lower."""

    def __init__(
        self,
        grid: PlanGrid,
        table: FloatArray,
        start: tuple[float, float],
        options: PlanOptions,
        kept: Kept,
    ):
        self.grid, self.table, self.options = grid, table, options
        path, nodes = grid.path, grid.nodes
        self.h = np.diff(path.s[nodes])
        n, n_axes, k = len(self.h), path.cell_left.shape[2], len(kept.ends)
        self.left = np.ascontiguousarray(path.cell_left[:, nodes[:-1]])
        self.right = np.ascontiguousarray(path.cell_right[:, nodes[1:] - 1])
        self.ends = np.array([start[0] ** 2, start[1], 0.0, 0.0])
        self.scale = np.empty((n, 4, n_axes))
        self.scale[:] = (1 - SLACK)[:, None]
        self.scale[:k] = np.minimum(kept.scale + RELAXED[:, None], 1.0)
        if k == 0 and start[0] > 0.0:
            # the state may come from a law that used all that this one may
            k = n
            self.scale += RELAXED[:, None]
        self.aim, self.accepted = np.tile(AIM, (n, 1)), np.tile(ACCEPTED, (n, 1))
        self.aim[:k], self.accepted[:k] = AIM_KEPT, ACCEPTED_KEPT
        guess = grid.guess
        if options.toppra:
            # toppra brings half a second of imports with it, and is seldom needed
            from cnc_interp.feedrate.toppra_stage import ceiling

            squared = ceiling(path, table, start[0])
            if squared is not None:
                guess = np.minimum(guess, 0.95 * np.sqrt(squared[nodes]))
        self.m = first_coefficients(self.h, grid.bounds, guess)
        self.rows = np.empty((n, 3, 3, n_axes))
        self.use = np.empty((2, n, 4, n_axes))
        self.slack = np.ones((n, 3 * n_axes + 2, 2))
        self.dual = np.zeros((n, 3 * n_axes + 2, 2))
        share = np.diff(path.s) / np.repeat(self.h, np.diff(nodes))
        self.points = 2 + np.ceil((options.points - 2) * share).astype(np.int64)

    def reset_widths(self) -> FloatArray:
        """Start the effective widths: 1.5 h beside rest, else h."""
        width = self.h.copy()
        if self.ends[0] == 0.0:
            width[0] *= 1.5
        width[-1] *= 1.5
        return width

    def solve(self, m: FloatArray, warm: bool) -> tuple[Stretch | None, bool]:
        """Solve with the present limits; m takes the solution. Tells whether it converged."""
        build_rows(self.left, self.right, self.table, self.scale, self.rows)
        part = np.minimum(self.scale[:, 0].min(axis=1), self.scale[:, 3, 0])
        cap = (self.grid.bounds[:, 0] * part) ** 2
        width = self.reset_widths()
        status, _, _ = solve(
            self.h,
            self.rows,
            cap,
            self.ends,
            m,
            width,
            self.slack,
            self.dual,
            warm,
            self.options.gap,
            MOST_ITERATIONS,
            np.empty((0, 6)),
        )
        return (None if status == BROKEN else self.check(m, width)), status == SOLVED

    def check(self, m: FloatArray, width: FloatArray) -> Stretch | None:
        """Turn coefficients into an exact law and see how far it uses the limits."""
        n = len(self.h)
        v, a, duration = np.empty(n + 1), np.empty(n + 1), np.empty(n)
        left = settle(self.h, m, width, self.ends, v, a, duration)
        if not (left < 1e-13 and np.all(np.isfinite(duration)) and duration.min() > 0):
            return None
        return self.measured(v, a, duration)

    def measured(self, v: FloatArray, a: FloatArray, duration: FloatArray) -> Stretch:
        """Spread a law over the cells of the path and evaluate its use of the limits."""
        path, nodes = self.grid.path, self.grid.nodes
        cells, n_axes = len(path.s) - 1, path.cell_left.shape[2]
        fine = np.empty(cells + 1), np.empty(cells + 1), np.empty(cells), np.empty(cells)
        spread(path.s, nodes, v, a, duration, *fine)
        use = np.empty((2, cells, 4, n_axes))
        limit_use(
            np.diff(path.s),
            path.cell_left,
            path.cell_right,
            path.cell_feed,
            *fine,
            self.table,
            self.points,
            use,
        )
        self.use[0] = np.maximum.reduceat(use[0], nodes[:-1], axis=0)
        self.use[1] = use[1, nodes[:-1]]
        np.maximum(self.use[1], use[1, nodes[1:] - 1], out=self.use[1])
        worst = float((self.use[0].max(axis=2) / self.accepted).max())
        return Stretch(path, *fine, nodes, self.scale.copy(), worst)

    def lower(self) -> bool:
        """
        Lower the limits of the cells where the last law passed them in between.

        Where the ends were not at their limit yet, the limit is brought down to their use first:
        else nothing would change. Tells whether the last solution is still a good start.
        """
        inside, ends = self.use
        over = inside > self.accepted[:, :, None]
        reached = np.clip(ends, 0.5 * self.scale, self.scale)
        less = self.aim[:, :, None] / np.where(over, 1 + OVERDONE * (inside - 1), 1.0)
        lowered = np.where(over, reached * less, self.scale)
        near = bool((lowered > NEAR * self.scale).all())
        self.scale = lowered
        return near

    def slowed(self, stretch: Stretch) -> Stretch:
        """Stretch the time of a law that starts at rest until it keeps all limits."""
        nodes = self.grid.nodes
        v, a = stretch.v[nodes], stretch.a[nodes]
        duration = np.add.reduceat(stretch.duration, nodes[:-1])
        self.measured(v, a, duration)
        worst = self.use[0].max(axis=(0, 2)) / ACCEPTED * (1 + 1e-9)
        factor = max(1.0, worst[0], worst[1] ** 0.5, worst[2] ** (1 / 3), worst[3])
        return self.measured(v / factor, a / factor**2, duration * factor)


def plan(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float] = (0.0, 0.0),
    options: PlanOptions | None = None,
    kept: Kept | None = None,
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
    kept : Kept, optional
        First cells of an older plan. They are given its parts of the limits and a little more, so
        that going on as planned remains possible.

    Returns
    -------
    Stretch or None
        A law that keeps every limit; None where none was found, which cannot happen from rest
        unless the path is not finite.

    """
    options = options or PlanOptions()
    kept = kept or Kept(np.empty(0), np.empty((0, 4, table.shape[1])))
    inside = int(np.searchsorted(kept.ends, path.s[-1]))
    kept = Kept(kept.ends[:inside], kept.scale[:inside])
    grid = planning_grid(
        path, table, start, options.cell_time, options.share, options.bend, kept.ends
    )
    problem = Problem(grid, table, start, options, kept)
    best: Stretch | None = None
    kept_all: Stretch | None = None
    m, warm = problem.m.copy(), False
    for attempt in range(options.passes + 1):
        stretch, converged = problem.solve(m, warm)
        warm = converged
        if stretch is not None and stretch.use <= 1.0:
            if converged:
                return stretch
            # within the limits, but who knows how far from the optimum
            if kept_all is None or stretch.duration.sum() < kept_all.duration.sum():
                kept_all = stretch
        elif stretch is not None:
            if best is None or stretch.use < best.use:
                best = stretch
            warm = problem.lower() and converged
        if not warm:
            m = problem.m * (1.0 if converged else 2.0 if attempt % 2 == 0 else 0.3)
    if kept_all is not None or start[0] > 0.0:
        return kept_all
    if best is None:
        best = problem.check(problem.m.copy(), problem.reset_widths())
    slow = None if best is None else problem.slowed(best)
    return slow if slow is not None and np.isfinite(slow.use) else None
