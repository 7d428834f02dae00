"""The 5-axis corner: two cubic B-splines within both tolerances [B2013, sections 2.2-2.3].

Bottom polygon: P2 is the programmed corner, P1 and P3 are at the distance L1 from it, P0 and P4 at
the distance L2 on the two lines. The deviation is largest in the middle,
|C(0.5) - P2| = |L1 (v + w)| / 4 (Eq. 3, A.3).

Top polygon: P12 = P2 + h o. P10 and P14 lie on the programmed tool axis at the start and end of
the corner. There are two ways to place the inner points. ``in_step`` divides the legs in the same
ratio as on the bottom, so that u_top = u_bottom is right to first order; if the top then exceeds
the orientation tolerance, L1 shrinks. ``tolerance`` is the paper's way: the inner points follow
from the orientation tolerance alone.

``literal`` corners follow the paper word for word: L2 is the same on both sides, at most half of
the shorter line, and L1 = L2 / ratio. Each tolerance counts for its own curve. All functions work
on many corners at once.

The ratio L2/L1 for the shortest time is left open by [B2013, section 2.2] (``best_ratios``).
Near a corner the axes move almost linearly with tip and tool axis. So in the space of the axes
the corner is the same B-spline, with legs along the slopes q_s of both lines. Each axis is divided
by its jerk limit. Three sizes describe the shape: max_i |q_s,i| / J_i before the corner, after the
corner, and of the difference.

If the slopes differ little, the speed hardly changes and the best ratio has the least q_sss. This
ratio is about 1.5, where the curvature is a triangle. If they differ much, the tool brakes for the
corner anyway, and an early turn is better: about 2. On the side where the axes move less per
metre, the tip is faster and needs a longer leg. The constants are fitted to planned machining
times of random corners; see ``docs/how_it_works/corner_rounding.md``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, cross, norm
from cnc_interp.core.tables import Table, column
from cnc_interp.machine_model.machine_traits import AxisRates
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.corners.connection import Curves, connect, poses
from cnc_interp.smoothing.corners.orientation_bounds import orientation_bounds
from cnc_interp.smoothing.orientation import turned_by

LEAST_RATIO = 1.5  #: Smallest ratio L2/L1 if the lines are too short for the tolerance.
LEAST_TOP_RATIO = 1.4  #: The same for the top polygon with ``tolerance``.
#: L2/L1 of literal corners; number of times that only the top shrinks, before both curves do.
PAPER_RATIO, TOP_TURNS = 1.4, 4
LARGEST_TURN = 0.7  #: Largest turn of the tool axis on each side of one corner [rad].
#: A corner whose deviation over tolerance is below this value is accepted [-].
USED_UP = 1.0 + 1e-9


class Corners(Table):
    #: Programmed corner points [m] and tool axes [-].
    tip: FloatArray = column(3)
    axis: FloatArray = column(3)
    #: Unit vectors from the corner along the lines before and after it [-].
    legs: FloatArray = column(2, 3)
    #: Rotation vector per metre of path on the lines before and after [rad/m].
    rates: FloatArray = column(2, 3)
    tolerances: FloatArray = column(2)  #: Contour and orientation tolerance [m].
    #: Motion of the extra axes per metre of path on the lines before and after [-].
    extra_rates: FloatArray = column(2, 'k', default=0.0)
    #: Whether the tool axis may pass the pole within the tolerance.
    near_pole: BoolArray = column(default=False)

    def axis_at(self, side: int, x: FloatArray) -> FloatArray:
        """Return the programmed tool axis near corners."""
        return turned_by(self.axis, self.rates[:, side], x if side else -x)


@dataclass(frozen=True)
class Style:
    """The construction of corners."""

    height: float  #: Flank height h [m].
    in_step: bool  #: Whether the top polygon is divided like the bottom one (module docstring).
    method: str  #: How the orientation is connected (``connection.py``).
    septic: bool  #: Whether the connection E is septic instead of quintic.
    #: Whether the corners are those of the paper, word for word (module docstring).
    literal: bool = False

    @staticmethod
    def of(settings: Settings) -> Style:
        """Return the construction of corners that the settings select."""
        literal, method = settings.corner == 'paper', settings.parametrization
        if method == 'auto':
            method = 'paper' if literal else 'exact'
        in_step = settings.top == 'in_step' and not literal
        return Style(settings.flank_height, in_step, method, settings.septic, literal)

    def empty_curves(self, count: int) -> Curves:
        spans = {'paper': 7, 'linear': 0, 'exact': 0 if self.in_step else 1}[self.method]
        return Curves.empty(count, 8 if self.septic else 6, spans)


def initial_lengths(
    corners: Corners, lengths: FloatArray, ratios: FloatArray, literal: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Compute L1 and L2 from the contour tolerance and the available lengths [B2013, Eq. 3]."""
    turn = norm(corners.rates) * lengths
    available = lengths * np.minimum(1.0, LARGEST_TURN / np.maximum(turn, 1e-300))
    least = np.full(len(available), LEAST_RATIO)
    if literal:
        available, least = np.minimum(available, available[:, ::-1]), ratios[:, 0]
    inner = available.min(axis=1) / least
    bend = norm(corners.legs[:, 0] + corners.legs[:, 1])
    # an extra axis is a fourth coordinate: its middle deviates by L1 |w_2 - w_1| / 4 likewise
    drift = np.abs(corners.extra_rates[:, 1] - corners.extra_rates[:, 0])
    bend = np.maximum(bend, drift.max(axis=1, initial=0.0))
    allowed = 4.0 * corners.tolerances[:, 0]
    bound = bend * inner > allowed
    inner = np.where(bound, allowed / np.where(bound, bend, 1.0), inner)  # Eq. 3 and A.3
    return inner, np.minimum(ratios * inner[:, None], available)


