"""
Lines and corners whose rotary axes are coordinates of the path.

A row whose rotary axes run linearly is a line in coordinates c: X Y Z of the axes (AXES_LINEAR) or
of the tip (ROTARY_LINEAR), both rotary axes, and the extra axes. Its length counts the rotary axes
at flank height, ``|c|^2 = x^2 + y^2 + z^2 + (h a)^2 + (h b)^2 + w^2``. A corner between two such
lines is the cubic B-spline of [B2013, section 2.2] in all coordinates at once. There is no tool
axis to be solved back, so there is no singular point, and every axis is C2.

Bound of the deviation. With unit vectors v and w from the corner along both lines, the curve is
``Q + a v + b w`` with ``a, b >= 0``. The programmed point ``Q + (a - b) v`` (``Q + (b - a) w``
where b > a) differs from it by ``min(a, b) (v + w)``. This is at most ``L1 / 4 (v + w)``, reached
in the middle (Eq. 3 in any number of coordinates). A point on the tool moves in W by at most
``|dx| + |dw| + r_1 |da| + r_2 |db|`` with the largest distances r_i from the rotary axes on the
corner. Each r_i changes at most as fast as the point moves relative to its axis. So the bounds
hold for every point of the curve, for tip, top point and tool axis at one programmed place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.program.blocks import AXES_LINEAR, Blocks
from cnc_interp.smoothing.axis_geometry import AxisGeometry
from cnc_interp.smoothing.corners.corner import LARGEST_TURN, LEAST_RATIO
from cnc_interp.smoothing.corners.ratio import best_ratios
from cnc_interp.smoothing.orientation import norm

#: Places of X Y Z (or the tip), of the rotary axes and of the extra axes among the coordinates.
POINT, TURN, EXTRA = slice(0, 3), slice(3, 5), slice(5, None)
#: Rounds in which the length of a corner and the bound that depends on it are found.
_ROUNDS = 4


@dataclass(frozen=True)
class AxisLegs:
    """
    The blocks between n + 1 vertices as lines in coordinates.

    Parameters
    ----------
    linear, in_axes : ndarray of bool, shape (n,)
        Whether the rotary axes run linearly, and whether X Y Z do so, too.
    start, step : ndarray, shape (n, 5 + k)
        Coordinates at the start of linear blocks, and what they move by [m, rad].
    length : ndarray, shape (n,)
        Length of linear blocks [m].

    """

    linear: BoolArray
    in_axes: BoolArray
    start: FloatArray
    step: FloatArray
    length: FloatArray

    @staticmethod
    def of(blocks: Blocks, machine: AxisGeometry, height: float) -> AxisLegs:
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


def positions(machine: AxisGeometry, coordinates: FloatArray) -> FloatArray:
    """Return X Y Z for tips, rotary axes and extra axes, shape (n, 5 + k), as (n, 3) [m]."""
    stands = machine.linear(coordinates[:, POINT], coordinates[:, TURN]).reshape(-1, 3)
    return np.asarray(stands - coordinates[:, EXTRA] @ machine.extra_direction)


def size_of(step: FloatArray, height: float) -> FloatArray:
    """Return the lengths of steps in coordinates, shape (..., 5 + k), as (...) [m]."""
    squares = step**2
    turned = height**2 * squares[..., TURN].sum(axis=-1)
    return np.asarray(
        np.sqrt(squares[..., POINT].sum(axis=-1) + turned + squares[..., EXTRA].sum(axis=-1))
    )


@dataclass(frozen=True)
class AxisCorners:
    """
    Corners between lines in coordinates, at n vertices.

    Parameters
    ----------
    row : ndarray of int, shape (n,)
        Vertices.
    joined : ndarray of bool, shape (n,)
        Whether both lines can be expressed in the same coordinates. Else the tool must rest.
    in_axes : ndarray of bool, shape (n,)
        Whether the coordinates are machine axes.
    point : ndarray, shape (n, 5 + k)
        Coordinates of the corners [m, rad].
    legs : ndarray, shape (n, 2, 5 + k)
        What they move by per metre from the corner along the lines before and after it.
    tolerances : ndarray, shape (n, 2)
        Contour and orientation tolerance [m].
    levers : ndarray, shape (n, 2, 2)
        Distance of the tip and of the top point from both rotary axes [m]; 0 with tips.
    height : float
        Flank height [m].

    """

    row: IntArray
    joined: BoolArray
    in_axes: BoolArray
    point: FloatArray
    legs: FloatArray
    tolerances: FloatArray
    levers: FloatArray
    height: float

    @staticmethod
    def at(
        rows: IntArray,
        blocks: Blocks,
        axes: AxisLegs,
        still: BoolArray,
        machine: AxisGeometry,
        height: float,
    ) -> AxisCorners:
        """
        Collect the corners at some vertices with a linear block on at least one side.

        Parameters
        ----------
        rows : ndarray of int, shape (n,)
            Inner vertices.
        blocks : Blocks
            All vertices.
        axes : AxisLegs
            Lines between them.
        still : ndarray of bool, shape (number of blocks,)
            Blocks of poses in which the tip moves alone. They are lines in any coordinates.
        machine : AxisGeometry
            The machine.
        height : float
            Flank height [m].

        """
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
        stands = point[:, POINT] + point[:, EXTRA] @ machine.extra_direction
        for k, above in enumerate((0.0, height)):
            levers[:, k] = machine.levers(stands, point[:, TURN], above)
        return AxisCorners(rows, joined, in_axes, point, legs, tolerances, levers, height)

    def __getitem__(self, rows: IntArray | BoolArray) -> AxisCorners:
        """Return the corners at these indices."""
        return AxisCorners(
            self.row[rows], self.joined[rows], self.in_axes[rows], self.point[rows],
            self.legs[rows], self.tolerances[rows], self.levers[rows], self.height,
        )  # fmt: skip

    @property
    def cosine(self) -> FloatArray:
        """Cosines of the turn of the path at the corners, shape (n,) [-]."""
        scale = np.ones(self.point.shape[1])
        scale[TURN] = self.height
        return np.asarray(-(self.legs[:, 0] * self.legs[:, 1] * scale**2).sum(axis=1))

    @property
    def bend(self) -> FloatArray:
        """Sizes of v + w, shape (n,) [-]; 0 where the path goes straight on."""
        return size_of(self.legs.sum(axis=1), self.height)

    def gains(self, outer: FloatArray) -> FloatArray:
        """
        Bound the deviation of tip and orientation per metre of min(a, b), shape (n, 2) [-].

        ``outer`` has L2 on both sides, shape (n, 2) [m]. The orientation counts at flank height,
        as the distance of the top point and as the turn of the tool axis.
        """
        bend = np.abs(self.legs.sum(axis=1))
        reach = outer[:, :, None] * np.abs(self.legs)
        way = (norm(reach[..., POINT]) + reach[..., EXTRA].sum(axis=-1)).max(axis=1)
        turn = reach[..., TURN].max(axis=1)
        # r_1 <= R_1 + way + r_2 turn_2 and r_2 <= R_2 + way + r_1 turn_1, solved for both
        own = self.levers + way[:, None, None]
        other = turn[:, None, ::-1] * own[..., ::-1]
        levers = (own + other) / (1.0 - turn.prod(axis=1))[:, None, None]
        levers[~self.in_axes] = np.array([[0.0], [self.height]])
        straight = norm(bend[:, POINT]) + bend[:, EXTRA].sum(axis=1)
        moved = straight[:, None] + (levers * bend[:, None, TURN]).sum(axis=-1)
        turned = self.height * bend[:, TURN].sum(axis=1)
        return np.stack([moved[:, 0], np.maximum(moved[:, 1], turned)], axis=1)

    def inner(self, outer: FloatArray) -> FloatArray:
        """Return the largest L1 within both tolerances for given L2 [m], shape (n,)."""
        allowed = (4.0 * self.tolerances / np.maximum(self.gains(outer), 1e-300)).min(axis=1)
        return np.asarray(np.minimum(allowed, outer.min(axis=1) / LEAST_RATIO))

    def sizes(
        self, lengths: FloatArray, ratio: float | None, jerk: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """
        Choose L1, shape (n,), and L2, shape (n, 2) [m].

        Parameters
        ----------
        lengths : ndarray, shape (n, 2)
            Length of each line that the corner may use [m].
        ratio : float, optional
            L2/L1; without it, the best one for the axes.
        jerk : ndarray, shape (5 + k,)
            Jerk limits of the axes, which compare their slopes.

        """
        if ratio is None:
            before, after = -self.legs[:, 0] / jerk, self.legs[:, 1] / jerk
            slopes = (np.abs(slope).max(axis=1) for slope in (before, after, after - before))
            ratios = best_ratios(*slopes)
        else:
            ratios = np.full((len(self.row), 2), ratio)
        turn = np.abs(self.legs[..., TURN]).max(axis=-1)
        outer = np.minimum(lengths, LARGEST_TURN / np.maximum(turn, 1e-300))
        for _ in range(_ROUNDS):
            outer = np.minimum(outer, ratios * self.inner(outer)[:, None])
        return self.inner(outer), outer

    def curves(self, outer: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Build the corners for given L2, shape (n, 2) [m].

        Returns
        -------
        points : ndarray, shape (n, 5, 5 + k)
            Control points in coordinates [m, rad].
        deviation : ndarray, shape (n, 2)
            Bounds of contour and orientation deviation [m].

        """
        inner = self.inner(outer)
        ways = [outer[:, 0], inner, np.zeros(len(inner)), inner, outer[:, 1]]
        sides = [0, 0, 0, 1, 1]
        points = [
            self.point + way[:, None] * self.legs[:, side]
            for way, side in zip(ways, sides, strict=True)
        ]
        deviation = 0.25 * inner[:, None] * self.gains(outer)
        return np.stack(points, axis=1), deviation
