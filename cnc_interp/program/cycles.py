"""Canned cycles: drilling, tapping and boring as rapid and feed moves.

G81 drills, G82 dwells at the bottom, G83 retracts fully after every peck, G73 retracts a little.
G84 and G74 tap: in and out at feed, without spindle synchronisation. G85 and G89 bore. G76 and G87
of Fanuc shift the tool by I and J at the bottom, G88 waits there. Z, R, Q and P stay valid for the
next holes. G98 retracts to the start level of the cycle, G99 to R.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import INCH, MM
from cnc_interp.program.arcs import PLANES
from cnc_interp.program.codes import DWELL
from cnc_interp.program.control_profiles import FANUC, LINUXCNC, PLAIN
from cnc_interp.program.holes import Hole, go_along, make_hole, pecks_of
from cnc_interp.program.modal_state import FARTHEST
from cnc_interp.program.motion import Mover
from cnc_interp.program.words import BlockWords

#: Clearance above the last peck, and retract distance of G73, by unit [m].
_CLEARANCE = {MM: 0.254 * MM, INCH: 0.01 * INCH}
_MOST_REPEATS = 10_000
_PECKING = {'G73', 'G83'}
TAPPING = {'G74', 'G84', 'G84.2', 'G84.3'}
_FEED_OUT = {*TAPPING, 'G85', 'G89'}
_RESTING = {'G76', 'G82', 'G86', 'G87', 'G89'}
_SHIFTING = {'G76', 'G87'}


class CannedCycle:
    def __init__(self, code: str, start: float):
        self.code, self.start = code, start
        self._sticky: dict[str, float] = {}

    def drill(self, mover: Mover, words: BlockWords, feed_given: bool) -> None:
        axis = PLANES[mover.plane][2]
        drilling = 'XYZ'[axis]
        values = words.values
        self._refuse(mover, words)
        kept = (drilling, 'R', 'Q', 'P', *('IJK' if self.code in _SHIFTING else ''))
        for letter in kept:
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

    def _refuse(self, mover: Mover, words: BlockWords) -> None:
        if mover.by_axes and mover.rotary.any() and mover.frames.rotated:
            raise mover.fault('a cycle in a rotated frame without tool-tip programming', self.code)
        turns = not words.values.keys().isdisjoint(mover.rotary_letters)
        if turns and not mover.dialect.turns_in_cycles:
            raise mover.fault('LinuxCNC takes no rotary words in a canned cycle; turn in a block '
                              'before, or choose --dialect fanuc', self.code)  # fmt: skip
        if self.code in (*_SHIFTING, 'G88') and mover.dialect is LINUXCNC:
            threads = 'G76 cuts threads on LinuxCNC' if self.code == 'G76' else 'LinuxCNC has none'
            raise mover.fault(f'{threads}; post the cycle as G0 and G1 moves', self.code)
        if self.code in TAPPING and mover.dialect is LINUXCNC and mover.plane != 'G17':
            raise mover.fault('LinuxCNC taps along the wrong axis here; tap in G17, or choose '
                              '--dialect fanuc', self.code)  # fmt: skip

    def _hole(self, mover: Mover, place: FloatArray, axis: int, feed_given: bool) -> None:
        depth, retract = (self._sticky['XYZ'[axis]], self._sticky['R'])
        here = mover.here()
        level = float(here[axis])
        if mover.incremental:
            retract = self.start + retract * mover.unit
            bottom = retract + depth * mover.unit
        else:
            retract, bottom = retract * mover.unit, depth * mover.unit
        if retract < bottom and self.code != 'G87':
            if mover.dialect not in (FANUC, PLAIN):
                raise mover.fault('the retract plane R lies below the depth', self.code)
            mover.notice(f'WARNING: {self.code} with R below Z',
                         'the feed goes from R up to Z, as on Fanuc')  # fmt: skip
        clear = max(self.start, retract) if mover.retract_to_start else retract
        if self.code == 'G87':
            clear = max(self.start, retract)
        whole = mover.dialect is LINUXCNC and self.code != 'G85'
        out = (clear if whole else retract) if self.code in _FEED_OUT else None
        hole = Hole(
            retract, bottom, clear, self._pecks(mover, retract, bottom), self.code == 'G73',
            _CLEARANCE[mover.unit], self.code in TAPPING, self.code in _RESTING,
            self.code == 'G88', out, self._shift(mover),
        )  # fmt: skip
        if self.code in _RESTING and self._sticky.get('P'):
            mover.notice(self.code, DWELL)
        if self.code == 'G88':
            mover.notice('G88', 'waits at the bottom; the retract after cycle start is a rapid')
        start = place
        if self.code == 'G87':
            if hole.shift is None:
                mover.notice('WARNING: G87 without a shift', 'it goes to R and back in the bore')
            else:
                start = place.copy()
                start[:3] += hole.shift
        levels = [level, retract]
        if level < retract:
            levels = [retract]
            go_along(mover, here, axis, retract, feed_given)
        for along in levels:
            go_along(mover, start, axis, along, feed_given)
        if start is not place:
            go_along(mover, place, axis, retract, feed_given)
        make_hole(mover, hole, place, axis, feed_given)

    def _shift(self, mover: Mover) -> FloatArray | None:
        """Return how G76 and G87 move the tool aside, shape (3,) [m]; None: not at all."""
        if self.code not in _SHIFTING:
            return None
        if not {'I', 'J', 'K'} & self._sticky.keys():
            amount, first = self._sticky.get('Q', 0.0), PLANES[mover.plane][0]
            if not amount:
                return None
            mover.notice(f'WARNING: {self.code} Q', f'the tool moves aside along +{"XYZ"[first]}; '
                         'a parameter of the control may give another direction')  # fmt: skip
            return np.asarray(np.eye(3)[first] * abs(amount) * mover.unit)
        return np.array([self._sticky.get(letter, 0.0) * mover.unit for letter in 'IJK'])

    def _pecks(self, mover: Mover, retract: float, bottom: float) -> list[float]:
        """Return the levels at which the tool turns back before the bottom."""
        if self.code not in _PECKING and not ('Q' in self._sticky and self.code in TAPPING):
            return []
        step = self._sticky.get('Q', 0.0) * mover.unit
        if step == 0.0 and mover.dialect in (FANUC, PLAIN):
            mover.notice(f'WARNING: {self.code} without a peck Q',
                         'drilled in one stroke; Fanuc and LinuxCNC refuse it')  # fmt: skip
            return []
        if not 0.0 < step < FARTHEST:
            raise mover.fault('the cycle needs its peck Q, greater than zero', self.code)
        return pecks_of(retract, bottom, step, lambda text: mover.fault(text, self.code))
