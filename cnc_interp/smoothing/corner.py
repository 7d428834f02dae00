"""
The 5-axis corner: two cubic B-splines within contour and orientation tolerance [B2013, 2.2-2.3].

Bottom polygon: P2 the programmed corner, P1 and P3 at L1 from it, P0 and P4 at L2 on the two
lines. The largest deviation is that of the middle, |C(0.5) - P2| = |L1 (v + w)| / 4 (Eq. 3, A.3).

Top polygon: P12 = P2 + h o; P10 and P14 lie on the programmed axis at entry and exit. Two ways to
place its inner points. ``in_step`` divides its legs like those of the bottom polygon, so that
u_top = u_bottom is right to first order; where the top then deviates by more than the orientation
tolerance, L1 shrinks. ``tolerance``, the paper's, sets them from the orientation tolerance alone.
Everything is vectorised over corners.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.program.blocks import FloatArray, IntArray
from cnc_interp.smoothing.connection import connect
from cnc_interp.smoothing.curves import Curves, poses
from cnc_interp.smoothing.orientation import dot, norm, turned_by

#: Parameters at which the axis is compared with the programmed one.
PROBES = np.arange(1, 16) / 16.0
#: Shortest ratio L2/L1 where the lines are too short for the tolerance.
LEAST_RATIO = 1.5
#: The same on top, where the inner points follow from the orientation tolerance alone.
LEAST_TOP_RATIO = 1.4
#: The tool axis turns at most this much on each side inside one corner [rad].
LARGEST_TURN = 0.7
#: A corner that uses its tolerance to this is not shrunk any more.
USED_UP = 1.0 + 1e-9


@dataclass(frozen=True)
class Corners:
    """
    What the program says about n corners.

    Parameters
    ----------
    tip, axis : ndarray, shape (n, 3)
        Programmed corners [m] and tool axes there [-].
    legs : ndarray, shape (n, 2, 3)
        Unit vectors from the corner along both lines [-].
    rates : ndarray, shape (n, 2, 3)
        Rotation vector per metre of path on the lines before and after [rad/m].
    tolerances : ndarray, shape (n, 2)
        Contour and orientation tolerance [m].

    """

    tip: FloatArray
    axis: FloatArray
    legs: FloatArray
    rates: FloatArray
    tolerances: FloatArray

    def __getitem__(self, rows: IntArray) -> Corners:
        """Take some of the corners."""
        return Corners(*(getattr(self, field.name)[rows] for field in fields(self)))

    def axis_at(self, side: int, x: FloatArray) -> FloatArray:
        """Return the programmed axis at x metres from the corner on one side, shape (n, 3)."""
        return turned_by(self.axis, self.rates[:, side], x if side else -x)


@dataclass(frozen=True)
class Style:
    """
    How corners are made.

    Parameters
    ----------
    height : float
        Flank height h [m].
    in_step : bool
        How the top polygon is divided.
    method : {'exact', 'linear', 'paper'}
        How the orientation is connected.
    septic : bool
        Whether E is septic instead of quintic.

    """

    height: float
    in_step: bool
    method: str
    septic: bool

    def room(self, count: int) -> Curves:
        """Return room for the curves of some corners."""
        spans = {'paper': 7, 'linear': 0, 'exact': 0 if self.in_step else 1}[self.method]
        return Curves.empty(count, 8 if self.septic else 6, spans)


def first_lengths(
    corners: Corners, lengths: FloatArray, ratios: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """
    Return L1, shape (n,), and both L2, shape (n, 2), from the contour tolerance and the room.

    ``lengths`` says how much of each line a corner may use [m], ``ratios`` is L2/L1 where there is
    room [-]; shapes (n, 2).
    """
    turn = norm(corners.rates) * lengths
    room = lengths * np.minimum(1.0, LARGEST_TURN / np.maximum(turn, 1e-300))
    inner = room.min(axis=1) / LEAST_RATIO
    bend = norm(corners.legs[:, 0] + corners.legs[:, 1])
    allowed = 4.0 * corners.tolerances[:, 0]
    bound = bend * inner > allowed
    inner = np.where(bound, allowed / np.where(bound, bend, 1.0), inner)  # Eq. 3 and A.3
    return inner, np.minimum(ratios * inner[:, None], room)


def build(
    corners: Corners, inner: FloatArray, outer: FloatArray, reach: FloatArray, style: Style
) -> Curves:
    """
    Return the curves of corners.

    Parameters
    ----------
    inner, outer : ndarray, shapes (n,) and (n, 2)
        L1 and both L2 [m].
    reach : ndarray, shape (n,)
        Deviation for which ``tolerance`` sets the inner points of the top polygon [m].

    """
    curves = style.room(len(inner))
    bottom, top = curves.bottom, curves.top
    axes = np.stack([corners.axis_at(side, outer[:, side]) for side in (0, 1)], axis=1)
    bottom[:, 2] = corners.tip
    top[:, 2] = corners.tip + style.height * corners.axis
    for side in (0, 1):
        leg = corners.legs[:, side]
        bottom[:, 4 * side] = corners.tip + outer[:, side, None] * leg
        bottom[:, 1 + 2 * side] = corners.tip + inner[:, None] * leg
        top[:, 4 * side] = bottom[:, 4 * side] + style.height * axes[:, side]
    shares = inner[:, None] / outer if style.in_step else top_shares(top, reach)
    for side in (0, 1):
        leg = top[:, 4 * side] - top[:, 2]
        top[:, 1 + 2 * side] = top[:, 2] + shares[:, side, None] * leg
    connect(curves, style.height, axes, corners.rates, style.method)
    return curves


def top_shares(top: FloatArray, reach: FloatArray) -> FloatArray:
    """Return where the paper's inner top points divide the legs, shape (n, 2): Eq. 3 on top."""
    legs = top[:, [0, 4]] - top[:, 2:3]
    lengths = np.maximum(norm(legs), 1e-300)
    inner = lengths.min(axis=1) / LEAST_TOP_RATIO
    unit = legs / lengths[..., None]
    bend = norm(unit[:, 0] + unit[:, 1])
    bound = bend * inner > 4.0 * reach
    inner = np.where(bound, 4.0 * reach / np.where(bound, bend, 1.0), inner)
    return np.asarray(inner[:, None] / lengths)


