"""
Canned cycles: drilling, tapping and boring as rapid and feed moves.

G81 drills, G82 dwells at the bottom, G83 retracts fully after every peck, G73 retracts a little.
G84 and G74 tap: in and out at feed, without spindle synchronisation. G85 and G89 bore. Z, R, Q and
P stay valid for the next holes. G98 retracts to the start level of the cycle, G99 to R.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM
from cnc_interp.program.arcs import PLANES
from cnc_interp.program.codes import DWELL
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.motion import Mover
from cnc_interp.program.words import BlockWords

#: Clearance above the last peck, and retract distance of G73 [m].
_CLEARANCE = 0.25 * MM
_MOST_PECKS, _MOST_REPEATS = 10_000, 10_000
_PECKING = {'G73', 'G83'}
_FEED_OUT = {'G74', 'G84', 'G85', 'G89'}
_RESTING = {'G82', 'G86', 'G89'}


class CannedCycle:
    """The active canned cycle."""

    def __init__(self, code: str, start: float):
        self.code, self.start = code, start
        self._sticky: dict[str, float] = {}

    def drill(self, mover: Mover, words: BlockWords, feed_given: bool) -> None:
        """Drill the holes of one block."""
        axis = PLANES[mover.plane][2]
        drilling = 'XYZ'[axis]
        values = words.values
        if mover.by_axes and mover.rotary.any() and mover.frames.rotated:
            raise mover.fault('a cycle in a rotated frame without tool-tip programming', self.code)
        for letter in (drilling, 'R', 'Q', 'P'):
            if letter in values:
                self._sticky[letter] = values.pop(letter)
        repeats = values.pop('L', None)
        repeats = values.pop('K', 1.0) if repeats is None else repeats
        if not 0.0 <= repeats <= _MOST_REPEATS:
            raise mover.fault(f'a cycle is repeated 0 to {_MOST_REPEATS} times', f'L{repeats:g}')
        for letter, meaning in ((drilling, 'depth'), ('R', 'retract plane')):
            if letter not in self._sticky:
                raise mover.fault(f'the cycle needs its {meaning} {letter}', self.code)
        for _ in range(round(repeats)):
            hole = mover.target(
                BlockWords(values=dict(values), ways=words.ways, texts=words.texts)
            )
            self._hole(mover, hole, axis, feed_given)
        for letter in ('X', 'Y', 'Z', *mover.rotary_letters):
            values.pop(letter, None)

    def _hole(self, mover: Mover, hole: FloatArray, axis: int, feed_given: bool) -> None:
        """Drill one hole at a position in program coordinates, shape (5,) [m, rad]."""
        depth, retract = (self._sticky['XYZ'[axis]], self._sticky['R'])
        here = mover.here()
        level = float(here[axis])
        if mover.incremental:
            retract = self.start + retract * mover.unit
            bottom = retract + depth * mover.unit
        else:
            retract, bottom = retract * mover.unit, depth * mover.unit
        if retract < bottom:
            raise mover.fault('the retract plane R lies below the depth', self.code)
        clear = max(self.start, retract) if mover.retract_to_start else retract

        def go(along: float, rapid: bool, place: FloatArray) -> None:
            # Move to a level on the drilling axis at a position.
            target = place.copy()
            target[axis] = along
            rotary = (
                target[3:] + mover.frames.rotary_origin if mover.rotary_letters else mover.rotary
            )
            mover.go(mover.frames.point(target[:3]), rotary, feed_given=feed_given, rapid=rapid)

        if level < retract:
            go(retract, True, here)
            level = retract
        go(level, True, hole)
        go(retract, True, hole)
        if self.code in _PECKING or ('Q' in self._sticky and self.code in ('G74', 'G84')):
            self._peck(mover, retract, bottom, lambda along, rapid: go(along, rapid, hole))
        else:
            go(bottom, False, hole)
        if self.code in _RESTING:
            mover.targets.stop_here()
            if self._sticky.get('P'):
                mover.notice(self.code, DWELL)
        if self.code in _FEED_OUT:
            mover.targets.stop_here()
            go(retract, False, hole)
        go(clear, True, hole)

    def _peck(
        self, mover: Mover, retract: float, bottom: float, go: Callable[[float, bool], None]
    ) -> None:
        """Feed down in steps of Q, with a retract after each step."""
        step = self._sticky.get('Q', 0.0) * mover.unit
        if not 0.0 < step < FARTHEST:
            raise mover.fault('the cycle needs its peck Q, greater than zero', self.code)
        count = np.ceil((retract - bottom) / step - 1e-9)
        if not count <= _MOST_PECKS:
            raise mover.fault(f'more than {_MOST_PECKS} pecks; enlarge Q', self.code)
        tapping = self.code in ('G74', 'G84')
        for peck in range(1, int(count) + 1):
            along = max(retract - peck * step, bottom)
            go(along, False)
            if along == bottom:
                return
            if tapping:
                go(retract, False)
                continue
            go(min(along + _CLEARANCE, retract) if self.code == 'G73' else retract, True)
            if self.code == 'G83':
                go(min(along + _CLEARANCE, retract), True)
