"""Smooth segments as lines and pairs of cubic B-splines; ``losses`` tells what controls change."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.corner_spline import corner_end_derivatives
from cnc_interp.core.units import DEG, MM
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.writer import SiemensMove
from cnc_interp.smoothing.native.cubic_curves import CubicCurve, cubic_curve
from cnc_interp.smoothing.native.joining import Jets, line_jets
from cnc_interp.smoothing.orientation import dot, norm, turned_by
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

SAME_POINT = 1e-9  #: Second points closer than this are equal [m].


class SplineMoves:
    """Converts smooth segments to native blocks."""

    def __init__(
        self, segments: PathSegments, transform: Transform, height: float, tolerance: float
    ):
        self.segments, self.transform = segments, transform
        self.height, self.tolerance = height, tolerance
        self.deviation = 0.0
        self.rate_jump = self.bend_jump = 0.0  # [rad/m], [rad/m2]

    def moves(self, blocks: Blocks) -> Iterator[SiemensMove]:
        """Yield the blocks of the path, the start pose first."""
        segments = self.segments
        start = 0
        yield self._pose(blocks.tip[0], blocks.axis[0], np.inf, False, self._second_before(0))
        arrives: Jets | None = None
        while start < len(segments):
            if segments.kind[start] in (CORNER, SPLINE):
                end = start + 1
                while (
                    end < len(segments)
                    and segments.kind[end] in (CORNER, SPLINE)
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

    def _curve(self, first: int, last: int, arrives: Jets | None) -> Iterator[SiemensMove]:
        """Yield the control points of successive curves as one curve."""
        segments, constant = self.segments, self._constant_height(first, last)
        for i in range(first, last):
            curve = cubic_curve(segments, i, self.height, self.tolerance, constant)
            self.deviation = max(self.deviation, curve.deviation)
            self._compare(arrives, curve.jets(at_end=False))
            arrives = self._last = curve.jets(at_end=True)
            yield from self._control_points(curve, i)

    def _control_points(self, curve: CubicCurve, i: int) -> Iterator[SiemensMove]:
        count = len(curve.bottom)
        feed = self.segments.feed[i]
        for k in range(1, count):
            yield SiemensMove(
                tip=curve.bottom[k],
                second=curve.top[k] if self.transform.machine.has_rotary else None,
                feedrate=float(feed[0] if k < curve.late else feed[1]),
                knot_interval=float(curve.knot_interval[k]),
                rapid=False,
                exact_stop=bool(self.segments.stop[i])
                and k == count - 1
                and i < len(self.segments) - 1,
            )

    def _constant_height(self, first: int, last: int) -> bool:
        """Return whether second points are at flank height: corners, and curves with gaps."""
        segments = self.segments
        if (segments.kind[first:last] == CORNER).any():
            return True
        gap = norm(segments.top[first : last - 1, 5] - segments.top[first + 1 : last, 0])
        return bool(gap.max(initial=0.0) > SAME_POINT)

    def _second_before(self, i: int) -> FloatArray | None:
        """Return the second point at the start of the curve from segment i, if it has one."""
        segments = self.segments
        if i >= len(segments) or segments.kind[i] != SPLINE:
            return None
        last = i + 1
        while (
            last < len(segments) and segments.kind[last] == SPLINE and not segments.stop[last - 1]
        ):
            last += 1
        corner = last < len(segments) and segments.kind[last] == CORNER
        if (corner and not segments.stop[last - 1]) or self._constant_height(i, last):
            return None
        return np.asarray(segments.top[i, 0])

    def _line(self, i: int) -> SiemensMove:
        segments = self.segments
        resting = segments.kind[i] == ROTATION
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
    ) -> SiemensMove:
        if second is None:
            second = tip + self.height * axis
        has_rotary = self.transform.machine.has_rotary
        return SiemensMove(
            tip, second if has_rotary else None, feed, np.nan, bool(np.isinf(feed)), stop
        )

    def _line_jets(self, i: int, at_end: bool) -> Jets | None:
        segments = self.segments
        if segments.kind[i] != LINE:
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
        """List the effects on a control that uses one parameter for both curves and joins none."""
        rate, bend = self.rate_jump / DEG * MM, self.bend_jump / DEG * MM**2
        notes = [
            'a control with u_top = u_bottom that does not connect curves sees jumps of the '
            f'orientation rate up to {rate:.2g} deg/mm, of its derivative up to {bend:.2g} deg/mm2'
        ]
        corners = self.segments.kind == CORNER
        if corners.any() and self.segments.rotation.any():
            plain = self._plain_jump() / DEG * MM
            notes.append(
                'with five control points for each corner, as in the paper, the rate would jump '
                f'by up to {plain:.2g} deg/mm: the second points are more and carry the connection'
            )
        return notes

    def _plain_jump(self) -> float:
        """Return the largest jump of o_s where lines meet plain corners [rad/m]."""
        segments, largest = self.segments, 0.0
        for i in np.flatnonzero(segments.kind == CORNER):
            for near, step in ((i - 1, 1), (i + 1, -1)):
                if not 0 <= near < len(segments) or segments.kind[near] != LINE:
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
