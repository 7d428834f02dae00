"""The smooth path of a plan directory: reading it, and the lengths of its segments."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bezier import bezier_values
from cnc_interp.core.corner_spline import corner_end_derivatives, sum_of
from cnc_interp.core.errors import InterpError
from cnc_interp.program.blocks import POSES
from cnc_interp.smoothing.orientation import norm
from cnc_interp.smoothing.segments import CORNER, SPLINE, PathSegments

FILE = 'segments.npz'


def read_segments(directory: Path) -> PathSegments | None:
    """Read the smooth path of a plan directory."""
    file = directory / FILE
    if not file.is_file():
        return None
    try:
        with np.load(file, allow_pickle=False) as archive:
            return PathSegments.of_columns(archive)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile) as fault:
        raise InterpError(f'{file}: cannot be read ({fault}); plan again') from fault


def lengths(segments: PathSegments, height: float) -> FloatArray:
    """Return the path lengths of segments; those of curves by Gauss's rule."""
    length = np.array(segments.length, dtype=float)
    corner = np.flatnonzero(segments.kind == CORNER)
    points = segments.bottom[corner, :5]
    if segments.interpolation.any():
        linear = (segments.interpolation[corner] != POSES)[:, None, None]
        beside = [height * segments.rotary[corner, :5], segments.extra[corner, :5]]
        beside = [np.where(linear, values, 0.0) for values in beside]
        points = np.concatenate([points, *beside], axis=2)
    node, weight = np.polynomial.legendre.leggauss(12)  # type: ignore[no-untyped-call]
    total = np.zeros(len(corner))
    for half in (points, points[:, ::-1]):
        first, second, third = corner_end_derivatives(half)
        for x, w in zip(0.25 * (node + 1.0), 0.25 * weight, strict=True):
            rate = first + x * (second + 0.5 * x * third)
            total += w * (norm(rate) if rate.shape[1] == 3 else np.linalg.norm(rate, axis=1))
    length[corner] = total
    spline = np.flatnonzero(segments.kind == SPLINE)
    rates = 5.0 * np.diff(segments.bottom[spline], axis=1)
    length[spline] = sum_of(
        0.5
        * w
        * norm(bezier_values(rates.swapaxes(1, 2), np.full((len(spline), 1), 0.5 * (x + 1.0))))
        for x, w in zip(node, weight, strict=True)
    )
    return length
