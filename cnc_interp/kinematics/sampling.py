"""
Segments -> cells of the AxisPath: q and its exact derivatives by path length.

A segment is cut into cells until the septic polynomial between a cell's ends meets the exact axes
inside. Cells break where the third derivative may jump: at joins and at u = 0.5 of corners, where
both curves are taken from the same side.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from cnc_interp.core import jet
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bezier import quintic_jet
from cnc_interp.core.bspline import corner_spline_jet
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_value
from cnc_interp.kinematics.transform import OUTER, SIZE, guided_jets, linear_jets, rotary_jets
from cnc_interp.smoothing.segments import (
    CORNER,
    LINE,
    POINTS,
    SPLINE,
    PathSegments,
    corner_breaks,
    corner_jets,
    great_circle_jets,
    line_jets,
    spline_jets,
)

#: Septic and exact axes agree to this inside a cell [m or rad],
CELL_ERROR = 1e-10
#: and their third derivatives to this share; ROUNDING / h^3 is noise of the axes. It grows with
#: the distance from the workpiece zero, as the tool axis is the difference of two points.
THIRD_ERROR = 0.01
ROUNDING, ROUNDING_PER_METRE = 1e-12, 4e-12
#: Cells are not cut in two below this length [m]: s itself has its digits.
FINEST_CELL = 1e-10
#: A segment is cut into at most this many cells.
MOST_CELLS = 4096
#: Parameters between the cells of a corner and of any other segment, before refinement.
CORNER_GRID = np.linspace(0.0, 1.0, 13)
PLAIN_GRID = np.array([0.0, 0.5, 1.0])
#: A tip slower than this share of the top rests, and its arc length measures nothing [-].
SLOWEST_TIP = 1e-6
#: What became of a segment.
FINE, UNREACHABLE, SINGULAR, STANDSTILL = 0, 1, 2, 3
#: How the rotary axes move on a segment: at rest, following the tool axis, or as coordinates of
#: the path on the basis of the tip. With ALL_AXES, X Y Z are coordinates, too, not the tip.
RESTING, FOLLOWING, LINEAR, ALL_AXES = 0, 1, 2, 3
#: Layout of a row of ``guides`` (``pole_passage.py``): parameters between which the outer axis
#: is a septic of the path length, the branch after it, path length from the start of the septic to
#: that of the segment, length of the septic [m], and its coefficients from the lowest on.
GUIDE_FROM, GUIDE_TO, BRANCH_AFTER, GUIDE_BEGUN, GUIDE_LENGTH = range(5)
GUIDE = slice(5, 13)
NO_GUIDE = np.array([2.0, 2.0] + [0.0] * 11)
#: Layout of ``rotary``: positions [rad], branch (+1 or -1) and flank height [m].
FIRST, SECOND, BRANCH, HEIGHT = range(4)
#: Rows of a segment's ``shape``.
BOTTOM, TOP = slice(0, POINTS), slice(POINTS, 2 * POINTS)
AXIS, ROTATION, CONNECTION = 2 * POINTS, 2 * POINTS + 1, slice(2 * POINTS + 2, None)

# Gauss-Legendre points and weights for the arc length of half a corner
_GAUSS = np.array(np.polynomial.legendre.leggauss(10))  # type: ignore[no-untyped-call]


def beside_of(segments: PathSegments) -> FloatArray:
    """Stack the control values of rotary and extra axes for the kernels, shape (n, 6, 2 + k)."""
    return np.concatenate([segments.rotary, segments.extra], axis=2)


def shapes_of(segments: PathSegments) -> FloatArray:
    """Stack the geometry of segments for the kernels, shape (n, 20 or 22, 3)."""
    return np.concatenate(
        [
            segments.bottom,
            segments.top,
            segments.axis[:, None],
            segments.rotation[:, None],
            segments.connection,
        ],
        axis=1,
    )


@njit(cache=True, nogil=True)
def sample(packed, kind, motion, shape, beside, f, length, rotary, guide, way, u, inside):  # type: ignore[no-untyped-def]
    """
    Return the axes at one point of a segment.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    kind, motion, length : int, int, float
        Kind of the segment, RESTING to ALL_AXES, and its length unless it is a curve [m].
    shape, f : ndarray, shapes (m, 3) and (spans, 8)
        Its geometry, and the parametrization of corners.
    beside : ndarray, shape (6, 2 + k)
        Control values of the rotary axes [rad] and of k extra axes [m], on the same basis as the
        bottom curve.
    rotary : ndarray, shape (4,)
        Rotary positions [rad], branch and flank height [m]. Rotary axes that follow the tool axis
        keep the branch and the whole turns nearest to these positions.
    guide : ndarray, shape (13,)
        Where the outer axis is given, and its septic (``GUIDE_FROM`` and following).
    way : float
        Path length from the start of the segment to u [m].
    u : float
        Parameter in [0, 1].
    inside : float
        A parameter inside the cell that u belongs to, where u lies on a break.

    Returns
    -------
    q : ndarray, shape (4, 5 + k)
        Axes, extra ones last, and three derivatives by path length.
    tip, tool : ndarray, shape (3,)
        Tool tip [m] and tool axis [-]; of no meaning where the rotary axes are coordinates.
    sine_squared : float
        Of the tilt from the pole; negative when unreachable, 1 unless it is solved.

    """
    if kind == CORNER and motion >= LINEAR:
        p = bottom_jets(shape[BOTTOM], u, inside)
        o = p
        speed = speed_beside(p, beside, rotary[HEIGHT], u, inside)
    else:
        p, o = pose_jets(kind, shape, f, u, inside)
        curved = kind == CORNER or kind == SPLINE
        speed = speed_of(p) if curved else jet.constant(length)
    sine_squared, outer = 1.0, int(packed[OUTER])
    if guide[GUIDE_FROM] <= inside < guide[GUIDE_TO]:
        s = (way, speed[0], 0.5 * speed[1], speed[2] / 3.0)
        turn = jet.compose(guide_jet(guide, way), s)
        tilt, turn = guided_jets(packed, o, turn, rotary[1 - outer], rotary[outer])
        first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    elif motion == RESTING:
        first, second = jet.constant(rotary[FIRST]), jet.constant(rotary[SECOND])
    elif motion != FOLLOWING:
        first = beside_jet(kind, beside, 0, u, inside)
        second = beside_jet(kind, beside, 1, u, inside)
    else:
        branch = rotary[BRANCH] if inside < guide[GUIDE_TO] else guide[BRANCH_AFTER]
        tilt, turn, sine_squared = rotary_jets(packed, o, branch, rotary[1 - outer], rotary[outer])
        first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    v = p if motion == ALL_AXES else linear_jets(packed, p, first, second)
    count = beside.shape[1] - 2
    q = np.empty((4, 5 + count))
    for i, component in enumerate((v[0], v[1], v[2], first, second)):
        q[0, i], q[1, i], q[2, i], q[3, i] = jet.by_arc_length(component, speed)
    for k in range(count):
        w = beside_jet(kind, beside, 2 + k, u, inside)
        j = 5 + k
        q[0, j], q[1, j], q[2, j], q[3, j] = jet.by_arc_length(w, speed)
        if motion == ALL_AXES:
            continue
        for i in range(3):  # (x, y, z) = XYZ + w d, so XYZ gives way
            direction = packed[SIZE + 3 * k + i]
            for order in range(4):
                q[order, i] -= direction * q[order, j]
    tip = np.array([p[0][0], p[1][0], p[2][0]])
    tool = np.array([o[0][0], o[1][0], o[2][0]])
    return q, tip, tool, sine_squared


@njit(cache=True, nogil=True)
def pose_jets(kind, shape, f, u, inside):  # type: ignore[no-untyped-def]
    """Return the jets in u of tool tip and tool axis on a segment of poses."""
    if kind == CORNER:
        return corner_jets(shape[BOTTOM], shape[TOP], shape[CONNECTION], f, u, inside)
    if kind == SPLINE:
        return spline_jets(shape[BOTTOM], shape[TOP], shape[CONNECTION], u)
    if kind == LINE:
        return line_jets(shape[BOTTOM], shape[AXIS], shape[ROTATION], u)
    p = (jet.constant(shape[0, 0]), jet.constant(shape[0, 1]), jet.constant(shape[0, 2]))
    return p, great_circle_jets(shape[AXIS], shape[ROTATION], u)


@njit(cache=True, nogil=True)
def guide_jet(guide, way):  # type: ignore[no-untyped-def]
    """Return the jet by path length of the outer axis where it is given; see ``GUIDE_FROM``."""
    value, length = np.empty(4), guide[GUIDE_LENGTH]
    septic_value(guide[GUIDE], (guide[GUIDE_BEGUN] + way) / length, length, value)
    return (value[0], value[1], 0.5 * value[2], value[3] / 6.0)


@njit(cache=True, nogil=True)
def beside_jet(kind, beside, k, u, inside):  # type: ignore[no-untyped-def]
    """
    Return the jet in u of an axis that is a coordinate beside the bottom curve.

    On a line the axis runs linearly with the tip. On a corner it joins both lines as smoothly as
    the tip does.
    """
    if kind == CORNER:
        return corner_spline_jet(beside, k, u, inside > 0.5)
    if kind == SPLINE:
        return quintic_jet(beside, k, u)
    rate = beside[1, k] - beside[0, k]
    return (beside[0, k] + u * rate, rate, 0.0, 0.0)


@njit(cache=True, nogil=True)
def bottom_jets(bottom, u, inside):  # type: ignore[no-untyped-def]
    """Return the jets in u of the three coordinates of the bottom curve of a corner."""
    late = inside > 0.5
    return (
        corner_spline_jet(bottom, 0, u, late),
        corner_spline_jet(bottom, 1, u, late),
        corner_spline_jet(bottom, 2, u, late),
    )


@njit(cache=True, nogil=True)
def speed_beside(p, beside, height, u, inside):  # type: ignore[no-untyped-def]
    """Return the jet of ds/du of a corner whose length counts the axes beside the bottom."""
    square = squared_rate(p[0])
    for i in range(1, 3):
        square = jet.add(square, squared_rate(p[i]))
    for k in range(beside.shape[1]):
        w = jet.scale(corner_spline_jet(beside, k, u, inside > 0.5), height if k < 2 else 1.0)
        square = jet.add(square, squared_rate(w))
    return jet.square_root(square)


@njit(cache=True, nogil=True, inline='always')
def squared_rate(p):  # type: ignore[no-untyped-def]
    """Return the jet of (dp/du)^2, two derivatives of it."""
    rate = (p[1], 2.0 * p[2], 3.0 * p[3], 0.0)
    return jet.multiply(rate, rate)


@njit(cache=True, nogil=True, inline='always')
def speed_of(p):  # type: ignore[no-untyped-def]
    """Return the jet of ds/du, two derivatives of it, from the jet of the tip."""
    dx = (p[0][1], 2.0 * p[0][2], 3.0 * p[0][3], 0.0)
    dy = (p[1][1], 2.0 * p[1][2], 3.0 * p[1][3], 0.0)
    dz = (p[2][1], 2.0 * p[2][2], 3.0 * p[2][3], 0.0)
    return jet.square_root(jet.dot((dx, dy, dz), (dx, dy, dz)))


@njit(cache=True, nogil=True)
def arc_length(kind, motion, shape, beside, height, length, a, b):  # type: ignore[no-untyped-def]
    """Return the path length of a segment between parameters a and b of one half [m]."""
    if kind != CORNER and kind != SPLINE:
        return length * (b - a)
    late = 0.5 * (a + b) > 0.5
    total = 0.0
    for i in range(_GAUSS.shape[1]):
        u = 0.5 * (a + b) + 0.5 * (b - a) * _GAUSS[0, i]
        square = 0.0
        for k in range(3):
            if kind == CORNER:
                rate = corner_spline_jet(shape[BOTTOM], k, u, late)[1]
            else:
                rate = quintic_jet(shape[BOTTOM], k, u)[1]
            square += rate * rate
        if motion >= LINEAR:
            for k in range(beside.shape[1]):
                rate = corner_spline_jet(beside, k, u, late)[1] * (height if k < 2 else 1.0)
                square += rate * rate
        total += _GAUSS[1, i] * sqrt(square)
    return 0.5 * (b - a) * total


@njit(cache=True, nogil=True)
def septic_fits(left, right, h, x, exact, axes, rounding):  # type: ignore[no-untyped-def]
    """Tell whether the cell's septic at x has the exact axes and third derivatives."""
    coefficients, value = np.empty(8), np.empty(4)
    for i in axes:
        septic_coefficients(left[:, i], right[:, i], h, coefficients)
        septic_value(coefficients, x / h, h, value)
        if abs(value[0] - exact[0, i]) > CELL_ERROR:
            return False
        size = max(abs(left[3, i]), abs(right[3, i]), abs(exact[3, i]))
        if abs(value[3] - exact[3, i]) > THIRD_ERROR * size + rounding / h**3:
            return False
    return True


