"""Smooth segments as lines and pairs of cubic B-splines; ``losses``: what a control may lose.

On a corner the tool axis is that of top(f(u)) + E(u) - bottom(u). A cubic spline with ever
more knots interpolates the second point and its end derivatives until the tolerance holds.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cnc_interp.core import DEG, MM, BlockError, FloatArray, dot, norm
from cnc_interp.core.bspline import bezier_values, corner_end_derivatives, cubic_bezier_points
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.writer import WrittenMove
from cnc_interp.smoothing import segments as kinds
from cnc_interp.smoothing.native.joining import Jets, line_jets, span_jets
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import PathSegments

if TYPE_CHECKING:
    from scipy.interpolate import BSpline


#: Largest number of knot intervals of a segment; number of points per interval for distances.
MOST_INTERVALS, PROBES = 512, 8


@dataclass(frozen=True)
class Portion:
    """A pair of cubic B-splines with one clamped knot vector, one row for each control point."""

    #: (n, 3): Control points of tool tip and second point [m].
    bottom: FloatArray
    top: FloatArray
    #: (n,): Knot intervals t_(i+3) - t_(i+2) of row i; 0 in the first and in the last two rows.
    knot_interval: FloatArray

    @property
    def knots(self) -> FloatArray:
        """The knots from 0, shape (n + 4,)."""
        inner = np.cumsum(self.knot_interval)
        return np.concatenate([np.zeros(3), inner, inner[-1:]])

    @property
    def curve(self) -> BSpline:
        """Tip and second point as one spline of u with six coordinates [m]."""
        from scipy.interpolate import BSpline  # takes a tenth of a second

        return BSpline(self.knots, np.hstack([self.bottom, self.top]), 3)

    def end_span(self, at_end: bool) -> tuple[FloatArray, FloatArray, float]:
        """Return Bezier points of both curves, (1, 4, 3), from one end inward; and span length."""
        step = self.knot_interval[1:4] if not at_end else self.knot_interval[-3:-6:-1]
        ends = np.cumsum(np.concatenate([step, np.zeros(3)]))[:3]  # a lone span has two
        knots = np.concatenate([np.zeros(3), ends])[None]
        rows = slice(None, 4) if not at_end else slice(None, -5, -1)
        bottom, top = (
            cubic_bezier_points(points[rows][None], knots) for points in (self.bottom, self.top)
        )
        return bottom, top, float(step[0])

    def jets(self, at_end: bool) -> Jets:
        bottom, top, _ = self.end_span(at_end)
        jets = span_jets(bottom, top, np.zeros((1, 4, 3)))
        return jets.backwards() if at_end else jets


@dataclass(frozen=True)
class CubicCurve(Portion):
    late: int  #: First row whose knot interval lies in the second half of the segment.
    deviation: float  #: Largest distance of tip and point at flank height from the segment [m].


def cubic_curve(
    segments: PathSegments, i: int, height: float, tolerance: float, constant_height: bool
) -> CubicCurve:
    """Approximate segment ``i`` by two cubic B-splines with one parameter, or raise BlockError."""
    if segments.kind[i] == kinds.CORNER and not len(segments.parametrization[i]):
        if not segments.connection[i].any():
            # By its own 5 + 5 control points [B2013, 4.1].
            bottom, top = segments.bottom[i, :5], segments.top[i, :5]
            half = 0.5 * float(norm(np.diff(bottom, axis=0)).sum())
            return CubicCurve(bottom, top, half * np.array([0.0, 1.0, 1.0, 0.0, 0.0]), 2, 0.0)
    count = 2 if segments.kind[i] == kinds.CORNER else 1
    rate = _points(segments, i, np.array([0.0, 1.0]), height, constant_height)[1]
    while count <= MOST_INTERVALS:
        sites = np.linspace(0.0, 1.0, count + 1)
        values, _ = _points(segments, i, sites, height, constant_height)
        spline = clamped(sites, values, rate)
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
        f'{tolerance * 1e6:g} um; allow a larger deviation (--fit-tolerance)',
        int(segments.line_number[i]),
    )


def clamped(sites: FloatArray, values: FloatArray, rate: FloatArray) -> BSpline:
    # Importing it takes a tenth of a second; only native programs need it.
    from scipy.interpolate import BSpline, make_interp_spline

    if len(sites) == 2:  # one cubic: its Bezier points
        first, last = values[0] + rate[0] / 3.0, values[1] - rate[1] / 3.0
        points = np.stack([values[0], first, last, values[1]])
        return BSpline(np.repeat([0.0, 1.0], 4), points, 3)
    return make_interp_spline(sites, values, k=3, bc_type=([(1, rate[0])], [(1, rate[1])]))


def _points(
    segments: PathSegments, i: int, u: FloatArray, height: float, constant_height: bool
) -> tuple[FloatArray, FloatArray]:
    """Return tip and second point at u, and their derivatives by u, shape (n, 6) each [m]."""
    values, rates = np.empty((len(u), 6)), np.empty((len(u), 6))
    curves = segments.bottom[i], segments.top[i], segments.connection[i]
    for k, x in enumerate(u.tolist()):
        if segments.kind[i] == kinds.CORNER:
            tip, axis = kinds.corner_jets(*curves, segments.parametrization[i], x, x)
        else:
            tip, axis = kinds.spline_jets(*curves, x)
        for c in range(3):
            values[k, c], rates[k, c] = tip[c][0], tip[c][1]
            values[k, 3 + c] = tip[c][0] + height * axis[c][0]
            rates[k, 3 + c] = tip[c][1] + height * axis[c][1]
    if not constant_height:
        connection = segments.connection[i]
        values[:, 3:] = _on_curve(segments.top[i], u) + _on_curve(connection, u)
        degrees = len(segments.top[i]) - 1, len(connection) - 1
        rates[:, 3:] = degrees[0] * _on_curve(np.diff(segments.top[i], axis=0), u)
        rates[:, 3:] += degrees[1] * _on_curve(np.diff(connection, axis=0), u)
    return values, rates


def _on_curve(points: FloatArray, u: FloatArray) -> FloatArray:
    return bezier_values(points.T[None], u[:, None])


def _distance(
    spline: BSpline, segments: PathSegments, i: int, u: FloatArray, height: float
) -> float:
    """Return the largest distance at equal u, of the tip or the point at flank height [m]."""
    wanted, _ = _points(segments, i, u, height, True)
    found = spline(u)
    tool = found[:, 3:] - found[:, :3]
    found[:, 3:] = found[:, :3] + height * tool / norm(tool)[:, None]
    return float(max(norm((found - wanted)[:, :3]).max(), norm((found - wanted)[:, 3:]).max()))


SAME_POINT = 1e-9  #: Second points closer than this are equal [m].


class SplineMoves:
    def __init__(
        self, segments: PathSegments, transform: Transform, height: float, tolerance: float
    ):
        self.segments, self.transform = segments, transform
        self.height, self.tolerance = height, tolerance
        self.deviation = 0.0
        self.rate_jump = self.bend_jump = 0.0  # [rad/m], [rad/m2]

    def moves(self, blocks: Blocks) -> Iterator[WrittenMove]:
        segments = self.segments
        start = 0
        yield self._pose(blocks.tip[0], blocks.axis[0], np.inf, False, self._second_before(0))
        arrives: Jets | None = None
        while start < len(segments):
            if segments.kind[start] in (kinds.CORNER, kinds.SPLINE):
                end = start + 1
                while (
                    end < len(segments)
                    and segments.kind[end] in (kinds.CORNER, kinds.SPLINE)
                    and not segments.stop[end - 1]
                ):
                    end += 1
                yield from self._curve(start, end, arrives)
                arrives = self._last
                start = end
            else:
                yield self._line(start)
                self._compare(arrives, self._line_jets(start, at_end=False))
                arrives = self._line_jets(start, at_end=True)
                start += 1
            if segments.stop[start - 1]:
                arrives = None

    def _curve(self, first: int, last: int, arrives: Jets | None) -> Iterator[WrittenMove]:
        segments, constant = self.segments, self._constant_height(first, last)
        for i in range(first, last):
            curve = cubic_curve(segments, i, self.height, self.tolerance, constant)
            self.deviation = max(self.deviation, curve.deviation)
            self._compare(arrives, curve.jets(at_end=False))
            arrives = self._last = curve.jets(at_end=True)
            yield from self._control_points(curve, i)

    def _control_points(self, curve: CubicCurve, i: int) -> Iterator[WrittenMove]:
        count = len(curve.bottom)
        feed = self.segments.feed[i]
        stops = bool(self.segments.stop[i]) and i < len(self.segments) - 1
        for k in range(1, count):
            yield WrittenMove(
                tip=curve.bottom[k],
                rapid=False,
                exact_stop=stops and k == count - 1,
                second=curve.top[k] if self.transform.machine.has_rotary else None,
                feedrate=float(feed[0] if k < curve.late else feed[1]),
                knot_interval=float(curve.knot_interval[k]),
            )

    def _constant_height(self, first: int, last: int) -> bool:
        """Return whether second points are at flank height, as needed for corners and gaps."""
        segments = self.segments
        if (segments.kind[first:last] == kinds.CORNER).any():
            return True
        gap = norm(segments.top[first : last - 1, 5] - segments.top[first + 1 : last, 0])
        return bool(gap.max(initial=0.0) > SAME_POINT)

    def _second_before(self, i: int) -> FloatArray | None:
        """Return the second point at the start of the curve from segment i, if it has one."""
        segments = self.segments
        if i >= len(segments) or segments.kind[i] != kinds.SPLINE:
            return None
        last = i + 1
        while (
            last < len(segments)
            and segments.kind[last] == kinds.SPLINE
            and not segments.stop[last - 1]
        ):
            last += 1
        corner = last < len(segments) and segments.kind[last] == kinds.CORNER
        if (corner and not segments.stop[last - 1]) or self._constant_height(i, last):
            return None
        return np.asarray(segments.top[i, 0])

    def _line(self, i: int) -> WrittenMove:
        segments = self.segments
        resting = segments.kind[i] == kinds.ROTATION
        words = segments.rotary[i, 1]
        if resting and np.isfinite(words).all():
            axis = self.transform.tool_axis(words[None])[0]
        else:
            axis = turned_by(segments.axis[i], segments.rotation[i], 1.0)
        stop = bool(segments.stop[i]) and not resting and i < len(segments) - 1
        tip = segments.bottom[i, 0 if resting else 1]
        feed = float(segments.feed[i, 0])
        return self._pose(tip, axis, feed, stop, self._second_before(i + 1))

    def _pose(
        self, tip: FloatArray, axis: FloatArray, feed: float, stop: bool, second: FloatArray | None
    ) -> WrittenMove:
        if not self.transform.machine.has_rotary:
            second = None
        elif second is None:
            second = tip + self.height * axis
        return WrittenMove(tip, feed, bool(np.isinf(feed)), stop, second=second)

    def _line_jets(self, i: int, at_end: bool) -> Jets | None:
        segments = self.segments
        if segments.kind[i] != kinds.LINE:
            return None
        length = float(segments.length[i])
        way = segments.bottom[i, 1] - segments.bottom[i, 0]
        axis = turned_by(segments.axis[i], segments.rotation[i], float(at_end))
        rows = (segments.bottom[i, int(at_end)], way / length, axis, segments.rotation[i] / length)
        return line_jets(*(row[None] for row in rows))

    def _compare(self, arrives: Jets | None, leaves: Jets | None) -> None:
        if arrives is None or leaves is None:
            return
        jumps = [float(norm(arrives.axis[k] - leaves.axis[k])[0]) for k in (1, 2)]
        self.rate_jump = max(self.rate_jump, jumps[0])
        self.bend_jump = max(self.bend_jump, jumps[1])

    def losses(self) -> list[str]:
        rate, bend = self.rate_jump / DEG * MM, self.bend_jump / DEG * MM**2
        notes = [
            'on a control that uses u_top = u_bottom and does not connect curves, the '
            f'orientation rate jumps by up to {rate:.2g} deg/mm, and its derivative by up to '
            f'{bend:.2g} deg/mm2'
        ]
        corners = self.segments.kind == kinds.CORNER
        if corners.any() and self.segments.rotation.any():
            plain = self._plain_jump() / DEG * MM
            notes.append(
                'with five control points for each corner, as in the paper, the rate would jump '
                f'by up to {plain:.2g} deg/mm; more second points are written to avoid this'
            )
        return notes

    def _plain_jump(self) -> float:
        """Return the largest jump of o_s where lines meet plain corners [rad/m]."""
        segments, largest = self.segments, 0.0
        for i in np.flatnonzero(segments.kind == kinds.CORNER):
            for near, step in ((i - 1, 1), (i + 1, -1)):
                if not 0 <= near < len(segments) or segments.kind[near] != kinds.LINE:
                    continue
                line = self._line_jets(int(near), at_end=step > 0)
                assert line is not None
                bottom, top = (
                    points[i : i + 1, :5][:, ::step] for points in (segments.bottom, segments.top)
                )
                p = corner_end_derivatives(bottom)[0]
                plain = corner_end_derivatives(top)[0] - p
                tool = top[:, 0] - bottom[:, 0]
                axis = tool / norm(tool)[:, None]
                rate = plain - dot(plain, axis)[:, None] * axis
                rate *= step / (norm(tool) * norm(p))[:, None]
                largest = max(largest, float(norm(rate - line.axis[1])[0]))
        return largest
