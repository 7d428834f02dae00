"""
Proven bounds for passages of the pole: where a path is near to it, and how far the tool deviates.

Between two points du apart a function differs from its larger end value by at most
``K du^2 / 8``, with a bound K of its second derivative. K follows from bounds of the tool axis o
and of the path length s on a segment. These are hulls of B-spline control points: the tool is
D / |D|, D = top + connection - bottom, so ``|o_u| <= |D_u| / |D|`` and, along the sphere,
``|o_uu| <= |D_uu| / |D| + 2 |D_u|^2 / |D|^2``.
"""

from __future__ import annotations

from math import ceil, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.kinematics.segment_axes import (
    FOLLOWING,
    GUIDE_FROM,
    GUIDE_TO,
    arc_length,
    guide_jet,
    pose_jets,
)
from cnc_interp.machine_model.transform_kernels import (
    OUTER,
    PRIMARY,
    SECONDARY,
    guided_gap,
    vector_at,
)
from cnc_interp.smoothing.orientation import norm
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

#: Columns of the rates: bounds of |o_u|, of |o_uu| along the sphere, of |s_u| and of |s_uu|.
TURN, BEND, SPEED, RISE = range(4)
#: Parameters at which the distance from the pole is looked at first.
LOOKS = 9
#: A tool axis that turns less rests [-], and one that stays nearer to the pole stays on it [-].
NO_TURN, STAYS = 1e-12, 2e-5
#: Bisections for a place on a segment.
HALVINGS = 50
#: Path lengths that differ by less are equal [-], and the most parts of half a segment.
SAME_LENGTH, MOST_PARTS = 1e-15, 64
#: Largest number of points for a bound on one segment.
MOST_POINTS = 4000


def rates_of(segments: PathSegments) -> FloatArray:
    """Bound the derivatives by u of tool axis and path length on segments of poses."""
    found = np.zeros((len(segments), 4))
    straight = (segments.kind == LINE) | (segments.kind == ROTATION)
    found[straight, TURN] = norm(segments.rotation)[straight]
    found[straight, SPEED] = segments.length[straight]
    for kind, derivatives in ((CORNER, _corner_derivatives), (SPLINE, _quintic_derivatives)):
        rows = np.flatnonzero(segments.kind == kind)
        if not len(rows):
            continue
        bottom, top = segments.bottom[rows], segments.top[rows]
        tip, tip_bend = derivatives(bottom)
        up, up_bend = derivatives(top)
        f, f_bend = _parameter_rates(segments.parametrization[rows])
        lift = segments.connection[rows]
        degree = lift.shape[1] - 1
        first, second = np.diff(lift, axis=1), np.diff(lift, 2, axis=1)
        rate = tip + up * f + degree * _largest(first)
        bend = tip_bend + up_bend * f**2 + up * f_bend + degree * (degree - 1) * _largest(second)
        if not segments.parametrization.shape[1]:  # f(u) = u: the difference is one curve
            rate, bend = derivatives(top - bottom)
            rate, bend = (
                rate + degree * _largest(first),
                bend + degree * (degree - 1) * _largest(second),
            )
        tool = top[:, 0] - bottom[:, 0]
        size = norm(tool)
        count = 5 if kind == CORNER else 6
        middle = tool / size[:, None]
        if segments.parametrization.shape[1]:
            spread = np.ptp(top[:, :count], axis=1) + np.ptp(bottom[:, :count], axis=1)
            least = size - norm(spread) - _largest(lift)
        else:
            along = ((top - bottom)[:, :count] * middle[:, None]).sum(axis=2).min(axis=1)
            least = along - _largest(lift)
        least = np.maximum(least, 0.05 * size)
        found[rows, TURN] = rate / least
        found[rows, BEND] = bend / least + 2.0 * (rate / least) ** 2
        found[rows, SPEED], found[rows, RISE] = tip, tip_bend
    return found


def _largest(points: FloatArray) -> FloatArray:
    """Return the largest length among the vectors of each row, shape (n, k, 3) to (n,)."""
    return np.asarray(norm(points).max(axis=1, initial=0.0))


