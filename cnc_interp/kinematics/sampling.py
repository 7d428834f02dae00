"""
One segment -> cells of the AxisPath: q and its exact derivatives by path length.

A segment is cut into cells until the septic polynomial between a cell's ends meets the exact axes
inside. Cells break where the third derivative may jump: at joins and at u = 0.5 of corners, where
both curves are taken from the same side.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from cnc_interp import jet
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_value
from cnc_interp.kinematics.transform import OUTER, linear_jets, rotary_jets
from cnc_interp.program.blocks import FloatArray
from cnc_interp.smoothing.segments import (
    CORNER,
    LINE,
    PathSegments,
    corner_jets,
    great_circle_jets,
    line_jets,
    spline_component,
)

#: Septic and exact axes agree to this inside a cell [m or rad],
CELL_ERROR = 1e-10
#: and their third derivatives to this share; ROUNDING / h^3 is noise of the axes.
THIRD_ERROR = 0.01
ROUNDING = 1e-12
#: A segment is cut into at most this many cells.
MOST_CELLS = 4096
#: What became of a segment.
FINE, UNREACHABLE, SINGULAR = 0, 1, 2
#: Layout of ``rotary``: positions, branch (+1, -1, or 0 for linear), rates per unit of u.
FIRST, SECOND, BRANCH, FIRST_RATE, SECOND_RATE = range(5)
#: Rows of a segment's ``shape``.
BOTTOM, TOP, AXIS, ROTATION, CONNECTION = slice(0, 5), slice(5, 10), 10, 11, slice(12, None)

# Gauss-Legendre points and weights for the arc length of half a corner
_GAUSS = np.array(np.polynomial.legendre.leggauss(10))  # type: ignore[no-untyped-call]


def shapes_of(segments: PathSegments) -> FloatArray:
    """Stack the geometry of segments for the kernels, shape (n, 18, 3)."""
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
def sample(packed, kind, shape, f, length, rotary, u, inside):  # type: ignore[no-untyped-def]
    """
    Return the axes at one point of a segment.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    kind, length : int, float
        Kind of the segment, and its length unless it is a corner [m].
    shape, f : ndarray, shapes (m, 3) and (spans, 8)
        Its geometry, and the parametrization of corners.
    rotary : ndarray, shape (5,)
        Rotary axes: with branch 0 they run linearly in u from the given positions at the given
        rates; otherwise they follow from the tool axis, on that branch and at the whole turns
        nearest to the given positions [rad].
    u : float
        Parameter in [0, 1].
    inside : float
        A parameter inside the cell that u belongs to, where u lies on a break.

    Returns
    -------
    q : ndarray, shape (4, 5)
        Axes and three derivatives by path length.
    tip, tool : ndarray, shape (3,)
        Tool tip [m] and tool axis [-].
    sine_squared : float
        Of the tilt from the pole; negative when unreachable, 1 for linear rotary axes.

    """
    if kind == CORNER:
        p, o = corner_jets(shape[BOTTOM], shape[TOP], shape[CONNECTION], f, u, inside)
        dx = (p[0][1], 2.0 * p[0][2], 3.0 * p[0][3], 0.0)
        dy = (p[1][1], 2.0 * p[1][2], 3.0 * p[1][3], 0.0)
        dz = (p[2][1], 2.0 * p[2][2], 3.0 * p[2][3], 0.0)
        speed = jet.square_root(jet.dot((dx, dy, dz), (dx, dy, dz)))
    elif kind == LINE:
        p, o = line_jets(shape[BOTTOM], shape[AXIS], shape[ROTATION], u)
        speed = jet.constant(length)
    else:
        p = (jet.constant(shape[0, 0]), jet.constant(shape[0, 1]), jet.constant(shape[0, 2]))
        o = great_circle_jets(shape[AXIS], shape[ROTATION], u)
        speed = jet.constant(length)
    if rotary[BRANCH] == 0.0:
        first = (rotary[FIRST] + u * rotary[FIRST_RATE], rotary[FIRST_RATE], 0.0, 0.0)
        second = (rotary[SECOND] + u * rotary[SECOND_RATE], rotary[SECOND_RATE], 0.0, 0.0)
        sine_squared = 1.0
    else:
        outer = int(packed[OUTER])
        tilt, turn, sine_squared = rotary_jets(
            packed, o, rotary[BRANCH], rotary[1 - outer], rotary[outer]
        )
        first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    v = linear_jets(packed, p, first, second)
    q = np.empty((4, 5))
    for i, component in enumerate((v[0], v[1], v[2], first, second)):
        q[0, i], q[1, i], q[2, i], q[3, i] = jet.by_arc_length(component, speed)
    tip = np.array([p[0][0], p[1][0], p[2][0]])
    tool = np.array([o[0][0], o[1][0], o[2][0]])
    return q, tip, tool, sine_squared


@njit(cache=True, nogil=True)
def arc_length(kind, shape, length, a, b):  # type: ignore[no-untyped-def]
    """Return the path length of a segment between parameters a and b of one half [m]."""
    if kind != CORNER:
        return length * (b - a)
    late = 0.5 * (a + b) > 0.5
    total = 0.0
    for i in range(_GAUSS.shape[1]):
        u = 0.5 * (a + b) + 0.5 * (b - a) * _GAUSS[0, i]
        dx = spline_component(shape[BOTTOM], 0, u, late)[1]
        dy = spline_component(shape[BOTTOM], 1, u, late)[1]
        dz = spline_component(shape[BOTTOM], 2, u, late)[1]
        total += _GAUSS[1, i] * sqrt(dx * dx + dy * dy + dz * dz)
    return 0.5 * (b - a) * total


@njit(cache=True, nogil=True)
def septic_fits(left, right, h, x, exact, n_axes):  # type: ignore[no-untyped-def]
    """Tell whether the cell's septic at x has the exact axes and third derivatives."""
    coefficients, value = np.empty(8), np.empty(4)
    for i in range(n_axes):
        septic_coefficients(left[:, i], right[:, i], h, coefficients)
        septic_value(coefficients, x / h, h, value)
        if abs(value[0] - exact[0, i]) > CELL_ERROR:
            return False
        size = max(abs(left[3, i]), abs(right[3, i]), abs(exact[3, i]))
        if abs(value[3] - exact[3, i]) > THIRD_ERROR * size + ROUNDING / h**3:
            return False
    return True


