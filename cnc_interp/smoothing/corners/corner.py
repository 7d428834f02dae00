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

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.corners.connection import connect
from cnc_interp.smoothing.corners.corner_curves import Curves, poses
from cnc_interp.smoothing.corners.orientation_bounds import orientation_bounds
from cnc_interp.smoothing.orientation import norm, turned_by

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

    @staticmethod
    def of(settings: Settings) -> Style:
        """Take what concerns the corners alone."""
        in_step = settings.top == 'in_step'
        return Style(settings.flank_height, in_step, settings.parametrization, settings.septic)

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
    Bound contour and orientation deviation of corners, shape (n, 2) [m].

    The contour deviation is the distance of the middle from the programmed corner (Eq. 3), the
    largest there is in either direction. The orientation deviation, at flank height, is the
    largest of three: the same distance on top; the distance of any top point from the programmed
    top locus; and the change of the axis against the programmed one at the tip's nearest point.
    """
    point, tool = poses(curves, 0.5)
    contour = norm(point - corners.tip)
    missed = norm(point + style.height * tool - curves.top[:, 2])
    bounds = orientation_bounds(
        curves, corners.legs, corners.rates, outer, style.height, least=missed
    )
    return np.stack([contour, bounds], axis=1)
