"""
L2/L1 for the shortest machining time [B2013, section 2.2, leaves it open].

Near a corner the axes move almost linearly with tip and tool axis, so the corner in *their* space
is the same B-spline with legs along the slopes q_s of both lines. Each axis weighed by its jerk
limit, three sizes tell its shape: max_i |q_s,i| / J_i before, behind, and of the difference.

Where the slopes hardly differ, the speed hardly changes and wants the least q_sss: L2/L1 near
1.5, at which the curvature is a triangle. Where they differ much, the tool brakes into the corner
anyway and gains by turning early: 2. On a side where the axes move less per metre than on the
other, the tip comes faster and wants a longer leg. The constants are fitted to planned machining
times of random corners; ``docs/how_it_works/corner_rounding.md`` has the figures.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.smoothing.corners.corner import Corners
from cnc_interp.smoothing.orientation import cross, norm

#: Axis movement per metre, each over its jerk limit, for poses (tip, axis, step, turn per metre).
AxisRates = Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]

#: Ratio over the change of slope, between the least and the most of equal slopes.
OFFSET, SLOPE, LEAST, MOST = 1.35, 0.65, 1.6, 2.0
#: Growth with the logarithm of unequal slopes, and the largest ratio of all.
GROWTH, LARGEST = 0.5, 4.0


def ratios_at(corners: Corners, height: float, axis_rates: AxisRates | None) -> FloatArray:
    """
    Return L2/L1 on both sides of corners, shape (n, 2).

    Without a machine, and where its axes are not defined (at the pole), the slopes of tip and top
    point stand for those of the axes.

    Parameters
    ----------
    corners : Corners
        The corners.
    height : float
        Flank height [m].
    axis_rates : callable, optional
        Axis movement per metre over the axes' jerk limits; rows that are not finite are unknown.

    """
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
    """
    Return L2/L1 on both sides of corners, shape (n, 2), from three sizes.

    Parameters
    ----------
    before, after, change : ndarray, shape (n,)
        Largest slope of any axis over its jerk limit on both lines, and of their difference.

    """
    steepest = np.maximum(before, after)
    equal = np.clip(OFFSET + SLOPE * change / steepest, LEAST, MOST)
    sizes = np.maximum(np.stack([before, after], axis=1), 1e-9 * steepest[:, None])
    unequal = GROWTH * np.log(steepest[:, None] / sizes)
    return np.asarray(np.minimum(equal[:, None] + unequal, LARGEST))
