"""
Model of time: how long the machine takes along segments, without a plan of the feed.

The smoothing chooses between a corner and a stop, and between a curve and lines, by this model.
Each segment is divided into cells. At their ends the exact derivatives of the axes by path length
are known, and with them the feed limit of [B2013, Eq. 10],

    v <= min(F, V / |q_s|, sqrt(A / |q_ss|), cbrt(J / |q_sss|)).

Below it, |q_s| a <= A - |q_ss| v^2 and |q_s| j <= J - |q_sss| v^3 leave an acceleration a and a
jerk j along the path. A change of speed by D takes, from and to constant speed,

    T(D) = D / a + a / j    if D >= a^2 / j,    else  2 sqrt(D / j),

and its mean speed is that of both ends. So it takes the time and the way of the constant
acceleration D / T(D). One pass forwards and one backwards with these accelerations give the
speeds. D is the whole change between a lowest and a highest speed. It follows from the speeds, so
both passes are repeated. On straight lines from rest to rest the result is exact.
"""

from __future__ import annotations

from math import inf, sqrt

import numpy as np
from numba import njit

from cnc_interp.core import jet
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.jet import VectorJet
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.machine_model.transform_kernels import OUTER, linear_jets, rotary_jets
from cnc_interp.smoothing.segment_curves import corner_jets, line_jets, spline_jets
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

#: Cells of a line on which the tool turns, of half a corner, and of a span of a curve.
TURNING_CELLS, CORNER_CELLS, SPAN_CELLS = 8, 6, 4
#: Repetitions of both passes.
PASSES = 8


def segment_times(segments: PathSegments, machine: MachineTraits) -> FloatArray:
    """
    Estimate the time of each segment of a path from rest to rest.

    Parameters
    ----------
    segments : PathSegments
        Segments of poses; extra axes do not count, and rotations with the tip at rest take none.
    machine : MachineTraits
        Geometry and limits of the machine.

    Returns
    -------
    ndarray, shape (n,)
        Times [s].

    """
    assert machine.limits is not None
    rotary = machine.geometry is not None
    packed = machine.geometry.packed if machine.geometry is not None else np.zeros(1)
    limits = np.ascontiguousarray(machine.limits[:, : 5 if rotary else 3])
    times: FloatArray = _segment_times(
        packed, rotary, limits, segments.kind, segments.bottom, segments.top, segments.axis,
        segments.rotation, segments.connection, segments.parametrization, segments.feed,
        segments.stop,
    )  # fmt: skip
    return times


@njit(cache=True, nogil=True)
def _write_rates(
    packed: FloatArray, rotary: bool, tip: VectorJet, tool: VectorJet, out: FloatArray
) -> float:
    """Write |q_s|, |q_ss| and |q_sss| of the axes, shape (3, n), and return ds/du [m]."""
    dx = (tip[0][1], 2.0 * tip[0][2], 3.0 * tip[0][3], 0.0)
    dy = (tip[1][1], 2.0 * tip[1][2], 3.0 * tip[1][3], 0.0)
    dz = (tip[2][1], 2.0 * tip[2][2], 3.0 * tip[2][3], 0.0)
    square = jet.dot((dx, dy, dz), (dx, dy, dz))
    out[:] = 0.0
    if square[0] <= 0.0:
        return 0.0
    speed = jet.square_root(square)
    axes = (tip[0], tip[1], tip[2], (0.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0))
    if rotary:
        tilt, turn, sine_squared = rotary_jets(packed, tool, 1.0, 0.0, 0.0)
        still = True
        for i in range(3):
            still = still and tool[i][1] == 0.0 and tool[i][2] == 0.0 and tool[i][3] == 0.0
        if still or sine_squared <= 0.0:  # at the pole only a resting tool axis has rates
            tilt, turn = (tilt[0], 0.0, 0.0, 0.0), (turn[0], 0.0, 0.0, 0.0)
        first, second = (tilt, turn) if int(packed[OUTER]) == 1 else (turn, tilt)
        v = linear_jets(packed, tip, first, second)
        axes = (v[0], v[1], v[2], first, second)
    for i in range(out.shape[1]):
        q = jet.by_arc_length(axes[i], speed)
        out[0, i], out[1, i], out[2, i] = abs(q[1]), abs(q[2]), abs(q[3])
    return speed[0]


@njit(cache=True, nogil=True)
def _feed_limit(rates: FloatArray, limits: FloatArray) -> float:
    """Return the feed limit of [B2013, Eq. 10] [m/s]."""
    most = inf
    for i in range(rates.shape[1]):
        if rates[0, i] > 0.0:
            most = min(most, limits[0, i] / rates[0, i])
        if rates[1, i] > 0.0:
            most = min(most, sqrt(limits[1, i] / rates[1, i]))
        if rates[2, i] > 0.0:
            most = min(most, (limits[2, i] / rates[2, i]) ** (1.0 / 3.0))
    return most


@njit(cache=True, nogil=True)
def _acceleration(
    rates: FloatArray, limits: FloatArray, first: float, last: float, change: float
) -> float:
    """Return change of speed over its time in a cell with these speeds at its ends [m/s2]."""
    a, j = 0.0, 0.0
    for end in range(2):
        v = first if end == 0 else last
        least, least_jerk = inf, inf
        for i in range(rates.shape[2]):
            if rates[end, 0, i] > 0.0:
                left = limits[1, i] - rates[end, 1, i] * v**2
                least = min(least, max(left, 0.0) / rates[end, 0, i])
                left = limits[2, i] - rates[end, 2, i] * v**3
                least_jerk = min(least_jerk, max(left, 0.0) / rates[end, 0, i])
        a += 0.5 * least
        j += 0.5 * least_jerk
    if a == inf or change == inf:
        return min(a, 1e12)
    if a <= 0.0 or j <= 0.0 or change <= 0.0:
        return 0.0
    if change < a * a / j:
        return 0.5 * sqrt(j * change)
    return 1.0 / (1.0 / a + a / (j * change))