def _quintic_derivatives(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound both derivatives of quintic Bezier curves, shape (n, 6, 3)."""
    first = 5.0 * np.diff(points, axis=1)
    return _largest(first), _largest(4.0 * np.diff(first, axis=1))


def _corner_derivatives(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound both derivatives of cubic B-splines with the knots (0 0 0 0 .5 1 1 1 1)."""
    first = np.diff(points[:, :5], axis=1) * np.array([6.0, 3.0, 3.0, 6.0])[:, None]
    second = np.diff(first, axis=1) * np.array([4.0, 2.0, 4.0])[:, None]
    return _largest(first), _largest(second)


def _parameter_rates(spans: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Bound both derivatives of f on corners, shape (n, spans, 8)."""
    if not spans.shape[1]:
        return np.ones(len(spans)), np.zeros(len(spans))
    ends = np.concatenate([spans[:, 1:, 0], np.ones((len(spans), 1))], axis=1)
    length = np.maximum(ends - spans[:, :, 0], 1e-9)[..., None]
    first = 6.0 * np.diff(spans[..., 1:], axis=2) / length
    second = 5.0 * np.diff(first, axis=2) / length
    return np.abs(first).max(axis=(1, 2)), np.abs(second).max(axis=(1, 2))


@njit(cache=True, nogil=True)
def pole_sine(packed: FloatArray, kind: int, shape: FloatArray, f: FloatArray, u: float) -> float:
    """Return the sine of the angle between tool axis and pole at one point of a segment."""
    o = pose_jets(kind, shape, f, u, u)[1]
    pole = vector_at(packed, SECONDARY if packed[OUTER] > 0.5 else PRIMARY)
    x = o[1][0] * pole[2] - o[2][0] * pole[1]
    y = o[2][0] * pole[0] - o[0][0] * pole[2]
    z = o[0][0] * pole[1] - o[1][0] * pole[0]
    return sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def near_pole(
    packed: FloatArray, kinds: IntArray, shapes: FloatArray, f: FloatArray, turns: FloatArray,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """
    Find where segments are near to the pole.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    kinds, shapes, f : ndarray
        Segments of poses, as in ``sample``.
    turns : ndarray, shape (n,)
        Bounds of |o_u| [-].
    limits : ndarray, shape (n,)
        Sine of the angle from the pole that counts as near [-].

    Returns
    -------
    near : ndarray, shape (n, 2)
        First and last parameter of the part that is near; 2 and -1 without one.
    start : ndarray, shape (n,)
        Sine of the angle from the pole at the start of each segment [-].

    """
    n = len(kinds)
    near, start = np.empty((n, 2)), np.empty(n)
    u, sine = np.linspace(0.0, 1.0, LOOKS), np.empty(LOOKS)
    for i in range(n):
        near[i, 0], near[i, 1] = 2.0, -1.0
        kind, shape, spans, limit = kinds[i], shapes[i], f[i], limits[i]
        sine[0] = start[i] = pole_sine(packed, kind, shape, spans, 0.0)
        if sine[0] - turns[i] > limit:
            continue
        stays = turns[i] < NO_TURN or sine[0] + turns[i] <= STAYS
        if stays and sine[0] + turns[i] <= limit:
            near[i, 0], near[i, 1] = 0.0, 1.0
            continue
        for k in range(1, LOOKS):
            sine[k] = pole_sine(packed, kind, shape, spans, u[k])
        step = turns[i] / (LOOKS - 1.0)
        for k in range(LOOKS):
            if min(sine[max(k - 1, 0)], sine[min(k + 1, LOOKS - 1)]) < sine[k]:
                continue
            if sine[k] - step > limit:
                continue
            low, high = u[max(k - 1, 0)], u[min(k + 1, LOOKS - 1)]
            left, right = low, high
            for _ in range(HALVINGS):  # golden section for the nearest point
                a, b = right - 0.618 * (right - left), left + 0.618 * (right - left)
                if pole_sine(packed, kind, shape, spans, a) < pole_sine(
                    packed, kind, shape, spans, b
                ):
                    right = b
                else:
                    left = a
            best, least = u[k], sine[k]
            middle = pole_sine(packed, kind, shape, spans, 0.5 * (left + right))
            if middle < least:
                best, least = 0.5 * (left + right), middle
            if least > limit:
                continue
            for side in range(2):
                inside, outside = best, low if side == 0 else high
                if pole_sine(packed, kind, shape, spans, outside) <= limit:
                    inside = outside
                else:
                    for _ in range(HALVINGS):
                        half = 0.5 * (inside + outside)
                        if pole_sine(packed, kind, shape, spans, half) <= limit:
                            inside = half
                        else:
                            outside = half
                if side == 0:
                    near[i, 0] = min(near[i, 0], inside)
                else:
                    near[i, 1] = max(near[i, 1], inside)
    return near, start


@njit(cache=True, nogil=True)
def way_to(kind, shape, beside, length, u):  # type: ignore[no-untyped-def]
    """
    Return the path length from the start of a segment of poses to u [m].

    It is as exact as the sum of its cells: where the outer axis turns fast, a millionth of a
    micrometre would show as a jump. So each half is divided until the sum no longer changes.
    """
    total = 0.0
    for half in range(2):
        a, b = 0.5 * half, min(u, 0.5 + 0.5 * half)
        if b <= a:
            break
        found = arc_length(kind, FOLLOWING, shape, beside, 0.0, length, a, b)
        parts = 2
        while parts <= MOST_PARTS:
            before, found, step = found, 0.0, (b - a) / parts
            for k in range(parts):
                low, high = a + k * step, a + (k + 1) * step
                found += arc_length(kind, FOLLOWING, shape, beside, 0.0, length, low, high)
            if abs(found - before) <= SAME_LENGTH * found:
                break
            parts *= 2
        total += found
    return total


@njit(cache=True, nogil=True)
def place_at(kind: int, shape: FloatArray, beside: FloatArray, length: float, way: float) -> float:
    """Return the parameter at a path length [m] from the start of a segment of poses."""
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        u = 0.5 * (low + high)
        if way_to(kind, shape, beside, length, u) < way:
            low = u
        else:
            high = u
    return 0.5 * (low + high)


@njit(cache=True, nogil=True)
def lengths_of(
    kinds: IntArray, shapes: FloatArray, beside: FloatArray, lengths: FloatArray
) -> FloatArray:
    """Return the path lengths of segments of poses, shape (n,) [m]."""
    found = np.empty(len(kinds))
    for i in range(len(kinds)):
        found[i] = way_to(kinds[i], shapes[i], beside[i], lengths[i], 1.0)
    return found


@njit(cache=True, nogil=True)
def gap_bounds(
    packed: FloatArray, kinds: IntArray, shapes: FloatArray, beside: FloatArray, f: FloatArray,
    lengths: FloatArray, guides: FloatArray, rates: FloatArray, turning: FloatArray,
    allowed: FloatArray,
) -> FloatArray:  # fmt: skip
    """
    Bound by what angle the tool axis deviates where the outer axis is given.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    kinds, shapes, beside, f, lengths, guides : ndarray
        Segments of poses, as in ``sample``.
    rates : ndarray, shape (n, 4)
        Bounds of their derivatives.
    turning : ndarray, shape (2,)
        Bounds of both derivatives of the outer axis by path length [rad/m, rad/m^2].
    allowed : ndarray, shape (n,)
        How exact each bound should be [rad].

    Returns
    -------
    bounds : ndarray, shape (n,)
        Bounds of the deviation [rad].

    """
    bounds = np.zeros(len(kinds))
    w = vector_at(packed, PRIMARY if packed[OUTER] > 0.5 else SECONDARY)
    curved = abs(w[2]) / sqrt(w[0] * w[0] + w[1] * w[1]) + 0.1
    for i in range(len(kinds)):
        kind, shape, spans, length, guide = kinds[i], shapes[i], f[i], lengths[i], guides[i]
        first, last = max(0.0, guide[GUIDE_FROM]), min(1.0, guide[GUIDE_TO])
        if last <= first:
            continue
        o_u, o_uu, s_u, s_uu = rates[i]
        a_u, a_uu = turning[0] * s_u, turning[1] * s_u * s_u + turning[0] * s_uu
        sine = pole_sine(packed, kind, shape, spans, first)
        sine = min(1.0, max(sine, pole_sine(packed, kind, shape, spans, last))
                   + 0.5 * o_u * (last - first))  # fmt: skip
        second = curved * (o_u + a_u * sine) ** 2
        second += o_uu + 2.0 * a_u * o_u + (a_uu + a_u * a_u) * sine
        count = ceil((last - first) * sqrt(second / (8.0 * allowed[i])))
        count = min(max(count, 2), MOST_POINTS)
        step, worst, way = (last - first) / count, 0.0, 0.0
        before = 0.0
        for k in range(count + 1):
            u = first + k * step
            if k == 0 or (before < 0.5) != (u <= 0.5):
                way = way_to(kind, shape, beside[i], length, u)
            else:
                way += arc_length(kind, FOLLOWING, shape, beside[i], 0.0, length, before, u)
            o = pose_jets(kind, shape, spans, u, u)[1]
            gap = guided_gap(packed, o, guide_jet(guide, way)[0])
            worst, before = max(worst, abs(gap)), u
        bounds[i] = worst + second * step * step / 8.0
    return bounds
