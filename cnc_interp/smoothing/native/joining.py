"""The general connection of two 5-axis path portions [B2013, section 2.6 and Fig. 4].

Two portions meet at one point with one tool axis. By the arc length s of the tip, the derivatives
p_s, p_ss, o_s, o_ss at the start of the second may differ from those at the end of the first. Each
jump would reduce the feed. Here a polynomial span is changed until it begins with the derivatives
of its neighbour:

* The two inner Bezier points of the tip next to the join move until p_s and p_ss agree.
* The tool axis gets the connection E of ``connection.py``: a polynomial that is added to the top
  curve and is zero at both ends. Let D = top - bottom be the tool vector and rho its length. Then
  E' and E'' (and E''' with the septic) are the differences of (rho o) and D in these derivatives.

The length rho need not be continuous, so it follows D. Everything is linear in the jumps. The
deviation from the programmed curves is therefore bounded by coefficients of the polynomials.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import FloatArray, cross, dot, norm
from cnc_interp.core.bspline import divided, least_length, start_derivatives, weighted_largest
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.connection import hermite, lacking
from cnc_interp.smoothing.dense.path_rows import STANDSTILL
from cnc_interp.smoothing.orientation import rotations_between

#: Jets with smaller differences are equal: first derivatives [rad], second derivatives [1/m].
SAME_DIRECTION, SAME_BEND = 1e-9, 1e-6
SHARPEST = 0.1  #: The tool rests at a join if the directions differ by more than this angle [rad].
MOST_HALVINGS = 12  #: Largest number of times that a span is halved for a join.


@dataclass(frozen=True)
class Jets:
    """Tip and tool axis at n points, with their derivatives by the arc length of the tip."""

    tip: FloatArray  #: (4, n, 3): p, p_s, p_ss, p_sss [m, -, 1/m, 1/m2].
    axis: FloatArray  #: (4, n, 3): o, o_s, o_ss, o_sss [-, 1/m, 1/m2, 1/m3].

    def backwards(self) -> Jets:
        sign = np.array([1.0, -1.0, 1.0, -1.0])[:, None, None]
        return Jets(sign * self.tip, sign * self.axis)

    def jumps(self, other: Jets, height: float) -> FloatArray:
        found = []
        for order in (1, 2):
            tip = norm(self.tip[order] - other.tip[order])
            found.append(np.maximum(tip, height * norm(self.axis[order] - other.axis[order])))
        return np.stack(found)


def line_jets(tip: FloatArray, direction: FloatArray, axis: FloatArray, rate: FloatArray) -> Jets:
    """Jets of n lines: o_s = w k x o, o_ss = -w^2 o, o_sss = -w^2 o_s [B2013, Eq. 4]."""
    turn, square = cross(rate, axis), dot(rate, rate)[:, None]
    rest = np.zeros_like(tip)
    return Jets(
        np.stack([tip, direction, rest, rest]),
        np.stack([axis, turn, -square * axis, -square * turn]),
    )


def span_jets(bottom: FloatArray, top: FloatArray, connection: FloatArray) -> Jets:
    """Return the jets at the start of polynomial spans [B2013, Eq. 5, B.3-B.5]."""
    p = start_derivatives(bottom)
    d = start_derivatives(top) - start_derivatives(bottom) + start_derivatives(connection)
    s1, s2, s3 = arc_length(p)
    # Unit vector o of D: rho' = D' . o, then order by order.
    d0 = top[:, 0] - bottom[:, 0] + connection[:, 0]
    rho = norm(d0)[:, None]
    o = d0 / rho
    rho1 = dot(d[0], o)[:, None]
    o1 = (d[0] - rho1 * o) / rho
    rho2 = dot(d[1], o)[:, None] + rho * dot(o1, o1)[:, None]
    o2 = (d[1] - rho2 * o - 2.0 * rho1 * o1) / rho
    rho3 = (dot(d[2], o) + dot(3.0 * rho * o1 - 3.0 * rho1 * o, o2))[:, None]
    o3 = (d[2] - rho3 * o - 3.0 * rho2 * o1 - 3.0 * rho1 * o2) / rho
    return Jets(
        np.stack([bottom[:, 0], *_by_arc_length(p, s1, s2, s3)]),
        np.stack([o, *_by_arc_length(np.stack([o1, o2, o3]), s1, s2, s3)]),
    )


def arc_length(p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    s1 = norm(p[0])[:, None]
    s2 = dot(p[0], p[1])[:, None] / s1
    s3 = (dot(p[1], p[1]) + dot(p[0], p[2]))[:, None] / s1 - s2**2 / s1
    return s1, s2, s3


def _by_arc_length(
    x: FloatArray, s1: FloatArray, s2: FloatArray, s3: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    x_s = x[0] / s1
    x_ss = (x[1] - x_s * s2) / s1**2
    return x_s, x_ss, (x[2] - 3.0 * x_ss * s1 * s2 - x_s * s3) / s1**3


@dataclass(frozen=True)
class Connected:
    bottom: FloatArray  #: (n, 6, 3): Bezier points of the tip [m].
    #: (n, points, 3): Bezier points of the connection E, which is added to the top curve [m].
    connection: FloatArray
    #: (n, 2): Bounds of the distance of tip and point at flank height from the given spans [m].
    deviation: FloatArray


def connected(
    bottom: FloatArray,
    top: FloatArray,
    first: Jets | None,
    last: Jets | None,
    height: float,
    points: int = 6,
) -> Connected:
    n = len(bottom)
    moved = bottom.copy()
    free = np.zeros((3, n, 3))
    lacking = [free, free]
    for side, jets in enumerate((first, None if last is None else last.backwards())):
        if jets is not None:
            inward = (moved, top) if side == 0 else (moved[:, ::-1], top[:, ::-1])
            _take_up_tip(inward[0], jets)
    for side, jets in enumerate((first, None if last is None else last.backwards())):
        if jets is not None:
            inward = (moved, top) if side == 0 else (moved[:, ::-1], top[:, ::-1])
            lacking[side] = _lacking(*inward, jets)
    # A moved tip changes D also far from a join. E need not correct that, only the join.
    connection = hermite(lacking[0], lacking[1], points)
    tip = weighted_largest(moved - bottom)
    tool = tip + weighted_largest(connection)
    ratio = tool / np.maximum(least_length(top - bottom), 1e-300)
    chord = np.where(ratio < 1.0, 2.0 * np.sin(0.5 * np.arcsin(np.minimum(ratio, 1.0))), np.inf)
    return Connected(moved, connection, np.stack([tip, tip + height * chord], axis=1))


def _take_up_tip(bottom: FloatArray, jets: Jets) -> None:
    """Move the second and third Bezier point so that p_s and p_ss are those of the jets."""
    p = start_derivatives(bottom)
    tangent = jets.tip[1]
    speed = dot(p[0], tangent)[:, None]
    second = speed**2 * jets.tip[2] + dot(p[1], tangent)[:, None] * tangent
    bottom[:, 1] = bottom[:, 0] + speed * tangent / 5.0
    bottom[:, 2] = 2.0 * bottom[:, 1] - bottom[:, 0] + second / 20.0


def _lacking(bottom: FloatArray, top: FloatArray, jets: Jets) -> FloatArray:
    """Return (rho o - D) in the first three derivatives by u, shape (3, n, 3) [m]."""
    p = start_derivatives(bottom)
    d1, d2, d3 = start_derivatives(top) - p
    rho = norm(top[:, 0] - bottom[:, 0])[:, None]
    return lacking((d1, d2, d3), jets.axis[0], by_parameter(jets, p), rho)


def by_parameter(jets: Jets, p: FloatArray) -> FloatArray:
    s1, s2, s3 = arc_length(p)
    _, o_s, o_ss, o_sss = jets.axis
    return np.stack(
        [o_s * s1, o_ss * s1**2 + o_s * s2, o_sss * s1**3 + 3.0 * o_ss * s1 * s2 + o_s * s3]
    )


def line_between(start: Blocks, end: Blocks, at_end: bool) -> Jets | None:
    """Return the jets at an end of a line of poses; None if the tip rests."""
    if end.by_rotary[0]:
        return None
    step = end.tip - start.tip
    length = norm(step)[:, None]
    if length[0, 0] < STANDSTILL:
        return None
    rate = rotations_between(start.axis, end.axis) / length
    row = end if at_end else start
    return line_jets(row.tip, step / length, row.axis, rate)


@dataclass(frozen=True)
class Piece:
    #: (1, 6, 3): Bezier points of tip and second point [m].
    bottom: FloatArray
    top: FloatArray
    connection: FloatArray  #: (1, m, 3): Bezier points of the connection E [m].
    deviation: FloatArray  #: (2,): Bounds of contour and orientation deviation [m].
    row: int  #: Number of the span in the curve.

    def jets(self, at_end: bool) -> Jets:
        if not at_end:
            return span_jets(self.bottom, self.top, self.connection)
        inward = (self.bottom[:, ::-1], self.top[:, ::-1], self.connection[:, ::-1])
        return span_jets(*inward).backwards()

    def halves(self) -> tuple[Piece, Piece]:
        first, last = zip(divided(self.bottom), divided(self.top), strict=True)
        return (
            replace(self, bottom=first[0], top=first[1]),
            replace(self, bottom=last[0], top=last[1]),
        )


def absorbed(
    piece: Piece,
    first: Jets | None,
    last: Jets | None,
    tolerance: FloatArray,
    height: float,
    halvings: int = MOST_HALVINGS,
) -> list[Piece] | None:
    """Give a span its neighbours' derivatives, halving it if necessary; None beyond tolerance."""
    if first is None and last is None:
        return [piece]
    points = piece.connection.shape[1]
    made = connected(piece.bottom, piece.top, first, last, height, points)
    if (made.deviation[0] <= tolerance).all():
        return [
            replace(
                piece, bottom=made.bottom, connection=made.connection, deviation=made.deviation[0]
            )
        ]
    if halvings == 0:
        return None
    left, right = piece.halves()
    parts = [
        absorbed(left, first, None, tolerance, height, halvings - 1),
        absorbed(right, None, last, tolerance, height, halvings - 1),
    ]
    return None if None in parts else [piece for part in parts for piece in part or ()]


def same_jets(a: Jets, b: Jets, height: float) -> bool:
    angle, bend = (float(x[0]) for x in a.jumps(b, height))
    return angle <= SAME_DIRECTION and bend <= SAME_BEND


def joins_gently(a: Jets, b: Jets) -> bool:
    return float(norm(a.tip[1] - b.tip[1])[0]) <= SHARPEST
