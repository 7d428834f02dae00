"""The grid of the feed planner: cells of constant jerk, few but close to the optimum.

A path cell is subdivided evenly in time if it takes longer than the wanted cell time, or if the
axis derivatives inside are far from linear. Cells may grow where the speed is constant.
Consecutive path cells become one if they are short in time and their axis derivatives lie on a
line; cells too short for double precision always do.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import (
    ACCELERATION,
    DRIVE,
    JERK,
    PLACE,
    has_loads,
    limit_at,
)
from cnc_interp.feedrate import speed_guess
from cnc_interp.kinematics.axis_path import (
    AxisPath,
    PathCells,
    refine,
    septic_coefficients,
    septic_jet,
)

SAMPLES = 96  #: Number of intervals in which a cell is sampled before it is subdivided.
#: Growth of the cell time per unit of time at constant speed, and its largest factor [-].
GROWTH, LONGEST = 0.3, 16.0
#: Cells in a ramp between rest and constant speed, and the shortest time of such a cell [s].
RAMP_CELLS, SHORTEST = 8, 2e-5
MOST_ROUNDS = 3  #: Largest number of rounds of speed guess and refinement.
LARGEST_GROUP = 32  #: Largest number of path cells in one planner cell.
MOST_NODES = 30_000  #: Most nodes in a window; a coarser grid is slower, but in time.
ALWAYS_GROUPED = 1e-5  #: Cells that take less time than this are always grouped [s].
NEAR = 1e-6  #: A kink gets no grid point within this part of the cell from its border [-].


@njit(cache=True, nogil=True, error_model='numpy')
def cell_times(
    s: FloatArray,
    feed: FloatArray,
    bounds: FloatArray,
    v: FloatArray,
    inside: FloatArray,
    capped: BoolArray,
    tau: float,
) -> FloatArray:
    """Return the wanted cell time at every grid point [s].

    It grows from ``tau`` only where the programmed feed alone limits the speed: there the law
    cruises.
    """
    n = len(bounds)
    wanted, growth = np.full(n + 1, tau), np.empty(n)
    for i in range(n):
        cruise = capped[i] and bounds[i, 1] >= feed[i] and min(v[i], v[i + 1]) >= inside[i]
        growth[i] = GROWTH * (s[i + 1] - s[i]) / inside[i] if cruise else -np.inf
        wanted[i + 1] = min(max(wanted[i] + growth[i], tau), LONGEST * tau)
    for i in range(n - 1, -1, -1):
        wanted[i] = min(wanted[i], max(wanted[i + 1] + growth[i], tau))
    return wanted


@njit(cache=True, nogil=True, error_model='numpy')
def cell_nodes(
    h: float,
    v0: float,
    v1: float,
    bound: FloatArray,
    start: float,
    end: float,
    least: float,
    out: FloatArray,
) -> int:
    """Write the inner nodes of one cell, evenly spaced in time; return their number."""
    x, count = np.empty(SAMPLES + 1), np.zeros(SAMPLES + 1)
    time, cruise = np.zeros(SAMPLES + 1), np.zeros(SAMPLES + 1, dtype=np.bool_)
    speed = np.empty(SAMPLES + 1)
    for p in range(SAMPLES + 1):
        u = p / SAMPLES
        x[p] = h * u**3 / (u**3 + (1 - u) ** 3)
        speed[p], cruise[p] = speed_guess.speed_inside(x[p], h, v0, v1, bound)
    for p in range(SAMPLES):
        factor = 3.0 if speed[p] == 0.0 or speed[p + 1] == 0.0 else 2.0
        time[p + 1] = time[p] + factor * (x[p + 1] - x[p]) / (speed[p] + speed[p + 1])
    first, last = SAMPLES, 0
    for p in range(SAMPLES + 1):
        if cruise[p]:
            first, last = min(first, p), max(last, p)
    # A short ramp between rest and a slow constant speed gets cells of its own time scale.
    if last > first and v0 == 0.0:
        start = min(start, max(time[first] / RAMP_CELLS, SHORTEST))
    if last > first and v1 == 0.0:
        end = min(end, max((time[SAMPLES] - time[last]) / RAMP_CELLS, SHORTEST))
    for p in range(SAMPLES):
        middle = (time[p] + time[p + 1]) / 2
        after, before = max(0.0, middle - time[first]), max(0.0, time[last] - middle)
        if last <= first:
            after, before = 0.0, 0.0
        wanted = min(start + GROWTH * after, end + GROWTH * before)
        by_time = (time[p + 1] - time[p]) / wanted
        count[p + 1] = count[p] + max(by_time, least * (x[p + 1] - x[p]) / h)
    cells = int(np.ceil(count[SAMPLES]))
    cells = min(max(cells, 1), len(out) + 1)
    p = 0
    for c in range(1, cells):
        rank = count[SAMPLES] * c / cells
        while count[p + 1] < rank:
            p += 1
        share = (rank - count[p]) / (count[p + 1] - count[p])
        if p == 0 and v0 == 0.0:
            share = share**3
        out[c - 1] = x[p] + share * (x[p + 1] - x[p])
    return cells - 1


@njit(cache=True, nogil=True, error_model='numpy')
def bend(
    left: FloatArray, right: FloatArray, i: int, h: float, v: float, table: FloatArray
) -> float:
    """Estimate the excess over a limit inside cell i that keeps it at the ends (q_ss, q_sss)."""
    worst = 0.0
    c = np.empty(8)
    for k in range(left.shape[2]):
        septic_coefficients(left[:, i, k], right[:, i, k], h, c)
        if c[3] == 0.0 and c[4] == 0.0 and c[5] == 0.0 and c[6] == 0.0 and c[7] == 0.0:
            continue
        q = left[0, i, k]
        by_jerk = v**3 / limit_at(table, JERK, k, q)
        by_acceleration = v**2 / limit_at(table, ACCELERATION, k, q)
        for p in range(1, 8):
            u = p / 8
            _, _, q_ss, q_sss = septic_jet(c, u, h)
            straight = left[3, i, k] + u * (right[3, i, k] - left[3, i, k])
            worst = max(worst, abs(q_sss - straight) * by_jerk)
            straight = left[2, i, k] + u * (right[2, i, k] - left[2, i, k])
            worst = max(worst, abs(q_ss - straight) * by_acceleration)
    return worst


@dataclass(frozen=True)
class PlanGrid:
    path: AxisPath  #: The refined path.
    nodes: IntArray  #: (n + 1,): Grid points of ``path`` where the planner cells begin and end.
    bounds: FloatArray  #: (n, 6): Bounds of each planner cell, as of ``speed_bounds``.
    guess: FloatArray  #: (n + 1,): Guessed s_dot at the nodes [m/s].


class Guess(NamedTuple):
    """A guess of the motion on n path cells, from which the planner cells are chosen."""

    bounds: FloatArray  #: (n, 6): As of ``speed_bounds``.
    v: FloatArray  #: (n + 1,): s_dot at the grid points [m/s].
    inside: FloatArray  #: (n,): s_dot in the middle of each cell [m/s].
    wanted: FloatArray  #: (n + 1,): Wanted cell times there [s].


@njit(cache=True, nogil=True, error_model='numpy')
def _grid_nodes(
    path: PathCells, table: FloatArray, guess: Guess, most_bend: float, whole: int
) -> FloatArray:
    s, left, right, _ = path
    bounds, v, inside, wanted = guess
    n = len(bounds)
    found = np.empty(4096)
    total = 0
    inner = np.empty(2048)
    for i in range(whole, n):
        h = s[i + 1] - s[i]
        start, end = wanted[i], wanted[i + 1]
        slowest = min(v[i], v[i + 1])
        # The law may be faster than the guess on ramps, by a factor of up to 2^(2/3).
        fastest = min(1.5 * max(inside[i], max(v[i], v[i + 1])), bounds[i, 1])
        if h < min(ALWAYS_GROUPED, 0.5 * start, 0.5 * end) * fastest:
            continue
        by_bend = np.sqrt(bend(left, right, i, h, fastest, table) / most_bend)
        new = 0
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


@njit(cache=True, nogil=True, error_model='numpy')
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
    """Return whether q_ss and q_sss of cells first ... last are linear in s, within ``most``."""
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


@njit(cache=True, nogil=True, error_model='numpy')
def _group_cells(
    kept: FloatArray,
    path: PathCells,
    table: FloatArray,
    guess: Guess,
    most_bend: float,
    given: FloatArray,
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Return the nodes, and the bounds and the guess there; path cells after ``kept`` are grouped.

    Only at points that were ``given`` a group may hold more than one wanted cell time.
    """
    s, left, right, feed = path
    bounds, v, inside, wanted = guess
    n, count, point = len(bounds), 0, 0
    nodes = np.zeros(n + 1, dtype=np.int64)
    for end in kept:
        count += 1
        nodes[count] = np.searchsorted(s, end)
    i = nodes[count]
    count += 1
    while i < n:
        start, spent, fastest = i, 0.0, 0.0
        while i < n and i - start < LARGEST_GROUP:
            time = (s[i + 1] - s[i]) / inside[i]
            fastest = max(fastest, min(1.5 * max(inside[i], max(v[i], v[i + 1])), bounds[i, 1]))
            if i > start and min(time, spent) > min(ALWAYS_GROUPED, 0.5 * wanted[start]):
                while given[point] < s[i]:
                    point += 1
                if feed[i] != feed[start] or given[point] != s[i]:
                    break
                if spent + time > min(wanted[start], wanted[i + 1]):
                    break
                if not _lies_on_line(start, i, s, left, right, table, fastest, most_bend):
                    break
            spent += time
            i += 1
        nodes[count] = i
        count += 1
    grouped = np.empty((count - 1, bounds.shape[1]))
    for c in range(count - 1):
        grouped[c] = bounds[nodes[c]]
        for i in range(nodes[c] + 1, nodes[c + 1]):
            for k in range(bounds.shape[1]):
                grouped[c, k] = min(grouped[c, k], bounds[i, k])
    return nodes[:count].copy(), grouped, v[nodes[:count]]


