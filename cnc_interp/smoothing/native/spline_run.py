"""
One native 5-axis B-spline, control points in, smooth segments out, however they arrive.

Each span of the pair of cubic B-splines becomes a SPLINE segment, exactly. Where the curve meets
a line, or itself at a repeated knot, the two sides' jets are compared: a span takes up what the
other side ends with by the general connection of ``joining.py``, within a share of the tolerances,
in a piece at its end that is halved until the deviation is small enough. Where the path turns too
sharply for that the tool rests.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.bezier import cubic_spans, divided, elevated
from cnc_interp.core.errors import BlockError
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.corner import Style
from cnc_interp.smoothing.native.joining import Jets, connected, shortest_tool, span_jets
from cnc_interp.smoothing.orientation import norm
from cnc_interp.smoothing.segments import SPLINE, PathSegments

#: Jets that differ less go on as they are: directions [rad], second derivatives [1/m].
SAME_DIRECTION, SAME_BEND = 1e-9, 1e-6
#: The tool rests where its path turns by more than this at a join [rad].
SHARPEST = 0.1
#: Share of the tolerances that joins may use [-]; both ends of a span may use it at one place.
JOIN_SHARE = 0.45
#: The piece that takes a join up is halved at most this often.
MOST_HALVINGS = 12
#: The tip stands still where its speed falls under this share of the span's polygon [-].
STANDSTILL_SHARE = 1e-6
#: A curve begins where the block before it ended [m], [-].
SAME_POSE = 1e-9


@dataclass(frozen=True)
class Piece:
    """A polynomial piece of the curve: Bezier points (1, 6, 3), deviation (2,), run row."""

    bottom: FloatArray
    top: FloatArray
    connection: FloatArray
    deviation: FloatArray
    row: int

    def jets(self, at_end: bool) -> Jets:
        """Return the jets where the piece begins or ends, in the direction of motion."""
        if not at_end:
            return span_jets(self.bottom, self.top, self.connection)
        inward = (self.bottom[:, ::-1], self.top[:, ::-1], self.connection[:, ::-1])
        return span_jets(*inward).backwards()

    def halves(self) -> tuple[Piece, Piece]:
        """Divide an unconnected piece in the middle."""
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
    Make a piece take up the jets of its neighbours within tolerances, shape (2,) [m].

    Returns the piece, or the shorter ones that it was divided into; None where nothing fits.
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


def _same(a: Jets, b: Jets, height: float) -> bool:
    """Tell whether two sides of a join go on as they are."""
    angle, bend = (float(x[0]) for x in a.jumps(b, height))
    return angle <= SAME_DIRECTION and bend <= SAME_BEND


def _gentle(a: Jets, b: Jets) -> bool:
    """Tell whether the tip turns little enough at a join to be led through it."""
    return float(norm(a.tip[1] - b.tip[1])[0]) <= SHARPEST


class SplineRun:
    """
    One curve of a native program.

    Parameters
    ----------
    row : int
        Row of the program of its first control point.
    pose : Blocks
        One row: where the tool is when the curve begins.
    before : Jets or None
        How the path arrives there, None at rest.
    style : Style
        Flank height, and the degree of the connections.

    """

    def __init__(self, row: int, pose: Blocks, before: Jets | None, style: Style):
        self._first_row, self._pose, self._before = row, pose, before
        self._style, self._room = style, style.room(1)
        self._rows: Blocks | None = None  # control points that may still act on spans
        self._offset = 0  # run row of the first of them
        self._next = 1  # run row of the next span
        # The last span, whose end is not settled yet, and what it takes up at its beginning.
        self._held: tuple[Piece, Jets | None] | None = None
        #: Whether the path goes on into the curve without rest; None until that is known.
        self.flows: bool | None = None

    @property
    def last_row(self) -> Blocks:
        """The last control point known, as one row."""
        return self._rows_known()[-1:]

    def push(self, rows: Blocks) -> PathSegments | None:
        """
        Take further control points and return the segments that are final.

        Raises
        ------
        BlockError
            If the curve does not begin at the tool, the tip stands still in it, or its knots
            tear it.

        """
        if self._rows is None:
            self._check_begin(rows)
        known = [] if self._rows is None else [self._rows]
        self._rows = Blocks.concatenate([*known, rows])
        pieces: list[tuple[Piece, bool]] = []
        for piece in self._spans():
            self._meet(piece, pieces)
        segments = self._segments(pieces)
        self._forget()
        return segments

    def finish(self, after: Jets | None) -> PathSegments | None:
        """
        Return the rest of the curve; ``after`` is how the path goes on, None for a rest.

        Raises
        ------
        BlockError
            If the curve has fewer than four control points or is not clamped at its end.

        """
        rows = self._rows_known()
        line = int(rows.line_number[-1])
        count = self._offset + len(rows)
        if count < 4 or self._held is None:
            raise BlockError(
                f'a cubic B-spline needs at least 4 control points, the start included, not '
                f'{count}',
                line,
            )
        if rows.knot_interval[-2:].any():
            raise BlockError('the last two knot intervals of a spline must be 0', line)
        pieces: list[tuple[Piece, bool]] = []
        self._settle(after, pieces, stop=True)
        return self._segments(pieces, end=True)

    def _check_begin(self, rows: Blocks) -> None:
        line = int(rows.line_number[0])
        gap = max(
            float(np.abs(rows.tip[0] - self._pose.tip[0]).max()),
            float(np.abs(rows.axis[0] - self._pose.axis[0]).max()),
        )
        if gap > SAME_POSE:
            raise BlockError('the spline does not begin where the tool is', line)
        if rows.knot_interval[0] != 0.0 or (len(rows) > 1 and rows.knot_interval[1] == 0.0):
            raise BlockError('the knots of a spline must begin with one interval', line)

    def _spans(self) -> list[Piece]:
        """Return the spans whose control points and knots are all known."""
        rows = self._rows_known()
        count = self._offset + len(rows)
        numbers = np.arange(self._next, count - 2)
        if not len(numbers):
            return []
        self._next = count - 2
        interval = rows.knot_interval
        numbers = numbers[interval[numbers - self._offset] > 0.0]
        # Span j lies between t_(j+2) and t_(j+3); its control points are j-1 ... j+2.
        own = numbers - self._offset
        padded = np.concatenate([np.zeros(2), interval])
        step = [padded[own + 2 + shift] for shift in (-2, -1, 0, 1, 2)]
        zero = np.zeros(len(numbers))
        knots = np.stack(
            [
                -(step[1] + step[0]), -step[1], zero, step[2], step[2] + step[3],
                step[2] + step[3] + step[4],
            ], axis=1,
        )  # fmt: skip
        acting = own[:, None] + np.arange(-1, 3)
        bottom = elevated(cubic_spans(rows.tip[acting], knots), 5)
        top = elevated(cubic_spans(rows.top[acting], knots), 5)
        self._check_spans(bottom, top, rows, own)
        free = self._room.connection
        return [
            Piece(bottom[i : i + 1], top[i : i + 1], free, np.zeros(2), int(number))
            for i, number in enumerate(numbers)
        ]

    def _check_spans(
        self, bottom: FloatArray, top: FloatArray, rows: Blocks, own: IntArray
    ) -> None:
        """Refuse spans along which neither path length nor tool axis is defined."""
        steps = np.diff(bottom, axis=1)
        size = norm(steps).sum(axis=1)
        slowest = np.full(len(bottom), np.inf)
        for u in np.linspace(0.0, 1.0, 9):
            inner = steps
            while inner.shape[1] > 1:
                inner = (1.0 - u) * inner[:, :-1] + u * inner[:, 1:]
            slowest = np.minimum(slowest, norm(inner[:, 0]))
        bad = np.flatnonzero(slowest <= STANDSTILL_SHARE * size)
        if len(bad):
            raise BlockError(
                'the tool tip stands still within this spline; end the spline there and turn the '
                'tool in a G1 block',
                int(rows.line_number[own[bad[0]]]),
            )
        bad = np.flatnonzero(shortest_tool(bottom, top) <= 1e-300)
        if len(bad):
            raise BlockError(
                'the two curves of this spline come too close to each other to give a tool axis',
                int(rows.line_number[own[bad[0]]]),
            )

    def _meet(self, piece: Piece, done: list[tuple[Piece, bool]]) -> None:
        """Let the next span follow the one held back."""
        taken = None
        if self._held is None:
            self.flows, taken = self._opening(piece, self._before)
        elif piece.row - self._held[0].row == 1:  # a simple knot: C2 as it is
            self._settle(None, done, stop=False)
        elif piece.row - self._held[0].row > 3:
            line = self._rows_known().line_number[piece.row - self._offset]
            raise BlockError(
                'more than two knot intervals of 0 in a row tear the spline', int(line)
            )
        else:
            flows, taken = self._opening(piece, self._held[0].jets(at_end=True))
            self._settle(None, done, stop=not flows)
        self._held = piece, taken

    def _opening(self, piece: Piece, before: Jets | None) -> tuple[bool, Jets | None]:
        """Tell whether the path flows into a piece, and what the piece takes up for that."""
        if before is None:
            return False, None
        start = piece.jets(at_end=False)
        if _same(start, before, self._style.height):
            return True, None
        fits = _gentle(start, before) and self._absorbed(piece, before, None) is not None
        return fits, before if fits else None

    def _settle(self, after: Jets | None, done: list[tuple[Piece, bool]], stop: bool) -> None:
        """Finish the span held back; ``stop`` says whether the tool rests where none follows."""
        assert self._held is not None
        piece, taken = self._held
        if after is not None:
            end = piece.jets(at_end=True)
            same = _same(end, after, self._style.height)
            fits = _gentle(end, after) and self._absorbed(piece, None, after) is not None
            stop = not (same or fits)
            after = after if fits and not same else None
        made = self._absorbed(piece, taken, after)
        assert made is not None  # each end fits by itself, and halving parts them
        done += [(part, False) for part in made[:-1]]
        done.append((made[-1], stop))

    def _absorbed(self, piece: Piece, first: Jets | None, last: Jets | None) -> list[Piece] | None:
        rows, i = self._rows_known(), piece.row - self._offset
        both = (rows.contour_tolerance[i], rows.orientation_tolerance[i])
        return absorbed(piece, first, last, JOIN_SHARE * np.array(both), self._style.height)

    def _rows_known(self) -> Blocks:
        assert self._rows is not None
        return self._rows

    def _forget(self) -> None:
        """Drop control points that no span to come needs."""
        needed = self._next if self._held is None else min(self._held[0].row, self._next)
        drop = max(0, needed - 3 - self._offset)
        if drop and self._rows is not None:
            self._rows = self._rows[drop:]
            self._offset += drop

    def _segments(
        self, pieces: list[tuple[Piece, bool]], end: bool = False
    ) -> PathSegments | None:
        """Turn pieces into segments; the last one of the curve ends in its last row."""
        if not pieces:
            return None
        rows, n = self._rows_known(), len(pieces)
        number = np.array([piece.row for piece, _ in pieces])
        own = number - self._offset
        bottom = np.concatenate([piece.bottom for piece, _ in pieces])
        top = np.concatenate([piece.top for piece, _ in pieces])
        tool = top[:, 0] - bottom[:, 0]
        block = np.repeat(self._first_row + number[:, None], 2, axis=1)
        if end:
            block[-1, 1] = self._first_row + self._offset + len(rows) - 1
        return PathSegments(
            kind=np.full(n, SPLINE),
            bottom=bottom,
            top=top,
            connection=np.concatenate([piece.connection for piece, _ in pieces]),
            parametrization=np.repeat(self._room.parametrization, n, axis=0),
            axis=tool / norm(tool)[:, None],
            rotation=np.zeros((n, 3)),
            rotary=np.full((n, 2, 2), np.nan),
            length=np.full(n, np.nan),
            feed=np.repeat(rows.feedrate[own][:, None], 2, axis=1),
            block=block,
            line_number=rows.line_number[own],
            stop=np.array([stop for _, stop in pieces]),
            deviation=np.stack([piece.deviation for piece, _ in pieces]),
        )
