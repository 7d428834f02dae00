"""
The grid of the feed planner: cells of constant jerk, few but close to the optimum.

A path cell is subdivided evenly in time if it takes longer than the wanted cell time. It is also
subdivided if the axis derivatives inside it are far from linear. Cells may grow where the speed
is constant. Consecutive path cells become one planner cell if they are short in time and their
axis derivatives lie on a line. Cells too short for double precision are always grouped.
"""

from __future__ import annotations

from dataclasses import dataclass

import numba
import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.limit_table import ACCELERATION, JERK, limit_at
from cnc_interp.feedrate.cell_nodes import bend, cell_nodes, cell_times
from cnc_interp.feedrate.speed_guess import guess_speed, guess_time, speed_bounds, speed_inside
from cnc_interp.kinematics.axis_path import AxisPath, refine

MOST_ROUNDS = 3
"""Largest number of rounds of speed guess and refinement."""

LARGEST_GROUP = 32
"""Largest number of path cells in one planner cell."""

MOST_NODES = 30_000
"""Largest number of nodes in a window. A coarser grid plans a slower motion, but in time."""

ALWAYS_GROUPED = 1e-5
"""Cells that take less time than this are always grouped [s]."""


@dataclass(frozen=True)
class PlanGrid:
    """A path with the cells of the feed planner."""

    path: AxisPath  #: The refined path.
    #: (n + 1,): Indices of the grid points of ``path`` at which the n planner cells begin and end.
    nodes: IntArray
    #: (n, 6): Bounds of each planner cell, as ``speed_bounds`` returns them [m/s, m/s2, m/s3].
    bounds: FloatArray
    guess: FloatArray  #: (n + 1,): Guessed s_dot at the nodes [m/s].


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _grid_nodes(
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    bounds: FloatArray,
    v: FloatArray,
    wanted: FloatArray,
    most_bend: float,
    whole: int,
) -> FloatArray:
    """Return the new grid points of all cells from cell ``whole`` on; earlier cells stay."""
    n = len(bounds)
    found = np.empty(4096)
    total = 0
    inner = np.empty(2048)
    for i in range(whole, n):
        h = s[i + 1] - s[i]
        start, end = wanted[i], wanted[i + 1]
        slowest = min(v[i], v[i + 1])
        # The law may be faster than the guess on ramps, by a factor of up to 2^(2/3).
        fastest = speed_inside(h / 2, h, v[i], v[i + 1], bounds[i])[0]
        fastest = min(1.5 * max(fastest, max(v[i], v[i + 1])), bounds[i, 1])
        by_bend = np.sqrt(bend(left[:, i], right[:, i], h, fastest, table) / most_bend)
        new = 0
        if h < ALWAYS_GROUPED * fastest:
            continue
        if by_bend > 1.0 or not (slowest > 0.0 and h < slowest * min(start, end)):
            least = by_bend if by_bend > 1.0 else 0.0
            new = cell_nodes(h, v[i], v[i + 1], bounds[i], start, end, least, inner)
        if total + new > MOST_NODES:
            break
        if total + new > len(found):
            larger = np.empty(2 * len(found) + new)
            larger[:total] = found[:total]
            found = larger
        for c in range(new):
            found[total + c] = s[i] + inner[c]
        total += new
    return found[:total].copy()


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _lies_on_line(
    first: int,
    last: int,
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    table: FloatArray,
    v: float,
    most: float,
) -> bool:
    """Tell whether q_ss and q_sss of cells first ... last are linear in s, within ``most``."""
    span = s[last + 1] - s[first]
    for k in range(left.shape[2]):
        q = left[0, first, k]
        by_jerk = v**3 / limit_at(table, JERK, k, q)
        by_acceleration = v**2 / limit_at(table, ACCELERATION, k, q)
        for order, factor in ((2, by_acceleration), (3, by_jerk)):
            start, end = left[order, first, k], right[order, last, k]
            for c in range(first, last):
                line = start + (end - start) * (s[c + 1] - s[first]) / span
                off = max(abs(right[order, c, k] - line), abs(left[order, c + 1, k] - line))
                if off * factor > most:
                    return False
    return True


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _group_cells(
    first: int,
    s: FloatArray,
    left: FloatArray,
    right: FloatArray,
    feed: FloatArray,
    table: FloatArray,
    bounds: FloatArray,
    v: FloatArray,
    wanted: FloatArray,
    most_bend: float,
    given: BoolArray,
) -> IntArray:
    """
    Group the path cells from ``first`` on; return the grid points between the groups.

    Only grid points of the original path (``given``) may lie inside a group. Otherwise the
    grouping would undo the refinement.
    """
    n = len(bounds)
    nodes = np.empty(n + 1, dtype=np.int64)
    nodes[0] = first
    count, i = 1, first
    while i < n:
        start, spent, fastest = i, 0.0, 0.0
        while i < n and i - start < LARGEST_GROUP:
            h = s[i + 1] - s[i]
            middle = speed_inside(h / 2, h, v[i], v[i + 1], bounds[i])[0]
            time = h / middle
            fastest = max(fastest, min(1.5 * max(middle, max(v[i], v[i + 1])), bounds[i, 1]))
            if i > start and time > ALWAYS_GROUPED and spent > ALWAYS_GROUPED:
                if feed[i] != feed[start] or not given[i]:
                    break
                if spent + time > min(wanted[start], wanted[i + 1]):
                    break
                if not _lies_on_line(start, i, s, left, right, table, fastest, most_bend):
                    break
            spent += time
            i += 1
        nodes[count] = i
        count += 1
    return nodes[:count].copy()


def planning_grid(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float],
    cell_time: tuple[float, float],
    share: float,
    most_bend: float,
    kept: FloatArray,
) -> PlanGrid:
    """Choose the planner cells of a path that ends at rest."""
    whole = int(np.searchsorted(path.s, kept[-1])) if len(kept) else 0
    coarse = path.s
    for attempt in range(MOST_ROUNDS + 1):
        bounds = speed_bounds(
            np.diff(path.s), path.cell_left, path.cell_right, path.cell_feed, table
        )
        v = guess_speed(np.diff(path.s), bounds, *start)
        tau = share * guess_time(np.diff(path.s), v, bounds)
        tau = min(max(tau, cell_time[0]), cell_time[1])
        # Later rounds refine only where the first guess was too coarse, so they are less strict.
        ease = 1.0 if attempt == 0 else 1.6
        curve = path.s, path.cell_left, path.cell_right
        wanted = cell_times(path.s, path.cell_feed, bounds, v, tau)
        new = _grid_nodes(*curve, table, bounds, v, ease * wanted, ease**2 * most_bend, whole)
        if len(new) == 0 or attempt == MOST_ROUNDS or len(path.s) + len(new) > MOST_NODES:
            break
        path = refine(path, new)
    given = np.isin(path.s, coarse)
    groups = _group_cells(
        whole, *curve, path.cell_feed, table, bounds, v, wanted, most_bend / 3, given
    )
    older = np.searchsorted(path.s, kept).astype(np.int64)
    nodes = np.concatenate([np.zeros(1, dtype=np.int64), older, groups[1:]])
    return PlanGrid(path, nodes, np.minimum.reduceat(bounds, nodes[:-1], axis=0), v[nodes])
