"""Drilling cycles of CL data, as NX, SolidWorks, CATIA and Creo write them.

``CYCLE/DRILL,FEDTO,d,MMPM,f,RAPTO,c,RTRCTO,r`` drills at each of the next GOTO points, until
``CYCLE/OFF``: a rapid to r and to c above the point along the tool axis, feed f to d below it, and
a rapid back to r. The signs of d, and words for the same thing, differ between CAM systems.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import MM

#: Kinds of cycles: those that come back by feed, that turn back after pecks, and that rest.
_FEED_OUT, _PECKING = {'TAP', 'BORE', 'REAM', 'BORE8'}, {'DEEP', 'DEEP2', 'BRKCHP', 'CHIPBR'}
KINDS = {'DRILL', 'FACE', 'CSINK', 'CDRILL', 'SPOTDRILL', *_FEED_OUT, *_PECKING}
_VALUES = {
    'FEDTO': 'depth', 'DEPTH': 'depth', 'RAPTO': 'clear', 'CLEAR': 'clear', 'RTRCTO': 'retract',
    'RETURN': 'retract', 'MMPM': 'feed', 'IPM': 'feed', 'STEP': 'peck', 'INCR': 'peck',
    '1STPECK': 'peck', 'SUBPECK': 'next', 'DWELL': 'dwell',
}  # fmt: skip
#: How near the tool comes to the last peck in a rapid [m].
_NEAR = 0.5 * MM
_MOST_PECKS = 10_000


@dataclass(frozen=True)
class ClCycle:
    """A drilling cycle; lengths along the tool axis from the point of GOTO [m]."""

    kind: str
    depth: float
    clear: float
    retract: float
    feed: float | None  #: In the unit that the statement names [m/min]; None: the one before.
    peck: float = 0.0
    following: float = 0.0  #: Pecks after the first one.
    dwell: float = 0.0

    @property
    def feeds_out(self) -> bool:
        """Whether the tool comes back by feed."""
        return self.kind in _FEED_OUT

    def levels(self) -> Iterator[tuple[float, bool, bool]]:
        """Yield levels above the point, whether in a rapid, and whether it rests there."""
        yield self.retract, True, False
        yield self.clear, True, False
        done, step = -self.clear if self.kind not in _PECKING else 0.0, self.peck or self.depth
        count = 0
        while self.kind in _PECKING and done + step < self.depth - 1e-9 and count < _MOST_PECKS:
            done, step, count = done + step, self.following or self.peck, count + 1
            yield -done, False, False
            yield self.clear, True, False
            yield min(-done + _NEAR, self.clear), True, False
        yield -self.depth, False, self.dwell > 0.0 or self.feeds_out
        yield (self.clear, False, False) if self.feeds_out else (self.retract, True, False)
        yield self.retract, True, False


def cycle_of(
    minor: str, units: dict[str, float], unit: float, fault: Callable[[str, str], ProgramError]
) -> ClCycle:
    """Return the cycle of a CYCLE statement; raise for words that are not known."""
    kind, *words = [word.strip() for word in minor.split(',')]
    if kind not in KINDS:
        raise fault('this cycle is not supported; output the tool path as GOTO points', kind)
    found: dict[str, float] = {}
    feed_unit = unit
    while words:
        word = words.pop(0)
        if word not in _VALUES:
            why = 'a number without a word' if re.fullmatch(r'[-+.\dE]+', word) else 'not known'
            raise fault(f'{why} in a cycle; write FEDTO, RAPTO, RTRCTO and MMPM', word or kind)
        if not words or not re.fullmatch(r'[-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?', words[0]):
            raise fault('a number is missing in the cycle', word)
        found[_VALUES[word]] = float(words.pop(0))
        feed_unit = units.get(word) or feed_unit
    if 'depth' not in found:
        raise fault('the cycle needs its depth FEDTO', kind)
    clear = abs(found.get('clear', 0.0)) * unit
    feed = found['feed'] * feed_unit if 'feed' in found else None
    return ClCycle(
        kind, abs(found['depth']) * unit, clear,
        max(abs(found.get('retract', 0.0)) * unit, clear), feed,
        abs(found.get('peck', 0.0)) * unit, abs(found.get('next', 0.0)) * unit,
        found.get('dwell', 0.0),
    )  # fmt: skip


def way_to(
    here: FloatArray, place: FloatArray, axis: FloatArray, retract: float
) -> FloatArray | None:
    """Return where to rise to first, if the tool stands below the retract level of a hole."""
    below = float((place - here) @ axis) + retract
    across = float(np.linalg.norm(np.cross(place - here, axis)))
    return here + below * axis if below > 1e-9 and across > 1e-9 else None
