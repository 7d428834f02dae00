"""The jerk stage: plans one part of the path within all limits and checks it between the nodes.

The interior point method applies the limits only at the two ends of each cell. Then the use of
each limit on the true curve is bounded at all instants of every cell. Where a bound exceeds a
limit, the limit of the cell falls by the excess, and the part is solved again, or only the cells
around few such ones. A law is accepted only if its bounds keep every limit.

A law must leave something to brake with, too. On a circle of radius r at speed v, the jerk of an
axis, q_s s_dddot + 3 q_ss s_dot s_ddot + q_sss s_dot^3 [B2013, Eq. 8], is v^3/r^2 by its last term
alone. A law that spends the whole limit on it, all the way round, has no short stop; likewise
with the acceleration. The braking left at a state is the most negative s_dddot (s_ddot) that
every axis allows, divided by that on a straight line. Short losses do no harm, as the machine goes
on as planned until it can brake. So the mean over ``LASTING`` seconds counts.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import ACCELERATION, COULOMB, DRIVE, has_loads, limit_at
from cnc_interp.feedrate.barrier_rows import Iterate
from cnc_interp.feedrate.grid import PlanGrid, planning_grid
from cnc_interp.feedrate.interior_point import BROKEN, SOLVED, solve
from cnc_interp.feedrate.jerk_rows import build_rows
from cnc_interp.feedrate.limit_use import limit_use
from cnc_interp.feedrate.motion_law import CellLaw, Stretch, settle_widths, spread_law
from cnc_interp.feedrate.planner_tuning import KeptCells, PlanOptions
from cnc_interp.feedrate.speed_guess import speed_inside
from cnc_interp.feedrate.time_bound import time_bound
from cnc_interp.kinematics.axis_path import AxisPath, PathCells

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit

LASTING = 0.25  #: Time without braking that a law may take [s].
LEAST = 0.15  #: Smallest mean of the braking left, relative to a straight line [-].
#: Part of each limit (velocity, acceleration, jerk, feed) that stays unused at the nodes.
SLACK = np.array([2e-4, 1e-3, 1e-3, 2e-5])
#: Use of a limit after a correction, and the largest accepted use at the checked instants.
AIM, ACCEPTED = 1.0 - 0.8 * SLACK, 1.0 - 0.2 * SLACK
#: The same two for cells of an older plan, and the part by which their limits are relaxed.
AIM_KEPT, ACCEPTED_KEPT, RELAXED = 1.0 - 0.1 * SLACK, np.ones(4), 0.25 * SLACK
TOOL_PASSES = 8  #: Further corrections where the error at the tool is limited.
#: Factor on the excess in the first correction of a cell, because neighbouring cells take over a
#: part of it; and its growth with each further correction, where they take over more.
EXCESS_FACTOR, HARDER = 1.3, 1.6
#: Smallest part of every limit after a correction that still allows a warm start.
WARM_START_PART = 0.7
MOST_ITERATIONS = 80
MARGIN = 120  #: Number of cells before and after a corrected cell that are solved again with it.
FEW = 0.5  #: Largest part of all cells that is solved again instead of all.
NO_ROWS = np.empty((0, 4, 0))  #: Rows of a tool whose error has no limit.
SMOOTHING_CELLS = 1  #: Number of cells on either side over which the first guess is smoothed.


@njit(cache=True, nogil=True, error_model='numpy')
def _braking_left(jet: FloatArray, v: FloatArray, a: FloatArray, table: FloatArray) -> FloatArray:
    """Return the braking left at states, relative to a straight line, shape (2, n) [-]."""
    n, n_axes = len(v), jet.shape[2]
    out = np.ones((2, n))
    for i in range(n):
        for row in range(2):
            least, straight = np.inf, np.inf
            for k in range(n_axes):
                q_s, q_ss, q_sss = jet[1, i, k], jet[2, i, k], jet[3, i, k]
                slope = abs(q_s)
                limit = limit_at(table, ACCELERATION + row, k, jet[0, i, k])
                if row == 0:
                    limit = min(limit, table[DRIVE, k, 0] + table[COULOMB, k, 0])
                # An axis that hardly moves along the path allows any deceleration.
                if not limit / slope < np.inf:
                    continue
                bent = q_ss * v[i] * v[i]
                if row == 1:
                    bent = 3 * q_ss * v[i] * a[i] + q_sss * v[i] ** 3
                least = min(least, (limit + np.sign(q_s) * bent) / slope)
                straight = min(straight, limit / slope)
            if straight < np.inf:
                out[row, i] = min(max(least / straight, 0.0), 1.0)
    return out


def without_braking(
    jet: FloatArray, v: FloatArray, a: FloatArray, duration: FloatArray, table: FloatArray
) -> BoolArray:
    """Find the cells of a law in which braking is not possible for long."""
    found, part = np.zeros((2, len(duration)), dtype=bool), _braking_left(jet, v, a, table)
    if part.min() >= LEAST:
        return found
    time = np.concatenate([[0.0], np.cumsum(duration)])
    for row in np.flatnonzero(part.min(axis=1) < LEAST) if time[-1] >= LASTING else ():
        left = part[row]
        so_far = np.concatenate([[0.0], np.cumsum(left * duration)])
        ends = np.minimum(time[:-1] + LASTING, time[-1])
        begins = ends - LASTING
        mean = (np.interp(ends, time, so_far) - np.interp(begins, time, so_far)) / LASTING
        low = np.flatnonzero(mean < LEAST)
        count = np.zeros(len(duration) + 1)
        np.add.at(count, np.searchsorted(time, begins[low], side='right') - 1, 1)
        np.add.at(count, np.minimum(np.searchsorted(time, ends[low]), len(duration)), -1)
        found[row] = np.cumsum(count[:-1]) > 0
    return found


@njit(cache=True, nogil=True, error_model='numpy')
def _cells(
    path: PathCells, nodes: IntArray, bounds: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return widths, both ends and first coefficients of the planner cells.

    The coefficients are a moving minimum, then a mean, as no law follows corners.
    """
    s, left, right, _ = path
    n, h = len(nodes) - 1, s[nodes[1:]] - s[nodes[:-1]]
    first, last = np.empty((4, n, left.shape[2])), np.empty((4, n, left.shape[2]))
    for i in range(n):
        first[:, i], last[:, i] = left[:, nodes[i]], right[:, nodes[i + 1] - 1]
    squared, least, m = np.empty(n), np.empty(n), np.empty(n)
    for i in range(n):
        middle = speed_inside(h[i] / 2, h[i], v[i], v[i + 1], bounds[i])[0]
        squared[i] = middle * middle
    for i in range(n):
        least[i] = squared[max(i - SMOOTHING_CELLS, 0) : i + SMOOTHING_CELLS + 1].min()
    for i in range(n):
        m[i] = least[max(i - SMOOTHING_CELLS, 0) : i + SMOOTHING_CELLS + 1].mean()
    return h, first, last, m


