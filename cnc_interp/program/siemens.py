"""Native 5-axis B-splines of the Siemens 840D: from words to spline rows of Blocks.

[B2013, section 4.1]. ``BSPLINE SD=3`` opens a curve. Each following block gives a control point of
the tool tip (X Y Z), a second point on the tool axis (XH YH ZH) and a knot interval (PL).
A missing coordinate keeps its value; a missing PL is 1. The first control point is the
position of the tool. ``docs/how_it_works/native_splines.md`` describes the convention, and
``splines.py`` follows the blocks.
"""

from __future__ import annotations

from math import isfinite, nan, sqrt

import numpy as np

from cnc_interp.core.errors import ProgramError
from cnc_interp.program.blocks import Blocks

Point = tuple[float, float, float]

#: Names of words for curves and second points; they are written with an equals sign.
CURVE_WORDS = frozenset(('XH', 'YH', 'ZH', 'PL', 'SD', 'PW'))
_SHORTEST_TOOL = 1e-6  #: Smallest distance between tip and second point [m].
#: Largest difference between the start of a curve and the tool: tip [m] and tool axis [-].
_SAME, _SAME_AXIS = 1e-9, 1e-6
_LEAST_POINTS = 4
#: A knot that is repeated this often makes the curve pass through a control point.
_MOST_REPEATED = 3


def tool_vector(tip: Point, second: Point) -> Point:
    """Return the unit vector from the tip to the second point; NaN if they are too close."""
    x, y, z = (b - a for a, b in zip(tip, second, strict=True))
    length = sqrt(x * x + y * y + z * z)
    if not (isfinite(length) and length > _SHORTEST_TOOL):
        return nan, nan, nan
    return x / length, y / length, z / length


class Curve:
    """The control points of one curve, added block by block.

    ``tip``, ``axis``: pose of the tool: the first control point [m] and the unit tool axis [-];
    ``second``: second point at the start if the program has named it [m]; ``height``: distance of
    the second point from the tip if the program names none [m]; ``source``: file name for error
    messages.
    """

    def __init__(self, tip: Point, axis: Point, second: Point | None, height: float, source: str):
        self._tip, self._axis, self._height, self._source = tip, axis, height, source
        self.second = second
        self._first_second = second
        self._named: bool | None = None  # whether the program names second points
        self._rows: list[tuple[float, ...]] = []

    def add(
        self, tip: Point, second: Point | None, interval: float,
        speed_and_tolerances: tuple[float, float, float], line_number: int,
    ) -> None:  # fmt: skip
        """Add a control point of the tip, and of the second curve or None [m].

        ``speed_and_tolerances``: feedrate [m/s], contour and orientation tolerance [m].
        """
        named = second is not None
        if self._named is None:
            self._named = named
        elif named and not self._named:
            raise self._fault(
                line_number, 'XH YH ZH must stand in the first block of a spline, or in none'
            )
        if not self._named:
            second = _along(tip, self._axis, self._height)
        second = second or self.second
        assert second is not None
        axis = tool_vector(tip, second)
        if not isfinite(axis[0]):
            raise self._fault(
                line_number, 'give XH YH ZH, all three at first, as a point above X Y Z'
            )
        self.second = second
        if not self._rows and _apart(tip, self._tip) <= _SAME:
            # A program may write the first control point as a block of its own.
            if _apart(axis, self._axis) > _SAME_AXIS:
                raise self._fault(
                    line_number,
                    'the tool axis at the start of the spline differs from that of the tool; '
                    'turn the tool before BSPLINE',
                )
            self._first_second = second
            return
        if not self._rows and interval == 0.0:
            raise self._fault(
                line_number,
                'PL of the first interval must be greater than 0; the two zeros that close a '
                'spline belong to its last two blocks',
            )
        self._rows.append((*tip, *second, interval, *speed_and_tolerances, line_number))

    def _fault(self, line: float, message: str) -> ProgramError:
        return ProgramError(message, self._source, int(line))

    def blocks(self, line_number: int) -> Blocks | None:
        """Return the curve as spline rows, None if it has only its start; errors name the line."""
        count = len(self._rows) + 1
        if count == 1:
            return None
        if count < _LEAST_POINTS:
            raise self._fault(
                line_number, f'a cubic B-spline needs at least {_LEAST_POINTS} control points, '
                f'the start included; this one has {count}: add control points',
            )  # fmt: skip
        table = np.array([self._rows[0], *self._rows])
        length = sqrt(float(((table[1, 3:6] - table[1, 0:3]) ** 2).sum()))
        if self._first_second is not None:
            length = _apart(self._tip, self._first_second)
        table[0, 0:3], table[0, 3:6] = self._tip, _along(self._tip, self._axis, length)
        table[0, 6] = table[-2, 6] = table[-1, 6] = 0.0
        intervals = np.flatnonzero(table[:, 6])
        torn = np.flatnonzero(np.diff(intervals) > _MOST_REPEATED)
        if len(torn):
            raise self._fault(
                table[intervals[torn[0] + 1], 10], 'three or more knot intervals (PL) of 0 in a '
                'row interrupt the spline; end it there and begin another one',
            )  # fmt: skip
        if intervals[-1] != len(table) - 3:
            raise self._fault(
                table[-3, 10], 'the knot interval (PL) two blocks before the end of a spline must '
                'be greater than 0',
            )  # fmt: skip
        tool = table[:, 3:6] - table[:, 0:3]
        n = len(table)
        return Blocks(
            tip=table[:, 0:3].copy(),
            axis=tool / np.sqrt((tool**2).sum(axis=1))[:, None],
            rotary=np.full((n, 2), np.nan),
            feedrate=table[:, 7].copy(),
            duration=np.full(n, np.nan),
            rapid=np.zeros(n, dtype=np.bool_),
            exact_stop=np.zeros(n, dtype=np.bool_),
            contour_tolerance=table[:, 8].copy(),
            orientation_tolerance=table[:, 9].copy(),
            line_number=table[:, 10].astype(np.int64),
            top=table[:, 3:6].copy(),
            knot_interval=table[:, 6].copy(),
        )


def _apart(a: Point, b: Point) -> float:
    """Return the distance between two points."""
    return sqrt(sum((y - x) ** 2 for x, y in zip(a, b, strict=True)))


def _along(tip: Point, axis: Point, length: float) -> Point:
    """Return the point on the tool axis at a distance from the tip."""
    x, y, z = (p + length * o for p, o in zip(tip, axis, strict=True))
    return x, y, z
