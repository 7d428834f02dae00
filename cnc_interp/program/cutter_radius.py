"""
Cutter radius compensation: from the contour of the part to the path of the tool centre.

G41 keeps the tool to the left of the contour, G42 to the right, at the distance of its radius. In
the plane of the contour each element is offset by d (left is positive): a line along its normal,
an arc to the radius R - d if it runs counter-clockwise, else R + d. At an outer corner the tool
rolls about the vertex, at an inner corner the offsets are cut where they meet. A row of targets
waits until the next one is known. Points in the plane are complex numbers.
"""

from __future__ import annotations

from cmath import exp
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import isfinite, nan, pi

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import MM
from cnc_interp.program.moves import (
    CENTRE,
    CONTOUR,
    EXACT_STOP,
    LINE,
    NORMAL,
    POINT,
    ROTARY,
    SWEEP,
)

#: Two elements meet without a corner if their directions differ by less [rad].
SMOOTH = 1e-6
#: An element that is shorter is none [m]. Rounding of intersections [m].
SHORTEST, ROUNDING = 1e-9, 1e-9
#: A cutter can touch the contour again within so many elements; more are not compared.
COMPARED = 60
#: Shares of an element at which its distance from others is compared.
SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
_NO_FIT = 'the cutter does not fit in here; take a smaller radius, or round the contour'


@dataclass(frozen=True)
class Element:
    """A line or an arc in the plane."""

    #: End points [m].
    start: complex
    end: complex
    centre: complex = 0j  #: Centre of an arc [m].
    sweep: float = nan  #: Angle of an arc, counter-clockwise positive [rad]; NaN of a line.

    @property
    def is_arc(self) -> bool:
        """Whether this is an arc."""
        return isfinite(self.sweep)

    @property
    def radius(self) -> float:
        """Radius of an arc at its start [m]."""
        return abs(self.start - self.centre)

    def direction(self, point: complex) -> complex:
        """Return the direction of motion at a point of the element, of length 1."""
        if not self.is_arc:
            return (self.end - self.start) / abs(self.end - self.start)
        away = (point - self.centre) * (1j if self.sweep > 0.0 else -1j)
        return away / abs(away)

    def at(self, share: float) -> complex:
        """Return the point at a share of the element, 0 to 1."""
        if not self.is_arc:
            return self.start + share * (self.end - self.start)
        return self.centre + (self.start - self.centre) * exp(1j * share * self.sweep)

    def distance(self, point: complex) -> float:
        """Return the distance of a point [m]."""
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
        """Return the element at a distance to its left; None if an arc has no radius left."""
        start = self.start + 1j * distance * self.direction(self.start)
        end = self.end + 1j * distance * self.direction(self.end)
        if self.is_arc:
            left = distance if self.sweep > 0.0 else -distance
            if self.radius - left < SHORTEST:
                return None
        return replace(self, start=start, end=end)

    def between(self, start: complex, end: complex) -> Element | None:
        """Return the element from and to other points on it; None if that runs backwards."""
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
    """Return the points in which the line or circle of one element meets that of another."""
    if first.is_arc and not second.is_arc:
        return crossings(second, first)
    if not first.is_arc:
        along = first.direction(first.start)
        if not second.is_arc:
            across = (along.conjugate() * second.direction(second.start)).imag
            if abs(across) < SHORTEST:
                return []
            way = (second.start - first.start) * second.direction(second.start).conjugate()
            return [first.start - way.imag / across * along]
        foot = first.start + ((second.centre - first.start) * along.conjugate()).real * along
        square = second.radius**2 - abs(second.centre - foot) ** 2
        return [foot + side * np.sqrt(square) * along for side in (1, -1)] if square > 0.0 else []
    apart = abs(second.centre - first.centre)
    if apart < SHORTEST:
        return []
    along = (second.centre - first.centre) / apart
    share = (apart**2 + first.radius**2 - second.radius**2) / (2.0 * apart)
    square = first.radius**2 - share**2
    if square <= 0.0:
        return []
    return [first.centre + (share + side * 1j * np.sqrt(square)) * along for side in (1, -1)]