@njit(cache=True, nogil=True)
def guided_grid(grid, guide):  # type: ignore[no-untyped-def]
    """Return the first parameters with the ends of a guide among them."""
    for k in range(GUIDE_FROM, GUIDE_TO + 1):
        if 0.0 < guide[k] < 1.0 and not (grid == guide[k]).any():
            grid = np.sort(np.append(grid, guide[k]))
    return grid


@njit(cache=True, nogil=True)
def first_grid(kind, f):  # type: ignore[no-untyped-def]
    """Return the first parameters to use, from 0 to 1, all breaks of the segment among them."""
    if kind != CORNER:
        return PLAIN_GRID
    if f.shape[0] == 0:
        return CORNER_GRID
    grid = corner_breaks(f)
    breaks = len(grid)
    grid = np.concatenate((grid, CORNER_GRID))
    count = breaks
    for u in CORNER_GRID:
        if np.abs(grid[:breaks] - u).min() > 1e-3:
            grid[count] = u
            count += 1
    return np.sort(grid[:count])


@njit(cache=True, nogil=True)
def tip_rests(shape):  # type: ignore[no-untyped-def]
    """Tell whether the tip of a spline rests at an end or in the middle."""
    for u in PLAIN_GRID:
        tip = top = 0.0
        for k in range(3):
            tip += quintic_jet(shape[BOTTOM], k, u)[1] ** 2
            top += quintic_jet(shape[TOP], k, u)[1] ** 2
        if tip <= SLOWEST_TIP**2 * top:
            return True
    return False


