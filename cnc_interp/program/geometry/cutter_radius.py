"""Cutter radius compensation: from the contour of the part to the path of the tool centre.

Each element is offset by d, positive to the left (G41): a line along its normal, an arc to the
radius R - d if it runs counter-clockwise, else R + d. At an outer corner the tool rolls about the
vertex; at an inner one the offsets are cut where they meet. Points in the plane are complex.

The first line after G41 ends beside the next element's start; in LinuxCNC, beside its own end.

Where the contour meets itself, it closes a loop, and the tool must not cut into that loop.
It may cut into the leads, the elements that lead to the loop and away from it.
"""

from __future__ import annotations

from cmath import exp
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from math import isfinite, nan, pi

import numpy as np

from cnc_interp.core import MM, FloatArray, ProgramError
from cnc_interp.program.geometry import target_row as col

SMOOTH = 1e-6  #: Elements whose directions differ by less meet without a corner [rad].
#: Length below which elements are left out, and rounding error of intersections [m].
SHORTEST, ROUNDING = 1e-9, 1e-9
#: Number of neighbouring contour elements with which a piece of the path is compared.
COMPARED = 60
#: Largest number of leads before and after a loop; largest gap at which a loop closes, and length
#: of the shortest loop [m].
LEADS, CLOSED, SHORTEST_LOOP = 4, 0.01 * MM, 0.1 * MM
#: At inner turns below this angle, offsets that do not meet are joined as they are. At turns
#: that differ from half a turn by less, the tool rolls about the vertex [rad].
NEARLY_SMOOTH = 0.05
#: Points of an element at which its distance from others is compared, 0 (start) to 1 (end).
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_NO_FIT = 'the cutter does not fit here; use a smaller radius, or round the contour'


Told = Callable[[ProgramError], None]  #: Receives faults that give a notice instead of a refusal.


@dataclass(frozen=True)
class Element:
    #: End points [m].
    start: complex
    end: complex
    centre: complex = 0j  #: Centre of an arc [m].
    sweep: float = nan  #: Angle of an arc, counter-clockwise positive [rad]; NaN of a line.
    along: complex = 0j  #: Direction of a line, also of one that was cut down to a point.

    @staticmethod
    def line(start: complex, end: complex) -> Element:
        return Element(start, end, along=(end - start) / abs(end - start))

    @property
    def is_arc(self) -> bool:
        return isfinite(self.sweep)

    @property
    def radius(self) -> float:
        return abs(self.start - self.centre)

    @property
    def curvature(self) -> float:
        """Curvature, counter-clockwise positive [1/m]."""
        return float(np.copysign(1.0 / self.radius, self.sweep)) if self.is_arc else 0.0

    def direction(self, point: complex) -> complex:
        if not self.is_arc:
            return self.along
        away = (point - self.centre) * (1j if self.sweep > 0.0 else -1j)
        return away / abs(away)

    @property
    def length(self) -> float:
        return self.radius * abs(self.sweep) if self.is_arc else abs(self.end - self.start)

    def is_near(self, other: Element, distance: float) -> bool:
        """Return whether two elements may be within ``distance`` [m], by circles around both."""
        middles, reach = [], distance
        for one in (self, other):
            middles.append(one.centre if one.is_arc else 0.5 * (one.start + one.end))
            reach += one.radius if one.is_arc else 0.5 * abs(one.end - one.start)
            reach += abs(abs(one.end - one.centre) - one.radius) if one.is_arc else 0.0
        return abs(middles[1] - middles[0]) <= reach

    def parted(self, point: complex) -> tuple[Element, Element]:
        """Return the parts of the element before and after one of its points."""
        first, second = replace(self, end=point), replace(self, start=point)
        if self.is_arc:
            sign = float(np.copysign(1.0, self.sweep))
            angle = float(np.angle((point - self.centre) / (self.start - self.centre)))
            turned = sign * angle % (2.0 * pi) % abs(self.sweep)
            first, second = (
                replace(first, sweep=sign * turned),
                replace(second, sweep=self.sweep - sign * turned),
            )
        return first, second

    def at(self, share: float) -> complex:
        if not self.is_arc:
            return self.start + share * (self.end - self.start)
        return self.centre + (self.start - self.centre) * exp(1j * share * self.sweep)

    def distance(self, point: complex) -> float:
        nearest = [abs(point - self.start), abs(point - self.end)]
        if self.is_arc:
            angle = np.angle((point - self.centre) / (self.start - self.centre))
            if self.sweep < 0.0:
                angle = -angle
            if angle % (2.0 * pi) <= abs(self.sweep):
                nearest.append(abs(abs(point - self.centre) - self.radius))
        else:
            along = ((point - self.start) * self.direction(self.start).conjugate()).real
            if 0.0 < along < abs(self.end - self.start):
                nearest.append(abs(point - self.start - along * self.direction(self.start)))
        return min(nearest)

    def offset(self, distance: float) -> Element | None:
        start = self.start + 1j * distance * self.direction(self.start)
        end = self.end + 1j * distance * self.direction(self.end)
        if self.is_arc:
            left = distance if self.sweep > 0.0 else -distance
            if min(self.radius, abs(self.end - self.centre)) - left < SHORTEST:
                return None
        return replace(self, start=start, end=end)

    def between(self, start: complex, end: complex) -> Element | None:
        if not self.is_arc:
            along = ((end - start) * self.direction(self.start).conjugate()).real
            return replace(self, start=start, end=end) if along > -ROUNDING else None
        turned = [
            float(np.angle((new - self.centre) / (old - self.centre)))
            for new, old in ((start, self.start), (end, self.end))
        ]
        sweep = self.sweep + turned[1] - turned[0]
        if sweep * self.sweep < 0.0:
            return None
        return replace(self, start=start, end=end, sweep=sweep)


