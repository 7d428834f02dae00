"""Write a part program in another dialect: its blocks, or its smooth path as native B-splines."""

from dataclasses import dataclass, replace

import numpy as np

from cnc_interp.convert.native_joins import Joins, portions
from cnc_interp.convert.native_splines import Portion, SplineMoves
from cnc_interp.core import MM, UM, BlockError, FloatArray, IntArray, ProgramError, norm
from cnc_interp.machine_model.five_axis import FiveAxis
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform, start_positions
from cnc_interp.program import Program
from cnc_interp.program.blocks import AXES_LINEAR, GO_ON, POSES, Blocks
from cnc_interp.program.geometry.subdivide import piece_counts, ragged
from cnc_interp.program.writer import WrittenMove, cl_data, gcode, siemens
from cnc_interp.run.path_chain import segments_of
from cnc_interp.run.plan_writer import effective_feed
from cnc_interp.settings.options import Settings
from cnc_interp.smoothing.segments import ROTATION

#: Share of the tolerances for chords of native splines and of linear rotary axes.
CHORD_SHARE = 0.1
SAME_POINT = 1e-9  #: Tips closer than this are equal [m].
SAME_AXIS = 1e-9  #: Tool axes closer than this are equal [-].
ROUNDING = 1e-13  #: Smallest deviation that is stated; smaller ones are rounding [m].


@dataclass(frozen=True)
class Converted:
    text: str  #: The program.
    notes: list[str]  #: Sentences for the user, one line each.


def convert(
    program: Program,
    machine: Machine,
    settings: Settings,
    to: str,
    fit_tolerance: float,
    slide: bool = False,
) -> Converted:
    """Write a program in another dialect.

    ``fit_tolerance``: largest distance of cubic curves from the smooth path [m]; ``slide``:
    whether native curves are first joined (``native_joins.py``). Raises InterpError if the dialect
    cannot express the program.
    """
    transform = Transform.of(machine)
    program = replace(program, blocks=with_poses(program.blocks, transform, settings.flank_height))
    if program.blocks.extra.any():
        raise ProgramError(
            f'moves {" ".join(machine.extra_names)}; only programs without extra axes can be '
            'converted',
            program.source,
        )
    if slide and to != 'siemens-bspline':
        raise ProgramError('only --to siemens-bspline has curves to join', program.source)
    try:
        if to == 'siemens-bspline':
            joins = Joins(settings.flank_height, fit_tolerance, settings.septic)
            if slide:
                program = replace(program, blocks=joins.joined(program.blocks))
            made = _siemens(program, transform, settings, fit_tolerance)
            return replace(made, notes=[*joins.notes(), *made.notes]) if slide else made
        blocks = with_chords(program.blocks, settings.flank_height)
        if to == 'gcode':
            return _gcode(blocks, transform)
        return _cl(blocks, program.source)
    except BlockError as problem:
        problem.source = program.source
        raise


