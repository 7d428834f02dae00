"""N-buffer: needles along the normals of a surface, cut by the moving mill.

The distance of a point of the needle ``B + h n`` from the convex mill is a convex function of h.
Newton's method from below therefore converges monotonically to the height at which the needle
enters. The result is the signed height of the material: scallop, excess or gouge.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from cnc_interp.cam.cutter import Cutter
from cnc_interp.cam.heights import Figures, deviations, is_cut
from cnc_interp.cam.needle_cuts import TOP, cut
from cnc_interp.cam.needles import MotionPieces, Needles, patches
from cnc_interp.core import BoolArray, FloatArray

#: What cuts: numba on the processor, or Warp on the processor or on a graphics card.
Device = Literal['cpu', 'warp-cpu', 'cuda']
GROUPS = 16  #: Groups of needles in each direction of a part that is cut at once.


@dataclass(frozen=True)
class Heights:
    needles: Needles  #: The needles.
    #: (rows, columns): Signed height above the surface; ``TOP`` where nothing was cut [m].
    height: FloatArray

    @property
    def cut(self) -> BoolArray:
        return is_cut(self.on_face)

    @property
    def on_face(self) -> FloatArray:
        """Heights, NaN on needles that are not on the face, shape (rows, columns) [m]."""
        counted = self.needles.counted
        return self.height if counted is None else np.where(counted, self.height, np.nan)

    def statistics(self) -> dict[str, float]:
        figures = Figures.of(self.on_face)
        return figures.statistics(deviations(self.on_face, figures.mean))


def cut_needles(
    needles: Needles, cutter: Cutter, tip: FloatArray, axis: FloatArray,
    progress: Callable[[float], None] | None = None, device: Device = 'cpu',
) -> Heights:  # fmt: skip
    sweep = MotionPieces.of(cutter, tip, axis)
    rows, columns = needles.shape
    height = np.empty(needles.shape)
    tall, wide = (GROUPS * n for n in needles.group_size())
    for i, j in patches(rows, columns, tall, wide):
        part = slice(i, i + tall), slice(j, j + wide)
        here = needles.part(*part)
        height[part] = cut_part(here, sweep.near(*here.ball), device)
        if progress:
            done = min(i + tall, rows) * columns if j + wide >= columns else i * columns + tall * j
            progress(min(1.0, done / height.size))
    return Heights(needles, height)


def cut_part(needles: Needles, sweep: MotionPieces, device: Device = 'cpu') -> FloatArray:
    needle = np.concatenate([needles.base, needles.normal], axis=2).reshape(-1, 6)
    R, skin, (stages, widest) = sweep.cutter.tool_radius, sweep.skin, sweep.search
    if device != 'cpu':
        from cnc_interp.cam.warp_cuts import cut_by_warp

        return cut_by_warp(needle, sweep, device).reshape(needles.shape)
    height = np.full(len(needle), TOP)
    cut(
        needle, *needles.groups(), sweep.first, sweep.middle, sweep.last, sweep.slack,
        sweep.rough, sweep.batch, stages, widest, R, skin, height,
    )  # fmt: skip
    return height.reshape(needles.shape)
