"""
Motion targets to blocks: rows of numbers are collected and converted in batches.

A reader appends one row of numbers per motion statement. When a batch is full, its rows become
blocks together. Positions become poses, arcs become chords, repeated points are merged, and curved
motion is divided. Lines in machine axes stay whole. So the memory does not depend on the length
of the program, and Python does not process single rows.
"""

from __future__ import annotations

from array import array
from dataclasses import replace
from itertools import pairwise
from math import inf, nan

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import DEG
from cnc_interp.program import arcs
from cnc_interp.program.blocks import (
    AXES_LINEAR,
    GO_ON,
    OPTIONAL_STOP,
    POSES,
    ROTARY_LINEAR,
    STOP,
    Blocks,
)
from cnc_interp.program.rotary_geometry import RotaryGeometry
from cnc_interp.program.subdivide import (
    MOST_PIECES,
    angle_between,
    great_circle,
    piece_counts,
    ragged,
)
from cnc_interp.settings.choices import Settings

# Columns of a target row.
POINT, AXIS, ROTARY = slice(0, 3), slice(3, 6), slice(6, 8)
NAMED, GREAT_CIRCLE, FEEDRATE, DURATION, RAPID, EXACT_STOP = 8, 9, 10, 11, 12, 13
CONTOUR, ORIENTATION, LINE, AXES, TURN_RATE = 14, 15, 16, 17, 18
CENTRE, NORMAL, SWEEP, EXTRA, WIDTH = slice(19, 22), slice(22, 25), 25, slice(26, 29), 29
#: Letters of the columns EXTRA.
EXTRA_LETTERS = 'UVW'
#: Values of EXACT_STOP for M1 and M0. The largest value counts if several stops meet.
AT_M1, AT_M0 = 2.0, 3.0
_WAITS = np.array([GO_ON, GO_ON, OPTIONAL_STOP, STOP])
#: The arc columns of a line that is not an arc.
NO_ARC = (nan,) * 7

_FIRST_BATCH, _BATCH_ROWS = 64, 4096
_SAME = 1e-12  # [m], [-], [rad]
_ANTIPARALLEL = 1e-4  # [rad]
#: Part of the tolerances for the deviation of chords and great circles from programmed motion [-].
CHORD_SHARE = 0.1
_MOST_TURN = 500.0 * 360.0 * DEG
#: Nearer to the pole than this number of orientation tolerances, a direction does not give the
#: rotary positions: a path within the tolerance could pass the pole on its other side.
POLE_TOLERANCES = 4.0
#: Without tool-tip programming, lines in axes become curves of poses after so many short blocks in
#: a row. In each of them the tip moves more than this share of the turn at flank height [-].
FEWEST_DENSE, SLOW_TIP = 32, 0.05
#: Largest turn of a piece whose rotary axes run linearly while the tip keeps its line [rad].
_LONGEST_TURN = 8.0 * 360.0 * DEG


