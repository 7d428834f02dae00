"""The skeleton of the program: its significant vertices and corners, found while blocks arrive."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from cnc_interp.core import BoolArray, FloatArray, IntArray, dot, norm
from cnc_interp.program.blocks import Blocks
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.dense import thinning
from cnc_interp.smoothing.dense.path_rows import STANDSTILL
from cnc_interp.smoothing.dense.thinning import FIXED, LONG, SHORT, Vertices
from cnc_interp.smoothing.orientation import rotations_between

#: Poses of a curve with a smaller difference count as one pose [m]; each step is judged alone.
REPEATED = 0.1 * STANDSTILL
LONGEST = 500.0  #: A block longer than this always stays a straight line [tolerances].
#: Smallest movement of the tip on a curve, as part of the movement of the top [-].
LEAST_TIP = 0.02


@dataclass
class Skeleton:
    """The vertices of the skeleton, one row each. The segment of a row ends at its vertex."""

    #: Programmed data at the vertices; a feed covers all rows that a line replaces.
    blocks: Blocks
    top: FloatArray  #: (n, 3): Top points: points on the tool axis at flank height [m].
    row: IntArray  #: (n,): Program row of each vertex.
    #: (n, 2): Contour and orientation deviation of the segment from the rows it replaces [m].
    used: FloatArray
    feed: FloatArray  #: (n,): Programmed speed of the tip on the segment [m/s].
    turning: BoolArray  #: (n,): Whether the tool turns on the segment.
    kind: IntArray  #: (n,): Kind of the segment: SHORT, LONG or FIXED.
    #: (n,): Whether the tool rests at the vertex, and whether the program ends every curve at it.
    stop: BoolArray
    closed: BoolArray
    corner: BoolArray  #: (n,): Whether a corner at the vertex ends curves.
    #: (n,): Curve parameter: distance along tip and top, root mean square of both [m].
    u: FloatArray
    turn: FloatArray  #: (n,): Turn of the path at the vertex, if already known [rad].

    def __len__(self) -> int:
        return len(self.row)

    def join(self, other: Skeleton) -> Skeleton:
        return Skeleton(
            Blocks.concatenate([self.blocks, other.blocks]),
            *(
                np.concatenate([getattr(self, field.name), getattr(other, field.name)])
                for field in fields(self)[1:]
            ),
        )

    def after(self, first: int) -> Skeleton:
        return Skeleton(*(getattr(self, field.name)[first:] for field in fields(self)))

    @cached_property
    def tolerance(self) -> FloatArray:
        """Return contour and orientation tolerance of each segment, shape (n, 2) [m]."""
        return np.stack([self.blocks.contour_tolerance, self.blocks.orientation_tolerance], axis=1)

    @cached_property
    def narrow(self) -> FloatArray:
        """Return the smallest tolerances of each segment and of those beside it, (n, 2) [m]."""
        own = self.tolerance
        narrow = own.copy()
        narrow[1:] = np.minimum(narrow[1:], own[:-1])
        narrow[:-1] = np.minimum(narrow[:-1], own[1:])
        return narrow

    @cached_property
    def vertices(self) -> Vertices:
        """Return the arrays that kernels read; they include later changes of marks."""
        pose = np.hstack([self.blocks.tip, self.blocks.axis])
        return Vertices(
            pose,
            self.top,
            self.u,
            self.used,
            self.tolerance,
            self.narrow,
            self.feed,
            self.row,
            self.blocks.line_number,
            self.kind,
            self.turning,
            self.closed,
            self.corner,
        )


class SkeletonBuilder:
    def __init__(self, settings: Settings, scale: float, row: int, joined: bool):
        self._longest_block, self._height = scale * settings.longest_block, settings.flank_height
        self._raw: Blocks | None = None  # blocks from the last vertex of the skeleton on
        self._row = row  # program row of the first of them
        self._joined = joined
        self.skeleton: Skeleton | None = None

    def push(self, blocks: Blocks | None, final: bool, joined: bool = False) -> None:
        """Add blocks; if a native spline follows (``joined``), the last block stays a line."""
        known = [part for part in (self._raw, blocks) if part is not None]
        if not known:
            return
        raw = Blocks.concatenate(known)
        height, n = self._height, len(raw)
        tolerance = np.stack([raw.contour_tolerance, raw.orientation_tolerance], axis=1)
        top = raw.tip + height * raw.axis
        if self.skeleton is None:
            self.skeleton = self._start(raw, top)
        kind, stop, closed = self._marks(raw, top, final, joined)
        must = stop | closed | (kind != SHORT)
        # A line of the skeleton replaces only rows with equal tolerances.
        must[:-1] |= (kind[1:] != SHORT) | (tolerance[:-1] != tolerance[1:]).any(axis=1)
        # The kind of a vertex is known only when the block after it is known.
        m = n if final else n - 1
        kept, used = thinning.select_vertices(raw.tip[:m], top[:m], tolerance[:m], must[:m])
        self._raw = raw
        if len(kept):
            self._append(raw, top, kept, used, kind, stop, closed)
            self._raw = raw[int(kept[-1]) :]
            self._row += int(kept[-1])

    def _start(self, raw: Blocks, top: FloatArray) -> Skeleton:
        yes, no = np.ones(1, dtype=bool), np.zeros(1, dtype=bool)
        return Skeleton(
            raw[:1],
            top[:1],
            np.array([self._row]),
            np.zeros((1, 2)),
            np.full(1, np.inf),
            no,
            np.full(1, FIXED),
            yes,
            yes.copy(),
            no.copy(),
            np.zeros(1),
            np.zeros(1),
        )

    def _marks(
        self, raw: Blocks, top: FloatArray, final: bool, joined: bool
    ) -> tuple[IntArray, BoolArray, BoolArray]:
        """Return the columns kind, stop and closed of the rows (see ``Skeleton``), shape (n,)."""
        height = self._height
        length = norm(np.diff(raw.tip, axis=0))
        # A block whose rotary axes run linearly stays a line, and its tool axis does not count.
        linear = raw.by_rotary[1:]
        turn = norm(rotations_between(raw.axis[:-1], raw.axis[1:]))
        turn[linear] = 0.0
        reversed_axis = dot(raw.axis[:-1], raw.axis[1:]) < -0.99
        words = np.isfinite(raw.rotary).all(axis=1)
        rotary = np.where(words[:, None], raw.rotary, 0.0)
        spin = np.where(words[1:] & words[:-1], np.abs(np.diff(rotary, axis=0)).max(axis=1), 0.0)
        tolerance = raw.orientation_tolerance[1:]
        # On the pole rotary axes turn, though the tool axis hardly does: such a turn is no rest.
        spins = (spin > 1e-9) & ((turn < 1e-12) | (height * spin > tolerance))
        # A block that moves an extra axis stays a line: curves exist only where those axes rest.
        beside = (np.diff(raw.extra, axis=0) != 0.0).any(axis=1)
        resting = length < STANDSTILL
        resting &= (height * turn > thinning.DROP * tolerance) | spins | beside
        resting &= ~linear
        kind = np.full(len(raw), SHORT)
        narrow = np.minimum(raw.contour_tolerance, raw.orientation_tolerance)[1:]
        kind[1:][length > np.minimum(self._longest_block, LONGEST * narrow)] = LONG
        fixed = resting | beside | linear | raw.rapid[1:] | reversed_axis
        kind[1:][fixed] = FIXED
        if self._joined and self.skeleton is not None and len(self.skeleton) == 1:
            kind[1:2] = FIXED
        if joined:
            kind[1:][-1:] = FIXED
        stop = raw.exact_stop.copy()
        stop[1:][resting] = True
        stop[:-1][resting] = True
        closed = kind == FIXED
        closed[:-1] |= kind[1:] == FIXED
        if final:
            stop[-1] = True
        return kind, stop, closed | stop

    def _append(
        self,
        raw: Blocks,
        top: FloatArray,
        kept: IntArray,
        used: FloatArray,
        kind: IntArray,
        stop: BoolArray,
        closed: BoolArray,
    ) -> None:
        assert self.skeleton is not None
        skeleton = self.skeleton
        # The block after row 0 may have changed its marks.
        skeleton.stop[-1] |= stop[0]
        skeleton.closed[-1] |= closed[0] | stop[0]
        # The marks of a repeated point belong to the point before it.
        before = np.concatenate([[0], kept[:-1]])
        step = np.abs(raw.tip[kept] - raw.tip[before]).max(axis=1)
        step = np.maximum(step, np.abs(top[kept] - top[before]).max(axis=1))
        repeated = (step < REPEATED) & (kind[kept] != FIXED)
        feed = self._feeds(raw, before, kept)
        if repeated.any():
            for k in np.flatnonzero(repeated)[::-1]:
                if k == 0:
                    skeleton.stop[-1] |= stop[kept[0]]
                    skeleton.closed[-1] |= closed[kept[0]]
                else:
                    stop[kept[k - 1]] |= stop[kept[k]]
                    closed[kept[k - 1]] |= closed[kept[k]]
            kept, before, used, feed = (x[~repeated] for x in (kept, before, used, feed))
            if not len(kept):
                return
        tip_step, top_step = raw.tip[kept] - raw.tip[before], top[kept] - top[before]
        length, top_length = norm(tip_step), norm(top_step)
        kind, stop, closed = kind[kept], stop[kept], closed[kept]
        # Small steps with the tip at rest may add up to a rotation.
        slow = (kind == SHORT) & (length < LEAST_TIP * top_length)
        resting = slow & (length < STANDSTILL) & (top_length > STANDSTILL)
        kind = np.where(slow, FIXED, kind)
        closed = closed | slow
        stop = stop | resting
        if slow[0]:
            skeleton.closed[-1] = True
        if resting[0]:
            skeleton.stop[-1] = True
        closed[:-1] |= slow[1:]
        stop[:-1] |= resting[1:]
        moving = (length >= STANDSTILL) & ~raw.by_rotary[kept]
        timed = np.isfinite(raw.duration[kept])
        turning = norm(rotations_between(raw.axis[before], raw.axis[kept])) > 0.0
        rows = raw[kept]
        blocks = replace(
            rows,
            feedrate=np.where(moving & timed, feed, rows.feedrate),
            duration=np.where(moving, np.nan, rows.duration),
        )
        du = np.sqrt(0.5 * (length**2 + top_length**2))
        u = np.cumsum(np.concatenate([skeleton.u[-1:], du]))[1:]
        nothing = np.zeros(len(kept))
        more = Skeleton(
            blocks,
            top[kept],
            self._row + kept,
            used,
            feed,
            turning,
            kind,
            stop,
            closed | stop,
            np.zeros(len(kept), dtype=bool),
            u,
            nothing,
        )
        self.skeleton = skeleton.join(more)

    def _feeds(self, raw: Blocks, before: IntArray, kept: IntArray) -> FloatArray:
        """Return distance / time of the rows between vertices, shape (m,) [m/s].

        If all rows have the same feed F, the result is exactly F. The feed is never above F of the
        last row, because only that row may be longer than the tolerance.
        """
        length = np.concatenate([[0.0], norm(np.diff(raw.tip, axis=0))])
        timed = np.isfinite(raw.duration)
        feed = np.where(timed, length / np.where(timed, raw.duration, 1.0), raw.feedrate)
        time = np.where(timed, raw.duration, length / np.where(raw.feedrate > 0, raw.feedrate, 1))
        last = int(kept[-1]) + 1
        way = np.add.reduceat(length[:last], before + 1)
        spent = np.add.reduceat(time[:last], before + 1)
        low = np.minimum.reduceat(feed[:last], before + 1)
        high = np.maximum.reduceat(feed[:last], before + 1)
        mean = way / np.where(spent > 0.0, spent, 1.0)
        mean = np.minimum(mean, np.where(length[kept] > 0.0, feed[kept], np.inf))
        return np.asarray(np.where((low == high) | (spent <= 0.0), feed[kept], mean))


class CornerSearch:
    def __init__(self, angle: float):
        self._angle = angle
        self.turned = 0  # number of vertices whose turn is known
        self.decided = 0  # number of vertices that are known to be corners or not

    def decide(self, skeleton: Skeleton, final: bool) -> None:
        n, tolerance = len(skeleton), skeleton.tolerance
        # A repeated point that arrives later may still close the last vertex.
        closed = np.flatnonzero(skeleton.closed[: n if final else n - 1])
        known = int(closed[-1]) + 1 if len(closed) else 0
        widest = float(tolerance[self.decided :].max())
        turned = n
        if not final:
            seen = np.searchsorted(skeleton.u, skeleton.u[-1] - thinning.REACH * widest, 'right')
            turned = max(known, min(int(seen), n - 1), self.turned)
        if turned > self.turned:
            skeleton.turn[self.turned : turned] = thinning.vertex_turns(
                skeleton.blocks.tip,
                skeleton.top,
                skeleton.u,
                skeleton.closed,
                tolerance,
                self.turned,
                turned,
            )
        self.turned = turned
        decided = n
        if not final:
            last = skeleton.u[turned - 1] if turned else -np.inf
            seen = np.searchsorted(skeleton.u, last - thinning.CHORD * widest, 'left')
            decided = max(known, int(seen), self.decided)
        if decided > self.decided:
            skeleton.corner[self.decided : decided] |= thinning.find_corners(
                skeleton.turn[:turned],
                skeleton.u[:turned],
                skeleton.closed[:turned],
                tolerance[:turned],
                self._angle,
                self.decided,
                decided,
            )
        self.decided = decided

    def shift(self, first: int) -> None:
        self.turned -= first
        self.decided -= first
