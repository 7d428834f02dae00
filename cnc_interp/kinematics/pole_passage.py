"""
Passages of the pole: where a path of poses comes to the pole nearer than its tolerance.

Near the pole a turn of the outer rotary axis C hardly moves the tool axis, but a tool axis that
passes beside the pole asks C for almost half a turn. Here C is given instead. On a stretch of the
path around such a place, C is the septic of the path length that takes C and three derivatives of
both ends. The tilt follows from the tool axis (``guided_jets``) and may change its sign, so C
needs a quarter of a turn at most. The tool axis then deviates. On a straight pass at the distance
d, with x from -1 to 1 along the stretch, it deviates by ``d (1 - x^2)^4``: smooth in three
derivatives, and largest at the pole.

The deviation is bounded without gaps (``passage_bounds.py``). The longest stretch is taken whose
bound fits into what corners and curves leave of the orientation tolerance. A stretch is chosen
when the path after it is known so far that nothing later can change it. So the result does not
depend on how the segments arrive.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from math import comb

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.units import DEG, MM
from cnc_interp.kinematics.axis_path import septic_coefficients
from cnc_interp.kinematics.branch import branch_at
from cnc_interp.kinematics.passage_bounds import (
    TURN,
    gap_bounds,
    lengths_of,
    near_pole,
    place_at,
    pole_sine,
    rates_of,
    way_to,
)
from cnc_interp.kinematics.segment_axes import (
    BRANCH_AFTER,
    FOLLOWING,
    GUIDE,
    GUIDE_BEGUN,
    GUIDE_FROM,
    GUIDE_LENGTH,
    GUIDE_TO,
    NO_GUIDE,
    RESTING,
    beside_of,
    sample,
    shapes_of,
)
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.segments import CORNER, PathSegments

#: Longest way before and after the pole on which the outer axis is given [m].
REACH = 30.0 * MM
#: The path is at the pole where this share of its tolerance reaches it [-].
AT_POLE = 0.9
#: The sine of the angle to the pole of a tool axis that lies on it is smaller [-].
ON_POLE = 1e-9
#: Places on the path that are nearer together are the same [m].
SAME_PLACE = 1e-9
#: Between two cores that are passed together, the path is not farther from the pole than this [-].
FAR = 10.0
#: A stretch does not begin in a segment farther from the pole than this [rad].
WIDEST = 40.0 * DEG
#: Factor by which a stretch is shortened, and the shortest one [m].
SHORTER, SHORTEST = 0.8, 1e-7
#: How exact the bound of the deviation should be, over the tolerance that is left [-].
EXACT = 0.01
#: From coefficients of a polynomial of degree 6 to its Bezier values; its second row is that of 5.
TO_BEZIER = [
    np.array([[comb(j, k) / comb(n, k) for k in range(n + 1)] for j in range(n + 1)])
    for n in (6, 5)
]


@dataclass(frozen=True)
class Released:
    """
    Segments whose rotary axes are decided.

    Parameters
    ----------
    segments : PathSegments
        The segments. Their deviation counts the passages of the pole.
    motion : ndarray of int, shape (n,)
        How the rotary axes move.
    guides : ndarray, shape (n, 13)
        Where the outer axis is given.
    turn_first : ndarray, shape (n,)
        Position to which the outer axis turns at rest before a segment [rad], else NaN.

    """

    segments: PathSegments
    motion: IntArray
    guides: FloatArray
    turn_first: FloatArray


@dataclass(frozen=True)
class _Known:
    """Segments that are not released yet, and what is known of each."""

    motion: IntArray
    guides: FloatArray
    bound: FloatArray  # of the deviation [rad]
    turn_first: FloatArray
    shapes: FloatArray
    beside: FloatArray
    spans: FloatArray
    lengths: FloatArray
    near: FloatArray
    sine: FloatArray  # of the angle from the pole at its start
    rates: FloatArray

    def __getitem__(self, rows: slice) -> _Known:
        return _Known(*(getattr(self, column.name)[rows] for column in fields(self)))

    def and_more(self, more: _Known) -> _Known:
        """Append further segments."""
        names = [column.name for column in fields(self)]
        return _Known(*(np.concatenate([getattr(x, n) for x in (self, more)]) for n in names))


@dataclass(frozen=True)
class _Core:
    """
    Where the path is at the pole, by path length [m].

    Before or after it the tool may rest at the pole for long.
    """

    start: float
    end: float
    rests_before: bool = False
    rests_after: bool = False


@dataclass(frozen=True)
class _End:
    """One end of a stretch: segment, parameter, path length, and C with three derivatives."""

    segment: int
    u: float
    s: float
    jet: FloatArray
    branch: float
    tilt: float
    forbidden: bool = False  # whether travel keeps the tilt from changing its sign


@dataclass(frozen=True)
class _Stretch:
    """Where the outer axis is given, the bounds of the deviation [rad] and of C' [rad/m]."""

    left: _End
    right: _End
    guides: FloatArray
    rows: slice
    bounds: FloatArray
    turning: float
    begins: bool