class TargetColumns:
    """
    Growing columns of motion targets that are converted to blocks in batches.

    Parameters
    ----------
    geometry : RotaryGeometry
        Kinematics of the machine.
    settings : Settings
        Flank height, for the division of curved motion.
    source : str
        File name for error messages.

    """

    def __init__(self, geometry: RotaryGeometry, settings: Settings, source: str):
        self._geometry, self._settings, self._source = geometry, settings, source
        self._rows = array('d')
        self._full = min(_FIRST_BATCH, _BATCH_ROWS) * WIDTH
        self._before: FloatArray | None = None  # the last target that became a block
        self._parts: list[Blocks] = []
        self._curve: Blocks | None = None  # the last spline, until the stop at its end is known
        self._dense = 0  # number of short blocks before the next motion
        self._zero = geometry.linear(np.zeros((1, 3)), np.zeros((1, 2)))[0]
        first = EXTRA.start
        self._extra = [first + EXTRA_LETTERS.index(name) for name in geometry.extra_names]

    def add(self, row: tuple[float, ...]) -> None:
        """
        Add one target.

        Parameters
        ----------
        row : tuple of 29 floats
            Point: tool tip, or axis positions minus those of the workpiece zero [m]; tool axis
            [-], NaN if rotary words give it; rotary positions [rad]; 1 if the program has used
            rotary words; 1 for the great circle, 0 for linear rotary axes; feedrate [m/s];
            duration [s]; rapid; exact stop (1, AT_M1 or AT_M0); contour and orientation tolerance
            [m]; line number; 1 if the point is axis positions; feedrate of rotary axes [rad/s];
            centre [m], normal [-] and sweep [rad] of an arc, NaN without;
            positions of the extra axes U V W [m].

        """
        if len(self._rows) >= self._full:
            self._convert(last=False)
        self._rows.extend(row)

    def extend(self, rows: FloatArray) -> None:
        """
        Add many targets.

        Parameters
        ----------
        rows : ndarray, shape (n, 29)
            Targets with the columns of ``add``.

        """
        if len(self._rows) >= self._full:
            self._convert(last=False)
        self._rows.frombytes(np.ascontiguousarray(rows).tobytes())

    def stop_here(self, kind: float = 1.0) -> None:
        """Stop at the end of the last target; AT_M0 and AT_M1 also wait for the operator."""
        if self._rows:
            at = EXACT_STOP - WIDTH
            self._rows[at] = max(self._rows[at], kind)

    def stand_at(self, rotary: FloatArray) -> None:
        """
        Set the rotary positions of the last target, whose tool axis came from a direction.

        Parameters
        ----------
        rotary : ndarray, shape (2,)
            Positions of the rotary axes [rad].

        """
        if self._rows:
            last = len(self._rows) - WIDTH
            self._rows[last + ROTARY.start : last + ROTARY.stop] = array('d', rotary)

    def add_curve(self, curve: Blocks, end: tuple[float, ...]) -> None:
        """
        Add a native spline that begins at the last target.

        Parameters
        ----------
        curve : Blocks
            Control points of the spline, one per row.
        end : tuple of 29 floats
            Target at the end of the spline, as for ``add``; the next motion starts there.

        """
        self._convert(last=True)
        extra = np.tile([end[column] for column in self._extra], (len(curve), 1))
        self._curve, self._before = replace(curve, extra=extra), None
        self._rows.extend(end)

    @property
    def stands(self) -> bool:
        """True while no motion is known, at most the start pose."""
        return self._before is None and self._curve is None and len(self._rows) <= WIDTH

    @property
    def empty(self) -> bool:
        """Whether there is no target yet."""
        return not self._rows

    def take(self) -> list[Blocks]:
        """Return the blocks that are final, and forget them."""
        parts, self._parts = self._parts, []
        return parts

    def finish(self) -> list[Blocks]:
        """End the program with a stop, and return the last blocks."""
        if self.empty:
            raise ProgramError('no motion found; is this a part program?', self._source)
        self.stop_here()
        self._convert(last=True)
        return self.take()

    def _convert(self, last: bool) -> None:
        """Convert the collected rows to blocks; the last row waits for rows that repeat it."""
        rows = np.frombuffer(self._rows, dtype=np.float64).reshape(-1, WIDTH).copy()
        by_rotary = np.isnan(rows[:, AXIS.start])
        if by_rotary.any():
            rows[by_rotary, AXIS] = self._geometry.tool_axis(rows[by_rotary, ROTARY])
        rows = _merge_repeated(rows)
        held = rows[:0] if last else rows[-1:]
        rows = rows[: len(rows) - len(held)]
        self._rows = array('d', held.tobytes())
        self._full = min(4 * self._full, _BATCH_ROWS * WIDTH)
        if self._before is None and len(rows):
            self._parts.append(self._beginning(rows[:1]))
            self._before, rows = rows[0], rows[1:]
        if len(rows) and self._before is not None:
            before = np.vstack([self._before, rows[:-1]])
            self._before = rows[-1]
            for part in _portions(before, rows):
                self._parts.append(self._blocks(before[part], rows[part]))

    def _beginning(self, row: FloatArray) -> Blocks:
        """Return the start pose, or the spline that ends in this row."""
        if self._curve is None:
            return self._start_pose(row)
        curve, self._curve = self._curve, None
        stop, waits = curve.exact_stop.copy(), curve.program_stop.copy()
        stop[-1] |= row[0, EXACT_STOP] != 0.0
        waits[-1] = _waits(row)[0]
        return replace(curve, exact_stop=stop, program_stop=waits)

    def _blocks(self, before: FloatArray, rows: FloatArray) -> Blocks:
        """Return the blocks of the motions between the rows."""
        moves = Moves(self._geometry, self._zero, before, rows, self._settings, self._dense)
        self._dense = moves.dense
        counts = self._piece_counts(moves)
        row, piece = ragged(counts)
        u = (piece + 1.0) / counts[row]
        final = piece + 1 == counts[row]
        rotary = moves.rotary(row, u)
        tip, axis = moves.poses(row, u)
        end = rows[row]
        on_circle = end[:, GREAT_CIRCLE] != 0.0
        interpolation = moves.interpolation[row]
        linear = interpolation != POSES
        rotary[~linear & (on_circle | (end[:, NAMED] == 0.0))] = nan
        rotary_from = np.full((len(row), 2), nan)
        named = linear | moves.rests[row]
        rotary_from[named] = moves.rotary(row[named], piece[named] / counts[row[named]])
        curved = np.isfinite(end[:, SWEEP]) & (counts[row] > 1)
        # Chords have used a part of the tolerance; the rest remains for the smoothing.
        share = np.where(curved, 1.0 - CHORD_SHARE, 1.0)
        feedrate, duration = moves.speeds()
        return Blocks(
            tip=tip,
            axis=axis,
            rotary=rotary,
            feedrate=feedrate[row],
            duration=duration[row] / counts[row],
            rapid=end[:, RAPID] != 0.0,
            exact_stop=(end[:, EXACT_STOP] != 0.0) & final,
            contour_tolerance=share * end[:, CONTOUR],
            orientation_tolerance=end[:, ORIENTATION].copy(),
            line_number=end[:, LINE].astype(np.int64),
            program_stop=np.where(final, _waits(end), GO_ON),
            extra=moves.extra(row, u)[:, [column - EXTRA.start for column in self._extra]],
            interpolation=interpolation,
            rotary_from=rotary_from,
        )

    def _piece_counts(self, moves: Moves) -> IntArray:
        """Return the number of pieces of each motion, shape (n,)."""
        rows = moves.rows
        counts = np.ones(len(rows), dtype=np.int64)
        on_circle = rows[:, GREAT_CIRCLE] != 0.0
        if on_circle.any():
            angle = angle_between(moves.axis_before[on_circle], rows[on_circle, AXIS])
            if (angle > np.pi - _ANTIPARALLEL).any():
                worst = rows[on_circle][np.argmax(angle)]
                raise ProgramError(
                    'the tool axis turns by 180 deg in one block, so its plane of rotation is '
                    'undefined; add a block between',
                    self._source,
                    int(worst[LINE]),
                )
            counts[on_circle] = np.maximum(np.ceil(angle / (90.0 * DEG) - 1e-9), 1.0)
        curved = np.flatnonzero(moves.curved())
        if len(curved):
            turned = np.abs(moves.sweep[curved]).sum(axis=1) + np.nan_to_num(
                np.abs(rows[curved, SWEEP])
            )
            if (turned > _MOST_TURN).any():
                raise ProgramError(
                    'more than 500 turns in one block; correct it or cut it into blocks',
                    self._source,
                    int(rows[curved[np.argmax(turned)], LINE]),
                )
            pieces = piece_counts(
                lambda block, u: moves.chordal(curved[block], u),
                turned,
                CHORD_SHARE * rows[curved, CONTOUR],
                CHORD_SHARE * rows[curved, ORIENTATION] / self._settings.flank_height,
            )
            if pieces.max() > MOST_PIECES:
                raise ProgramError(
                    f'more than {MOST_PIECES:,} chords in one block; widen the tolerances',
                    self._source,
                    int(rows[curved[np.argmax(pieces)], LINE]),
                )
            counts[curved] = np.maximum(counts[curved], pieces)
        turning = moves.interpolation == ROTARY_LINEAR
        if turning.any():
            turns = np.abs(moves.sweep[turning]).max(axis=1) / _LONGEST_TURN
            counts[turning] = np.maximum(counts[turning], np.ceil(turns).astype(np.int64))
        return counts

    def _start_pose(self, row: FloatArray) -> Blocks:
        """Return row 0, the start pose. It has no motion, so no feedrate and no duration."""
        here = Moves(self._geometry, self._zero, row, row, self._settings)
        tip, _ = here.poses(np.zeros(1, np.int64), np.ones(1))
        rotary = row[:, ROTARY].copy()
        if np.isfinite(rotary).all():
            axis = self._geometry.tool_axis(rotary)
            if np.abs(axis - row[:, AXIS]).max() > _SAME:
                rotary[:] = nan  # the tool axis came from a direction
        return Blocks(
            tip=tip,
            axis=row[:, AXIS].copy(),
            rotary=rotary,
            feedrate=np.full(1, inf),
            duration=np.full(1, nan),
            rapid=row[:, RAPID] != 0.0,
            exact_stop=row[:, EXACT_STOP] != 0.0,
            contour_tolerance=row[:, CONTOUR].copy(),
            orientation_tolerance=row[:, ORIENTATION].copy(),
            line_number=row[:, LINE].astype(np.int64),
            extra=row[:, self._extra],
        )


