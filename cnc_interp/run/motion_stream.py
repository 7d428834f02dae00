"""
The stream of one run: legs planned one after the other, sampled, and cut into chunks with tails.

Along every leg places are noted from which a fast stop along the path is known (``stop_law``), a
few tens of milliseconds apart. The tail of a chunk goes on as planned to the next such place and
stops there. Setpoints for which no tail is known yet are not handed out.

``revise`` plans anew, with another override, behind a setpoint that was handed out, and may be
taken back; ``resume`` plans anew from rest anywhere on the path. All leave the path as it is.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cnc_interp.core.errors import PlanningError
from cnc_interp.feedrate.limits import AxisLimits, limit_table
from cnc_interp.feedrate.stop_law import stop_law
from cnc_interp.feedrate.window import PlannedPiece
from cnc_interp.kinematics.axis_path import AxisPath, cut
from cnc_interp.run.chunk import Chunk, Wait, part_of
from cnc_interp.run.course import Course, LegEnd, finely, slowed
from cnc_interp.run.interpolator import Interpolator, Setpoints
from cnc_interp.run.leg import Leg

STOP_EVERY = 0.02
"""Time between places at which a stop is looked for [s]."""

THOROUGH_AFTER, THOROUGH_EVERY = 0.1, 0.06
"""Time without a stop after which the jerk stage is asked, and how often [s]."""


class MotionStream:
    """
    Path in, chunks out.

    Parameters
    ----------
    limits : AxisLimits
        Limits of the axes.
    period : float
        Interpolation period [s].
    chunk_size : int
        Most setpoints in a chunk.
    line_of : callable
        Tells the source line of a block; single block stops where it changes.

    """

    def __init__(
        self,
        limits: AxisLimits,
        period: float,
        chunk_size: int = 10,
        line_of: Callable[[int], int] = int,
    ):
        self._limits, self._table, self.period = limits, limit_table(limits), period
        self._chunk_size, self._line_of = chunk_size, line_of
        self._stop_every = max(1, round(STOP_EVERY / period))
        self.override, self.single_block = 1.0, False
        self.pause_blocks: set[int] = set()
        self._course = Course()
        self._last: Setpoints | None = None
        self._before_revision: dict[str, Any] = {}
        self._begin(deque(), None, 0)

    def _begin(self, todo: deque[AxisPath | LegEnd], leg: Leg | None, number: int) -> None:
        """Go on with a course and a first leg; ``number`` is the next setpoint's."""
        self._todo = todo
        self._legs: deque[Leg] = deque([] if leg is None else [leg])
        self._way_down: PlannedPiece | None = None
        self._undivided = -math.inf  # no leg is cut before this place
        self._history: deque[tuple[Leg, PlannedPiece]] = deque()
        self._backlog: deque[Setpoints] = deque()
        self._first = self._next = number
        self._stops: deque[tuple[int, Setpoints | None]] = deque()
        self._waits: dict[int, Wait] = {}
        self._stop_known = self._stop_asked = number
        self._block_before = -1

    def push(self, path: AxisPath) -> None:
        """Take the next part of the path; nothing is planned yet."""
        self._todo.extend(self._course.push(path))

    def end_leg(self, wait: Wait) -> None:
        """Let the motion rest at the end of the path pushed so far."""
        self._todo.append(self._course.end_leg(wait))

    def release(self, s: float) -> None:
        """Forget the path before a place that was executed."""
        self._course.release(s)
        while len(self._history) > 1 and self._history[1][1].law.s[0] < s:
            self._history.popleft()

    @property
    def first_block(self) -> int:
        """The block in which the path that is not forgotten begins; 0 before there is any."""
        return self._course.first_block

    @property
    def planned(self) -> float:
        """Motion planned but not sampled [s]."""
        return sum(leg.planned for leg in self._legs)

    @property
    def has_path(self) -> bool:
        """Tell whether there is path that is not planned."""
        return bool(self._todo)

    @property
    def can_plan(self) -> bool:
        """Tell whether there is path to plan."""
        return self.has_path and self.override > 0.0

    @property
    def can_sample(self) -> bool:
        """Tell whether there is motion to sample."""
        return bool(self._legs) and (bool(self._legs[0].slices) or self._legs[0].wait is not None)

    def plan(self) -> None:
        """
        Plan one portion of the path.

        Raises
        ------
        PlanningError
            If there is no law within the limits.

        """
        item = self._todo.popleft()
        if isinstance(item, AxisPath):
            item = self._until_border(item)
        if isinstance(item, LegEnd):
            self._open_leg().finish(item.wait)
            return
        self._block_before = int(item.cell_block[-1])
        self._open_leg().push(slowed(item, self.override, self._way_down))

    def _open_leg(self) -> Leg:
        if not self._legs or self._legs[-1].wait is not None:
            self._legs.append(Leg(self._limits, self.period))
        return self._legs[-1]

    def _until_border(self, part: AxisPath) -> AxisPath | LegEnd:
        """Cut a part where the operator is waited for; the rest goes back."""
        border = self._border(part)
        if border is None:
            return part
        if border == 0:
            self._todo.appendleft(part)
            self._block_before = int(part.cell_block[0])
            return LegEnd(Wait.CYCLE_START)
        last = len(part.s) - 1
        self._todo.appendleft(cut(part, border, last))
        return cut(part, 0, border)

    def _border(self, part: AxisPath) -> int | None:
        """Find the first grid point of a part behind which the operator is waited for."""
        before = np.concatenate([[self._block_before], part.cell_block[:-1]])
        changes = np.flatnonzero((before != part.cell_block) & (before >= 0))
        for k in changes.tolist():
            if part.s[k] < self._undivided:
                continue
            block, following = int(before[k]), int(part.cell_block[k])
            moves = k > 0 or (bool(self._legs) and self._legs[-1].wait is None)
            single = self.single_block and self._line_of(block) != self._line_of(following)
            if moves and (single or block in self.pause_blocks):
                return int(k)
        return None

    def sample(self) -> list[Chunk]:
        """Sample a slice of the motion and return the chunks that are complete with it."""
        leg = self._legs[0]
        if leg.number_of_zero is None:
            leg.number_of_zero = self._next - leg.interpolator.next_number
        if leg.slices:
            piece = leg.slices.popleft()
            self._history.append((leg, piece))
            self._append(leg.interpolator.push(piece))
            self._look_for_stops(leg, piece)
        else:
            assert leg.wait is not None
            self._legs.popleft()
            last = leg.last_sample() if leg.moves else self._last
            if last is not None and (leg.moves or leg.wait is Wait.END):
                self._append(last)
                self._waits[self._next - 1] = leg.wait
                self._stops.append((self._next - 1, None))
                self._stop_known = self._next
        return self._chunks()

    def _append(self, samples: Setpoints) -> None:
        if len(samples):
            self._backlog.append(samples)
            self._next += len(samples)
            self._last = part_of(samples, len(samples) - 1, len(samples))

    def _look_for_stops(self, leg: Leg, piece: PlannedPiece) -> None:
        """Look for stops at the setpoints of a slice that was just sampled."""
        count = len(self._backlog[-1]) if self._backlog else 0
        every = self._stop_every
        first = -(-(self._next - count + 1) // every) * every - 1
        ahead: AxisPath | None = None
        for number in range(first, self._next, every):
            state = leg.state_at(number, piece)
            if state[1] <= 0.0:
                continue
            if ahead is None:
                ahead = self._course.ahead(float(piece.law.s[0]))
            thorough = (
                number - self._stop_known >= THOROUGH_AFTER / self.period
                and number - self._stop_asked >= THOROUGH_EVERY / self.period
            )
            stop = stop_law(ahead, state, self._table, 0.0, thorough)
            if thorough:
                self._stop_asked = number
            if stop is not None:
                self._stop_known = number
                self._stops.append((number, self._sampled(stop)))

    def _sampled(self, stop: PlannedPiece) -> Setpoints:
        """Sample a stop: the setpoints behind its first state, the last one at rest."""
        interpolator = Interpolator(self.period, 1)
        return Setpoints.concatenate([interpolator.push(stop), interpolator.finish()])

    def _chunks(self) -> list[Chunk]:
        """Cut what has a stop behind it into chunks."""
        if not self._stops:
            return []
        waiting = Setpoints.concatenate(list(self._backlog))
        chunks: list[Chunk] = []
        base = begin = self._first
        while self._stops:
            end = begin + self._chunk_size
            border = min((n + 1 for n in self._waits if n >= begin), default=end)
            end = min(end, border)
            while self._stops and self._stops[0][0] < end - 1:
                self._stops.popleft()
            if not self._stops:
                break
            number, stop = self._stops[0]
            tail = part_of(waiting, end - base, number + 1 - base)
            if stop is not None:
                tail = Setpoints.concatenate([tail, stop])
            wait = self._waits.pop(end - 1, Wait.NOTHING)
            chunks.append(Chunk(part_of(waiting, begin - base, end - base), tail, wait))
            begin = end
        self._first = begin
        rest = part_of(waiting, begin - base, len(waiting))
        self._backlog = deque([rest] if len(rest) else [])
        return chunks

    def state_at(self, number: int) -> tuple[Leg, tuple[float, float, float]] | None:
        """Return leg and state of motion at a setpoint handed out; None when it is forgotten."""
        for leg, piece in reversed(self._history):
            assert leg.number_of_zero is not None
            if (number - leg.number_of_zero) * self.period >= piece.law.time[0] - 1e-9:
                return leg, leg.state_at(number, piece)
        return None

    def revise(self, number: int, override: float, single_block: bool) -> bool:
        """
        Plan anew behind a setpoint that stays, with another override.

        Parameters
        ----------
        number : int
            Number of the last setpoint that stays.
        override : float
            Factor on the programmed feed; 0 stops on the path and waits.
        single_block : bool
            Rest at the end of each block until cycle_start.

        Returns
        -------
        bool
            False where no other motion was found from there: the old one goes on, ask later.

        """
        found = self.state_at(number)
        if found is None:
            return False
        leg, (s, v, a) = found
        stop = None
        if v > 0.0:
            stop = stop_law(self._course.ahead(s), (s, v, a), self._table, 0.0, thorough=True)
            if stop is None:
                return False
        self._before_revision = {}
        kept = dict(vars(self))
        history = deque(entry for entry in self._history)
        assert leg.number_of_zero is not None
        begun = number - leg.number_of_zero + 1
        new = Leg(self._limits, self.period, begun, (v, a)) if v > 0.0 else None
        self._begin(finely(self._course.after(s)), new, number + 1)
        self._history = history
        self.override, self.single_block = override, single_block
        self._before_revision = kept
        if stop is not None and new is not None:
            self._undivided = float(stop.path.s[-1]) * (1 + 1e-12) + 1e-9
            if override <= 0.0:
                new.drive(shifted(stop, (begun - 1) * self.period), Wait.OVERRIDE)
                self._todo = self._course.after(float(stop.path.s[-1]))
                return True
            self._way_down = stop
        try:
            while self.can_plan and new is not None and not self.can_sample:
                self.plan()
        except PlanningError:
            found = None
        if found is None or (new is not None and new.planner.stuck):
            self.take_back()
            return False
        return True

    def take_back(self) -> None:
        """Go on as if ``revise`` had not been called; to be called before anything else is."""
        vars(self).update(self._before_revision)

    def resume(self, s: float) -> None:
        """Plan anew from rest at a place on the path; setpoints are numbered from 0 again."""
        self._begin(self._course.after(s), None, 0)


def shifted(piece: PlannedPiece, time: float) -> PlannedPiece:
    """Let a law begin at another time."""
    law = piece.law
    return PlannedPiece(piece.path, replace(law, time=law.time - law.time[0] + time))
