"""
A part program in another dialect: ``cnc-interp convert``.

``gcode`` and ``cl`` write the program's own blocks, native splines as chords. ``siemens-bspline``
writes the smooth path that the look-ahead makes of it, as lines and pairs of cubic B-splines, and
says what a control with one parameter for both curves makes of the joins.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from cnc_interp.core.arrays import FloatArray
from cnc_interp.core.bspline import corner_end_derivatives
from cnc_interp.core.errors import BlockError
from cnc_interp.core.units import DEG, MM, UM
from cnc_interp.kinematics.axis_rates import traits_of
from cnc_interp.kinematics.branch import start_positions
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program import Program
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.writer import (
    ClMove,
    GcodeMove,
    SiemensMove,
    cl_data,
    gcode,
    siemens,
)
from cnc_interp.proof.programmed_splines import chords, portions
from cnc_interp.run.chain import BATCH
from cnc_interp.run.plan_writer import effective_feed
from cnc_interp.settings.choices import Settings
from cnc_interp.smoothing.native.cubic_curves import CubicCurve, cubic_curve
from cnc_interp.smoothing.native.joining import Jets, line_jets
from cnc_interp.smoothing.orientation import dot, norm, turned_by
from cnc_interp.smoothing.path_smoother import PathSmoother
from cnc_interp.smoothing.segments import CORNER, LINE, ROTATION, SPLINE, PathSegments

FORMATS = ('siemens-bspline', 'gcode', 'cl')
#: Share of the contour tolerance for the chords of native splines.
CHORD_SHARE = 0.1
#: Second points that differ less are the same [m].
SAME_POINT = 1e-9
#: Tool axes that differ less are the same [-].
SAME_AXIS = 1e-9
#: What rounding may hide in a deviation [m].
ROUNDING = 1e-13
#: Tool axes nearer to the pole than this leave the outer rotary axis where it is [-].
ON_POLE = 1e-14


@dataclass(frozen=True)
class Converted:
    """A written program, and what is worth knowing about it, one line each."""

    text: str
    notes: list[str]


def convert(
    program: Program, machine: Machine, settings: Settings, to: str, fit_tolerance: float
) -> Converted:
    """
    Write a program in another dialect.

    Parameters
    ----------
    program : Program
        What was read.
    machine : Machine
        Gives rotary words their meaning.
    settings : Settings
        How corners are rounded (``siemens-bspline``).
    to : {'siemens-bspline', 'gcode', 'cl'}
        The dialect.
    fit_tolerance : float
        Largest distance of cubic curves from the smooth path [m].

    Raises
    ------
    InterpError
        If the program cannot be written so.

    """
    transform = Transform.of(machine)
    try:
        if to == 'siemens-bspline':
            return _siemens(program, transform, settings, fit_tolerance)
        blocks = with_chords(program.blocks, settings.flank_height)
        if to == 'gcode':
            return _gcode(blocks, transform)
        return _cl(blocks, program.source, settings.flank_height)
    except BlockError as problem:
        problem.source = program.source
        raise


def with_chords(blocks: Blocks, height: float) -> Blocks:
    """Replace native splines by chords within a share of the contour tolerance."""
    if not blocks.on_spline.any():
        return blocks
    columns = {field.name: getattr(blocks, field.name) for field in fields(Blocks)}
    columns['line'] = blocks.line_number
    parts = []
    for first, last in portions(blocks.on_spline, blocks.exact_stop):
        if blocks.on_spline[first]:
            chord = CHORD_SHARE * float(blocks.contour_tolerance[first:last].min())
            rows, _ = chords(columns, first, last, height, chord)
            rows.pop('line')
            waits = np.zeros(len(rows['tip']), dtype=np.int64)
            waits[-1] = blocks.program_stop[last - 1]
            parts.append(Blocks(**rows | {'program_stop': waits}))
        else:
            parts.append(blocks[first:last])
    return Blocks.concatenate(parts)


def _gcode(blocks: Blocks, transform: Transform) -> Converted:
    """Write blocks with the machine's rotary words."""
    rotary = _rotary_words(blocks, transform) if transform.machine.has_rotary else None
    notes = []
    other = blocks.orientation_tolerance != blocks.contour_tolerance
    if rotary is not None and other.any():
        notes.append('G64 P gives the contour tolerance; the orientation tolerance is another')
    moves = (
        GcodeMove(
            tip=blocks.tip[i],
            rotary=None if rotary is None else rotary[i],
            feedrate=float(blocks.feedrate[i]),
            duration=float(blocks.duration[i]),
            rapid=bool(blocks.rapid[i]) or i == 0,
            exact_stop=bool(blocks.exact_stop[i]) and i < len(blocks) - 1,
            program_stop=int(blocks.program_stop[i]),
            on_great_circle=bool(np.isnan(blocks.rotary[i]).any()),
            tolerance=float(blocks.contour_tolerance[i]),
        )
        for i in range(len(blocks))
    )
    names = transform.machine.axis_names
    return Converted(gcode(moves, tuple(names[3:5]), notes), notes)


