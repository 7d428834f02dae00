"""
PathSegments -> AxisPath: sample q and its derivatives by path length, cell by cell.

Each segment is cut into cells until the septic polynomial between a cell's ends meets the exact
axes in the middle. Cells break where the third derivative may jump: at joins and at u = 0.5 of
corners, where both curves are taken from the same side.
"""

from __future__ import annotations

from math import sqrt

import numpy as np
from numba import njit

from cnc_interp import jet
from cnc_interp.kinematics.axis_path import septic_coefficients, septic_value
from cnc_interp.kinematics.transform import OUTER, linear_jets, rotary_jets
from cnc_interp.smoothing.segments import CORNER, LINE, corner_jets, great_circle_jets, line_jets

#: How the rotary axes of a segment are found.
FREE, HELD, RADIAL, PROGRAMMED, NO_ROTARY = 0, 1, 2, 3, 4
#: Septic and exact axes agree to this in the middle of a cell [m or rad].
CELL_ERROR = 1e-10
#: and its third derivative to this share; below the rounding of the axes over h^3 it is noise.
THIRD_ERROR = 0.01
ROUNDING = 1e-12
#: A segment is cut into at most this many cells.
MOST_CELLS = 4096
FINE, UNREACHABLE, SINGULAR = 0, 1, 2

GAUSS_X, GAUSS_W = np.polynomial.legendre.leggauss(10)


@njit(cache=True)
def sample(packed, kind, mode, bottom, top, connection, axis, rotation, rotary, length, held, u, late):  # type: ignore[no-untyped-def]  # noqa: E501
    """
    Return axes, tip and axis at one point of a segment.

    Parameters
    ----------
    packed : ndarray
        Geometry of the machine.
    kind, mode : int
        Kind of segment, and how its rotary axes are found.
    bottom ... length
        The segment's row of PathSegments.
    held : ndarray, shape (4,)
        Primary and secondary position nearby [rad], branch (+1, -1), and for RADIAL the rate of
        the tilt per unit of u [rad].
    u : float
        Parameter in [0, 1].
    late : bool
        Which side of u = 0.5 to take.

    Returns
    -------
    q : ndarray, shape (4, 5)
        Axes and three derivatives by path length.
    tip, tool : ndarray, shape (3,)
        Tool tip [m] and tool axis [-].
    speed : float
        ds/du [m].
    sine_squared : float
        Of the tilt; negative when unreachable.

    """
    if kind == CORNER:
        p, o = corner_jets(bottom, top, connection, u, late)
        dx = (p[0][1], 2.0 * p[0][2], 3.0 * p[0][3], 0.0)
        dy = (p[1][1], 2.0 * p[1][2], 3.0 * p[1][3], 0.0)
        dz = (p[2][1], 2.0 * p[2][2], 3.0 * p[2][3], 0.0)
        speed = jet.square_root(jet.dot((dx, dy, dz), (dx, dy, dz)))
    else:
        if kind == LINE:
            p, o = line_jets(bottom, axis, rotation, u)
        else:
            p = (jet.constant(bottom[0, 0]), jet.constant(bottom[0, 1]), jet.constant(bottom[0, 2]))
            o = great_circle_jets(axis, rotation, u)
        speed = jet.constant(length)
    sine_squared = 1.0
    if mode == NO_ROTARY:
        first, second = jet.constant(0.0), jet.constant(0.0)
    elif mode == PROGRAMMED:
        d1, d2 = rotary[1, 0] - rotary[0, 0], rotary[1, 1] - rotary[0, 1]
        first = (rotary[0, 0] + u * d1, d1, 0.0, 0.0)
        second = (rotary[0, 1] + u * d2, d2, 0.0, 0.0)
    else:
        outer = int(packed[OUTER])
        if mode == HELD:
            first, second = jet.constant(held[0]), jet.constant(held[1])
        elif mode == RADIAL:
            tilt = (held[1 - outer] + held[3] * u, held[3], 0.0, 0.0)
            turn = jet.constant(held[outer])
            first, second = (tilt, turn) if outer == 1 else (turn, tilt)
        else:
            tilt, turn, sine_squared = rotary_jets(
                packed, o, held[2], held[1 - outer], held[outer]
            )
            first, second = (tilt, turn) if outer == 1 else (turn, tilt)
    v = linear_jets(packed, p, first, second)
    q = np.empty((4, 5))
    for i, component in enumerate((v[0], v[1], v[2], first, second)):
        q[0, i], q[1, i], q[2, i], q[3, i] = jet.by_arc_length(component, speed)
    tip = np.array([p[0][0], p[1][0], p[2][0]])
    tool = np.array([o[0][0], o[1][0], o[2][0]])
    return q, tip, tool, speed[0], sine_squared


