"""Motions between target rows: which coordinates move linearly, and the poses on each motion."""

from __future__ import annotations

from copy import copy
from math import nan
from typing import NamedTuple

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import AXES_LINEAR, POSES, ROTARY_LINEAR
from cnc_interp.program.geometry import arcs
from cnc_interp.program.geometry import target_row as col
from cnc_interp.program.geometry.subdivide import Poses, angle_between, great_circle, piece_counts
from cnc_interp.settings.options import Settings

SAME = 1e-12  # [m], [-], [rad]
#: Share of the tolerances for the deviation of chords and great circles from the motion [-].
CHORD_SHARE = 0.1
#: Nearer to the pole than this many orientation tolerances, a smooth path could pass it on
#: the other side.
POLE_TOLERANCES = 4.0
#: Without tool-tip programming, lines in axes become curves of poses after FEWEST_DENSE short
#: blocks in a row, if the tip moves more than SLOW_TIP times the turn at flank height [-].
FEWEST_DENSE, SLOW_TIP = 32, 0.05
BESIDE_ARC = 8  #: A short line has the tolerance of an arc at most this many motions away.

FARTHEST = 1000  #: Largest number of motions joined with a later one near the pole.


class Preceding(NamedTuple):
    """Properties of earlier motions that affect the interpolation of the next ones."""

    dense: int = 0  #: Number of dense motions at the end, at most FEWEST_DENSE.
    led: bool = False  #: Whether the last motion is ROTARY_LINEAR.
    since_arc: int = BESIDE_ARC  #: Number of motions since an arc, at most BESIDE_ARC.


NOTHING_BEFORE = Preceding()


