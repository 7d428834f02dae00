"""Lines and corners whose rotary axes are coordinates of the path.

A row whose rotary axes run linearly is a line in coordinates c: X Y Z of the axes (AXES_LINEAR) or
of the tip (ROTARY_LINEAR), both rotary axes, and the extra axes. In the length of such a line the
rotary axes count at flank height, ``|c|^2 = x^2 + y^2 + z^2 + (h a)^2 + (h b)^2 + w^2``. A corner
between two such lines is the cubic B-spline of [B2013, section 2.2] in all coordinates at once. No
tool axis must be converted to axis positions, so no point is singular, and every axis is C2.

Bound of the deviation. With unit vectors v and w from the corner along both lines, the curve is
``Q + a v + b w``. Here a falls from L2 to 0 and b rises from 0 to L2, because a cubic B-spline
rises and falls with its control values. Three programmed points are compared with this curve. From
``Q + a v`` it differs by ``b w``, from ``Q + b w`` by ``a v``, and from the point at ``a - b``
along v (at ``b - a`` along w) by ``min(a, b) (v + w)``, at most ``L1 / 4 (v + w)`` (Eq. 3 in any
number of coordinates). A point on the tool moves in W by at most
``|dx| + |dw| + r_1 |da| + r_2 |db|`` with the largest distances r_i from the rotary axes on the
corner. Each r_i changes at most as fast as the point moves relative to its axis. So the bounds
hold for every point of the curve, with tip, top point and tool axis compared with the same point
of the program. The curve also passes the vertex itself, and with it every rotary word, within the
tolerances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, norm
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.program.blocks import AXES_LINEAR, Blocks
from cnc_interp.smoothing.corners import corner_curve

#: Indices of X Y Z (or the tip), of the rotary axes and of the extra axes in the coordinates.
POINT, TURN, EXTRA = slice(0, 3), slice(3, 5), slice(5, None)
_BISECTIONS = 45  #: Bisections for the middle of a corner.
_PLACES = np.linspace(0.1, 0.9, 33)  #: Parameters at which the curve may pass the vertex.


@dataclass(frozen=True)
class AxisLegs:
    """The blocks between n + 1 vertices as lines in coordinates."""

    #: (n,): Whether the rotary axes run linearly, and whether X Y Z do so, too.
    linear: BoolArray
    in_axes: BoolArray
    #: (n, 5 + k): Coordinates at the start of linear blocks, and their change along them [m, rad].
    start: FloatArray
    step: FloatArray
    length: FloatArray  #: (n,): Length of linear blocks [m].

    @staticmethod
    def of(blocks: Blocks, machine: FiveAxis, height: float) -> AxisLegs:
        """Compute the lines between the rows of blocks; the flank height is in metres."""
        kind, extra = blocks.interpolation[1:], blocks.extra
        linear, in_axes = blocks.by_rotary[1:], kind == AXES_LINEAR
        ends = []
        for rows, rotary in (
            (slice(None, -1), blocks.rotary_from[1:]),
            (slice(1, None), blocks.rotary[1:]),
        ):
            found = np.zeros((len(linear), 5 + extra.shape[1]))
            found[:, POINT], found[:, EXTRA] = blocks.tip[rows], extra[rows]
            found[linear, TURN] = rotary[linear]
            found[in_axes, POINT] = positions(machine, found[in_axes])
            ends.append(found)
        step = ends[1] - ends[0]
        return AxisLegs(linear, in_axes, ends[0], step, size_of(step, height))


def positions(machine: FiveAxis, coordinates: FloatArray) -> FloatArray:
    """Return X Y Z for tips, rotary axes and extra axes, shape (n, 5 + k), as (n, 3) [m]."""
    stands = machine.linear(coordinates[:, POINT], coordinates[:, TURN]).reshape(-1, 3)
    return np.asarray(stands - coordinates[:, EXTRA] @ machine.machine.extra_direction)


def size_of(step: FloatArray, height: float) -> FloatArray:
    """Return the lengths of steps in coordinates, shape (..., 5 + k), as (...) [m]."""
    squares = step**2
    turned = height**2 * squares[..., TURN].sum(axis=-1)
    return np.asarray(
        np.sqrt(squares[..., POINT].sum(axis=-1) + turned + squares[..., EXTRA].sum(axis=-1))
    )


@dataclass(frozen=True)
class AxisCorners:
    """Corners between lines in coordinates, at n vertices."""

    row: IntArray  #: (n,): Rows of the vertices.
    #: (n,): Whether both lines can be expressed in the same coordinates. If not, the tool must
    #: rest.
    joined: BoolArray
    in_axes: BoolArray  #: (n,): Whether the coordinates are machine axes.
    point: FloatArray  #: (n, 5 + k): Coordinates of the corners [m, rad].
    #: (n, 2, 5 + k): Change of coordinates per metre from the corner along the lines on both
    #: sides.
    legs: FloatArray
    tolerances: FloatArray  #: (n, 2): Contour and orientation tolerance [m].
    #: (n, 2, 2): Distance of tip and top point from both rotary axes [m]; 0 if X Y Z are those of
    #: the tip.
    levers: FloatArray
    height: float  #: Flank height [m].

    @staticmethod
    def at(
        rows: IntArray,
        blocks: Blocks,
        axes: AxisLegs,
        still: BoolArray,
        machine: FiveAxis,
        height: float,
    ) -> AxisCorners:
        """Collect corners beside linear blocks; ``still``: blocks where only the tip moves."""
        before, after = rows - 1, rows
        first, second = axes.linear[before], axes.linear[after]
        in_axes = (first & axes.in_axes[before]) | (second & axes.in_axes[after])
        joined = (first | still[before]) & (second | still[after])
        joined &= ~(first & second) | (axes.in_axes[before] == axes.in_axes[after])
        ends = axes.start[before] + axes.step[before]
        point = np.where(first[:, None], ends, axes.start[after])
        legs = np.zeros((len(rows), 2, point.shape[1]))
        for side, block, linear, sign in ((0, before, first, -1.0), (1, after, second, 1.0)):
            step = sign * axes.step[block]
            step[~linear] = 0.0
            step[~linear, POINT] = (blocks.tip[rows + (2 * side - 1)] - blocks.tip[rows])[~linear]
            beside = in_axes & ~linear
            if beside.any():  # a rotary axis that rests: X Y Z of both ends
                ends = point[beside].copy()
                far = (rows + (2 * side - 1))[beside]
                ends[:, POINT] = blocks.tip[far]
                step[beside, POINT] = positions(machine, ends) - point[beside, POINT]
            size = size_of(step, height)
            legs[:, side] = step / np.where(size > 0.0, size, 1.0)[:, None]
        tolerances = np.stack(
            [
                np.minimum(column[rows], column[rows + 1])
                for column in (blocks.contour_tolerance, blocks.orientation_tolerance)
            ],
            axis=1,
        )
        levers = np.zeros((len(rows), 2, 2))
        stands = point[:, POINT] + point[:, EXTRA] @ machine.machine.extra_direction
        for k, above in enumerate((0.0, height)):
            levers[:, k] = machine.levers(stands, point[:, TURN], above)
        return AxisCorners(rows, joined, in_axes, point, legs, tolerances, levers, height)

    @property
    def cosine(self) -> FloatArray:
        """Cosines of the turn of the path at the corners, shape (n,) [-]."""
        scale = np.ones(self.point.shape[1])
        scale[TURN] = self.height
        return np.asarray(-(self.legs[:, 0] * self.legs[:, 1] * scale**2).sum(axis=1))

    @property
    def bend(self) -> FloatArray:
        """Sizes of v + w, shape (n,) [-]; 0 where the path continues straight."""
        return size_of(self.legs.sum(axis=1), self.height)

    def gains(self, outer: FloatArray, way: FloatArray) -> FloatArray:
        """Bound the motion of tip and orientation per step along ``way``, shape (n, 2) [-]."""
        way = np.abs(way)
        reach = outer[:, :, None] * np.abs(self.legs)
        gone = (norm(reach[..., POINT]) + reach[..., EXTRA].sum(axis=-1)).max(axis=1)
        turn = reach[..., TURN].max(axis=1)
        # r_1 <= R_1 + gone + r_2 turn_2 and r_2 <= R_2 + gone + r_1 turn_1, solved for both
        own = self.levers + gone[:, None, None]
        other = turn[:, None, ::-1] * own[..., ::-1]
        levers = (own + other) / (1.0 - turn.prod(axis=1))[:, None, None]
        levers[~self.in_axes] = np.array([[0.0], [self.height]])
        straight = norm(way[:, POINT]) + way[:, EXTRA].sum(axis=1)
        moved = straight[:, None] + (levers * way[:, None, TURN]).sum(axis=-1)
        turned = self.height * way[:, TURN].sum(axis=1)
        return np.stack([moved[:, 0], np.maximum(moved[:, 1], turned)], axis=1)

    def deviation(self, inner: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Bound both deviations of corners (n, 2) [m], and the larger use of a tolerance (n,)."""
        ways = self.legs[:, 0], self.legs[:, 1], self.legs.sum(axis=1)
        gains = [self.gains(outer, way) for way in ways]
        deviation = np.stack(
            [_largest_gap(inner, outer, *(gain[:, k] for gain in gains)) for k in (0, 1)], axis=1
        )
        uses = ((gain / self.tolerances).max(axis=1) for gain in gains)
        return deviation, _largest_gap(inner, outer, *uses)

    def fit(
        self, inner: FloatArray, outer: FloatArray, ratios: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        while True:
            deviation, use = self.deviation(inner, outer)
            wide = use > corner_curve.USED_UP
            if not wide.any():
                return inner, outer, deviation
            # With the same L2, a smaller L1 reduces the deviation at least by its square root.
            inner = np.where(wide, inner * np.clip(0.999 / use, 0.05, 0.999), inner)
            if ratios is not None:
                outer = np.minimum(outer, ratios * inner[:, None])

    def sizes(
        self, lengths: FloatArray, ratio: float | None, jerk: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Choose L1, shape (n,), and L2, shape (n, 2) [m]."""
        if ratio is None:
            before, after = -self.legs[:, 0] / jerk, self.legs[:, 1] / jerk
            slopes = (np.abs(slope).max(axis=1) for slope in (before, after, after - before))
            ratios = corner_curve.best_ratios(*slopes)
        else:
            ratios = np.full((len(self.row), 2), ratio)
        turn = np.abs(self.legs[..., TURN]).max(axis=-1)
        outer = np.minimum(lengths, corner_curve.LARGEST_TURN / np.maximum(turn, 1e-300))
        inner = outer.min(axis=1) / corner_curve.LEAST_RATIO
        outer = np.minimum(outer, ratios * inner[:, None])
        return self.fit(inner, outer, ratios)[:2]

    def curves(self, inner: FloatArray, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Build corners with L1, shape (n,), and L2, shape (n, 2) [m]; L1 may shrink."""
        inner, _, deviation = self.fit(inner, outer)
        ways = [outer[:, 0], inner, np.zeros(len(inner)), inner, outer[:, 1]]
        points = [
            self.point + way[:, None] * self.legs[:, side]
            for way, side in zip(ways, [0, 0, 0, 1, 1], strict=True)
        ]
        return np.stack(points, axis=1), deviation


def _largest_gap(
    inner: FloatArray, outer: FloatArray, before: FloatArray, after: FloatArray, both: FloatArray
) -> FloatArray:
    """Bound the distances of the curve from the program and the vertex from the curve, (n,).

    The first is at most ``max_u min(a before, b after)``, found where both are equal, because one
    falls and the other rises. The second is at most ``a before + b after`` at any parameter. Both
    are at most ``L1 / 4 both``. The gains belong to v, w and v + w.
    """
    passed = np.full(len(inner), np.inf)
    for share in _PLACES:
        u = np.full(len(inner), share)
        sum_there = _along(inner, outer[:, 0], u) * before
        sum_there += _along(inner, outer[:, 1], 1.0 - u) * after
        passed = np.minimum(passed, sum_there)
    low, high = np.zeros(len(inner)), np.ones(len(inner))
    for _ in range(_BISECTIONS):
        u = 0.5 * (low + high)
        rises = _along(inner, outer[:, 1], 1.0 - u) * after
        falls = _along(inner, outer[:, 0], u) * before
        low, high = np.where(rises < falls, u, low), np.where(rises < falls, high, u)
    crossing = _along(inner, outer[:, 1], 1.0 - high) * after
    return np.minimum(np.maximum(crossing, passed), 0.25 * inner * both)


def _along(inner: FloatArray, outer: FloatArray, u: FloatArray) -> FloatArray:
    """Return the B-spline of the control values L2, L1, 0, 0, 0 at parameters u, shape (n,)."""
    first = outer * (1.0 - 2.0 * u) ** 3 + inner * u * (6.0 - 18.0 * u + 14.0 * u**2)
    return np.asarray(np.where(u < 0.5, first, 2.0 * inner * (1.0 - u) ** 3))
