"""Native 5-axis B-splines of the Siemens 840D: from words to spline rows of Blocks.

After ``BSPLINE SD=3`` each block is a control point (X Y Z, XH YH ZH, PL); the first one is the
position of the tool [B2013, section 4.1] (``docs/how_it_works/native_splines.md``).
"""

from dataclasses import replace
from math import inf, nan, sqrt

import numpy as np

from cnc_interp.core import FloatArray, ProgramError
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.geometry.target_row import NO_ARC
from cnc_interp.program.motion.block_motion import Mover
from cnc_interp.program.text import code_tables as codes
from cnc_interp.program.text.words import BlockWords

#: Words for curves and second points, written with an equals sign.
_SECOND = ('XH', 'YH', 'ZH')
CURVE_WORDS = frozenset((*_SECOND, 'PL', 'SD', 'PW'))
_SHORTEST_TOOL = 1e-6  #: Smallest distance between tip and second point [m].
#: Allowed distance of the tool from the start of a curve: tip [m] and tool axis [-].
_SAME, _SAME_AXIS = 1e-9, 1e-6
_LEAST_POINTS = 4
NO_SECOND = 'give XH YH ZH, all three at first, as a point above X Y Z'
#: Multiplicity of a knot at which the curve passes through a control point.
_MOST_REPEATED = 3


class ProgrammedCurve:
    """Control points of one curve; ``height`` [m]: of second points that are not programmed."""

    def __init__(
        self,
        tip: FloatArray,
        axis: FloatArray,
        second: FloatArray | None,
        height: float,
        source: str,
    ):
        self._tip, self._axis, self._height, self._source = tip, axis, height, source
        self._second = self._first_second = second
        self._named: bool | None = None  # whether the program names second points
        self._rows: list[tuple[float, ...]] = []

    def add(
        self,
        tip: FloatArray,
        second: FloatArray | None,
        interval: float,
        speed_and_tolerances: tuple[float, float, float],
        line: int,
    ) -> None:
        """Add a control point and second point [m]; speed and tolerances are in [m/s] and [m]."""
        if self._named is None:
            self._named = second is not None
        elif second is not None and not self._named:
            why = 'write XH YH ZH in the first block of a spline, or in none'
            raise self._fault(line, why)
        if not self._named:
            second = tip + self._height * self._axis
        second = self._second if second is None else second
        if second is None or not _SHORTEST_TOOL < (length := _length(second - tip)) < inf:
            raise self._fault(line, NO_SECOND)
        self._second = second
        if not self._rows and _length(tip - self._tip) <= _SAME:
            # A program may write the first control point as a block of its own.
            if _length((second - tip) / length - self._axis) > _SAME_AXIS:
                why = 'the tool axis at the start of the spline differs from that of the tool'
                raise self._fault(line, f'{why}; turn the tool before BSPLINE')
            self._first_second = second
            return
        if not self._rows and interval == 0.0:
            why = 'the two zeros that close a spline belong to its last two blocks'
            raise self._fault(line, f'PL of the first interval must be greater than 0; {why}')
        self._rows.append((*tip, *second, interval, *speed_and_tolerances, line))

    def _fault(self, line: float, message: str) -> ProgramError:
        return ProgramError(message, self._source, int(line))

    def blocks(self, line: int) -> Blocks | None:
        count = len(self._rows) + 1
        if count == 1:
            return None
        if count < _LEAST_POINTS:
            why = f'a cubic B-spline needs at least {_LEAST_POINTS} control points, the start'
            raise self._fault(line, f'{why} included; this one has {count}: add control points')
        table = np.array([self._rows[0], *self._rows])
        length = sqrt(float(((table[1, 3:6] - table[1, 0:3]) ** 2).sum()))
        if self._first_second is not None:
            length = _length(self._first_second - self._tip)
        table[0, 0:3], table[0, 3:6] = self._tip, self._tip + length * self._axis
        table[0, 6] = table[-2, 6] = table[-1, 6] = 0.0
        intervals = np.flatnonzero(table[:, 6])
        torn = np.flatnonzero(np.diff(intervals) > _MOST_REPEATED)
        if len(torn):
            line = table[intervals[torn[0] + 1], 10]
            why = 'three or more knot intervals (PL) of 0 in a row interrupt the spline'
            raise self._fault(line, f'{why}; end it there and begin another one')
        if intervals[-1] != len(table) - 3:
            why = 'the knot interval (PL) two blocks before the end of a spline'
            raise self._fault(table[-3, 10], f'{why} must be greater than 0')
        tool = table[:, 3:6] - table[:, 0:3]
        axis = tool / np.sqrt((tool**2).sum(axis=1))[:, None]
        return replace(
            Blocks.of_poses(table[:, 0:3].copy(), axis, 1.0),
            feedrate=table[:, 7].copy(),
            contour_tolerance=table[:, 8].copy(),
            orientation_tolerance=table[:, 9].copy(),
            line_number=table[:, 10].astype(np.int64),
            top=table[:, 3:6].copy(),
            knot_interval=table[:, 6].copy(),
        )


def _length(way: FloatArray) -> float:
    return sqrt(sum(x**2 for x in way.tolist()))


