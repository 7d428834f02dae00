"""Passages of the pole (docs/how_it_works/corner_rounding.md): the outer axis C is prescribed.

On a stretch around the pole, C is the septic in path length that matches C and three derivatives
at both ends. The tilt may change its sign, so C turns by a quarter turn at most. A stretch is
chosen as soon as no later segment can change it, so the result does not depend on how the segments
arrive.
"""

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.core import DEG, MM, FloatArray, IntArray
from cnc_interp.kinematics.passages import Passages
from cnc_interp.kinematics.path_ahead import SAME_PLACE, PassageEnd
from cnc_interp.kinematics.path_at_pole import Guides, PathAtPole
from cnc_interp.kinematics.segment_axes import FOLLOWING, GUIDE_FROM, GUIDE_TO, RESTING
from cnc_interp.machine_model.five_axis import ON_POLE, FiveAxis
from cnc_interp.smoothing.segments import CORNER, PathSegments

REACH = 30.0 * MM  #: Longest path before and after the pole on which C is prescribed [m].
FAR = 10.0  #: Largest distance from the pole between two cores of one stretch [tolerances].
WIDEST = 40.0 * DEG  #: A stretch begins only in segments nearer to the pole than this [rad].
SHORTER, SHORTEST = 0.8, 1e-7  #: Factor by which a stretch is shortened [-]; shortest stretch [m].


@dataclass(frozen=True)
class _Core:
    start: float
    end: float
    rests_before: bool = False
    rests_after: bool = False


@dataclass(frozen=True)
class _Stretch:
    left: PassageEnd
    right: PassageEnd
    guides: Guides
    begins: bool


