"""What smoothing does near the pole: axes beside it are put on it, and room is left to pass.

CL data give tool axes with six to twelve digits. Beside the pole the last digit alone decides
where the outer rotary axis stands, and from block to block it would turn half round for nothing.
So a tool axis that is nearer to the pole than a small part of the tolerance becomes the pole
(``Upright``). What this takes of the orientation tolerance, the blocks before and after it no
longer have. Where the tool rests and where a native spline begins, it stands as programmed. So a
block whose tool axis would be moved waits for the next one.

A path that passes beside the pole is moved through it (``kinematics/pole_passage.py``). Corners
and curves leave a part of the orientation tolerance for that (``share_near_pole``). With the
distance d of the programmed path from the pole and a share c, both over the tolerance, a path
passes the pole at most at ``d + g c``, and 1 - c is left. It can be moved onto the pole if
``d + g c < 0.9 (1 - c)``; here it is at most ``0.8 (1 - c)``. A path that is farther away should
not come nearer than that. The factor g is 1 for curves. A corner deviates less the farther it is
from its vertex: at the part f of its leg by about ``(1 - f)^4`` of its largest deviation.
"""

from dataclasses import replace

import numpy as np

from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.units import UM
from cnc_interp.core.vectors import cross, norm
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import POSES, Blocks

#: Part of the orientation tolerance that may be used [-], and the most at flank height [m].
SHARE, MOST = 0.05, 0.5 * UM


class Upright:
    """Put tool axes on the pole. The result does not depend on how the blocks arrive."""

    def __init__(self, machine: MachineTraits, height: float):
        self._pole = None if machine.pole is None else np.asarray(machine.pole)
        self._height = height
        self._moved = 0.0  # how far the last tool axis was moved, at flank height [m]
        self._begun = False
        self._waiting: Blocks | None = None  # a block that may be the last one

    def push(self, blocks: Blocks) -> Blocks:
        """Return blocks whose tool axes are on the pole where they were nearly.

        The last row may come with the next call. The start pose, exact stops, rows that name
        rotary positions, rows whose rotary axes run linearly, control points, and rows before a
        spline keep their tool axes.
        """
        if self._pole is None or not len(blocks):
            return blocks
        if self._waiting is not None:
            blocks, self._waiting = Blocks.concatenate([self._waiting, blocks]), None
        away = self._height * norm(cross(blocks.axis, self._pole[None]))
        most = np.minimum(SHARE * blocks.orientation_tolerance, MOST)
        most[:-1] = np.minimum(most[:-1], most[1:])
        near = (away > 0.0) & (away <= most)
        near &= np.isnan(blocks.rotary).all(axis=1) & (blocks.interpolation == POSES)
        near &= ~blocks.exact_stop & ~blocks.on_spline
        near[:-1] &= ~blocks.on_spline[1:]
        near[0] &= self._begun
        self._begun = True
        if near[-1]:
            self._waiting = blocks[-1:]
            blocks, near, away = blocks[:-1], near[:-1], away[:-1]
        return self._moved_to_pole(blocks, near, np.where(near, away, 0.0))

    def finish(self) -> Blocks | None:
        """Return the row that still waits; the program ends there, and its tool axis stays."""
        waiting, self._waiting = self._waiting, None
        if waiting is None:
            return None
        return self._moved_to_pole(waiting, np.zeros(1, dtype=np.bool_), np.zeros(1))

    def _moved_to_pole(self, blocks: Blocks, near: BoolArray, moved: FloatArray) -> Blocks:
        """Put tool axes on the pole and take from the tolerances on both sides what that takes."""
        used = np.maximum(moved, np.r_[self._moved, moved[:-1]][: len(moved)])
        if len(moved):
            self._moved = float(moved[-1])
        if self._pole is None or not used.any():
            return blocks
        sense = np.where(blocks.axis @ self._pole < 0.0, -1.0, 1.0)
        return replace(
            blocks,
            axis=np.where(near[:, None], sense[:, None] * self._pole, blocks.axis),
            orientation_tolerance=blocks.orientation_tolerance - used,
        )