class Splines:
    def __init__(self, mover: Mover):
        self._mover = mover
        self._curve: ProgrammedCurve | None = None
        self._passes = 0  # of the start line, at the last control point
        self._changed: int | None = None  # changes before the first control point
        self._second: FloatArray | None = None  # last second point, in program coordinates [m]

    @property
    def open(self) -> bool:
        return self._curve is not None

    def begin(self) -> None:
        mover = self._mover
        if self._curve is not None:
            return
        mover.end_corner()
        mover.demand(
            not mover.targets.empty,
            'a spline begins where the tool is; move there first',
            'BSPLINE',
        )
        mover.demand(
            mover.feed_mode != 'G93',
            'inverse-time feed (G93) in a spline is not supported',
            'BSPLINE',
        )
        if mover.by_axes:
            how = f'switch it on with {codes.TCP_ON_WORDS}'
            raise mover.fault(f'a spline needs tool-tip programming; {how}', 'BSPLINE')
        if mover.frames.length:
            raise mover.fault(
                'a spline takes no tool length; put it into the machine file', 'BSPLINE'
            )
        second = None if self._second is None else mover.frames.point(self._second)
        self._changed, height = None, mover.settings.flank_height
        self._curve = ProgrammedCurve(
            mover.point, mover.tool_axis, second, height, mover.flow.main.name
        )

    def take(self, words: BlockWords, feed_given: bool) -> bool:
        mover = self._mover
        named = [(str(name), value) for name, value in words.sets if name in CURVE_WORDS]
        given = dict(named)
        mover.demand(
            len(given) >= len(named),
            'a spline word is written twice in one block; keep one of them',
        )
        self._check(given)
        if self._curve is None:
            self._linear(words, given)
            return False
        axes = {'X', 'Y', 'Z', *mover.rotary_letters} & set(words.values)
        if not axes and not given.keys() - {'SD', 'PW'}:
            return False
        mover.refuse_if(
            set(mover.rotary_letters) & set(words.values) or any(n == 'A3' for n, _ in words.sets),
            'rotary words in a spline; give the tool axis by XH YH ZH',
        )
        point = mover.frames.point(mover.target(words)[:3])
        mover.check_point(point)
        second = self._second_point(given)
        rate, _, _ = mover.feed(feed_given)
        self._curve.add(
            point,
            None if second is None else mover.frames.point(second),
            given.get('PL', 1.0),
            (rate, mover.contour, mover.orientation),
            mover.flow.main_line,
        )
        mover.point, self._passes = point, mover.targets.start.passes
        self._changed = mover.targets.changed if self._changed is None else self._changed
        if mover.stop_always:
            mover.notice('exact stop', 'stops at the end of a spline, not at its control points')
        if mover.stop_once:
            self.stop_here()
        return True

    def end(self, stop: bool = False) -> None:
        curve, self._curve = self._curve, None
        rows = None if curve is None else curve.blocks(self._mover.flow.main_line)
        if rows is None:
            return
        mover = self._mover
        if mover.rotary_letters:
            mover.vector = rows.axis[-1]
        mover.targets.add_curve(
            rows,
            (
                *mover.point,
                *rows.axis[-1],
                *mover.rotary,
                0.0,
                1.0,
                np.inf,
                nan,
                0.0,
                float(stop or mover.stop_always),
                mover.contour,
                mover.orientation,
                mover.flow.main_line,
                float(mover.by_axes),
                nan,
                *NO_ARC,
                *mover.extra,
            ),
            self._passes,
            self._changed or 0,
        )

    def stop_here(self, kind: float = 1.0) -> None:
        """Stop at the last target. In a spline this ends the curve and begins another one."""
        was_open = self.open
        self.end(stop=True)
        self._mover.targets.stop_here(kind)
        if was_open:
            self.begin()

    def _check(self, given: dict[str, float]) -> None:
        fault = self._mover.fault
        if given.get('SD', 3.0) != 3.0:
            raise fault('only cubic splines are supported; write SD=3', f'SD={given["SD"]:g}')
        if given.get('PW', 1.0) != 1.0:
            raise fault('weights are not supported; write PW=1', f'PW={given["PW"]:g}')
        if not 0.0 <= given.get('PL', 0.0) < np.inf:
            raise fault('a knot interval must not be negative', f'PL={given["PL"]:g}')

    def _second_point(self, given: dict[str, float]) -> FloatArray | None:
        if not given.keys() & set(_SECOND):
            return None
        mover = self._mover
        mover.demand(not mover.incremental, 'XH YH ZH are absolute; write G90')
        second = np.full(3, nan) if self._second is None else self._second.copy()
        for i, name in enumerate(_SECOND):
            if name in given:
                second[i] = given[name] * mover.unit
        self._second = second
        return second

    def _linear(self, words: BlockWords, given: dict[str, float]) -> None:
        mover = self._mover
        mover.refuse_if(
            given.keys() - {'XH', 'YH', 'ZH', 'SD', 'PW'},
            'this word belongs in a spline; write BSPLINE first',
            'PL',
        )
        second = self._second_point(given)
        if second is None:
            if {'X', 'Y', 'Z', *mover.rotary_letters} & set(words.values):
                self._second = None
            return
        tip = mover.target(replace(words, values=dict(words.values)))[:3]
        mover.demand(np.isfinite(second).all(), NO_SECOND)
        words.sets += zip(('A3', 'B3', 'C3'), (second - tip).tolist(), strict=True)
