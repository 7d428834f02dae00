"""
The proof: every emitted setpoint is checked against limits, tolerances, feed and program.

It starts from the plan files alone. The only code shared with the planner is the forward
kinematics of the machine.

- Limits: first, second and third differences of the positions at the interpolation period. The
  axes are at rest before the first and after the last sample.
- Tolerances: distance of the tip and of the point at flank height from the programmed lines and
  great circles. At a corner, the smaller tolerance of its two blocks counts.
  Where the rotary axes run linearly, the axes are compared with their lines, too.
- Order: the motion follows the program from vertex to vertex, none left out, none twice
  (``order.py``).
- Completeness: the motion passes every programmed vertex within the tolerance, and every axis with
  a word passes it on its own branch and turn.

- The planner's path and the figures of the summary agree with the setpoints (``path_grid.py``).

Native splines are first replaced by chords (``programmed_splines.py``).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from cnc_interp.core.arrays import FloatArray, IntArray
from cnc_interp.core.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.program.blocks import POSES
from cnc_interp.proof.order import order_of
from cnc_interp.proof.path_grid import ROUND_TRIP, ROUNDING, prove_grid
from cnc_interp.proof.plan_files import PlanFiles, read_plan, with_override
from cnc_interp.proof.programmed_axes import ProgrammedAxes
from cnc_interp.proof.programmed_path import (
    WINDOW,
    Deviation,
    ProgrammedPath,
    distances_to_vertices,
)
from cnc_interp.proof.programmed_splines import with_chords
from cnc_interp.proof.verdict import DIFFERENCES, Ledger, Proof

# Uses of limits agree when they differ by less [-].
SAME_USE = 1e-6
# Distances below this are zero [m].
SLACK = 1e-9
# Largest accepted distance between an exact stop and its vertex [m].
STOP_DISTANCE = 1e-6
# A search is widened by this number of tolerances where blocks are tiny. There one path segment
# covers many rows, but each of its halves names one row: the middle one, or the first or last row
# of a curve. A half is 50 tolerances long at most, counted as the root mean square of tip and
# point at flank height. Way of the tip plus rotation at flank height is up to sqrt(8) times that.
REACH = 142.0
# Where the plan does not say which blocks may become curves: those up to this length [m].
LONGEST_BLOCK = 5e-3
# Rotary words are met within this at an exact stop [rad].
STOP_ANGLE = 1e-6
# At the pole the tool axis does not show a turn; nearer than this number of orientation tolerances
# the outer rotary axis is held to its word as if the tool were so far away.
POLE_TOLERANCES = 4.0


def verify_plan(directory: Path, machine: Machine) -> Proof:
    """
    Check the plan files of a directory.

    Parameters
    ----------
    directory : Path
        Directory written by ``cnc-interp plan``.
    machine : Machine
        Machine with the limits and the forward kinematics to use.

    Returns
    -------
    Proof
        Largest use of every limit, and all failures.

    Raises
    ------
    InterpError
        If the files cannot be read.

    """
    return verify(read_plan(directory), machine)


def verify(plan: PlanFiles, machine: Machine) -> Proof:
    """
    Check a plan in memory.

    Parameters
    ----------
    plan : PlanFiles
        Setpoints and program. With an empty ``path``, the grid of the planner is not checked.
    machine : Machine
        Machine with the limits and the forward kinematics to use.

    Returns
    -------
    Proof
        Largest use of every limit, and all failures.

    Raises
    ------
    InterpError
        If the flank height is 0 on a machine with rotary axes.

    """
    if machine.has_rotary and plan.flank_height <= 0.0:
        raise InterpError(
            'flank_height is 0, so that the tool axis would not be checked; plan again'
        )
    plan = with_override(plan)
    ledger, programmed = Ledger(plan, machine), len(plan.blocks['tip']) - 1
    axes = machine.axis_names
    if plan.position.shape[1] != len(axes):
        count = plan.position.shape[1]
        ledger.failures.append(
            f'the plan has {count} axes, machine {machine.name} has {len(axes)}; '
            'check it with the machine that it was planned for'
        )
        return ledger.close()
    tip, axis = Transform.of(machine).forward(plan.position)
    _prove_limits(ledger, plan, machine)
    _prove_order(ledger, plan)
    _prove_summary(ledger, plan)
    if plan.path:
        prove_grid(ledger, plan, machine)
    ledger.plan = plan = with_chords(plan, machine)
    lines = ProgrammedAxes.of(plan, machine)
    plan = _prove_sequence(ledger, plan, machine, tip, axis, lines)
    deviation = measure(plan, machine, tip, axis)
    _prove_tolerances(ledger, plan, deviation)
    if lines is not None:
        beside = lines.improve(deviation, plan.position, plan.block)
        contour = plan.blocks['contour_tolerance'][plan.block]
        ledger.judge('axes beside their line', beside * contour, contour, slack=SLACK)
    _prove_completeness(ledger, plan, machine, tip, axis)
    _prove_feed(ledger, plan, tip, lines)
    _prove_columns(ledger, plan, machine)
    if plan.path:
        _prove_path(ledger, plan, machine)
    return replace(ledger.close(), blocks=programmed)


def _prove_limits(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Judge the travel of the axes, and their differences with both ends at rest."""
    held = np.pad(plan.position, ((3, 3), (0, 0)), mode='edge')
    orders = zip(DIFFERENCES, machine.limits, strict=True)
    for order, ((kind, _), limit) in enumerate(orders, start=1):
        difference = np.abs(np.diff(held, order, axis=0)) / plan.period**order
        # The value of a difference belongs to the middle sample of its stencil.
        middle = difference[3 - (order + 1) // 2 :]
        for j, name in enumerate(machine.axis_names):
            ledger.judge(kind, middle[:, j], float(limit[j]), name, ROUNDING)
    for j, name in enumerate(machine.axis_names):
        lowest, highest = machine.travel[j]
        if np.isinf(lowest) and np.isinf(highest):
            continue
        outside = np.maximum(lowest - plan.position[:, j], plan.position[:, j] - highest)
        beyond, reached = float(outside.max()), int(np.argmax(outside))
        axis = machine.axes[j]
        scale, unit = 1.0 / axis.shown_size, axis.shown_unit
        ledger.require(
            beyond <= SLACK,
            f'{name} exceeds its travel of {lowest * scale:.6g} to {highest * scale:.6g} {unit} '
            f'by {beyond * scale:.3g} {unit} in line {plan.blocks["line"][plan.block[reached]]} '
            f'(sample {reached}, {reached * plan.period:.3f} s)',
        )


def _first(numbers: IntArray) -> int:
    """Return the first number as an int for a message, or -1 if there is none."""
    return int(numbers[0]) if len(numbers) else -1


def _prove_order(ledger: Ledger, plan: PlanFiles) -> None:
    """Check that time is uniform, that blocks are in order and that the first ones are there."""
    time, block = plan.setpoints['time'], plan.block
    uneven = np.abs(time - time[0] - plan.period * np.arange(len(time)))
    at = int(np.argmax(uneven))
    ledger.require(
        uneven[at] <= 1e-6 * plan.period + 1e-12 * abs(time[-1]),
        f'time is not uniform: sample {at} at {time[at]:.9g} s, period {plan.period:g} s',
    )
    back = np.flatnonzero(np.diff(block) < 0)
    ledger.require(
        not len(back),
        f'block order runs backwards at sample {_first(back + 1)}: '
        f'row {_first(block[back])}, then {_first(block[back + 1])}',
    )
    # Rows may be left out at the start if the tool is already at their end (repeated points, first
    # control points). Completeness checks their vertices with all others.
    tip, axis, contour, orientation = (
        plan.blocks[name][: max(block[0], 1)]
        for name in ('tip', 'axis', 'contour_tolerance', 'orientation_tolerance')
    )
    top = tip + plan.flank_height * axis
    off, off_top = (np.linalg.norm(points - points[0], axis=1) for points in (tip, top))
    away = np.flatnonzero((off > contour + SLACK) | (off_top > orientation + SLACK))
    ledger.require(
        not len(away),
        f'the motion starts with line {plan.blocks["line"][block[0]]}, '
        f'but line {_first(plan.blocks["line"][away])} comes before it',
    )


def _prove_summary(ledger: Ledger, plan: PlanFiles) -> None:
    """Compare figures of `summary.json` with the setpoints."""
    time, summary = plan.setpoints['time'], plan.summary
    figures = (
        ('cycle_time', float(time[-1] - time[0]), 1.01 * plan.period),
        ('path_length', float(plan.setpoints['s'][-1]), ROUND_TRIP),
        ('samples', len(time), 0.0),
        ('blocks', len(plan.blocks['tip']) - 1, 0.0),
    )
    for name, found, room in figures:
        stated = summary.get(name, found)
        ledger.require(
            isinstance(stated, int | float) and abs(stated - found) <= room,
            f'summary.json says {name} {stated!r}, the setpoints say {found:.9g}',
        )
    uses = summary.get('largest_use')
    for kind, of_axes in uses.items() if isinstance(uses, dict) else ():
        for axis, stated in of_axes.items() if isinstance(of_axes, dict) else ():
            found = next(
                (f.ratio for f in ledger.findings if (f.what, f.axis) == (kind, axis)), np.nan
            )
            ledger.require(
                isinstance(stated, int | float) and abs(stated - found) <= SAME_USE,
                f'summary.json says {axis} uses {stated!r} of its {kind}, it uses {found:.6g}',
            )


def measure(plan: PlanFiles, machine: Machine, tip: FloatArray, axis: FloatArray) -> Deviation:
    """
    Measure poses of the plan against its program.

    Parameters
    ----------
    plan : PlanFiles
        Program, and the axis positions of the K setpoints.
    machine : Machine
        Machine with the forward kinematics to use.
    tip, axis : ndarray, shape (K, 3)
        Tool tip [m] and unit tool axis [-] of the setpoints.

    Returns
    -------
    Deviation
        Distances of the setpoints from the program.

    """
    program = _program_of(plan)
    result = _measure_widely(
        program, plan, tip, axis, plan.block, plan.position, ProgrammedAxes.of(plan, machine)
    )
    ruled = program.by_axes[plan.block] & (plan.blocks['interpolation'][plan.block] == POSES)
    if ruled.any():
        # Here the rotary axes move linearly: compare with their position at the same part of it.
        row, position = plan.block[ruled], plan.position[ruled].copy()
        rotary = plan.blocks['rotary']
        first, way = rotary[row - 1], rotary[row] - rotary[row - 1]
        share = np.sum((position[:, 3:5] - first) * way, axis=1)
        share = np.clip(share / np.maximum(np.sum(way**2, axis=1), 1e-300), 0.0, 1.0)
        position[:, 3:5] = first + share[:, None] * way
        turned = Transform.of(machine).forward(position)[1]
        gap = tip[ruled] - plan.blocks['tip'][row] + plan.flank_height * (axis[ruled] - turned)
        distance = np.linalg.norm(gap, axis=1)
        result.orientation[ruled] = np.minimum(result.orientation[ruled], distance)
        result.twist[ruled] = np.minimum(result.twist[ruled], distance)
    return result


def _measure_widely(
    program: ProgrammedPath,
    plan: PlanFiles,
    tip: FloatArray,
    axis: FloatArray,
    block: IntArray,
    position: FloatArray,
    lines: ProgrammedAxes | None,
) -> Deviation:
    """Measure near the executed row; where the result exceeds a tolerance, search more rows."""
    result = program.deviation(tip, axis, block)
    if lines is not None:
        lines.improve(result, position, block)
    contour, top = corner_tolerances(plan, result)
    far = (result.contour > contour + SLACK) | (result.orientation > top + SLACK)
    if far.any():
        reach = REACH * np.maximum(contour, top)[far]
        wide = program.deviation(tip[far], axis[far], block[far], reach)
        nearer = wide.contour <= result.contour[far]
        for name in ('contour', 'row', 'part', 'twist'):
            getattr(result, name)[far] = np.where(
                nearer, getattr(wide, name), getattr(result, name)[far]
            )
        result.orientation[far] = np.minimum(result.orientation[far], wide.orientation)
    return result


def _program_of(plan: PlanFiles) -> ProgrammedPath:
    """Build the programmed path of a plan from its blocks."""
    blocks = plan.blocks
    linear = blocks['interpolation'] != POSES
    return ProgrammedPath.of(
        blocks['tip'], blocks['axis'], blocks['rotary'], plan.flank_height, linear
    )


def vertex_tolerances(plan: PlanFiles) -> tuple[FloatArray, FloatArray]:
    """
    Return the tolerances at the program vertices: the smaller one of both adjacent blocks.

    Parameters
    ----------
    plan : PlanFiles
        Plan with M program rows.

    Returns
    -------
    contour, orientation : ndarray, shape (M,)
        Tolerances [m].

    """
    both = []
    for name in ('contour_tolerance', 'orientation_tolerance'):
        own = np.array(plan.blocks[name], dtype=float)
        own[0] = own[1]
        both.append(np.minimum(own, np.r_[own[1:], own[-1]]))
    return both[0], both[1]


def corner_tolerances(plan: PlanFiles, deviation: Deviation) -> tuple[FloatArray, FloatArray]:
    """
    Return the tolerances at the vertex nearest to each pose.

    Parameters
    ----------
    plan : PlanFiles
        Plan with the tolerances of its program rows.
    deviation : Deviation
        Nearest points of K poses.

    Returns
    -------
    contour, orientation : ndarray, shape (K,)
        Tolerances [m].

    """
    contour, top = vertex_tolerances(plan)
    vertex = np.where(deviation.part >= 0.5, deviation.row, np.maximum(deviation.row - 1, 0))
    return contour[vertex], top[vertex]


def _prove_tolerances(ledger: Ledger, plan: PlanFiles, deviation: Deviation) -> None:
    """Judge contour and orientation errors of all samples."""
    contour, top = corner_tolerances(plan, deviation)
    ledger.judge('contour error', deviation.contour, contour, slack=SLACK)
    ledger.judge('orientation error', deviation.orientation, top, slack=SLACK)
    ledger.remarks['largest_twist'] = float(np.max(deviation.twist))


def _prove_completeness(
    ledger: Ledger, plan: PlanFiles, machine: Machine, tip: FloatArray, axis: FloatArray
) -> None:
    """Check that the motion passes every vertex, begins and ends on the program, and stops."""
    blocks, height = plan.blocks, plan.flank_height
    top, vertex_top = tip + height * axis, blocks['tip'] + height * blocks['axis']
    rows = np.arange(len(blocks['tip']))
    contour, orientation = vertex_tolerances(plan)
    nearest, _ = _search_vertices(plan, tip, blocks['tip'], contour)
    ledger.judge('vertex missed by tip', nearest, contour, slack=SLACK, rows=rows)
    nearest_top, where = _search_vertices(plan, top, vertex_top, orientation)
    ledger.judge('vertex missed by top', nearest_top, orientation, slack=SLACK, rows=rows)
    for name, sample, row in (('first', 0, 0), ('last', len(tip) - 1, len(rows) - 1)):
        gap = max(
            float(np.linalg.norm(tip[sample] - blocks['tip'][row])),
            float(np.linalg.norm(top[sample] - vertex_top[row])),
        )
        ledger.require(
            gap <= SLACK,
            f'the motion is {gap * 1e3:.3g} mm away from the {name} pose of the program '
            f'(line {blocks["line"][row]})',
        )
    if machine.has_rotary:
        _prove_rotary_words(ledger, plan, machine, tip, where)
    if machine.extra_names:
        _prove_extra_words(ledger, plan, machine, where)
    stops = np.flatnonzero(blocks['exact_stop'])
    if len(stops):
        ledger.judge('exact stop missed', nearest[stops], STOP_DISTANCE, rows=stops)
        # While an axis passes through rest, it moves less than J T^3 / 3 in one period.
        crawl = machine.max_jerk * plan.period**3 / 3.0
        use = np.r_[np.max(np.abs(np.diff(plan.position, axis=0)) / crawl, axis=1), 0.0]
        slowest = [float(use[max(i - 1, 0) : i + 2].min()) for i in where[stops]]
        moving = stops[np.array(slowest) > ROUNDING]
        ledger.require(
            not len(moving),
            f'no rest at the exact stop of line {_first(blocks["line"][moving])}; '
            f'{len(moving)} stops missed',
        )


def _search_vertices(
    plan: PlanFiles,
    points: FloatArray,
    vertices: FloatArray,
    tolerance: FloatArray,
    unit: FloatArray | None = None,
) -> tuple[FloatArray, IntArray]:
    """
    Search each vertex among the samples of its rows; if it is missed, among more samples.

    The distance counts in ``unit``, shape (M, 3); then the tolerance is 1 of it.
    """
    missed = tolerance + SLACK if unit is None else np.ones(len(vertices))
    label = np.maximum.accumulate(plan.block)
    rows = np.arange(len(vertices))

    def samples(first: IntArray, last: IntArray) -> tuple[IntArray, IntArray]:
        # First and last sample of the rows first ... last, with one sample more on each side.
        low = np.searchsorted(label, first) - 1
        high = np.searchsorted(label, last, 'right')
        return np.clip(low, 0, len(points) - 2), np.clip(high, 1, len(points) - 1)

    # A vertex lies between its own row and the next. Rounding may shift the row of a sample by one
    # more, except at a stop: a tool that turns back has passed the vertex in the row before.
    spread = np.where(plan.blocks['exact_stop'], 0, 1)
    nearest, where = distances_to_vertices(
        points, vertices, *samples(rows - spread, rows + 1 + spread), unit
    )
    far = nearest > missed
    if far.any():
        way = np.cumsum(np.r_[0.0, np.linalg.norm(np.diff(vertices, axis=0), axis=1)])
        reach = REACH * tolerance[far]
        first = np.searchsorted(way, way[far] - reach)
        last = np.searchsorted(way, way[far] + reach, 'right')
        first, last = np.minimum(first, rows[far] - 1), np.maximum(last, rows[far] + 2)
        nearest[far], where[far] = distances_to_vertices(
            points, vertices[far], *samples(first, last), None if unit is None else unit[far]
        )
    return nearest, where


def _prove_sequence(
    ledger: Ledger,
    plan: PlanFiles,
    machine: Machine,
    tip: FloatArray,
    axis: FloatArray,
    lines: ProgrammedAxes | None,
) -> PlanFiles:
    """
    Demand that the motion follows the program in order, and that its row numbers say so.

    Returns the plan with the nearest row number that is possible by order alone, for each sample.
    """
    contour, orientation = (tolerance + SLACK for tolerance in vertex_tolerances(plan))
    program = _program_of(plan)
    order = order_of(plan, machine, tip, axis, program, lines, (contour, orientation))
    line, time = plan.blocks['line'], plan.setpoints['time']
    for what, sample, reached in order.left:
        ledger.require(
            False,
            f'out of order: from sample {sample} on ({time[sample]:.3f} s) the {what} does not '
            f'follow the program, which it followed to line {line[reached]}',
        )
    if order.left:
        return plan
    # A segment of a curve covers many rows, but names only the middle row of each of its halves.
    row, reach = plan.block, REACH * np.maximum(contour, orientation)
    way = np.cumsum(np.linalg.norm(program.chord, axis=1) + plan.flank_height * program.turn)
    early, late = row < order.low, row > order.high
    gap = np.zeros(len(row))
    gap[early] = (way[order.low - 1] - way[row])[early]
    gap[late] = (way[row - 1] - way[order.high])[late]
    # The vertex that the motion has left behind, or not yet reached.
    vertex = np.where(early, row, np.maximum(row - 1, 0))
    tips, axes = plan.blocks['tip'][vertex], plan.blocks['axis'][vertex]
    off = np.linalg.norm(tip - tips, axis=1)
    off_top = np.linalg.norm(tip - tips + plan.flank_height * (axis - axes), axis=1)
    gap = np.maximum(gap, np.maximum(off, off_top))
    if machine.has_rotary:
        turn = np.abs(plan.position[:, 3:5] - plan.blocks['rotary'][vertex]).max(axis=1)
        gap = np.fmax(gap, np.where(program.by_axes[row], plan.flank_height * turn, 0.0))
    length = np.diff(way, prepend=0.0)
    meant = np.where(early, order.low, order.high)
    dense = np.maximum(length[row], length[meant]) <= longest_block(plan)
    dense &= (np.abs(row - meant) <= WINDOW) & ~program.by_axes[row] & ~program.by_axes[meant]
    wrong = (early | late) & (gap > reach[row]) & ~dense
    at = _first(np.flatnonzero(wrong))
    ledger.require(
        not wrong.any(),
        f'wrong row number at sample {at} ({time[at]:.3f} s): line {line[row[at]]}, but the '
        f'motion executes line {line[order.low[at]]}; {np.count_nonzero(wrong)} places in all',
    )
    possible = np.clip(row, order.low, np.maximum(order.low, order.high))
    return replace(plan, setpoints={**plan.setpoints, 'block': possible})


def longest_block(plan: PlanFiles) -> float:
    """Return the length up to which blocks of a plan may become curves [m]."""
    settings = plan.summary.get('settings')
    length = settings.get('longest_block') if isinstance(settings, dict) else None
    return float(length) if isinstance(length, int | float) else LONGEST_BLOCK


def _prove_rotary_words(
    ledger: Ledger, plan: PlanFiles, machine: Machine, tip: FloatArray, where: IntArray
) -> None:
    """
    Check that rotary axes pass their words, each on its own branch and whole turn.

    The samples ``where`` the vertices are passed are replaced where the rotary axes tell better.

    A rounded vertex may turn the tool axis by the tolerances at flank height. So each rotary axis
    may miss its word by this angle over the sine of the angle between itself and the tool axis.
    """
    rotary = np.array(plan.blocks['rotary'], dtype=float)
    rows = np.flatnonzero(np.isfinite(rotary).all(axis=1))
    rows = rows[rows > 0]
    if not len(rows):
        return
    height = max(plan.flank_height, 1e-3)
    contour, orientation = vertex_tolerances(plan)
    words = np.nan_to_num(rotary)
    allowed = np.ones((len(rotary), 3))
    for i in range(2):
        step = np.zeros(2)
        step[i] = 1e-4
        ahead, back = (Transform.of(machine).tool_axis(words + way) for way in (step, -step))
        sine = np.linalg.norm(ahead - back, axis=1) / 2e-4
        least = POLE_TOLERANCES * orientation / height
        allowed[:, i] = (contour + orientation) / height / np.maximum(sine, least)
    by_axes = _program_of(plan).by_axes
    linear = by_axes | np.r_[by_axes[1:], False]
    allowed[linear, :2] = (orientation[linear] / height)[:, None]
    stops = np.asarray(plan.blocks['exact_stop'], dtype=bool).copy()
    stops[-1] = True
    allowed[stops, :2] = np.minimum(allowed[stops, :2], STOP_ANGLE)
    points = np.hstack([plan.position[:, 3:5], np.zeros((len(plan.position), 1))])
    targets = np.hstack([words, np.zeros((len(words), 1))])
    angle = allowed[:, :2].max(axis=1)
    gap, passed = _search_vertices(plan, points, targets, angle, allowed)
    ledger.judge('rotary word missed', gap[rows] * angle[rows], angle[rows], rows=rows)
    # A turn of the tool about its own axis is hardly visible in the workpiece frame, so the
    # nearest sample by tip and tool axis may be any on the way.
    rows = rows[by_axes[rows]]
    on_the_way = np.abs(points[where[rows]] - targets[rows]).max(axis=1) > STOP_ANGLE
    there = np.linalg.norm(tip[passed[rows]] - plan.blocks['tip'][rows], axis=1) <= STOP_DISTANCE
    rows = rows[on_the_way & there]
    where[rows] = passed[rows]


def _prove_extra_words(ledger: Ledger, plan: PlanFiles, machine: Machine, where: IntArray) -> None:
    """
    Demand that extra axes end on their words.

    A word is met between the last sample of its block and the next sample. A rounded vertex may
    miss it by the contour tolerance, as the tip does. Where the tip rests, only these axes show
    where the block ends.
    """
    words = plan.blocks['extra_axes']
    if words.shape[1] != len(machine.extra_names):
        ledger.require(False, f'blocks.npz has no words for the axes {machine.extra_names}')
        return
    rows = np.arange(len(words))
    label = np.maximum.accumulate(plan.block)
    after = np.clip(np.searchsorted(label, rows, 'right'), 1, len(label) - 1)
    contour, _ = vertex_tolerances(plan)
    resting = np.r_[False, np.abs(np.diff(plan.blocks['tip'], axis=0)).max(axis=1) < SLACK]
    for k, name in enumerate(machine.extra_names):
        position = plan.position[:, machine.axis_names.index(name)]
        ends = np.stack([position[after - 1], position[after]])
        gap = np.maximum(words[:, k] - ends.max(axis=0), ends.min(axis=0) - words[:, k])
        gap = np.maximum(gap, 0.0)
        ledger.judge(f'word missed by {name}', gap, contour, slack=SLACK, rows=rows)
        alone = resting & (np.r_[0.0, np.abs(np.diff(words[:, k]))] > SLACK)
        nearer = np.abs(ends - words[:, k]).argmin(axis=0)
        where[alone] = (after - 1 + nearer)[alone]


def _prove_feed(
    ledger: Ledger, plan: PlanFiles, tip: FloatArray, lines: ProgrammedAxes | None
) -> None:
    """
    Judge the tip speed against the feed of the executed block; at a border, of both blocks.

    Where the rotary axes run linearly, the speed along the line counts instead.
    """
    blocks, period = plan.blocks, plan.period
    duration = np.asarray(blocks['duration'], dtype=float)
    chord = np.linalg.norm(np.diff(blocks['tip'], axis=0, prepend=blocks['tip'][:1]), axis=1)
    timed = np.isfinite(duration) & (duration > 0.0)
    feed = np.where(np.isnan(blocks['feed']), np.inf, blocks['feed'])
    turning = 1 + np.flatnonzero(timed[1:] & (chord[1:] < SLACK))
    if lines is not None:
        turning = turning[~lines.linear[turning]]
        chord = np.where(lines.linear, lines.lengths, chord)
    feed[timed] = chord[timed] / duration[timed]
    feed[np.asarray(blocks['rapid'], dtype=bool) | (chord < SLACK)] = np.inf
    feed[0] = feed[1]
    speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) / period
    before, after = np.sort(np.stack([plan.block[:-1], plan.block[1:]]), axis=0)
    if lines is not None:
        along = lines.speeds(plan.position, tip, before, period)
        # In a row whose tip moves alone, one corner may be in coordinates, the other one in poses.
        known = lines.known[before] | lines.known[after]
        speed = np.where(known, np.minimum(speed, along), speed)
        speed = np.where(lines.linear[before] | lines.linear[after], along, speed)
    spans = np.stack([before, after + 1], axis=1).ravel()
    allowed = np.maximum.reduceat(np.r_[feed, -np.inf], spans)[::2]
    contour = vertex_tolerances(plan)[0]
    for i in np.flatnonzero(speed > allowed * ROUNDING):
        near = speed[i] * period + contour[before[i]]
        for vertex, row in ((before[i] - 1, before[i] - 1), (after[i], after[i] + 1)):
            if not 0 < row < len(feed):
                continue
            gap = np.linalg.norm(tip[i : i + 2] - blocks['tip'][vertex], axis=1)
            if gap.min() <= near:
                allowed[i] = max(allowed[i], feed[row])
    finite = np.isfinite(allowed)
    ledger.judge('tip feed', np.where(finite, speed, 0.0), allowed, allowed=ROUNDING, slack=SLACK)
    if len(turning):
        spent = np.bincount(plan.block, minlength=len(feed))[turning] * period
        shortest = duration[turning] / ROUNDING - 2.0 * period
        ledger.judge('rotation time', shortest, np.maximum(spent, 1e-12), rows=turning)


