"""
VPOp: the motion law by steps forward in time, after [B2012]; offline, to compare with.

At each state (v, a) = (s_dot, s_ddot) every axis leaves an interval of j = s_dddot:

    |q_s j + 3 q_ss v a + q_sss v^3| <= J    [B2013, Eq. 8]
    |q_s a + q_ss v^2| <= A, |q_s v| <= V, v <= F at the end of the step    [Eq. 6, 7]

Each step takes the largest j of all intervals. Before a speed limit, j is lower, so that a is zero
when v gets there. A step ends after one period or at the border of a path cell.

If the intervals have no common j, the motion came too fast. Then the law goes back to an earlier
step, brakes with the lowest j, and goes on with the largest j; bisection finds the first step of
going on that passes the place. Of all earlier steps, the one with the highest least speed counts.
If none passes, the law brakes to a constant speed and holds it until the place is passed. If
nothing passes, the law is stuck, and there is no plan.

At the end of the path it brakes to rest: j is the lowest one until v = a^2 / (2 j) with nearly the
jerk of a straight line, and stays constant from there on. The moment at which braking begins is
found by bisection to rounding.

The idea is that of [B2012], the searches are our own. The constraints are applied to derivatives
of the exact path. A step never crosses a border of cells, where q_sss may jump.
"""

from __future__ import annotations

import numba
import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.jerk_stage import ACCEPTED
from cnc_interp.feedrate.limits import limit_use
from cnc_interp.feedrate.plan_options import KeptCells, PlanOptions
from cnc_interp.feedrate.speed_guess import FASTEST, speed_bounds
from cnc_interp.feedrate.stretch import Stretch
from cnc_interp.kinematics.axis_path import (
    AxisPath,
    refine,
    septic_coefficients,
    septic_value,
)

SLACK_SPEED, SLACK_FEED, SLACK = 2e-4, 2e-5, 1e-3
"""Part of velocity, feed, and acceleration and jerk limits that the steps leave free [-]."""

ROUNDS = 5
"""Largest number of corrections of j in one step."""

EASE = 0.9
"""Jerk with which a speed is approached, relative to what the axes leave [-]."""

SHARE = 0.1
"""Longest step near rest, relative to the time in which the jerk reaches the speed [-]."""

MARGIN = 8.0
"""Number of steps by which a difficult place must be passed."""

SPEEDS = 12
"""Number of speeds that are tried by bisection at one place."""

GROWTH = 1.5
"""Growth of the number of steps by which the law goes back in a search [-]."""

LONGEST_SEARCH = 8192
"""Largest number of steps from the beginning of braking until a place is passed."""

MOST_STEPS = 4_000_000
"""Largest number of steps in one stretch."""

RELEASES = (0.995, 0.97, 0.93, 0.9, 0.8, 0.7, 0.6, 0.5, 0.4)
"""Jerk of the last part before rest, relative to a straight line; tried in this order [-]."""

LANDED = 1e-13
"""Largest accepted distance between the rest and the end of the path [m]."""

