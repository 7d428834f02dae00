"""Proven bounds: where a segment is near the pole, and the deviation of the tool axis there.

On a segment the tool axis is o = D / |D| with ``D = E + L + (T(f) - T(u))``: E = T - B is the
difference of top and bottom curve, L the connection, and f the parameter of the top curve, u
itself on most curves. With hulls (``core/bspline.py``) of the derivatives, and with
``d >= |f - u|``, ``e >= |f' - 1|``,

    |D| >= min E - |L| - |T'| d              |D'| <= |E'| + |L'| + |T'| e + |T''| d
    |D''| <= |E''| + |L''| + |T''| e (2 + e) + |T'''| d + |T'| |f''|
    |o'| <= |D'| / |D|                       |o''| <= |D''| / |D| + |D'|^2 / |D|^2 along the sphere

The sine of the angle to the pole changes by at most |o'| per u. So its value at one place proves
that a stretch around it is not near the pole, and the search continues after that stretch.

Where the outer axis is given by C(s), the tool axis in its frame is v = Rot(u, -C) o. It deviates
by g = lat(v) - lat(e_z), with the latitude about the axis w of the tilt (``guided_jets``). On the
sphere the latitude has a gradient of length 1, and its second derivative along the parallel is
-tan(lat). With a = |C_u| and the sine z of the angle between o and the pole,

    |v'| <= |o'| + a z               |v''| <= |o''| + 2 a |o'| + (|C_uu| + a^2) z along the sphere
    |g''| <= |v''| + tan(|lat(e_z)| + G) |v'|^2             where |g| <= G

Between samples du apart, |g| <= G = largest sample + |v'| du / 2, and then the sharper
``largest sample + |g''| du^2 / 8``.
"""

from math import atan2, ceil, pi, sqrt, tan

import numpy as np

from cnc_interp.core import FloatArray, IntArray, bspline, norm
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.machine_model.five_axis_kernels import guided_gap, outer_and_inner
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

#: Margins within which a farther place still counts as near: relative [-], and rounding [-].
GRAZING, ON_IT = 1e-4, 1e-12
MOST_POINTS = 4000  #: Largest number of points for a bound on one segment.
HALVINGS = 50  #: Bisections for a place on a segment.
#: Relative difference of equal path lengths [-]; largest number of parts of half a segment.
SAME_LENGTH, MOST_PARTS = 1e-15, 64
#: Columns of the rates: bounds of |o_u|, of |o_uu| along the sphere, of |s_u| and of |s_uu|.
TURN, BEND, SPEED, RISE = range(4)


def rates_of(segments: PathSegments) -> FloatArray:
    """Bound the derivatives by u on segments of poses, shape (n, 4); infinite if not bounded."""
    found = np.zeros((len(segments), 4))
    straight = (segments.kind == LINE) | (segments.kind == ROTATION)
    found[straight, TURN] = norm(segments.rotation)[straight]
    found[straight, SPEED] = segments.length[straight]
    for kind, halves in ((CORNER, bspline.corner_pieces), (SPLINE, bspline.divided)):
        rows = np.flatnonzero((segments.kind == kind) & (segments.interpolation == POSES))
        if not len(rows):
            continue
        lift = segments.connection[rows]
        bottom, top = (
            np.stack(halves(points[rows]), axis=1) for points in (segments.bottom, segments.top)
        )
        tip, up, between = (
            bspline.derivative_bounds(curves, 0.5).max(axis=2)
            for curves in (bottom, top, top - bottom)
        )
        raised = bspline.derivative_bounds(lift)
        off, stretch, bend = _parameter_bounds(segments.parametrization[rows])
        least = (
            bspline.least_length(top - bottom).min(axis=1) - bspline.largest(lift) - up[0] * off
        )
        rate = between[0] + raised[0] + up[0] * stretch + up[1] * off
        second = between[1] + raised[1] + up[1] * stretch * (2.0 + stretch) + up[2] * off
        bounded, least = least > 0.0, np.where(least > 0.0, least, 1.0)
        turn = np.where(bounded, rate / least, np.inf)
        found[rows, TURN] = turn
        found[rows, BEND] = (second + up[0] * bend) / least + turn**2
        found[rows, SPEED], found[rows, RISE] = tip[0], tip[1]
    return found


def _parameter_bounds(spans: FloatArray) -> FloatArray:
    """Bound |f - u|, |f' - 1| and |f''| of corners, shape (n, spans, 8) to (3, n)."""
    if not spans.shape[1]:
        return np.zeros((3, len(spans)))
    ends = np.concatenate([spans[:, 1:, 0], np.ones((len(spans), 1))], axis=1)
    length = np.maximum(ends - spans[:, :, 0], 1e-9)[..., None]
    values = spans[..., 1:]
    first = 6.0 * np.diff(values, axis=2) / length
    second = 5.0 * np.diff(first, axis=2) / length
    same = spans[..., :1] + length * np.arange(7) / 6.0
    rows = (values - same, first - 1.0, second)
    return np.stack([np.abs(row).max(axis=(1, 2)) for row in rows])


@njit(cache=True, nogil=True)
def pole_sine(packed: FloatArray, kind: int, shape: FloatArray, f: FloatArray, u: float) -> float:
    o = axes.pose_jets(kind, shape, f, u, u)[1]
    pole, _ = outer_and_inner(packed)
    x = o[1][0] * pole[2] - o[2][0] * pole[1]
    y = o[2][0] * pole[0] - o[0][0] * pole[2]
    z = o[0][0] * pole[1] - o[1][0] * pole[0]
    return sqrt(x * x + y * y + z * z)


