"""The blocks of native splines: the effect of BSPLINE, XH YH ZH and PL on a running program."""

from __future__ import annotations

from dataclasses import replace
from math import nan

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.program import codes
from cnc_interp.program.motion import Mover
from cnc_interp.program.siemens import CURVE_WORDS, Curve, Point
from cnc_interp.program.target_row import NO_ARC
from cnc_interp.program.words import BlockWords

_SECOND = ('XH', 'YH', 'ZH')


class Splines:
    """The native splines of a program."""

    def __init__(self, mover: Mover):
        self._mover = mover
        self._curve: Curve | None = None
        self._passes = 0  # of the start line, at the last control point
        self._second: FloatArray | None = None  # last second point, in program coordinates [m]

    @property
    def open(self) -> bool:
        """Whether blocks are control points at present."""
        return self._curve is not None

    def begin(self) -> None:
        """Process BSPLINE: later blocks are control points; the tool is at the first one."""
        mover = self._mover
        if self._curve is not None:
            return
        mover.end_corner()
        if mover.targets.empty:
            raise mover.fault('a spline begins where the tool is; move there first', 'BSPLINE')
        if mover.feed_mode == 'G93':
            raise mover.fault('inverse-time feed (G93) in a spline is not supported', 'BSPLINE')
        if mover.by_axes:
            raise mover.fault(
                f'a spline needs tool-tip programming; switch it on with {codes.TCP_ON_WORDS}',
                'BSPLINE',
            )
        second = None if self._second is None else _point(mover.frames.point(self._second))
        self._curve = Curve(
            _point(mover.point), _point(mover.tool_axis), second, mover.settings.flank_height,
            mover.flow.main.name,
        )  # fmt: skip

    def take(self, words: BlockWords, feed_given: bool) -> bool:
        """Take a block if it is a control point; of a line, make its second point the axis."""
        mover = self._mover
        named = [(str(name), value) for name, value in words.sets if name in CURVE_WORDS]
        given = dict(named)
        if len(given) < len(named):
            raise mover.fault('a spline word is written twice in one block; keep one of them')
        self._check(given)
        if self._curve is None:
            self._linear(words, given)
            return False
        axes = {'X', 'Y', 'Z', *mover.rotary_letters} & set(words.values)
        if not axes and not given.keys() - {'SD', 'PW'}:
            return False
        if set(mover.rotary_letters) & set(words.values) or any(n == 'A3' for n, _ in words.sets):
            raise mover.fault('rotary words in a spline; give the tool axis by XH YH ZH')
        point = mover.frames.point(mover.target(words)[:3])
        mover.check_point(point)
        second = self._second_point(given)
        rate, _, _ = mover.feed(feed_given)
        self._curve.add(
            _point(point), None if second is None else _point(mover.frames.point(second)),
            given.get('PL', 1.0), (rate, mover.contour, mover.orientation), mover.flow.main_line,
        )  # fmt: skip
        mover.point, self._passes = point, mover.targets.start.passes
        if mover.stop_always:
            mover.notice('exact stop', 'holds at the end of a spline, not at its control points')
        if mover.stop_once:
            self.stop_here()
        return True

    def end(self, stop: bool = False) -> None:
        """Close the open curve and add its rows; linear blocks continue from its end."""
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
                *mover.point, *rows.axis[-1], *mover.rotary, 0.0, 1.0, np.inf, nan, 0.0,
                float(stop or mover.stop_always), mover.contour, mover.orientation,
                mover.flow.main_line, float(mover.by_axes), nan, *NO_ARC, *mover.extra,
            ),
            self._passes,
        )  # fmt: skip

    def stop_here(self, kind: float = 1.0) -> None:
        """Stop at the last target. In a spline this ends the curve and begins another one."""
        was_open = self.open
        self.end(stop=True)
        self._mover.targets.stop_here(kind)
        if was_open:
            self.begin()

    def _check(self, given: dict[str, float]) -> None:
        """Raise ProgramError for spline words with values that are not supported."""
        fault = self._mover.fault
        if given.get('SD', 3.0) != 3.0:
            raise fault('only cubic splines are supported; write SD=3', f'SD={given["SD"]:g}')
        if given.get('PW', 1.0) != 1.0:
            raise fault('weights are not supported; write PW=1', f'PW={given["PW"]:g}')
        if not 0.0 <= given.get('PL', 0.0) < np.inf:
            raise fault('a knot interval must not be negative', f'PL={given["PL"]:g}')

    def _second_point(self, given: dict[str, float]) -> FloatArray | None:
        """Return the second point of a block in program coordinates; None if it names none."""
        if not given.keys() & set(_SECOND):
            return None
        mover = self._mover
        if mover.incremental:
            raise mover.fault('XH YH ZH are absolute; write G90')
        second = np.full(3, nan) if self._second is None else self._second.copy()
        for i, name in enumerate(_SECOND):
            if name in given:
                second[i] = given[name] * mover.unit
        self._second = second
        return second

    def _linear(self, words: BlockWords, given: dict[str, float]) -> None:
        """Convert the second point of a linear block to a tool direction."""
        mover = self._mover
        if given.keys() - {'XH', 'YH', 'ZH', 'SD', 'PW'}:
            raise mover.fault('this word belongs into a spline; write BSPLINE first', 'PL')
        second = self._second_point(given)
        if second is None:
            if {'X', 'Y', 'Z', *mover.rotary_letters} & set(words.values):
                self._second = None
            return
        tip = mover.target(replace(words, values=dict(words.values)))[:3]
        if not np.isfinite(second).all():
            raise mover.fault('give XH YH ZH, all three at first, as a point above X Y Z')
        words.sets += zip(('A3', 'B3', 'C3'), (second - tip).tolist(), strict=True)


def _point(values: FloatArray) -> Point:
    """Return an array, shape (3,), as a tuple."""
    x, y, z = values.tolist()
    return x, y, z
