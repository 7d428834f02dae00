"""One native 5-axis B-spline: from control points, in batches of any size, to smooth segments.

Each span of the pair of cubic B-splines becomes exactly one SPLINE segment. The curve may meet a
line, or its own next span at a repeated knot. There the derivatives on both sides are compared. If
they differ, the span takes the derivatives of the other side by the general connection of
``joining.py``. The span may use a share of the tolerances. If the deviation is too large, the span
is halved, so that only its end changes. If the path turns too sharply, the tool rests. With
``--parametrization linear`` nothing is connected, as on a control with u_top = u_bottom.
"""

import numpy as np

from cnc_interp.core import BlockError, FloatArray, IntArray, norm
from cnc_interp.core.bspline import cubic_bezier_points, divided, elevated, least_length
from cnc_interp.program.blocks import Blocks
from cnc_interp.smoothing.corners.corner_curve import Style
from cnc_interp.smoothing.native.joining import Jets, Piece, absorbed, joins_gently, same_jets
from cnc_interp.smoothing.segments import POINTS, SPLINE, PathSegments

#: Share of the tolerances for one join [-]. Two joins of a span may act at the same place.
JOIN_SHARE = 0.45
#: The tip stands still if its speed is below this share of the polygon length of the span [-].
STANDSTILL_SHARE = 1e-6
#: Largest difference between the start of a curve and the end of the block before it [m], [-].
SAME_POSE = 1e-9


