"""The part of a run's path that is still needed, divided into legs from rest to rest."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import FloatArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.feedrate.motion_law import MotionLaw
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import FeedPlanner, PlannedPiece
from cnc_interp.feedrate.stop_law import cut_between
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate, refine
from cnc_interp.program.geometry.subdivide import ragged
from cnc_interp.run.setpoints import Interpolator, Setpoints, Wait

if TYPE_CHECKING:
    from cnc_interp.feedrate.tool_limit import ToolLimit

PORTION = 500  #: Number of path cells planned in one call.
FINE = 64  #: The same at the beginning, while the drives wait for setpoints.
AHEAD = 4000  #: Largest number of path cells that are available for a stop.
ENVELOPE = 24  #: Number of cells into which the path of a stop is divided.
ABOVE = 1.02  #: Feed allowed on the path of a stop, over the speed of the stop [-].
SAME = 1e-13  #: Path positions nearer than this are equal; every cell is longer [m].
#: Planner options in a run: no lower bound of the motion time is computed.
LIVE = PlanOptions(bound=False)
#: Duration of the slices in which motion is sampled. A change of override waits for one slice [s].
SLICE = 0.1
STILL = 1e-9  #: A motion law that ends below this speed ends at rest [m/s].
SAME_TIME = 1e-9  #: Times nearer than this are equal [s].


class Course:
    def __init__(self) -> None:
        self.items: deque[AxisPath | Wait] = deque()

    def push(self, path: AxisPath) -> list[AxisPath]:
        portions = portions_of(path, PORTION)
        self.items.extend(portions)
        return portions

    def lead(self, way: AxisPath, s: float) -> None:
        """Replace the path before position ``s`` [m] by path ``way``, which ends there at rest."""
        self.items = deque([way, Wait.NOTHING, *self.after(s)])

    def release(self, s: float) -> None:
        while len(self.items) > 1:
            first = self.items[0]
            if isinstance(first, AxisPath) and first.s[-1] >= s:
                return
            following = self.items[1]
            if isinstance(first, Wait) and not (
                isinstance(following, AxisPath) and following.s[0] < s
            ):
                return
            self.items.popleft()

    @property
    def first_block(self) -> int:
        return next((int(part.cell_block[0]) for part in self._parts()), 0)

    def _parts(self) -> Iterator[AxisPath]:
        return (item for item in self.items if isinstance(item, AxisPath))

    def ahead(self, s: float) -> AxisPath:
        """Return the path up to the end of the leg, from the part that contains ``s`` [m]."""
        parts: list[AxisPath] = []
        cells = 0
        for item in self.items:
            if isinstance(item, Wait):
                if parts:
                    break
            elif item.s[-1] > s or parts:
                parts.append(item)
                cells += len(item.s)
                if cells > AHEAD:
                    break
        return AxisPath.join(parts)

    def rest_at(self, s: float) -> Setpoints | None:
        """Return the setpoint at rest at path position ``s`` [m]; None if the path is dropped."""
        path = next((p for p in self._parts() if p.s[0] - SAME <= s <= p.s[-1] + SAME), None)
        if path is None:
            return None
        cell = min(max(int(np.searchsorted(path.s, s)) - 1, 0), len(path.s) - 2)
        place = np.array([s])
        position = evaluate(path, place, np.array([cell]))[0]
        return Setpoints.at_rest(0.0, position, path.cell_block[cell : cell + 1].copy(), place)

    def first_rest(self) -> Setpoints | None:
        return next((self.rest_at(float(part.s[0])) for part in self._parts()), None)

    def after(self, s: float) -> deque[AxisPath | Wait]:
        """Return all items after path position ``s`` [m]; a part that contains it is cut there."""
        rest: deque[AxisPath | Wait] = deque()
        passed = False
        for item in self.items:
            if isinstance(item, Wait):
                # at this very place only the end of the program still matters
                if passed or item is Wait.END:
                    rest.append(item)
            elif item.s[-1] > s + SAME:
                passed = True
                rest.append(item if item.s[0] > s - SAME else from_place(item, s))
        return rest


def portions_of(path: AxisPath, cells: int) -> list[AxisPath]:
    borders = [*range(0, len(path.s) - 1, cells), len(path.s) - 1]
    return [cut(path, a, b) for a, b in pairwise(borders)]


def finely(items: deque[AxisPath | Wait]) -> deque[AxisPath | Wait]:
    """Divide the first parts into small portions, so that the first motion is planned soon."""
    rest: deque[AxisPath | Wait] = deque()
    cells = 0
    for item in items:
        if isinstance(item, Wait) or cells >= PORTION:
            rest.append(item)
        else:
            rest.extend(portions_of(item, FINE))
            cells += len(item.s) - 1
    return rest


def from_place(path: AxisPath, s: float) -> AxisPath:
    nearest = int(np.argmin(np.abs(path.s - s)))
    if abs(path.s[nearest] - s) <= SAME:
        return cut(path, nearest, len(path.s) - 1)
    return cut_between(path, s, float(path.s[-1]), np.array([s]))


def to_place(path: AxisPath, s: float) -> AxisPath | None:
    """Return the path before position ``s`` [m]; None if there is none."""
    nearest = int(np.argmin(np.abs(path.s - s)))
    if abs(path.s[nearest] - s) <= SAME:
        return cut(path, 0, nearest) if nearest else None
    return cut_between(path, float(path.s[0]), s, np.array([s]))


def feed_under(
    path: AxisPath, limits: Limits, feed: FloatArray | float, rapid: FloatArray | float
) -> FloatArray:
    """Return the feed of each path cell with overrides [m/s].

    ``feed``, ``rapid``: factors on the feed, and on the speed of rapids (at most 1) [-]: numbers,
    """
    found = np.asarray(path.cell_feed * feed)
    rapids = np.isinf(path.cell_feed)
    share = np.broadcast_to(rapid, found.shape)[rapids]
    if (share < 1.0).any():
        # |q_s| v <= V: the fastest axis runs at a share of its largest velocity.
        ends = path.cell_left[1, rapids], path.cell_right[1, rapids]
        use = np.abs(ends).max(axis=0) / limits.max_velocity
        found[rapids] = np.where(share < 1.0, share / use.max(axis=1), np.inf)
    return found


def slowed(
    path: AxisPath, scaled: Callable[[AxisPath], FloatArray], way_down: PlannedPiece | None
) -> AxisPath:
    """Scale the feed of a part; along the stop ``way_down`` it is at least the stop's speed."""
    if way_down is None or path.s[0] >= way_down.path.s[-1]:
        return replace(path, cell_feed=scaled(path))
    law = way_down.law
    begin, end = float(law.s[0]), float(way_down.path.s[-1])
    fine = refine(path, np.linspace(begin, end, ENVELOPE))
    fastest = fastest_in_cells(law, fine.s)
    feed = np.maximum(scaled(fine), ABOVE * fastest)
    return replace(fine, cell_feed=feed)