class PlanCells(NamedTuple):
    """The n planner cells of a stretch, with the limits that they may use."""

    h: FloatArray  #: (n,): Widths [m].
    left: FloatArray  #: (4, n, n_axes): q, q_s, q_ss, q_sss at both ends.
    right: FloatArray
    scale: FloatArray  #: (n, 4, n_axes): Parts of each limit [-].
    bounds: FloatArray  #: (n, 6): As of ``speed_bounds``.


@njit(cache=True, nogil=True, error_model='numpy')
def solve_cells(
    span: tuple[int, int],
    cells: PlanCells,
    table: FloatArray,
    ends: FloatArray,
    more: FloatArray,
    point: Iterate,
    warm: bool,
    gap: float,
) -> int:
    """Solve a span of cells between two states; ``more`` are rows of the tool.

    The ``point`` of all cells is the starting point there, then the solution.
    """
    (first, end), n_axes = span, cells.left.shape[2]
    some, count = slice(first, end), end - first
    some_scale, fast = cells.scale[some], cells.bounds[some, 4:].copy()
    places = (len(point.slack) - 2) // (2 * (n_axes + len(more)))
    rows = np.zeros((n_axes + len(more), 13 if places > 3 else 9, count))
    some_left, some_right, some_slack, some_dual = (
        np.ascontiguousarray(cells.left[:, some]),
        np.ascontiguousarray(cells.right[:, some]),
        np.ascontiguousarray(point.slack[:, some]),
        np.ascontiguousarray(point.dual[:, some]),
    )
    build_rows(some_left, some_right, table, some_scale, rows[:n_axes])
    if len(more) > 0 and count > 2:
        # The first node of the solved cells is given.
        rows[n_axes:, 9:, 1:] = more[:, :, first + 1 : end]
    # The velocity limit is linear inside the cell, so these are the Bezier points of b.
    caps = np.empty((count, 2))
    for i in range(count):
        fast[i] *= min(some_scale[i, 0].min(), some_scale[i, 3, 0])
    for i in range(count):
        node = fast[i, 0] if i == 0 else min(fast[i, 0], fast[i - 1, 1])
        caps[i, 0], caps[i, 1] = fast[i, 0] * fast[i, 1], node * node
    part = Iterate(point.m[some], point.width[some], some_slack, some_dual)
    status, _, _ = solve(cells.h[some], rows, caps, ends, part, warm, gap, MOST_ITERATIONS)
    if status != BROKEN:
        point.slack[:, some], point.dual[:, some] = some_slack, some_dual
    return status


