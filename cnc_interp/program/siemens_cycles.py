"""Drilling cycles of the 840D: CYCLE81 to CYCLE89, CYCLE840, with MCALL, HOLES1 and HOLES2.

Their first arguments are the retract plane RTP, the reference plane RFP, the safety distance SDIS
above it, and the depth, DP absolute or DPR below the reference plane. The feed begins at RFP +
SDIS. With MCALL the cycle runs at the end of every block with a motion in the plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cnc_interp.core.units import DEG, MINUTE, MM
from cnc_interp.program.arcs import PLANES
from cnc_interp.program.codes import DWELL
from cnc_interp.program.holes import Hole, go_along, make_hole, pecks_of
from cnc_interp.program.motion import Mover

CYCLES = {f'CYCLE{number}' for number in (81, 82, 83, 84, 840, 85, 86, 87, 88, 89)}
PATTERNS = {'HOLES1', 'HOLES2'}
WORDS = {'MCALL', 'CYCLE80', *CYCLES, *PATTERNS}
_TAPPING = {'CYCLE84', 'CYCLE840'}
_FEED_OUT = {*_TAPPING, 'CYCLE85', 'CYCLE89'}
#: How far the tool goes back to break the chip, and how near it comes again [m].
_BREAK, _NEAR, _NEAR_SHARE, _NEAR_MOST = 1.0 * MM, 0.6 * MM, 0.02, 7.0 * MM
_MOST_HOLES = 10_000

Given = Sequence[float | None]


class SiemensCycle:
    def __init__(self, name: str, given: Given, mover: Mover):
        self.name, self._given, self._mover = name, given, mover
        if None in (self._at(0), self._at(1)) or (self._at(3), self._at(4)) == (None, None):
            raise mover.fault('give the planes RTP and RFP and the depth DP or DPR', name)

    def _at(self, index: int) -> float | None:
        return self._given[index] if index < len(self._given) else None

    def _value(self, index: int) -> float:
        return self._at(index) or 0.0

    def make(self) -> None:
        mover, unit = self._mover, self._mover.unit
        axis = PLANES[mover.plane][2]
        reference, depth = self._value(1) * unit, self._at(3)
        bottom = reference - self._value(4) * unit if depth is None else depth * unit
        if reference < bottom:
            raise mover.fault('the reference plane lies below the depth', self.name)
        retract, clear = reference + self._value(2) * unit, self._value(0) * unit
        if clear < retract:
            raise mover.fault('the retract plane RTP lies below the safety distance', self.name)
        pecks = self._pecks(reference, bottom) if self.name == 'CYCLE83' else []
        shift = None
        if self.name == 'CYCLE86' and any(self._value(i) for i in (7, 8)):
            shift = np.zeros(3)
            for index, place in zip((7, 8), PLANES[mover.plane][:2], strict=True):
                shift[place] = self._value(index) * unit
        if self.name in _TAPPING:
            mover.notice(self.name, 'feed in, feed out; the spindle is not synchronised')
        rests = self.name in ('CYCLE82', 'CYCLE86', 'CYCLE88', 'CYCLE89') or self._value(5) > 0.0
        if rests and self._value(5):
            mover.notice(self.name, DWELL)
        waits = self.name in ('CYCLE87', 'CYCLE88')
        breaks = self.name == 'CYCLE83' and not self._value(11)
        distance = self._value(14) * unit or _BREAK
        near = self._value(16) * unit or min(
            max(_NEAR, _NEAR_SHARE * (reference - bottom)), _NEAR_MOST
        )
        here = mover.here()
        for along in (clear, retract) if here[axis] < retract else (retract,):
            go_along(mover, here, axis, along, feed_given=True)
        hole = Hole(
            retract, bottom, clear, pecks, breaks, distance if breaks else near, rests=rests,
            waits=waits, out=retract if self.name in _FEED_OUT else None, shift=shift,
            feed=self._feed(), feed_out=self._feed_out(),
        )  # fmt: skip
        make_hole(mover, hole, here, axis)

    def _feed(self) -> float | None:
        """Return the feed into the hole [m/s]: FFR, or pitch by speed; None: the modal one."""
        unit, speed = self._mover.unit, self._mover.spindle_speed
        if self.name == 'CYCLE85':
            return self._value(6) * unit / MINUTE
        if self.name == 'CYCLE84':
            return abs(self._value(8)) * MM * (self._value(10) or speed) / MINUTE
        return abs(self._value(10)) * MM * speed / MINUTE if self.name == 'CYCLE840' else None

    def _feed_out(self) -> float | None:
        """Return the feed out of the hole [m/s]; None: that into it."""
        if self.name == 'CYCLE85' and self._value(7):
            return self._value(7) * self._mover.unit / MINUTE
        if self.name == 'CYCLE84' and self._value(8) and self._value(11):
            return abs(self._value(8)) * MM * self._value(11) / MINUTE
        return None

    def _pecks(self, reference: float, bottom: float) -> list[float]:
        """Return the levels of the pecks before the bottom: FDEP or FDPR, then less by DAM."""
        unit, depth = self._mover.unit, reference - bottom
        first = self._at(5)
        stroke = self._value(6) * unit if first is None else reference - first * unit
        if not 0.0 < stroke < depth:
            return []
        less, least = self._value(7), max(self._value(13) * unit, 0.0)

        def then(stroke: float, left: float) -> float:
            if less > 0.0:
                stroke = max(stroke - less * unit, less * unit)
            elif less < 0.0:
                stroke = max(stroke * -less, least, 1e-6)
            stroke = max(stroke, least)
            if less > 0.0 and stroke < left < 2.0 * stroke:
                return 0.5 * left  # the last two strokes are alike
            return min(stroke, left)

        return pecks_of(reference, bottom, stroke, lambda text: self._mover.fault(text, self.name),
                        then)  # fmt: skip


def places_of(name: str, given: Given, mover: Mover) -> list[tuple[float, float]]:
    """Return the places of HOLES1 (a row) and HOLES2 (a circle) in the plane [m]."""
    unit = mover.unit
    values = [value or 0.0 for value in given] + [0.0] * 6
    a, b, count = values[0] * unit, values[1] * unit, int(values[5])
    if not 0 < count <= _MOST_HOLES:
        raise mover.fault('the number of holes is missing', name)
    if name == 'HOLES1':
        along = np.exp(1j * values[2] * DEG)
        steps = (values[3] + values[4] * np.arange(count)) * unit
        found = a + 1j * b + steps * along
    else:
        turn = values[4] or 360.0 / count
        angles = (values[3] + turn * np.arange(count)) * DEG
        found = a + 1j * b + values[2] * unit * np.exp(1j * angles)
    return [(float(place.real), float(place.imag)) for place in found]