def fastest_in_cells(law: MotionLaw, s: FloatArray) -> FloatArray:
    instants = np.linspace(law.time[0], law.end_time, 20 * ENVELOPE)
    place, speed, _, _ = law.evaluate(instants)
    at = np.interp(s, place, speed, left=float(speed[0]), right=0.0)
    fastest = np.maximum(at[:-1], at[1:])
    cell = np.clip(np.searchsorted(s, place, side='right') - 1, 0, len(s) - 2)
    np.maximum.at(fastest, cell, speed)
    return fastest


def sliced(piece: PlannedPiece) -> list[PlannedPiece]:
    law = without_long_rows(piece.law)
    stretch = np.floor((law.time - law.time[0]) / SLICE)
    borders = [0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(law)]
    return [PlannedPiece(piece.path, law[np.arange(a, b)]) for a, b in pairwise(borders)]


def without_long_rows(law: MotionLaw) -> MotionLaw:
    """Divide the rows of a law that last longer than a slice; a slow line may last minutes."""
    parts = np.maximum(1, np.ceil(law.duration / SLICE - 1.0)).astype(np.int64)
    if (parts == 1).all():
        return law
    row, place = ragged(parts)
    duration = law.duration[row] / parts[row]
    time = law.time[row] + place * duration
    s, s_dot, s_ddot, _ = law.evaluate(time, row)
    cut_law = law[row]
    return replace(cut_law, time=time, duration=duration, s=s, s_dot=s_dot, s_ddot=s_ddot)


class Leg:
    def __init__(
        self,
        limits: Limits,
        period: float,
        begun: int = 0,
        start: tuple[float, float] = (0.0, 0.0),
        tool: ToolLimit | None = None,
    ):
        self.period = period
        self.planner = FeedPlanner(limits, LIVE, start, max(begun - 1, 0) * period, tool)
        self.interpolator = Interpolator(period, begun)
        self.slices: deque[PlannedPiece] = deque()
        self.wait: Wait | None = None
        self.moves = False
        #: Number of the setpoint at time 0; whether it is known because sampling has begun.
        self.number_of_zero, self.sampled = 0, False

    def push(self, path: AxisPath) -> None:
        for piece in self.planner.push(path):
            self.slices.extend(sliced(piece))
        self.moves = True

    def finish(self, wait: Wait) -> None:
        for piece in self.planner.finish():
            self.slices.extend(sliced(piece))
        self.wait = wait

    def drive(self, piece: PlannedPiece, wait: Wait) -> None:
        self.slices.extend(sliced(piece))
        self.moves, self.wait = True, wait

    @property
    def planned(self) -> float:
        if not self.slices:
            return 0.0
        return float(self.slices[-1].law.end_time - self.slices[0].law.time[0])

    def state_at(self, number: int, piece: PlannedPiece) -> tuple[float, float, float]:
        """Return s, s_dot and s_ddot at setpoint ``number`` of slice ``piece`` [m, m/s, m/s2]."""
        time = (number - self.number_of_zero) * self.period
        s, v, a, _ = (float(x[0]) for x in piece.law.evaluate(np.array([time])))
        rests = time >= piece.law.end_time - SAME_TIME and v < STILL  # after the last slice
        return (s, 0.0, 0.0) if rests else (s, v, a)
