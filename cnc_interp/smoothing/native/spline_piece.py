"""One polynomial piece of a native spline, and how it joins its neighbours."""

from __future__ import annotations

from dataclasses import dataclass, replace

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bezier import divided
from cnc_interp.smoothing.native.joining import Jets, connected, span_jets
from cnc_interp.smoothing.orientation import norm

#: Jets with smaller differences are equal: first derivatives [rad], second derivatives [1/m].
SAME_DIRECTION, SAME_BEND = 1e-9, 1e-6
#: Above this angle between the directions at a join, the tool rests [rad].
SHARPEST = 0.1
#: Largest number of times that a span is halved for a join.
MOST_HALVINGS = 12


@dataclass(frozen=True)
class Piece:
    """One polynomial piece of the curve."""

    #: (1, 6, 3): Bezier points of tip and second point [m].
    bottom: FloatArray
    top: FloatArray
    connection: FloatArray  #: (1, m, 3): Bezier points of the connection E [m].
    deviation: FloatArray  #: (2,): Bounds of contour and orientation deviation [m].
    row: int  #: Number of the span in the curve.

    def jets(self, at_end: bool) -> Jets:
        """Return the jets at the start or the end of the piece, in the direction of motion."""
        if not at_end:
            return span_jets(self.bottom, self.top, self.connection)
        inward = (self.bottom[:, ::-1], self.top[:, ::-1], self.connection[:, ::-1])
        return span_jets(*inward).backwards()

    def halves(self) -> tuple[Piece, Piece]:
        """Divide a piece without a connection in the middle."""
        first, last = zip(divided(self.bottom), divided(self.top), strict=True)
        return (
            replace(self, bottom=first[0], top=first[1]),
            replace(self, bottom=last[0], top=last[1]),
        )


def absorbed(
    piece: Piece, first: Jets | None, last: Jets | None, tolerance: FloatArray, height: float,
    halvings: int = MOST_HALVINGS,
) -> list[Piece] | None:  # fmt: skip
    """
    Change a piece so that it takes the derivatives of its neighbours within tolerances.

    Returns the changed piece, or the shorter ones it was divided into. Returns None if the
    tolerances, shape (2,) [m], cannot be kept.
    """
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
    """Tell whether both sides of a join have equal derivatives."""
    angle, bend = (float(x[0]) for x in a.jumps(b, height))
    return angle <= SAME_DIRECTION and bend <= SAME_BEND


def joins_gently(a: Jets, b: Jets) -> bool:
    """Tell whether the path turns little enough at a join to pass it without rest."""
    return float(norm(a.tip[1] - b.tip[1])[0]) <= SHARPEST
