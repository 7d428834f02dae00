"""Proven bounds of both orientation errors on one interval of a corner."""

from __future__ import annotations

from math import comb, cos, expm1, sin, sqrt

import numpy as np
from numba import njit

from cnc_interp.core.arrays import FloatArray

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
#: Columns of the last of these rows: rotation per metre, L2.
TURN, OUTER = range(2)


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
    """Return the scalar product of two vectors of length 3."""
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
    half: float, tip: FloatArray, tool: FloatArray, lines: FloatArray, side: int, top_side: int,
    height: float, largest_seen: float, both: bool,
) -> tuple[float, float]:  # fmt: skip
    """
    Return a proven bound of the errors on an interval, and the largest error seen so far.

    Without ``both``, the axis error does not count.
    """
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
    tips: FloatArray, axes: FloatArray, line: FloatArray, height: float, remainder: FloatArray,
    nearest: FloatArray,
) -> float:  # fmt: skip
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
    half: float, tip: FloatArray, tool: FloatArray, line: FloatArray, top_line: FloatArray,
    height: float,
) -> FloatArray:  # fmt: skip
    """
    Bound the interpolation remainders, shape (4,) [m].

    They belong to the axis error, the distance from the corner, the top error and the foot.
    """
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
