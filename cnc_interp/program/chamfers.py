"""Rounded and chamfered corners of lines: RND, RNDM, CHR, CHF of Siemens and Heidenhain.

The line before a corner waits until the next one is known. Both are shortened, and an arc or a
line joins them.
"""

from __future__ import annotations

from cmath import phase
from collections.abc import Callable
from dataclasses import dataclass
from math import nan, pi, sin, tan

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.errors import ProgramError

#: Shorter lines are none [m, rad].
_NOTHING = 1e-9
Fault = Callable[[str, str], ProgramError]


@dataclass(frozen=True)
class Corner:
    """What is made of the end of a line."""

    kind: str  #: RND: radius; CHR: length along both lines; CHF: length of the chamfer.
    size: float  #: [m]
    modal: bool = False  #: Whether every corner is rounded (RNDM).

    def joint(
        self, here: FloatArray, corner: FloatArray, after: FloatArray, frame: FloatArray,
        fault: Fault,
    ) -> tuple[FloatArray, FloatArray, tuple[float, ...]] | None:  # fmt: skip
        """Return where the first line ends, where the second begins, and the arc between [m].

        The columns of ``frame`` (3, 3) are both axes of the plane and its normal. None where a
        modal rounding has no corner.
        """
        start, vertex, end = (complex(*(frame[:, :2].T @ p)) for p in (here, corner, after))
        heights = [float(p @ frame[:, 2]) for p in (here, corner, after)]
        into, out = vertex - start, end - vertex
        angle = phase(out / into) if abs(into) > _NOTHING < abs(out) else 0.0
        if np.ptp(heights) > _NOTHING or not _NOTHING < abs(angle) < pi - _NOTHING:
            if self.modal:
                return None
            raise fault('needs two lines in the plane that make a corner', self.kind)
        cut = self.size
        if self.kind == 'RND':
            cut *= tan(0.5 * abs(angle))
        elif self.kind == 'CHF':
            cut /= 2.0 * sin(0.5 * (pi - abs(angle)))
        if cut > min(abs(into), abs(out)):
            raise fault('does not fit between the lines; make it smaller', self.kind)
        first = corner + cut / abs(into) * (here - corner)
        last = corner + cut / abs(out) * (after - corner)
        if self.kind != 'RND':
            return first, last, (nan,) * 7
        side = 1j * (1.0 if angle > 0.0 else -1.0) * self.size * into / abs(into)
        centre = first + side.real * frame[:, 0] + side.imag * frame[:, 1]
        return first, last, (*centre, *frame[:, 2], angle)
