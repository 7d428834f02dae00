"""Drilling cycles of CL data, as NX, SolidWorks, CATIA and Creo write them.

``CYCLE/DRILL,FEDTO,d,MMPM,f,RAPTO,c,RTRCTO,r`` drills at each of the next GOTO points, until
``CYCLE/OFF``: a rapid to r and to c above the point along the tool axis, feed f to d below it, and
a rapid back to r. The signs of d, and words for the same thing, differ between CAM systems.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.core.units import MINUTE, MM
from cnc_interp.program.holes import Hole, pecks_of

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


def cycle_of(
    minor: str, units: dict[str, float], unit: float, fault: Callable[[str, str], ProgramError]
) -> Hole:
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
    depth, clear, first, following = (
        abs(found.get(name, 0.0)) * unit for name in ('depth', 'clear', 'peck', 'next')
    )
    pecks: list[float] = []
    if kind in _PECKING:
        pecks = pecks_of(
            0.0, -depth, first or depth, lambda text: fault(text, kind),
            lambda *_: following or first,
        )  # fmt: skip
    return Hole(
        clear, -depth, max(abs(found.get('retract', 0.0)) * unit, clear), pecks, gap=_NEAR,
        rests=found.get('dwell', 0.0) > 0.0, out=clear if kind in _FEED_OUT else None,
        feed=found.get('feed', 0.0) * feed_unit / MINUTE,
    )  # fmt: skip


def way_to(
    here: FloatArray, place: FloatArray, axis: FloatArray, retract: float
) -> FloatArray | None:
    """Return where to rise to first, if the tool stands below the retract level of a hole."""
    below = float((place - here) @ axis) + retract
    across = float(np.linalg.norm(np.cross(place - here, axis)))
    return here + below * axis if below > 1e-9 and across > 1e-9 else None
