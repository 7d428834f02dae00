"""Parts of a path -> sections for the processes that plan; they end at rests where possible."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from cnc_interp.kinematics.axis_path import AxisPath, cut

#: Work in a section, in path cells: some 0.1 s of planning.
ENOUGH = 500
#: Work that a rest adds: a short stroke costs as much as so many cells on a long path.
STROKE = 20


@dataclass(frozen=True)
class Section:
    """Part of a path that begins where the one before ends."""

    path: AxisPath  #: The part.
    rests: bool  #: Whether the motion rests at its end.


class RestSections:
    """
    Cuts a path that arrives in parts, at its exact stops if possible.

    Where a section ends may depend on the arrival of the parts. The motion does not.
    """

    def __init__(self, at_rests: bool = True) -> None:
        self._at_rests = at_rests
        self._parts: list[AxisPath] = []
        self._work = 0

    def push(self, path: AxisPath) -> Iterator[Section]:
        """Add the next part of the path; yield the sections that are complete."""
        begin = counted = 0
        for rest in np.flatnonzero(path.stop).tolist() if self._at_rests else ():
            if rest == 0 and not self._parts:
                continue  # the first point of the path
            self._work += rest - counted + STROKE
            counted = rest
            if self._work < ENOUGH:
                continue
            if rest > begin:
                self._parts.append(cut(path, begin, rest))
                begin = rest
            yield self._section(len(self._parts), rests=True)
        last = len(path.s) - 1
        if last > begin:
            self._parts.append(cut(path, begin, last))
            self._work += last - counted
        # The newest part is kept: the part after it may begin with a rest.
        if self._work >= ENOUGH and len(self._parts) > 1:
            yield self._section(len(self._parts) - 1, rests=False)

    def finish(self) -> Iterator[Section]:
        """Yield what is left, down to rest at the end of the path."""
        if self._parts:
            yield self._section(len(self._parts), rests=True)

    def _section(self, parts: int, rests: bool) -> Section:
        """Take the first parts."""
        path = AxisPath.join(self._parts[:parts])
        del self._parts[:parts]
        self._work = sum(len(part.s) - 1 for part in self._parts)
        return Section(path, rests)
