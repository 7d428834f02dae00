"""
The 5-axis corner: two cubic B-splines within contour and orientation tolerance [B2013, 2.2-2.3].

Bottom polygon: P2 the programmed corner, P1 and P3 at L1 from it, P0 and P4 at L2 on the two
lines. The largest deviation is that of the middle, |C(0.5) - P2| = |L1 (v + w)| / 4 (Eq. 3, A.3).

Top polygon: P12 = P2 + h o; P10 and P14 lie on the programmed axis at entry and exit. Its inner
points divide the legs like those of the bottom polygon (*in step*), so u_top = u_bottom is right
to first order; where the top then deviates by more than the orientation tolerance, L1 shrinks.
The paper sets the inner points from the orientation tolerance alone and bends the parametrization.
"""

from __future__ import annotations

from math import cos, sqrt

import numpy as np
from numba import njit

from cnc_interp.smoothing.orientation import connect, turned_by
from cnc_interp.smoothing.segments import corner_pose

#: Parameters at which the axis is compared with the programmed one.
PROBES = np.arange(1, 16) / 16.0
#: Shortest ratio L2/L1 where the lines are too short for the tolerance.
LEAST_RATIO = 1.5
#: The tool axis turns at most this much on each side inside one corner [rad].
LARGEST_TURN = 0.7


@njit(cache=True)
def first_lengths(legs, lengths, turns, tolerance, ratio):  # type: ignore[no-untyped-def]
    """
    Return L1 and both L2 of a corner from the contour tolerance and the lengths of its lines.

    Parameters
    ----------
    legs : ndarray, shape (2, 3)
        Unit vectors from the corner along both lines [-].
    lengths : ndarray, shape (2,)
        Length of each line that the corner may use [m].
    turns : ndarray, shape (2,)
        Angle of the tool axis over that length [rad].
    tolerance : float
        Contour tolerance [m].
    ratio : float
        L2/L1 where there is room [-].

    """
    room = np.empty(2)
    for side in range(2):
        room[side] = lengths[side]
        if turns[side] > LARGEST_TURN:
            room[side] *= LARGEST_TURN / turns[side]
    inner = min(room[0], room[1]) / LEAST_RATIO
    bend = norm(legs[0] + legs[1])
    if bend * inner > 4.0 * tolerance:
        inner = 4.0 * tolerance / bend  # Eq. 3 and A.3
    return inner, min(ratio * inner, room[0]), min(ratio * inner, room[1])


@njit(cache=True)
def build(tip, axis, height, legs, rates, inner, outer, bottom, top, connection):  # type: ignore[no-untyped-def]
    """
    Fill the control points of a corner.

    Parameters
    ----------
    tip, axis : ndarray, shape (3,)
        The programmed corner [m] and tool axis [-].
    height : float
        Flank height h [m].
    legs : ndarray, shape (2, 3)
        Unit vectors from the corner along both lines [-].
    rates : ndarray, shape (2, 3)
        Rotation vector per metre of path before and after [rad/m].
    inner, outer : float and ndarray, shape (2,)
        L1 and both L2 [m].
    bottom, top, connection : ndarray, shapes (5, 3), (5, 3), (6, 3)
        Results [m].

    """
    axes = np.empty((2, 3))
    axes[0] = turned_by(axis, rates[0], -outer[0])
    axes[1] = turned_by(axis, rates[1], outer[1])
    bottom[2] = tip
    top[2] = tip + height * axis
    for side in range(2):
        end, mid = 4 * side, 1 + 2 * side
        bottom[end] = tip + outer[side] * legs[side]
        bottom[mid] = tip + inner * legs[side]
        top[end] = bottom[end] + height * axes[side]
        top[mid] = top[2] + (inner / outer[side]) * (top[end] - top[2])
    connect(bottom, top, height, axes, rates, connection)


@njit(cache=True)
def norm(v):  # type: ignore[no-untyped-def]
    """Return the length of a vector, shape (3,)."""
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@njit(cache=True)
def top_bound(height, rates, outer, bottom, top, connection):  # type: ignore[no-untyped-def]
    """
    Bound the distance of every top point p + h o of a corner from the programmed top locus [m].

    On each half only one control point lies off that half's leg, with a weight of at most
    B_33(0.5) = 1/4 (A.2). Let p and D be tip and tool vector, p' and D' those of the foot on the
    leg, and o' the direction of D'. Normalising takes away the part of d = D - D' along o':

        |p + h D/|D| - p' - h o'| <= |p - p' + d - (d . o') o'| + (h/|D'| - 1) |d| + 2.3 |d|^2/h

    for |d| < h/4. Between the ends of the leg o' turns by ``angle``, which moves the projection by
    at most |d| angle. The leg is a chord of the programmed arc, and its direction runs ahead of
    the arc's by less than 0.02 angle^3. The connection E adds to d, at most its control points.
    """
    largest = added = 0.0
    for i in range(1, connection.shape[0] - 1):
        added = max(added, norm(connection[i]))
    for side in range(2):
        end, mid, far = 4 * side, 1 + 2 * side, 3 - 2 * side
        leg, own, off = top[end] - top[2], top[mid] - top[2], top[far] - top[2]
        off_tip = bottom[far] - bottom[2]
        square = (leg**2).sum()
        if square > 0.0:  # nearest point of the leg; at u = 0.5 it must not pass the corner
            foot = max((off * leg).sum() / square, -norm(own) / sqrt(square))
            off = off - foot * leg
            off_tip = off_tip - foot * (bottom[end] - bottom[2])
        off_tool = off - off_tip
        away = 0.0
        for k in (end, 2):
            tool = (top[k] - bottom[k]) / height
            across = 0.0
            for i in range(1, connection.shape[0] - 1):
                across = max(across, norm(connection[i] - (connection[i] * tool).sum() * tool))
            away = max(away, 0.25 * norm(off - (off_tool * tool).sum() * tool) + across)
        angle = norm(rates[side]) * outer[side]
        gap = 0.25 * norm(off_tool) + added
        away += gap * (angle + 1.0 / cos(0.5 * angle) - 1.0 + 2.3 * gap / height)
        largest = max(largest, away + 0.02 * height * angle**3)
    return largest