class CutterRadius:
    """One stretch of compensation, from G41 or G42 to G40."""

    def __init__(self, distance: float, frame: FloatArray, before: FloatArray, source: str):
        self._distance, self._frame, self._source = distance, frame, source
        self._rotary = before[ROTARY].copy()
        self._here = self._flat(before[POINT])
        self._last: Element | None = None  # offset, from where the one before it ends
        # The row of the last element, and moves along the normal.
        self._rows: list[FloatArray] = []
        self._parts: deque[Element] = deque(maxlen=COMPARED)  # of the contour, as programmed
        self._path: deque[Element] = deque(maxlen=COMPARED)

    def _flat(self, point: FloatArray) -> complex:
        """Return a point in the plane."""
        return complex(point @ self._frame[:, 0], point @ self._frame[:, 1])

    def _moved(self, row: FloatArray, place: complex) -> FloatArray:
        """Return a row whose point has another place in the plane."""
        change = place - self._flat(row[POINT])
        moved = row.copy()
        moved[POINT] += change.real * self._frame[:, 0] + change.imag * self._frame[:, 1]
        return moved

    def _fault(self, message: str, row: FloatArray) -> ProgramError:
        """Return an error at the line of a row."""
        return ProgramError(message, self._source, int(row[LINE]))

    @property
    def waits(self) -> bool:
        """Whether a row waits for the next one."""
        return bool(self._rows)

    def stop_here(self, kind: float) -> None:
        """Stop at the end of the row that came last, as ``TargetColumns.stop_here``."""
        self._rows[-1][EXACT_STOP] = max(self._rows[-1][EXACT_STOP], kind)

    def push(self, row: FloatArray) -> list[FloatArray]:
        """
        Take the next row of the program.

        Parameters
        ----------
        row : ndarray
            Row of targets.

        Returns
        -------
        list of ndarray
            Rows of the path of the tool centre that are final.

        Raises
        ------
        ProgramError
            If the cutter does not fit, or the row cannot be compensated.

        """
        if np.abs(np.nan_to_num(row[ROTARY] - self._rotary)).max() > 0.0:
            raise self._fault('rotary motion in cutter compensation; write G40 before', row)
        element = self._element(row)
        if element is None:
            if self._rows:
                self._rows.append(row)
                return []
            return [row]
        self._here = element.end
        if not (self._parts or self._rows):
            if element.is_arc:
                raise self._fault('G41 and G42 begin with a line; write one before the arc', row)
            self._rows = [row]
            return []
        offset = element.offset(self._distance)
        if offset is None:
            raise self._fault(_NO_FIT, row)
        ready = self._corner(element, offset, row)
        self._compare(element, row)
        self._rows = [row]
        return ready

    def _element(self, row: FloatArray) -> Element | None:
        """Return the motion to a row in the plane; None if it runs along the normal only."""
        end = self._flat(row[POINT])
        if not isfinite(row[SWEEP]):
            return Element(self._here, end) if abs(end - self._here) > SHORTEST else None
        turn = float(row[NORMAL] @ self._frame[:, 2])
        if abs(abs(turn) - 1.0) > SMOOTH:
            raise self._fault('an arc in another plane in cutter compensation', row)
        sweep = float(np.copysign(1.0, turn) * row[SWEEP])
        return Element(self._here, end, self._flat(row[CENTRE]), sweep)

    def _corner(self, element: Element, offset: Element, row: FloatArray) -> list[FloatArray]:
        """Join the last element with the next; return the rows up to there."""
        if self._last is None:
            # The line to the contour ends beside its first element.
            self._last = offset
            return [self._moved(waiting, offset.start) for waiting in self._rows]
        leaves = self._parts[-1].direction(self._parts[-1].end)
        turn = float(np.angle(element.direction(element.start) / leaves))
        if abs(abs(turn) - pi) < SMOOTH:
            turn = -float(np.copysign(pi, self._distance))  # back along itself: about its end
        vertex = element.start
        if abs(turn) < SMOOTH:
            ready, self._last = self._to(offset.start, row), offset
        elif turn * self._distance < 0.0:
            ready = self._to(vertex + 1j * self._distance * leaves, row)
            about = Element(self._flat(ready[-1][POINT]), offset.start, vertex, turn)
            self._path.append(about)
            around = self._row_of(about, ready[-1])
            around[EXACT_STOP] = float(ready[-1][EXACT_STOP] == 1.0)  # nobody waits at its end
            ready.append(around)
            self._last = offset
        else:
            found = sorted(crossings(self._last, offset), key=lambda point: abs(point - vertex))
            for point in found:
                after = offset.between(point, offset.end)
                if after is not None and self._last.between(self._last.start, point) is not None:
                    ready, self._last = self._to(point, row), after
                    break
            else:
                raise self._fault(_NO_FIT, row)
        return ready

    def _to(self, end: complex, row: FloatArray) -> list[FloatArray]:
        """End the last element at a point; return its row, and moves along the normal there."""
        assert self._last is not None
        part = self._last.between(self._last.start, end)
        if part is None:
            raise self._fault(_NO_FIT, row)
        self._path.append(part)
        for vertex in self._parts:
            for share in SHARES:
                self._check(vertex.distance(part.at(share)), self._rows[0])
        first, *others = self._rows
        return [self._row_of(part, first), *(self._moved(other, end) for other in others)]

    def _row_of(self, part: Element, row: FloatArray) -> FloatArray:
        """Return the row of an element of the path; ``row`` gives all else."""
        made = self._moved(row, part.end)
        if not part.is_arc:
            return made
        made[CENTRE] = made[POINT]
        away = part.centre - part.end
        made[CENTRE] += away.real * self._frame[:, 0] + away.imag * self._frame[:, 1]
        made[NORMAL], made[SWEEP] = self._frame[:, 2], part.sweep
        return made

    def _compare(self, element: Element, row: FloatArray) -> None:
        """Raise if the path so far comes too near to an element of the contour."""
        self._parts.append(element)
        for part in list(self._path)[:-1]:
            for share in SHARES:
                self._check(part.distance(element.at(share)), row)

    def _check(self, distance: float, row: FloatArray) -> None:
        """Raise if the tool centre is nearer to the contour than its radius and the tolerance."""
        if distance < abs(self._distance) - row[CONTOUR]:
            short = (abs(self._distance) - distance) / MM
            raise self._fault(f'{_NO_FIT}; it would cut {short:.3g} mm into the contour', row)

    def end(self) -> Iterable[FloatArray]:
        """Return the rows that wait; the tool stands beside the end of the contour then."""
        rows, self._rows = self._rows, []
        if not rows or self._last is None:
            return rows
        self._rows = rows
        ready = self._to(self._last.end, rows[0])
        self._rows = []
        return ready