@njit(cache=True, nogil=True, error_model='numpy')
def _divided(
    path: PathCells,
    table: FloatArray,
    start: tuple[float, float],
    cell_time: tuple[float, float],
    share: float,
    ease: float,
    most_bend: float,
    whole: int,
) -> tuple[Guess, FloatArray]:
    """Return the guess of the motion, and where cells are divided."""
    s, left, right, feed = path
    h = s[1:] - s[:-1]
    bounds = speed_guess.speed_bounds(h, left, right, feed, table)
    v = speed_guess.guess_speed(h, bounds, *start)
    inside, capped = speed_guess.speeds_inside(h, v, bounds)
    time = speed_guess.guess_time(h, v, inside)
    tau = min(max(share * time, cell_time[0]), cell_time[1], time / RAMP_CELLS)
    wanted = cell_times(s, feed, bounds, v, inside, capped, tau)
    eased = Guess(bounds, v, inside, ease * wanted)
    return Guess(bounds, v, inside, wanted), _grid_nodes(path, table, eased, most_bend, whole)


def planning_grid(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float],
    cell_time: tuple[float, float],
    share: float,
    most_bend: float,
    kept: FloatArray,
) -> PlanGrid:
    whole = int(np.searchsorted(path.s, kept[-1])) if len(kept) else 0
    given = path.s
    for attempt in range(MOST_ROUNDS + 1):
        # Later rounds refine only where the first guess was too coarse, so they are less strict.
        ease = 1.0 if attempt == 0 else 1.6
        most = ease**2 * most_bend
        guess, new = _divided(path.cells, table, start, cell_time, share, ease, most, whole)
        if len(new) == 0 or attempt == MOST_ROUNDS or len(path.s) + len(new) > MOST_NODES:
            break
        path = refine(path, new)
    return PlanGrid(path, *_group_cells(kept, path.cells, table, guess, most_bend / 3, given))