@njit(cache=True, nogil=True, error_model='numpy')
def _spread(
    path: PathCells,
    nodes: IntArray,
    law: tuple[FloatArray, FloatArray, FloatArray],
    table: FloatArray,
    accepted: FloatArray,
    fresh: BoolArray,
    use: FloatArray,
) -> tuple[CellLaw, float]:
    """Spread a law over the path cells; write the use of the limits in ``fresh`` planner cells."""
    cells, n_axes, worst = len(path.feed), path.left.shape[2], 0.0
    v, a, duration = law
    spread = spread_law(path.s, nodes, v, a, duration)
    all_use, all_fresh = np.empty((2, cells, 4, n_axes)), np.empty(cells, dtype=np.bool_)
    for i in range(len(nodes) - 1):
        all_fresh[nodes[i] : nodes[i + 1]] = fresh[i]
    limit_use(path, spread, table, ACCEPTED, all_fresh, all_use)
    for i in range(len(nodes) - 1):
        for row in range(4):
            for k in range(n_axes):
                most = all_use[0, nodes[i], row, k]
                for c in range(nodes[i] + 1, nodes[i + 1]):
                    most = np.maximum(most, all_use[0, c, row, k])
                start, end = all_use[1, nodes[i], row, k], all_use[1, nodes[i + 1] - 1, row, k]
                if fresh[i]:
                    use[0, i, row, k], use[1, i, row, k] = most, np.maximum(start, end)
                worst = np.maximum(worst, use[0, i, row, k] / accepted[i, row])
    return spread, worst


def _spans_around(changed: BoolArray) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for cell in np.flatnonzero(changed).tolist():
        first, end = max(cell - MARGIN, 0), min(cell + MARGIN + 1, len(changed))
        if found and first <= found[-1][1]:
            first = found.pop()[0]
        found.append((first, end))
    return found


