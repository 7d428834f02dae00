"""
Windows: the feed planner for a path that arrives in parts.

Every plan ends at rest at the end of what is known. Of a plan that fills its window the first part
is committed and never revised; the rest is planned again when the next window is full. Windows
follow from the path alone, never from how it was cut into pushes or when it came: the same path
gives the same bits.

A window fails when no law within the limits was found from the committed state. Then the plan
before it, which is complete down to its own stop, is driven on, half of what is left at a time.
What cannot be driven at all is refused with its block, after a stop before it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import PlanningError
from cnc_interp.feedrate.horizon import WindowScan, commit_node
from cnc_interp.feedrate.jerk_stage import Kept, PlanOptions, plan
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.speed_guess import speed_bounds
from cnc_interp.feedrate.stretch import Stretch
from cnc_interp.kinematics.axis_path import AxisPath, cut, refine

AT_REST = (0.0, 0.0)

PART = 512
"""Most cells of the path in a part that is handled as one."""

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


def unsound_cell(path: AxisPath) -> int | None:
    """Find the first cell that is not finite, does not advance, or has no feed."""
    sound = np.isfinite(path.cell_left).all(axis=(0, 2)) & (path.cell_feed > 0.0)
    sound &= np.isfinite(path.cell_right).all(axis=(0, 2)) & (np.diff(path.s) > 0.0)
    return None if sound.all() else int(np.argmin(sound))


class FeedPlanner:
    """
    Plan the motion along a path that arrives in parts.

    Parameters
    ----------
    limits : AxisLimits
        Limits of the axes, for instance a Machine.
    options : PlanOptions, optional
        Settings.
    start : tuple of float, optional
        s_dot and s_ddot at the start of the path [m/s, m/s2]; rest by default. From a state of an
        older law within the same limits and feeds, there is a law.
    time : float
        Time there [s].

    """

    def __init__(
        self,
        limits: AxisLimits,
        options: PlanOptions | None = None,
        start: tuple[float, float] = AT_REST,
        time: float = 0.0,
    ):
        self.options = options or PlanOptions()
        self._table = limit_table(limits)
        self._parts: list[AxisPath] = []
        self._start = start
        self._kept: Kept | None = None
        self._time = time
        self._older: Stretch | None = None
        self._failed = False
        self._problem: PlanningError | None = None
        self._scan_again(self.options.window_ratio)

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
            What is committed now, in order; often nothing. Where the path cannot be driven on,
            it ends at rest before that block, and the next call raises.

        Raises
        ------
        PlanningError
            If the path is not finite, or there is no law within the limits at all, and nothing
            was left to be planned before it.

        """
        self._refuse()
        bad = unsound_cell(path)
        last = len(path.s) - 1 if bad is None else bad
        self._parts += [cut(path, i, min(i + PART, last)) for i in range(0, last, PART)]
        if bad is None:
            return self._plan_windows(finished=False)
        block = int(path.cell_block[bad])
        self._problem = PlanningError(
            f'block {block} has no finite path with a positive feed: check its coordinates and F'
        )
        pieces = self._plan_windows(finished=True)
        if not pieces:
            self._refuse()
        return pieces

    def finish(self) -> list[PlannedPiece]:
        """Plan all that is left, down to rest at the end of the path; ready for another path."""
        self._refuse()
        pieces = self._plan_windows(finished=True)
        self._parts, self._start, self._kept, self._older = [], AT_REST, None, None
        self._scan_again(self.options.window_ratio)
        return pieces

    @property
    def stuck(self) -> bool:
        """Tell whether the next call will raise: the path cannot be driven on."""
        return self._problem is not None

    def _refuse(self) -> None:
        """Raise what an earlier call found, when all before it was handed out."""
        if self._problem is not None:
            raise self._problem

    def _scan_again(self, ratio: float) -> None:
        """Begin a window; the scan sees the known parts one by one, no further than it must."""
        self._scan = WindowScan(self._table, self._start[0], ratio, self.options.window_cells)
        self._scanned = 0

    def _front(self, cells: int) -> AxisPath:
        """Join the first parts that hold so many cells."""
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
        """Plan from the committed state to rest; once more on a finer grid where that fails."""
        stretch = plan(known, self._table, self._start, self.options, self._kept)
        if stretch is None:
            finer = self.options.finer()
            stretch = plan(known, self._table, self._start, finer, self._kept)
        return stretch

    def _plan_window(self, last: int, at_stop: bool) -> list[PlannedPiece]:
        """Plan the window up to a grid point, commit what is due."""
        known = cut(self._front(last), 0, last)
        stretch = self._solve(known)
        if stretch is None and self._older is not None:
            return [self._drive_on(self._older)]
        while stretch is None:
            # no law at all: rest as near to the trouble as there is one
            last, at_stop = last // 2, True
            if last == 0:
                raise self._impossible(int(known.cell_block[0]))
            stretch = self._solve(cut(known, 0, last))
        cells = len(stretch.nodes) - 1
        if not at_stop:
            fine, s = stretch.path, stretch.path.s
            bounds = speed_bounds(
                np.diff(s), fine.cell_left, fine.cell_right, fine.cell_feed, self._table
            )
            node = commit_node(s, stretch.v, bounds)
            due = int(np.searchsorted(stretch.nodes, node, side='right')) - 1
            least = int(np.searchsorted(s[stretch.nodes], 0.75 * s[0] + 0.25 * s[-1]))
            if due < least and not self._scan.crowded:
                # faster than the window was made for: wait for a longer one
                self._scan_again(1.5 * self._scan.ratio)
                return []
            cells = max(due, least, 1)
        self._failed = False
        return [self._commit(stretch, cells)]

    def _impossible(self, block: int) -> PlanningError:
        v, a = self._start
        state = 'rest' if self._start == AT_REST else f's_dot {v:.4g} m/s, s_ddot {a:.4g} m/s2'
        return PlanningError(
            f'no motion from {state} within the axis limits along block {block}: '
            'check the path for jumps and the limits of the machine file'
        )

    def _drive_on(self, older: Stretch) -> PlannedPiece:
        """Commit a part of the older plan instead of a window that failed; next time all of it."""
        cells = len(older.nodes) - 1
        part = cells if self._failed else (cells + 1) // 2
        self._failed = part < cells
        return self._commit(older, part)

    def _commit(self, stretch: Stretch, cells: int) -> PlannedPiece:
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
        self._begin_at(position)
        self._scan_again(self.options.window_ratio)
        return piece

    def _begin_at(self, position: FloatArray) -> None:
        """Forget the path before the first position, and make grid points of all of them."""
        while self._parts[0].s[-1] < position[-1]:
            self._front(len(self._parts[0].s))
        front = refine(self._parts[0], position)
        first, last = int(np.searchsorted(front.s, position[0])), len(front.s) - 1
        self._parts[:1] = [cut(front, first, last)] if first < last else []


def plan_path(
    path: AxisPath,
    limits: AxisLimits,
    options: PlanOptions | None = None,
    start: tuple[float, float] = AT_REST,
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
    start : tuple of float, optional
        s_dot and s_ddot at the start of the path [m/s, m/s2]; rest by default.

    Returns
    -------
    PlannedPiece
        The path on the planner's grid and the motion law along it.

    Raises
    ------
    PlanningError
        If there is no law within the limits at all.

    """
    planner = FeedPlanner(limits, options, start)
    return PlannedPiece.join(planner.push(path) + planner.finish())