class Moves:
    """Motions between consecutive targets; their poses can be computed at any parameter in [0, 1].

    ``interpolation`` (n,): as in ``Blocks``; in the last ``undecided`` motions it depends on later
    motions. ``beside`` (n,): whether extra axes move and rotary axes do not. ``rests`` (n,):
    whether the rotary axes turn while the tip stands still. ``beside_arcs`` (n,): whether a motion
    is an arc, or a short line near one.
    """

    def __init__(
        self,
        geometry: Transform,
        zero: FloatArray,
        before: FloatArray,
        rows: FloatArray,
        settings: Settings,
        preceding: Preceding = NOTHING_BEFORE,
        coming: FloatArray | None = None,
    ):
        self._geometry, self._zero, self._before, self.rows = geometry, zero, before, rows
        (self.dense, self.led, self.since_arc), self.undecided = preceding, 0
        self.sweep = np.nan_to_num(rows[:, col.ROTARY] - before[:, col.ROTARY])
        self.axis_before = before[:, col.AXIS]
        self._along = col.extra_directions(geometry.machine)
        self._start = self._starts()
        self._arc = np.isfinite(rows[:, col.SWEEP])
        # If the tool length turns with the tool, the programmed tip moves on lines and arcs.
        self._length = rows[:, col.LENGTH]
        self._turns_length = self._length != 0.0
        self._turns_length &= np.abs(rows[:, col.AXIS] - self.axis_before).max(axis=1) > SAME
        # Axis positions and tool tips are equal while the rotary axes are at zero.
        turned = (np.abs(rows[:, col.ROTARY]) > 0.0) | (np.abs(before[:, col.ROTARY]) > 0.0)
        beside = (rows[:, col.EXTRA] != 0.0) | (before[:, col.EXTRA] != 0.0)
        turned = turned.any(axis=1) | beside.any(axis=1)
        self._by_axes = (rows[:, col.AXES] != 0.0) & turned
        self.interpolation = self._interpolation(settings)
        coming = rows[:0] if coming is None else coming
        self.beside_arcs = self._beside_arcs(np.isfinite(coming[:, col.SWEEP]), settings)

    @property
    def preceding(self) -> Preceding:
        """Return the properties of these motions that affect later ones."""
        return Preceding(self.dense, self.led, self.since_arc)

    def __getitem__(self, part: slice) -> Moves:
        some = copy(self)
        for name in (
            '_before',
            'rows',
            'sweep',
            'axis_before',
            '_start',
            '_arc',
            '_by_axes',
            '_length',
            '_turns_length',
            'interpolation',
            'beside',
            'rests',
            'beside_arcs',
        ):
            setattr(some, name, getattr(self, name)[part])
        return some

    def _interpolation(self, settings: Settings) -> IntArray:
        """Return the interpolation of each motion, (n,); dense short lines become POSES."""
        rows, cuts = self.rows, self.rows[:, col.RAPID] == 0.0
        linear = rows[:, col.GREAT_CIRCLE] == 0.0
        turns = (np.abs(self.sweep).max(axis=1) > SAME) & linear
        step = rows[:, col.EXTRA] - self._before[:, col.EXTRA]  # of U V W
        drifts = (np.abs(step) > SAME).any(axis=1) & ~turns
        drifts &= np.isfinite(rows[:, col.ROTARY]).all(axis=1)
        self.beside = drifts & (rows[:, col.AXES] != 0.0)
        kind = np.where(turns & (rows[:, col.AXES] != 0.0) | self.beside, AXES_LINEAR, POSES)
        # With tool-tip programming, directions give the rotary axes unless the pole is near.
        self.rests = turns & (kind == POSES) & ~self._travels()
        words = np.flatnonzero(turns & (kind == POSES) & ~self.rests)
        drifts &= np.isfinite(self._before[:, col.ROTARY]).all(axis=1) & linear
        drifts &= (kind == POSES) & self._travels()
        if len(words) or drifts.any():
            kind[self._ruled_by_words(words, drifts, settings)] = ROTARY_LINEAR
        self.led = bool(kind[-1] == ROTARY_LINEAR) if len(rows) else self.led
        if settings.compress:
            like = (kind == POSES) & cuts & self._travels()
            short = np.flatnonzero((kind == AXES_LINEAR) & cuts & ~self._arc)
            if len(short):
                like[short[self._like_poses(short, settings)]] = True
            row = np.arange(len(rows))
            broken = np.maximum.accumulate(np.where(like, -1, row))
            count = row - broken + np.where(broken < 0, self.dense, 0)
            kind[like & (count > FEWEST_DENSE)] = POSES
            self.dense = int(min(count[-1], FEWEST_DENSE)) if len(rows) else self.dense
        return kind

    def _ruled_by_words(self, words: IntArray, drifts: BoolArray, settings: Settings) -> BoolArray:
        """Return in which motions the rotary axes move linearly to programmed positions, (n,).

        These are motions near the pole, and those of ``words`` and ``drifts`` that join them.
        """
        near = np.zeros(len(self.rows), dtype=np.bool_)
        near[words] = self._near_pole(words, settings.flank_height)
        joins = near | drifts
        joins[words[~self._short(words, settings)]] = True
        # A chain is a row of motions that can be joined; a rest ends it.
        chain = np.cumsum(~joins | (self._before[:, col.EXACT_STOP] != 0.0))
        row = np.arange(len(joins))
        first = np.full(chain[-1] + 1, len(joins) + FARTHEST)
        np.minimum.at(first, chain[near], row[near])
        first[0] = 0 if self.led else first[0]
        ruled = joins & (row >= first[chain] - FARTHEST)
        if joins[-1] and not ruled[-1] and self.rows[-1, col.EXACT_STOP] == 0.0:
            self.undecided = min(int((joins & (chain == chain[-1])).sum()), FARTHEST)
        return np.asarray(ruled)

    def _near_pole(self, row: IntArray, height: float) -> BoolArray:
        """Return which motions come so near the pole that rotary words must be followed, (m,)."""
        cone = POLE_TOLERANCES * self.rows[row, col.ORIENTATION] / height
        ends = self._before[row, col.ROTARY], self.rows[row, col.ROTARY]
        near = self._geometry.five_axis.nearest_to_pole(*ends)
        return np.asarray(near < np.maximum(cone, self._geometry.machine.singular_cone))

    def _like_poses(self, row: IntArray, settings: Settings) -> BoolArray:
        """Return which short lines in axes deviate little enough from lines of poses, (m,)."""
        height = settings.flank_height
        fits = self._short(row, settings)
        fits &= self.beside[row] | ~self._near_pole(row, height)
        some = row[fits]
        if len(some):
            turned = np.abs(self.sweep[some]).sum(axis=1)
            fits[fits] = self.pieces(some, turned, self.poses, height) == 1
        return np.asarray(fits)

    def pieces(self, row: IntArray, turned: FloatArray, poses: Poses, height: float) -> IntArray:
        """Return into how many pieces, (m,), turning motions are divided to stay near chords."""
        tip, top = CHORD_SHARE * self.rows[row][:, [col.CONTOUR, col.ORIENTATION]].T
        return piece_counts(lambda block, u: poses(row[block], u), turned, tip, top, height)

    def _short(self, row: IntArray, settings: Settings) -> BoolArray:
        """Return which motions are short moves of the tip, not mere turns, shape (m,)."""
        (tip_from, o_from), (tip, o) = (self.poses(row, np.full(len(row), u)) for u in (0.0, 1.0))
        way = np.linalg.norm(tip - tip_from, axis=1)
        turn = settings.flank_height * angle_between(o_from, o)
        longest = self._geometry.machine.scale * settings.longest_block
        return np.asarray((way <= longest) & (way > SLOW_TIP * turn))

    def _travels(self) -> BoolArray:
        gone = np.abs(self.rows[:, col.POINT] - self._start).max(axis=1)
        return np.asarray((gone > SAME) | self._arc)

    def _starts(self) -> FloatArray:
        points = self._before[:, col.POINT].copy()
        was, now = self._before[:, col.AXES] != 0.0, self.rows[:, col.AXES] != 0.0
        to_tips, to_axes = was & ~now, ~was & now
        if to_tips.any():
            rotary, extra = (self._before[to_tips, column] for column in (col.ROTARY, col.EXTRA))
            points[to_tips] = self._tips(points[to_tips], rotary, extra)
        if to_axes.any():
            linear = self._geometry.linear(points[to_axes], self._before[to_axes, col.ROTARY])
            points[to_axes] = linear - self._zero - self._before[to_axes, col.EXTRA] @ self._along
        return points

    def _tips(self, points: FloatArray, rotary: FloatArray, extra: FloatArray) -> FloatArray:
        stands = points + extra @ self._along
        if np.isnan(rotary).all():  # a machine without rotary axes
            return np.asarray(stands)
        return self._geometry.forward(np.concatenate([stands + self._zero, rotary], axis=1))[0]

    def extra(self, row: IntArray, u: FloatArray) -> FloatArray:
        start, end = self._before[row, col.EXTRA], self.rows[row, col.EXTRA]
        return np.where((u == 1.0)[:, None], end, start + u[:, None] * (end - start))

    def rotary(self, row: IntArray, u: FloatArray) -> FloatArray:
        at = self._before[row, col.ROTARY] + u[:, None] * self.sweep[row]
        return np.where((u == 1.0)[:, None], self.rows[row, col.ROTARY], at)

    def poses(self, row: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tips [m] and unit tool axes [-] of motions ``row`` at ``u`` in [0, 1], (m, 3)."""
        point, rotary = self._points(row, u), self.rotary(row, u)
        by_axes = self._by_axes[row]
        if by_axes.any():
            extra = self.extra(row[by_axes], u[by_axes])
            point[by_axes] = self._tips(point[by_axes], rotary[by_axes], extra)
        return point, self._axes(row, u, rotary)

    def _axes(self, row: IntArray, u: FloatArray, rotary: FloatArray) -> FloatArray:
        end = self.rows[row]
        axis = end[:, col.AXIS].copy()
        between = u != 1.0
        circle = between & (end[:, col.GREAT_CIRCLE] != 0.0)
        axis[circle] = great_circle(self.axis_before[row[circle]], axis[circle], u[circle])
        linear = between & (end[:, col.GREAT_CIRCLE] == 0.0)
        if linear.any():
            axis[linear] = self._geometry.tool_axis(rotary[linear])
        return axis

    def _line_ends(self, row: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return start, end and centre of the moving point of lines or arcs, (m, 3) each [m]."""
        end, length = self.rows[row], (self._length * self._turns_length)[row, None]
        before = length * self.axis_before[row]
        last = end[:, col.POINT] - length * end[:, col.AXIS]
        return self._start[row] - before, last, end[:, col.CENTRE] - before

    def _points(self, row: IntArray, u: FloatArray) -> FloatArray:
        end, arc = self.rows[row], self._arc[row]
        start, last, centre = self._line_ends(row)
        point = start + u[:, None] * (last - start)
        if arc.any():
            shape = end[arc, col.NORMAL], end[arc, col.SWEEP]
            point[arc] = arcs.points_on(start[arc], last[arc], centre[arc], *shape, u[arc])
        if (turns := self._turns_length[row]).any():
            axis = self._axes(row[turns], u[turns], self.rotary(row[turns], u[turns]))
            point[turns] += self._length[row[turns], None] * axis
        final = u == 1.0
        point[final] = end[final, col.POINT]
        return np.asarray(point)

    def chordal(self, row: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return tips and axes; if rotary axes move linearly, moving points and constant axes."""
        tip, axis = self.poses(row, u)
        linear = self.interpolation[row] != POSES
        if linear.any():
            tip[linear] = self._points(row[linear], u[linear])
            axis[linear] = (0.0, 0.0, 1.0)
        return tip, axis

    def curved(self) -> BoolArray:
        """Return which motions are curved and must be divided into lines, shape (n,)."""
        turns = (np.abs(self.sweep).max(axis=1) > SAME) & (self.rows[:, col.GREAT_CIRCLE] == 0.0)
        # A rotation with the tip at rest stays whole, because only the rotary axes move.
        turns &= (self.interpolation == POSES) & self._travels()
        return np.asarray(self._arc | turns | self._turns_length)

    def _beside_arcs(self, coming: BoolArray, settings: Settings) -> BoolArray:
        count, arc = len(self._arc), np.concatenate([self._arc, coming])
        row = np.arange(len(arc))
        last = np.maximum.accumulate(np.where(arc, row, -1 - self.since_arc))
        following = np.where(arc, row, len(row) + BESIDE_ARC)
        following = np.minimum.accumulate(following[::-1])[::-1]
        near = (np.minimum(row - last, following - row) <= BESIDE_ARC)[:count]
        near &= ~self._arc & (self.rows[:, col.RAPID] == 0.0)
        lines = np.flatnonzero(near)
        near[lines] = self._short(lines, settings) if len(lines) else False
        if count:
            self.since_arc = int(min(count - 1 - last[count - 1], BESIDE_ARC))
        return np.asarray(self._arc | near)

    def speeds(self) -> tuple[FloatArray, FloatArray]:
        """Return feedrate [m/s] and duration [s] of the motions, (n,); one of the two is NaN.

        For axis positions, F is the speed of X Y Z if they move, else of the extra axes, else of
        the rotary axes. With ``COMBINED`` it is the speed of all axes.
        """
        feedrate, duration = self.rows[:, col.FEEDRATE].copy(), self.rows[:, col.DURATION].copy()
        turning = (self.rows[:, col.AXES] != 0.0) & (np.abs(self.sweep).max(axis=1) > SAME)
        turning |= (self.interpolation == ROTARY_LINEAR) | self.beside | self._turns_length
        row = np.flatnonzero(turning & np.isfinite(feedrate))
        if len(row):
            start, last, _ = self._line_ends(row)
            way = np.linalg.norm(last - start, axis=1)
            arc = row[self._arc[row]]
            shape = (self.rows[arc, column] for column in (col.NORMAL, col.SWEEP))
            way[self._arc[row]] = arcs.lengths(*self._line_ends(arc), *shape)
            more = np.flatnonzero(self.beside[row] & ~self._arc[row])
            step = (self.rows[:, col.EXTRA] - self._before[:, col.EXTRA])[row[more]]
            tip = self.rows[row[more], col.POINT] - self._start[row[more]] + step @ self._along
            way[more] = np.maximum(np.linalg.norm(tip, axis=1), np.linalg.norm(step, axis=1))
            angle = np.linalg.norm(self.sweep[row], axis=1)
            by_direction = (angle <= SAME) & self._turns_length[row]
            directions = self.axis_before[row], self.rows[row, col.AXIS]
            angle[by_direction] = angle_between(*directions)[by_direction]
            turning = angle / self.rows[row, col.TURN_RATE]
            alone = np.where(way <= SAME, turning, way / feedrate[row])
            combined = self.rows[row, col.AXES] == col.COMBINED
            duration[row] = np.where(combined, np.hypot(way / feedrate[row], turning), alone)
            feedrate[row] = nan
        return feedrate, duration


def merge_repeated(rows: FloatArray) -> FloatArray:
    # Row 0 is always kept: it begins the program, or the batch before held it back.
    same = np.zeros(len(rows), dtype=np.bool_)
    same[1:] = _moves_nothing(rows[:-1], rows[1:])
    if not same.any():
        return rows
    first = np.flatnonzero(~same)
    kept = rows[first]
    kept[:, col.EXACT_STOP] = np.maximum.reduceat(rows[:, col.EXACT_STOP], first)
    return kept


def _moves_nothing(rows: FloatArray, following: FloatArray) -> BoolArray:
    change = np.abs(following[:, : col.ROTARY.stop] - rows[:, : col.ROTARY.stop])
    still = (change[:, col.POINT].max(axis=1) <= SAME) & (change[:, col.AXIS].max(axis=1) <= SAME)
    on_circle = following[:, col.GREAT_CIRCLE] != 0.0
    still &= on_circle | ~(change[:, col.ROTARY].max(axis=1) > SAME)
    still &= np.isnan(following[:, col.SWEEP])
    still &= ~(np.abs(following[:, col.EXTRA] - rows[:, col.EXTRA]).max(axis=1) > SAME)
    # Equal numbers mean nothing if one row has tool tips and the other axis positions.
    same_terms = following[:, col.AXES] == rows[:, col.AXES]
    at_zero = np.abs(rows[:, col.ROTARY]).max(axis=1) == 0.0
    at_zero &= np.abs(rows[:, col.EXTRA]).max(axis=1) == 0.0
    return np.asarray(still & (same_terms | at_zero))
