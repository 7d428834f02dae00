"""
What corners and curves may use of the orientation tolerance near the pole.

The rest moves the path through the pole (``kinematics/pole_passage.py``). With the distance d of
the programmed path from the pole and a share c, both over the tolerance, a path passes the pole at
most at ``d + g c``, and 1 - c is left. It can be moved onto the pole if ``d + g c < 0.9 (1 - c)``;
here it is at most ``0.8 (1 - c)``. A path that is farther away should not come nearer than that.
The factor g is 1 for curves. A corner deviates less the farther it is from its vertex: at the part
f of its leg by about ``(1 - f)^4`` of its largest deviation.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.orientation import cross, dot, norm

#: Part of the tolerance that can move a path onto the pole [-].
MOVED = 0.8
#: Smallest share of corners and curves, and distance that a path keeps from the pole [-].
LEAST, KEPT = 0.1, 0.7
#: The deviation of a corner at f is at most this times ``(1 - f)^4`` of the largest [-].
FADING = 1.4


def shares_near_pole(
    pole: FloatArray,
    axis: FloatArray,
    rotation: FloatArray,
    tolerance: FloatArray,
    corner: bool = False,
) -> FloatArray:
    """Return what corners and curves may use of the orientation tolerance beside great circles."""
    sense = np.where(axis @ pole < 0.0, -1.0, 1.0)
    poles = sense[:, None] * pole
    turn = norm(rotation)
    normal = rotation / np.where(turn > 0.0, turn, 1.0)[:, None]
    side = cross(normal, axis)
    foot = np.clip(np.arctan2(dot(side, poles), dot(axis, poles)), 0.0, turn)
    nearest = np.cos(foot)[:, None] * axis + np.sin(foot)[:, None] * side
    distance = np.arctan2(norm(cross(nearest, poles)), dot(nearest, poles)) / tolerance
    part = foot / np.where(turn > 0.0, turn, 1.0) if corner else np.zeros(len(foot))
    fading = np.clip(FADING * (1.0 - part) ** 4, 1e-3, 1.0)
    through = (MOVED - distance) / (fading + MOVED)
    share = np.maximum(np.maximum(through, (distance - KEPT) / fading), LEAST)
    return np.asarray(np.minimum(share, 1.0))
