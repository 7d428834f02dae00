"""The parts of a pass that are milled: the strip lies over the surface, or in an overrun."""

from __future__ import annotations

import numpy as np

from cnc_interp.cam.guiding import GuidingCurve, SurfaceCurve
from cnc_interp.core.arrays import BoolArray, FloatArray, IntArray
from cnc_interp.core.units import MM
from cnc_interp.core.vectors import scaled

SPACING = 0.2 * MM  #: Distance of the places at which the border is compared with the strip [m].
LINES = 9  #: Lines along the strip that are compared with the border, over its whole width.


def kept_ranges(
    curve: GuidingCurve | SurfaceCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> list[tuple[float, float]]:
    """Return the milled parts of a pass: where its strip lies on the surface, and overruns."""
    dense = np.linspace(0.0, curve.length, max(60, int(curve.length / SPACING)))
    known = np.isfinite(reach)
    width = np.interp(dense, s[known], reach[known]) if known.any() else np.zeros(len(dense))
    frames, surface = curve.frames(dense), curve.surface
    a, b = surface.at(frames.u, frames.v).components(scaled(width, frames.across))
    across = np.linspace(-1.0, 1.0, LINES)[:, None]
    inside = surface.contains(frames.u + across * a, frames.v + across * b).any(axis=0)
    longer = overrun + dense[1]
    parts: list[tuple[float, float]] = []
    for run in runs(inside):
        first = max(float(dense[run.start]) - longer, 0.0)
        last = min(float(dense[run.stop - 1]) + longer, float(dense[-1]))
        if parts and first <= parts[-1][1]:
            first = parts.pop()[0]
        parts.append((first, last))
    return parts


def kept_places(
    curve: GuidingCurve, s: FloatArray, reach: FloatArray, overrun: float
) -> BoolArray:
    kept = np.zeros(len(s), bool)
    for first, last in kept_ranges(curve, s, reach, overrun):
        kept |= (s >= first) & (s <= last)
    return kept


def runs(true: BoolArray) -> list[slice]:
    bounds = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]])))
    return [slice(int(a), int(b)) for a, b in zip(bounds[::2], bounds[1::2], strict=True)]


def places_around(good: BoolArray, kept: BoolArray) -> IntArray:
    """Return the good places from the run with the first milled place to that with the last."""
    found = runs(good)
    ours = [run for run in found if kept[run].any()]
    if not ours:
        ours = sorted(found, key=lambda run: run.stop - run.start)[-1:]
    if not ours:
        return np.zeros(0, np.int64)
    return np.asarray(ours[0].start + np.flatnonzero(good[ours[0].start : ours[-1].stop]))