class PolePassages:
    """
    Choose where the outer rotary axis is given, segment by segment.

    Parameters
    ----------
    transform : Transform
        The machine's five-axis transformation.
    height : float
        Flank height, at which the orientation tolerance counts [m].

    """

    def __init__(self, transform: Transform, height: float):
        self._transform, self._height = transform, height
        self._outer = transform.outer
        self._turn, self._branch, self._free = 0.0, 1.0, False
        self._segments: PathSegments | None = None
        self._known: _Known | None = None
        self._open = 0  # the first known segment in which a stretch may begin
        self._begins, self._stopped = True, True
        #: Source lines in which travel keeps the tilt from changing its sign.
        self.forbidden: list[int] = []

    def begin(self, rotary: FloatArray, branch: float, free: bool) -> None:
        """Begin at rotary positions [rad]; where ``free`` the outer axis may begin anywhere."""
        self._turn, self._branch, self._free = float(rotary[self._outer]), branch, free

    @property
    def notice(self) -> tuple[int, str] | None:
        """Where travel keeps the tilt from changing its sign: the first line, and a text."""
        if not self.forbidden:
            return None
        machine = self._transform.machine
        tilt, turn = machine.axes[4 - self._outer], machine.axes[3 + self._outer]
        low, high = (tilt.position_text(end) for end in tilt.travel)
        return min(self.forbidden), (
            f'the tool passes the pole, where {tilt.name} would change its sign; its travel of '
            f'{low} to {high} deg reaches less far there, so {turn.name} makes half a turn '
            f'instead and the motion slows down (passes: {len(self.forbidden)})'
        )

    def take(self, segments: PathSegments, motion: IntArray) -> Released:
        """
        Take further segments and return those that are decided.

        Parameters
        ----------
        segments : PathSegments
            The next segments.
        motion : ndarray of int, shape (n,)
            How their rotary axes move.

        """
        known = self._look_at(segments, motion)
        if self._known is not None and self._segments is not None:
            segments = PathSegments.concatenate([self._segments, segments])
            known = self._known.and_more(known)
        self._segments, self._known = segments, known
        free = self._open
        at, n = 0, len(segments)
        while at < n:
            if not self._with_poses(at):
                self._step_over(at)
                at += 1
                self._begins = True
                continue
            last = at + 1
            while last < n and not segments.stop[last - 1] and self._with_poses(last):
                last += 1
            closed = last < n or bool(segments.stop[last - 1])
            self._open = max(free, at)
            ready = self._pass(at, last, closed)
            if not closed:
                free = self._open
                self._begins = self._begins and ready == at
                at = ready
                break
            self._stopped, self._begins = bool(segments.stop[last - 1]), True
            at = last
        self._open = max(free - at, 0)
        taken = known[:at]
        if at:
            self._free = False
        self._segments, self._known = segments[at:], known[at:]
        released = segments[:at]
        deviation = released.deviation.copy()
        deviation[:, 1] += self._height * taken.bound
        return Released(
            replace(released, deviation=deviation), taken.motion, taken.guides, taken.turn_first
        )

    def _look_at(self, segments: PathSegments, motion: IntArray) -> _Known:
        """Find out what is needed of segments, and where they are near to the pole."""
        n, packed = len(segments), self._transform.packed
        shapes, beside, spans = shapes_of(segments), beside_of(segments), segments.parametrization
        rates = rates_of(segments)
        poses = segments.interpolation == POSES
        near, sine = np.tile([2.0, -1.0], (n, 1)), np.ones(n)
        lengths = np.zeros(n)
        rows = np.flatnonzero(poses)
        if len(rows):
            some = (segments.kind[rows], shapes[rows])
            lengths[rows] = lengths_of(*some, beside[rows], segments.length[rows])
            limits = AT_POLE * np.maximum(segments.room[rows], 0.0) / self._height
            near[rows], sine[rows] = near_pole(
                packed, *some, spans[rows], rates[rows, TURN], limits
            )
        return _Known(
            motion.copy(), np.tile(NO_GUIDE, (n, 1)), np.zeros(n), np.full(n, np.nan),
            shapes, beside, spans, lengths, near, sine, rates,
        )  # fmt: skip

    def _with_poses(self, i: int) -> bool:
        """Tell whether the rotary axes rest or follow the tool axis on a known segment."""
        assert self._known is not None
        return int(self._known.motion[i]) in (RESTING, FOLLOWING)

    def _step_over(self, i: int) -> None:
        """Take note of where a segment with linear rotary axes ends."""
        assert self._segments is not None
        one = self._segments
        words = one.rotary[i, 4 if one.kind[i] == CORNER else 1]
        self._turn, self._branch = float(words[self._outer]), branch_at(self._transform, words)
        self._stopped = bool(one.stop[i])

    def _pass(self, first: int, last: int, closed: bool) -> int:
        """
        Decide on the passages in the segments ``first`` to ``last``, which join smoothly.

        Returns
        -------
        int
            The segments before this one are decided.

        """
        known = self._known
        assert known is not None
        ends = np.concatenate([[0.0], np.cumsum(known.lengths[first:last])])
        total, hold = float(ends[-1]), np.inf
        moves = bool((known.motion[first:last] == FOLLOWING).any())
        cores = self._cores(first, last, ends, closed)
        for k, core in enumerate(cores if moves else []):
            open_s = float(ends[min(max(self._open, first), last) - first])
            if core.end < open_s + SAME_PLACE and core.start < open_s - SAME_PLACE:
                continue
            needed = core.end + (REACH if core.rests_after else 2.0 * REACH)
            if not closed and total < max(needed, core.start + 4.0 * REACH):
                hold = core.start
                break
            best: _Stretch | None = None
            for following in range(k, len(cores)):
                whole = replace(
                    core, end=cores[following].end, rests_after=cores[following].rests_after
                )
                apart = whole.end - whole.start > 2.0 * REACH or cores[following].rests_before
                if following > k and (apart or cores[following - 1].rests_after):
                    break
                if following > k and self._leaves(first, ends, cores[following - 1], whole):
                    break
                after = cores[following + 1].start if following + 1 < len(cores) else np.inf
                found = self._longest(first, last, ends, whole, after)
                if found is not None and (best is None or found.turning < best.turning):
                    best = found
                elif following > k:
                    break
            if best is None:
                self._open = self._place(core.end, first, ends)[0] + 1
            else:
                self._give(first, best)
        if closed:
            guided = known.guides[last - 1]
            given = guided[GUIDE_FROM] < 1.0 <= guided[GUIDE_TO]
            moves_on = known.lengths[last - 1] > 0.0  # else the builder refuses it
            if known.motion[last - 1] == FOLLOWING and moves_on and not given:
                place = self._following(last - 1, 1.0, total, self._branch, self._turn)
                self._turn = float(place.jet[0])
            return last
        if not moves and len(cores) == 1 and cores[0].end < total and cores[0].rests_after:
            hold = total
        hold = min(hold, total) - REACH
        return first + int(np.searchsorted(ends[1:], hold, 'right'))

    def _cores(self, first: int, last: int, ends: FloatArray, closed: bool) -> list[_Core]:
        """Return where the segments ``first`` to ``last`` are at the pole."""
        known = self._known
        assert known is not None
        found: list[_Core] = []
        i = first
        while i < last:
            low, high = known.near[i]
            if low > high:
                i += 1
                continue
            if known.motion[i] == RESTING:
                k = i
                while k < last and known.motion[k] == RESTING and known.near[k, 0] <= 1.0:
                    k += 1
                start, end = float(ends[i - first]), float(ends[k - first])
                cut_off = i == first and not self._begins
                if end - start > 2.0 * REACH or cut_off:
                    if found and abs(found[-1].end - start) < SAME_PLACE:
                        found[-1] = replace(found[-1], end=start, rests_after=True)
                    if k < last or not closed:
                        found.append(_Core(end, end, rests_before=True))
                    i = k
                    continue
            else:
                start = float(ends[i - first]) + self._way(i, low)
                end = float(ends[i - first]) + self._way(i, high)
                k = i + 1
            if found and start - found[-1].end < SAME_PLACE:
                found[-1] = replace(found[-1], end=end)
            else:
                found.append(_Core(start, end))
            i = k
        return found

    def _way(self, i: int, u: float) -> float:
        """Return the path length from the start of a known segment to u [m]."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        return float(
            way_to(segments.kind[i], known.shapes[i], known.beside[i], segments.length[i], u)
        )

    def _sine(self, i: int, u: float) -> float:
        """Return the sine of the angle from the pole on a known segment."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        return float(
            pole_sine(
                self._transform.packed, segments.kind[i], known.shapes[i], known.spans[i], u
            )
        )  # fmt: skip

    def _place(self, s: float, first: int, ends: FloatArray) -> tuple[int, float]:
        """Return segment and parameter at a path length."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        i = int(np.clip(np.searchsorted(ends, s, 'right') - 1, 0, len(ends) - 2))
        way, i = s - float(ends[i]), first + i
        if way <= SAME_PLACE or way >= known.lengths[i] - SAME_PLACE:
            return i, 0.0 if way <= SAME_PLACE else 1.0
        u = place_at(segments.kind[i], known.shapes[i], known.beside[i], segments.length[i], way)
        return i, float(u)

    def _following(self, i: int, u: float, s: float, branch: float, near: float) -> _End:
        """Solve the rotary axes for the tool axis at one point, on a branch."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        rotary = np.array([0.0, 0.0, branch, self._height])
        rotary[self._outer] = near
        inside = u + (1e-9 if u < 0.5 else -1e-9)
        spans = known.spans[
            i
        ].copy()  # never read-only: a kernel is compiled for each kind of array
        q = sample(
            self._transform.packed, segments.kind[i], FOLLOWING, known.shapes[i], known.beside[i],
            spans, segments.length[i], rotary, NO_GUIDE, 0.0, u, inside,
        )[0]  # fmt: skip
        return _End(i, u, s, q[:, 3 + self._outer].copy(), branch, q[0, 4 - self._outer])

    def _leaves(self, first: int, ends: FloatArray, core: _Core, whole: _Core) -> bool:
        """Tell whether the path goes far away from the pole between a core and the end of all."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        at = (ends[:-1] > core.end) & (ends[:-1] < whole.end)
        rows = first + np.flatnonzero(at)
        room = segments.room[rows] + segments.deviation[rows, 1]
        return bool((known.sine[rows] * self._height > FAR * room).any())

    def _longest(
        self, first: int, last: int, ends: FloatArray, core: _Core, after: float
    ) -> _Stretch | None:
        """Return the longest stretch around a core that keeps the tolerance; None without one."""
        segments = self._segments
        assert segments is not None
        open_s, total = float(ends[min(max(self._open, first), last) - first]), float(ends[-1])
        begins = self._begins and self._open <= first and core.start < SAME_PLACE
        arrives = core.end > total - SAME_PLACE
        if np.isfinite(after):  # between two cores, a stretch ends where a segment ends
            near = ends[(ends >= core.end - SAME_PLACE) & (ends <= after + SAME_PLACE)]
            middle = 0.5 * (core.end + after)
            after = float(near[np.abs(near - middle).argmin()]) if len(near) else core.end
        before, behind = self._ways(first, last, ends, core, open_s, after)
        if begins:
            before = 0.0
        if arrives:
            behind = 0.0
        middle = 0.5 * (core.start + core.end)
        while True:
            left = self._left(first, ends, core, before, begins)
            right = self._right(first, ends, core, behind, arrives, left)
            left = self._set_free(left, right, begins)
            guides, rows = self._guides(first, ends, left, right)
            bounds, turning = self._bounds(rows, guides)
            over = bounds / np.maximum(segments.room[rows] / self._height, 1e-12)
            worst = int(np.argmax(over))
            if over[worst] <= 1.0:
                return _Stretch(left, right, guides, rows, bounds, turning, begins)
            at = float(ends[rows.start + worst - first : rows.start + worst - first + 2].mean())
            shorten = at < middle if before > SHORTEST and behind > SHORTEST else before > SHORTEST
            if not shorten and behind <= SHORTEST:
                return None
            before, behind = (before * SHORTER, behind) if shorten else (before, behind * SHORTER)

    def _give(self, first: int, stretch: _Stretch) -> None:
        """Give the outer axis on a stretch."""
        known, rows = self._known, stretch.rows
        assert known is not None and self._segments is not None
        if stretch.begins and self._stopped and stretch.left.jet[0] != self._turn:
            known.turn_first[first] = stretch.left.jet[0]
        known.guides[rows] = stretch.guides
        known.bound[rows] = np.maximum(known.bound[rows], stretch.bounds)
        self._turn, self._branch = float(stretch.right.jet[0]), stretch.right.branch
        self._open = rows.stop
        if stretch.right.forbidden:
            self.forbidden.append(int(self._segments.line_number[rows.start]))

    def _ways(
        self, first: int, last: int, ends: FloatArray, core: _Core, open_s: float, after: float
    ) -> tuple[float, float]:
        """Return how far a stretch may reach before and after a core [m]."""
        known = self._known
        assert known is not None
        widest = np.sin(WIDEST)
        before, behind = 0.0, 0.0
        if core.rests_before:
            before = REACH
        else:
            i = self._place(core.start - 1e-12, first, ends)[0]
            while i >= first and known.motion[i] == FOLLOWING and before < REACH:
                before = core.start - float(ends[i - first])
                if known.sine[i] > widest:
                    break
                i -= 1
        if core.rests_after:
            behind = REACH
        else:
            i = self._place(core.end + 1e-12, first, ends)[0]
            while i < last and known.motion[i] == FOLLOWING and behind < REACH:
                behind = float(ends[i + 1 - first]) - core.end
                if i + 1 < last and known.sine[i + 1] > widest:
                    break
                i += 1
        before = min(before, REACH, core.start - open_s)
        behind = min(behind, REACH, after - core.end)
        return max(before, 0.0), max(behind, 0.0)

    def _left(
        self, first: int, ends: FloatArray, core: _Core, before: float, begins: bool
    ) -> _End:
        """Return the first end of a stretch."""
        resting = np.array([self._turn, 0.0, 0.0, 0.0])
        if begins:
            return _End(first, 0.0, 0.0, resting, self._branch, 0.0)
        s = core.start - before
        i, u = self._place(s, first, ends)
        if core.rests_before:
            return _End(i, u, s, resting, self._branch, 0.0)
        return self._following(i, u, s, self._branch, self._turn)

    def _right(
        self,
        first: int,
        ends: FloatArray,
        core: _Core,
        behind: float,
        arrives: bool,
        left: _End,
    ) -> _End:
        """Return the last end of a stretch: on the branch that turns the outer axis less."""
        near = float(left.jet[0])
        s = float(ends[-1]) if arrives else core.end + behind
        i, u = (first + len(ends) - 2, 1.0) if arrives else self._place(s, first, ends)
        stands = arrives or core.rests_after
        if stands and self._sine(i, u) < ON_POLE:
            if self._sine(*self._place(core.start, first, ends)) > ON_POLE:
                near = float(
                    self._following(
                        *self._place(core.start, first, ends), s, self._branch, near
                    ).jet[0]
                )
            return _End(i, u, s, np.array([near, 0.0, 0.0, 0.0]), self._branch, 0.0)
        found = [
            self._following(i, u, s, branch, near) for branch in (self._branch, -self._branch)
        ]
        less = min(found, key=lambda end: abs(float(end.jet[0]) - near))
        if less.branch != self._branch and not self._reachable(i, less.tilt):
            less = replace(found[0], forbidden=True)
        return replace(less, jet=np.array([less.jet[0], 0.0, 0.0, 0.0])) if stands else less

    def _reachable(self, i: int, tilt: float) -> bool:
        """Tell whether the tilt may change its sign: its travel there is not the shorter one."""
        machine = self._transform.machine
        inner = 1 - self._outer
        low, high = machine.travel[3 + inner]
        assert self._segments is not None
        pole = self._transform.pole
        pole = pole if self._segments.axis[i] @ pole > 0.0 else -pole
        level = self._transform.rotary_solutions(pole)
        upright = float(level[0][inner]) if level else 0.0
        tilt = upright + (tilt - upright + np.pi) % (2.0 * np.pi) - np.pi
        down, up = upright - low, high - upright
        return bool(up >= down - 1e-9 if tilt > upright else down >= up - 1e-9)

    def _set_free(self, left: _End, right: _End, begins: bool) -> _End:
        """Let the outer axis begin where it shall go, if the tool leaves the pole from rest."""
        known = self._known
        assert known is not None
        leaves = self._stopped and known.motion[left.segment] == FOLLOWING
        if not begins or not (leaves or self._free):
            return left
        if self._sine(left.segment, 0.0) > ON_POLE:
            return left
        return replace(left, jet=np.array([right.jet[0], 0.0, 0.0, 0.0]))

    def _guides(
        self, first: int, ends: FloatArray, left: _End, right: _End
    ) -> tuple[FloatArray, slice]:
        """Return the rows of ``guides`` for a stretch, and the known segments they belong to."""
        begin = left.segment + (left.u >= 1.0)
        end = right.segment + (right.u > 0.0)
        guides = np.tile(NO_GUIDE, (end - begin, 1))
        length = right.s - left.s
        coefficients = np.empty(8)
        septic_coefficients(left.jet, right.jet, length, coefficients)
        guides[:, GUIDE_FROM], guides[:, GUIDE_TO] = -1.0, 1.5
        if begin == left.segment:
            guides[0, GUIDE_FROM] = left.u
        guides[-1, GUIDE_TO] = right.u if end == right.segment + 1 else 1.0
        guides[:, BRANCH_AFTER] = right.branch
        guides[:, GUIDE_BEGUN] = ends[begin - first : end - first] - left.s
        guides[:, GUIDE_LENGTH] = length
        guides[:, GUIDE] = coefficients
        return guides, slice(begin, end)

    def _bounds(self, rows: slice, guides: FloatArray) -> tuple[FloatArray, float]:
        """Bound the deviation on the segments of a stretch [rad], and C' there [rad/m]."""
        known, segments = self._known, self._segments
        assert known is not None and segments is not None
        slope, length = guides[0, GUIDE], guides[0, GUIDE_LENGTH]
        turning = np.zeros(2)
        for order in (1, 2):
            slope = slope[1:] * np.arange(1, len(slope)) / length
            turning[order - 1] = np.abs(TO_BEZIER[order - 1] @ slope).max()
        exact = EXACT * np.maximum(segments.room[rows], 1e-9) / self._height
        bounds = gap_bounds(
            self._transform.packed, segments.kind[rows], known.shapes[rows], known.beside[rows],
            known.spans[rows], segments.length[rows], guides, known.rates[rows], turning, exact,
        )  # fmt: skip
        return np.asarray(bounds), float(turning[0])
