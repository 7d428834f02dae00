"""The stop along the path from any state of motion, with the full braking that the axes allow.

With s_dot = v, s_ddot = a and s_dddot = j, the jerk of an axis is

    q_s j + 3 q_ss v a + q_sss v^3    [B2013, Eq. 8]

so at every state each axis leaves an interval of j. The stop takes its lower end, step by step,
until the deceleration can be brought back to zero together with the speed:

    v = a^2 / (2 j)    where j is a part of the jerk that a straight line would allow.

From there j = a^2 / (2 v) stays constant down to rest. The acceleration q_ss v^2 + q_s a [Eq. 7]
and the torque are kept, too. If an axis cannot follow, the release is tried earlier and slower,
then less braking. If none keeps the limits, the motion goes on as planned until there is a stop.

The limits hold at every instant of a step: at its ends and its middle by their values, between
them by the chord bound of ``limit_use.py``. A step whose bound is too large is halved.
"""

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.limit_kernels import JERK, VELOCITY, acceleration_room, limit_at
from cnc_interp.feedrate.limit_use import (
    TORQUE,
    bends_of_use,
    derivative_hulls,
    place_bounds,
)
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.kinematics import axis_path
from cnc_interp.kinematics.axis_path import AxisPath

STEP = 2e-3  #: Longest time with one jerk [s].
HALVINGS = 3  #: How often a step is halved until its bound keeps the limits.
SHARE = 0.05  #: Longest such time relative to that in which braking would take away all speed [-].
LEEWAY = 2e-4  #: Smallest part of every limit that braking leaves free [-].
ACCEPTED = 1.0 - 1e-4  #: Largest accepted use of a limit [-].
#: Jerk of the release, relative to a straight line; tried in this order [-].
RELEASES = (0.95, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
BRAKINGS = (1.0, 0.5)  #: Parts of the braking jerk that the axes leave; tried in this order [-].
LONGEST_STOP = 3.0  #: Longest stop that is looked for [s].
SAME = 1e-12  #: Places nearer than this are the same place [m].

FOUND, NO_RELEASE, NO_BRAKING = 0, 1, 2


@njit(cache=True, nogil=True, error_model='numpy')
def _left_by_axes(
    jet: FloatArray, v: float, a: float, table: FloatArray, leeway: float, out: FloatArray
) -> float:
    """Write lowest and highest j, lowest a, and highest j if straight; return the largest use."""
    out[0], out[1], out[2], out[3] = -np.inf, np.inf, -np.inf, np.inf
    worst = 0.0
    for i in range(jet.shape[0]):
        q, q_s, q_ss, q_sss = jet[i, 0], jet[i, 1], jet[i, 2], jet[i, 3]
        sign = 1.0 if q_s > 0.0 else -1.0
        forward, backward = acceleration_room(table, i, q, q_s * v)
        largest_j, along = limit_at(table, JERK, i, q), sign * (q_ss * v * v + q_s * a)
        bent, turned = q_ss * v * v, 3 * q_ss * v * a + q_sss * v**3
        worst = max(worst, abs(q_s * v) / limit_at(table, VELOCITY, i, q))
        worst = max(worst, along / forward, -along / backward)
        if q_s == 0.0:
            worst = max(worst, abs(turned) / largest_j, abs(bent) / forward)
            continue
        slope = abs(q_s)
        most = (1.0 - leeway) * largest_j
        out[0] = max(out[0], (-most - sign * turned) / slope)
        out[1] = min(out[1], (most - sign * turned) / slope)
        out[2] = max(out[2], (-(1.0 - leeway) * backward - sign * bent) / slope)
        out[3] = min(out[3], most / slope)
    return worst


@njit(cache=True, nogil=True, error_model='numpy')
def _enter(
    left: FloatArray,
    right: FloatArray,
    cell: int,
    h: float,
    septics: FloatArray,
    hulls: FloatArray,
) -> None:
    for i in range(left.shape[2]):
        axis_path.septic_coefficients(left[:, cell, i], right[:, cell, i], h, septics[i])
        derivative_hulls(septics[i], h, hulls[i])


@njit(cache=True, nogil=True, error_model='numpy')
def _is_bounded(
    table: FloatArray,
    places: FloatArray,
    hulls: FloatArray,
    law: tuple[float, float, float],
    duration: float,
    room: tuple[float, float],
) -> bool:
    """Say whether no use of a limit rises by more than a room between ends and middle of a step.

    ``law``: v, a and j at its begin; ``room``: of the jerk, and of all other limits [-].
    """
    v, a, j = law
    a_end = a + j * duration
    fast = max(v, v + duration * (a + duration * j / 2))
    if a * a_end < 0.0:
        fast = max(fast, v - a * a / (2 * j))
    bends, share = np.empty(4), (0.5 * duration) ** 2 / 8
    for i in range(len(hulls)):
        bends_of_use(table, places, i, hulls[i], fast, max(abs(a), abs(a_end)), abs(j), bends)
        if share * bends[JERK] > room[0]:
            return False
        if share * max(bends[0], bends[1], bends[TORQUE]) > room[1]:
            return False
    return True


@njit(cache=True, nogil=True, error_model='numpy')
def _jets_at(septics: FloatArray, u: float, h: float, jet: FloatArray) -> None:
    for i in range(len(septics)):
        jet[i, 0], jet[i, 1], jet[i, 2], jet[i, 3] = axis_path.septic_jet(septics[i], u, h)


@njit(cache=True, nogil=True)
def _time_to(distance: float, v: float, a: float, j: float, most: float) -> float:
    """Return the time to a distance that is reached before ``most``, with growing s [s]."""
    low, high = 0.0, most
    for _ in range(60):
        t = 0.5 * (low + high)
        if t * (v + t * (a / 2 + t * j / 6)) < distance:
            low = t
        else:
            high = t
    return high


@njit(cache=True, nogil=True)
def _may_release(release: float, straight: float, v: float, a: float) -> bool:
    """Return whether j = a^2 / (2 v) is at least a part of the jerk on a straight line."""
    return a < 0.0 and 2 * release * straight * v <= a * a


@njit(cache=True, nogil=True, error_model='numpy')
def _brake(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    stop: BoolArray,
    table: FloatArray,
    leeway: float,
    braking: float,
    release: float,
    begin: int,
    steps: FloatArray,
) -> tuple[int, int]:
    """Brake from s, v, a and cell of step ``begin`` to rest; write the columns of ``steps``.

    Duration, s, v, a, j, cell, and highest j if straight. Returns FOUND and the number of steps,
    or why there is no such stop and the step that failed.
    """
    jet, septics = np.empty((left.shape[2], 4)), np.empty((left.shape[2], 8))
    now, halfway, then = np.empty(4), np.empty(4), np.empty(4)
    hulls, places = np.empty((left.shape[2], 5)), place_bounds(table)
    s, v, a = steps[begin, 1], steps[begin, 2], steps[begin, 3]
    cell = int(steps[begin, 5])
    h = s_grid[cell + 1] - s_grid[cell]
    _enter(left, right, cell, h, septics, hulls)
    _jets_at(septics, (s - s_grid[cell]) / h, h, jet)
    worst_now = _left_by_axes(jet, v, a, table, leeway, now)
    releasing = False
    for k in range(begin, len(steps)):
        steps[k, 1], steps[k, 2], steps[k, 3] = s, v, a
        steps[k, 5], steps[k, 6] = cell, now[3]
        releasing = releasing or _may_release(release, now[3], v, a)
        longest, to_rest = min(STEP, SHARE * np.sqrt(v / now[3])), 0.0
        if releasing:
            j, to_rest = a * a / (2 * v), -2 * v / a
            longest = to_rest if to_rest < 1.5 * STEP else STEP
            if not now[0] <= j <= now[1]:
                return k, NO_RELEASE
        else:
            j = now[0] * braking if now[0] < 0.0 else now[0]
            j = max(j, (now[2] - a) / longest)
            if j > now[1]:
                return k, NO_BRAKING
        duration, at_border, rests, worst = longest, False, False, 0.0
        least, most, corrections, halvings = now[0], now[1], 0, 0
        while True:
            ahead = s_grid[cell + 1] - s
            duration = longest
            at_border = duration * (v + duration * (a / 2 + duration * j / 6)) >= ahead
            if at_border:
                duration = _time_to(ahead, v, a, j, longest)
            s_end = s + duration * (v + duration * (a / 2 + duration * j / 6))
            rests = releasing and s_end + SAME > s + v * to_rest / 3
            if rests:
                duration = to_rest
            v_end = 0.0 if rests else v + duration * (a + duration * j / 2)
            a_end = 0.0 if rests else a + duration * j
            if v_end < 0.0:
                return k, NO_RELEASE
            half = 0.5 * duration
            s_half = s + half * (v + half * (a / 2 + half * j / 6))
            v_half, a_half = v + half * (a + half * j / 2), a + half * j
            _jets_at(septics, (s_half - s_grid[cell]) / h, h, jet)
            worst = _left_by_axes(jet, v_half, a_half, table, leeway, halfway)
            _jets_at(septics, min((s_end - s_grid[cell]) / h, 1.0), h, jet)
            worst = max(worst, _left_by_axes(jet, v_end, a_end, table, leeway, then))
            least = max(now[0], halfway[0], then[0])
            most = min(now[1], halfway[1], then[1])
            wanted = min(max(j, least, (then[2] - a) / duration), most)
            if not releasing and corrections < 2 and abs(wanted - j) > 1e-9 * now[3]:
                j, corrections = wanted, corrections + 1
                continue
            room = leeway - 0.5 * LEEWAY, 1.0 - max(worst, worst_now)
            bounded = _is_bounded(table, places, hulls, (v, a, j), duration, room)
            if bounded or worst > ACCEPTED or halvings == HALVINGS:
                break
            longest, corrections, halvings = 0.5 * duration, 0, halvings + 1
        rounding = 0.5 * LEEWAY * then[3]
        if not bounded or worst > ACCEPTED or not least - rounding <= j <= most + rounding:
            return k, NO_RELEASE if releasing else NO_BRAKING
        steps[k, 0], steps[k, 4] = duration, j
        if rests:
            return k + 1, FOUND
        s, v, a = s_end, v_end, a_end
        now[:], worst_now = then, worst
        if at_border:
            cell += 1
            if cell + 1 == len(s_grid) or stop[cell]:
                return k, NO_BRAKING
            s, h = s_grid[cell], s_grid[cell + 1] - s_grid[cell]
            _enter(left, right, cell, h, septics, hulls)
            _jets_at(septics, 0.0, h, jet)
            worst_now = _left_by_axes(jet, v, a, table, leeway, now)
    return len(steps) - 1, NO_RELEASE


@njit(cache=True, nogil=True)
def _first_stop(
    s_grid: FloatArray,
    left: FloatArray,
    right: FloatArray,
    stop: BoolArray,
    start: FloatArray,
    table: FloatArray,
    leeway: float,
    brakings: FloatArray,
    releases: FloatArray,
    steps: FloatArray,
) -> int:
    """Try all ways to brake, which share first steps; return the steps of the first, or 0."""
    cell = max(min(np.searchsorted(s_grid, start[0], side='right') - 1, len(s_grid) - 2), 0)
    steps[0, 1:4], steps[0, 5] = start, cell
    for braking in brakings:
        known = 0
        for release in releases:
            begin = 0
            while begin < known:
                _, _, v, a, _, _, straight = steps[begin]
                if _may_release(release, straight, v, a):
                    break
                begin += 1
            known, outcome = _brake(
                s_grid, left, right, stop, table, leeway, braking, release, begin, steps
            )
            if outcome == FOUND:
                return int(known)
            if outcome == NO_BRAKING:
                break  # the release was not reached
    return 0


def stop_law(
    path: AxisPath,
    state: tuple[float, float, float],
    table: FloatArray,
    time: float,
    leeway: float = LEEWAY,
) -> PlannedPiece | None:
    """Return a stop from s, s_dot and s_ddot at ``time``; None if none keeps all limits."""
    if state[1] <= 0.0:
        return None
    steps = np.empty((round(LONGEST_STOP / STEP), 7))
    begin = grid_place(path, state[0])
    count = _first_stop(
        path.s,
        path.cell_left,
        path.cell_right,
        path.stop,
        np.array([begin, *state[1:]]),
        table,
        leeway,
        np.array(BRAKINGS),
        np.array(RELEASES),
        steps,
    )
    if count == 0:
        return None
    duration, s, v, a, j, cell, _ = np.ascontiguousarray(steps[:count].T)
    t = duration[-1]
    end = grid_place(path, float(s[-1] + t * (v[-1] + t * (a[-1] / 2 + t * j[-1] / 6))))
    if end == begin:
        return None  # as good as at rest
    part = cut_between(path, begin, end, np.array([begin, end]))
    begins = time + np.concatenate([[0.0], np.cumsum(duration)[:-1]])
    # A stop that ends within rounding of a border ends at it: the cell after it is cut off.
    cells = np.minimum(cell - cell[0], len(part.s) - 2).astype(np.int64)
    return PlannedPiece(part, MotionLaw(begins, duration, s, v, a, j, cells))


def grid_place(path: AxisPath, s: float) -> float:
    """Return a place on the path [m], or the grid point that is the same place."""
    nearest = path.s[max(int(np.searchsorted(path.s, s)) - 1, 0) :][:2]
    same = nearest[np.abs(nearest - s) < SAME]
    return float(same[0]) if len(same) else s


def cut_between(path: AxisPath, first: float, last: float, at: FloatArray) -> AxisPath:
    """Cut the path at two positions; all positions ``at`` [m], these two too, are grid points."""
    lowest = int(np.searchsorted(path.s, first, side='right')) - 1
    highest = int(np.searchsorted(path.s, last))
    lowest, highest = max(lowest, 0), min(max(highest, lowest + 1), len(path.s) - 1)
    part = axis_path.refine(axis_path.cut(path, lowest, highest), at)
    return axis_path.cut(
        part, int(np.searchsorted(part.s, first)), int(np.searchsorted(part.s, last))
    )