def _rotary_words(blocks: Blocks, transform: Transform) -> FloatArray:
    """Return rotary positions of all rows, each nearest to the one before, shape (n, 2) [rad]."""
    found = np.empty((len(blocks), 2))
    here, _ = start_positions(
        transform, blocks.axis[0], blocks.rotary[0], np.zeros(2), int(blocks.line_number[0])
    )
    found[0] = here
    for i in range(1, len(blocks)):
        axis, words = blocks.axis[i], blocks.rotary[i]
        if np.isfinite(words).all():
            here = words
        elif not np.array_equal(axis, blocks.axis[i - 1]):
            choices = []
            for pair in transform.rotary_solutions(axis):
                if 1.0 - abs(float(axis @ transform.pole)) < ON_POLE:
                    pair[transform.outer] = here[transform.outer]
                choices.append(pair + 2.0 * np.pi * np.round((here - pair) / (2.0 * np.pi)))
            if not choices:
                raise BlockError(
                    f'machine {transform.machine.name} cannot reach the tool axis',
                    int(blocks.line_number[i]),
                )
            here = min(choices, key=lambda pair: float(np.abs(pair - here).sum()))
        found[i] = here
    return found


def _cl(blocks: Blocks, source: str, height: float) -> Converted:
    """Write blocks as GOTO points."""
    feed = effective_feed(blocks)
    notes = []
    turning = np.isfinite(blocks.rotary[1:]).all(axis=1) & (
        norm(np.diff(blocks.tip, axis=0)) < SAME_POINT
    )
    if turning.any():
        notes.append('CL data have no rotary words: turns about the resting tip are vectors only')
    smallest = blocks.contour_tolerance.min(), blocks.orientation_tolerance.min()
    reader = Settings()
    if smallest != (reader.contour_tolerance, reader.orientation_tolerance):
        notes.append(
            'CL data have no tolerances; read them with '
            f'--contour-tolerance {smallest[0] / MM:g} --orientation-tolerance '
            f'{smallest[1] / MM:g}'
        )
    if np.isfinite(blocks.duration).any():
        notes.append('inverse-time feeds (G93) are written as feedrates')
    moves = (
        ClMove(
            tip=blocks.tip[i],
            axis=blocks.axis[i],
            feedrate=float(feed[i]),
            rapid=bool(blocks.rapid[i]) and i > 0,
            exact_stop=bool(blocks.exact_stop[i]) and i < len(blocks) - 1,
            program_stop=int(blocks.program_stop[i]),
        )
        for i in range(len(blocks))
    )
    return Converted(cl_data(moves, source.rsplit('/', 1)[-1], notes), notes)


def _siemens(
    program: Program, transform: Transform, settings: Settings, tolerance: float
) -> Converted:
    """Write the smooth path of a program."""
    smoother = PathSmoother(settings, traits_of(transform))
    blocks = program.blocks
    parts = [smoother.push(blocks[k : k + BATCH]) for k in range(0, len(blocks), BATCH)]
    segments = PathSegments.concatenate(
        [part for part in [*parts, smoother.finish()] if len(part)]
    )
    path = _Path(segments, transform, settings.flank_height, tolerance)
    moves = list(path.moves(blocks))
    notes = [
        f'smooth path in cubic B-splines, within {max(path.deviation, ROUNDING) / UM:.2g} um; '
        f'{len(blocks) - 1} blocks have become {len(moves) - 1}',
        *(path.losses() if np.ptp(blocks.axis, axis=0).max() > SAME_AXIS else ()),
    ]
    if (segments.kind == ROTATION).any() and np.isfinite(segments.rotary).any():
        notes.append('turns about the resting tip are written as tool axes, without whole turns')
    if blocks.program_stop.any():
        notes.append('M0 and M1 are written as exact stops')
    return Converted(siemens(moves, notes), notes)


class _Path:
    """Smooth segments on their way to native blocks."""

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
        """Yield the control points of consecutive curves as those of one."""
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
        """Whether second points are taken at flank height: corners, or curves that do not meet."""
        segments = self.segments
        if (segments.kind[first:last] == CORNER).any():
            return True
        gap = norm(segments.top[first : last - 1, 5] - segments.top[first + 1 : last, 0])
        return bool(gap.max(initial=0.0) > SAME_POINT)

    def _second_before(self, i: int) -> FloatArray | None:
        """Return the second point that the curve from segment i on begins with, if one does."""
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
        """Return the end of a line or of a rotation."""
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
        """Remember the largest jumps of the orientation's derivatives in what is written."""
        if arrives is None or leaves is None:
            return
        jumps = [float(norm(arrives.axis[k] - leaves.axis[k])[0]) for k in (1, 2)]
        self.rate_jump = max(self.rate_jump, jumps[0])
        self.bend_jump = max(self.bend_jump, jumps[1])

    def losses(self) -> list[str]:
        """Say what a control loses that takes u_top = u_bottom and does not connect curves."""
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
        """Return the largest jump of o_s from lines to corners of five points each [rad/m]."""
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
