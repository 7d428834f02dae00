"""The check that the bottom of the mill stays outside the surface."""

from __future__ import annotations

import numpy as np

from cnc_interp.cam.posture import Postures
from cnc_interp.cam.surface import Surface
from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.units import MM

#: Rays on which the bottom of the mill is tested, and its circles as shares of R.
RAYS, CIRCLES = 48, (0.4, 0.7, 1.0)
#: Points further beyond the border than this do not belong to the surface [m].
BEYOND = 0.2 * MM


def gouge_depth(surface: Surface, postures: Postures) -> FloatArray:
    """
    Return how deep the bottom of the mill enters the surface.

    The equations of the paper regard the fillet at the contact point only. Here points on circles
    of the bottom, out to the corner circle, must stay r_c above the surface.
    """
    cutter, frames = postures.cutter, postures.frames
    depth = np.zeros(len(postures))
    if cutter.is_ball:
        return depth
    turn = np.linspace(0.0, 2.0 * np.pi, RAYS, endpoint=False)
    e = (
        postures.front[:, None, :] * np.cos(turn)[None, :, None]
        + postures.turned[1][:, None, :] * np.sin(turn)[None, :, None]
    )
    for part in CIRCLES:
        points = postures.centre[:, None, :] + part * cutter.tool_radius * e
        guess = np.broadcast_to(frames.u[:, None], points.shape[:2])
        u, v, above = surface.project(
            points, guess, np.broadcast_to(frames.v[:, None], guess.shape)
        )
        ours = surface.contains(u, v, BEYOND)
        deep = np.where(ours & np.isfinite(above), cutter.corner_radius - above, 0.0)
        depth = np.maximum(depth, deep.max(axis=1))
    return depth
