"""
Proven bounds of the orientation deviation of a corner, for every way to construct it.

On each smooth piece of a corner two errors are analytic in u (o' is the programmed axis, Eq. 4):

    axis error   h (o(u) - o'(x))                   x: foot of the tip on its programmed line
    top error    p(u) + h o(u) - p'(x) - h o'(x)    x: foot of the top point on its polygon,
                                                       or the corner if that is nearer

A polynomial of degree n interpolates such an error at Chebyshev points of an interval. The
remainder is at most 4 M rho^-n / (rho - 1), where M bounds the error in the Bernstein ellipse rho
around the interval [T2013, theorem 8.2]. M follows from the Taylor coefficients of the curves at
the middle of the interval. The polynomial lies in the hull of its Bezier points. The sum of both
is a proven bound. An interval is halved until its bound is within the factor ``CLOSE`` of the
largest error at any Chebyshev point of the corner.
"""

from __future__ import annotations

from math import comb, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.corner_spline import corner_spline_jet
from cnc_interp.smoothing.corners.corner_curves import Curves
from cnc_interp.smoothing.corners.interval_bounds import (
    AXIS,
    CHORD,
    CLOSE,
    HALVINGS,
    LEG,
    OUTER,
    SCALARS,
    SLOPE,
    TURN,
    bound_interval,
    scalar_product,
)
from cnc_interp.smoothing.segment_curves import corner_breaks, span_at

#: Errors below this value are rounding errors of coordinates [m].
ROUNDING = 1e-14
BINOMIAL = np.array([[float(comb(n, k)) for k in range(8)] for n in range(8)])


