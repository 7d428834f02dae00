"""
Smooth segments -> pairs of cubic B-splines with one parameter, as native programs have them.

A corner's axis is the direction of top(f(u)) + E(u) - bottom(u): with one knot vector for both
curves neither f nor E can be said. Instead the second point is followed, with more knots, by the
cubic spline that interpolates it and has its derivative at both ends, so that o_s meets the
neighbours; knots are added until the stated tolerance holds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bezier import cubic_spans
from cnc_interp.core.errors import BlockError
from cnc_interp.smoothing.native.joining import Jets, span_jets
from cnc_interp.smoothing.orientation import norm
from cnc_interp.smoothing.segments import CORNER, PathSegments, corner_jets, spline_jets

#: Most knot intervals of one segment, and points in each at which it is compared.
MOST_INTERVALS, PROBES = 512, 8


@dataclass(frozen=True)
class CubicCurve:
    """
    One segment as control points, row by row as in Blocks.

    Parameters
    ----------
    bottom, top : ndarray, shape (n, 3)
        Control points of tip and second point [m].
    knot_interval : ndarray, shape (n,)
        Of each control point, 0 in the first and in the last two rows [m].
    late : int
        First row whose interval lies in the second half of the segment.
    deviation : float
        Largest distance found of tip and of point at flank height from the segment [m].

    """

    bottom: FloatArray
    top: FloatArray
    knot_interval: FloatArray
    late: int
    deviation: float

    def jets(self, at_end: bool) -> Jets:
        """Return the jets at one end of the pair of curves, in the direction of motion."""
        step = self.knot_interval[1:4] if not at_end else self.knot_interval[-3:-6:-1]
        ends = np.cumsum(np.concatenate([step, np.zeros(3)]))[:3]
        knots = np.concatenate([np.zeros(3), ends])[None]
        bottom, top = (
            cubic_spans((points[:4] if not at_end else points[:-5:-1])[None], knots)
            for points in (self.bottom, self.top)
        )
        jets = span_jets(bottom, top, np.zeros((1, 4, 3)))
        return jets.backwards() if at_end else jets


def cubic_curve(
    segments: PathSegments, i: int, height: float, tolerance: float, constant_height: bool
) -> CubicCurve:
    """
    Follow one corner or spline by a pair of cubic B-splines with one parameter.

    Parameters
    ----------
    segments : PathSegments
        The path.
    i : int
        Which segment.
    height : float
        Flank height, at which the deviation of the tool axis counts [m].
    tolerance : float
        Largest distance from the segment [m].
    constant_height : bool
        Whether the second point is that at flank height, or that of the segment's own top curve.

    Raises
    ------
    BlockError
        If more than MOST_INTERVALS knot intervals would be needed.

    """
    count = 2 if segments.kind[i] == CORNER else 1
    rate = _points(segments, i, np.array([0.0, 1.0]), height, constant_height)[1]
    while count <= MOST_INTERVALS:
        sites = np.linspace(0.0, 1.0, count + 1)
        values, _ = _points(segments, i, sites, height, constant_height)
        spline = _clamped(sites, values, rate)
        probes = (np.arange(count * PROBES) + 0.5) / (count * PROBES)
        deviation = _distance(spline, segments, i, probes, height)
        if deviation <= tolerance:
            size = float(norm(np.diff(values[:, :3], axis=0)).sum())
            return CubicCurve(
                bottom=spline.c[:, :3].copy(),
                top=spline.c[:, 3:].copy(),
                knot_interval=size * (spline.t[3:-1] - spline.t[2:-2]),
                late=1 + (count + 1) // 2,
                deviation=deviation,
            )
        count *= 2
    raise BlockError(
        f'no cubic spline with {MOST_INTERVALS} knot intervals follows this curve within '
        f'{tolerance * 1e6:g} um; allow more (--fit-tolerance)',
        int(segments.line_number[i]),
    )


def _clamped(sites: FloatArray, values: FloatArray, rate: FloatArray) -> BSpline:
    """Interpolate by a cubic spline with given derivatives at both ends."""
    if len(sites) == 2:  # one cubic: its Bezier points
        points = np.stack(
            [values[0], values[0] + rate[0] / 3.0, values[1] - rate[1] / 3.0, values[1]]
        )
        return BSpline(np.repeat([0.0, 1.0], 4), points, 3)
    return make_interp_spline(sites, values, k=3, bc_type=([(1, rate[0])], [(1, rate[1])]))


def _points(
    segments: PathSegments, i: int, u: FloatArray, height: float, constant_height: bool
) -> tuple[FloatArray, FloatArray]:
    """Return tip and second point and their derivatives at u, shape (n, 6) each."""
    values, rates = np.empty((len(u), 6)), np.empty((len(u), 6))
    for k, x in enumerate(u):
        tip, axis = segment_jets(segments, i, float(x))
        for c in range(3):
            values[k, c], rates[k, c] = tip[c][0], tip[c][1]
            values[k, 3 + c] = tip[c][0] + height * axis[c][0]
            rates[k, 3 + c] = tip[c][1] + height * axis[c][1]
    if not constant_height:
        connection = segments.connection[i]
        values[:, 3:] = _bezier(segments.top[i], u) + _bezier(connection, u)
        degrees = len(segments.top[i]) - 1, len(connection) - 1
        rates[:, 3:] = degrees[0] * _bezier(np.diff(segments.top[i], axis=0), u)
        rates[:, 3:] += degrees[1] * _bezier(np.diff(connection, axis=0), u)
    return values, rates


def _bezier(points: FloatArray, u: FloatArray) -> FloatArray:
    """Return points of one Bezier curve, shape (n, 3)."""
    level = np.repeat(points[None], len(u), axis=0)
    while level.shape[1] > 1:
        level = level[:, :-1] + u[:, None, None] * np.diff(level, axis=1)
    return level[:, 0]


def segment_jets(
    segments: PathSegments, i: int, u: float
) -> tuple[tuple[tuple[float, ...], ...], ...]:
    """Return the vector jets, in u, of tip and tool axis of one corner or spline."""
    bottom, top, connection = segments.bottom[i], segments.top[i], segments.connection[i]
    if segments.kind[i] == CORNER:
        found = corner_jets(bottom, top, connection, segments.parametrization[i], u, u)
    else:
        found = spline_jets(bottom, top, connection, u)
    return found  # type: ignore[no-any-return]


def _distance(
    spline: BSpline, segments: PathSegments, i: int, u: FloatArray, height: float
) -> float:
    """Return the largest distance of tip, and of point at flank height, at the same u [m]."""
    wanted, _ = _points(segments, i, u, height, True)
    found = spline(u)
    tool = found[:, 3:] - found[:, :3]
    found[:, 3:] = found[:, :3] + height * tool / norm(tool)[:, None]
    return float(max(norm((found - wanted)[:, :3]).max(), norm((found - wanted)[:, 3:]).max()))