def crossings(first: Element, second: Element) -> list[complex]:
    radius, other = abs(first.end - first.centre), second.radius  # at the vertex
    if first.is_arc and second.is_arc:
        apart = abs(second.centre - first.centre)
        if apart < SHORTEST:
            return []
        along = (second.centre - first.centre) / apart
        share = (apart**2 + radius**2 - other**2) / (2.0 * apart)
        square = radius**2 - share**2
        root = np.sqrt(max(square, 0.0))
        points = [first.centre + (share + side * 1j * root) * along for side in (1, -1)]
        return points if square > 0.0 else []
    if first.is_arc or second.is_arc:
        line, arc, radius = (second, first, radius) if first.is_arc else (first, second, other)
        foot = line.start + ((arc.centre - line.start) * line.along.conjugate()).real * line.along
        square = radius**2 - abs(arc.centre - foot) ** 2
        found = (foot + side * np.sqrt(max(square, 0.0)) * line.along for side in (1, -1))
        return list(found) if square > 0.0 else []
    across = (first.along.conjugate() * second.along).imag
    if abs(across) < SHORTEST:
        return []
    way = (second.start - first.start) * second.along.conjugate()
    return [first.start - way.imag / across * first.along]


def meeting(first: Element, second: Element) -> complex | None:
    """Return the point where the second element first meets the first, earlier one; or None."""
    if not first.is_near(second, CLOSED):
        return None
    found = [
        point
        for point in (*crossings(first, second), first.start, second.end)
        if max(first.distance(point), second.distance(point)) < CLOSED
    ]
    return min(found, key=lambda point: abs(point - second.start), default=None)


