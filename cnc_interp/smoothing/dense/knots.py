"""Knots and samples of a curve through dense blocks.

The blocks are a polyline of tool tips p and unit tool axes o. With the top point T = p + h o at
flank height h, the curve parameter u grows by du = sqrt((|dp|^2 + |dT|^2) / 2) per block. So u
also grows where the tip is slow and the tool turns.
"""

from math import ceil, sqrt

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.dense.polyline import Polyline

LONGEST, FINEST = 100.0, 2.0  #: Longest and shortest spacing of knots, in tolerances.
#: Distance after a window up to which the polyline influences its knots, in longest spacings.
AHEAD = 3.0
LADDER = 7  #: Number of spacings that are tried; each one is half of the spacing before.
BEND = 4.0  #: Largest second difference of the polyline over one spacing, in tolerances.
GROWTH = 0.5  #: Largest change of the spacing per unit of u [-].
DENSITY = 0.35  #: Largest distance of samples, as part of a spacing [-].


@njit(cache=True, nogil=True)
def _write_pose(line: Polyline, k: int, x: float, height: float, out: FloatArray) -> None:
    """Write tip and top at u = x on segment k of a polyline; its ends continue straight."""
    share = (x - line.u[k]) / (line.u[k + 1] - line.u[k])
    for i in range(6):
        out[i] = line.pose[k, i] + share * (line.pose[k + 1, i] - line.pose[k, i])
    size = out[3] * out[3] + out[4] * out[4] + out[5] * out[5]
    size = height / sqrt(size)
    for i in range(3):
        out[3 + i] = out[i] + size * out[3 + i]


@njit(cache=True, nogil=True)
def knot_spacings(line: Polyline, left: FloatArray, height: float, longest: float) -> FloatArray:
    """Return the wanted spacing of knots at each vertex of a polyline, shape (n,) [m].

    It is the longest one over which the second difference of the polyline stays below ``BEND``
    tolerances that are ``left`` (n - 1, 2). Along u it changes at most by ``GROWTH``.
    """
    u, n = line.u, len(line.u)
    least = np.empty(n - 1)
    for k in range(n - 1):
        least[k] = min(line.tolerance[k, 0], line.tolerance[k, 1])
    wanted = np.full(n, longest)
    before, here, after = np.empty(6), np.empty(6), np.empty(6)
    d = longest
    for _ in range(LADDER):
        back, forth = 0, 0
        for j in range(n):
            while back < n - 2 and u[back + 1] < u[j] - d:
                back += 1
            while forth < n - 2 and u[forth + 1] < u[j] + d:
                forth += 1
            k = min(j, n - 2)
            if wanted[j] == d and d >= FINEST * least[k]:  # longer spacings have been rejected
                _write_pose(line, back, u[j] - d, height, before)
                _write_pose(line, k, u[j], height, here)
                _write_pose(line, forth, u[j] + d, height, after)
                bottom, top = 0.0, 0.0
                for i in range(3):
                    bottom += (before[i] - 2.0 * here[i] + after[i]) ** 2
                    top += (before[3 + i] - 2.0 * here[3 + i] + after[3 + i]) ** 2
                if sqrt(bottom) > BEND * left[k, 0] or sqrt(top) > BEND * left[k, 1]:
                    wanted[j] = max(0.5 * d, FINEST * least[k])
        d *= 0.5
    for j in range(n):
        wanted[j] = min(wanted[j], LONGEST * min(least[min(j, n - 2)], least[max(j - 1, 0)]))
    for j in range(1, n):
        wanted[j] = min(wanted[j], wanted[j - 1] + GROWTH * (u[j] - u[j - 1]))
    for j in range(n - 2, -1, -1):
        wanted[j] = min(wanted[j], wanted[j + 1] + GROWTH * (u[j + 1] - u[j]))
    return wanted


@njit(cache=True, nogil=True)
def place_knots(
    u: FloatArray,
    wanted: FloatArray,
    start: float,
    end: float,
    factor: float,
    most: int,
) -> FloatArray:
    """Place knots; inside a long segment the spacing grows from both ends."""
    knots = np.empty(most + 1)
    knots[0] = start
    count, k = 0, 0
    n = len(u)
    while count < most and knots[count] < end:
        x = knots[count]
        while k < n - 2 and u[k + 1] <= x:
            k += 1
        d = min(
            wanted[k] + GROWTH * max(0.0, x - u[k]),
            wanted[k + 1] + GROWTH * max(0.0, u[k + 1] - x),
        )
        # The spacing must also fit the end of the span.
        j = k + 1
        while j < n and u[j] < x + d:
            d = min(d, wanted[j] + GROWTH * (u[j] - x))
            j += 1
        count += 1
        knots[count] = x + factor * d
    return knots[: count + 1].copy()


@njit(cache=True, nogil=True)
def sample_points(
    line: Polyline, left: FloatArray, knots: FloatArray, height: float
) -> tuple[FloatArray, IntArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return parameters, spans, poses, tool axes, tolerances and weights of m samples."""
    u, spans = line.u, len(knots) - 1
    first = 0
    while first < len(u) - 2 and u[first + 1] <= knots[0]:
        first += 1
    last = first
    while last < len(u) - 1 and u[last] < knots[spans]:
        last += 1
    room = 5 * (last - first + spans) + 16
    x, weight = np.empty(room), np.zeros(room)
    point, tool, allowed = np.empty((room, 6)), np.empty((room, 3)), np.empty((room, 2))
    span = np.empty(room, dtype=np.int64)
    count, s, k = 0, 0, first
    while k < len(u) - 1 and u[k] < knots[spans]:
        a, b = max(u[k], knots[0]), min(u[k + 1], knots[spans])
        position = a
        while position < b:
            while s < spans - 1 and knots[s + 1] <= position:
                s += 1
            # Long segments are sampled span by span, short segments as a whole.
            end = b
            if b - a > knots[s + 1] - knots[s]:
                end = min(b, knots[s + 1])
            step = end - position
            spacing = knots[s + 1] - knots[s]
            pairs = 0
            if step >= 0.5 * DENSITY * spacing:
                pairs = ceil(step / (2.0 * DENSITY * spacing))
            pieces = max(1, 2 * pairs)
            for p in range(pieces + 1):
                if p == 0 and count > 0:
                    at = count - 1  # the last point of the part before
                    for i in range(2):
                        allowed[at, i] = min(allowed[at, i], left[k, i])
                else:
                    at = count
                    count += 1
                    x[at] = position + step * p / pieces if p < pieces else end
                    _write_pose(line, k, x[at], height, point[at])
                    for i in range(3):
                        tool[at, i] = (point[at, 3 + i] - point[at, i]) / height
                    allowed[at, 0], allowed[at, 1] = left[k, 0], left[k, 1]
                if pairs == 0:
                    weight[at] += 0.5 * step
                else:
                    share = 1.0 if p in (0, pieces) else (4.0 if p % 2 == 1 else 2.0)
                    weight[at] += share * step / (3.0 * pieces)
            position = end
        k += 1
    s = 0
    for at in range(count):
        while s < spans - 1 and knots[s + 1] <= x[at]:
            s += 1
        span[at] = s
    return (
        x[:count].copy(),
        span[:count].copy(),
        point[:count].copy(),
        tool[:count].copy(),
        allowed[:count].copy(),
        weight[:count].copy(),
    )
