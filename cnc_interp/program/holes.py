"""One hole, as the cycles of all dialects describe it, and the motions that make it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError
from cnc_interp.program.motion import Mover
from cnc_interp.program.target_row import AT_M0

#: Kinds of strokes: a rapid, and those at the feed into the hole and out of it.
RAPID, INTO, OUT_OF = range(3)
_MOST_PECKS = 10_000
_NOTHING = 1e-9  #: What is left of a hole and not worth another stroke [m].


@dataclass(frozen=True)
class Hole:
    """How a hole is made from the level ``retract``; levels are those along the tool [m]."""

    retract: float  #: Where the feed begins.
    bottom: float
    clear: float  #: Where the tool has left the hole.
    pecks: Sequence[float] = ()  #: Where the tool turns back before the bottom.
    #: Whether it retracts a little after each peck only, and by how much; where it comes back, it
    #: stops short of the last peck by ``gap``.
    breaks: bool = False
    gap: float = 0.0
    feeds_back: bool = False  #: Whether it comes back from each peck by feed.
    rests: bool = False
    waits: bool = False  #: Whether an operator retracts the tool.
    out: float | None = None  #: Level up to which it comes back by feed; None: in a rapid.
    shift: FloatArray | None = None  #: (3,): How the tool moves aside at the bottom [m].
    #: Feeds into the hole and out of it [m/s]; None: that of the program, and that into it.
    feed: float | None = None
    feed_out: float | None = None

    def strokes(self) -> Iterator[tuple[float, int, bool, float]]:
        """Yield the level, kind, whether it is moved aside, and the stop at the end of strokes."""
        for peck in self.pecks:
            yield peck, INTO, False, 0.0
            if not self.breaks:
                yield self.retract, INTO if self.feeds_back else RAPID, False, 0.0
            if self.breaks or not self.feeds_back:
                yield min(peck + self.gap, self.retract), RAPID, False, 0.0
        rests = self.rests or self.out is not None
        yield self.bottom, INTO, False, AT_M0 if self.waits else float(rests)
        if self.out is not None:
            yield self.out, OUT_OF, False, 0.0
        elif self.shift is not None:
            yield self.bottom, RAPID, True, 0.0
            yield self.clear, RAPID, True, 0.0
        yield self.clear, RAPID, False, 0.0


def pecks_of(
    top: float, bottom: float, first: float, fault: Callable[[str], ProgramError],
    then: Callable[[float, float], float] | None = None,
) -> list[float]:  # fmt: skip
    """Return the levels at which the tool turns back before the bottom [m].

    ``then`` gives each stroke from the one before and what is left; without it all are alike.
    """
    depth, done, stroke, levels = top - bottom, first, first, list[float]()
    while depth - done > _NOTHING:
        levels.append(top - done)
        if len(levels) > _MOST_PECKS:
            raise fault(f'more than {_MOST_PECKS} pecks; enlarge the peck')
        stroke = stroke if then is None else then(stroke, depth - done)
        done = first * (len(levels) + 1) if then is None else done + stroke
    return levels


def go_along(
    mover: Mover, place: FloatArray, axis: int, along: float, feed_given: bool, rapid: bool = True
) -> None:
    target = place.copy()
    target[axis] = along
    rotary = target[3:] + mover.frames.rotary_origin if mover.rotary_letters else mover.rotary
    mover.go(mover.frames.point(target[:3]), rotary, feed_given=feed_given, rapid=rapid)


def make_hole(
    mover: Mover, hole: Hole, place: FloatArray, axis: int, feed_given: bool = True
) -> None:
    """Drill at a place in program coordinates, shape (5,) [m, rad]."""
    kept = mover.feedrate
    feed = hole.feed or kept
    beside = place.copy()
    beside[:3] += np.zeros(3) if hole.shift is None else hole.shift
    for level, kind, aside, stop in hole.strokes():
        mover.feedrate = hole.feed_out or feed if kind == OUT_OF else feed
        go_along(mover, beside if aside else place, axis, level, feed_given, kind == RAPID)
        if stop:
            mover.targets.stop_here(stop)
    mover.feedrate = kept