def _waits(rows: FloatArray) -> IntArray:
    """Return whether the program waits for the operator after each target, shape (n,)."""
    return np.asarray(_WAITS[rows[:, EXACT_STOP].astype(np.int64)])


class Moves:
    """
    Motions between consecutive targets, which can be evaluated at any parameter.

    Parameters
    ----------
    geometry : RotaryGeometry
        Kinematics of the machine.
    zero : ndarray, shape (3,)
        Axis positions of the workpiece zero, with the rotary axes at zero [m].
    before, rows : ndarray, shape (n, 29)
        Targets at the start and at the end of each motion.
    settings : Settings
        Choices of the user.
    dense : int
        Number of short blocks before the first motion, at most ``FEWEST_DENSE``.

    Attributes
    ----------
    interpolation : ndarray of int, shape (n,)
        What runs linearly in each motion, as in ``Blocks``.
    dense : int
        The same number before the next motion.
    rests : ndarray of bool, shape (n,)
        Motions with tool-tip programming in which words turn the rotary axes about a resting tip.

    """

    def __init__(
        self,
        geometry: RotaryGeometry,
        zero: FloatArray,
        before: FloatArray,
        rows: FloatArray,
        settings: Settings,
        dense: int = 0,
    ):
        self._geometry, self._zero, self._before, self.rows = geometry, zero, before, rows
        self.dense = dense
        self.sweep = np.nan_to_num(rows[:, ROTARY] - before[:, ROTARY])
        self.axis_before = before[:, AXIS]
        self._along = np.zeros((3, 3))
        for letter, direction in zip(geometry.extra_names, geometry.extra_direction, strict=True):
            self._along[EXTRA_LETTERS.index(letter)] = direction
        self._start = self._starts()
        self._arc = np.isfinite(rows[:, SWEEP])
        # Axis positions and tool tips are equal while the rotary axes are at zero.
        turned = (np.abs(rows[:, ROTARY]) > 0.0) | (np.abs(before[:, ROTARY]) > 0.0)
        beside = (rows[:, EXTRA] != 0.0) | (before[:, EXTRA] != 0.0)
        turned = turned.any(axis=1) | beside.any(axis=1)
        self._by_axes = (rows[:, AXES] != 0.0) & turned
        self.interpolation = self._interpolation(settings)

    def _interpolation(self, settings: Settings) -> IntArray:
        """
        Say what runs linearly; without tool-tip programming, the axes where one turns.

        Short blocks whose poses run linearly as well become curves with their neighbours.
        """
        rows = self.rows
        turns = (np.abs(self.sweep).max(axis=1) > _SAME) & (rows[:, GREAT_CIRCLE] == 0.0)
        kind = np.where(turns & (rows[:, AXES] != 0.0), AXES_LINEAR, POSES)
        # With tool-tip programming, directions give the rotary axes unless the pole is near.
        self.rests = turns & (kind == POSES) & ~self._travels()
        words = np.flatnonzero(turns & (kind == POSES) & ~self.rests)
        if len(words):
            kind[words[self._near_pole(words, settings.flank_height)]] = ROTARY_LINEAR
        if settings.compress:
            like = (kind == POSES) & (rows[:, RAPID] == 0.0) & self._travels()
            short = np.flatnonzero((kind == AXES_LINEAR) & (rows[:, RAPID] == 0.0) & ~self._arc)
            if len(short):
                like[short[self._like_poses(short, settings)]] = True
            row = np.arange(len(rows))
            broken = np.maximum.accumulate(np.where(like, -1, row))
            count = row - broken + np.where(broken < 0, self.dense, 0)
            kind[like & (count > FEWEST_DENSE)] = POSES
            self.dense = int(min(count[-1], FEWEST_DENSE)) if len(rows) else self.dense
        return kind

    def _near_pole(self, row: IntArray, height: float) -> BoolArray:
        """Return which motions come so near to the pole that words must rule, shape (m,)."""
        cone = POLE_TOLERANCES * self.rows[row, ORIENTATION] / height
        near = self._geometry.nearest_to_pole(self._before[row, ROTARY], self.rows[row, ROTARY])
        return np.asarray(near < np.maximum(cone, self._geometry.pole_cone))

    def _like_poses(self, row: IntArray, settings: Settings) -> BoolArray:
        """Return which lines in axes are short lines of poses within a tenth, shape (m,)."""
        end, height = self.rows[row], settings.flank_height
        (tip_from, o_from), (tip, o) = (self.poses(row, np.full(len(row), u)) for u in (0.0, 1.0))
        way, turn = np.linalg.norm(tip - tip_from, axis=1), height * angle_between(o_from, o)
        fits = (way <= settings.longest_block) & (way > SLOW_TIP * turn)
        fits &= ~self._near_pole(row, height)
        some = row[fits]
        if len(some):
            fits[fits] = (
                piece_counts(
                    lambda block, u: self.poses(some[block], u),
                    np.abs(self.sweep[some]).sum(axis=1),
                    CHORD_SHARE * end[fits, CONTOUR],
                    CHORD_SHARE * end[fits, ORIENTATION] / height,
                )
                == 1
            )
        return np.asarray(fits)

    def _travels(self) -> BoolArray:
        """Return which end points differ from their start points, shape (n,)."""
        gone = np.abs(self.rows[:, POINT] - self._start).max(axis=1)
        return np.asarray((gone > _SAME) | self._arc)

    def _starts(self) -> FloatArray:
        """Return the start points of the motions, in the same coordinates as their ends."""
        points = self._before[:, POINT].copy()
        was, now = self._before[:, AXES] != 0.0, self.rows[:, AXES] != 0.0
        to_tips, to_axes = was & ~now, ~was & now
        if to_tips.any():
            before = self._before[to_tips]
            points[to_tips] = self._tips(points[to_tips], before[:, ROTARY], before[:, EXTRA])
        if to_axes.any():
            linear = self._geometry.linear(points[to_axes], self._before[to_axes, ROTARY])
            points[to_axes] = linear - self._zero - self._before[to_axes, EXTRA] @ self._along
        return points

    def _tips(self, points: FloatArray, rotary: FloatArray, extra: FloatArray) -> FloatArray:
        """Tool tips of axis positions, of the rotary axes and of U V W [m], shape (m, 3)."""
        stands = points + extra @ self._along
        if np.isnan(rotary).all():  # a machine without rotary axes
            return np.asarray(stands)
        return self._geometry.forward(np.concatenate([stands + self._zero, rotary], axis=1))[0]

    def extra(self, row: IntArray, u: FloatArray) -> FloatArray:
        """Return positions of U V W at shares of motions, shape (m, 3) [m]."""
        start, end = self._before[row, EXTRA], self.rows[row, EXTRA]
        return np.where((u == 1.0)[:, None], end, start + u[:, None] * (end - start))

    def rotary(self, row: IntArray, u: FloatArray) -> FloatArray:
        """
        Return rotary positions on motions.

        Parameters
        ----------
        row : ndarray of int, shape (m,)
            Indices of the motions.
        u : ndarray, shape (m,)
            Parameters in [0, 1].

        Returns
        -------
        ndarray, shape (m, 2)
            Rotary positions [rad].

        """
        at = self._before[row, ROTARY] + u[:, None] * self.sweep[row]
        return np.where((u == 1.0)[:, None], self.rows[row, ROTARY], at)

    def poses(self, row: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return poses on motions.

        Parameters
        ----------
        row : ndarray of int, shape (m,)
            Indices of the motions.
        u : ndarray, shape (m,)
            Parameters in [0, 1].

        Returns
        -------
        tip, axis : ndarray, shape (m, 3)
            Tool tips [m] and unit tool axes [-].

        """
        end, point, final = self.rows[row], self._points(row, u), u == 1.0
        rotary = self.rotary(row, u)
        by_axes = self._by_axes[row]
        if by_axes.any():
            extra = self.extra(row[by_axes], u[by_axes])
            point[by_axes] = self._tips(point[by_axes], rotary[by_axes], extra)
        axis = end[:, AXIS].copy()
        between = ~final
        circle = between & (end[:, GREAT_CIRCLE] != 0.0)
        axis[circle] = great_circle(self.axis_before[row[circle]], end[circle, AXIS], u[circle])
        linear = between & (end[:, GREAT_CIRCLE] == 0.0)
        if linear.any():
            axis[linear] = self._geometry.tool_axis(rotary[linear])
        return point, axis

    def _points(self, row: IntArray, u: FloatArray) -> FloatArray:
        """Return points on lines and arcs, in the coordinates of their ends, shape (m, 3) [m]."""
        end, start, arc = self.rows[row], self._start[row], self._arc[row]
        point = start + u[:, None] * (end[:, POINT] - start)
        if arc.any():
            on_arc = end[arc]
            point[arc] = arcs.points_on(
                start[arc], on_arc[:, POINT], on_arc[:, CENTRE], on_arc[:, NORMAL],
                on_arc[:, SWEEP], u[arc],
            )  # fmt: skip
        final = u == 1.0
        point[final] = end[final, POINT]
        return np.asarray(point)

    def chordal(self, row: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """
        Return what a chord must be near to: poses, or points where rotary axes run linearly.

        The tip deviates from a chord in the axes as much as X Y Z do, because the rotary axes of
        both are the same. The parameters are those of ``poses``.
        """
        tip, axis = self.poses(row, u)
        linear = self.interpolation[row] != POSES
        if linear.any():
            tip[linear] = self._points(row[linear], u[linear])
            axis[linear] = (0.0, 0.0, 1.0)
        return tip, axis

    def curved(self) -> BoolArray:
        """Return which motions must be divided: what they interpolate is no line, shape (n,)."""
        turns = (np.abs(self.sweep).max(axis=1) > _SAME) & (self.rows[:, GREAT_CIRCLE] == 0.0)
        # A rotation with the tip at rest stays whole, because only the rotary axes move.
        turns &= (self.interpolation == POSES) & self._travels()
        return np.asarray(self._arc | turns)

    def speeds(self) -> tuple[FloatArray, FloatArray]:
        """
        Return feedrate and duration of the motions; one of both is NaN.

        If axis positions are programmed and rotary axes turn, F is the speed of X Y Z. If the
        rotary axes turn alone, F is their speed. The duration follows from it. Where the rotary
        axes run linearly beside the tip, the duration follows from its speed.

        Returns
        -------
        feedrate, duration : ndarray, shape (n,)
            Speed of the tip [m/s], and time [s].

        """
        feedrate, duration = self.rows[:, FEEDRATE].copy(), self.rows[:, DURATION].copy()
        turning = (self.rows[:, AXES] != 0.0) & (np.abs(self.sweep).max(axis=1) > _SAME)
        turning |= self.interpolation == ROTARY_LINEAR
        row = np.flatnonzero(turning & np.isfinite(feedrate))
        if len(row):
            way = np.linalg.norm(self.rows[row, POINT] - self._start[row], axis=1)
            arc = row[self._arc[row]]
            rows = self.rows[arc]
            way[self._arc[row]] = arcs.lengths(
                self._start[arc], rows[:, POINT], rows[:, CENTRE], rows[:, NORMAL], rows[:, SWEEP]
            )
            angle = np.linalg.norm(self.sweep[row], axis=1)
            alone = way <= _SAME
            duration[row] = np.where(alone, angle / self.rows[row, TURN_RATE], way / feedrate[row])
            feedrate[row] = nan
        return feedrate, duration


def _portions(before: FloatArray, rows: FloatArray) -> list[slice]:
    """Divide a batch into parts that do not give too many blocks each."""
    turned = np.nan_to_num(np.abs(rows[:, SWEEP]))
    turned += np.nan_to_num(np.abs(rows[:, ROTARY] - before[:, ROTARY])).sum(axis=1)
    portion = np.floor(np.cumsum(turned) / _MOST_TURN)
    edges = [0, *(np.flatnonzero(np.diff(portion)) + 1).tolist(), len(rows)]
    return [slice(first, last) for first, last in pairwise(edges)]


def _merge_repeated(rows: FloatArray) -> FloatArray:
    """Drop rows without motion; their exact stops are moved to the row before."""
    # Row 0 is always kept: it begins the program, or the batch before held it back.
    same = np.zeros(len(rows), dtype=np.bool_)
    same[1:] = _moves_nothing(rows[:-1], rows[1:])
    if not same.any():
        return rows
    first = np.flatnonzero(~same)
    kept = rows[first]
    kept[:, EXACT_STOP] = np.maximum.reduceat(rows[:, EXACT_STOP], first)
    return kept


def _moves_nothing(rows: FloatArray, following: FloatArray) -> BoolArray:
    """Return which following rows do not move from the row before, shape (n,)."""
    change = np.abs(following[:, : ROTARY.stop] - rows[:, : ROTARY.stop])
    still = (change[:, POINT].max(axis=1) <= _SAME) & (change[:, AXIS].max(axis=1) <= _SAME)
    on_circle = following[:, GREAT_CIRCLE] != 0.0
    still &= on_circle | ~(change[:, ROTARY].max(axis=1) > _SAME)
    still &= np.isnan(following[:, SWEEP])
    still &= ~(np.abs(following[:, EXTRA] - rows[:, EXTRA]).max(axis=1) > _SAME)
    # Equal numbers mean nothing if one row has tool tips and the other axis positions.
    same_terms = following[:, AXES] == rows[:, AXES]
    at_zero = np.abs(rows[:, ROTARY]).max(axis=1) == 0.0
    at_zero &= np.abs(rows[:, EXTRA]).max(axis=1) == 0.0
    return np.asarray(still & (same_terms | at_zero))