class CutterRadius:
    def __init__(
        self,
        distance: float,
        frame: FloatArray,
        before: FloatArray,
        source: str,
        own_entry: bool,
        told: Told | None = None,
    ):
        self._distance, self._frame, self._source = distance, frame, source
        self._own_entry, self._told = own_entry, told
        self._rotary, self._point = before[col.ROTARY].copy(), before[col.POINT].copy()
        self._here = self._flat(before[col.POINT])
        self._last: Element | None = None  # offset, from where the one before it ends
        self._before: Element | None = None  # the last one, as programmed
        self._stood: complex | None = None  # where the line began that leads to the contour
        self._count = 0  # elements of the contour so far
        # The first elements, and those of the last ones, as programmed, each with its number and
        # how far along the contour it ends [m]; leads are left out.
        self._first: list[tuple[int, Element, float]] = []
        self._parts: deque[tuple[int, Element, float]] = deque(maxlen=COMPARED)
        self._length = 0.0  # of the contour so far [m]
        self._is_closed = False  # whether a loop begins in the first elements
        self._met = -LEADS - 1  # the last element that meets an earlier one
        # Pieces of the path that cut into what may be a lead: with their row, and both numbers.
        self._pending: list[tuple[Element, FloatArray, int, int]] = []
        # The row of the last element, and moves along the normal.
        self._rows: list[FloatArray] = []
        self._path: deque[tuple[int, Element]] = deque(maxlen=COMPARED)  # of the tool centre

    def _flat(self, point: FloatArray) -> complex:
        return complex(point @ self._frame[:, 0], point @ self._frame[:, 1])

    def _moved(self, row: FloatArray, place: complex) -> FloatArray:
        change = place - self._flat(row[col.POINT])
        moved = row.copy()
        moved[col.POINT] += change.real * self._frame[:, 0] + change.imag * self._frame[:, 1]
        return moved

    def _fault(self, message: str, row: FloatArray) -> ProgramError:
        return ProgramError(message, self._source, int(row[col.LINE]))

    @property
    def waits(self) -> bool:
        return bool(self._rows)

    def stop_here(self, kind: float) -> None:
        self._rows[-1][col.EXACT_STOP] = max(self._rows[-1][col.EXACT_STOP], kind)

    def push(self, row: FloatArray) -> list[FloatArray]:
        if np.abs(np.nan_to_num(row[col.ROTARY] - self._rotary)).max() > 0.0:
            raise self._fault(
                'no rotary motion is possible in cutter compensation; write G40 first', row
            )
        element = self._element(row)
        if element is None:
            if self._rows:
                self._rows.append(row)
                return []
            return [row]
        self._pace(element, row)
        self._here = element.end
        if not (self._count or self._rows):
            if element.is_arc or self._own_entry:
                self._enter(element, row)
            self._rows, self._before = [row], element
            return []
        offset = element.offset(self._distance)
        if offset is None:
            raise self._fault(_NO_FIT, row)
        ready = self._corner(element, offset, row)
        self._compare(element, row)
        self._rows, self._before = [row], element
        return ready

    def _pace(self, element: Element, row: FloatArray) -> None:
        """Replace the duration of a row (G93) by the feedrate on its contour, also for corners."""
        rise = float((row[col.POINT] - self._point) @ self._frame[:, 2])
        self._point = row[col.POINT].copy()
        if isfinite(row[col.DURATION]):
            row[col.FEEDRATE] = float(np.hypot(element.length, rise)) / row[col.DURATION]
            row[col.DURATION] = nan

    def _enter(self, element: Element, row: FloatArray) -> None:
        left, stands = 1j * self._distance, element.start
        if not element.is_arc:
            if abs(element.end - element.start) <= abs(self._distance):
                raise self._fault(
                    'the line to the contour must be longer than the radius of the cutter', row
                )
            self._stood, self._last = stands, element.offset(self._distance)
            return
        end = element.end + left * element.direction(element.end)
        inward = (element.centre - element.end) / abs(element.centre - element.end)
        beside = ((stands - end) * inward.conjugate()).real
        if element.offset(self._distance) is None or beside < SHORTEST:
            raise self._fault(_NO_FIT, row)
        centre = end + abs(stands - end) ** 2 / (2.0 * beside) * inward
        turn = float(np.angle((end - centre) / (stands - centre)))
        sense = float(np.copysign(1.0, element.sweep))
        self._last = Element(stands, end, centre, sense * (sense * turn % (2.0 * pi)))

    def _element(self, row: FloatArray) -> Element | None:
        """Return the element that leads to a row, in the plane; None if it is along the normal."""
        end = self._flat(row[col.POINT])
        if not isfinite(row[col.SWEEP]):
            return Element.line(self._here, end) if abs(end - self._here) > SHORTEST else None
        turn = float(row[col.NORMAL] @ self._frame[:, 2])
        if abs(abs(turn) - 1.0) > SMOOTH:
            raise self._fault('the arc must lie in the plane of the cutter compensation', row)
        sweep = float(np.copysign(1.0, turn) * row[col.SWEEP])
        return Element(self._here, end, self._flat(row[col.CENTRE]), sweep)

    def _corner(self, element: Element, offset: Element, row: FloatArray) -> list[FloatArray]:
        if self._last is None:
            # The line to the contour ends beside its first element.
            self._last = offset
            return [self._moved(waiting, offset.start) for waiting in self._rows]
        assert self._before is not None
        leaves = self._before.direction(self._before.end)
        turn = float(np.angle(element.direction(element.start) / leaves))
        side = float(np.copysign(1.0, self._distance))
        bend = (self._before.curvature + element.curvature) * side
        back, is_inner = pi - abs(turn), turn * side > 0.0
        if back < SMOOTH or (back < NEARLY_SMOOTH and bend < 0.0):
            is_inner = bend < 0.0  # the contour reverses, and the tool is between both elements
        vertex, inner = element.start, list[tuple[complex, Element]]()
        for point in crossings(self._last, offset) if is_inner else []:
            after = offset.between(point, offset.end)
            if after is not None and self._last.between(self._last.start, point) is not None:
                inner.append((point, after))
        is_inner = is_inner and (bool(inner) or back >= NEARLY_SMOOTH)
        if abs(turn) < SMOOTH:
            ready, self._last = self._to(offset.start, row), offset
        elif not is_inner:
            turn -= 2.0 * pi * side * (turn * side > 0.0)
            ready = self._to(vertex + 1j * self._distance * leaves, row)
            about = Element(self._flat(ready[-1][col.POINT]), offset.start, vertex, turn)
            self._keep_clear(about, row)
            around = self._row_of(about, ready[-1])
            if isfinite(row[col.FEEDRATE]):
                around[col.FEEDRATE] = row[col.FEEDRATE]  # F of the element after the corner
            # The program does not wait at its end.
            around[col.EXACT_STOP] = float(ready[-1][col.EXACT_STOP] == 1.0)
            ready.append(around)
            self._last = offset
        elif inner:
            last = self._last

            def order(each: tuple[complex, Element]) -> tuple[bool, float]:
                beyond = max(last.distance(each[0]), offset.distance(each[0])) > CLOSED
                return beyond, abs(each[0] - vertex)

            point, after = min(inner, key=order)  # prefers points of both elements
            ready, self._last = self._to(point, row), after
        else:
            ready = self._to(vertex + 1j * self._distance * leaves, row)
            joined = offset.between(self._flat(ready[-1][col.POINT]), offset.end)
            if abs(turn) > NEARLY_SMOOTH or joined is None:
                raise self._fault(_NO_FIT, row)
            self._last = joined
        return ready

    def _to(self, end: complex, row: FloatArray) -> list[FloatArray]:
        """End the last element at a point; return its row, and those of moves along the normal."""
        assert self._last is not None
        part = self._last.between(self._last.start, end)
        if part is None:
            raise self._fault(_NO_FIT, row)
        if self._stood is not None:
            part, self._stood = replace(part, start=self._stood), None
        elif self._count:
            self._keep_clear(part, self._rows[0])
        first, *others = self._rows
        return [self._row_of(part, first), *(self._moved(other, end) for other in others)]

    def _keep_clear(self, path: Element, row: FloatArray) -> None:
        self._path.append((self._count - 1, path))
        for number, element, _ in self._parts:
            self._judge(path, element, row, number, self._count - 1)

    def _row_of(self, part: Element, row: FloatArray) -> FloatArray:
        made = self._moved(row, part.end)
        if not part.is_arc:
            return made
        made[col.CENTRE] = made[col.POINT]
        away = part.centre - part.end
        made[col.CENTRE] += away.real * self._frame[:, 0] + away.imag * self._frame[:, 1]
        made[col.NORMAL], made[col.SWEEP] = self._frame[:, 2], part.sweep
        return made

    def _compare(self, element: Element, row: FloatArray) -> None:
        """Add a contour element; if it is not a lead-in, check that the path does not gouge it."""
        number, kept = self._count, element
        self._length += element.length
        is_lead = number - self._met <= LEADS
        self._count += 1
        if number <= LEADS:
            self._first.append((number, element, self._length))
        if element.is_arc and abs(element.sweep) > 2.0 * pi - SMOOTH:
            self._met = number
            self._close(number, element)
        elif (met := self._meeting(element)) is not None:
            self._met = number
            first, where = met
            kept, _ = element.parted(where)
            if first <= LEADS:
                self._close(first, self._first[first][1].parted(where)[1])
        if is_lead:
            return
        self._parts.append((number, kept, self._length))
        for other, path in list(self._path)[:-1]:
            self._judge(path, kept, row, number, other)

    def _meeting(self, element: Element) -> tuple[int, complex] | None:
        """Return number and meeting point of the first element that this one meets; or None."""
        recent = [part for part in self._parts if part[0] > LEADS]
        for other, part, end in (*self._first, *recent):
            loop = self._length - element.length - end
            if loop > SHORTEST_LOOP and (where := meeting(part, element)) is not None:
                return other, where
        return None

    def _close(self, first: int, begin: Element) -> None:
        """Close a loop that begins at element ``first``; ``begin`` is that element or its rest."""
        if self._is_closed or first > LEADS:
            return
        self._is_closed = True
        _, _, end = self._first[first]
        self._first[first] = first, begin, end
        kept = [self._first[first], *(part for part in self._parts if part[0] > first)]
        self._parts = deque(kept, COMPARED)
        for path, row, number, other in self._pending:
            if number >= first:
                self._judge(path, self._first[number][1], row, number, other)
        self._pending.clear()

    def _judge(
        self, path: Element, part: Element, row: FloatArray, number: int, other: int
    ) -> None:
        """Raise if the path comes too near a contour element; possible leads are checked later."""
        if not path.is_near(part, abs(self._distance)):
            return
        apart = min(
            min(path.distance(part.at(share)), part.distance(path.at(share))) for share in SHARES
        )
        if apart >= abs(self._distance) - row[col.CONTOUR]:
            return
        if number <= LEADS and not self._is_closed and abs(other - number) > 1:
            self._pending.append((path, row, number, other))
            return
        short = (abs(self._distance) - apart) / MM
        fault = self._fault(f'{_NO_FIT}; it would cut {short:.3g} mm into the contour', row)
        if self._told is None:
            raise fault
        self._told(fault)

    def end(self) -> Iterable[FloatArray]:
        rows, self._rows = self._rows, []
        if self._first:
            self._close(0, self._first[0][1])  # without a loop, all of it is kept
        if not rows or self._last is None:
            return rows
        self._rows = rows
        ready = self._to(self._last.end, rows[0])
        self._rows = []
        return ready
