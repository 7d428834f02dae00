"""Cutter compensation in space: from contact points and surface normals to the tip of the tool.

Let c be the contact point, n the unit normal away from the part, and o the tool axis. The corner
of the tool has radius r, and its centre lies on a circle of radius R about o. Then
tip = c + r (n - o) + R unit(n - (n . o) o). This is linear in r and R, so the same formula with
differences of both converts the tip of one tool to that of another.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray, ProgramError
from cnc_interp.program.text.words import BlockWords

#: Sines of the angle between normal and tool axis [-]: below the first one they count as
#: parallel; up to the second one it is uncertain on which side the tool touches.
PARALLEL, UNSURE = 1e-6, 1e-3
ROUNDED = 1e-4  #: A normal may point down the tool by this cosine, because programs round.
FLANK = 1e-3  #: The flank of the tool touches if the cosine of normal and tool axis is less.
SHORTEST = 1e-9  #: A shorter way between two contact points has no direction [m].
#: Words of the normal, and the length below which a normal has no direction [-].
NORMAL_WORDS, SMALLEST = ('A5', 'B5', 'C5'), 1e-6
_NO_FIT = 'the cutter does not fit here; use a smaller tool'
Fault = Callable[[str], ProgramError]


@dataclass(frozen=True)
class ToolShape:
    radius: float  #: Radius of its cylinder [m].
    corner_radius: float  #: Radius of its corner, at most ``radius`` [m].

    def beyond(self, other: ToolShape) -> ToolShape:
        return ToolShape(self.radius - other.radius, self.corner_radius - other.corner_radius)

    def shift(self, normal: FloatArray, axis: FloatArray) -> FloatArray:
        """Return the vector from contact point to tip, (3,) [m], given normal and tool axis."""
        across = normal - (normal @ axis) * axis
        sine = float(np.linalg.norm(across))
        side = across / sine if sine > PARALLEL else np.zeros(3)
        ring = self.radius - self.corner_radius
        return np.asarray(self.corner_radius * (normal - axis) + ring * side)


class ContactPath:
    def __init__(self, cutter: ToolShape):
        self._cutter = cutter
        self._normal: FloatArray | None = None  # the last one
        self._before: tuple[FloatArray, FloatArray, float] | None = None

    def take(self, words: BlockWords, turn: FloatArray, fault: Fault) -> None:
        """Take the contact normal (I J K, or A5 B5 C5) from a block, or keep the last one."""
        named = {name: value for name, value in words.sets if name in NORMAL_WORDS}
        given = [float(named.get(name, 0.0)) for name in NORMAL_WORDS]
        if not named:
            if not {'I', 'J', 'K'} & set(words.values):
                return
            given = [words.values.pop(letter, 0.0) for letter in 'IJK']
        length = float(np.linalg.norm(given))
        if not length > SMALLEST:
            raise fault('the contact normal is zero; correct I, J, K')
        self._normal = np.asarray(turn @ (np.array(given) / length))

    def tip(self, point: FloatArray, axis: FloatArray, cuts: bool, fault: Fault) -> FloatArray:
        """Return the tool tip, (3,) [m]; raise if the tool cannot touch or would gouge."""
        normal = self._normal
        if normal is None:
            raise fault(
                'write the contact normal in the block: I J K, or A5= B5= C5=; without '
                'normals post the path of the tool centre'
            )
        cosine = float(normal @ axis)
        if cosine < -ROUNDED:
            raise fault(
                'the normal points down the tool, which cannot touch there; '
                'the normal points away from the part'
            )
        sine = float(np.linalg.norm(np.cross(normal, axis)))
        ring = self._cutter.radius - self._cutter.corner_radius
        if PARALLEL < sine < UNSURE and ring:
            raise fault(
                'the normal is almost parallel to the tool, so the side on which it '
                'touches is not sure; write it parallel, or tilt the tool'
            )
        self._demand_room(point, normal, cosine, cuts, fault)
        return np.asarray(point + self._cutter.shift(normal, axis))

    def _demand_room(
        self, point: FloatArray, normal: FloatArray, cosine: float, cuts: bool, fault: Fault
    ) -> None:
        """Raise if the surface is so concave that the centre of the cutter moves backwards."""
        before, self._before = self._before, (point, normal, cosine)
        if before is None or not cuts:
            return
        by_flank = max(abs(cosine), abs(before[2])) < FLANK
        reach = self._cutter.radius if by_flank else self._cutter.corner_radius
        way = point - before[0]
        centre = way + reach * (normal - before[1])
        if np.linalg.norm(way) > SHORTEST and centre @ way < 0.0:
            raise fault(_NO_FIT)