class StretchProblem:
    """One stretch on its grid, with the limits that the corrections lower; see ``plan``."""

    def __init__(
        self,
        grid: PlanGrid,
        table: FloatArray,
        start: tuple[float, float],
        options: PlanOptions,
        kept: KeptCells,
        tool: ToolLimit | None = None,
    ):
        self.grid, self.table, self.options = grid, table, options
        path, nodes, guess = grid.path, grid.nodes, grid.guess
        if options.below_ceiling:
            squared = time_bound(path, nodes, table, start[0] ** 2, True).squared
            guess = np.minimum(guess, 0.95 * np.sqrt(squared[nodes]))
        self.h, self.left, self.right, self.m = _cells(path.cells, nodes, grid.bounds, guess)
        n, n_axes, k = len(self.h), path.cell_left.shape[2], len(kept.ends)
        self.m[: len(kept.m)] = kept.m
        self.ends = np.array([start[0] ** 2, start[1], 0.0, 0.0])
        self.scale = np.empty((n, 4, n_axes))
        self.scale[:] = (1 - SLACK)[:, None]
        self.scale[:k] = np.minimum(kept.scale + RELAXED[:, None], 1.0)
        if k == 0 and start[0] > 0.0:
            # The start state may come from a law with the full limits, so these are relaxed.
            k = n
            self.scale += RELAXED[:, None]
        self.factor = np.full(n, EXCESS_FACTOR)
        self.aim, self.accepted = np.empty((n, 4)), np.empty((n, 4))
        self.aim[k:], self.accepted[k:] = AIM, ACCEPTED
        self.aim[:k], self.accepted[:k] = AIM_KEPT, ACCEPTED_KEPT
        self.use = np.empty((2, n, 4, n_axes))
        self.loaded = has_loads(table)
        self.tool = None if tool is None else tool.stretch_rows(self.left, self.right, kept.tool)
        self.more_rows = 0 if self.tool is None else len(self.tool.rows)
        self.places = 4 if self.loaded or self.tool is not None else 3
        self.slack = np.ones((2 * self.places * (n_axes + self.more_rows) + 2, n))
        self.dual = np.zeros(self.slack.shape)
        self.changed = np.zeros(n, dtype=np.bool_)  # cells whose limits fell since the last law
        self.width, self.v, self.a = self.h, np.zeros(n + 1), np.zeros(n + 1)  # of the last law

    def reset_widths(self) -> FloatArray:
        """Return the initial effective widths [m]: 1.5 h in a cell at rest, else h."""
        width = self.h.copy()
        if self.ends[0] == 0.0:
            width[0] *= 1.5
        width[-1] *= 1.5
        return width

    def solve(self, m: FloatArray, warm: bool) -> tuple[Stretch | None, bool]:
        """Solve from ``m``, which becomes the solution; ``warm``: from the last slacks and duals.

        Returns the law with its use of the limits, None after a breakdown, and whether it
        converged.
        """
        changed, self.changed = self.changed, np.zeros_like(self.changed)
        spans = _spans_around(changed) if warm else []
        if spans and sum(end - first for first, end in spans) <= FEW * len(m):
            tried, width = m.copy(), self.width.copy()
            if all(self._solve_cells(*span, tried, width, True) == SOLVED for span in spans):
                m[:] = tried
                return self.check(m, width, spans), True
        width = self.reset_widths()
        status = self._solve_cells(0, len(m), m, width, warm)
        return (None if status == BROKEN else self.check(m, width)), status == SOLVED

    def _solve_cells(
        self, first: int, end: int, m: FloatArray, width: FloatArray, warm: bool
    ) -> int:
        """Solve some cells between the states of the last law, or the ends of the stretch."""
        ends = self.ends.copy()
        if first > 0:
            ends[:2] = self.v[first] ** 2, self.a[first]
        if end < len(m):
            ends[2:] = self.v[end] ** 2, self.a[end]
        more = NO_ROWS if self.tool is None else self.tool.within_parts()
        cells = PlanCells(self.h, self.left, self.right, self.scale, self.grid.bounds)
        point, gap = Iterate(m, width, self.slack, self.dual), self.options.gap
        return int(solve_cells((first, end), cells, self.table, ends, more, point, warm, gap))

    def keep_tool(self, stretch: Stretch) -> tuple[Stretch, bool]:
        if self.tool is None:
            return stretch, False
        part = self.tool.part
        use, less = self.tool.lower(stretch)
        self.changed |= less
        return replace(stretch, tool=part, tool_use=use), bool(less.any())

    def check(
        self, m: FloatArray, width: FloatArray, spans: list[tuple[int, int]] | None = None
    ) -> Stretch | None:
        """Turn coefficients and widths, which settle, into an exact law; None if there is none.

        With ``spans`` of cells, the law in all others is the last one.
        """
        n = len(self.h)
        v, a, duration = np.empty(n + 1), np.empty(n + 1), np.empty(n)
        if not settle_widths(self.h, m, width, self.ends, v, a, duration) < 1e-13:
            return None
        self.width, self.v, self.a = width, v, a
        fresh = np.full(n, spans is None)
        for first, end in spans or ():
            fresh[first:end] = True
        return self.with_limit_use(v, a, duration, fresh)

    def with_limit_use(
        self, v: FloatArray, a: FloatArray, duration: FloatArray, fresh: BoolArray
    ) -> Stretch:
        path, nodes, law = self.grid.path, self.grid.nodes, (v, a, duration)
        spread, worst = _spread(path.cells, nodes, law, self.table, self.accepted, fresh, self.use)
        law_of_cells = spread.v, spread.a, spread.jerk, spread.duration
        return Stretch(path, *law_of_cells, nodes, self.scale.copy(), worst)

    def lower_limits(self) -> bool:
        """Lower limits where the last law exceeded them; tell whether it is still a good start.

        If the ends of such a cell did not use their full limit, it first falls to the use there.
        """
        over = self.use[0] > self.accepted[:, :, None]
        cells = np.flatnonzero(over.any(axis=(1, 2)))
        over, (inside, ends), scale = over[cells], self.use[:, cells], self.scale[cells]
        reached, factor = np.clip(ends, 0.5 * scale, scale), self.factor[cells, None, None]
        less = self.aim[cells, :, None] / np.where(over, 1 + factor * (inside - 1), 1.0)
        # Below 1, an excess over what is accepted turns a grown factor round: limits would rise.
        less = np.where(less < self.accepted[cells, :, None], less, 1 - factor * SLACK[:, None])
        self.factor[cells] *= HARDER
        lowered = np.where(over, reached * less, scale)
        self.changed[cells] |= (lowered < scale).any(axis=(1, 2))
        self.scale[cells] = lowered
        return bool((lowered > WARM_START_PART * scale).all())

    def keep_reserve(self, stretch: Stretch) -> bool:
        """Lower the limits where a law cannot brake, so that a short stop exists from it."""
        if not self.options.reserve > 0.0:
            return False
        nodes = self.grid.nodes
        v, a = stretch.v[nodes[:-1]], stretch.a[nodes[:-1]]
        duration = np.add.reduceat(stretch.duration, nodes[:-1])
        found = without_braking(self.left, v, a, duration, self.table)
        if not found.any():
            return False
        most = ((1 - SLACK) * (1 - self.options.reserve))[1:3, None]
        lowered = np.where(found.T[:, :, None], np.minimum(self.scale[:, 1:3], most), np.inf)
        lower = lowered < self.scale[:, 1:3]
        self.scale[:, 1:3] = np.where(lower, lowered, self.scale[:, 1:3])
        self.changed |= lower.any(axis=(1, 2))
        return bool(lower.any())

    def slowed(self, stretch: Stretch) -> Stretch:
        """Scale the time of a law that starts at rest until it keeps all limits."""
        nodes = self.grid.nodes
        v, a = stretch.v[nodes], stretch.a[nodes]
        duration = np.add.reduceat(stretch.duration, nodes[:-1])
        every = np.ones(len(duration), dtype=np.bool_)
        self.with_limit_use(v, a, duration, every)
        worst = self.use[0].max(axis=(0, 2)) / ACCEPTED * (1 + 1e-9)
        # Viscous friction falls with the speed only.
        second = worst[1] if self.loaded else worst[1] ** 0.5
        factor = max(1.0, worst[0], second, worst[2] ** (1 / 3), worst[3])
        return self.with_limit_use(v / factor, a / factor**2, duration * factor, every)


