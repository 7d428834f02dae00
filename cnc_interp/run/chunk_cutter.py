"""Stops along the path: stop tails of chunks, and the speed at which another plan joins.

A stop tail follows the plan to the next setpoint from which a stop is known, and then this stop.
A plan that joins in motion is at first no slower than a stop would be (``way_down``).
"""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np

from cnc_interp.core import FloatArray, IntArray
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planning_windows import PlannedPiece
from cnc_interp.feedrate.stop_law import cut_between, grid_place, stop_law
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.signals import FEED_FIXED, PER_TURN, SPEED, SPINDLE_FIXED, Signals
from cnc_interp.program.blocks.functions import Functions
from cnc_interp.run.course import STILL, Course, Leg
from cnc_interp.run.setpoints import NO_FUNCTIONS, Chunk, Interpolator, Setpoints, Wait

STOP_EVERY = 0.005  #: Time between setpoints at which a stop is computed [s].
#: A plan that joins in motion must be ready early: in its first part, of this duration, stops are
#: computed at larger distances, of the second value [s].
HASTE, HASTY_EVERY = 0.3, 0.02
#: Share of every limit that ``way_down`` leaves unused as a reserve for other motion laws [-].
LEEWAY = 6e-3
NO_SIGNALS = Signals()


class StopSearch:
    def __init__(
        self, course: Course, table: FloatArray, period: float, joins_at: int | None = None
    ):
        self._course, self._table, self._period = course, table, period
        self._every = max(1, round(STOP_EVERY / period))
        self._hasty_every = self._every * round(HASTY_EVERY / STOP_EVERY)
        self._hasty_until = 0 if joins_at is None else joins_at + round(HASTE / period)

    def stops(
        self, leg: Leg, piece: PlannedPiece, numbers: range
    ) -> Iterator[tuple[int, Setpoints]]:
        """Yield number and stop for setpoints of a slice; the stop: setpoints down to rest."""
        ahead: AxisPath | None = None
        first = -(-(numbers.start + 1) // self._every) * self._every - 1
        for number in range(first, numbers.stop, self._every):
            if number < self._hasty_until and (number + 1) % self._hasty_every:
                continue
            state = leg.state_at(number, piece)
            if state[1] <= 0.0:
                continue
            if ahead is None:
                ahead = self._course.ahead(float(piece.law.s[0]))
            stop = stop_law(ahead, state, self._table, 0.0)
            if stop is not None:
                down = Interpolator(self._period, 1)
                yield number, Setpoints.concatenate([down.push(stop), down.finish()])


class FunctionQueue:
    def __init__(self, signals: Signals = NO_SIGNALS) -> None:
        self._output = np.array([step.output for step in signals.steps], dtype=np.int64)
        self._signals, self._set = signals, dict[str, float]()  # by those that were dropped
        self._kept, self._first, self._sent = NO_FUNCTIONS, 0, 0
        self.done = 0  # by the machine

    def feed_share(self, block: IntArray, feed: float, spindle: float) -> FloatArray:
        """Return the factor on the feed of each block under overrides; M49 and G95 affect it."""
        if self._signals.spindle.speed < 0 or not (self._set or len(self._kept)):
            return np.full(len(block), feed)
        signals = self._signals
        names = [signal.name for signal in signals.outputs]

        def value(name: str) -> FloatArray:
            mine = self._output[self._kept.step] == names.index(name)
            values = np.concatenate([[self._set.get(name, 0.0)], self._kept.value[mine]])
            return values[np.searchsorted(self._kept.block[mine], block, side='right')]

        turns = np.where(value(SPINDLE_FIXED) == 0.0, spindle, 1.0)
        most = signals.outputs[names.index(SPEED)].high
        turns = np.minimum(turns, most / np.maximum(value(SPEED), 1e-9))
        share = np.where(value(FEED_FIXED) == 0.0, feed, 1.0)
        return np.asarray(share * np.where(value(PER_TURN) == 0.0, 1.0, turns))

    def told(self, done: int) -> None:
        """Record how many functions the machine has executed; it cannot be more than were sent."""
        self.done = min(done, max(self._sent, self.done))

    def push(self, functions: Functions) -> None:
        drop = min(max(self.done - self._first, 0), len(self._kept))
        gone = self._kept[:drop]
        if len(self._output):
            outputs = self._output[gone.step].tolist()
            for output, value in zip(outputs, gone.value.tolist(), strict=True):
                self._set[self._signals.outputs[output].name] = value
        self._first += drop
        self._kept = Functions.concatenate([self._kept[drop:], functions])

    def between(self, before: int, last: int | None) -> tuple[Functions, int]:
        """Return functions after block ``before`` up to ``last``, and the number of the first."""
        kept, done = self._kept, self.done - self._first
        first = max(kept.until(before), min(max(done, 0), len(kept)))
        after = len(kept) if last is None else max(kept.until(last), first)
        self._sent = max(self._sent, self._first + after)
        return kept[first:after], self._first + first


class ChunkCutter:
    """Cuts the setpoints of one plan into chunks. Those after the last known stop are kept."""

    def __init__(self, size: int, number: int, functions: FunctionQueue):
        self._size, self._functions, self._block = size, functions, -1  # the last block cut
        self._first = self.next_number = number
        self._kept: deque[Setpoints] = deque()  # from setpoint _first on
        self.stops: deque[tuple[int, Setpoints | None]] = deque()  # known; None: at rest
        self._waits: dict[int, Wait] = {}

    def take(self, samples: Setpoints) -> None:
        if len(samples):
            self._kept.append(samples)
            self.next_number += len(samples)

    def end_leg(self, wait: Wait) -> None:
        self.stops.append((self.next_number - 1, None))
        self._waits[self.next_number - 1] = wait

    def cut(self) -> list[Chunk]:
        if not self.stops:
            return []
        kept = Setpoints.concatenate(list(self._kept))
        chunks: list[Chunk] = []
        base = begin = self._first
        while self.stops:
            end = begin + self._size
            end = min(end, min((n + 1 for n in self._waits if n >= begin), default=end))
            while self.stops and self.stops[0][0] < end - 1:
                self.stops.popleft()
            if not self.stops:
                break
            number, stop = self.stops[0]
            tail = kept[end - base : number + 1 - base]
            if stop is not None:
                tail = Setpoints.concatenate([tail, stop])
            wait = self._waits.pop(end - 1, Wait.NOTHING)
            chunks.append(self._chunk(kept[begin - base : end - base], tail, wait))
            begin = end
        self._first = begin
        rest = kept[begin - base :]
        self._kept = deque([rest] if len(rest) else [])
        return chunks

    def _chunk(self, samples: Setpoints, tail: Setpoints, wait: Wait) -> Chunk:
        """Return a chunk with its functions; the chunk before an approach has none."""
        if wait is Wait.APPROACH:
            return Chunk(samples, tail, wait)
        last = int(samples.block[-1])
        until = int(tail.block[-1]) if len(tail) else last
        found = self._functions.between(self._block, None if wait is Wait.END else until)
        self._block = last
        return Chunk(samples, tail, wait, *found)


def way_down(
    pieces: Sequence[PlannedPiece], begin: float, ahead: AxisPath, table: FloatArray
) -> PlannedPiece | None:
    """Return the motion from time ``begin`` [s] to the first possible stop, and this stop."""
    driven: list[PlannedPiece] = []
    for piece in pieces:
        first, last = max(begin, float(piece.law.time[0])), piece.law.end_time
        for time in np.arange(first, last, STOP_EVERY):
            s, v, a, _ = (float(x[0]) for x in piece.law.evaluate(np.array([time])))
            stop = stop_law(ahead, (s, v, a), table, float(time), LEEWAY)
            if stop is not None:
                return PlannedPiece.join([*driven, *between(piece, first, float(time)), stop])
        driven += between(piece, first, last)
    if driven and driven[-1].law.evaluate(np.array([last]))[1][0] < STILL:
        return PlannedPiece.join(driven)
    return None


def between(piece: PlannedPiece, begin: float, end: float) -> list[PlannedPiece]:
    """Return the motion between two times [s]; [] if no path is left between them."""
    law = piece.law
    if end <= begin:
        return []
    first, last = law.piece_at(np.array([begin, end])).tolist()
    last -= law.time[last] == end and last > first
    rows = np.arange(first, last + 1)
    times = np.maximum(law.time[rows], begin)
    s, v, a, j = law.evaluate(times, rows)
    ends = np.append(times[1:], end)
    until = float(law.evaluate(np.array([end]), rows[-1:])[0][0])
    places = grid_place(piece.path, float(s[0])), grid_place(piece.path, until)
    if places[0] == places[1]:
        return []
    path = cut_between(piece.path, *places, np.array(places))
    start = int(np.searchsorted(piece.path.s, places[0], side='right')) - 1
    cells = np.maximum(law.cell[rows] - start, 0)
    return [PlannedPiece(path, MotionLaw(times, ends - times, s, v, a, j, cells))]
