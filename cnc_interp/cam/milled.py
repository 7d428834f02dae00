"""The part of a pass that is milled: its strip lies over the surface, or in the overrun."""

from __future__ import annotations

import numpy as np

from cnc_interp.cam.guiding import GuidingCurve
from cnc_interp.cam.surface_curve import SurfaceCurve
from cnc_interp.cam.vectors import scaled
from cnc_interp.core.arrays import BoolArray, FloatArray
from cnc_interp.core.units import MM

#: Distance of the places at which the border is compared with the strip [m].
SPACING = 0.2 * MM


def kept_range(
    curve: GuidingCurve | SurfaceCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> tuple[float, float] | None:
    """
    Return the part of a pass that is milled: where its strip lies on the surface, and the overrun.

    Parameters
    ----------
    curve : GuidingCurve or SurfaceCurve
        Path of the guided point K.
    s : ndarray, shape (n,)
        Places at which the width is known [m].
    reach : ndarray, shape (n,)
        Half widths of the strip there; NaN where they are unknown [m].
    overrun : float
        Length added at both ends [m].

    Returns
    -------
    (float, float) or None
        First and last place [m]; None if no part of the strip lies on the surface.

    """
    dense = np.linspace(0.0, curve.length, max(60, int(curve.length / SPACING)))
    known = np.isfinite(reach)
    width = np.interp(dense, s[known], reach[known]) if known.any() else np.zeros(len(dense))
    frames, surface = curve.frames(dense), curve.surface
    a, b = surface.at(frames.u, frames.v).components(scaled(width, frames.across))
    (u0, u1), (v0, v1) = surface.domain
    inside = np.zeros(len(dense), bool)
    for side in (-1.0, 0.0, 1.0):
        u, v = frames.u + side * a, frames.v + side * b
        inside |= (u >= u0) & (u <= u1) & (v >= v0) & (v <= v1)
    if not inside.any():
        return None
    first, last = dense[inside][[0, -1]]
    longer = overrun + dense[1]
    return max(float(first) - longer, 0.0), min(float(last) + longer, float(dense[-1]))


def kept_places(
    curve: GuidingCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> BoolArray:
    """
    Tell which places of a pass are milled.

    Parameters
    ----------
    curve : GuidingCurve
        Path of the guided point K.
    s : ndarray, shape (n,)
        Places [m].
    reach : ndarray, shape (n,)
        Half widths of the strip there; NaN where they are unknown [m].
    overrun : float
        Length added at both ends [m].

    Returns
    -------
    ndarray of bool, shape (n,)

    """
    ends = kept_range(curve, s, reach, overrun)
    return (s >= ends[0]) & (s <= ends[1]) if ends else np.zeros(len(s), bool)


def run_around(good: BoolArray, kept: BoolArray) -> slice:
    """
    Return the unbroken run of good places that contains the places that are milled.

    Parameters
    ----------
    good : ndarray of bool, shape (n,)
        Places with a solution.
    kept : ndarray of bool, shape (n,)
        Places that are milled; all of them are good. If there are none, the longest run counts.

    Returns
    -------
    slice

    """
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], good, [False]])))
    runs = [slice(int(a), int(b)) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]
    best = max(runs, key=lambda run: (kept[run].any(), run.stop - run.start), default=slice(0, 0))
    return best
