"""
Proven bounds of how far the tool axis of a corner strays, for every way to make a corner.

On each smooth piece of a corner both errors are analytic in u (o' is the programmed axis, Eq. 4):

    swing   h (o(u) - o'(x))                   x: foot of the tip on its programmed line
    away    p(u) + h o(u) - p'(x) - h o'(x)    x: foot of the top point on its polygon's leg,
                                               or the corner where that is nearer

Interpolated at Chebyshev points of an interval by a polynomial of degree n, such an error is
missed by at most 4 M rho^-n / (rho - 1) if M bounds it in the Bernstein ellipse rho around the
interval [T2013, theorem 8.2]; the polynomial lies in the hull of its Bezier points. M follows
from the Taylor coefficients of the curves at the middle. An interval is halved until what is
proven there is within ``CLOSE`` of the largest error met at any Chebyshev point of the corner.
"""

from __future__ import annotations

from math import comb, cos, expm1, sin, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.corners.corner_curves import Curves
from cnc_interp.smoothing.segments import corner_breaks, span_at, spline_component

#: Degree of the interpolation; proven / met where an interval is not halved again; most halvings.
DEGREE, CLOSE, HALVINGS = 8, 1.01, 12
#: Errors below this are rounding of coordinates [m].
ROUNDING = 1e-14
#: Chebyshev points in [-1, 1], and from values there to Bezier points.
PLACES = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
TO_BEZIER = np.linalg.inv(
    np.array(
        [
            [comb(DEGREE, k) * x**k * (1.0 - x) ** (DEGREE - k) for k in range(DEGREE + 1)]
            for x in (0.5 + 0.5 * PLACES).tolist()
        ]
    )
)
#: Ellipses tried: a large one makes rho^-n small and M large.
ELLIPSES = np.array([40.0, 16.0, 6.0, 2.5])
BINOMIAL = np.array([[float(comb(n, k)) for k in range(8)] for n in range(8)])


def orientation_bounds(
    curves: Curves,
    legs: FloatArray,
    rates: FloatArray,
    outer: FloatArray,
    height: float,
    least: FloatArray,
) -> FloatArray:
    """
    Bound the orientation deviation of corners, shape (n,) [m].

    Parameters
    ----------
    curves : Curves
        The corners.
    legs, rates : ndarray, shape (n, 2, 3)
        Unit vectors from the corner along both lines [-]; rotation vectors per metre [rad/m].
    outer : ndarray, shape (n, 2)
        Both L2 [m].
    height : float
        Flank height h [m].
    least : ndarray, shape (n,)
        Deviation known to occur: smaller errors need no close bound [m].

    """
    return np.asarray(
        bounds_of(
            curves.bottom, curves.top, curves.connection, curves.parametrization,
            legs, rates, outer, height, least,
        )
    )  # fmt: skip


@njit(cache=True, nogil=True)
def bounds_of(bottom, top, connection, parametrization, legs, rates, outer, height, least):  # type: ignore[no-untyped-def]
    """Bound the errors of many corners, shape (n,) [m]."""
    bounds = least.copy()
    for i in range(len(bottom)):
        lift, met = powers(connection[i]), least[i]
        lines = lines_of(bottom[i], top[i], legs[i], rates[i], outer[i], height)
        breaks = corner_breaks(parametrization[i])
        for k in range(len(breaks) - 1):
            met, bounds[i] = bound_piece(
                breaks[k], breaks[k + 1], bottom[i], top[i], lift, parametrization[i], lines,
                height, met, bounds[i],
            )  # fmt: skip
    return bounds


#: Rows of what is programmed on one side of a corner.
AXIS, LEG, SLOPE, CHORD, SCALARS = range(5)
#: Columns of its last row: rotation per metre, L2.
TURN, OUTER = range(2)