@njit(cache=True)
def swing(tip, axis, height, legs, rates, outer, bottom, top, connection):  # type: ignore[no-untyped-def]
    """Return the change of the axis against the programmed one at the tip's nearest point [m]."""
    largest = 0.0
    for u in PROBES:
        point, tool = corner_pose(bottom, top, connection, u)
        side = 0 if u <= 0.5 else 1
        x = min(max(((point - tip) * legs[side]).sum(), 0.0), outer[side])
        programmed = turned_by(axis, rates[side], x if side == 1 else -x)
        largest = max(largest, height * norm(tool - programmed))
    return largest


@njit(cache=True)
def deviations(tip, axis, height, legs, rates, outer, bottom, top, connection):  # type: ignore[no-untyped-def]
    """
    Return the contour and the orientation deviation of a corner [m].

    The contour deviation is the distance of the middle from the programmed corner (Eq. 3), the
    largest there is in either direction. The orientation deviation, at flank height, is the
    largest of three: the same distance on top, the bound of the distance from the programmed top
    locus, and the change of the axis against the programmed one at the tip's nearest point.
    """
    point, tool = corner_pose(bottom, top, connection, 0.5)
    contour = norm(point - tip)
    missed = norm(point + height * tool - top[2])
    away = top_bound(height, rates, outer, bottom, top, connection)
    turned = swing(tip, axis, height, legs, rates, outer, bottom, top, connection)
    return contour, max(missed, away, turned)


@njit(cache=True)
def fit(tip, axis, height, legs, rates, tolerances, inner, outer, bottom, top, connection):  # type: ignore[no-untyped-def]
    """
    Build a corner and shrink its L1 until both tolerances hold; ends stay where they are.

    Returns
    -------
    inner, contour, orientation : float
        L1 and the deviations reached [m].

    """
    contour = orientation = 0.0
    for _ in range(30):
        build(tip, axis, height, legs, rates, inner, outer, bottom, top, connection)
        contour, orientation = deviations(
            tip, axis, height, legs, rates, outer, bottom, top, connection
        )
        excess = max(contour / tolerances[0], orientation / tolerances[1])
        if excess <= 1.0 + 1e-9:
            break
        inner *= min(0.995, max(0.25, 0.998 / excess))
    return inner, contour, orientation


@njit(cache=True)
def size_corners(  # type: ignore[no-untyped-def]
    tip, axis, height, legs, rates, lengths, turns, tolerances, ratio, inner, outer
):
    """
    Choose L1 and both L2 of many corners, each on its own (first pass).

    Parameters
    ----------
    tip, axis : ndarray, shape (n, 3)
        Corners and tool axes.
    height, ratio : float
        Flank height [m] and L2/L1 [-].
    legs, rates : ndarray, shape (n, 2, 3)
        As in ``build``.
    lengths, turns, tolerances : ndarray, shape (n, 2)
        As in ``first_lengths``; contour and orientation tolerance [m].
    inner, outer : ndarray, shapes (n,) and (n, 2)
        Results [m].

    """
    bottom, top, connection = np.empty((5, 3)), np.empty((5, 3)), np.empty((6, 3))
    for i in range(len(tip)):
        l1, a, b = first_lengths(legs[i], lengths[i], turns[i], tolerances[i, 0], ratio)
        outer[i, 0], outer[i, 1] = a, b
        for _ in range(20):
            build(
                tip[i], axis[i], height, legs[i], rates[i], l1, outer[i], bottom, top, connection
            )
            contour, orientation = deviations(
                tip[i], axis[i], height, legs[i], rates[i], outer[i], bottom, top, connection
            )
            excess = max(contour / tolerances[i, 0], orientation / tolerances[i, 1])
            if excess <= 1.0 + 1e-9:
                break
            shrink = min(0.995, max(0.05, 0.998 / excess))
            l1 *= shrink
            outer[i, 0] = min(outer[i, 0], ratio * l1)
            outer[i, 1] = min(outer[i, 1], ratio * l1)
        inner[i] = l1


@njit(cache=True)
def fit_corners(  # type: ignore[no-untyped-def]
    tip, axis, height, legs, rates, tolerances, inner, outer, bottom, top, connection, deviation
):
    """Build many corners whose ends are decided (second pass); arrays as in ``fit``."""
    for i in range(len(tip)):
        inner[i], deviation[i, 0], deviation[i, 1] = fit(
            tip[i], axis[i], height, legs[i], rates[i], tolerances[i],
            inner[i], outer[i], bottom[i], top[i], connection[i],
        )  # fmt: skip