@njit(cache=True, nogil=True, error_model='numpy')
def _kinks(s: FloatArray, left: FloatArray, right: FloatArray, table: FloatArray) -> FloatArray:
    """Return where in cells a limit has a kink [m]: in its table, or where an axis turns."""
    found = [0.0 for _ in range(0)]
    c = np.empty(8)
    for i in range(left.shape[1]):
        h = s[i + 1] - s[i]
        for k in range(left.shape[2]):
            septic_coefficients(left[:, i, k], right[:, i, k], h, c)
            turns = table[DRIVE, k, 0] < np.inf and left[1, i, k] * right[1, i, k] < 0.0
            for p in range(table.shape[2] + int(turns)):
                order = int(p == table.shape[2])
                place = 0.0 if order else table[PLACE, k, p]
                start, end = left[order, i, k], right[order, i, k]
                if (place - start) * (end - place) <= 0.0:
                    continue
                low, high = 0.0, 1.0
                for _ in range(60):
                    u = 0.5 * (low + high)
                    q, q_s, _, _ = septic_jet(c, u, h)
                    if ((q_s if order else q) < place) == (start < end):
                        low = u
                    else:
                        high = u
                if NEAR < low < 1.0 - NEAR:
                    found.append(s[i] + low * h)
    return np.array(found)


def with_kinks(path: AxisPath, table: FloatArray) -> AxisPath:
    """Add grid points at the kinks of limits: else a long cell would hide a low limit inside."""
    if (table.shape[2] == 1 and not has_loads(table)) or len(path.s) < 2:
        return path
    return refine(path, _kinks(path.s, path.cell_left, path.cell_right, table))
