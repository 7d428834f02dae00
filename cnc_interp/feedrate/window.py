"""
Windows: the feed planner for a path that arrives in parts.

Every plan ends at rest at the end of what is known. Of a plan that fills its window the first part
is committed and never revised; the rest is planned again when the next window is full. Windows
follow from the path alone, never from how it was cut into pushes or when it came: the same path
gives the same bits.

A window fails when no law within the limits was found from the committed state. Then the plan
before it, which is complete down to its own stop, is driven on, half of what is left at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cnc_interp.errors import PlanningError
from cnc_interp.feedrate.jerk_stage import Kept, PlanOptions, plan
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.speed_guess import reach, speed_bounds
from cnc_interp.feedrate.stretch import Stretch
from cnc_interp.kinematics.axis_path import AxisPath, cut, refine
from cnc_interp.program.blocks import FloatArray

KEPT_PART = 0.5
"""Part of the horizon in which the next window keeps the cells of the older plan."""

HORIZON = 3.0
"""Stopping distances that must lie between a committed state and the end of its plan."""

SETTLE = 0.1
"""Time added to every stop when horizons are measured [s]."""


@dataclass(frozen=True)
class PlannedPiece:
    """
    A committed part of the motion.

    Parameters
    ----------
    path : AxisPath
        The path on the planner's grid.
    law : MotionLaw
        The motion along it, one piece per cell; time goes on from piece to piece.

    """

    path: AxisPath
    law: MotionLaw

    @staticmethod
    def join(parts: list[PlannedPiece]) -> PlannedPiece:
        """Join pieces that follow each other."""
        laws, first_cell = [], 0
        for part in parts:
            law = part.law
            shifted = law.cell + first_cell
            laws.append(
                MotionLaw(law.time, law.duration, law.s, law.s_dot, law.s_ddot, law.jerk, shifted)
            )
            first_cell += len(part.path.s) - 1
        return PlannedPiece(AxisPath.join([p.path for p in parts]), MotionLaw.join(laws))


@numba.njit(cache=True)
def stopping_distance(v: float, acceleration: float, jerk: float) -> float:
    """Bound the distance of a stop along the path [m]: v sqrt(v/J), more where A binds."""
    # a part of slow motion too, so that slow windows are not all ramps
    return float(v * (SETTLE + np.sqrt(v / jerk)) + v * v / (2 * acceleration))


@numba.njit(cache=True)
def window_end(
    s: FloatArray, bounds: FloatArray, v_start: float, ratio: float, most_cells: int
) -> int:
    """
    Find the node at which the window that starts at node 0 is full, or -1.

    It is full at ``ratio`` horizons for the fastest speed that an optimistic guess reaches.
    """
    v, farthest = v_start, 0.0
    for i in range(len(bounds)):
        h = s[i + 1] - s[i]
        # twice the guess's jerk and more acceleration: rather a window too long
        v = min(bounds[i, 1], reach(v, h, 2 * bounds[i, 2], 4 * bounds[i, 3]))
        farthest = max(farthest, stopping_distance(v, bounds[i, 2], bounds[i, 3]))
        if s[i + 1] - s[0] >= ratio * HORIZON * farthest or i + 1 >= most_cells:
            return i + 1
    return -1


@numba.njit(cache=True)
def commit_node(s: FloatArray, v: FloatArray, bounds: FloatArray) -> int:
    """Find the last node from which a whole horizon is left at the speeds planned."""
    n = len(bounds)
    farthest = 0.0
    for i in range(n - 1, 0, -1):
        speed = max(v[i], v[i + 1])
        farthest = max(farthest, stopping_distance(speed, bounds[i, 2], bounds[i, 3]))
        if s[n] - s[i] >= HORIZON * farthest:
            return i
    return 0


def refuse_unsound(path: AxisPath) -> None:
    """Refuse a path that is not finite, does not advance, or has no feed; names the block."""
    sound = np.isfinite(path.cell_left).all(axis=(0, 2)) & (path.cell_feed > 0.0)
    sound &= np.isfinite(path.cell_right).all(axis=(0, 2)) & (np.diff(path.s) > 0.0)
    if not sound.all():
        block = int(path.cell_block[np.argmin(sound)])
        raise PlanningError(
            f'block {block} has no finite path with a positive feed: check its coordinates and F'
        )


class FeedPlanner:
    """
    Plan the motion along a path that arrives in parts.

    Parameters
    ----------
    limits : AxisLimits
        Limits of the axes, for instance a Machine.
    options : PlanOptions, optional
        Settings.

    """

    def __init__(self, limits: AxisLimits, options: PlanOptions | None = None):
        self.options = options or PlanOptions()
        self._table = limit_table(limits)
        self._path: AxisPath | None = None
        self._start = (0.0, 0.0)
        self._kept: Kept | None = None
        self._time = 0.0
        self._older: Stretch | None = None
        self._ratio = self.options.window_ratio
        self._failed = False

    def push(self, path: AxisPath) -> list[PlannedPiece]:
        """
        Take the next part of the path, and plan the windows that it fills.

        Parameters
        ----------
        path : AxisPath
            Begins at the grid point where the part before ended.

        Returns
        -------
        list of PlannedPiece
            What is committed now, in order; often nothing.

        Raises
        ------
        PlanningError
            If the path is not finite, or there is no law within the limits at all.

        """
        refuse_unsound(path)
        self._path = path if self._path is None else AxisPath.join([self._path, path])
        return self._plan_windows(finished=False)

    def finish(self) -> list[PlannedPiece]:
        """Plan all that is left, down to rest at the end of the path; ready for another path."""
        pieces = self._plan_windows(finished=True)
        self._path, self._start, self._kept, self._older = None, (0.0, 0.0), None, None
        return pieces

    def _plan_windows(self, finished: bool) -> list[PlannedPiece]:
        pieces: list[PlannedPiece] = []
        while self._path is not None and len(self._path.s) > 1:
            last, at_stop = self._next_window(finished)
            if last < 0:
                break
            pieces.extend(self._plan_window(last, at_stop))
        return pieces

    def _next_window(self, finished: bool) -> tuple[int, bool]:
        """Find the last node of the next window, -1 while it is not full; True at a stop."""
        path = self._path
        assert path is not None
        n = len(path.s) - 1
        stops = np.flatnonzero(path.stop[1:])
        stop = int(stops[0]) + 1 if len(stops) else n
        known = len(stops) > 0 or finished
        part = slice(0, stop)
        bounds = speed_bounds(
            np.diff(path.s[: stop + 1]),
            path.cell_left[:, part],
            path.cell_right[:, part],
            path.cell_feed[part],
            self._table,
        )
        full = window_end(
            path.s[: stop + 1], bounds, self._start[0], self._ratio, self.options.window_cells
        )
        if 0 < full < stop:
            return full, False
        return (stop, True) if known else (-1, False)

    def _plan_window(self, last: int, at_stop: bool) -> list[PlannedPiece]:
        """Plan the window up to a node, commit what is due."""
        assert self._path is not None
        known = cut(self._path, 0, last)
        stretch = plan(known, self._table, self._start, self.options, self._kept)
        if stretch is None:
            finer = self.options.finer()
            stretch = plan(known, self._table, self._start, finer, self._kept)
        if stretch is None:
            return [self._drive_on()]
        cells = len(stretch.nodes) - 1
        if not at_stop:
            s = stretch.path.s
            bounds = speed_bounds(
                np.diff(s),
                stretch.path.cell_left,
                stretch.path.cell_right,
                stretch.path.cell_feed,
                self._table,
            )
            node = commit_node(s, stretch.v, bounds)
            due = int(np.searchsorted(stretch.nodes, node, side='right')) - 1
            least = int(np.searchsorted(s[stretch.nodes], 0.75 * s[0] + 0.25 * s[-1]))
            if due < least and last < self.options.window_cells:
                # faster than the window was made for: wait for a longer one
                self._ratio *= 1.5
                return []
            cells = max(due, least, 1)
        self._ratio, self._failed = self.options.window_ratio, False
        return [self._commit(stretch, cells)]

    def _drive_on(self) -> PlannedPiece:
        """Commit a part of the older plan instead of a window that failed; next time all of it."""
        older = self._older
        if older is None:
            assert self._path is not None
            block = int(self._path.cell_block[0])
            raise PlanningError(
                f'no motion within the axis limits along block {block}: '
                'check the path for jumps and the limits of the machine file',
            )
        cells = len(older.nodes) - 1
        part = cells if self._failed else (cells + 1) // 2
        self._failed = part < cells
        return self._commit(older, part)

    def _commit(self, stretch: Stretch, cells: int) -> PlannedPiece:
        """Hand out the first cells of a plan and keep the rest for the next window."""
        assert self._path is not None
        last = int(stretch.nodes[cells])
        piece = PlannedPiece(cut(stretch.path, 0, last), stretch.law(self._time, last))
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
            self._kept = Kept(ends, self._older.scale[: len(ends)])
            position = np.concatenate([position, ends])
        rest = refine(self._path, position)
        self._path = cut(rest, int(np.searchsorted(rest.s, position[0])), len(rest.s) - 1)
        return piece


def plan_path(
    path: AxisPath, limits: AxisLimits, options: PlanOptions | None = None
) -> PlannedPiece:
    """
    Plan a whole path at once: push, finish, join.

    Parameters
    ----------
    path : AxisPath
        The path, stops included.
    limits : AxisLimits
        Limits of the axes, for instance a Machine.
    options : PlanOptions, optional
        Settings.

    Returns
    -------
    PlannedPiece
        The path on the planner's grid and the motion law along it.

    Raises
    ------
    PlanningError
        If there is no law within the limits at all.

    """
    planner = FeedPlanner(limits, options)
    return PlannedPiece.join(planner.push(path) + planner.finish())
