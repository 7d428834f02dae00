"""Program coordinates: the only system in which positions are shown to people.

They are the values of X Y Z A C with which the next line (or the executed line) would move the
axes to their current positions, with all offsets in effect at that line:

    program = turn^T (point - origin - length * along)

With tool-tip programming, ``point`` is the tool tip in the workpiece and ``along`` the tool axis.
Without it, ``point`` is X Y Z in machine coordinates minus the workpiece zero, and ``along`` is Z.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cnc_interp.core import FloatArray


@dataclass(frozen=True)
class ProgramCoordinates:
    coordinates: str = ''  #: Offsets in effect, as ``G54 + G92 + TRANS``; empty if unknown.
    of_tip: bool = False  #: Whether X Y Z are those of the tool tip.
    #: Zero of X Y Z, and of the rotary axes of the machine [m, rad].
    origin: tuple[float, ...] = ()
    turn: tuple[float, ...] = ()  #: Rotation from the coordinates to points, row by row.
    length: float = 0.0  #: Tool length in effect [m].

    def of_place(
        self, positions: FloatArray, tip: FloatArray, axis: FloatArray, zero: FloatArray
    ) -> FloatArray:
        """Convert axis positions to program coordinates.

        Parameters
        ----------
        positions : ndarray, shape (n,)
            Axis positions [m, rad]; for an arm, its tool tip and its further joints.
        tip, axis : ndarray, shape (3,)
            Tool tip [m] and unit tool axis [-] at these positions, in the workpiece frame.
        zero : ndarray, shape (3,)
            Workpiece zero of the machine file [m].

        Returns
        -------
        ndarray, shape (n,)
            X Y Z, rotary axes, and extra axes, which have no offset [m, rad]; empty if unknown.

        """
        if not self.coordinates:
            return np.zeros(0)
        found = np.array(positions, dtype=float)
        point, along = (tip, axis) if self.of_tip else (found[:3] - zero, np.array([0, 0, 1.0]))
        found[:3] = self._turn.T @ (point - self.length * along - np.array(self.origin[:3]))
        found[3 : len(self.origin)] -= self.origin[3:]
        return found

    def change_of_zero(self, change: Mapping[int, float]) -> FloatArray:
        """Return the change of a work offset that lowers coordinates by ``change`` [m, rad]."""
        less = np.zeros(max(3, len(self.origin)))
        for index, value in change.items():
            less[index] = value
        less[:3] = self._turn @ less[:3]
        return less

    @property
    def _turn(self) -> FloatArray:
        return np.reshape(self.turn, (3, 3))