def _better(one: Stretch, other: Stretch) -> bool:
    """Return whether a law keeps the tool's error limit better, or is faster within it."""
    off = max(one.tool_use, 1.0), max(other.tool_use, 1.0)
    return off[0] < off[1] or (off[0] == off[1] and one.duration.sum() < other.duration.sum())


def plan(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float] = (0.0, 0.0),
    options: PlanOptions | None = None,
    kept: KeptCells | None = None,
    tool: ToolLimit | None = None,
) -> Stretch | None:
    """Plan from a state of motion to rest at the end of the path."""
    options = options or PlanOptions()
    kept = kept or KeptCells(np.empty(0), np.empty((0, 4, table.shape[1])), np.empty(0))
    kept = kept.before(path.s[-1])
    grid = planning_grid(
        path, table, start, options.cell_time, options.share, options.bend, kept.ends
    )
    problem = StretchProblem(grid, table, start, options, kept, tool)
    best: Stretch | None = None
    kept_all: Stretch | None = None
    m, warm, reserved = problem.m.copy(), False, False
    passes = options.passes + (TOOL_PASSES if tool is not None else 0)
    for attempt in range(passes + 1):
        stretch, converged = problem.solve(m, warm)
        warm = converged
        if stretch is not None and stretch.use <= 1.0:
            reserve = converged and not reserved and problem.keep_reserve(stretch)
            stretch, less = problem.keep_tool(stretch)
            if converged and not reserve and not less:
                return stretch
            reserved = reserved or converged
            # This law keeps the limits, but its distance to the optimum is unknown.
            stretch = replace(stretch, converged=converged)
            if kept_all is None or _better(stretch, kept_all):
                kept_all = stretch
        elif stretch is not None:
            if best is None or stretch.use < best.use:
                best = stretch
            warm = problem.lower_limits() and converged
        if not warm:
            m = problem.m * (1.0 if converged else 2.0 if attempt % 2 == 0 else 0.3)
    if kept_all is not None or start[0] > 0.0:
        return kept_all
    if best is None:
        best = problem.check(problem.m.copy(), problem.reset_widths())
    slow = None if best is None else replace(problem.slowed(best), converged=False)
    return slow if slow is not None and np.isfinite(slow.use) else None
