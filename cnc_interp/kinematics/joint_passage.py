"""Passages of the singular poses of an arm: a joint is prescribed instead of the spin (arms.md).

On a stretch around the singular pose, one joint is a septic in path length that matches its value
and three derivatives at both ends. The tool pose stays exact, and the spin follows. Stretches of
several lengths, to the nearest solutions after the pose, are compared by their time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import chain, product
from math import ceil, pi
from typing import NamedTuple

import numpy as np

from cnc_interp.core import MM, FloatArray, IntArray
from cnc_interp.core.kernels import njit
from cnc_interp.kinematics import segment_axes as axes
from cnc_interp.kinematics.axis_path import septic_coefficients
from cnc_interp.kinematics.passages import Passages
from cnc_interp.kinematics.path_ahead import PassageEnd, PathAhead
from cnc_interp.kinematics.sampling import guided_grid
from cnc_interp.kinematics.segment_axes import Place, SegmentRows, Stands
from cnc_interp.machine_model.joint import ARM
from cnc_interp.machine_model.joint_chain import JointChain
from cnc_interp.machine_model.machine import arm_of
from cnc_interp.smoothing.segments import CORNER, PathSegments

NEAR = 0.05  #: A stretch is tried where the smallest pivot of the rates is below this [-].
FAR = 0.12  #: Longest way before and after it, as a share of the arm's reach [-].
WAYS = (1.0, 0.6, 0.35, 0.2, 0.1, 0.0)  #: Shares of that way that are tried [-].
STEP, MOST_STEPS = 2.0 * MM, 128  #: Step of a walk [m]; largest number of steps on half a segment.
#: Bumps of the leading joint; each is tried if no stretch is possible with those before [rad].
BUMPS = (0.0, 0.6, -0.6, 1.2, -1.2, 2.0, -2.0)
LEADERS, SOLUTIONS = 2, 2  #: Number of joints, and of solutions after the pose, that are tried.
FEW = pi / 3.0  #: If a leading joint turns farther, the opposite direction is also tried [rad].
SAME = 1e-7  #: Largest error of the joints at the end of a stretch [rad].
MOST_FAILED = 8  #: A walk is lost after this many steps without a solution.


@dataclass(frozen=True)
class _Walk:
    """Results of a walk at its steps, and the joints at the start of each segment."""

    s: FloatArray  # (m,) from the start of the path [m]
    q: FloatArray  # (m, 4, n)
    measure: FloatArray  # (m,)
    row: IntArray  # (m,)
    begins: FloatArray  # (segments + 1, n)
    branches: FloatArray  # (segments + 1,)
    sound: bool


class _Stretch(NamedTuple):
    left: PassageEnd
    right: PassageEnd
    joint: float  # as in ``GUIDE_JOINT``
    there: FloatArray  # (n,): the joints at its end [rad]


class JointPassages(Passages[PathAhead]):
    def __init__(self, transform: JointChain, height: float, spins: FloatArray | None = None):
        super().__init__()
        self._chain, self._height = transform, height
        self._q, self._branch = np.zeros(len(transform.machine.axis_names)), 0.0
        self._far = FAR * arm_of(transform.machine).reach
        self._spins = spins
        self._lost = False  # what follows is refused
        self._keeps_spin = False  # that poses give, so no joint may lead

    def begin(self, q: FloatArray, branch: float) -> None:
        self._q, self._branch = q.copy(), branch

    def _look_at(self, segments: PathSegments, motion: IntArray) -> PathAhead:
        guides = np.zeros((len(segments), axes.GUIDE_BUMP + 1))
        guides[:, : len(axes.NO_GUIDE)] = axes.NO_GUIDE
        guides[:, axes.SPIN_BEGUN + 1], guides[:, axes.SPIN.start] = 1.0, self._chain.spin
        if self._spins is not None:
            rows, self._spins = np.split(self._spins, [len(segments)])
            guides[:, axes.SPIN_BEGUN : axes.SPIN.stop] = rows
        count = len(self._chain.machine.extra_names)
        extra, given = segments.extra[:, :, :count], segments.extra[:, :, count:]
        path = PathAhead.of(self._height, replace(segments, extra=extra), motion, guides)
        self._keeps_spin = given.shape[2] > 0
        if self._keeps_spin:
            spins = _given_spins(path, given[:, :, 0] / self._height)
            guides[:, axes.SPIN_BEGUN : axes.SPIN.stop] = spins
        return path

    def _pass(self, path: PathAhead, closed: bool) -> int:
        if self._lost:
            return len(path)
        ends = path.ends
        total, hold = float(ends[-1]), float(ends[-1]) - self._far
        walk = self._walk(path, slice(0, len(path)), path.guides, self._q, self._branch)
        while not self._lost:
            core = self._core(walk, float(ends[0]))
            if core is None:
                self._lost = not walk.sound
                break
            if not closed and walk.sound and total < core[1] + self._far:
                hold = core[0] - self._far
                break
            rests = self._begins and self._stopped, closed
            self._decide(path, walk, core, rests)
            walk = self._walk(path, slice(0, len(path)), path.guides, self._q, self._branch)
        ready = len(path)
        if not closed and not self._lost:
            ready = int(np.searchsorted(ends[1:], hold, 'right'))
        self._q, self._branch = walk.begins[ready], float(walk.branches[ready])
        self._begun = 0.0 if closed else float(ends[ready])
        return ready

    def _core(self, walk: _Walk, begin: float) -> tuple[float, float] | None:
        """Return the path lengths at which a path approaches and leaves a singular pose [m].

        A segment can hold one stretch, so it is the pose nearest to singular of the first segment.
        """
        low = (walk.measure < NEAR * NEAR) & (walk.row >= self._open)
        if not low.any():
            return None
        here = low & (walk.row == walk.row[low.argmax()])
        nearest = int(np.where(here, walk.measure, np.inf).argmin())
        before, after = np.flatnonzero(~low[:nearest]), np.flatnonzero(~low[nearest:])
        last = nearest + int(after[0]) if len(after) else len(low) - 1
        return float(walk.s[before[-1]]) if len(before) else begin, float(walk.s[last])

    def _decide(
        self, path: PathAhead, walk: _Walk, core: tuple[float, float], rests: tuple[bool, bool]
    ) -> None:
        """Choose how to pass a pose: by a leading joint if that is faster, else by the spin.

        ``rests``: whether the motion rests at the start and at the end of the path.
        """
        ends, (start, end) = path.ends, core
        first = max(self._open, int(np.searchsorted(ends, start - self._far, 'right')) - 1)
        last = min(int(np.searchsorted(ends, end + self._far, 'left')), len(path))
        rows, at = slice(first, last), (walk.begins[first], float(walk.branches[first]))
        best = self._time(path, rows, path.guides[rows], at, self._chain.least)
        given: tuple[slice, FloatArray] | None = None
        low = (walk.s >= start) & (walk.s <= end)
        nearest = walk.q[low][walk.measure[low].argmin(), 0]
        turns = np.abs(np.linalg.svd(self._chain.pose_rates(nearest))[2][-1])
        leaders = np.argsort(-turns, kind='stable')[:LEADERS]
        tried = dict[tuple[float, float], list[_Stretch]]()
        for share in () if self._keeps_spin else WAYS:
            ways = (
                min(share * self._far, start - float(ends[first])),
                min(share * self._far, float(ends[-1]) - end),
            )
            if ways not in tried:
                s = start - ways[0], end + ways[1]
                near = walk.q[max(int(np.searchsorted(walk.s, s[0], 'right')) - 1, 0), 0]
                near = near if s[0] > walk.s[0] else at[0]
                tried[ways] = self._pairs(path, s, near, leaders, rests)
        for bump in BUMPS:
            if bump and np.isfinite(best):
                break
            for left, right, joint, there in chain.from_iterable(tried.values()):
                some, values = path.led_between(left, right)
                values[:, axes.GUIDE_JOINT], values[:, axes.GUIDE_BUMP] = joint, bump
                guides = path.guides[rows].copy()
                guides[some.start - first : some.stop - first] = values
                time = self._time(path, rows, guides, at, self._chain.least, (right.s, there))
                if time < best:
                    best, given = time, (some, values)
        if given is not None:
            path.guides[given[0]] = given[1]
            self._open = given[0].stop
        else:
            self._open = path.place(end)[0] + 1
            self._lost = not np.isfinite(best)

    def _pairs(
        self,
        path: PathAhead,
        s: tuple[float, float],
        near: FloatArray,
        leaders: IntArray,
        rests: tuple[bool, bool],
    ) -> list[_Stretch]:
        """Return the stretches between two path lengths, one for each joint that may lead."""
        found = list[_Stretch]()
        left, left_end = self._solved(path, s[0], near)
        at_rest = rests[0] and s[0] <= path.ends[0], rests[1] and s[1] >= path.ends[-1]
        for q in self._solutions(path, s[1], left[0]):
            right, right_end = self._solved(path, s[1], q)
            for joint, turn in product(leaders.tolist(), (0.0, 2.0 * pi)):
                jets = [left[:, joint].copy(), right[:, joint].copy()]
                gap = jets[1][0] - jets[0][0]
                if turn and abs(gap) < FEW:
                    continue
                jets[1][0] -= np.copysign(turn, gap)
                slope = (jets[1][0] - jets[0][0]) / (s[1] - s[0])
                for jet, rest in zip(jets, at_rest, strict=True):
                    jet[1:] = [slope, 0.0, 0.0] if rest else jet[1:]
                found.append(
                    _Stretch(
                        PassageEnd(*left_end, jets[0], 0.0),
                        PassageEnd(*right_end, jets[1], self._chain.sense(q)),
                        (joint + 1) * self._chain.sense(left[0], joint),
                        right[0],
                    )
                )
        return found

    def _solved(
        self, path: PathAhead, s: float, near: FloatArray
    ) -> tuple[FloatArray, tuple[int, float, float]]:
        """Return the joints and three derivatives at a path length, with the spin prescribed."""
        i, u = path.place(s)
        stands = Stands(near.copy(), np.zeros(1), self._height)
        place = Place(path.way(i, u), u, u + (1e-9 if u < 0.5 else -1e-9))
        free = path.guides[i].copy()
        free[: axes.GUIDE_JOINT] = axes.NO_GUIDE
        return axes.sample(self._chain.packed, path.segment(i), stands, free, place)[0], (i, u, s)

    def _solutions(self, path: PathAhead, s: float, near: FloatArray) -> list[FloatArray]:
        """Return the solutions at a path length, nearest to given joints (n,) first."""
        i, u = path.place(s)
        segment, machine = path.segment(i), self._chain.machine
        pose = axes.pose_jets(segment.kind, segment.shape, segment.f, u, u)
        spin = axes.guide_jet(path.guides[i], path.way(i, u), axes.SPIN_BEGUN)[0]
        tip, axis = (np.array([row[0] for row in rows]) for rows in pose)
        beside = [
            axes.beside_jet(segment.kind, segment.beside, k, u, u)[0]
            for k in range(2, segment.beside.shape[1])
        ]
        found = self._chain.spun(spin).branches(tip, axis, np.array(beside))
        turns = np.round((near - found) / (2.0 * pi))
        found[:, :ARM] += 2.0 * pi * turns[:, :ARM]
        low, high = machine.travel.T
        found = found[((found >= low) & (found <= high)).all(axis=1)]
        away = (np.abs(found - near) / machine.max_velocity).max(axis=1)
        return list(found[np.argsort(away, kind='stable')[:SOLUTIONS]])

    def _walk(
        self,
        path: PathAhead,
        rows: slice,
        guides: FloatArray,
        q: FloatArray,
        branch: float,
        least: float = 0.0,
    ) -> _Walk:
        """Follow segments from given joints on; see ``walked`` for ``least``."""
        stands = Stands(q.copy(), np.array([branch]), self._height)
        given = self._chain.packed, path.rows(rows), path.lengths[rows], guides, stands
        opens = self._open if least == 0.0 else rows.stop
        s, *found = walked(*given, opens, least)
        return _Walk(float(path.ends[rows.start]) + s, *found)

    def _time(
        self,
        path: PathAhead,
        rows: slice,
        guides: FloatArray,
        at: tuple[FloatArray, float],
        least: float,
        there: tuple[float, FloatArray] | None = None,
    ) -> float:
        """Return a bound of the time of segments, from joints and branch on [s]; infinite if lost.

        ``there``: path length and joints at the end of the stretch, if there is one.
        """
        walk, machine = self._walk(path, rows, guides, *at, least), self._chain.machine
        q = walk.q[:, 0]
        if not walk.sound or ((q < machine.travel[:, 0]) | (q > machine.travel[:, 1])).any():
            return np.inf
        if there is not None:
            reached = q[np.abs(walk.s - there[0]).argmin()]
            gap = (reached - there[1]) / (2.0 * pi)
            if np.abs(gap - np.round(gap)).max() > SAME:
                return np.inf
        feed = path.segments.feed[rows].min(axis=1)[walk.row]
        powers = np.abs(walk.q[:, 1:])
        limits = machine.max_velocity, machine.max_acceleration, machine.max_jerk
        slow = 1.0 / feed
        for order, limit in enumerate(limits):
            share = (powers[:, order] / limit).max(axis=1)
            slow = np.maximum(slow, share ** (1.0 / (order + 1)))
        return float((np.diff(walk.s, prepend=path.ends[rows.start]) * slow).sum())


def _given_spins(path: PathAhead, values: FloatArray) -> FloatArray:
    """Return the spin of each segment from control values (n, POINTS), (n, 10) as in ``guides``.

    It is linear on lines; on corners it continues both lines with three derivatives.
    """
    found, segments = np.zeros((len(path), 10)), path.segments
    found[:, 1], found[:, 2], found[:, 3] = path.lengths, values[:, 0], values[:, 1] - values[:, 0]
    for i in np.flatnonzero(segments.kind == CORNER):
        jets = np.zeros((2, 4))
        for jet, (at, a, b) in zip(jets, ((0, 0, 1), (4, 3, 4)), strict=True):
            way = float(np.linalg.norm(segments.bottom[i, b] - segments.bottom[i, a]))
            jet[:2] = values[i, at], (values[i, b] - values[i, a]) / way
        septic_coefficients(*jets, float(path.lengths[i]), found[i, 2:])
    return found


@njit(cache=True, nogil=True)
def walked(
    packed: FloatArray,
    segments: SegmentRows,
    lengths: FloatArray,
    guides: FloatArray,
    stands: Stands,
    opens: int,
    least: float,
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray, FloatArray, FloatArray, bool]:
    """Follow segments in steps from the present joints, and return the fields of ``_Walk``.

    The walk ends at the first step whose measure is below ``least``. If ``least`` is 0, singular
    poses are allowed from segment ``opens`` on. There the walk continues on any branch that it
    finds, and it ends where it finds none.
    """
    count, n = len(lengths), len(stands.q)
    halves = np.empty(count, dtype=np.int64)
    for i in range(count):
        halves[i] = min(max(ceil(0.5 * lengths[i] / STEP), 1), MOST_STEPS)
    room = 2 * halves.sum() + 2 * count
    s, measure, row = np.empty(room), np.empty(room), np.empty(room, dtype=np.int64)
    q, begins, branches = np.empty((room, 4, n)), np.zeros((count + 1, n)), np.zeros(count + 1)
    at, failed, begun = 0, 0, 0.0
    for i in range(count):
        segment, guide, way = axes.segment_at(segments, i), guides[i], 0.0
        kind, motion, shape, beside, _, length = segment
        begins[i], branches[i] = stands.q, stands.branch[0]
        grid = guided_grid(np.linspace(0.0, 1.0, 2 * halves[i] + 1), guide)
        for k in range(1, len(grid)):
            a, b = grid[k - 1], grid[k]
            way += axes.arc_length(kind, motion, shape, beside, stands.height, length, a, b)
            place = Place(way, b, 0.5 * (a + b))
            found, _, _, sine = axes.sample(packed, segment, stands, guide, place)
            q[at], measure[at], s[at], row[at] = found, sine, begun + way, i
            at += 1
            failed = 0 if sine > 0.0 else failed + 1
            if sine < least or failed > MOST_FAILED or (sine <= 0.0 and i < opens):
                return s[:at], q[:at], measure[:at], row[:at], begins, branches, False
            if sine > 0.0:
                stands.q[:] = found[0]
            if i >= opens and sine < NEAR * NEAR:
                stands.branch[0] = 0.0
        if guide[axes.GUIDE_FROM] < 1.0 and guide[axes.GUIDE_TO] <= 1.0:
            stands.branch[0] = guide[axes.BRANCH_AFTER]
        begun += lengths[i]
    begins[count], branches[count] = stands.q, stands.branch[0]
    return s[:at], q[:at], measure[:at], row[:at], begins, branches, failed == 0