def _prove_columns(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Compare the velocity and acceleration columns with differences of the positions."""
    held = np.pad(plan.position, ((1, 1), (0, 0)), mode='edge')
    central = (held[2:] - held[:-2]) / (2.0 * plan.period)
    second = np.diff(held, 2, axis=0) / plan.period**2
    # With jerk J, a velocity differs from its mean by J T^2 / 6 and an acceleration by J T / 3.
    for name, column, mean, room in (
        ('velocity column', plan.setpoints['velocity'], central, plan.period**2 / 2.0),
        ('acceleration column', plan.setpoints['acceleration'], second, plan.period),
    ):
        allowed = machine.max_jerk * room * ROUNDING
        for j, axis in enumerate(machine.axis_names):
            gap = np.abs(column[:, j] - mean[:, j])
            ledger.check(f'{name}', gap, float(allowed[j]), axis)


def _prove_path(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    """Judge the contour error of the path of the planner."""
    path, rows = plan.path, np.asarray(plan.path['block'], dtype=np.int64)
    tip, axis = Transform.of(machine).forward(path['q'])
    lines = ProgrammedAxes.of(plan, machine)
    deviation = _measure_widely(_program_of(plan), plan, tip, axis, rows, path['q'], lines)
    contour, _ = corner_tolerances(plan, deviation)
    ledger.judge('contour error of path', deviation.contour, contour, slack=SLACK, rows=rows)
