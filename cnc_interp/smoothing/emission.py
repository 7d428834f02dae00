"""Convert classified vertices to segments: remaining lines, corners and spans of curves."""

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import BlockError, FloatArray, IntArray, norm
from cnc_interp.machine_model.machine_traits import MachineTraits
from cnc_interp.program.blocks import AXES_LINEAR, ROTARY_LINEAR
from cnc_interp.smoothing import segments as kinds
from cnc_interp.smoothing.corners import corner_curve
from cnc_interp.smoothing.corners.axis_corner import EXTRA, POINT, TURN
from cnc_interp.smoothing.corners.corner_curve import Style
from cnc_interp.smoothing.corners.vertices import ROUND, STOP, Legs, axis_corners, corners_at
from cnc_interp.smoothing.dense.path_rows import Rows
from cnc_interp.smoothing.orientation import turned_by
from cnc_interp.smoothing.segments import PathSegments


@dataclass(frozen=True)
class Emission:
    rows: Rows  #: End poses of lines and curves.
    legs: Legs  #: Geometry of the blocks between the vertices.
    vertex: IntArray  #: (n,): Kind of each vertex: PASS, ROUND or STOP.
    inner: FloatArray  #: (n,): L1 of the corners [m].
    outer: FloatArray  #: (n, 2): L2 before and after the vertices [m]; 0 without a corner.
    style: Style  #: The construction of the corners.
    machine: MachineTraits  #: Kinematics for blocks whose rotary axes run linearly.

    def segments(self, last: int) -> PathSegments:
        """Build the segments of rows 1 ... last and the corners at vertices 1 ... last."""
        kept, lines = self._lines(last)
        parts, places = [lines], [2 * kept + 1]
        round_ones = np.flatnonzero(self.vertex[: last + 1] == ROUND)
        round_ones = round_ones[round_ones > 0]
        in_axes, own = self._axis_corners(round_ones)
        if in_axes is not None:
            parts.append(in_axes)
            places.append(2 * own)
            round_ones = round_ones[~np.isin(round_ones, own)]
        if len(round_ones):
            parts.append(self._corners(round_ones))
            places.append(2 * round_ones)
        curves = np.repeat(np.arange(last), self.rows.count[1 : last + 1])
        if len(curves):
            parts.append(self._curves(curves))
            places.append(2 * curves + 1)
        order = np.argsort(np.concatenate(places), kind='stable')
        return PathSegments.concatenate(parts)[order]

    def _curves(self, row: IntArray) -> PathSegments:
        """Return the spans of curves; ``row`` has the index of the vertex before each span."""
        n, first = len(row), int(self.rows.count[0])
        spans = self.rows.spans[first : first + n]
        empty_curves = self.style.empty_curves(n)
        tool = spans.top[:, 0] - spans.bottom[:, 0]
        final = np.append(row[1:] != row[:-1], True)
        return PathSegments(
            kind=np.full(n, kinds.SPLINE),
            bottom=spans.bottom,
            top=spans.top,
            connection=empty_curves.connection,
            parametrization=empty_curves.parametrization,
            axis=tool / norm(tool)[:, None],
            feed=spans.feed,
            block=spans.block,
            line_number=spans.line_number,
            stop=final & (self.vertex[row + 1] == STOP),
            deviation=spans.deviation,
            room=spans.room,
            extra=np.repeat(self.rows.blocks.extra[row, None], kinds.POINTS, axis=1),
        )

    def _lines(self, last: int) -> tuple[IntArray, PathSegments]:
        """Return the vertex before each line or rotation between corners, and their segments."""
        rows, legs, outer, stop = self.rows, self.legs, self.outer, self.vertex == STOP
        blocks = rows.blocks
        start, end = outer[:last, 1], legs.length[:last] - outer[1 : last + 1, 0]
        resting = legs.resting[:last]
        begin = blocks.rotary_from[1 : last + 1]
        begin = np.where(np.isfinite(begin), begin, blocks.rotary[:last])
        rotary = np.stack([begin, blocks.rotary[1 : last + 1]], axis=1)
        programmed = np.isfinite(rotary).all(axis=(1, 2))
        swept = np.where(
            programmed, np.sqrt((np.diff(rotary, axis=1)[:, 0] ** 2).sum(axis=1)), legs.turn[:last]
        )
        longer = self._longer(np.arange(last))
        length = np.where(
            resting, self._resting_way(np.arange(last), swept), longer * (end - start)
        )
        line = rows.count[1 : last + 1] == 0
        kept = np.flatnonzero(
            line & np.where(resting, length > 0.0, end - start > 1e-12 * legs.length[:last])
            | (line & ~resting & stop[1 : last + 1] & (end - start > 0.0))
        )
        share = np.where(resting, 0.0, start / np.where(resting, 1.0, legs.length[:last]))
        rotation = legs.rotation[:last]
        part = np.where(resting, 1.0, (end - start) / np.where(resting, 1.0, legs.length[:last]))
        curves = self.style.empty_curves(last)
        bottom = curves.bottom
        bottom[:, 0] = blocks.tip[:last] + start[:, None] * legs.direction[:last]
        bottom[:, 1] = blocks.tip[:last] + end[:, None] * legs.direction[:last]
        from_corner, to_corner = outer[:last, 1] > 0.0, outer[1 : last + 1, 0] > 0.0
        bottom[:, 1] = np.where(
            (to_corner | resting)[:, None], bottom[:, 1], blocks.tip[1 : last + 1]
        )
        bottom[:, 0] = np.where(from_corner[:, None], bottom[:, 0], blocks.tip[:last])
        axis = turned_by(blocks.axis[:last], rotation, share)
        feed = self._feed(np.arange(last), swept)
        row = rows.row[kept + 1]
        values = kinds.no_rotary(last)
        values[:, :2] = rotary
        extra = self._extra_on_lines(last, start, end)
        self._put_axis_lines(start, end, bottom, axis, values, extra)
        return kept, PathSegments(
            kind=np.where(resting, kinds.ROTATION, kinds.LINE)[kept],
            bottom=kinds.padded(bottom[kept]),
            top=kinds.padded(curves.top[kept]),
            connection=curves.connection[kept],
            parametrization=curves.parametrization[kept],
            axis=axis[kept],
            rotation=(rotation * part[:, None])[kept],
            rotary=values[kept],
            length=length[kept],
            feed=np.repeat(feed[kept, None], 2, axis=1),
            block=np.repeat(row[:, None], 2, axis=1),
            line_number=blocks.line_number[kept + 1],
            stop=stop[1 : last + 1][kept],
            deviation=rows.used[kept + 1],
            extra=extra[kept],
            interpolation=blocks.interpolation[kept + 1],
            room=self._least_tolerance(kept),
        )

    def _put_axis_lines(
        self,
        start: FloatArray,
        end: FloatArray,
        bottom: FloatArray,
        axis: FloatArray,
        rotary: FloatArray,
        extra: FloatArray,
    ) -> None:
        axes, geometry = self.legs.axes, self.machine.geometry
        if axes is None or geometry is None:
            return
        rows = np.flatnonzero(axes.linear[: len(start)])
        if not len(rows):
            return
        length = np.where(axes.length[rows] > 0.0, axes.length[rows], 1.0)
        for k, way in enumerate((start, end)):
            at = axes.start[rows] + (way[rows] / length)[:, None] * axes.step[rows]
            whole = way[rows] == axes.length[rows]
            at[whole] = (axes.start[rows] + axes.step[rows])[whole]
            bottom[rows, k], rotary[rows, k] = at[:, POINT], at[:, TURN]
            extra[rows, k] = at[:, EXTRA]
        axis[rows] = geometry.tool_axis(rotary[rows, 0])

    def _axis_corners(self, rows: IntArray) -> tuple[PathSegments | None, IntArray]:
        corners = axis_corners(self.rows, self.legs, self.style.height, self.machine, rows)
        geometry = self.machine.geometry
        if corners is None or geometry is None or not len(corners.row):
            return None, np.zeros(0, dtype=np.int64)
        own, blocks, n = corners.row, self.rows.blocks, len(corners.row)
        points, deviation = corners.curves(self.inner[own], self.outer[own])
        points = np.concatenate([points, np.zeros_like(points[:, : kinds.POINTS - 5])], axis=1)
        before, after = self._feed(own - 1, np.zeros(n)), self._feed(own, np.zeros(n))
        curves = self.style.empty_curves(n)
        return PathSegments(
            kind=np.full(n, kinds.CORNER),
            bottom=points[..., POINT].copy(),
            top=kinds.padded(curves.top),
            connection=curves.connection,
            parametrization=np.zeros_like(curves.parametrization),
            axis=geometry.tool_axis(points[:, 0, TURN]),
            rotary=points[..., TURN].copy(),
            feed=np.stack([before, after], axis=1),
            block=np.stack([self.rows.row[own], self.rows.row[own + 1]], axis=1),
            line_number=blocks.line_number[own + 1],
            deviation=deviation,
            extra=points[..., EXTRA].copy(),
            interpolation=np.where(corners.in_axes, AXES_LINEAR, ROTARY_LINEAR),
        ), own

    def _resting_way(self, rows: IntArray, swept: FloatArray) -> FloatArray:
        moved = self.legs.extra_step[rows]
        turned = self.style.height * swept
        return np.where(moved.any(axis=1), np.sqrt(turned**2 + (moved**2).sum(axis=1)), turned)

    def _longer(self, rows: IntArray) -> FloatArray:
        """Return path length over tip length: 1, or more where the tool swivels, at flank height.

        Per travel of the tip, rotary axes would turn by up to 1e8 rad/m, so that a rounding error
        of the path position would make the axes jump.
        """
        legs, swivels = self.legs, self.legs.swivels[rows]
        turned = self.style.height * legs.turn[rows]
        return np.maximum(turned / np.where(swivels, legs.length[rows], np.inf), 1.0)

    def _extra_on_lines(self, last: int, start: FloatArray, end: FloatArray) -> FloatArray:
        blocks, legs = self.rows.blocks, self.legs
        found = np.zeros((last, kinds.POINTS, blocks.extra.shape[1]))
        rate = legs.extra_rate[:last]
        found[:, 0] = blocks.extra[:last] + start[:, None] * np.where(
            legs.resting[:last, None], 0.0, rate
        )
        short = (end < legs.length[:last]) & ~legs.resting[:last]
        found[:, 1] = np.where(
            short[:, None], blocks.extra[:last] + end[:, None] * rate, blocks.extra[1 : last + 1]
        )
        return found

    def _orientation_tolerance(self, rows: IntArray) -> FloatArray:
        """Return the orientation tolerance at vertices: the smaller one of both blocks [m]."""
        column = self.rows.blocks.orientation_tolerance
        after = np.minimum(rows + 1, len(column) - 1)
        return np.asarray(np.minimum(column[rows], column[after]))

    def _least_tolerance(self, rows: IntArray) -> FloatArray:
        """Return the smaller orientation tolerance of both ends of blocks after vertices [m]."""
        ends = self._orientation_tolerance(rows), self._orientation_tolerance(rows + 1)
        return np.asarray(np.minimum(*ends))

    def _extra_on_corners(self, rows: IntArray, inner: FloatArray) -> FloatArray:
        blocks, legs, outer = self.rows.blocks, self.legs, self.outer[rows]
        found = np.zeros((len(rows), kinds.POINTS, blocks.extra.shape[1]))
        found[:, 2] = blocks.extra[rows]
        for side, rate in ((0, -legs.extra_rate[rows - 1]), (1, legs.extra_rate[rows])):
            found[:, 4 * side] = found[:, 2] + outer[:, side, None] * rate
            found[:, 1 + 2 * side] = found[:, 2] + inner[:, None] * rate
        return found

    def _feed(self, rows: IntArray, swept: FloatArray) -> FloatArray:
        """Return the programmed ds/dt after vertices [m/s]; inf where only the axes limit it."""
        blocks, legs = self.rows.blocks, self.legs
        duration = blocks.duration[rows + 1]
        timed = np.isfinite(duration)
        resting = legs.resting[rows]
        longer = self._longer(rows)
        length = np.where(resting, self._resting_way(rows, swept), longer * legs.length[rows])
        alone = resting & ~(legs.extra_step[rows].any(axis=1) & (swept == 0.0))
        programmed = np.where(alone, np.inf, longer * blocks.feedrate[rows + 1])
        return np.where(timed, length / np.where(timed, duration, 1.0), programmed)

    def _corners(self, rows: IntArray) -> PathSegments:
        n, lines, blocks = len(rows), self.rows, self.rows.blocks
        corners = corners_at(blocks, self.legs, rows, self.machine, self.style.height)
        inner, _, curves, deviation = corner_curve.fit(
            corners, self.inner[rows], self.outer[rows], self.style
        )
        beyond = np.flatnonzero((deviation > corners.tolerances * (1.0 + 1e-6)).any(axis=1))
        if len(beyond):
            raise BlockError(
                'this corner cannot be rounded within the tolerances; give it an exact stop (G61)',
                int(blocks.line_number[rows[beyond[0]]]),
            )
        zero = np.zeros(n)
        return PathSegments(
            kind=np.full(n, kinds.CORNER),
            bottom=kinds.padded(curves.bottom),
            top=kinds.padded(curves.top),
            connection=curves.connection,
            parametrization=curves.parametrization,
            axis=(curves.top[:, 0] - curves.bottom[:, 0]) / self.style.height,
            feed=np.stack([self._feed(rows - 1, zero), self._feed(rows, zero)], axis=1),
            block=np.stack([lines.row[rows], lines.row[rows + 1]], axis=1),
            line_number=blocks.line_number[rows + 1],
            deviation=deviation + np.maximum(lines.used[rows], lines.used[rows + 1]),
            extra=self._extra_on_corners(rows, inner),
            room=np.maximum(self._orientation_tolerance(rows) - deviation[:, 1], 0.0),
        )