S, V, A, J, D, CELL = 0, 1, 2, 3, 4, 5  # columns of a step: state at its start, j, duration, cell
PASSED, FAILED, AT_END, RESTS, FULL, BACKWARDS = 0, 1, 2, 3, 4, 5


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _leave(
    septics: FloatArray, u: float, h: float, v: float, a: float, table: FloatArray, out: FloatArray
) -> None:
    """Write lowest and highest j, lowest and highest a, highest j on a straight line, and v."""
    jet = np.empty(4)
    out[0], out[1], out[2], out[3], out[4], out[5] = (
        -np.inf,
        np.inf,
        -np.inf,
        np.inf,
        np.inf,
        np.inf,
    )
    for i in range(len(septics)):
        septic_value(septics[i], u, h, jet)
        q_s, bent = jet[1], jet[2] * v * v
        turned = (3 * jet[2] * a + jet[3] * v * v) * v
        jerk, acceleration = (1 - SLACK) * table[2, i], (1 - SLACK) * table[1, i]
        if q_s == 0.0:
            if abs(turned) > jerk or abs(bent) > acceleration:
                out[0], out[1] = np.inf, -np.inf
            continue
        if q_s < 0.0:
            q_s, bent, turned = -q_s, -bent, -turned
        out[0] = max(out[0], (-jerk - turned) / q_s)
        out[1] = min(out[1], (jerk - turned) / q_s)
        out[2] = max(out[2], (-acceleration - bent) / q_s)
        out[3] = min(out[3], (acceleration - bent) / q_s)
        out[4] = min(out[4], jerk / q_s)
        out[5] = min(out[5], (1 - SLACK_SPEED) * table[0, i] / q_s)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _time_to(x: float, v: float, a: float, j: float, most: float) -> float:
    """Return the time to the distance x, which is reached before ``most`` (Newton, bisection)."""
    low, high, t = 0.0, most, 0.5 * most
    for _ in range(80):
        off = t * (v + t * (a / 2 + t * j / 6)) - x
        if off > 0.0:
            high = t
        else:
            low = t
        speed = v + t * (a + t * j / 2)
        new = t - off / speed if speed > 0.0 else 0.5 * (low + high)
        if not low <= new <= high:
            new = 0.5 * (low + high)
        if abs(new - t) <= 1e-16 * high:
            return new
        t = new
    return t


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _step_time(longest: float, ahead: float, v: float, a: float, j: float) -> tuple[float, bool]:
    """Return the time of a step and whether it ends at the border; no short rest is left."""
    for factor in (1.2, 2.0):
        t = factor * longest
        if t * (v + t * (a / 2 + t * j / 6)) >= ahead and v + t * (a + t * j / 2) > 0.0:
            t = _time_to(ahead, v, a, j, t)
            return (t, True) if factor == 1.2 else (0.5 * t, False)
    return longest, False


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _last_a(room: float, jerk: float, t: float, otherwise: float) -> float:
    """Return the a from which a = 0 can be reached before v has changed by ``room``."""
    return jerk * (np.sqrt(t * t / 4 + 2 * room / jerk) - t / 2) if room >= 0.0 else otherwise


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _steps(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    rows: FloatArray,
    target: float,
    release: float,
    passed: float,
    margin: float,
) -> tuple[int, int]:
    """
    Go forward from the state in row 0; return what ended it, and the number of steps.

    Above the speed ``target`` j is the lowest one, below it the largest one. With ``release`` j is
    the lowest one down to rest. It ends ``margin`` steps after the position ``passed``, without a
    target when s_dot falls no more.
    """
    grid, septics, feed, table, longest = curve
    k, s, v, a, cell = 0, rows[0, S], rows[0, V], rows[0, A], int(rows[0, CELL])
    now, then = np.empty(6), np.empty(6)
    releasing, after, to_rest = False, 0.0, 0.0
    while True:
        if k + 1 >= len(rows):
            return FULL, k
        if cell + 1 >= len(grid):
            return AT_END, k
        if s > passed:
            after += 1.0
            if after > margin and (a >= 0.0 or target < np.inf):
                return PASSED, k
        start, h, c = grid[cell], grid[cell + 1] - grid[cell], septics[cell]
        ahead, cap = grid[cell + 1] - s, (1 - SLACK_FEED) * feed[cell]
        _leave(c, (s - start) / h, h, v, a, table, now)
        if v > min(cap, now[5]) * (1 + 0.5 * SLACK_FEED):
            return FAILED, k
        brakes = release > 0.0 or v > target
        releasing = releasing or (
            a < 0.0
            and 2 * release * now[4] * v > 0.0
            and 2 * release * now[4] * v <= a * a * (1 + 1e-12)
        )
        dt = longest
        if releasing:
            to_rest = -2 * v / a
            dt = to_rest if to_rest < 1.5 * dt else dt
            j = a * a / (2 * v)
        else:
            near_rest = SHARE * np.sqrt(v / now[4])
            if release > 0.0:
                dt = min(dt, near_rest)
            elif v < now[4] * (4 * dt) ** 2:
                dt = min(dt, max(near_rest, 0.1 * dt))
            j = now[0] if brakes else now[1]
        d, at_border, rests, sound = dt, False, False, False
        for attempt in range(ROUNDS):
            d, at_border = _step_time(dt, ahead, v, a, j)
            if releasing and d >= to_rest:
                d, at_border, rests = to_rest, False, True
            lo, hi, sound = now[0], now[1], True
            grace = 0.5 * SLACK * now[4]
            sound = lo - grace <= j <= hi + grace
            for p in range(1, 4):
                t = d * p / 3
                v_t, a_t = v + t * (a + t * j / 2), a + t * j
                x = t * (v + t * (a / 2 + t * j / 6))
                _leave(c, min((s - start + x) / h, 1.0), h, max(v_t, 0.0), a_t, table, then)
                grace = 0.5 * SLACK * then[4]
                sound = sound and then[0] - grace <= j <= then[1] + grace and v_t > -1e-12
                grace = 0.5 * SLACK * max(then[3] - then[2], 0.0)
                sound = sound and then[2] - 0.5 * grace <= a_t <= then[3] + 0.5 * grace
                sound = sound and v_t <= min(cap, then[5]) * (1 + 0.5 * SLACK_FEED)
                t = max(t, 0.25 * longest)
                lo = max(lo, then[0], (then[2] - a) / t)
                hi = min(hi, then[1], (then[3] - a) / t)
            if releasing:
                break
            if release == 0.0:
                t = max(d, 0.25 * longest)
                top = min(cap, then[5]) if brakes else min(cap, then[5], target)
                jerk = EASE * max(min(now[4], -now[0]), 0.1 * now[4])
                rise = _last_a(top - v - a * t / 2, jerk, t, 2 * (top - v) / t - a)
                jerk = EASE * max(min(now[4], now[1]), 0.1 * now[4])
                fall = _last_a(v + a * t / 2 - target, jerk, t, 2 * (v - target) / t + a)
                least, most = lo, hi
                hi = min(hi, max((rise - a) / t, least))
                lo = max(lo, min((-fall - a) / t, most)) if brakes else lo
            wanted = 0.5 * (lo + hi) if lo > hi else lo if brakes else hi
            if attempt + 1 == ROUNDS or abs(wanted - j) <= 1e-6 * now[4]:
                break
            j = wanted
        v_end, a_end = v + d * (a + d * j / 2), a + d * j
        if v_end < -1e-12 or not (rests or v + v_end > 0.0):
            return BACKWARDS, k
        if not sound:
            return FAILED, k
        if release > 0.0 and not releasing and a_end < 0.0:
            if 2 * release * then[4] * v_end <= a_end * a_end:
                d = _release_time(c, s - start, h, (v, a, j, d), table, release, then)
                at_border = at_border and d == _step_time(dt, ahead, v, a, j)[0]
                v_end, a_end = v + d * (a + d * j / 2), a + d * j
        x = d * (v + d * (a / 2 + d * j / 6))
        if not at_border and x > ahead:
            return AT_END if cell + 2 == len(grid) else FAILED, k
        rows[k, J], rows[k, D] = j, d
        s = grid[cell + 1] if at_border else s + x
        v, a = (0.0, 0.0) if rests else (max(v_end, 0.0), a_end)
        cell += 1 if at_border else 0
        k += 1
        rows[k, S], rows[k, V], rows[k, A], rows[k, CELL] = s, v, a, cell
        if rests:
            return RESTS, k


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _release_time(
    septics: FloatArray,
    along: float,
    h: float,
    step: tuple[float, float, float, float],
    table: FloatArray,
    release: float,
    out: FloatArray,
) -> float:
    """Return the time within a step (v, a, j, duration) at which the release begins."""
    v, a, j, high = step
    low = 0.0
    for _ in range(100):
        t = 0.5 * (low + high)
        if t in (low, high):
            break
        x = t * (v + t * (a / 2 + t * j / 6))
        v_t, a_t = v + t * (a + t * j / 2), a + t * j
        _leave(septics, min((along + x) / h, 1.0), h, v_t, a_t, table, out)
        if a_t < 0.0 and 2 * release * out[4] * v_t <= a_t * a_t:
            high = t
        else:
            low = t
    return high


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _from(state: FloatArray, rows: FloatArray) -> FloatArray:
    """Write a state into the first row."""
    rows[0] = state
    return rows


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _touch(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    state: FloatArray,
    passed: float,
    down: FloatArray,
    up: FloatArray,
) -> tuple[float, int, bool]:
    """
    Brake from a state, and find the first step from which the largest j passes a place.

    Returns the lowest speed, 0 if nothing passes, the number of braking steps in ``down``, and
    whether braking alone ends before the place.
    """
    _, count = _steps(curve, _from(state, down), -np.inf, 0.0, np.inf, 0.0)
    too_early = down[count, S] < passed
    low, high, found, speed = 0, count + 1, 0, 0.0
    while high - low > 1:
        m = (low + high) // 2
        end, more = _steps(curve, _from(down[m], up), np.inf, 0.0, passed, MARGIN)
        if end in (PASSED, AT_END):
            found, speed = m, up[: more + 1, V].min()
        if end == FAILED:
            low = m
        else:
            high = m
    return speed, found, too_early


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _hold(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    state: FloatArray,
    fastest: float,
    passed: float,
    rows: FloatArray,
) -> float:
    """Return the highest speed to which the motion may change to pass a place; 0 if none."""
    low, high, found = 0.0, fastest, 0.0
    for _ in range(SPEEDS):
        speed = 0.5 * (low + high)
        end, _ = _steps(curve, _from(state, rows), speed, 0.0, passed, MARGIN)
        if end == FAILED or end == BACKWARDS:
            high = speed
        else:
            low = speed
            found = speed if end != FULL else found
    return found


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _go_back(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    rows: FloatArray,
    k: int,
    passed: float,
    trial: FloatArray,
    faster: FloatArray,
) -> tuple[int, int]:
    """
    Change the steps of rows 0 to k so that the motion passes the position ``passed``.

    Returns the row after the last step and what ended it; the row is negative if nothing passes.
    """
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
        end, count = _steps(curve, _from(trial[braking], faster), np.inf, 0.0, passed, MARGIN)
        rows[begin + braking : begin + braking + count + 1] = faster[: count + 1]
        return int(begin + braking + count), int(end)
    k, end = _pass_held(curve, rows, k, passed, trial, faster)
    return k, end


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _pass_held(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    rows: FloatArray,
    k: int,
    passed: float,
    trial: FloatArray,
    faster: FloatArray,
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
        if _steps(curve, _from(rows[m], trial), speed, 0.0, passed, MARGIN)[0] == PASSED:
            begin = m
        else:
            late = m
    end, count = _steps(curve, _from(rows[begin], trial), speed, 0.0, passed, MARGIN)
    if end not in (PASSED, AT_END):
        return -1, FAILED
    rows[begin : begin + count + 1] = trial[: count + 1]
    place, low, high = trial[count, S], 0, count
    while high - low > 1:
        m = (low + high) // 2
        if _steps(curve, _from(trial[m], faster), np.inf, 0.0, place, 0.0)[0] in (PASSED, AT_END):
            high = m
        else:
            low = m
    if high == count:
        return begin + count, end
    end, count = _steps(curve, _from(trial[high], faster), np.inf, 0.0, place, 0.0)
    rows[begin + high : begin + high + count + 1] = faster[: count + 1]
    return begin + high + count, end


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _brake(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    step: FloatArray,
    part: float,
    release: float,
    out: FloatArray,
) -> tuple[int, float]:
    """Follow a step for a time, then brake to rest; return the steps and the distance left."""
    out[0] = step
    first, v, a, j = 0, step[V], step[A], step[J]
    if part > 0.0:
        first, out[0, D] = 1, part
        out[1, S] = step[S] + part * (v + part * (a / 2 + part * j / 6))
        out[1, V], out[1, A] = v + part * (a + part * j / 2), a + part * j
        out[1, CELL] = step[CELL]
    end, count = _steps(curve, out[first:], 0.0, release, np.inf, 0.0)
    count += first
    return (count, curve[0][-1] - out[count, S]) if end == RESTS else (count, -1.0)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _come_to_rest(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    rows: FloatArray,
    k: int,
    release: float,
    out: FloatArray,
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


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _arrive_slower(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    rows: FloatArray,
    k: int,
    trial: FloatArray,
) -> int:
    """Change the last steps so that the motion comes to the end of the path at half the speed."""
    back, speed = 1, 0.5 * rows[k, V]
    while True:
        m = max(k - back, 0)
        end, count = _steps(curve, _from(rows[m], trial), speed, 0.0, np.inf, 0.0)
        if end == AT_END:
            rows[m : m + count + 1] = trial[: count + 1]
            return int(m + count)
        if m == 0:
            return -1
        back *= 2


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _difficult_until(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    state: FloatArray,
    steady: FloatArray,
) -> float:
    """Return the end of the cells from a state on in which its speed could not stay constant."""
    grid, cell = curve[0], int(state[CELL])
    place = state[S]
    if steady[cell] >= state[V] and grid[cell + 1] - place < MARGIN * curve[4] * state[V]:
        cell += 1
    while cell < len(steady) and steady[cell] < state[V]:
        cell += 1
        place = grid[cell]
    return float(place)


@numba.njit(cache=True, nogil=True, error_model='numpy')
def _drive(
    curve: tuple[FloatArray, FloatArray, FloatArray, FloatArray, float],
    start: tuple[float, float],
    steady: FloatArray,
    releases: FloatArray,
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
        end, count = _steps(curve, rows[k : k + LONGEST_SEARCH], np.inf, 0.0, np.inf, 0.0)
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


@numba.njit(cache=True, nogil=True)
def _all_septics(h: FloatArray, left: FloatArray, right: FloatArray) -> FloatArray:
    """Return the coefficients of all cells, shape (n, n_axes, 8)."""
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
) -> Stretch | None:
    """
    Plan from a state of motion to rest at the end of the path, by steps forward.

    Parameters
    ----------
    path : AxisPath
        Path without stops inside.
    table : ndarray, shape (3, n_axes)
        Velocity, acceleration and jerk limits of the axes.
    start : tuple of float
        s_dot and s_ddot at the start of the path [m/s, m/s2].
    options : PlanOptions, optional
        Settings of the planner: the longest step, and the instants at which limits are checked.
    kept : KeptCells, optional
        Cells of an older plan; they are not needed here.

    Returns
    -------
    Stretch or None
        A law that keeps every limit, or None if the steps are stuck: nothing passes a place.

    """
    options = options or PlanOptions()
    septics = _all_septics(np.diff(path.s), path.cell_left, path.cell_right)
    # Counted from the start of the stretch, positions have the smallest rounding errors.
    curve = (
        path.s - path.s[0], septics, np.minimum(path.cell_feed, FASTEST), table, options.step
    )  # fmt: skip
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
    use = np.empty((2, n, 4, n_axes))
    limit_use(
        np.diff(fine.s), fine.cell_left, fine.cell_right, fine.cell_feed,
        v, a, jerk[:-1], duration[:-1], table, np.full(n, options.points), use,
    )  # fmt: skip
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