@njit(cache=True, nogil=True)
def way_to_pole(
    packed: FloatArray,
    kind: int,
    shape: FloatArray,
    f: FloatArray,
    turn: float,
    limit: float,
    back: bool,
) -> float:
    """Return the distance in u from an end to the first place near the pole; 2 if there is none.

    ``turn`` bounds |o_u|, ``limit`` is the sine that counts as near; ``back`` starts at u = 1.
    """
    way = 0.0
    while way <= 1.0 and turn < np.inf:
        sine = pole_sine(packed, kind, shape, f, 1.0 - way if back else way)
        if sine <= limit * (1.0 + GRAZING) + ON_IT:
            return way
        if sine - limit >= turn * (1.0 - way):
            break
        way += (sine - limit) / turn
    return 2.0


@njit(cache=True, nogil=True)
def near_pole(
    packed: FloatArray,
    kinds: IntArray,
    shapes: FloatArray,
    f: FloatArray,
    turns: FloatArray,
    limits: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return first and last parameter where the sine is within ``limits``, and the sine at u = 0.

    The parameters are 2 and -1 if the segment is nowhere near the pole.
    """
    near, start = np.empty((len(kinds), 2)), np.empty(len(kinds))
    for i in range(len(kinds)):
        kind, shape, spans = kinds[i], shapes[i], f[i]
        start[i] = pole_sine(packed, kind, shape, spans, 0.0)
        near[i, 0] = way_to_pole(packed, kind, shape, spans, turns[i], limits[i], False)
        near[i, 1] = -1.0
        if near[i, 0] <= 1.0:
            back = way_to_pole(packed, kind, shape, spans, turns[i], limits[i], True)
            near[i, 1] = max(near[i, 0], 1.0 - back)
    return near, start


@njit(cache=True, nogil=True)
def way_to(kind, shape, beside, length, u):  # type: ignore[no-untyped-def]
    """Return the path length from the start of a segment of poses to u [m].

    Each half is divided until the sum no longer changes. Where the outer axis turns fast, an error
    of a millionth of a micrometre would already appear as a jump.
    """
    total = 0.0
    for half in range(2):
        a, b = 0.5 * half, min(u, 0.5 + 0.5 * half)
        if b <= a:
            break
        found = axes.arc_length(kind, axes.FOLLOWING, shape, beside, 0.0, length, a, b)
        parts = 2
        while parts <= MOST_PARTS:
            before, found, step = found, 0.0, (b - a) / parts
            for k in range(parts):
                low, high = a + k * step, a + (k + 1) * step
                found += axes.arc_length(
                    kind, axes.FOLLOWING, shape, beside, 0.0, length, low, high
                )
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
    found = np.empty(len(kinds))
    for i in range(len(kinds)):
        found[i] = way_to(kinds[i], shapes[i], beside[i], lengths[i], 1.0)
    return found


@njit(cache=True, nogil=True)
def gap_bounds(
    packed: FloatArray,
    segments: axes.SegmentRows,
    guides: FloatArray,
    rates: FloatArray,
    turning: FloatArray,
    allowed: FloatArray,
) -> FloatArray:
    """Bound the deviation of the tool axis where the outer axis is prescribed, shape (n,) [rad].

    ``turning`` bounds both derivatives of the outer axis by path length; ``allowed``: accuracy of
    each bound [rad]; ``rates``: the result of ``rates_of``.
    """
    bounds = np.zeros(len(segments.kind))
    _, w = outer_and_inner(packed)
    latitude = atan2(abs(w[2]), sqrt(w[0] * w[0] + w[1] * w[1]))
    for i in range(len(bounds)):
        kind, _, shape, beside, spans, length = axes.segment_at(segments, i)
        guide = guides[i]
        first, last = max(0.0, guide[axes.GUIDE_FROM]), min(1.0, guide[axes.GUIDE_TO])
        if last <= first:
            continue
        o_u, o_uu, s_u, s_uu = rates[i]
        bounds[i] = np.inf
        if o_u == np.inf:
            continue
        a_u, a_uu = turning[0] * s_u, turning[1] * s_u * s_u + turning[0] * s_uu
        sine = pole_sine(packed, kind, shape, spans, first)
        sine = min(
            1.0,
            max(sine, pole_sine(packed, kind, shape, spans, last)) + 0.5 * o_u * (last - first),
        )
        rate = o_u + a_u * sine
        second = o_uu + 2.0 * a_u * o_u + (a_uu + a_u * a_u) * sine
        likely = second + tan(latitude) * rate * rate
        count = ceil((last - first) * sqrt(likely / (8.0 * allowed[i])))
        count = min(max(count, 2), MOST_POINTS)
        step, worst, way = (last - first) / count, 0.0, 0.0
        before = 0.0
        for k in range(count + 1):
            u = first + k * step
            if k == 0 or (before < 0.5) != (u <= 0.5):
                way = way_to(kind, shape, beside, length, u)
            else:
                way += axes.arc_length(kind, axes.FOLLOWING, shape, beside, 0.0, length, before, u)
            o = axes.pose_jets(kind, shape, spans, u, u)[1]
            gap = guided_gap(packed, o, axes.guide_jet(guide, way, axes.GUIDE_BEGUN)[0])
            worst, before = max(worst, abs(gap)), u
        farthest = latitude + worst + 0.5 * rate * step
        if farthest < 0.5 * pi:
            bounds[i] = worst + (second + tan(farthest) * rate * rate) * step * step / 8.0
    return bounds