def with_poses(blocks: Blocks, transform: Transform, height: float) -> Blocks:
    """Replace linear rotary motion by poses, to a share of the tolerances at ``height`` [m]."""
    linear = np.flatnonzero(blocks.by_rotary)
    if not len(linear):
        return blocks
    in_axes = blocks.interpolation == AXES_LINEAR
    first, last = blocks.rotary_from, blocks.rotary
    start, end = blocks.tip[linear - 1].copy(), blocks.tip[linear].copy()
    own = in_axes[linear]
    start[own] = transform.linear(start[own], first[linear[own]]).reshape(-1, 3)
    end[own] = transform.linear(end[own], last[linear[own]]).reshape(-1, 3)
    # X Y Z plus the extra axes along their directions: the sum runs linearly, too.
    ends = [np.hstack([start, first[linear]]), np.hstack([end, last[linear]])]

    def poses(row: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        q = ends[0][row] + u[:, None] * (ends[1] - ends[0])[row]
        tip, axis = transform.forward(q)
        tip[~own[row]] = q[~own[row], :3]
        return tip, axis

    counts = np.ones(len(blocks), dtype=np.int64)
    counts[linear] = piece_counts(
        poses,
        np.abs(last - first)[linear].sum(axis=1),
        CHORD_SHARE * blocks.contour_tolerance[linear],
        CHORD_SHARE * blocks.orientation_tolerance[linear],
        height,
    )
    row, piece = ragged(counts)
    u, final = (piece + 1.0) / counts[row], piece + 1 == counts[row]
    columns = {name: values[row] for name, values in blocks.columns().items()}
    between = np.flatnonzero(~final)
    place = np.searchsorted(linear, row[between])
    columns['tip'][between], columns['axis'][between] = poses(place, u[between])
    way = (last - first)[row[between]]
    columns['rotary'][between] = first[row[between]] + u[between, None] * way
    left = (1.0 - u[between, None]) * (blocks.extra[row[between]] - blocks.extra[row[between] - 1])
    columns['extra'][between] -= left
    columns['duration'] /= counts[row]
    columns['exact_stop'] &= final
    columns['program_stop'] = np.where(final, columns['program_stop'], GO_ON)
    columns['interpolation'] = np.full(len(row), POSES)
    columns['rotary_from'] = np.full((len(row), 2), np.nan)
    return Blocks(**columns)


def with_chords(blocks: Blocks, height: float, most: float = np.inf) -> Blocks:
    """Replace native splines by chords within a share of their tolerance and ``most`` [m]."""
    parts = []
    for first, last in portions(blocks):
        rows = blocks[first:last]
        parts.append(_chords(rows, height, most) if rows.on_spline[0] else rows)
    return Blocks.concatenate(parts)


def _chords(rows: Blocks, height: float, most: float) -> Blocks:
    portion = Portion(rows.tip, rows.top, rows.knot_interval)
    curve, spans = portion.curve, np.flatnonzero(rows.knot_interval)

    def poses(span: IntArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        row = spans[span]
        both = curve(portion.knots[row + 2] + u * rows.knot_interval[row])
        tool = both[:, 3:] - both[:, :3]
        return both[:, :3], tool / norm(tool)[:, None]

    within = min(CHORD_SHARE * float(rows.contour_tolerance.min()), most)
    allowed = np.full(len(spans), within)
    turned = np.full(len(spans), np.pi / 4.0)  # several pieces for the first trial
    counts = piece_counts(poses, turned, allowed, allowed, height)
    span, piece = ragged(counts)
    columns = {name: values[spans[span]] for name, values in rows.columns().items()}
    columns['tip'], columns['axis'] = poses(span, (piece + 1.0) / counts[span])
    columns['top'] = np.full((len(span), 3), np.nan)
    columns['knot_interval'] = np.full(len(span), np.nan)
    last = np.arange(len(span)) == len(span) - 1
    columns['exact_stop'] = last & rows.exact_stop[-1]
    columns['program_stop'] = np.where(last, rows.program_stop[-1], GO_ON)
    return Blocks(**columns)


def _gcode(blocks: Blocks, transform: Transform) -> Converted:
    five_axis = transform.five_axis
    rotary = _rotary_words(blocks, five_axis) if transform.machine.has_rotary else None
    notes = []
    other = blocks.orientation_tolerance != blocks.contour_tolerance
    if rotary is not None and other.any():
        notes.append('G64 P holds the contour tolerance only; the orientation tolerance differs')
    moves = (
        WrittenMove(
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
    return Converted(gcode(moves, tuple(transform.machine.axis_names[3:5]), notes), notes)


def _rotary_words(blocks: Blocks, transform: FiveAxis) -> FloatArray:
    """Return rotary positions, each closest to the previous one, shape (n, 2) [rad]."""
    found = np.empty((len(blocks), 2))
    first, line = (blocks.axis[0], blocks.rotary[0]), int(blocks.line_number[0])
    here, _ = start_positions(transform, *first, np.zeros(2), line)
    found[0] = here
    for i in range(1, len(blocks)):
        axis, words = blocks.axis[i], blocks.rotary[i]
        if np.isfinite(words).all():
            here = words
        elif not np.array_equal(axis, blocks.axis[i - 1]):
            free = here if transform.on_pole(axis) else None
            choices = transform.branches(axis, here, free)
            if not choices:
                raise BlockError(
                    f'machine {transform.machine.name} cannot reach the tool axis; choose another '
                    'machine',
                    int(blocks.line_number[i]),
                )
            here = min(choices, key=lambda pair: float(np.abs(pair - here).sum()))
        found[i] = here
    return found


def _cl(blocks: Blocks, source: str) -> Converted:
    feed = effective_feed(blocks)
    notes = []
    rests = norm(np.diff(blocks.tip, axis=0)) < SAME_POINT
    turning = np.isfinite(blocks.rotary[1:]).all(axis=1) & rests
    if turning.any():
        notes.append('CL data have no rotary words: turns about the resting tip become vectors')
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
        WrittenMove(
            tip=blocks.tip[i],
            axis=blocks.axis[i],
            feedrate=float(feed[i]),
            rapid=bool(blocks.rapid[i]) and i > 0,
            program_stop=int(blocks.program_stop[i]),
            exact_stop=bool(blocks.exact_stop[i]) and i < len(blocks) - 1,
        )
        for i in range(len(blocks))
    )
    return Converted(cl_data(moves, source.rsplit('/', 1)[-1], notes), notes)


def _siemens(
    program: Program, transform: Transform, settings: Settings, tolerance: float
) -> Converted:
    blocks = program.blocks
    segments = segments_of(blocks, transform, settings)
    path = SplineMoves(segments, transform, settings.flank_height, tolerance)
    moves = list(path.moves(blocks))
    notes = [
        f'smooth path in cubic B-splines, within {max(path.deviation, ROUNDING) / UM:.2g} um; '
        f'{len(blocks) - 1} blocks have become {len(moves) - 1}',
        *(path.losses() if np.ptp(blocks.axis, axis=0).max() > SAME_AXIS else ()),
    ]
    if (segments.kind == ROTATION).any() and np.isfinite(segments.rotary).any():
        notes.append('rotations about the resting tip become tool axes; whole turns are lost')
    if blocks.program_stop.any():
        notes.append('M0 and M1 are written as exact stops')
    return Converted(siemens(moves, notes), notes)
