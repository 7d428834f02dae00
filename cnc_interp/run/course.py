"""The course: the path of a run that is still needed, cut into legs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.feedrate.feed_planner import PlannedPiece
from cnc_interp.feedrate.stop_law import cut_between
from cnc_interp.kinematics.axis_path import AxisPath, cut, evaluate, refine
from cnc_interp.run.chunk import Wait
from cnc_interp.run.setpoints import Setpoints

#: Cells of the path planned at a time.
PORTION = 500
#: Cells planned at a time where the drives wait for the first setpoint.
FINE = 64
#: Cells of the path that a stop may use.
AHEAD = 4000
#: Cells into which the way down to a lower feed is cut.
ENVELOPE = 24
#: Feed allowed on the way down, as a multiple of the fastest stop [-].
ABOVE = 1.02
#: Places nearer than this are the same place; no cell is so short [m].
SAME = 1e-13


@dataclass(frozen=True)
class LegEnd:
    """The end of a leg between parts of the path."""

    wait: Wait


class Course:
    """Parts of the path, and the ends of legs between them, in order."""

    def __init__(self) -> None:
        self.items: deque[AxisPath | LegEnd] = deque()

    def push(self, path: AxisPath) -> list[AxisPath]:
        """Add a part of the path and return it in portions."""
        portions = portions_of(path, PORTION)
        self.items.extend(portions)
        return portions

    def end_leg(self, wait: Wait) -> LegEnd:
        """End the leg at the end of the path known so far."""
        end = LegEnd(wait)
        self.items.append(end)
        return end

    def lead(self, way: AxisPath, s: float) -> None:
        """Put a way of its own, down to rest, in the place of the path before a place [m]."""
        self.items = deque([way, LegEnd(Wait.NOTHING), *self.after(s)])

    def release(self, s: float) -> None:
        """Drop the path before a place [m]."""
        while len(self.items) > 1:
            first = self.items[0]
            if isinstance(first, AxisPath) and first.s[-1] >= s:
                return
            following = self.items[1]
            if isinstance(first, LegEnd) and not (
                isinstance(following, AxisPath) and following.s[0] < s
            ):
                return
            self.items.popleft()

    @property
    def first_block(self) -> int:
        """The block in which the kept path begins; 0 where none is kept."""
        parts = (item for item in self.items if isinstance(item, AxisPath))
        return next((int(part.cell_block[0]) for part in parts), 0)

    def ahead(self, s: float) -> AxisPath:
        """Return the path from the part that contains s [m] to the end of its leg."""
        parts: list[AxisPath] = []
        cells = 0
        for item in self.items:
            if isinstance(item, LegEnd):
                if parts:
                    break
            elif item.s[-1] > s or parts:
                parts.append(item)
                cells += len(item.s)
                if cells > AHEAD:
                    break
        return AxisPath.join(parts)

    def rest_at(self, s: float) -> Setpoints | None:
        """Return the setpoint of a machine that rests at a place [m]; None if it was dropped."""
        parts = (item for item in self.items if isinstance(item, AxisPath))
        path = next((p for p in parts if p.s[0] - SAME <= s <= p.s[-1] + SAME), None)
        if path is None:
            return None
        cell = min(max(int(np.searchsorted(path.s, s)) - 1, 0), len(path.s) - 2)
        place = np.array([s])
        position = evaluate(path, place, np.array([cell]))[0]
        still: FloatArray = np.zeros_like(position)
        return Setpoints(
            time=np.zeros(1), position=position, velocity=still, acceleration=still, jerk=still,
            block=path.cell_block[cell : cell + 1].copy(), s=place,
        )  # fmt: skip

    def first_rest(self) -> Setpoints | None:
        """Return the setpoint of a machine that rests where the kept path begins."""
        parts = (item for item in self.items if isinstance(item, AxisPath))
        return next((self.rest_at(float(part.s[0])) for part in parts), None)

    def after(self, s: float) -> deque[AxisPath | LegEnd]:
        """Return all items after a place [m]; the part that contains it is cut there."""
        rest: deque[AxisPath | LegEnd] = deque()
        passed = False
        for item in self.items:
            if isinstance(item, LegEnd):
                # at the very place: only the end of the program still counts
                if passed or item.wait is Wait.END:
                    rest.append(item)
            elif item.s[-1] > s + SAME:
                passed = True
                rest.append(item if item.s[0] > s - SAME else from_place(item, s))
        return rest


def portions_of(path: AxisPath, cells: int) -> list[AxisPath]:
    """Cut a path into portions of ``cells`` cells; the last may have fewer."""
    borders = [*range(0, len(path.s) - 1, cells), len(path.s) - 1]
    return [cut(path, a, b) for a, b in pairwise(borders)]


def finely(items: deque[AxisPath | LegEnd]) -> deque[AxisPath | LegEnd]:
    """Cut the first parts into small portions, so that the first motion is planned soon."""
    rest: deque[AxisPath | LegEnd] = deque()
    cells = 0
    for item in items:
        if isinstance(item, LegEnd) or cells >= PORTION:
            rest.append(item)
        else:
            rest.extend(portions_of(item, FINE))
            cells += len(item.s) - 1
    return rest


def from_place(path: AxisPath, s: float) -> AxisPath:
    """Cut off the path before a place inside it [m]."""
    nearest = int(np.argmin(np.abs(path.s - s)))
    if abs(path.s[nearest] - s) <= SAME:
        return cut(path, nearest, len(path.s) - 1)
    return cut_between(path, s, float(path.s[-1]), np.array([s]))


def slowed(
    path: AxisPath, scaled: Callable[[AxisPath], FloatArray], way_down: PlannedPiece | None
) -> AxisPath:
    """Scale the feed of a part. During a stop the feed is at least the speed of the stop."""
    if way_down is None or path.s[0] >= way_down.path.s[-1]:
        return replace(path, cell_feed=scaled(path))
    law = way_down.law
    begin, end = float(law.s[0]), float(way_down.path.s[-1])
    fine = refine(path, np.linspace(begin, end, ENVELOPE))
    fastest = fastest_in_cells(law.time, way_down, fine.s)
    feed = np.maximum(scaled(fine), ABOVE * fastest)
    return replace(fine, cell_feed=feed)


def fastest_in_cells(time: FloatArray, way_down: PlannedPiece, s: FloatArray) -> FloatArray:
    """Return the largest speed of a stop in each cell."""
    law = way_down.law
    instants = np.linspace(time[0], law.end_time, 20 * ENVELOPE)
    place, speed, _, _ = law.evaluate(instants)
    at = np.interp(s, place, speed, left=float(speed[0]), right=0.0)
    fastest = np.maximum(at[:-1], at[1:])
    cell = np.clip(np.searchsorted(s, place, side='right') - 1, 0, len(s) - 2)
    np.maximum.at(fastest, cell, speed)
    return fastest