@njit(cache=True)
def arc_length(kind, bottom, top, connection, length, a, b):  # type: ignore[no-untyped-def]
    """Return the path length of a segment between parameters a and b of one half [m]."""
    if kind != CORNER:
        return length * (b - a)
    late = 0.5 * (a + b) > 0.5
    total = 0.0
    for x, weight in zip(GAUSS_X, GAUSS_W):
        u = 0.5 * (a + b) + 0.5 * (b - a) * x
        p, _ = corner_jets(bottom, top, connection, u, late)
        total += weight * sqrt(p[0][1] ** 2 + p[1][1] ** 2 + p[2][1] ** 2)
    return 0.5 * (b - a) * total


@njit(cache=True)
def sample_segment(packed, cone_sine, n_axes, kind, mode, bottom, top, connection, axis, rotation, rotary, length, held, grid):  # type: ignore[no-untyped-def]  # noqa: E501
    """
    Cut one segment into cells.

    Parameters
    ----------
    cone_sine : float
        Sine of the singular cone [-].
    n_axes : int
        3 or 5.
    held : ndarray, shape (4,)
        As in ``sample``; on return the rotary axes at the end of the segment.
    grid : ndarray
        First parameters to use, from 0 to 1; 0.5 among them for corners.

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
    ends = np.empty(MOST_CELLS)  # right ends of the cells still to do, last one first
    waiting = 0
    for i in range(len(grid) - 1, 0, -1):
        ends[waiting] = grid[i]
        waiting += 1
    count, early, a = 0, 0, 0.0
    q_a, tip, tool, _, sine = sample(
        packed, kind, mode, bottom, top, connection, axis, rotation, rotary, length, held, a, False
    )
    if sine < cone_sine * cone_sine:
        return (
            UNREACHABLE if sine < 0.0 else SINGULAR,
            0, steps[:0], left[:, :0], right[:, :0], tips[:1], tools[:1],
        )  # fmt: skip
    tips[0], tools[0] = tip, tool
    while waiting > 0:
        b = ends[waiting - 1]
        middle = 0.5 * (a + b)
        late = middle > 0.5
        if a == 0.5:
            q_a = sample(
                packed, kind, mode, bottom, top, connection, axis, rotation, rotary, length,
                held, a, True,
            )[0]  # fmt: skip
        if mode == FREE:  # whole turns follow the left end of the cell
            held[0], held[1] = q_a[0, 3], q_a[0, 4]
        q_m, _, _, _, sine_m = sample(
            packed, kind, mode, bottom, top, connection, axis, rotation, rotary, length, held,
            middle, late,
        )  # fmt: skip
        if mode == FREE:
            held[0], held[1] = q_m[0, 3], q_m[0, 4]
        q_b, tip, tool, _, sine = sample(
            packed, kind, mode, bottom, top, connection, axis, rotation, rotary, length, held, b,
            late,
        )  # fmt: skip
        if min(sine, sine_m) < cone_sine * cone_sine:
            return (
                UNREACHABLE if min(sine, sine_m) < 0.0 else SINGULAR,
                0, steps[:0], left[:, :0], right[:, :0], tips[:1], tools[:1],
            )  # fmt: skip
        h = arc_length(kind, bottom, top, connection, length, a, b)
        half = arc_length(kind, bottom, top, connection, length, a, middle)
        room = count + waiting < MOST_CELLS - 1
        if room and not septic_fits(q_a, q_b, h, half, q_m, n_axes):
            ends[waiting] = middle
            waiting += 1
            continue
        waiting -= 1
        steps[count] = h
        left[:, count], right[:, count] = q_a[:, :n_axes], q_b[:, :n_axes]
        count += 1
        if not late:
            early = count
        tips[count], tools[count] = tip, tool
        a, q_a = b, q_b
    if mode == FREE or mode == PROGRAMMED or mode == RADIAL:
        held[0], held[1] = q_a[0, 3], q_a[0, 4]
    return (
        FINE, early, steps[:count].copy(), left[:, :count].copy(), right[:, :count].copy(),
        tips[: count + 1].copy(), tools[: count + 1].copy(),
    )  # fmt: skip


@njit(cache=True)
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
