"""
Where a planning window ends and how much of its plan may be committed.

Both follow from stopping distances: a state is committed only where several of them lie between it
and the stop that ends the plan, so that more path could not have made it faster by anything that
matters; and a window holds a few such horizons.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.speed_guess import reach, speed_bounds
from cnc_interp.kinematics.axis_path import AxisPath

HORIZON = 3.0
"""Stopping distances that must lie between a committed state and the end of its plan."""

SHORT, LEAST = 2e-4, 1 / 8
"""Cells that take less time [s] count only in part, for they are grouped; and the least part."""

SETTLE = 0.1
"""Time added to every stop when horizons are measured, else slow windows are all ramps [s]."""


@numba.njit(cache=True, nogil=True, error_model='numpy')
def stopping_distance(v: float, acceleration: float, jerk: float) -> float:
    """Bound the distance of a stop along the path [m]: v sqrt(v/J), more where A binds."""
    return float(v * (SETTLE + np.sqrt(v / jerk)) + v * v / (2 * acceleration))


@numba.njit(cache=True, nogil=True, error_model='numpy')
def window_end(
    s: FloatArray, bounds: FloatArray, ratio: float, most_cells: int, state: FloatArray
) -> int:
    """
    Go on along a window; returns the grid point of ``s`` at which it is full, or -1.

    It is full at ``ratio`` horizons for the fastest speed that an optimistic guess reaches, or
    after so many cells. ``state`` holds where it begins, the guessed speed, the farthest stop and
    the cells counted.
    """
    for i in range(len(bounds)):
        # twice the guess's jerk and more acceleration: rather a window too long
        v = reach(state[1], s[i + 1] - s[i], 2 * bounds[i, 2], 4 * bounds[i, 3])
        v = min(bounds[i, 1], v)
        state[1] = v
        state[2] = max(state[2], stopping_distance(v, bounds[i, 2], bounds[i, 3]))
        state[3] += min(1.0, max(LEAST, (s[i + 1] - s[i]) / (v * SHORT)))
        if s[i + 1] - state[0] >= ratio * HORIZON * state[2] or state[3] >= most_cells:
            return i + 1
    return -1


@numba.njit(cache=True, nogil=True, error_model='numpy')
def commit_node(s: FloatArray, v: FloatArray, bounds: FloatArray) -> int:
    """Find the last grid point from which a whole horizon is left at the speeds planned."""
    n = len(bounds)
    farthest = 0.0
    for i in range(n - 1, 0, -1):
        speed = max(v[i], v[i + 1])
        farthest = max(farthest, stopping_distance(speed, bounds[i, 2], bounds[i, 3]))
        if s[n] - s[i] >= HORIZON * farthest:
            return i
    return 0


class WindowScan:
    """
    Look for the end of a window while its path arrives; every cell is looked at once.

    Parameters
    ----------
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    v_start : float
        Speed at the window's start [m/s].
    ratio : float
        Length of the window in horizons.
    most_cells : int
        Most cells of the path in it.

    """

    def __init__(self, table: FloatArray, v_start: float, ratio: float, most_cells: int):
        self.table, self.ratio, self.most_cells = table, ratio, most_cells
        self.state = np.array([np.nan, v_start, 0.0, 0.0])
        self.cells = 0
        self.full: int | None = None
        self.stop: int | None = None

    @property
    def crowded(self) -> bool:
        """Tell whether the window holds all the cells that it may."""
        return bool(self.state[3] >= self.most_cells)

    def extend(self, part: AxisPath) -> None:
        """Take the next part of the path."""
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
        found = window_end(s, bounds, self.ratio, self.most_cells, self.state)
        if found > 0:
            self.full = before + found

    def end(self, finished: bool) -> tuple[int, bool] | None:
        """
        Tell the last grid point of the window, and whether the motion must rest there.

        A window that is full at the last point known waits: that point may turn out a stop.
        """
        full, stop = self.full, self.stop
        if full is not None and full < (self.cells if stop is None else stop):
            return full, False
        if stop is not None:
            return stop, True
        return (self.cells, True) if finished else None
