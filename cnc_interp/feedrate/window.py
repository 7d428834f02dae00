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

import numpy as np

from cnc_interp.errors import PlanningError
from cnc_interp.feedrate.horizon import WindowScan, commit_node
from cnc_interp.feedrate.jerk_stage import Kept, PlanOptions, plan
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.speed_guess import speed_bounds
from cnc_interp.feedrate.stretch import Stretch
from cnc_interp.kinematics.axis_path import AxisPath, cut, refine

KEPT_PART = 0.5
"""Part of the horizon in which the next window keeps the cells of the older plan."""


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
        self._parts: list[AxisPath] = []
        self._start = (0.0, 0.0)
        self._kept: Kept | None = None
        self._time = 0.0
        self._older: Stretch | None = None
        self._failed = False
        self._scan = self._new_scan(self.options.window_ratio)

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
        self._parts.append(path)
        self._scan.extend(path)
        return self._plan_windows(finished=False)

    def finish(self) -> list[PlannedPiece]:
        """Plan all that is left, down to rest at the end of the path; ready for another path."""
        pieces = self._plan_windows(finished=True)
        self._parts, self._start, self._kept, self._older = [], (0.0, 0.0), None, None
        self._scan = self._new_scan(self.options.window_ratio)
        return pieces

    def _new_scan(self, ratio: float) -> WindowScan:
        return WindowScan(self._table, self._start[0], ratio, self.options.window_cells)

    def _scan_again(self, path: AxisPath, ratio: float) -> None:
        """Begin a window with what is known of the path."""
        self._parts = [path] if len(path.s) > 1 else []
        self._scan = self._new_scan(ratio)
        if self._parts:
            self._scan.extend(path)

    def _plan_windows(self, finished: bool) -> list[PlannedPiece]:
        pieces: list[PlannedPiece] = []
        while self._parts:
            end = self._scan.end(finished)
            if end is None:
                break
            pieces.extend(self._plan_window(AxisPath.join(self._parts), *end))
        return pieces

    def _plan_window(self, path: AxisPath, last: int, at_stop: bool) -> list[PlannedPiece]:
        """Plan the window up to a grid point, commit what is due."""
        known = cut(path, 0, last)
        stretch = plan(known, self._table, self._start, self.options, self._kept)
        if stretch is None:
            finer = self.options.finer()
            stretch = plan(known, self._table, self._start, finer, self._kept)
        if stretch is None:
            return [self._drive_on(path)]
        cells = len(stretch.nodes) - 1
        if not at_stop:
            fine, s = stretch.path, stretch.path.s
            bounds = speed_bounds(
                np.diff(s), fine.cell_left, fine.cell_right, fine.cell_feed, self._table
            )
            node = commit_node(s, stretch.v, bounds)
            due = int(np.searchsorted(stretch.nodes, node, side='right')) - 1
            least = int(np.searchsorted(s[stretch.nodes], 0.75 * s[0] + 0.25 * s[-1]))
            if due < least and last < self.options.window_cells:
                # faster than the window was made for: wait for a longer one
                self._scan_again(path, 1.5 * self._scan.ratio)
                return []
            cells = max(due, least, 1)
        self._failed = False
        return [self._commit(path, stretch, cells)]

    def _drive_on(self, path: AxisPath) -> PlannedPiece:
        """Commit a part of the older plan instead of a window that failed; next time all of it."""
        older = self._older
        if older is None:
            block = int(path.cell_block[0])
            raise PlanningError(
                f'no motion within the axis limits along block {block}: '
                'check the path for jumps and the limits of the machine file',
            )
        cells = len(older.nodes) - 1
        part = cells if self._failed else (cells + 1) // 2
        self._failed = part < cells
        return self._commit(path, older, part)

    def _commit(self, path: AxisPath, stretch: Stretch, cells: int) -> PlannedPiece:
        """Hand out the first cells of a plan and keep the rest for the next window."""
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
        rest = refine(path, position)
        rest = cut(rest, int(np.searchsorted(rest.s, position[0])), len(rest.s) - 1)
        self._scan_again(rest, self.options.window_ratio)
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