def fit(
    corners: Corners,
    inner: FloatArray,
    outer: FloatArray,
    style: Style,
    ratios: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray, Curves, FloatArray]:
    """
    Build corners and shrink them until both tolerances hold.

    Parameters
    ----------
    corners : Corners
        The corners.
    inner, outer : ndarray, shapes (n,) and (n, 2)
        L1 and both L2 to begin with [m].
    style : Style
        How corners are made.
    ratios : ndarray, shape (n, 2), optional
        Largest L2/L1 of a corner that shrinks; without it the ends stay where they are [-].

    Returns
    -------
    inner, outer : ndarray
        As reached.
    curves : Curves
        The corners.
    deviation : ndarray, shape (n, 2)
        Contour and orientation deviation [m].

    """
    inner, outer = inner.copy(), outer.copy()
    reach = corners.tolerances[:, 1].copy()
    curves, deviation = style.room(len(inner)), np.zeros((len(inner), 2))
    rows = np.arange(len(inner))
    for turn in range(30):
        some = corners[rows]
        built = build(some, inner[rows], outer[rows], reach[rows], style)
        curves.put(rows, built)
        deviation[rows] = deviations(some, outer[rows], built, style)
        excess = (deviation[rows] / some.tolerances).max(axis=1)
        too_large = excess > USED_UP
        rows = rows[too_large]
        if not len(rows):
            break
        # Where only the swing of the axis is too large, L1 must fall far before L2 follows.
        shrink = np.clip(0.998 / excess[too_large], 0.05, 0.995 if turn < 6 else 0.9)
        inner[rows] *= shrink
        reach[rows] *= shrink
        if ratios is not None:
            outer[rows] = np.minimum(outer[rows], ratios[rows] * inner[rows, None])
    return inner, outer, curves, deviation