@njit(cache=True, nogil=True)
def roomier(array, cells):  # type: ignore[no-untyped-def]
    """Return the array with room for more cells on its first axis."""
    larger = np.empty((cells, *array.shape[1:]))
    larger[: len(array)] = array
    return larger


@njit(cache=True, nogil=True)
def sample_segments(  # type: ignore[no-untyped-def]
    packed, cone_sine, axes, kinds, shapes, extra, f, lengths, motion, guides, rotary
):
    """
    Cut consecutive segments into cells.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    cone_sine : float
        Sine of the singular cone [-].
    axes : ndarray of int, shape (n_axes,)
        The machine's own among X Y Z, first and second rotary axis, extra axes.
    kinds, shapes, extra, f, lengths, motion, guides : ndarray
        Shapes (n,), (n, m, 3), (n, 6, 2 + k), (n, spans, 8), (n,), (n,) and (n, 13).
        As in ``sample``, segment by segment.
    rotary : ndarray, shape (4,)
        As in ``sample``; on return it holds the positions at the end of the last segment.

    Returns
    -------
    status : int
        FINE, or why the segment after the last one counted cannot be cut.
    counts, early : ndarray of int, shape (m,)
        How many cells each segment has, and how many of them lie before u = 0.5; m = n when all
        is fine, else m - 1 segments are sound and the last one is not.
    steps : ndarray, shape (N,)
        Path length of each cell [m].
    left, right : ndarray, shape (N, 4, n_axes)
        As in AxisPath, but cell by cell.
    tips, tools : ndarray, shape (N + 1, 3)
        Tool tip and axis at the cells' ends.

    """
    n, n_axes = len(kinds), len(axes)
    counts, early = np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64)
    capacity = 8 * n + MOST_CELLS
    steps = np.empty(capacity)
    left, right = np.empty((capacity, 4, n_axes)), np.empty((capacity, 4, n_axes))
    tips, tools = np.empty((capacity + 1, 3)), np.empty((capacity + 1, 3))
    ends = np.empty(MOST_CELLS)  # right ends of the cells still to do, the next one last
    status, count, row, height = FINE, 0, 0, rotary[HEIGHT]
    for row in range(n):
        kind, shape, spans, length = kinds[row], shapes[row], f[row], lengths[row]
        beside, guide, way = extra[row], guides[row], 0.0
        guided = guide[GUIDE_FROM] < 1.0
        if count + MOST_CELLS > capacity:
            capacity = 2 * capacity + MOST_CELLS
            steps, left = roomier(steps, capacity), roomier(left, capacity)
            right = roomier(right, capacity)
            tips, tools = roomier(tips, capacity + 1), roomier(tools, capacity + 1)
        how = motion[row]
        free = how == FOLLOWING or guided
        least = cone_sine * cone_sine if free and not guided else 0.0
        grid = CORNER_GRID if kind == CORNER and how >= LINEAR else first_grid(kind, spans)
        if guided:
            grid = guided_grid(grid, guide)
        waiting = len(grid) - 1
        ends[:waiting] = grid[:0:-1]
        begin, a, fresh = count, 0.0, False
        rounding = max(ROUNDING, ROUNDING_PER_METRE * np.abs(shape[0]).max())
        if kind == SPLINE and tip_rests(shape):
            status = STANDSTILL
            break
        q_a, tip, tool, sine = sample(
            packed, kind, how, shape, beside, spans, length, rotary, guide, 0.0, 0.0, 0.0
        )
        if count == 0:
            tips[0], tools[0] = tip, tool
        while waiting > 0 and sine >= least:
            b = ends[waiting - 1]
            middle = 0.5 * (a + b)
            if fresh:  # on a break the left end is another one than the last right end
                q_a = sample(
                    packed, kind, how, shape, beside, spans, length, rotary, guide, way, a, middle
                )[0]
                fresh = False
            if free:  # whole turns follow the left end of the cell
                rotary[FIRST], rotary[SECOND] = q_a[0, 3], q_a[0, 4]
            h = arc_length(kind, how, shape, beside, height, length, a, b)
            half = arc_length(kind, how, shape, beside, height, length, a, middle)
            q_m, _, _, sine = sample(
                packed, kind, how, shape, beside, spans, length, rotary, guide, way + half, middle,
                middle,
            )  # fmt: skip
            if sine < least:
                break
            if free:
                rotary[FIRST], rotary[SECOND] = q_m[0, 3], q_m[0, 4]
            q_b, tip, tool, sine = sample(
                packed, kind, how, shape, beside, spans, length, rotary, guide, way + h, b, middle
            )
            room = count - begin + waiting < MOST_CELLS - 1 and h > FINEST_CELL
            fits = not room or septic_fits(q_a, q_b, h, half, q_m, axes, rounding)
            if sine >= least and not fits:
                ends[waiting] = middle
                waiting += 1
                continue
            waiting -= 1
            steps[count] = h
            for i in range(n_axes):
                left[count, :, i], right[count, :, i] = q_a[:, axes[i]], q_b[:, axes[i]]
            count += 1
            if b <= 0.5:
                early[row] = count - begin
            tips[count], tools[count] = tip, tool
            a, q_a, fresh, way = b, q_b, (kind == CORNER or guided) and b in grid, way + h
        counts[row] = count - begin
        if sine < least:
            status = UNREACHABLE if sine < 0.0 else SINGULAR
            break
        rotary[FIRST], rotary[SECOND] = q_a[0, 3], q_a[0, 4]
        if guided and guide[GUIDE_TO] <= 1.0:
            rotary[BRANCH] = guide[BRANCH_AFTER]
    return (
        status, counts[: row + 1], early[: row + 1], steps[:count], left[:count], right[:count],
        tips[: count + 1], tools[: count + 1],
    )  # fmt: skip
