"""
Tool axes that lie beside the pole by rounding are put on it.

CL data give tool axes with six to twelve digits. Beside the pole the last digit alone decides
where the outer rotary axis stands, and from block to block it would turn half round for nothing.
So a tool axis that is nearer to the pole than a small part of the tolerance becomes the pole. What
this takes of the orientation tolerance, the blocks before and after it no longer have. Where the
tool rests, it stands as programmed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cnc_interp.core.units import UM
from cnc_interp.program.blocks import POSES, Blocks
from cnc_interp.smoothing.machine_traits import MachineTraits
from cnc_interp.smoothing.orientation import cross, norm

#: Part of the orientation tolerance that may be used [-], and the most at flank height [m].
SHARE, MOST = 0.05, 0.5 * UM


class Upright:
    """
    Put tool axes on the pole. The result does not depend on how the blocks arrive.

    Parameters
    ----------
    machine : MachineTraits
        Its pole; without one, blocks stay as they are.
    height : float
        Flank height, at which the orientation tolerance counts [m].

    """

    def __init__(self, machine: MachineTraits, height: float):
        self._pole = None if machine.pole is None else np.asarray(machine.pole)
        self._height = height
        self._moved = 0.0  # how far the last tool axis was moved, at flank height [m]
        self._begun = False

    def push(self, blocks: Blocks) -> Blocks:
        """
        Return blocks whose tool axes are on the pole where they were nearly.

        Parameters
        ----------
        blocks : Blocks
            The next rows of the program; the very first row is the start pose. It and exact
            stops, rows that name rotary positions, rows whose rotary axes run linearly, and
            control points keep their tool axes.

        """
        if self._pole is None or not len(blocks):
            return blocks
        away = self._height * norm(cross(blocks.axis, self._pole[None]))
        free = np.isnan(blocks.rotary).all(axis=1) & (blocks.interpolation == POSES)
        most = np.minimum(SHARE * blocks.orientation_tolerance, MOST)
        moves = free & ~blocks.on_spline & ~blocks.exact_stop & (away <= most)
        moves[0] &= self._begun
        self._begun = True
        moved = np.where(moves, away, 0.0)
        used = np.maximum(moved, np.r_[self._moved, moved[:-1]])
        self._moved = float(moved[-1])
        if not used.any():
            return blocks
        sense = np.where(blocks.axis @ self._pole < 0.0, -1.0, 1.0)
        return replace(
            blocks,
            axis=np.where(moves[:, None], sense[:, None] * self._pole, blocks.axis),
            orientation_tolerance=blocks.orientation_tolerance - used,
        )
