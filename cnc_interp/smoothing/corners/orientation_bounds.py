"""Proven bounds of the orientation deviation of a corner, for every way to construct it.

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

from math import comb, cos, expm1, sin, sqrt
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.core.bspline import corner_spline_jet
from cnc_interp.core.kernels import njit
from cnc_interp.smoothing.corners.connection import Curves
from cnc_interp.smoothing.segments import corner_breaks, span_at

#: Degree of interpolation; accepted ratio of bound and largest error seen; most halvings.
DEGREE, CLOSE, HALVINGS = 8, 1.01, 12
#: Chebyshev points in [-1, 1], and the matrix from values there to Bezier points.
PLACES = -np.cos(np.pi * np.arange(DEGREE + 1) / DEGREE)
TO_BEZIER = np.linalg.inv(
    np.array(
        [
            [comb(DEGREE, k) * x**k * (1.0 - x) ** (DEGREE - k) for k in range(DEGREE + 1)]
            for x in (0.5 + 0.5 * PLACES).tolist()
        ]
    )
)
#: Ellipses that are tried. A large rho makes rho^-n small, but M large.
ELLIPSES = np.array([40.0, 16.0, 6.0, 2.5])
#: Rows of the programmed data on one side of a corner.
AXIS, LEG, SLOPE, CHORD, SCALARS = range(5)
TURN, OUTER = range(2)  #: Columns of the last of these rows: rotation per metre, L2.
#: Errors below this value are rounding errors of coordinates [m].
ROUNDING = 1e-14
BINOMIAL = np.array([[float(comb(n, k)) for k in range(8)] for n in range(8)])


class CornerCurve(NamedTuple):
    """The curves of one corner; ``lift`` has the power coefficients of its connection."""

    bottom: FloatArray
    top: FloatArray
    lift: FloatArray
    parametrization: FloatArray


@njit(cache=True, nogil=True)
def _variation(rows: FloatArray, radius: float) -> float:
    """Bound the distance of a polynomial from its middle value in a complex disc."""
    total = 0.0
    for i in range(len(rows) - 1, 0, -1):
        square = rows[i, 0] ** 2 + rows[i, 1] ** 2 + rows[i, 2] ** 2
        total = (total + sqrt(square)) * radius
    return total


@njit(cache=True, nogil=True, inline='always')
def scalar_product(v: FloatArray, w: FloatArray) -> float:
    return float(v[0] * w[0] + v[1] * w[1] + v[2] * w[2])


@njit(cache=True, nogil=True, inline='always')
def _write_axis_error(
    gap: FloatArray, o: FloatArray, line: FloatArray, x: float, height: float, row: FloatArray
) -> float:
    """Write the error gap + h (o - o'(x)) to ``row`` and return its length [m]."""
    angle = line[SCALARS, TURN] * x
    cosine, sine = cos(angle), sin(angle)
    for c in range(3):
        row[c] = gap[c] + height * (o[c] - cosine * line[AXIS, c] - sine * line[SLOPE, c])
    return sqrt(scalar_product(row, row))


@njit(cache=True, nogil=True)
def bound_interval(
    half: float,
    tip: FloatArray,
    tool: FloatArray,
    lines: FloatArray,
    sides: tuple[int, int],
    height: float,
    largest_seen: float,
    both: bool,
) -> tuple[float, float]:
    """Return a proven bound of the errors on an interval, and the largest error seen so far.

    ``sides``: of the corner on which the interval lies on the bottom and on the top curve.
    """
    side, top_side = sides
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
        length = sqrt(scalar_product(o, o))
        for c in range(3):
            o[c] /= length
        swings = _write_axis_error(gap, o, line, scalar_product(p, line[LEG]), height, swing[j])
        if both:
            largest_seen = max(largest_seen, swings)
    nearest, away = np.full(DEGREE + 1, np.inf), np.inf
    remainder = _remainders(half, tip, tool, line, lines[top_side], height)
    if remainder[0] == np.inf:
        return np.inf, largest_seen
    swung = _hull(swing) + remainder[0] if both else 0.0
    for attempt in range(2):
        if attempt == 1:  # the other side of the top polygon may be nearer
            remainder = _remainders(half, tip, tool, line, lines[1 - top_side], height)
        top_line = lines[top_side if attempt == 0 else 1 - top_side]
        away = min(away, _bound_top_error(tips, axes, top_line, height, remainder, nearest))
        if max(away, swung) <= CLOSE * largest_seen:
            return max(away, swung), largest_seen
    for j in range(DEGREE + 1):
        largest_seen = max(largest_seen, nearest[j])
    return max(away, swung), largest_seen


@njit(cache=True, nogil=True)
def _bound_top_error(
    tips: FloatArray,
    axes: FloatArray,
    line: FloatArray,
    height: float,
    remainder: FloatArray,
    nearest: FloatArray,
) -> float:
    """Return a proven bound of the top error from one side; lower ``nearest`` to values there."""
    corner, away = np.empty((DEGREE + 1, 3)), np.empty((DEGREE + 1, 3))
    feet, gap, scratch = np.empty(DEGREE + 1), np.zeros(3), np.zeros(3)
    for j in range(DEGREE + 1):
        for c in range(3):
            corner[j, c] = tips[j, c] + height * (axes[j, c] - line[AXIS, c])
        feet[j] = scalar_product(corner[j], line[CHORD])
    low, high = _value_range(feet)
    shift = max(remainder[3] - low, 0.0)  # keeps every foot on this side of the corner
    # The foot must lie on the programmed block, which is at least 2 L2 long.
    outside = high + shift + remainder[3] > 1.5 * line[SCALARS, OUTER]
    for j in range(DEGREE + 1):
        foot = feet[j] + shift
        for c in range(3):
            gap[c] = tips[j, c] - foot * line[LEG, c]
        found = _write_axis_error(gap, axes[j], line, foot, height, away[j])
        if shift > 0.0:  # the error itself is attained at the foot or at the corner
            foot = max(feet[j], 0.0)
            for c in range(3):
                gap[c] = tips[j, c] - foot * line[LEG, c]
            found = _write_axis_error(gap, axes[j], line, foot, height, scratch)
        nearest[j] = min(nearest[j], found, sqrt(scalar_product(corner[j], corner[j])))
    bound = np.inf if outside else _hull(away) + remainder[2]
    if outside or shift > 0.0:
        bound = min(bound, _hull(corner) + remainder[1])
    return bound


@njit(cache=True, nogil=True)
def _remainders(
    half: float,
    tip: FloatArray,
    tool: FloatArray,
    line: FloatArray,
    top_line: FloatArray,
    height: float,
) -> FloatArray:
    """Bound the remainders of axis error, distance from the corner, top error and foot [m]."""
    found = np.full(4, np.inf)
    straight = sqrt(scalar_product(tool[0], tool[0]))
    chord = sqrt(scalar_product(top_line[CHORD], top_line[CHORD]))
    for rho in ELLIPSES:
        radius = 0.5 * half * (rho + 1.0 / rho)  # of a disc around the ellipse
        share = _variation(tool, radius) / straight
        square = share * (2.0 + share)  # |D . D / D0 . D0 - 1|
        if square > 0.75:
            continue
        stretch = 1.0 / sqrt(1.0 - square)
        axis = height * (share * stretch + stretch - 1.0)  # h |o - o0|
        moved = _variation(tip, radius)
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
def _hull(values: FloatArray) -> float:
    """Return the largest length of the Bezier points of the polynomial through vector values."""
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
def _value_range(values: FloatArray) -> tuple[float, float]:
    """Return the smallest and largest Bezier value of the polynomial through scalar values."""
    low, high = np.inf, -np.inf
    for k in range(DEGREE + 1):
        point = 0.0
        for j in range(DEGREE + 1):
            point += TO_BEZIER[k, j] * values[j]
        low, high = min(low, point), max(high, point)
    return low, high


def orientation_bounds(
    curves: Curves,
    legs: FloatArray,
    rates: FloatArray,
    outer: FloatArray,
    height: float,
    least: FloatArray,
    both: BoolArray,
) -> FloatArray:
    return np.asarray(
        _bounds_of(
            (curves.bottom, curves.top, curves.connection, curves.parametrization),
            legs,
            rates,
            outer,
            height,
            least,
            both,
        )
    )


@njit(cache=True, nogil=True)
def _bounds_of(
    curves: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    legs: FloatArray,
    rates: FloatArray,
    outer: FloatArray,
    height: float,
    least: FloatArray,
    both: BoolArray,
) -> FloatArray:
    bottom, top, connection, parametrization = curves
    bounds = least.copy()
    for i in range(len(bottom)):
        lift, largest_seen = _powers(connection[i]), least[i]
        curve = CornerCurve(bottom[i], top[i], lift, parametrization[i])
        lines = _programmed_lines(bottom[i], top[i], legs[i], rates[i], outer[i], height)
        breaks = corner_breaks(parametrization[i])
        for k in range(len(breaks) - 1):
            largest_seen, bounds[i] = _bound_piece(
                (breaks[k], breaks[k + 1]),
                curve,
                lines,
                height,
                largest_seen,
                bounds[i],
                both[i],
            )
    return bounds


@njit(cache=True, nogil=True)
def _programmed_lines(
    bottom: FloatArray,
    top: FloatArray,
    legs: FloatArray,
    rates: FloatArray,
    outer: FloatArray,
    height: float,
) -> FloatArray:
    """Return the programmed data on both sides of a corner, shape (2, 5, 3).

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
    part: tuple[float, float],
    curve: CornerCurve,
    lines: FloatArray,
    height: float,
    largest_seen: float,
    proven: float,
    both: bool,
) -> tuple[float, float]:
    """Return the largest error seen and the bound, raised to those of one smooth piece [m]."""
    stack = np.empty((HALVINGS + 2, 3))
    stack[0, 0], stack[0, 1], stack[0, 2] = part[0], part[1], 0.0
    count = 1
    while count > 0:
        count -= 1
        start, end, depth = stack[count, 0], stack[count, 1], stack[count, 2]
        middle = 0.5 * (start + end)
        half = 0.5 * (end - start)
        tip, tool, late, outside = _taylor(middle, half, curve)
        bound, largest_seen = bound_interval(
            half, tip, tool, lines, (int(middle > 0.5), int(late)), height, largest_seen, both
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
    u: float, half: float, curve: CornerCurve
) -> tuple[FloatArray, FloatArray, bool, float]:
    """Return the Taylor coefficients at u of tip, shape (4, 3), and tool vector, shape (m, 3).

    The tip is relative to the corner. The tool vector is the difference of both curves (Eq. 5).
    The third value tells whether the top curve is in its second half. The last one bounds the
    error of the polynomial within u +- half if f crosses 0.5 there, in metres.
    """
    bottom, top, lift, parametrization = curve
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
