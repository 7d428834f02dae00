"""
The end of a planning window, and how much of its plan may be committed.

Both follow from stopping distances. A state is committed only if several stopping distances lie
between it and the stop at the end of the plan. Then more path would hardly have made it faster.
One window holds a few such horizons.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.speed_guess import reach, speed_bounds
from cnc_interp.kinematics.axis_path import AxisPath

HORIZON = 3.0
"""Stopping distances that must lie between a committed state and the end of its plan [-]."""

SHORT, LEAST = 2e-4, 1 / 8
"""Cells shorter than this time [s] are grouped, so they count in part; the smallest part [-]."""

SETTLE = 0.1
"""Time added to every stop in a horizon [s]. Without it, slow windows would be ramps only."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _stopping_distance(v: float, acceleration: float, jerk: float) -> float:
    """Return an upper bound of the stopping distance from speed v along a straight path [m]."""
    return float(v * (SETTLE + np.sqrt(v / jerk)) + v * v / (2 * acceleration))


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _window_end(
    s: FloatArray, bounds: FloatArray, ratio: float, most_cells: int, state: FloatArray
) -> int:
    """
    Continue the search for the window end; return its grid point in ``s``, or -1.

    A window is full after ``ratio`` horizons at the fastest speed of an optimistic guess. It is
    also full after ``most_cells`` cells. ``state`` holds the start of the window [m], the guessed
    speed [m/s], the longest stopping distance [m] and the number of cells counted.
    """
    for i in range(len(bounds)):
        # The guess uses twice the jerk and more acceleration: a window may be too long, not short.
        v = reach(state[1], s[i + 1] - s[i], 2 * bounds[i, 2], 4 * bounds[i, 3])
        v = min(bounds[i, 1], v)
        state[1] = v
        state[2] = max(state[2], _stopping_distance(v, bounds[i, 2], bounds[i, 3]))
        state[3] += min(1.0, max(LEAST, (s[i + 1] - s[i]) / (v * SHORT)))
        if s[i + 1] - state[0] >= ratio * HORIZON * state[2] or state[3] >= most_cells:
            return i + 1
    return -1


@numba.njit(cache=True, nogil=True, error_model='numpy')
def commit_node(s: FloatArray, v: FloatArray, bounds: FloatArray) -> int:
    """Find the last grid point with a whole horizon between it and the end of the plan."""
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
        """Whether the window contains its largest number of cells."""
        return bool(self.state[3] >= self.most_cells)

    def extend(self, part: AxisPath) -> None:
        """Examine the next part of the path."""
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
        cells = slice(0, last)
        s = part.s[: last + 1]
        bounds = speed_bounds(
            np.diff(s),
            part.cell_left[:, cells],
            part.cell_right[:, cells],
            part.cell_feed[cells],
            self.table,
        )
        found = _window_end(s, bounds, self.ratio, self.most_cells, self.state)
        if found > 0:
            self.full = before + found

    def end(self, finished: bool) -> tuple[int, bool] | None:
        """
        Return the last grid point of the window and whether the motion must rest there.

        If the window is full exactly at the last known point, the answer is None for now. The
        next part of the path may declare that point a stop.
        """
        full, stop = self.full, self.stop
        if full is not None and full < (self.cells if stop is None else stop):
            return full, False
        if stop is not None:
            return stop, True
        return (self.cells, True) if finished else None
