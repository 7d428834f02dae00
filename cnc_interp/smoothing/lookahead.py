"""
The look-ahead: blocks in, smooth segments out, the same however the blocks arrive.

Runs of short blocks are made into curves first (``compressor.py``). A vertex between two of the
blocks that are left becomes one of three things: a corner (rounded), a stop (the tool
rests there), or nothing (the path goes straight on). A corner is final when the next one is
sized, because the line between them may be so short that both take what is left of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cnc_interp.errors import BlockError, InterpError
from cnc_interp.program.blocks import Blocks, BoolArray, FloatArray, IntArray
from cnc_interp.smoothing import corner
from cnc_interp.smoothing.chain import STANDSTILL
from cnc_interp.smoothing.compression import Compression
from cnc_interp.smoothing.compressor import Compressor
from cnc_interp.smoothing.corner import Corners, Style
from cnc_interp.smoothing.orientation import (
    angles_between,
    dot,
    norm,
    rotations_between,
    turned_by,
)
from cnc_interp.smoothing.ratio import AxisRates, ratios_at
from cnc_interp.smoothing.rows import Rows
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments, room_for
from cnc_interp.units import DEG, MM

#: Directions (relative to 1) and rates at flank height that differ less go straight on.
STRAIGHT = 1e-9
PASS, ROUND, STOP = 0, 1, 2
#: Fixed L2/L1 that may be asked for; at 1 the curve meets its lines with a kink.
RATIOS = 1.2, 4.0
#: Ways to make a corner; the first of each is the default.
CHOICES = {'parametrization': ('exact', 'linear', 'paper'), 'top': ('in_step', 'tolerance')}


@dataclass(frozen=True)
class SmoothingOptions:
    """
    How the look-ahead smooths.

    Parameters
    ----------
    flank_height : float
        Height h over the tip at which the orientation tolerance is measured [m].
    ratio : float, optional
        L2/L1 of every corner where there is room [-]; None: chosen for each corner, see
        ``ratio.py``.
    axis_rates : callable, optional
        What the machine's axes do along a line, each over its jerk limit, to choose ratios by.
    parametrization : {'exact', 'linear', 'paper'}
        How the orientation of a corner is connected to its lines; see ``connection.py``.
    top : {'in_step', 'tolerance'}
        How the inner points of the top polygon are placed; see ``corner.py``.
    septic : bool
        Continue the third derivative of the tool axis as well (``exact`` only).
    left_over : float
        A line shorter than this share of its block goes to the corners [-].
    sharpest_turn, sharpest_swing : float
        The tool stops where its path turns by more than this while the tool axis rests, and where
        it turns [rad]: there a stop is faster on average.
    pole : tuple of float or None
        Direction at which a rotary axis is undefined; a turning tool stops there.
    pole_cone : float
        Angle around the pole within which that holds [rad].
    compression : Compression
        How runs of short blocks become curves.

    """

    flank_height: float = 30.0 * MM
    ratio: float | None = None
    axis_rates: AxisRates | None = None
    parametrization: str = 'exact'
    top: str = 'in_step'
    septic: bool = False
    left_over: float = 0.05
    sharpest_turn: float = 178.0 * DEG
    sharpest_swing: float = 176.0 * DEG
    pole: tuple[float, float, float] | None = None
    pole_cone: float = 0.02 * DEG
    compression: Compression = field(default_factory=Compression)

    def __post_init__(self) -> None:
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise InterpError(
                    f'{name} {getattr(self, name)!r} is unknown; choose {" or ".join(choices)}'
                )
        low, high = RATIOS
        if self.ratio is not None and not low <= self.ratio <= high:
            raise InterpError(f'ratio L2/L1 {self.ratio:g} is not between {low:g} and {high:g}')

    @property
    def style(self) -> Style:
        """Return what concerns the corners alone."""
        in_step = self.top == 'in_step'
        return Style(self.flank_height, in_step, self.parametrization, self.septic)


@dataclass
class Legs:
    """Geometry of the blocks between consecutive vertices, one row per block."""

    length: FloatArray
    direction: FloatArray
    rotation: FloatArray
    turn: FloatArray
    rate: FloatArray
    resting: BoolArray

    @staticmethod
    def of(blocks: Blocks) -> Legs:
        """Measure the blocks; row i leads from vertex i to vertex i + 1."""
        step = np.diff(blocks.tip, axis=0)
        length = norm(step)
        resting = length < STANDSTILL
        direction = step / np.where(resting, 1.0, length)[:, None]
        rotation = rotations_between(blocks.axis[:-1], blocks.axis[1:])
        rate = rotation / np.where(resting, 1.0, length)[:, None]
        return Legs(length, direction, rotation, norm(rotation), rate, resting)


class LookAhead:
    """
    Round the corners of a stream of blocks.

    Parameters
    ----------
    options : SmoothingOptions
        How to smooth.
    row : int
        Row in the program of the first block to come.
    joined : bool
        Whether a native spline ends at the first pose, so that the first block stays a line.

    """

    def __init__(
        self, options: SmoothingOptions | None = None, row: int = 0, joined: bool = False
    ):
        self.options = options or SmoothingOptions()
        self._style = self.options.style
        self._none = no_segments(self._style)
        options = self.options
        self._compressor = Compressor(
            options.compression, options.flank_height, options.pole, options.pole_cone, row, joined
        )
        self._rows: Rows | None = None
        self._outer_before = 0.0  # L2 of the corner at the first kept vertex, unstretched

    def push(self, blocks: Blocks) -> PathSegments:
        """
        Take further blocks and return the segments that are final.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program; the very first row is the start pose.

        Returns
        -------
        PathSegments
            Possibly empty.

        Raises
        ------
        BlockError
            If a block's tool axis reverses (no plane of rotation).

        """
        return self._take(self._compressor.push(blocks), final=False)

    def finish(self, joined: bool = False) -> PathSegments:
        """
        Return the remaining segments; the tool rests at the end.

        With ``joined`` the last block stays a line, for a native spline goes on from it.
        """
        return self._take(self._compressor.finish(joined), final=True)

    def _take(self, rows: Rows, final: bool) -> PathSegments:
        """Emit every line and curve whose both end vertices are final."""
        if self._rows is not None:
            rows = Rows.concatenate([self._rows, rows])
        self._rows, blocks = rows, rows.blocks
        if len(blocks) < 2:
            return self._none
        legs = Legs.of(blocks)
        self._refuse_reversals(rows, legs)
        vertex = self._classify(rows, legs)
        inner, outer = self._size(rows, legs, vertex)
        outer[0, 1] = self._outer_before
        # A vertex is final when its own corner is sized and its neighbour's too (left-overs).
        last = len(blocks) - 1 if final else len(blocks) - 3
        if last < 1:
            return self._none
        own_share = float(outer[last, 1])
        self._share_left_overs(legs, outer, len(blocks) - 1 if final else last + 1)
        segments = self._emit(rows, legs, vertex, inner, outer, last)
        self._outer_before = own_share
        self._rows = rows[last:]
        return segments

    def _refuse_reversals(self, rows: Rows, legs: Legs) -> None:
        """Refuse blocks whose orientations are antiparallel: their great circle is undefined."""
        blocks = rows.blocks
        cosine = dot(blocks.axis[:-1], blocks.axis[1:])
        programmed = np.isfinite(blocks.rotary[1:]).all(axis=1) & legs.resting
        bad = np.flatnonzero((cosine < -1.0 + 1e-12) & ~programmed & (rows.count[1:] == 0))
        if len(bad):
            raise BlockError(
                'the tool axis reverses within one block, so its plane of rotation is undefined; '
                'add a block with an orientation in between',
                int(blocks.line_number[bad[0] + 1]),
            )

    def _classify(self, rows: Rows, legs: Legs) -> IntArray:
        """Decide what each vertex becomes, shape (n,); the ends are stops."""
        blocks, curve = rows.blocks, rows.count > 0
        kind = np.full(len(blocks), STOP)
        before, after = slice(None, -1), slice(1, None)
        resting = legs.resting[before] | legs.resting[after]
        cosine = dot(legs.direction[before], legs.direction[after])
        turning = (legs.turn[before] > 0.0) | (legs.turn[after] > 0.0)
        sharpest = np.where(turning, self.options.sharpest_swing, self.options.sharpest_turn)
        sharp = cosine < np.cos(sharpest)
        bend = norm(np.diff(legs.direction, axis=0))
        twist = norm(np.diff(legs.rate, axis=0)) * self.options.flank_height
        straight = (bend < STRAIGHT) & (twist < STRAIGHT)
        kind[1:-1] = np.where(straight, PASS, ROUND)
        at_pole = np.zeros(len(kind) - 2, dtype=bool)
        if self.options.pole is not None:
            o = blocks.axis[1:-1]
            pole = np.broadcast_to(np.asarray(self.options.pole), o.shape)
            angle = angles_between(o, pole)
            close = np.minimum(angle, np.pi - angle) < self.options.pole_cone
            at_pole = close & turning
        stop = resting | sharp | at_pole | blocks.exact_stop[1:-1]
        kind[1:-1][stop] = STOP
        beside = curve[1:-1] | curve[2:]
        kind[1:-1][beside] = np.where(rows.smooth[2:], PASS, STOP)[beside]
        return kind

    def _corners_at(self, blocks: Blocks, legs: Legs, rows: IntArray) -> Corners:
        """Collect what the program says about the corners at some vertices."""
        tolerances = [
            np.minimum(column[rows], column[rows + 1])
            for column in (blocks.contour_tolerance, blocks.orientation_tolerance)
        ]
        return Corners(
            tip=blocks.tip[rows],
            axis=blocks.axis[rows],
            legs=np.stack([-legs.direction[rows - 1], legs.direction[rows]], axis=1),
            rates=np.stack([legs.rate[rows - 1], legs.rate[rows]], axis=1),
            tolerances=np.stack(tolerances, axis=1),
        )

    def _size(self, lines: Rows, legs: Legs, vertex: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return L1, shape (n,), and both L2, shape (n, 2), of every vertex; 0 without corner."""
        inner, outer = np.zeros(len(lines)), np.zeros((len(lines), 2))
        rows = np.flatnonzero(vertex == ROUND)
        if len(rows):
            corners = self._corners_at(lines.blocks, legs, rows)
            # a line that a curve joins belongs to its only corner
            alone = np.stack([lines.smooth[rows], lines.leads[rows + 1]], axis=1)
            half = np.stack([legs.length[rows - 1], legs.length[rows]], axis=1)
            half = np.where(alone, half, 0.5 * half)
            ratios = self._ratios(corners)
            start = corner.first_lengths(corners, half, ratios)
            inner[rows], outer[rows], _, _ = corner.fit(corners, *start, self._style, ratios)
        return inner, outer

    def _ratios(self, corners: Corners) -> FloatArray:
        """Return L2/L1 on both sides of corners, shape (n, 2): as told, or chosen for each."""
        if self.options.ratio is not None:
            return np.full((len(corners.tip), 2), self.options.ratio)
        return ratios_at(corners, self.options.flank_height, self.options.axis_rates)

    def _share_left_overs(self, legs: Legs, outer: FloatArray, known: int) -> None:
        """Stretch the corners over lines that are too short to be worth keeping."""
        used = outer[:known, 1] + outer[1 : known + 1, 0]
        length = legs.length[:known]
        rest = length - used
        stretch = (rest < self.options.left_over * length) & (used > 0.0)
        factor = np.where(stretch, length / np.where(used > 0.0, used, 1.0), 1.0)
        outer[:known, 1] *= factor
        outer[1 : known + 1, 0] *= factor

    def _emit(
        self,
        rows: Rows,
        legs: Legs,
        vertex: IntArray,
        inner: FloatArray,
        outer: FloatArray,
        last: int,
    ) -> PathSegments:
        """Build the segments of rows 1 .. last and the corners at vertices 1 .. last."""
        kept, lines = self._lines(rows, legs, vertex, outer, last)
        parts, places = [lines], [2 * kept + 1]
        round_ones = np.flatnonzero(vertex[: last + 1] == ROUND)
        round_ones = round_ones[round_ones > 0]
        if len(round_ones):
            parts.append(self._corners(rows, legs, round_ones, inner, outer))
            places.append(2 * round_ones)
        curves = np.repeat(np.arange(last), rows.count[1 : last + 1])
        if len(curves):
            parts.append(self._curves(rows, vertex, curves))
            places.append(2 * curves + 1)
        order = np.argsort(np.concatenate(places), kind='stable')
        return PathSegments.concatenate(parts)[order]

    def _curves(self, rows: Rows, vertex: IntArray, row: IntArray) -> PathSegments:
        """Return the spans of curves; ``row`` says to which row, less one, each belongs."""
        n, first = len(row), int(rows.count[0])
        spans = rows.spans[first : first + n]
        room = self._style.room(n)
        tool = spans.top[:, 0] - spans.bottom[:, 0]
        final = np.append(row[1:] != row[:-1], True)
        return PathSegments(
            kind=np.full(n, SPLINE),
            bottom=spans.bottom,
            top=spans.top,
            connection=room.connection,
            parametrization=room.parametrization,
            axis=tool / norm(tool)[:, None],
            rotation=np.zeros((n, 3)),
            rotary=np.full((n, 2, 2), np.nan),
            length=np.full(n, np.nan),
            feed=spans.feed,
            block=spans.block,
            line_number=spans.line_number,
            stop=final & (vertex[row + 1] == STOP),
            deviation=spans.deviation,
        )

    def _lines(
        self, rows: Rows, legs: Legs, vertex: IntArray, outer: FloatArray, last: int
    ) -> tuple[IntArray, PathSegments]:
        """
        Return what the corners leave of the blocks, and the rotations of the resting tool.

        The first array tells the rows, less one.
        """
        blocks = rows.blocks
        start, end = outer[:last, 1], legs.length[:last] - outer[1 : last + 1, 0]
        resting = legs.resting[:last]
        rotary = np.stack([blocks.rotary[:last], blocks.rotary[1 : last + 1]], axis=1)
        programmed = np.isfinite(rotary).all(axis=(1, 2))
        swept = np.where(
            programmed, np.sqrt((np.diff(rotary, axis=1)[:, 0] ** 2).sum(axis=1)), legs.turn[:last]
        )
        length = np.where(resting, self.options.flank_height * swept, end - start)
        line = rows.count[1 : last + 1] == 0
        kept = np.flatnonzero(
            line & np.where(resting, swept > 0.0, end - start > 1e-12 * legs.length[:last])
            | (line & (vertex[1 : last + 1] == STOP) & (end - start > 0.0))
        )
        share = np.where(resting, 0.0, start / np.where(resting, 1.0, legs.length[:last]))
        rotation = legs.rotation[:last]
        part = np.where(resting, 1.0, (end - start) / np.where(resting, 1.0, legs.length[:last]))
        curves = self._style.room(last)
        bottom = curves.bottom
        bottom[:, 0] = blocks.tip[:last] + start[:, None] * legs.direction[:last]
        bottom[:, 1] = blocks.tip[:last] + end[:, None] * legs.direction[:last]
        from_corner, to_corner = outer[:last, 1] > 0.0, outer[1 : last + 1, 0] > 0.0
        bottom[:, 1] = np.where(
            (to_corner | resting)[:, None], bottom[:, 1], blocks.tip[1 : last + 1]
        )
        bottom[:, 0] = np.where(from_corner[:, None], bottom[:, 0], blocks.tip[:last])
        axis = turned_by(blocks.axis[:last], rotation, share)
        feed = self._feed(blocks, legs, np.arange(last), swept)
        row = rows.row[kept + 1]
        return kept, PathSegments(
            kind=np.where(resting, ROTATION, LINE)[kept],
            bottom=room_for(bottom[kept]),
            top=room_for(curves.top[kept]),
            connection=curves.connection[kept],
            parametrization=curves.parametrization[kept],
            axis=axis[kept],
            rotation=(rotation * part[:, None])[kept],
            rotary=np.where(programmed[:, None, None], rotary, np.nan)[kept],
            length=length[kept],
            feed=np.repeat(feed[kept, None], 2, axis=1),
            block=np.repeat(row[:, None], 2, axis=1),
            line_number=blocks.line_number[kept + 1],
            stop=(vertex[1 : last + 1] == STOP)[kept],
            deviation=rows.used[kept + 1],
        )

    def _feed(self, blocks: Blocks, legs: Legs, rows: IntArray, swept: FloatArray) -> FloatArray:
        """
        Return the programmed ds/dt of the blocks that start at rows [m/s].

        A duration (G93) gives length / duration; a rotation of the resting tip is limited by its
        duration or by the axes alone.
        """
        duration = blocks.duration[rows + 1]
        timed = np.isfinite(duration)
        resting = legs.resting[rows]
        length = np.where(resting, self.options.flank_height * swept, legs.length[rows])
        programmed = np.where(resting, np.inf, blocks.feedrate[rows + 1])
        return np.where(timed, length / np.where(timed, duration, 1.0), programmed)

    def _corners(
        self, lines: Rows, legs: Legs, rows: IntArray, inner: FloatArray, outer: FloatArray
    ) -> PathSegments:
        """Return the corners at the given vertices."""
        n, blocks = len(rows), lines.blocks
        corners = self._corners_at(blocks, legs, rows)
        _, _, curves, deviation = corner.fit(corners, inner[rows], outer[rows], self._style)
        beyond = np.flatnonzero((deviation > corners.tolerances * (1.0 + 1e-6)).any(axis=1))
        if len(beyond):
            raise BlockError(
                'this corner cannot be rounded within the tolerances; give it an exact stop (G61)',
                int(blocks.line_number[rows[beyond[0]]]),
            )
        zero = np.zeros(n)
        return PathSegments(
            kind=np.full(n, CORNER),
            bottom=room_for(curves.bottom),
            top=room_for(curves.top),
            connection=curves.connection,
            parametrization=curves.parametrization,
            axis=(curves.top[:, 0] - curves.bottom[:, 0]) / self.options.flank_height,
            rotation=np.zeros((n, 3)),
            rotary=np.full((n, 2, 2), np.nan),
            length=np.full(n, np.nan),
            feed=np.stack(
                [self._feed(blocks, legs, rows - 1, zero), self._feed(blocks, legs, rows, zero)],
                axis=1,
            ),
            block=np.stack([lines.row[rows], lines.row[rows + 1]], axis=1),
            line_number=blocks.line_number[rows + 1],
            stop=np.zeros(n, dtype=bool),
            deviation=deviation + np.maximum(lines.used[rows], lines.used[rows + 1]),
        )


def no_segments(style: Style) -> PathSegments:
    """Return an empty batch for a style of corners."""
    curves = style.room(0)
    return PathSegments(
        kind=np.zeros(0, dtype=np.int64),
        bottom=room_for(curves.bottom),
        top=room_for(curves.top),
        connection=curves.connection,
        parametrization=curves.parametrization,
        axis=np.zeros((0, 3)),
        rotation=np.zeros((0, 3)),
        rotary=np.zeros((0, 2, 2)),
        length=np.zeros(0),
        feed=np.zeros((0, 2)),
        block=np.zeros((0, 2), dtype=np.int64),
        line_number=np.zeros(0, dtype=np.int64),
        stop=np.zeros(0, dtype=bool),
        deviation=np.zeros((0, 2)),
    )