@njit(cache=True, nogil=True)
def _segment_times(
    packed: FloatArray, rotary: bool, limits: FloatArray, kind: IntArray, bottom: FloatArray,
    top: FloatArray, axis: FloatArray, rotation: FloatArray, connection: FloatArray,
    parametrization: FloatArray, feed: FloatArray, stop: BoolArray,
) -> FloatArray:  # fmt: skip
    """Return the time of each segment, shape (n,) [s]; arrays as in PathSegments."""
    n = len(kind)
    most = n * max(TURNING_CELLS, 2 * CORNER_CELLS)
    owner, length, cap = np.empty(most, dtype=np.int64), np.empty(most), np.empty(most)
    rates, node = np.zeros((most, 2, 3, limits.shape[1])), np.full(most + 1, inf)
    scratch, own = np.zeros((3, limits.shape[1])), np.zeros(2)
    count = 0
    for k in range(n):
        if kind[k] == ROTATION:
            node[count] = 0.0
            continue
        cells = 2 * CORNER_CELLS if kind[k] == CORNER else SPAN_CELLS
        if kind[k] == LINE:
            turns = rotation[k, 0] != 0.0 or rotation[k, 1] != 0.0 or rotation[k, 2] != 0.0
            cells = TURNING_CELLS if turns else 1
        for c in range(cells):
            middle, weight = (c + 0.5) / cells, 0.0
            for place in range(3):
                u = (c + 0.5 * place) / cells
                if kind[k] == CORNER:
                    tip, tool = corner_jets(
                        bottom[k], top[k], connection[k], parametrization[k], u, middle
                    )
                elif kind[k] == SPLINE:
                    tip, tool = spline_jets(bottom[k], top[k], connection[k], u)
                else:
                    tip, tool = line_jets(bottom[k], axis[k], rotation[k], u)
                into = scratch if place == 1 else rates[count, place // 2]
                speed = _write_rates(packed, rotary, tip, tool, into)
                weight += speed * (4.0 if place == 1 else 1.0) / (6.0 * cells)
            if weight <= 0.0:
                continue
            owner[count], length[count] = k, weight
            fastest = feed[k, 0 if middle < 0.5 else 1]
            if cells == 1:
                fastest = min(feed[k, 0], feed[k, 1])
            own[0] = _feed_limit(rates[count, 0], limits)
            own[1] = _feed_limit(rates[count, 1], limits)
            cap[count] = min(fastest, max(own[0], own[1]))
            node[count] = min(node[count], fastest, own[0])
            node[count + 1] = min(fastest, own[1])
            count += 1
        if stop[k]:
            node[count] = 0.0
    node[0] = node[count] = 0.0
    speed, damped, peak = np.zeros(count + 1), np.zeros(count + 1), np.zeros(count)
    rise, fall = np.full(count, inf), np.full(count, inf)
    up, down = np.zeros(count), np.zeros(count)
    for repetition in range(PASSES):
        for c in range(count):
            first, last = damped[c], damped[c + 1]
            up[c] = _acceleration(rates[c], limits, first, last, rise[c])
            down[c] = _acceleration(rates[c], limits, first, last, fall[c])
        speed[:] = node[: count + 1]
        for c in range(count):
            speed[c + 1] = min(speed[c + 1], sqrt(speed[c] ** 2 + 2.0 * up[c] * length[c]))
        for c in range(count - 1, -1, -1):
            speed[c] = min(speed[c], sqrt(speed[c + 1] ** 2 + 2.0 * down[c] * length[c]))
        for c in range(count):
            peak[c] = max(speed[c], speed[c + 1])
            if up[c] > 0.0 and down[c] > 0.0:
                square = 2.0 * up[c] * down[c] * length[c]
                square += down[c] * speed[c] ** 2 + up[c] * speed[c + 1] ** 2
                peak[c] = max(peak[c], min(cap[c], sqrt(square / (up[c] + down[c]))))
        # The whole rise and fall of which each cell is a part.
        first = 0
        for c in range(count):
            if c == count - 1 or speed[c + 1] < peak[c] * (1.0 - 1e-6):
                for i in range(first, c + 1):
                    rise[i] = peak[c] - speed[first]
                first = c + 1
        last = count - 1
        for c in range(count - 1, -1, -1):
            if c == 0 or speed[c] < peak[c] * (1.0 - 1e-6):
                for i in range(c, last + 1):
                    fall[i] = peak[c] - speed[last + 1]
                last = c - 1
        for c in range(count + 1):
            damped[c] = speed[c] if repetition == 0 else 0.5 * (damped[c] + speed[c])
    times = np.zeros(n)
    for c in range(count):
        way, time = length[c], 0.0
        if up[c] > 0.0 and down[c] > 0.0:
            way -= (peak[c] ** 2 - speed[c] ** 2) / (2.0 * up[c])
            way -= (peak[c] ** 2 - speed[c + 1] ** 2) / (2.0 * down[c])
            time = (peak[c] - speed[c]) / up[c] + (peak[c] - speed[c + 1]) / down[c]
            times[owner[c]] += time + max(way, 0.0) / max(peak[c], 1e-300)
        else:
            times[owner[c]] += 2.0 * way / max(speed[c] + speed[c + 1], 1e-300)
    return times
