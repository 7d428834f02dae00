"""Steps forward in time: the kernels below VPOp (``vpop.py``).

At each state (v, a) = (s_dot, s_ddot) every axis leaves an interval of j = s_dddot:

    |q_s j + 3 q_ss v a + q_sss v^3| <= J    [B2013, Eq. 8]
    |q_s a + q_ss v^2| <= A, |q_s v| <= V, v <= F at the end of the step    [Eq. 6, 7]

and the torque of its drive. Each step takes the largest j, or the lowest one to brake, for one
period or to the border of a path cell; before a speed limit a is zero when v gets there.
"""

from typing import TypeAlias

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.kernels import njit
from cnc_interp.core.limits_by_position import JERK, VELOCITY, acceleration_room, limit_at
from cnc_interp.feedrate.motion_law import time_at
from cnc_interp.kinematics.axis_path import septic_jet

#: Ends of the cells from 0 on, septics and largest feed of each, limits, and the longest step.
Curve: TypeAlias = tuple[FloatArray, FloatArray, FloatArray, FloatArray, float]
#: Part of velocity, feed, and acceleration and jerk limits that the steps leave free [-].
SLACK_SPEED, SLACK_FEED, SLACK = 2e-4, 2e-5, 1e-3
ROUNDS = 5  #: Largest number of corrections of j in one step.
EASE = 0.9  #: Jerk with which a speed is approached, relative to what the axes leave [-].
#: Longest step near rest, relative to the time in which the jerk reaches the speed [-].
SHARE = 0.1

S, V, A, J, D, CELL = 0, 1, 2, 3, 4, 5  # columns of a step: state at its start, j, duration, cell
PASSED, FAILED, AT_END, RESTS, FULL, BACKWARDS = 0, 1, 2, 3, 4, 5


@njit(cache=True, nogil=True, error_model='numpy')
def _leave(
    septics: FloatArray, u: float, h: float, v: float, a: float, table: FloatArray, out: FloatArray
) -> None:
    """Write lowest and highest j, lowest and highest a, highest j on a straight line, and v."""
    out[:] = np.inf
    out[0], out[2] = -np.inf, -np.inf
    for i in range(len(septics)):
        q, q_s, q_ss, q_sss = septic_jet(septics[i], u, h)
        bent = q_ss * v * v
        turned = (3 * q_ss * a + q_sss * v * v) * v
        jerk = (1 - SLACK) * limit_at(table, JERK, i, q)
        forward, backward = acceleration_room(table, i, q, q_s * v)
        forward, backward = (1 - SLACK) * forward, (1 - SLACK) * backward
        if q_s == 0.0:
            if abs(turned) > jerk or abs(bent) > forward:
                out[0], out[1] = np.inf, -np.inf
            continue
        if q_s < 0.0:
            q_s, bent, turned = -q_s, -bent, -turned
        out[0] = max(out[0], (-jerk - turned) / q_s)
        out[1] = min(out[1], (jerk - turned) / q_s)
        out[2] = max(out[2], (-backward - bent) / q_s)
        out[3] = min(out[3], (forward - bent) / q_s)
        out[4] = min(out[4], jerk / q_s)
        out[5] = min(out[5], (1 - SLACK_SPEED) * limit_at(table, VELOCITY, i, q) / q_s)


@njit(cache=True, nogil=True, error_model='numpy')
def _step_time(longest: float, ahead: float, v: float, a: float, j: float) -> tuple[float, bool]:
    """Return the time of a step and whether it ends at the border; no short rest is left."""
    for factor in (1.2, 2.0):
        t = factor * longest
        if t * (v + t * (a / 2 + t * j / 6)) >= ahead and v + t * (a + t * j / 2) > 0.0:
            t = time_at(ahead, v, a, j, 0.0, t)
            return (t, True) if factor == 1.2 else (0.5 * t, False)
    return longest, False


@njit(cache=True, nogil=True, error_model='numpy')
def _last_a(room: float, jerk: float, t: float, otherwise: float) -> float:
    """Return the a from which a = 0 can be reached before v has changed by ``room``."""
    return jerk * (np.sqrt(t * t / 4 + 2 * room / jerk) - t / 2) if room >= 0.0 else otherwise


@njit(cache=True, nogil=True, error_model='numpy')
def go_forward(
    curve: Curve, rows: FloatArray, target: float, release: float, passed: float, margin: float
) -> tuple[int, int]:
    """Go forward from the state in row 0; return what ended it, and the number of steps.

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
        least = 2 * release * now[4] * v
        releasing = releasing or (a < 0.0 and 0.0 < least <= a * a * (1 + 1e-12))
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


@njit(cache=True, nogil=True, error_model='numpy')
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