class SplineRun:
    def __init__(self, row: int, pose: Blocks, before: Jets | None, style: Style):
        self._first_row, self._pose, self._before = row, pose, before
        self._style, self._room = style, style.empty_curves(1)
        self._rows: Blocks | None = None  # control points that later spans may need
        self._offset = 0  # number in the curve of the first of them
        self._next = 1  # number in the curve of the next span
        # The last span, which is not ended yet, and the derivatives at its start.
        self._held: tuple[Piece, Jets | None] | None = None
        #: Whether the path continues into the curve without rest; None if not known yet.
        self.flows: bool | None = None

    @property
    def last_row(self) -> Blocks:
        return self._rows_known()[-1:]

    def push(self, rows: Blocks) -> PathSegments | None:
        """Add control points and return the segments that later ones cannot change.

        Raises BlockError if the curve does not start at the tool position, the tip stands still in
        it, or repeated knots interrupt it.
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
        """Return the rest of the curve; without jets of a path after it, it ends with a stop.

        Raises BlockError if it has fewer than four control points or is not clamped at its end.
        """
        rows = self._rows_known()
        line = int(rows.line_number[-1])
        count = self._offset + len(rows)
        if count < 4 or self._held is None:
            raise BlockError(
                f'a cubic B-spline needs at least 4 control points, the start included; '
                f'this one has {count}: add control points',
                line,
            )
        if rows.knot_interval[-2:].any():
            raise BlockError(
                'the last two knot intervals of a spline must be 0; '
                'write PL=0 in its last two blocks',
                line,
            )
        pieces: list[tuple[Piece, bool]] = []
        self._settle(after, pieces, stop=True)
        return self._segments(pieces, end=True)

    def _check_begin(self, rows: Blocks) -> None:
        """Raise BlockError if the curve does not start at the tool, or its knots do not fit."""
        line = int(rows.line_number[0])
        gap = max(
            float(np.abs(rows.tip[0] - self._pose.tip[0]).max()),
            float(np.abs(rows.axis[0] - self._pose.axis[0]).max()),
        )
        if gap > SAME_POSE:
            raise BlockError(
                'the spline does not begin where the tool is; its first control point must be '
                'the end pose of the previous block',
                line,
            )
        if rows.knot_interval[0] != 0.0 or (len(rows) > 1 and rows.knot_interval[1] == 0.0):
            raise BlockError(
                'the first knot interval of a spline must be 0 and the second one must not; '
                'correct PL in its first two blocks',
                line,
            )

    def _spans(self) -> list[Piece]:
        rows = self._rows_known()
        count = self._offset + len(rows)
        numbers = np.arange(self._next, count - 2)
        if not len(numbers):
            return []
        self._next = count - 2
        interval = rows.knot_interval
        numbers = numbers[interval[numbers - self._offset] > 0.0]
        # Span j lies between the knots t_(j+2) and t_(j+3). Its control points are j-1 ... j+2.
        own = numbers - self._offset
        padded = np.concatenate([np.zeros(2), interval])
        step = [padded[own + 2 + shift] for shift in (-2, -1, 0, 1, 2)]
        zero = np.zeros(len(numbers))
        knots = np.stack(
            [
                -(step[1] + step[0]),
                -step[1],
                zero,
                step[2],
                step[2] + step[3],
                step[2] + step[3] + step[4],
            ],
            axis=1,
        )
        acting = own[:, None] + np.arange(-1, 3)
        bottom = elevated(cubic_bezier_points(rows.tip[acting], knots), 5)
        top = elevated(cubic_bezier_points(rows.top[acting], knots), 5)
        self._check_spans(bottom, top, rows, own)
        free = self._room.connection
        return [
            Piece(bottom[i : i + 1], top[i : i + 1], free, np.zeros(2), int(number))
            for i, number in enumerate(numbers)
        ]

    def _check_spans(
        self, bottom: FloatArray, top: FloatArray, rows: Blocks, own: IntArray
    ) -> None:
        """Raise BlockError for a span on which the path length or the tool axis is undefined."""
        steps = np.diff(bottom, axis=1)
        size = norm(steps).sum(axis=1)
        slowest = np.full(len(bottom), np.inf)
        for u in np.linspace(0.0, 1.0, 9):
            slowest = np.minimum(slowest, norm(divided(steps, float(u))[0][:, -1]))
        bad = np.flatnonzero(slowest <= STANDSTILL_SHARE * size)
        if len(bad):
            raise BlockError(
                'the tool tip rests in a part of this spline; end the spline there and turn the '
                'tool in a G1 block',
                int(rows.line_number[own[bad[0]]]),
            )
        bad = np.flatnonzero(least_length(top - bottom) <= 0.0)
        if len(bad):
            raise BlockError(
                'the two curves of this spline come too close to each other to give a tool axis; '
                'move their control points apart',
                int(rows.line_number[own[bad[0]]]),
            )

    def _meet(self, piece: Piece, done: list[tuple[Piece, bool]]) -> None:
        """Accept the next span, and finish the span before it."""
        taken = None
        if self._held is None:
            self.flows, taken = self._opening(piece, self._before)
        elif piece.row - self._held[0].row == 1:  # a simple knot, where the curve is C2
            self._settle(None, done, stop=False)
        elif piece.row - self._held[0].row > 3:
            raise BlockError(
                'three or more knot intervals of 0 in a row interrupt the spline; end it there '
                'and begin another one',
                int(self._rows_known().line_number[piece.row - self._offset]),
            )
        else:
            flows, taken = self._opening(piece, self._held[0].jets(at_end=True))
            self._settle(None, done, stop=not flows)
        self._held = piece, taken

    def _opening(self, piece: Piece, before: Jets | None) -> tuple[bool, Jets | None]:
        """Return whether the path enters a span without rest, and the jets for its start."""
        if before is None:
            return False, None
        start = piece.jets(at_end=False)
        if same_jets(start, before, self._style.height):
            return True, None
        if self._style.method == 'linear':
            return joins_gently(start, before), None
        fits = joins_gently(start, before) and self._absorb(piece, before, None) is not None
        return fits, before if fits else None

    def _settle(self, after: Jets | None, done: list[tuple[Piece, bool]], stop: bool) -> None:
        assert self._held is not None
        piece, taken = self._held
        if after is not None:
            end = piece.jets(at_end=True)
            same, plain = same_jets(end, after, self._style.height), self._style.method == 'linear'
            fits = joins_gently(end, after)
            fits = fits and (plain or self._absorb(piece, None, after) is not None)
            stop = not (same or fits)
            after = after if fits and not (same or plain) else None
        made = self._absorb(piece, taken, after)
        assert made is not None  # each end fits alone, and halving separates the ends
        done += [(part, False) for part in made[:-1]]
        done.append((made[-1], stop))

    def _absorb(self, piece: Piece, first: Jets | None, last: Jets | None) -> list[Piece] | None:
        rows, i = self._rows_known(), piece.row - self._offset
        both = (rows.contour_tolerance[i], rows.orientation_tolerance[i])
        return absorbed(piece, first, last, JOIN_SHARE * np.array(both), self._style.height)

    def _rows_known(self) -> Blocks:
        assert self._rows is not None
        return self._rows

    def _forget(self) -> None:
        needed = self._next if self._held is None else min(self._held[0].row, self._next)
        drop = max(0, needed - 3 - self._offset)
        if drop and self._rows is not None:
            self._rows = self._rows[drop:]
            self._offset += drop

    def _segments(
        self, pieces: list[tuple[Piece, bool]], end: bool = False
    ) -> PathSegments | None:
        """Convert pieces to segments; with ``end``, the last segment ends in the last row."""
        if not pieces:
            return None
        rows, n = self._rows_known(), len(pieces)
        number = np.array([piece.row for piece, _ in pieces])
        own = number - self._offset
        bottom = np.concatenate([piece.bottom for piece, _ in pieces])
        top = np.concatenate([piece.top for piece, _ in pieces])
        tool = top[:, 0] - bottom[:, 0]
        deviation = np.stack([piece.deviation for piece, _ in pieces])
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
            block=block,
            line_number=rows.line_number[own],
            feed=np.repeat(rows.feedrate[own][:, None], 2, axis=1),
            stop=np.array([stop for _, stop in pieces]),
            deviation=deviation,
            extra=np.repeat(rows.extra[own, None], POINTS, axis=1),
            room=rows.orientation_tolerance[own] - deviation[:, 1],
        )
