"""VPOp: the motion law by steps forward in time, after [B2012] (docs/how_it_works/feedrate.md).

Where the axes allow no jerk, the law goes back to the earlier step with the highest least speed,
brakes, and goes on; if none passes, it holds a constant speed until the place is passed. At the
end j is the lowest one until v = a^2 / (2 j), and stays constant from there on.
"""

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.feedrate.jerk_stage import ACCEPTED
from cnc_interp.feedrate.limit_use import limit_use
from cnc_interp.feedrate.motion_law import CellLaw, Stretch
from cnc_interp.feedrate.plan_options import KeptCells, PlanOptions
from cnc_interp.feedrate.speed_guess import FASTEST, speed_bounds
from cnc_interp.feedrate.vpop_steps import (
    AT_END,
    BACKWARDS,
    CELL,
    FAILED,
    FULL,
    PASSED,
    RESTS,
    A,
    Curve,
    D,
    J,
    S,
    V,
    go_forward,
)
from cnc_interp.kinematics.axis_path import AxisPath, refine, septic_coefficients

MARGIN = 8.0  #: Number of steps by which a difficult place must be passed.
SPEEDS = 12  #: Number of speeds that are tried by bisection at one place.
GROWTH = 1.5  #: Growth of the number of steps by which the law goes back in a search [-].
#: Largest number of steps from the beginning of braking until a place is passed.
LONGEST_SEARCH = 8192
MOST_STEPS = 4_000_000  #: Largest number of steps in one stretch.
#: Jerk of the last part before rest, relative to a straight line; tried in this order [-].
RELEASES = (0.995, 0.97, 0.93, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
LANDED = 1e-13  #: Largest accepted distance between the rest and the end of the path [m].


@njit(cache=True, nogil=True, error_model='numpy')
def _from(state: FloatArray, rows: FloatArray) -> FloatArray:
    rows[0] = state
    return rows


@njit(cache=True, nogil=True, error_model='numpy')
def _touch(
    curve: Curve, state: FloatArray, passed: float, down: FloatArray, up: FloatArray
) -> tuple[float, int, bool]:
    """Brake from a state; find the first step from which the largest j passes a place.

    Returns the lowest speed (0: nothing passes), the braking steps, and whether braking alone
    ends before the place.
    """
    _, count = go_forward(curve, _from(state, down), -np.inf, 0.0, np.inf, 0.0)
    too_early = down[count, S] < passed
    low, high, found, speed = 0, count + 1, 0, 0.0
    while high - low > 1:
        m = (low + high) // 2
        end, more = go_forward(curve, _from(down[m], up), np.inf, 0.0, passed, MARGIN)
        if end in (PASSED, AT_END):
            found, speed = m, up[: more + 1, V].min()
        if end == FAILED:
            low = m
        else:
            high = m
    return speed, found, too_early


@njit(cache=True, nogil=True, error_model='numpy')
def _hold(
    curve: Curve, state: FloatArray, fastest: float, passed: float, rows: FloatArray
) -> float:
    """Return the highest speed to which the motion may change to pass a place; 0 if none."""
    low, high, found = 0.0, fastest, 0.0
    for _ in range(SPEEDS):
        speed = 0.5 * (low + high)
        end, _ = go_forward(curve, _from(state, rows), speed, 0.0, passed, MARGIN)
        if end == FAILED or end == BACKWARDS:
            high = speed
        else:
            low = speed
            found = speed if end != FULL else found
    return found


@njit(cache=True, nogil=True, error_model='numpy')
def _go_back(
    curve: Curve, rows: FloatArray, k: int, passed: float, trial: FloatArray, faster: FloatArray
) -> tuple[int, int]:
    """Change rows 0 to k so that the motion passes; return the row after and what ended it."""
    best, begin = 0.0, k
    back, enough = 0.0, np.inf
    # Farther and farther back, until braking ends before the place; then beside the best one.
    while back <= min(k, enough):
        m = k - int(back)
        speed, _, too_early = _touch(curve, rows[m], passed, trial, faster)
        if speed > best:
            best, begin = speed, m
        back = max(back + 1.0, GROWTH * back)
        if too_early and best > 0.0 and enough == np.inf:
            enough = GROWTH * back
    step = 0.5 * (GROWTH - 1.0) * (k - begin)
    while best > 0.0 and step >= 0.5:
        for side in (-1, 1):
            m = min(max(begin + side * int(np.ceil(step)), 0), k)
            speed, _, _ = _touch(curve, rows[m], passed, trial, faster)
            if speed > best:
                best, begin = speed, m
        step *= 0.5
    if best > 0.0:
        _, braking, _ = _touch(curve, rows[begin], passed, trial, faster)
        rows[begin : begin + braking + 1] = trial[: braking + 1]
        end, count = go_forward(curve, _from(trial[braking], faster), np.inf, 0.0, passed, MARGIN)
        rows[begin + braking : begin + braking + count + 1] = faster[: count + 1]
        return int(begin + braking + count), int(end)
    k, end = _pass_held(curve, rows, k, passed, trial, faster)
    return k, end


@njit(cache=True, nogil=True, error_model='numpy')
def _pass_held(
    curve: Curve, rows: FloatArray, k: int, passed: float, trial: FloatArray, faster: FloatArray
) -> tuple[int, int]:
    """Change rows 0 to k as ``_go_back`` does: hold a speed until the place is passed."""
    fastest = rows[: k + 1, V].max()
    begin, m, back, best = k, k, 1, 0.0
    while m > 0:
        m = max(k - back, 0)
        found = _hold(curve, rows[m], max(rows[m, V], 0.1 * fastest), passed, trial)
        if 0.0 < found <= 1.02 * best:
            break
        begin = m if found > 0.0 else begin
        best, back = max(best, found), 2 * back
    if not best > 0.0:
        return -1, FAILED
    late, speed = k + 1, 0.98 * best
    while late - begin > 1:
        m = (late + begin) // 2
        if go_forward(curve, _from(rows[m], trial), speed, 0.0, passed, MARGIN)[0] == PASSED:
            begin = m
        else:
            late = m
    end, count = go_forward(curve, _from(rows[begin], trial), speed, 0.0, passed, MARGIN)
    if end not in (PASSED, AT_END):
        return -1, FAILED
    rows[begin : begin + count + 1] = trial[: count + 1]
    place, low, high = trial[count, S], 0, count
    while high - low > 1:
        m = (low + high) // 2
        if go_forward(curve, _from(trial[m], faster), np.inf, 0.0, place, 0.0)[0] in (
            PASSED,
            AT_END,
        ):
            high = m
        else:
            low = m
    if high == count:
        return begin + count, end
    end, count = go_forward(curve, _from(trial[high], faster), np.inf, 0.0, place, 0.0)
    rows[begin + high : begin + high + count + 1] = faster[: count + 1]
    return begin + high + count, end


@njit(cache=True, nogil=True, error_model='numpy')
def _brake(
    curve: Curve, step: FloatArray, part: float, release: float, out: FloatArray
) -> tuple[int, float]:
    """Follow a step for a time, then brake to rest; return the steps and the distance left."""
    out[0] = step
    first, v, a, j = 0, step[V], step[A], step[J]
    if part > 0.0:
        first, out[0, D] = 1, part
        out[1, S] = step[S] + part * (v + part * (a / 2 + part * j / 6))
        out[1, V], out[1, A] = v + part * (a + part * j / 2), a + part * j
        out[1, CELL] = step[CELL]
    end, count = go_forward(curve, out[first:], 0.0, release, np.inf, 0.0)
    count += first
    return (count, curve[0][-1] - out[count, S]) if end == RESTS else (count, -1.0)


@njit(cache=True, nogil=True, error_model='numpy')
def _come_to_rest(
    curve: Curve, rows: FloatArray, k: int, release: float, out: FloatArray
) -> tuple[int, int]:
    """Find where braking begins so that it ends at the end of the path; (-1, 0) if it cannot."""
    late, begin, back = k, -1, 1
    while begin < 0:
        m = max(k - back, 0)
        if _brake(curve, rows[m], 0.0, release, out)[1] >= 0.0 or rows[m, V] == 0.0:
            begin = m
        elif m == 0:
            return -1, 0
        else:
            late, back = m, 2 * back
    while late - begin > 1:
        m = (late + begin) // 2
        if _brake(curve, rows[m], 0.0, release, out)[1] >= 0.0:
            begin = m
        else:
            late = m
    low, high = 0.0, rows[begin, D]
    for _ in range(200):
        part = 0.5 * (low + high)
        if part in (low, high):
            break
        left = _brake(curve, rows[begin], part, release, out)[1]
        if left >= 0.0:
            low = part
            if left <= 2e-16:
                break
        else:
            high = part
    count, left = _brake(curve, rows[begin], low, release, out)
    return (begin, count) if 0.0 <= left <= LANDED else (-1, 0)


@njit(cache=True, nogil=True, error_model='numpy')
def _arrive_slower(curve: Curve, rows: FloatArray, k: int, trial: FloatArray) -> int:
    """Change the last steps so that the motion comes to the end of the path at half the speed."""
    back, speed = 1, 0.5 * rows[k, V]
    while True:
        m = max(k - back, 0)
        end, count = go_forward(curve, _from(rows[m], trial), speed, 0.0, np.inf, 0.0)
        if end == AT_END:
            rows[m : m + count + 1] = trial[: count + 1]
            return int(m + count)
        if m == 0:
            return -1
        back *= 2


@njit(cache=True, nogil=True, error_model='numpy')
def _difficult_until(curve: Curve, state: FloatArray, steady: FloatArray) -> float:
    """Return the end of the cells from a state on in which its speed could not stay constant."""
    grid, cell = curve[0], int(state[CELL])
    place = state[S]
    if steady[cell] >= state[V] and grid[cell + 1] - place < MARGIN * curve[4] * state[V]:
        cell += 1
    while cell < len(steady) and steady[cell] < state[V]:
        cell += 1
        place = grid[cell]
    return float(place)


@njit(cache=True, nogil=True, error_model='numpy')
def _drive(
    curve: Curve, start: tuple[float, float], steady: FloatArray, releases: FloatArray
) -> FloatArray:
    """Return the steps from a state to rest at the end of the path; no row if it is stuck."""
    rows = np.empty((4 * LONGEST_SEARCH, 6))
    trial, faster = np.empty((LONGEST_SEARCH, 6)), np.empty((LONGEST_SEARCH, 6))
    rows[0, S], rows[0, V], rows[0, A], rows[0, CELL] = curve[0][0], start[0], start[1], 0
    k, end = 0, FAILED
    while end != AT_END:
        if k + 3 * LONGEST_SEARCH > len(rows):
            if len(rows) > MOST_STEPS:
                return rows[:0].copy()
            larger = np.empty((2 * len(rows), 6))
            larger[: len(rows)] = rows
            rows = larger
        end, count = go_forward(curve, rows[k : k + LONGEST_SEARCH], np.inf, 0.0, np.inf, 0.0)
        k += count
        if end in (FAILED, BACKWARDS):
            failed, passed = k, _difficult_until(curve, rows[k], steady)
            k, end = _go_back(curve, rows, failed, passed, trial, faster)
            if k < 0 and passed > rows[failed, S]:
                k, end = _go_back(curve, rows, failed, rows[failed, S], trial, faster)
            if k < 0:
                return rows[:0].copy()
    for _ in range(SPEEDS):
        for release in releases:
            begin, count = _come_to_rest(curve, rows, k, release, trial)
            if begin >= 0:
                rows[begin : begin + count + 1] = trial[: count + 1]
                return rows[: begin + count + 1].copy()
        k = _arrive_slower(curve, rows, k, trial)
        if k < 0:
            break
    return rows[:0].copy()


@njit(cache=True, nogil=True)
def _all_septics(h: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    out = np.empty((len(h), left.shape[2], 8))
    for i in range(len(h)):
        for k in range(left.shape[2]):
            septic_coefficients(left[:, i, k], right[:, i, k], h[i], out[i, k])
    return out


def plan(
    path: AxisPath,
    table: FloatArray,
    start: tuple[float, float] = (0.0, 0.0),
    options: PlanOptions | None = None,
    kept: KeptCells | None = None,
    tool: object = None,
) -> Stretch | None:
    """Plan from a state of motion to rest at the end of the path, by steps forward."""
    options = options or PlanOptions()
    septics = _all_septics(np.diff(path.s), path.cell_left, path.cell_right)
    # Counted from the start of the stretch, positions have the smallest rounding errors.
    curve = (path.s - path.s[0], septics, np.minimum(path.cell_feed, FASTEST), table, options.step)
    bounds = speed_bounds(np.diff(path.s), path.cell_left, path.cell_right, curve[2], table)
    rows = _drive(curve, start, bounds[:, 1].copy(), np.array(RELEASES))
    if not len(rows):
        return None
    rows[-1, S] = curve[0][-1]
    s = path.s[0] + rows[:, S]
    on_grid = np.searchsorted(curve[0], rows[:, S])
    s = np.where(curve[0][on_grid] == rows[:, S], path.s[on_grid], s)
    # A step that is shorter than the rounding of s is left out; its time is below 1e-15 m / v.
    s, rows = _without_empty_steps(s, rows)
    fine = refine(path, s)
    if len(fine.s) != len(s):
        return None
    n, n_axes = len(s) - 1, path.cell_left.shape[2]
    v, a, jerk, duration = (rows[:, column].copy() for column in (V, A, J, D))
    law = CellLaw(v, a, jerk[:-1], duration[:-1])
    use = np.empty((2, n, 4, n_axes))
    limit_use(fine.cells, law, table, ACCEPTED, np.ones(n, dtype=np.bool_), use)
    largest = float((use[0].max(axis=2) / ACCEPTED).max())
    if not largest <= 1.0:
        return None
    nodes = np.arange(n + 1, dtype=np.int64)
    return Stretch(
        fine, v, a, jerk[:-1].copy(), duration[:-1].copy(), nodes, np.ones((n, 4, n_axes)), largest
    )


def _without_empty_steps(s: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Drop the steps that do not advance by more than the rounding of the position s."""
    advance = np.diff(s) > 4.0 * np.spacing(s[-1])
    advance[-1] = True
    used = np.append(advance, True)
    return s[used], rows[used]
