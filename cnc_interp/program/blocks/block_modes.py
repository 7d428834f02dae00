"""The modal state of each block, recorded so that it is known when the machine executes it."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Callable, Hashable
from dataclasses import dataclass, field, replace
from math import nan

import numpy as np

from cnc_interp.core import MINUTE, FloatArray
from cnc_interp.program.geometry.program_coordinates import ProgramCoordinates

NONE = -1.0  #: Value for a missing motion code, feed or state.
#: Largest numbers of recorded states, and of recorded changes of state, motion code and feed.
MOST_STATES, MOST_CHANGES = 10_000, 1_000_000


@dataclass(frozen=True)
class ActiveModes:
    codes: tuple[str, ...]  #: The active code of each modal group, such as G1, G17, G21, G90.
    #: Tolerances [m].
    contour_tolerance: float
    orientation_tolerance: float
    spindle_speed: float = 0.0  #: Programmed spindle speed [rev/min].
    tool: int = 0  #: Number of the active tool; 0 if none is chosen.
    feedrate: float = nan  #: Feedrate [m/s], with G95 [m/rev]; NaN if none is set.
    duration: float = nan  #: Duration of a block with G93 [s]; NaN if none is set.
    frame: ProgramCoordinates = field(default_factory=ProgramCoordinates)

    def moving(self, motion: float, feed: float) -> ActiveModes:
        codes = self.codes if motion == NONE else (f'G{motion:.0f}', *self.codes)
        if feed == NONE:
            return replace(self, codes=codes)
        if 'G93' in codes:
            return replace(self, codes=codes, duration=MINUTE / feed)
        return replace(self, codes=codes, feedrate=feed * (MINUTE if 'G95' in codes else 1.0))


class ModesOfBlocks:
    def __init__(self) -> None:
        self._numbers: dict[Hashable, int] = {}
        self._states: list[ActiveModes] = []
        self._blocks, self._changes = array('q'), array('d')
        self._last = np.full(3, nan)

    def number(self, key: Hashable, state: Callable[[], ActiveModes]) -> float:
        """Return the number of the modal state with a key; call ``state`` to create a new one."""
        found = self._numbers.get(key)
        if found is None:
            if len(self._states) >= MOST_STATES:
                return NONE
            found = self._numbers[key] = len(self._states)
            self._states.append(state())
        return float(found)

    def see(self, states: FloatArray, first: int) -> None:
        before = np.vstack([self._last, states[:-1]])
        rows = np.flatnonzero((states != before).any(axis=1))
        self._last = states[-1]
        room = MOST_CHANGES - len(self._blocks)
        if not room:
            return
        if len(rows) >= room:
            rows, states = rows[:room], states.copy()
            states[rows[-1]] = NONE  # from here on
        self._blocks.extend((first + rows).tolist())
        self._changes.frombytes(np.ascontiguousarray(states[rows]).tobytes())

    def change_before(self, block: int) -> int:
        """Return the index of the last change at or before a block; -1 if there is none."""
        return bisect_right(self._blocks, block) - 1

    def after(self, change: int) -> ActiveModes | None:
        if change < 0:
            return None
        number, motion, feed = self._changes[3 * change : 3 * change + 3]
        return None if number == NONE else self._states[int(number)].moving(motion, feed)