def orientation_bounds(
    curves: Curves,
    legs: FloatArray,
    rates: FloatArray,
    outer: FloatArray,
    height: float,
    least: FloatArray,
    both: BoolArray,
) -> FloatArray:
    """Compute a proven bound of the orientation deviation of corners."""
    return np.asarray(
        _bounds_of(
            curves.bottom, curves.top, curves.connection, curves.parametrization,
            legs, rates, outer, height, least, both,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True)
def _bounds_of(
    bottom: FloatArray, top: FloatArray, connection: FloatArray, parametrization: FloatArray,
    legs: FloatArray, rates: FloatArray, outer: FloatArray, height: float, least: FloatArray,
    both: BoolArray,
) -> FloatArray:  # fmt: skip
    """Return the bounds of many corners, shape (n,) [m]."""
    bounds = least.copy()
    for i in range(len(bottom)):
        lift, largest_seen = _powers(connection[i]), least[i]
        lines = _programmed_lines(bottom[i], top[i], legs[i], rates[i], outer[i], height)
        breaks = corner_breaks(parametrization[i])
        for k in range(len(breaks) - 1):
            largest_seen, bounds[i] = _bound_piece(
                breaks[k], breaks[k + 1], bottom[i], top[i], lift, parametrization[i], lines,
                height, largest_seen, bounds[i], both[i],
            )  # fmt: skip
    return bounds


@njit(cache=True, nogil=True)
def _programmed_lines(
    bottom: FloatArray, top: FloatArray, legs: FloatArray, rates: FloatArray, outer: FloatArray,
    height: float,
) -> FloatArray:  # fmt: skip
    """
    Return the programmed data on both sides of a corner, shape (2, 5, 3).

    At x metres from the corner the programmed axis is cos(turn x) axis + sin(turn x) slope. The
    foot of the top point is x = (top point - corner of the top polygon) . chord.
    """
    found = np.zeros((2, 5, 3))
    for side in range(2):
        square = turn = 0.0
        for c in range(3):
            turn += rates[side, c] ** 2
            square += (top[4 * side, c] - top[2, c]) ** 2
        turn = sqrt(turn)
        sense = (2.0 * side - 1.0) / turn if turn > 0.0 else 0.0
        for c in range(3):
            a, b = (c + 1) % 3, (c + 2) % 3
            found[side, AXIS, c] = (top[2, c] - bottom[2, c]) / height
            found[side, LEG, c] = legs[side, c]
            chord = top[4 * side, c] - top[2, c]
            found[side, CHORD, c] = chord * outer[side] / square if square > 0.0 else 0.0
        o = found[side, AXIS]
        for c in range(3):
            a, b = (c + 1) % 3, (c + 2) % 3
            found[side, SLOPE, c] = sense * (rates[side, a] * o[b] - rates[side, b] * o[a])
        found[side, SCALARS, TURN], found[side, SCALARS, OUTER] = turn, outer[side]
    return found


@njit(cache=True, nogil=True)
def _powers(points: FloatArray) -> FloatArray:
    """Return the power coefficients over [0, 1] of a Bezier curve, shape (k, d)."""
    found = points.copy()
    n = len(points) - 1
    for level in range(1, n + 1):
        for k in range(n, level - 1, -1):
            for c in range(points.shape[1]):
                found[k, c] -= found[k - 1, c]
    for k in range(n + 1):
        for c in range(points.shape[1]):
            found[k, c] *= BINOMIAL[n, k]
    return found


@njit(cache=True, nogil=True)
def _shifted(coefficients: FloatArray, place: float) -> FloatArray:
    """Return the Taylor coefficients at ``place`` of polynomials given at zero, shape (k, d)."""
    found = coefficients.copy()
    n = len(found)
    for i in range(n - 1):
        for k in range(n - 2, i - 1, -1):
            for c in range(found.shape[1]):
                found[k, c] += place * found[k + 1, c]
    return found


@njit(cache=True, nogil=True)
def _bound_piece(
    low: float, high: float, bottom: FloatArray, top: FloatArray, lift: FloatArray,
    parametrization: FloatArray, lines: FloatArray, height: float, largest_seen: float,
    proven: float, both: bool,
) -> tuple[float, float]:  # fmt: skip
    """
    Raise the largest error seen and the bound to those of one smooth piece.

    The piece is halved where its bound is not close enough. Returns both values [m].
    """
    stack = np.empty((HALVINGS + 2, 3))
    stack[0, 0], stack[0, 1], stack[0, 2] = low, high, 0.0
    count = 1
    while count > 0:
        count -= 1
        start, end, depth = stack[count, 0], stack[count, 1], stack[count, 2]
        middle = 0.5 * (start + end)
        half = 0.5 * (end - start)
        tip, tool, late, outside = _taylor(middle, half, bottom, top, lift, parametrization)
        bound, largest_seen = bound_interval(
            half, tip, tool, lines, int(middle > 0.5), int(late), height, largest_seen, both
        )
        bound += 4.0 * height * outside / sqrt(scalar_product(tool[0], tool[0]))
        if bound <= max(CLOSE * largest_seen, proven, ROUNDING) or depth >= HALVINGS:
            proven = max(proven, bound)
            continue
        stack[count, 0], stack[count, 1], stack[count, 2] = start, middle, depth + 1.0
        stack[count + 1, 0], stack[count + 1, 1], stack[count + 1, 2] = middle, end, depth + 1.0
        count += 2
    return largest_seen, proven


@njit(cache=True, nogil=True)
def _taylor(
    u: float, half: float, bottom: FloatArray, top: FloatArray, lift: FloatArray,
    parametrization: FloatArray,
) -> tuple[FloatArray, FloatArray, bool, float]:  # fmt: skip
    """
    Return the Taylor coefficients at u of tip, shape (4, 3), and tool vector, shape (m, 3).

    The tip is relative to the corner. The tool vector is the difference of both curves (Eq. 5).
    The third value tells whether the top curve is in its second half. The last one bounds the
    error of the polynomial within u +- half if f crosses 0.5 there, in metres.
    """
    tip, spline = np.empty((4, 3)), np.empty((4, 3))
    for c in range(3):
        tip[0, c], tip[1, c], tip[2, c], tip[3, c] = corner_spline_jet(bottom, c, u, u > 0.5)
    raised = _shifted(lift, u)
    if len(parametrization) == 0:
        t, inner = u, np.zeros((2, 1))
        inner[1, 0] = 1.0
    else:
        k, start, length = span_at(parametrization, u)
        inner = _shifted(
            _powers(parametrization[k, 1:].copy().reshape((7, 1))), (u - start) / length
        )
        for i in range(1, 7):
            inner[i, 0] /= length**i
        t = inner[0, 0]
    for c in range(3):
        spline[0, c], spline[1, c], spline[2, c], spline[3, c] = corner_spline_jet(
            top, c, t, t > 0.5
        )
    over, jump = -abs(t - 0.5), 0.0
    for i in range(1, len(inner)):
        over += abs(inner[i, 0]) * half**i
    for c in range(3):
        jump += (spline[3, c] - corner_spline_jet(top, c, t, t <= 0.5)[3]) ** 2
    outside = sqrt(jump) * max(over, 0.0) ** 3
    degree = 3 * (len(inner) - 1)
    tool = np.zeros((max(degree + 1, len(raised)), 3))
    power = np.zeros(degree + 1)  # coefficients of (f - f(u))^k
    power[0] = 1.0
    for k in range(4):
        for i in range(degree + 1):
            for c in range(3):
                tool[i, c] += spline[k, c] * power[i]
        for i in range(degree, -1, -1):
            total = 0.0
            for j in range(1, min(i, len(inner) - 1) + 1):
                total += inner[j, 0] * power[i - j]
            power[i] = total
    for c in range(3):
        for i in range(len(raised)):
            tool[i, c] += raised[i, c]
        for i in range(4):
            tool[i, c] -= tip[i, c]
        tip[0, c] -= bottom[2, c]
    return tip, tool, t > 0.5, outside