@njit(cache=True, nogil=True)
def lines_of(bottom, top, legs, rates, outer, height):  # type: ignore[no-untyped-def]
    """
    Return what is programmed on both sides of a corner, shape (2, 5, 3).

    At x metres from the corner the axis is cos(turn x) axis + sin(turn x) slope; the top point's
    foot is x = (top point - corner of the top polygon) . chord.
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
def powers(points):  # type: ignore[no-untyped-def]
    """Return the power coefficients of a Bezier curve over [0, 1]."""
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
def moved_to(coefficients, place):  # type: ignore[no-untyped-def]
    """Return the Taylor coefficients at a place of polynomials given at zero."""
    found = coefficients.copy()
    n = len(found)
    for i in range(n - 1):
        for k in range(n - 2, i - 1, -1):
            for c in range(found.shape[1]):
                found[k, c] += place * found[k + 1, c]
    return found


@njit(cache=True, nogil=True)
def bound_piece(low, high, bottom, top, lift, parametrization, lines, height, met, proven):  # type: ignore[no-untyped-def]
    """Return ``met`` and ``proven`` raised to the errors of one smooth piece, halved at need."""
    stack = np.empty((HALVINGS + 2, 3))
    stack[0, 0], stack[0, 1], stack[0, 2] = low, high, 0.0
    count = 1
    while count > 0:
        count -= 1
        start, end, depth = stack[count, 0], stack[count, 1], stack[count, 2]
        middle = 0.5 * (start + end)
        half = 0.5 * (end - start)
        tip, tool, late, strange = taylor(middle, half, bottom, top, lift, parametrization)
        bound, met = bound_interval(
            half, tip, tool, lines, int(middle > 0.5), int(late), height, met
        )
        bound += 4.0 * height * strange / sqrt(along(tool[0], tool[0]))
        if bound <= max(CLOSE * met, proven, ROUNDING) or depth >= HALVINGS:
            proven = max(proven, bound)
            continue
        stack[count, 0], stack[count, 1], stack[count, 2] = start, middle, depth + 1.0
        stack[count + 1, 0], stack[count + 1, 1], stack[count + 1, 2] = middle, end, depth + 1.0
        count += 2
    return met, proven


@njit(cache=True, nogil=True)
def taylor(u, half, bottom, top, lift, parametrization):  # type: ignore[no-untyped-def]
    """
    Return the Taylor coefficients at u of tip, shape (4, 3), and tool vector, shape (m, 3).

    The tip counts from the corner; the tool vector is the difference of both curves (Eq. 5).
    Also returned are whether the top curve is in its second half, and how far the tool vector
    may be from the polynomial within u +- half, should f pass 0.5 there.
    """
    tip, spline = np.empty((4, 3)), np.empty((4, 3))
    for c in range(3):
        tip[0, c], tip[1, c], tip[2, c], tip[3, c] = spline_component(bottom, c, u, u > 0.5)
    raised = moved_to(lift, u)
    if len(parametrization) == 0:
        t, inner = u, np.zeros((2, 1))
        inner[1, 0] = 1.0
    else:
        k, start, length = span_at(parametrization, u)
        inner = moved_to(
            powers(parametrization[k, 1:].copy().reshape((7, 1))), (u - start) / length
        )
        for i in range(1, 7):
            inner[i, 0] /= length**i
        t = inner[0, 0]
    for c in range(3):
        spline[0, c], spline[1, c], spline[2, c], spline[3, c] = spline_component(
            top, c, t, t > 0.5
        )
    over, jump = -abs(t - 0.5), 0.0
    for i in range(1, len(inner)):
        over += abs(inner[i, 0]) * half**i
    for c in range(3):
        jump += (spline[3, c] - spline_component(top, c, t, t <= 0.5)[3]) ** 2
    strange = sqrt(jump) * max(over, 0.0) ** 3
    degree = 3 * (len(inner) - 1)
    tool = np.zeros((max(degree + 1, len(raised)), 3))
    power = np.zeros(degree + 1)  # of f - f(u)
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
    return tip, tool, t > 0.5, strange


@njit(cache=True, nogil=True)
def reach(rows, radius):  # type: ignore[no-untyped-def]
    """Bound how far a polynomial goes from its value at the middle of a complex disc."""
    total = 0.0
    for i in range(len(rows) - 1, 0, -1):
        square = rows[i, 0] ** 2 + rows[i, 1] ** 2 + rows[i, 2] ** 2
        total = (total + sqrt(square)) * radius
    return total


@njit(cache=True, nogil=True, inline='always')
def along(v, w):  # type: ignore[no-untyped-def]
    """Return a scalar product."""
    return v[0] * w[0] + v[1] * w[1] + v[2] * w[2]


@njit(cache=True, nogil=True, inline='always')
def strayed(gap, o, line, x, height, row):  # type: ignore[no-untyped-def]
    """Write gap + h (o - o'(x)) to a row and return its length."""
    angle = line[SCALARS, TURN] * x
    cosine, sine = cos(angle), sin(angle)
    for c in range(3):
        row[c] = gap[c] + height * (o[c] - cosine * line[AXIS, c] - sine * line[SLOPE, c])
    return sqrt(along(row, row))


@njit(cache=True, nogil=True)
def bound_interval(half, tip, tool, lines, side, top_side, height, met):  # type: ignore[no-untyped-def]
    """Return a proven bound of both errors on an interval, and the largest error met so far."""
    swing, tips, axes = (
        np.empty((DEGREE + 1, 3)),
        np.empty((DEGREE + 1, 3)),
        np.empty((DEGREE + 1, 3)),
    )
    gap, line = np.zeros(3), lines[side]
    for j in range(DEGREE + 1):
        x, p, o = half * PLACES[j], tips[j], axes[j]
        for c in range(3):
            p[c] = tip[0, c] + x * (tip[1, c] + x * (tip[2, c] + x * tip[3, c]))
            o[c] = tool[len(tool) - 1, c]
            for i in range(len(tool) - 2, -1, -1):
                o[c] = o[c] * x + tool[i, c]
        length = sqrt(along(o, o))
        for c in range(3):
            o[c] /= length
        met = max(met, strayed(gap, o, line, along(p, line[LEG]), height, swing[j]))
    nearest, away = np.full(DEGREE + 1, np.inf), np.inf
    missed = missed_by(half, tip, tool, line, lines[top_side], height)
    if missed[0] == np.inf:
        return np.inf, met
    swung = hull(swing) + missed[0]
    for attempt in range(2):
        if attempt == 1:  # perhaps the other side is nearer
            missed = missed_by(half, tip, tool, line, lines[1 - top_side], height)
        top_line = lines[top_side if attempt == 0 else 1 - top_side]
        away = min(away, bound_away(tips, axes, top_line, height, missed, nearest))
        if max(away, swung) <= CLOSE * met:
            return max(away, swung), met
    for j in range(DEGREE + 1):
        met = max(met, nearest[j])
    return max(away, swung), met


@njit(cache=True, nogil=True)
def bound_away(tips, axes, line, height, missed, nearest):  # type: ignore[no-untyped-def]
    """Return a proven bound of ``away`` from one side, and lower ``nearest`` to values there."""
    corner, away = np.empty((DEGREE + 1, 3)), np.empty((DEGREE + 1, 3))
    feet, gap, scratch = np.empty(DEGREE + 1), np.zeros(3), np.zeros(3)
    for j in range(DEGREE + 1):
        for c in range(3):
            corner[j, c] = tips[j, c] + height * (axes[j, c] - line[AXIS, c])
        feet[j] = along(corner[j], line[CHORD])
    low, high = span_of(feet)
    shift = max(missed[3] - low, 0.0)  # no foot before the corner
    # Half a block is L2 or more.
    outside = high + shift + missed[3] > 1.5 * line[SCALARS, OUTER]
    for j in range(DEGREE + 1):
        foot = feet[j] + shift
        for c in range(3):
            gap[c] = tips[j, c] - foot * line[LEG, c]
        found = strayed(gap, axes[j], line, foot, height, away[j])
        if shift > 0.0:  # what is met is met at the foot itself, or at the corner
            foot = max(feet[j], 0.0)
            for c in range(3):
                gap[c] = tips[j, c] - foot * line[LEG, c]
            found = strayed(gap, axes[j], line, foot, height, scratch)
        nearest[j] = min(nearest[j], found, sqrt(along(corner[j], corner[j])))
    bound = np.inf if outside else hull(away) + missed[2]
    if outside or shift > 0.0:
        bound = min(bound, hull(corner) + missed[1])
    return bound


@njit(cache=True, nogil=True)
def missed_by(half, tip, tool, line, top_line, height):  # type: ignore[no-untyped-def]
    """Bound what interpolation misses of swing, way from the corner, away and foot."""
    found = np.full(4, np.inf)
    straight = sqrt(along(tool[0], tool[0]))
    chord = sqrt(along(top_line[CHORD], top_line[CHORD]))
    for rho in ELLIPSES:
        radius = 0.5 * half * (rho + 1.0 / rho)  # of a disc around the ellipse
        share = reach(tool, radius) / straight
        square = share * (2.0 + share)  # |D . D / D0 . D0 - 1|
        if square > 0.75:
            continue
        stretch = 1.0 / sqrt(1.0 - square)
        axis = height * (share * stretch + stretch - 1.0)  # h |o - o0|
        moved = reach(tip, radius)
        slid = (moved + axis) * chord
        turned = height * expm1(min(line[SCALARS, TURN] * moved, 30.0))  # h |o' - o'0|
        top_turned = height * expm1(min(top_line[SCALARS, TURN] * slid, 30.0))
        factor = 4.0 * rho ** (-DEGREE) / (rho - 1.0)
        found[0] = min(found[0], factor * (axis + turned))
        found[1] = min(found[1], factor * (axis + moved))
        found[2] = min(found[2], factor * (axis + moved + slid + top_turned))
        found[3] = min(found[3], factor * slid)
    return found


@njit(cache=True, nogil=True)
def hull(values):  # type: ignore[no-untyped-def]
    """Return the largest length of the Bezier points of the polynomial through values."""
    most = 0.0
    for k in range(DEGREE + 1):
        square = 0.0
        for c in range(3):
            point = 0.0
            for j in range(DEGREE + 1):
                point += TO_BEZIER[k, j] * values[j, c]
            square += point * point
        most = max(most, square)
    return sqrt(most)


@njit(cache=True, nogil=True)
def span_of(values):  # type: ignore[no-untyped-def]
    """Return the least and the largest Bezier value of the polynomial through values."""
    low, high = np.inf, -np.inf
    for k in range(DEGREE + 1):
        point = 0.0
        for j in range(DEGREE + 1):
            point += TO_BEZIER[k, j] * values[j]
        low, high = min(low, point), max(high, point)
    return low, high
