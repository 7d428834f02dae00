"""Planning windows: the feed planner for a path that arrives in parts.

Every plan ends at rest at the end of the known path. When a window is full, it is planned, and
the first part of its plan is committed for good. The rest is planned again in the next window.
Windows depend only on the path, not on how it was divided or when it arrived. So the same path
always gives the same bits.

If the solver does not converge, its law keeps the limits but may be far too slow. Then the window
is divided by a rest where that law is slowest, if this is faster.

A window fails if no law within the limits was found from the committed state. Then half of the
older plan, which ends at rest, is committed instead, and after a second failure all of it. If even
this is impossible, the path is rejected with its block after a stop before it.

Where a window ends, and how much of it is committed, follows from stopping distances. Several of
them lie between a committed state and the stop at the end of the plan: then more path would
hardly have made it faster. One window holds a few such horizons.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import FloatArray, PlanningError
from cnc_interp.core.axis_limits import Limits
from cnc_interp.core.kernels import njit
from cnc_interp.feedrate import jerk_stage
from cnc_interp.feedrate.grid import with_kinks
from cnc_interp.feedrate.motion_law import MotionLaw, Stretch
from cnc_interp.feedrate.planner_tuning import KeptCells, PlanOptions
from cnc_interp.feedrate.speed_guess import reach, speed_bounds
from cnc_interp.feedrate.time_bound import time_bound
from cnc_interp.kinematics.axis_path import AxisPath, PathCells, cut, refine
from cnc_interp.machine_model.machine import Machine, limits_of

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit

HORIZON = 3.0  #: Stopping distances between a committed state and the end of its plan [-].
#: Cells shorter than this time [s] are grouped, so they count in part; the smallest part [-].
SHORT, LEAST = 2e-4, 1 / 8
#: Time added to every stop in a horizon [s]. Without it, slow windows would be ramps only.
SETTLE = 0.1
AT_REST = (0.0, 0.0)
#: Largest number of path cells in a part that is handled as one.
PART = 512
CONVERGED, DIVIDED, NOT_CONVERGED, OLDER = 'converged', 'divided', 'not converged', 'older plan'
#: How the law of a committed piece was found. A divided window has one rest more.
SOLVED_BY = (CONVERGED, DIVIDED, NOT_CONVERGED, OLDER)
MOST_RESTS = 8  #: Most places at which a window is divided until its first part converges.
KEPT_PART = 0.5  #: Part of the horizon in which the next window keeps the older plan's cells.


@njit(cache=True, nogil=True, error_model='numpy')
def _stopping_distance(v: float, acceleration: float, jerk: float) -> float:
    """Return an upper bound of the stopping distance from speed v along a straight path [m]."""
    return float(v * (SETTLE + np.sqrt(v / jerk)) + v * v / (2 * acceleration))


@njit(cache=True, nogil=True, error_model='numpy')
def _window_end(
    path: PathCells,
    table: FloatArray,
    last: int,
    ratio: float,
    most_cells: int,
    state: FloatArray,
) -> int:
    """Continue the search for the window end up to a grid point; return its own, or -1.

    It is full after ``ratio`` horizons at the fastest speed of an optimistic guess, or after
    ``most_cells``. ``state``: start [m], guessed speed, longest stopping distance [m], cells
    counted.
    """
    s, left, right, feed = path
    bounds = speed_bounds(s[1 : last + 1] - s[:last], left, right, feed, table)
    for i in range(last):
        # The guess uses twice the jerk and more acceleration: a window may be too long, not short.
        v = reach(state[1], s[i + 1] - s[i], 2 * bounds[i, 2], 4 * bounds[i, 3])
        v = min(bounds[i, 1], v)
        state[1] = v
        state[2] = max(state[2], _stopping_distance(v, bounds[i, 2], bounds[i, 3]))
        state[3] += min(1.0, max(LEAST, (s[i + 1] - s[i]) / (v * SHORT)))
        if s[i + 1] - state[0] >= ratio * HORIZON * state[2] or state[3] >= most_cells:
            return i + 1
    return -1


@njit(cache=True, nogil=True, error_model='numpy')
def commit_node(path: PathCells, table: FloatArray, v: FloatArray) -> int:
    """Find the last grid point with a whole horizon between it and the end of the plan."""
    s, left, right, feed = path
    bounds = speed_bounds(s[1:] - s[:-1], left, right, feed, table)
    n = len(bounds)
    farthest = 0.0
    for i in range(n - 1, 0, -1):
        speed = max(v[i], v[i + 1])
        farthest = max(farthest, _stopping_distance(speed, bounds[i, 2], bounds[i, 3]))
        if s[n] - s[i] >= HORIZON * farthest:
            return i
    return 0


class WindowScan:
    """Find the end of a planning window while its path arrives; each cell is examined once."""

    def __init__(self, table: FloatArray, v_start: float, ratio: float, most_cells: int):
        self.table, self.ratio, self.most_cells = table, ratio, most_cells
        self.state = np.array([np.nan, v_start, 0.0, 0.0])
        self.cells = 0
        self.full: int | None = None
        self.stop: int | None = None

    @property
    def crowded(self) -> bool:
        return bool(self.state[3] >= self.most_cells)

    def extend(self, part: AxisPath) -> None:
        if self.cells == 0:
            self.state[0] = part.s[0]
        elif part.stop[0] and self.stop is None:
            self.stop = self.cells
        before = self.cells
        self.cells += len(part.s) - 1
        if self.stop is not None:
            return
        stops = np.flatnonzero(part.stop[1:])
        last = int(stops[0]) + 1 if len(stops) else len(part.s) - 1
        if len(stops):
            self.stop = before + last
        if self.full is not None:
            return
        within = self.ratio, self.most_cells
        found = _window_end(part.cells, self.table, last, *within, self.state)
        if found > 0:
            self.full = before + found

    def end(self, finished: bool) -> tuple[int, bool] | None:
        """Return the last grid point of the window and whether the motion must rest there.

        None if the window is full exactly at the last known point, which may turn out to be a
        stop.
        """
        full, stop = self.full, self.stop
        if full is not None and full < (self.cells if stop is None else stop):
            return full, False
        if stop is not None:
            return stop, True
        return (self.cells, True) if finished else None


@dataclass(frozen=True)
class PlannedPiece:
    path: AxisPath  #: The path on the grid of the planner.
    law: MotionLaw  #: The law along it, one piece per path cell; its clock continues.
    #: No motion within feed, velocities and accelerations is faster here [s]; 0 if not computed.
    least_time: float = 0.0
    solved: str = CONVERGED  #: One of ``SOLVED_BY``.

    @staticmethod
    def join(parts: list[PlannedPiece]) -> PlannedPiece:
        laws, first_cell = [], 0
        for part in parts:
            laws.append(replace(part.law, cell=part.law.cell + first_cell))
            first_cell += len(part.path.s) - 1
        least = sum(part.least_time for part in parts)
        solved = max((part.solved for part in parts), key=SOLVED_BY.index)
        path = AxisPath.join([part.path for part in parts])
        return PlannedPiece(path, MotionLaw.concatenate(laws), least, solved)


def _unsound_cell(path: AxisPath) -> int | None:
    sound = np.isfinite(path.cell_left).all(axis=(0, 2)) & (path.cell_feed > 0.0)
    sound &= np.isfinite(path.cell_right).all(axis=(0, 2)) & (np.diff(path.s) > 0.0)
    return None if sound.all() else int(np.argmin(sound))


class FeedPlanner:
    """Plan a path arriving in parts, from a state ``start`` of a law within the same limits."""

    def __init__(
        self,
        limits: Machine | Limits,
        options: PlanOptions | None = None,
        start: tuple[float, float] = AT_REST,
        time: float = 0.0,
        tool: ToolLimit | None = None,
    ):
        self.options = options or PlanOptions()
        self._table = limits_of(limits).table
        self._parts: list[AxisPath] = []
        self._start = start
        self._fastest_sq = start[0] ** 2  # no motion from the start of the path is faster here
        self._kept: KeptCells | None = None
        self._time = time
        self._older: Stretch | None = None
        self._failed = False
        self._problem: PlanningError | None = None
        self._tool = tool  # with the drives at the start of the path
        self._scan_again(self.options.window_ratio)

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        """Add the next part of the path; return the motion of the windows that are now full.

        If the path cannot be continued, the motion ends at rest before the faulty block, and the
        next call raises PlanningError.
        """
        self.refuse()
        bad = _unsound_cell(path)
        known = with_kinks(path if bad is None else cut(path, 0, bad), self._table)
        last = len(known.s) - 1
        self._parts += [cut(known, i, min(i + PART, last)) for i in range(0, last, PART)]
        if bad is None:
            return self._plan_windows(finished=False)
        block = int(path.cell_block[bad])
        self._problem = PlanningError(
            f'block {block} has no finite path with a positive feed: check its coordinates and F'
        )
        pieces = self._plan_windows(finished=True)
        if not pieces:
            self.refuse()
        return pieces

    def finish(self) -> list[PlannedPiece]:
        """Plan the rest of the path down to rest, or raise PlanningError; another may follow."""
        self.refuse()
        pieces = self._plan_windows(finished=True)
        self._parts, self._start, self._kept, self._older = [], AT_REST, None, None
        self._fastest_sq = 0.0
        self._scan_again(self.options.window_ratio)
        return pieces

    @property
    def stuck(self) -> bool:
        """Whether the next call raises because the path cannot be continued."""
        return self._problem is not None

    def refuse(self) -> None:
        """Raise the error of an earlier call, after the motion before it was returned."""
        if self._problem is not None:
            raise self._problem

    def _scan_again(self, ratio: float) -> None:
        self._scan = WindowScan(self._table, self._start[0], ratio, self.options.window_cells)
        self._scanned = 0

    def _front(self, cells: int) -> AxisPath:
        count, held = 0, 0
        while held < cells:
            held += len(self._parts[count].s) - 1
            count += 1
        self._parts[:count] = [AxisPath.join(self._parts[:count])]
        return self._parts[0]

    def _plan_windows(self, finished: bool) -> list[PlannedPiece]:
        pieces: list[PlannedPiece] = []
        while self._parts:
            end = self._scan.end(False)
            if end is None and self._scanned < len(self._parts):
                self._scan.extend(self._parts[self._scanned])
                self._scanned += 1
                continue
            end = end or self._scan.end(finished)
            if end is None:
                break
            try:
                pieces.extend(self._plan_window(*end))
            except PlanningError as problem:
                self._parts, self._problem = [], problem
                if not pieces:
                    raise
        return pieces

    def _solve(self, known: AxisPath) -> Stretch | None:
        """Plan from the committed state to rest; after a failure, once more on a finer grid."""
        if self._tool is not None:
            self._tool = self._tool.begun(known, self._start)
        state = self._table, self._start
        stretch = jerk_stage.plan(known, *state, self.options, self._kept, self._tool)
        if stretch is None:
            finer = self.options.finer()
            stretch = jerk_stage.plan(known, *state, finer, self._kept, self._tool)
        return stretch

    def _plan_window(self, last: int, at_stop: bool) -> list[PlannedPiece]:
        """Plan the window up to a grid point, and commit its first part."""
        known = cut(self._front(last), 0, last)
        rests = at_stop
        stretch = self._solve(known)
        if stretch is None and self._older is not None:
            return [self._drive_on(self._older)]
        if stretch is None and self._start != AT_REST:
            raise self._impossible(int(known.cell_block[0]))  # who begins in motion knows a stop
        solved = CONVERGED
        while stretch is None:
            # No law reaches this point: stop at half the distance instead.
            last, at_stop, rests, solved = last // 2, True, False, DIVIDED
            if last == 0:
                raise self._impossible(int(known.cell_block[0]))
            known = cut(known, 0, last)
            stretch = self._solve(known)
        if not stretch.converged:
            solved = NOT_CONVERGED
            first = self._divided(known, stretch, MOST_RESTS)
            if first is not None:
                stretch, at_stop, rests = first, True, False
                solved = DIVIDED if first.converged else NOT_CONVERGED
        cells = len(stretch.nodes) - 1
        if not at_stop:
            fine, s = stretch.path, stretch.path.s
            node = commit_node(fine.cells, self._table, stretch.v)
            due = int(np.searchsorted(stretch.nodes, node, side='right')) - 1
            least = int(np.searchsorted(s[stretch.nodes], 0.75 * s[0] + 0.25 * s[-1]))
            if due < least and not self._scan.crowded:
                # The motion is faster than this window expected: wait for a longer window.
                self._scan_again(1.5 * self._scan.ratio)
                return []
            cells = max(due, least, 1)
        self._failed = False
        return [self._commit(stretch, cells, solved, rests)]

    def _divided(self, known: AxisPath, stretch: Stretch, rests: int) -> Stretch | None:
        """Plan down to a rest on the way if this is faster than a law that has not converged."""
        v = stretch.v[np.searchsorted(stretch.path.s, known.s)]
        slow = 1 + np.flatnonzero((v[1:-1] <= v[:-2]) & (v[1:-1] <= v[2:]))
        if not len(slow) or not rests:
            return None
        place, end = int(slow[np.argmin(v[slow])]), len(known.s) - 1
        before, after = cut(known, 0, place), cut(known, place, end)
        options, tool = self.options, self._tool
        first = jerk_stage.plan(before, self._table, self._start, options, self._kept, tool)
        afresh = None if tool is None else tool.afresh(after)
        second = jerk_stage.plan(after, self._table, AT_REST, options, None, afresh)
        if first is None or second is None:
            return None
        if not first.converged:
            first = self._divided(before, first, rests - 1) or first
        divided = first.duration.sum() + second.duration.sum()
        return first if divided < stretch.duration.sum() else None

    def _impossible(self, block: int) -> PlanningError:
        v, a = self._start
        state = 'rest' if self._start == AT_REST else f's_dot {v:.4g} m/s, s_ddot {a:.4g} m/s2'
        return PlanningError(
            f'no motion from {state} within the axis limits along block {block}: '
            'check the path for jumps and the limits of the machine file'
        )

    def _drive_on(self, older: Stretch) -> PlannedPiece:
        cells = len(older.nodes) - 1
        part = cells if self._failed else (cells + 1) // 2
        self._failed = part < cells
        return self._commit(older, part, OLDER)

    def _commit(
        self, stretch: Stretch, cells: int, solved: str, rests: bool = False
    ) -> PlannedPiece:
        """Commit the first cells, keep the rest; ``rests``: any motion must rest at its end."""
        last = int(stretch.nodes[cells])
        least = self._least_time(stretch, last, rests) if self.options.bound else 0.0
        law = stretch.law(self._time, last)
        if self._tool is not None:
            self._tool = self._tool.after(stretch, last)
        piece = PlannedPiece(cut(stretch.path, 0, last), law, least, solved)
        self._time = piece.law.end_time
        s = stretch.path.s
        self._start = (float(stretch.v[last]), float(stretch.a[last]))
        self._older, self._kept = None, None
        position = s[last : last + 1]
        if cells < len(stretch.nodes) - 1:
            self._older = stretch.after(cells)
            half = (1 - KEPT_PART) * s[last] + KEPT_PART * s[-1]
            ends = s[stretch.nodes[cells + 1 :]]
            ends = ends[ends <= half]
            parts = self._older.tool
            parts = None if parts is None else parts[:, : len(ends)]
            scale, m = self._older.scale[: len(ends)], self._older.coefficients[: len(ends)]
            self._kept = KeptCells(ends, scale, m, parts)
            position = np.concatenate([position, ends])
        self._begin_at(position)
        self._scan_again(self.options.window_ratio)
        return piece

    def _least_time(self, stretch: Stretch, last: int, rests: bool) -> float:
        """Return the least time up to a grid point, at any speed that is possible before it."""
        path, nodes = stretch.path, stretch.nodes
        bound = time_bound(path, nodes, self._table, self._fastest_sq, rests)
        self._fastest_sq = float(bound.squared[last])
        return float(bound.time[:last].sum())

    def _begin_at(self, position: FloatArray) -> None:
        """Drop the path before the first position, and make all positions grid points."""
        while self._parts[0].s[-1] < position[-1]:
            self._front(len(self._parts[0].s))
        front = refine(self._parts[0], position)
        first, last = int(np.searchsorted(front.s, position[0])), len(front.s) - 1
        self._parts[:1] = [cut(front, first, last)] if first < last else []


def plan_path(
    path: AxisPath,
    limits: Machine | Limits,
    options: PlanOptions | None = None,
    start: tuple[float, float] = AT_REST,
    tool: ToolLimit | None = None,
) -> PlannedPiece:
    """Plan the fastest motion along a complete path, which may contain stops, from rest to rest.

    Parameters
    ----------
    limits : Machine or Limits
        The limits of the axes.
    start : tuple of float
        s_dot [m/s] and s_ddot [m/s2] of a motion that goes on.

    Returns
    -------
    PlannedPiece
        ``path`` and ``law`` for ``axis_motion``; ``law.end_time``, and ``least_time``: no motion
        without jerk limits is faster [s].

    Raises
    ------
    PlanningError
        No motion keeps the limits; the message names the block.

    """
    planner = FeedPlanner(limits, options, start, tool=tool)
    return PlannedPiece.join(planner.push(path) + planner.finish())