def deviations(corners: Corners, outer: FloatArray, curves: Curves, style: Style) -> FloatArray:
    """
    Return contour and orientation deviation of corners, shape (n, 2) [m].

    The contour deviation is the distance of the middle from the programmed corner (Eq. 3), the
    largest there is in either direction. The orientation deviation, at flank height, is the
    largest of three: the same distance on top; the distance from the programmed top locus, as a
    bound for ``in_step`` with f(u) = u, else as measured; and the change of the axis against the
    programmed one at the tip's nearest point.
    """
    point, tool = poses(curves, 0.5)
    contour = norm(point - corners.tip)
    missed = norm(point + style.height * tool - curves.top[:, 2])
    bounded = style.in_step and curves.parametrization.shape[1] == 0
    away = top_bound(corners, outer, curves, style.height) if bounded else np.zeros(len(contour))
    swing = np.zeros(len(contour))
    for u in PROBES:
        point, tool = poses(curves, u)
        side = 0 if u <= 0.5 else 1
        x = dot(point - corners.tip, corners.legs[:, side]).clip(0.0, outer[:, side])
        swing = np.maximum(swing, norm(tool - corners.axis_at(side, x)))
        if not bounded:
            top_point = point + style.height * tool
            away = np.maximum(away, top_distance(corners, outer, curves, style.height, top_point))
    return np.stack([contour, np.maximum(np.maximum(missed, away), style.height * swing)], axis=1)


def top_distance(
    corners: Corners, outer: FloatArray, curves: Curves, height: float, point: FloatArray
) -> FloatArray:
    """Return the distance of top points from the programmed top locus, shape (n,) [m]."""
    nearest = np.full(len(point), np.inf)
    for side in (0, 1):
        leg = curves.top[:, 4 * side] - curves.top[:, 2]
        share = dot(point - curves.top[:, 2], leg) / np.maximum(dot(leg, leg), 1e-300)
        x = share.clip(0.0, 1.0) * outer[:, side]
        locus = corners.tip + x[:, None] * corners.legs[:, side]
        nearest = np.minimum(nearest, norm(point - locus - height * corners.axis_at(side, x)))
    return nearest


def top_bound(corners: Corners, outer: FloatArray, curves: Curves, height: float) -> FloatArray:
    """
    Bound the distance of every top point p + h o of corners from the top locus, shape (n,) [m].

    On each half only one control point lies off that half's leg, with a weight of at most
    B_33(0.5) = 1/4 (A.2). Let p and D be tip and tool vector, p' and D' those of the foot on the
    leg, and o' the direction of D'. Normalising takes away the part of d = D - D' along o':

        |p + h D/|D| - p' - h o'| <= |p - p' + d - (d . o') o'| + (h/|D'| - 1) |d| + 2.3 |d|^2/h

    for |d| < h/4. Between the ends of the leg o' turns by ``angle``, which moves the projection by
    at most |d| angle. The leg is a chord of the programmed arc, and its direction runs ahead of
    the arc's by less than 0.02 angle^3. The connection E adds to d, at most its control points.
    """
    bottom, top, inside = curves.bottom, curves.top, curves.connection[:, 1:-1]
    largest = np.zeros(len(bottom))
    added = norm(inside).max(axis=1)
    for side in (0, 1):
        end, mid, far = 4 * side, 1 + 2 * side, 3 - 2 * side
        leg, own, off = (top[:, k] - top[:, 2] for k in (end, mid, far))
        off_tip, tip_leg = bottom[:, far] - bottom[:, 2], bottom[:, end] - bottom[:, 2]
        square = np.maximum(dot(leg, leg), 1e-300)
        # nearest point of the leg; at u = 0.5 it must not pass the corner
        foot = np.maximum(dot(off, leg) / square, -norm(own) / np.sqrt(square))[:, None]
        off_tool = off - off_tip - foot * (leg - tip_leg)
        off = off - foot * leg
        away = np.zeros(len(bottom))
        for k in (end, 2):
            tool = (top[:, k] - bottom[:, k]) / height
            across = inside - dot(inside, tool[:, None])[..., None] * tool[:, None]
            plain = off - dot(off_tool, tool)[:, None] * tool
            away = np.maximum(away, 0.25 * norm(plain) + norm(across).max(axis=1))
        angle = norm(corners.rates[:, side]) * outer[:, side]
        gap = 0.25 * norm(off_tool) + added
        away += gap * (angle + 1.0 / np.cos(0.5 * angle) - 1.0 + 2.3 * gap / height)
        largest = np.maximum(largest, away + 0.02 * height * angle**3)
    return largest