class PolePassages(Passages[PathAtPole]):
    def __init__(self, transform: FiveAxis, height: float):
        super().__init__()
        self._transform, self._height = transform, height
        self._outer = transform.outer
        self._turn, self._branch, self._free = 0.0, 1.0, False
        #: Lines where travel prevents a change of sign of the tilt.
        self.forbidden: list[int] = []

    def begin(self, rotary: FloatArray, branch: float, free: bool) -> None:
        """Set the first rotary positions [rad]; if ``free``, the outer axis may start anywhere."""
        self._turn, self._branch, self._free = float(rotary[self._outer]), branch, free

    @property
    def notice(self) -> tuple[int, str] | None:
        """The first line where travel prevents a change of sign of the tilt, and a message."""
        if not self.forbidden:
            return None
        machine = self._transform.machine
        tilt, turn = machine.axes[4 - self._outer], machine.axes[3 + self._outer]
        low, high = (tilt.position_text(end) for end in tilt.travel)
        return min(self.forbidden), (
            f'the tool passes the pole, where {tilt.name} would change its sign; its travel of '
            f'{low} to {high} deg is shorter on that side, so {turn.name} makes half a turn '
            f'instead, and the motion slows down (passes: {len(self.forbidden)})'
        )

    def _look_at(self, segments: PathSegments, motion: IntArray) -> PathAtPole:
        return PathAtPole.look_at(self._transform, self._height, segments, motion)

    def _released(self) -> None:
        self._free = False

    def _step_over(self, path: PathAtPole, i: int) -> None:
        one = path.segments
        words = one.rotary[i, 4 if one.kind[i] == CORNER else 1]
        self._turn, self._branch = float(words[self._outer]), self._transform.branch_at(words)
        self._stopped = bool(one.stop[i])

    def _pass(self, path: PathAtPole, closed: bool) -> int:
        """Choose the passages of a path between stops; return how many segments are final."""
        ends, hold = path.ends, np.inf
        total = float(ends[-1])
        moves = bool((path.motion == FOLLOWING).any())
        cores = self._cores(path, closed)
        for k, core in enumerate(cores if moves else []):
            open_s = float(ends[min(self._open, len(path))])
            if core.end < open_s + SAME_PLACE and core.start < open_s - SAME_PLACE:
                continue
            needed = core.end + (REACH if core.rests_after else 2.0 * REACH)
            if not closed and total < max(needed, core.start + 4.0 * REACH):
                hold = core.start
                break
            best = self._slowest_turning(path, cores[k:])
            if best is None:
                self._open = path.place(core.end)[0] + 1
            else:
                self._give(path, best)
        if closed:
            self._arrive(path)
            self._begun = 0.0
            return len(path)
        if not moves and len(cores) == 1 and cores[0].end < total and cores[0].rests_after:
            hold = total
        hold = min(hold, total) - REACH
        ready = int(np.searchsorted(ends[1:], hold, 'right'))
        self._begun = float(ends[ready])
        return ready

    def _slowest_turning(self, path: PathAtPole, cores: list[_Core]) -> _Stretch | None:
        """Return the stretch over the first core, or several, on which C turns most slowly."""
        best: _Stretch | None = None
        for k, core in enumerate(cores):
            whole = replace(cores[0], end=core.end, rests_after=core.rests_after)
            if k:
                apart = whole.end - whole.start > 2.0 * REACH or core.rests_before
                if apart or cores[k - 1].rests_after or self._leaves(path, cores[k - 1], whole):
                    break
            after = cores[k + 1].start if k + 1 < len(cores) else np.inf
            found = self._longest(path, whole, after)
            if found is not None and (best is None or found.guides.turning < best.guides.turning):
                best = found
            elif k:
                break
        return best

    def _arrive(self, path: PathAtPole) -> None:
        i, total = len(path) - 1, float(path.ends[-1])
        guided = path.guides[i]
        given = guided[GUIDE_FROM] < 1.0 <= guided[GUIDE_TO]
        moves_on = path.lengths[i] > 0.0  # else the builder refuses it
        if path.motion[i] == FOLLOWING and moves_on and not given:
            place = path.following(i, 1.0, total, self._branch, self._turn)
            self._turn = float(place.jet[0])

    def _cores(self, path: PathAtPole, closed: bool) -> list[_Core]:
        found: list[_Core] = []
        i, last, ends = 0, len(path), path.ends.tolist()
        while i < last:
            low, high = path.near[i]
            if low > high:
                i += 1
                continue
            if path.motion[i] == RESTING:
                k = i
                while k < last and path.motion[k] == RESTING and path.near[k, 0] <= 1.0:
                    k += 1
                start, end = ends[i], ends[k]
                cut_off = i == 0 and not self._begins
                if end - start > 2.0 * REACH or cut_off:
                    if found and abs(found[-1].end - start) < SAME_PLACE:
                        found[-1] = replace(found[-1], end=start, rests_after=True)
                    if k < last or not closed:
                        found.append(_Core(end, end, rests_before=True))
                    i = k
                    continue
            else:
                start, end = ends[i] + path.way(i, low), ends[i] + path.way(i, high)
                k = i + 1
            if found and start - found[-1].end < SAME_PLACE:
                found[-1] = replace(found[-1], end=end)
            else:
                found.append(_Core(start, end))
            i = k
        return found

    def _leaves(self, path: PathAtPole, core: _Core, whole: _Core) -> bool:
        rows = (path.ends[:-1] > core.end) & (path.ends[:-1] < whole.end)
        room = path.segments.room[rows] + path.segments.deviation[rows, 1]
        return bool((path.sine[rows] * self._height > FAR * room).any())

    def _longest(self, path: PathAtPole, core: _Core, after: float) -> _Stretch | None:
        ends = path.ends
        begins = self._begins and self._open == 0 and core.start < SAME_PLACE
        arrives = core.end > float(ends[-1]) - SAME_PLACE
        if np.isfinite(after):  # between two cores, a stretch ends where a segment ends
            near = ends[(ends >= core.end - SAME_PLACE) & (ends <= after + SAME_PLACE)]
            middle = 0.5 * (core.end + after)
            after = float(near[np.abs(near - middle).argmin()]) if len(near) else core.end
        before, beyond = self._ways(path, core, after)
        middle = 0.5 * (core.start + core.end)
        while True:
            left = self._left(path, core, before, begins)
            right = self._right(path, core, beyond, arrives, left)
            left = self._set_free(path, left, right, begins)
            guides = path.guides_between(left, right)
            room = path.segments.room[guides.rows] / self._height
            over = guides.bounds / np.maximum(room, 1e-12)
            worst = int(np.argmax(over))
            if over[worst] <= 1.0:
                return _Stretch(left, right, guides, begins)
            at_segment = guides.rows.start + worst
            at = float(ends[at_segment : at_segment + 2].mean())
            shorten = at < middle if before > SHORTEST and beyond > SHORTEST else before > SHORTEST
            if not shorten and beyond <= SHORTEST:
                return None
            before, beyond = (before * SHORTER, beyond) if shorten else (before, beyond * SHORTER)

    def _give(self, path: PathAtPole, stretch: _Stretch) -> None:
        guides = stretch.guides
        rows = guides.rows
        if stretch.begins and self._stopped and stretch.left.jet[0] != self._turn:
            path.turn_first[0] = stretch.left.jet[0]
        path.guides[rows] = guides.values
        path.bound[rows] = np.maximum(path.bound[rows], guides.bounds)
        self._turn, self._branch = float(stretch.right.jet[0]), stretch.right.branch
        self._open = rows.stop
        if stretch.right.forbidden:
            self.forbidden.append(int(path.segments.line_number[rows.start]))

    def _ways(self, path: PathAtPole, core: _Core, after: float) -> tuple[float, float]:
        ends, last, widest = path.ends, len(path), np.sin(WIDEST)
        before, beyond = 0.0, 0.0
        if core.rests_before:
            before = REACH
        else:
            i = path.place(core.start - 1e-12)[0]
            while i >= 0 and path.motion[i] == FOLLOWING and before < REACH:
                before = core.start - float(ends[i])
                if path.sine[i] > widest:
                    break
                i -= 1
        if core.rests_after:
            beyond = REACH
        else:
            i = path.place(core.end + 1e-12)[0]
            while i < last and path.motion[i] == FOLLOWING and beyond < REACH:
                beyond = float(ends[i + 1]) - core.end
                if i + 1 < last and path.sine[i + 1] > widest:
                    break
                i += 1
        before = min(before, REACH, core.start - float(ends[min(self._open, last)]))
        beyond = min(beyond, REACH, after - core.end)
        return max(before, 0.0), max(beyond, 0.0)

    def _left(self, path: PathAtPole, core: _Core, before: float, begins: bool) -> PassageEnd:
        resting = np.array([self._turn, 0.0, 0.0, 0.0])
        if begins:
            return PassageEnd(0, 0.0, 0.0, resting, self._branch, 0.0)
        s = core.start - before
        i, u = path.place(s)
        if core.rests_before:
            return PassageEnd(i, u, s, resting, self._branch, 0.0)
        return path.following(i, u, s, self._branch, self._turn)

    def _right(
        self, path: PathAtPole, core: _Core, beyond: float, arrives: bool, left: PassageEnd
    ) -> PassageEnd:
        """Return the end of a stretch, on the branch for which the outer axis turns less."""
        near = float(left.jet[0])
        s = float(path.ends[-1]) if arrives else core.end + beyond
        i, u = (len(path) - 1, 1.0) if arrives else path.place(s)
        stands = arrives or core.rests_after
        if stands and path.sine_at(i, u) < ON_POLE:
            start = path.place(core.start)
            if path.sine_at(*start) > ON_POLE:
                near = float(path.following(*start, s, self._branch, near).jet[0])
            return PassageEnd(i, u, s, np.array([near, 0.0, 0.0, 0.0]), self._branch, 0.0)
        found = [path.following(i, u, s, branch, near) for branch in (self._branch, -self._branch)]
        less = min(found, key=lambda end: abs(float(end.jet[0]) - near))
        if less.branch != self._branch and not path.may_change_sign(i, less.tilt):
            less = replace(found[0], forbidden=True)
        return replace(less, jet=np.array([less.jet[0], 0.0, 0.0, 0.0])) if stands else less

    def _set_free(
        self, path: PathAtPole, left: PassageEnd, right: PassageEnd, begins: bool
    ) -> PassageEnd:
        """If a stretch starts at rest on the pole, let C start at its later position."""
        leaves = self._stopped and path.motion[left.segment] == FOLLOWING
        if not begins or not (leaves or self._free):
            return left
        if path.sine_at(left.segment, 0.0) > ON_POLE:
            return left
        return replace(left, jet=np.array([right.jet[0], 0.0, 0.0, 0.0]))
