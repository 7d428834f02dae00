"""The ratio L2/L1 of a corner for the shortest time; [B2013, section 2.2] leaves it open.

Near a corner the axes move almost linearly with tip and tool axis. So in the space of the axes
the corner is the same B-spline, with legs along the slopes q_s of both lines. Each axis is divided
by its jerk limit. Three sizes describe the shape: max_i |q_s,i| / J_i before the corner, after the
corner, and of the difference.

If the slopes differ little, the speed hardly changes and the best ratio has the least q_sss.
This is about 1.5, where the curvature is a triangle. If they differ much, the tool brakes for the
corner anyway, and an early turn is better: about 2. On the side where the axes move less per
metre, the tip is faster and needs a longer leg. The constants are fitted to planned machining
times of random corners; see ``docs/how_it_works/corner_rounding.md``.
"""

from __future__ import annotations

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.machine_model.machine_traits import AxisRates
from cnc_interp.smoothing.corners.corner import Corners
from cnc_interp.smoothing.orientation import cross, norm

#: Ratio for equal slopes: offset, factor of the relative change, smallest and largest value.
OFFSET, SLOPE, LEAST, MOST = 1.35, 0.65, 1.6, 2.0
#: Growth with the logarithm of the ratio of both slopes, and the largest ratio in any case.
GROWTH, LARGEST = 0.5, 4.0


def ratios_at(corners: Corners, height: float, axis_rates: AxisRates | None) -> FloatArray:
    """Return L2/L1 on both sides of corners [B2013, 2.2]; without axes by tip and top point."""
    steps = -corners.legs[:, 0], corners.legs[:, 1]
    swings = [height * cross(corners.rates[:, side], corners.axis) for side in (0, 1)]
    found = best_ratios(
        *(
            np.maximum(norm(tip), norm(top))
            for tip, top in (
                (steps[0], swings[0]),
                (steps[1], swings[1]),
                (steps[1] - steps[0], swings[1] - swings[0]),
            )
        )
    )
    if axis_rates is None:
        return found
    before, after = (
        axis_rates(corners.tip, corners.axis, steps[side], corners.rates[:, side])
        for side in (0, 1)
    )
    own = best_ratios(*(np.abs(slope).max(axis=1) for slope in (before, after, after - before)))
    return np.where(np.isfinite(own), own, found)


def best_ratios(before: FloatArray, after: FloatArray, change: FloatArray) -> FloatArray:
    """Return L2/L1 on both sides of corners from the three sizes."""
    steepest = np.maximum(before, after)
    equal = np.clip(OFFSET + SLOPE * change / steepest, LEAST, MOST)
    sizes = np.maximum(np.stack([before, after], axis=1), 1e-9 * steepest[:, None])
    unequal = GROWTH * np.log(steepest[:, None] / sizes)
    return np.asarray(np.minimum(equal[:, None] + unequal, LARGEST))