@njit(cache=True, nogil=True)
def sample_segment(packed, cone_sine, n_axes, kind, shape, f, length, rotary, grid):  # type: ignore[no-untyped-def]
    """
    Cut one segment into cells.

    Parameters
    ----------
    packed, kind, shape, f, length, rotary
        As in ``sample``; on return ``rotary`` holds the positions at the end of the segment.
    cone_sine : float
        Sine of the singular cone [-].
    n_axes : int
        3 or 5.
    grid : ndarray
        First parameters to use, from 0 to 1, all breaks among them.

    Returns
    -------
    status : int
        FINE, UNREACHABLE or SINGULAR.
    early : int
        How many of the cells lie before u = 0.5.
    steps : ndarray, shape (n,)
        Path length of each cell [m].
    left, right : ndarray, shape (4, n, n_axes)
        As in AxisPath.
    tips, tools : ndarray, shape (n + 1, 3)
        Tool tip and axis at the cells' ends.

    """
    steps = np.empty(MOST_CELLS)
    left, right = np.empty((4, MOST_CELLS, n_axes)), np.empty((4, MOST_CELLS, n_axes))
    tips, tools = np.empty((MOST_CELLS + 1, 3)), np.empty((MOST_CELLS + 1, 3))
    ends = np.empty(MOST_CELLS)  # right ends of the cells still to do, the next one last
    waiting = len(grid) - 1
    ends[:waiting] = grid[:0:-1]
    free = rotary[BRANCH] != 0.0
    least = cone_sine * cone_sine
    count, early, a, fresh = 0, 0, 0.0, False
    q_a, tips[0], tools[0], sine = sample(packed, kind, shape, f, length, rotary, 0.0, 0.0)
    while waiting > 0 and sine >= least:
        b = ends[waiting - 1]
        middle = 0.5 * (a + b)
        if fresh:  # on a break the left end is another one than the last right end
            q_a = sample(packed, kind, shape, f, length, rotary, a, middle)[0]
            fresh = False
        if free:  # whole turns follow the left end of the cell
            rotary[FIRST], rotary[SECOND] = q_a[0, 3], q_a[0, 4]
        q_m, _, _, sine = sample(packed, kind, shape, f, length, rotary, middle, middle)
        if sine < least:
            break
        if free:
            rotary[FIRST], rotary[SECOND] = q_m[0, 3], q_m[0, 4]
        q_b, tip, tool, sine = sample(packed, kind, shape, f, length, rotary, b, middle)
        h = arc_length(kind, shape, length, a, b)
        half = arc_length(kind, shape, length, a, middle)
        room = count + waiting < MOST_CELLS - 1
        if sine >= least and room and not septic_fits(q_a, q_b, h, half, q_m, n_axes):
            ends[waiting] = middle
            waiting += 1
            continue
        waiting -= 1
        steps[count] = h
        left[:, count], right[:, count] = q_a[:, :n_axes], q_b[:, :n_axes]
        count += 1
        if b <= 0.5:
            early = count
        tips[count], tools[count] = tip, tool
        a, q_a, fresh = b, q_b, kind == CORNER and b in grid
    status = FINE if sine >= least else (UNREACHABLE if sine < 0.0 else SINGULAR)
    rotary[FIRST], rotary[SECOND] = q_a[0, 3], q_a[0, 4]
    return (
        status, early, steps[:count].copy(), left[:, :count].copy(), right[:, :count].copy(),
        tips[: count + 1].copy(), tools[: count + 1].copy(),
    )  # fmt: skip