def build(
    corners: Corners, inner: FloatArray, outer: FloatArray, reach: FloatArray, style: Style
) -> Curves:
    curves = style.empty_curves(len(inner))
    bottom, top = curves.bottom, curves.top
    axes = np.stack([corners.axis_at(side, outer[:, side]) for side in (0, 1)], axis=1)
    bottom[:, 2] = corners.tip
    top[:, 2] = corners.tip + style.height * corners.axis
    for side in (0, 1):
        leg = corners.legs[:, side]
        bottom[:, 4 * side] = corners.tip + outer[:, side, None] * leg
        bottom[:, 1 + 2 * side] = corners.tip + inner[:, None] * leg
        top[:, 4 * side] = bottom[:, 4 * side] + style.height * axes[:, side]
    shares = inner[:, None] / outer if style.in_step else _top_shares(top, reach)
    for side in (0, 1):
        leg = top[:, 4 * side] - top[:, 2]
        top[:, 1 + 2 * side] = top[:, 2] + shares[:, side, None] * leg
    if style.method == 'exact':
        connect(curves, style.height, axes, corners.rates)
    elif style.method == 'paper':
        from cnc_interp.smoothing.corners.paper_parametrization import spans

        curves.parametrization[:] = spans(curves, axes, corners.rates)
    return curves


def _top_shares(top: FloatArray, reach: FloatArray) -> FloatArray:
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
    """Build corners and shrink them until both tolerances hold."""
    inner, outer = inner.copy(), outer.copy()
    reach = corners.tolerances[:, 1].copy()
    curves, deviation = style.empty_curves(len(inner)), np.zeros((len(inner), 2))
    rows = np.arange(len(inner))
    for turn in range(30):
        some = corners[rows]
        built = build(some, inner[rows], outer[rows], reach[rows], style)
        curves.put(rows, built)
        deviation[rows] = _deviations(some, outer[rows], built, style)
        excess = (deviation[rows] / some.tolerances).max(axis=1)
        too_large = excess > USED_UP
        rows = rows[too_large]
        if not len(rows):
            break
        if style.literal and turn < TOP_TURNS:
            reach[rows] *= np.maximum(0.9999 / excess[too_large], 0.05)
            continue
        if style.literal and turn == TOP_TURNS:  # a sharper top does not help: begin again
            reach[rows] = corners.tolerances[rows, 1]
        # If only the turn of the axis is too large, L1 must shrink far before L2 follows.
        shrink = np.clip(0.998 / excess[too_large], 0.05, 0.995 if turn < 6 else 0.9)
        inner[rows] *= shrink
        reach[rows] *= shrink
        if ratios is not None:
            outer[rows] = np.minimum(outer[rows], ratios[rows] * inner[rows, None])
    return inner, outer, curves, deviation


def _deviations(corners: Corners, outer: FloatArray, curves: Curves, style: Style) -> FloatArray:
    """Return contour deviation and bound of the orientation deviation, shape (n, 2) [m].

    The contour deviation is the distance of the middle from the programmed corner (Eq. 3). It is
    the largest deviation in both directions. The orientation deviation is measured at flank
    height. This deviation is the largest of three values: the distance of the middle on top, the
    distance of any top point from the programmed top curve, and the turn of the axis from the
    programmed one. The last one does not count on literal corners, unless they are near the pole.
    """
    point, tool = poses(curves, 0.5)
    contour = norm(point - corners.tip)
    missed = norm(point + style.height * tool - curves.top[:, 2])
    both = corners.near_pole | (not style.literal)
    bounds = orientation_bounds(
        curves, corners.legs, corners.rates, outer, style.height, missed, both
    )
    return np.stack([contour, bounds], axis=1)


#: Ratio for equal slopes: offset, factor of the relative change, smallest and largest value.
OFFSET, SLOPE, LEAST, MOST = 1.35, 0.65, 1.6, 2.0
#: Growth with the logarithm of the ratio of both slopes, and the largest ratio in any case.
GROWTH, LARGEST = 0.5, 4.0


def ratios_at(corners: Corners, height: float, axis_rates: AxisRates | None) -> FloatArray:
    """Return L2/L1 on both sides of corners [B2013, 2.2], for axes or for tip and top point."""
    steps = -corners.legs[:, 0], corners.legs[:, 1]
    swings = [height * cross(corners.rates[:, side], corners.axis) for side in (0, 1)]
    found = best_ratios(
        *(
            np.maximum(norm(tip), norm(top))
            for tip, top in (
                (steps[0], swings[0]),
                (steps[1], swings[1]),
                (steps[1] - steps[0], swings[1] - swings[0]),
            )
        )
    )
    if axis_rates is None:
        return found
    before, after = (
        axis_rates(corners.tip, corners.axis, steps[side], corners.rates[:, side])
        for side in (0, 1)
    )
    own = best_ratios(*(np.abs(slope).max(axis=1) for slope in (before, after, after - before)))
    return np.where(np.isfinite(own), own, found)


def best_ratios(before: FloatArray, after: FloatArray, change: FloatArray) -> FloatArray:
    """Return L2/L1 on both sides of corners from the three sizes."""
    steepest = np.maximum(before, after)
    equal = np.clip(OFFSET + SLOPE * change / steepest, LEAST, MOST)
    sizes = np.maximum(np.stack([before, after], axis=1), 1e-9 * steepest[:, None])
    unequal = GROWTH * np.log(steepest[:, None] / sizes)
    return np.asarray(np.minimum(equal[:, None] + unequal, LARGEST))
