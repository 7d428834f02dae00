"""The proof: every emitted setpoint is checked against limits, tolerances, feed and program.

The proof reads only the plan files. The proof shares code with the planner in three places:
reading the machine file, forward kinematics, and simulating the drives if the error at the tool is
limited. At a corner the smaller tolerance of both blocks applies.
"""

from collections.abc import Sequence
from dataclasses import replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from cnc_interp.core import MM, FloatArray, IntArray, InterpError
from cnc_interp.drives.compensation import compensated_model
from cnc_interp.drives.tool_error import ToolMotion
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.completeness import prove_completeness
from cnc_interp.proof.functions import prove_followed, prove_functions
from cnc_interp.proof.limits_again import limits_of_differences, torques_of
from cnc_interp.proof.order import JOINT_ROOM, order_of
from cnc_interp.proof.overrides import Overrides, scaled
from cnc_interp.proof.own_chain import OwnChain
from cnc_interp.proof.own_errors import in_nominal_axes
from cnc_interp.proof.path_grid import ROUND_TRIP, ROUNDING, prove_grid
from cnc_interp.proof.plan_files import PlanFiles, Stored, held, read_plan, spans
from cnc_interp.proof.program_shapes import REACH, SLACK, ProgramShapes, measure, measure_widely
from cnc_interp.proof.programmed_path import ROW, WINDOW, with_chords
from cnc_interp.proof.verdict import DIFFERENCES, TORQUE, Ledger, Proof

SAME_USE = 1e-6  #: Largest difference of equal uses of limits [-].
LONGEST_BLOCK = 5e-3  #: Default for the longest block that may become part of a curve [m].


def verify_plan(directory: Path, machine: Machine) -> Proof:
    return verify(read_plan(directory), machine)


def verify(plan: PlanFiles, machine: Machine) -> Proof:
    """Check a plan and return the proof; if ``path`` is empty, the grid is not checked."""
    if machine.has_rotary and plan.flank_height <= 0.0:
        why = 'so that the tool axis would not be checked'
        raise InterpError(f'flank_height is 0, {why}; plan again')
    ledger, programmed = Ledger(plan, machine), len(plan.blocks['tip']) - 1
    axes = machine.axis_names
    if plan.position.shape[1] != len(axes):
        count = plan.position.shape[1]
        text = f'the plan has {count} axes, machine {machine.name} has {len(axes)}'
        ledger.fail(f'{text}; check it with the machine that it was planned for')
        return ledger.close()
    overrides = Overrides(plan, machine)
    _prove_limits(ledger, plan, machine)
    _prove_order(ledger, plan)
    _prove_summary(ledger, plan)
    prove_functions(ledger, plan, machine)
    prove_followed(ledger, plan, machine)
    if plan.path:
        prove_grid(ledger, overrides)
    if plan.settings.get('scene') or plan.collision:
        from cnc_interp.proof.clearance import prove_clearance  # loaded with a scene only

        if (motion := prove_clearance(ledger, machine)) is not None:
            from cnc_interp.proof.stock import prove_stock  # loaded with a stock only

            prove_stock(motion, machine.signals)
    commanded, plan = plan, in_nominal_axes(plan, machine)
    ledger.plan = plan = with_chords(plan, machine)
    if ROW in plan.blocks:
        overrides = overrides.in_rows(plan.blocks[ROW])
    program = ProgramShapes.of(plan, machine)
    plan = _prove_sequence(ledger, plan, program)
    _prove_tolerances(ledger, plan, program)
    prove_completeness(ledger, plan, program)
    _prove_feed(ledger, plan, program, overrides)
    _prove_columns(ledger, commanded, machine)
    if plan.path:
        _prove_path(ledger, plan, program)
    return with_tool_error(replace(ledger.close(), blocks=programmed), commanded, machine)


def _prove_limits(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    count, names = len(plan.position), machine.axis_names
    outermost = dict.fromkeys(names, (-np.inf, 0))
    for a, b in spans(count):
        position = held(plan.position, a, b, 3, 3)
        for order, (kind, _) in enumerate(DIFFERENCES, start=1):
            difference = np.abs(np.diff(position, order, axis=0)) / plan.period**order
            # The value of a difference belongs to the middle sample of its stencil.
            first = 3 - (order + 1) // 2
            last = None if b == count else first + b - a
            middle = difference[first:last]
            limit = limits_of_differences(machine, order, position)[first:last]
            for j, name in enumerate(names):
                ledger.judge(kind, middle[:, j], limit[:, j], name, ROUNDING, first=a)
        for j, load in machine.limits.loads.items():
            torque = torques_of(machine, j, position[:, j], plan.period)
            torque = torque[2 : None if b == count else 2 + b - a]
            ledger.judge(TORQUE, torque, load.torque, names[j], ROUNDING, first=a)
        for j, name in enumerate(names):
            lowest, highest = machine.travel[j]
            outside = np.maximum(lowest - position[3:-3, j], position[3:-3, j] - highest)
            at = int(np.argmax(outside))
            outermost[name] = max(outermost[name], (float(outside[at]), a + at), key=itemgetter(0))
    for j, name in enumerate(names):
        (lowest, highest), (beyond, reached) = machine.travel[j], outermost[name]
        axis = machine.axes[j]
        scale, unit = 1.0 / axis.shown_size, axis.shown_unit
        travel = f'its travel of {lowest * scale:.6g} to {highest * scale:.6g} {unit}'
        place = f'(sample {reached}, {reached * plan.period:.3f} s)'
        line = plan.blocks['line'][plan.block[reached]]
        text = f'{name} exceeds {travel} by {beyond * scale:.3g} {unit} in line {line} {place}'
        ledger.require(beyond <= SLACK, text)


def _prove_order(ledger: Ledger, plan: PlanFiles) -> None:
    time, block = plan.setpoints['time'], plan.block
    worst, late = -1.0, 0
    back: list[int] = []
    for a, b in spans(len(time)):
        uneven = np.abs(time[a:b] - time[0] - plan.period * np.arange(a, b))
        at = int(np.argmax(uneven))
        worst, late = max((worst, late), (float(uneven[at]), a + at), key=itemgetter(0))
        if not back:
            back = [a + int(k) for k in np.flatnonzero(np.diff(block[a : b + 1]) < 0)[:1]]
    at_zero = not plan.path or abs(time[0]) <= 1e-6 * plan.period
    ledger.require(at_zero, f'time begins at {time[0]:.9g} s, not at 0')
    ledger.require(
        worst <= 1e-6 * plan.period + 1e-12 * abs(time[-1]),
        f'time is not uniform: sample {late} at {time[late]:.9g} s, period {plan.period:g} s',
    )
    for k in back:
        rows = f'row {block[k]}, then {block[k + 1]}'
        ledger.fail(f'block order runs backwards at sample {k + 1}: {rows}')
    # At the start, rows may be left out if the tool is already at their ends.
    tip, axis, contour, orientation = (
        plan.blocks[name][: max(block[0], 1)]
        for name in ('tip', 'axis', 'contour_tolerance', 'orientation_tolerance')
    )
    top = tip + plan.flank_height * axis
    off, off_top = (np.linalg.norm(points - points[0], axis=1) for points in (tip, top))
    line = plan.blocks['line']
    for row in np.flatnonzero((off > contour + SLACK) | (off_top > orientation + SLACK))[:1]:
        text = f'the motion starts with line {line[block[0]]}'
        ledger.fail(f'{text}, but line {line[row]} comes before it')


def _prove_summary(ledger: Ledger, plan: PlanFiles) -> None:
    time, summary = plan.setpoints['time'], plan.summary
    figures = (
        ('cycle_time', float(time[-1] - time[0]), 1.01 * plan.period),
        ('path_length', float(plan.setpoints['s'][-1]), ROUND_TRIP),
        ('samples', len(time), 0.0),
        ('blocks', len(plan.blocks['tip']) - 1, 0.0),
    )
    for name, found, room in figures:
        stated = summary.get(name, found)
        agrees = isinstance(stated, int | float) and abs(stated - found) <= room
        text = f'summary.json says {name} {stated!r}'
        ledger.require(agrees, f'{text}, the setpoints say {found:.9g}')
    uses = None if plan.cut else summary.get('largest_use')
    ratios = {(f.what, f.axis): f.ratio for f in reversed(ledger.findings)}
    for kind, of_axes in uses.items() if isinstance(uses, dict) else ():
        for axis, stated in of_axes.items() if isinstance(of_axes, dict) else ():
            found = ratios.get((kind, axis), np.nan)
            agrees = isinstance(stated, int | float) and abs(stated - found) <= SAME_USE
            text = f'summary.json says {axis} uses {stated!r} of its {kind}'
            ledger.require(agrees, f'{text}, it uses {found:.6g}')


def _prove_tolerances(ledger: Ledger, plan: PlanFiles, program: ProgramShapes) -> None:
    # The spin that poses give, as an arc length at flank height.
    spin = plan.blocks['extra_axes'][:, len(program.machine.extra_names) :].ravel()
    way = program.path.way
    for a, b in spans(len(plan.position)):
        position, block = plan.position[a:b], plan.block[a:b]
        deviation = measure(program, position, block)
        contour, top = program.tolerances(deviation)
        ledger.judge('contour deviation', deviation.contour, contour, slack=SLACK, first=a)
        ledger.judge('orientation deviation', deviation.orientation, top, slack=SLACK, first=a)
        if program.lines is not None:
            beside = program.lines.improve(deviation, position, block)
            own = plan.blocks['contour_tolerance'][block]
            ledger.judge('axes beside their line', beside * own, own, slack=SLACK, first=a)
        if len(spin) and isinstance(program.transform, OwnChain):
            row, before = deviation.row, np.maximum(deviation.row - 1, 0)
            step, turn = spin[row] - spin[before], 2.0 * np.pi * plan.flank_height
            gap = spin[before] + deviation.part * step
            gap -= plan.flank_height * program.transform.spins(position)
            gap = np.abs(gap - turn * np.round(gap / turn))
            # The nearest place of the program may be a tolerance away from that of the motion.
            rate = np.abs(step) / np.maximum(way[row] - way[before], SLACK)
            ledger.judge('spin', gap, JOINT_ROOM * contour * (1.0 + rate), slack=SLACK, first=a)


def _prove_sequence(ledger: Ledger, plan: PlanFiles, program: ProgramShapes) -> PlanFiles:
    """Check the order of a motion; return the plan with the nearest possible row numbers."""
    contour, orientation = program.contour + SLACK, program.orientation + SLACK
    machine, path = program.machine, program.path
    order = order_of(program, (contour, orientation))
    line, time, blocks = plan.blocks['line'], plan.setpoints['time'], plan.blocks
    for what, sample, reached in order.left:
        text = f'out of order: from sample {sample} on ({time[sample]:.3f} s) the {what} does not'
        ledger.fail(f'{text} follow the program; up to line {line[reached]} it does')
    if order.left:
        return plan
    if plan.cut:
        ledger.known_rows = min(ledger.known_rows, int(order.low[len(time) - 1 :][0]))
    # A segment of a curve covers many rows, but names only the middle row of each of its halves.
    reach, length = REACH * np.maximum(contour, orientation), np.diff(path.way, prepend=0.0)
    possible = Stored.empty(len(time), np.int64)
    wrongs, wrong_at, where = 0, -1, ''
    told = plan.settings.get('longest_block')
    longest = float(told) if isinstance(told, int | float) else LONGEST_BLOCK
    longest *= machine.scale
    for a, b in spans(len(time)):
        row, low, high, position = plan.block[a:b], order.low[a:b], order.high[a:b], plan.position
        early, late = row < low, row > high
        possible[a:b] = np.clip(row, low, np.maximum(low, high))
        beside = np.flatnonzero(early | late)
        if not len(beside):
            continue
        row, low, high, early = row[beside], low[beside], high[beside], early[beside]
        position = position[a:b][beside]
        gap = np.where(
            early, path.way[low - 1] - path.way[row], path.way[row - 1] - path.way[high]
        )
        # The vertex that the motion has passed, or not yet reached.
        vertex = np.where(early, row, np.maximum(row - 1, 0))
        tip, axis = program.transform.forward(position)
        tips, axes = blocks['tip'][vertex], blocks['axis'][vertex]
        off = np.linalg.norm(tip - tips, axis=1)
        off_top = np.linalg.norm(tip - tips + plan.flank_height * (axis - axes), axis=1)
        gap = np.maximum(gap, np.maximum(off, off_top))
        if machine.has_rotary:
            turn = np.abs(position[:, 3:5] - blocks['rotary'][vertex]).max(axis=1)
            gap = np.fmax(gap, np.where(path.by_axes[row], plan.flank_height * turn, 0.0))
        meant = np.where(early, low, high)
        dense = np.maximum(length[row], length[meant]) <= longest
        dense &= (np.abs(row - meant) <= WINDOW) & ~path.by_axes[row] & ~path.by_axes[meant]
        wrong = np.flatnonzero((gap > reach[row]) & ~dense)
        if len(wrong) and wrong_at < 0:
            first = wrong[0]
            wrong_at = a + int(beside[first])
            where = f'line {line[row[first]]}, but the motion executes line {line[low[first]]}'
        wrongs += len(wrong)
    text = f'wrong row number at sample {wrong_at} ({time[wrong_at]:.3f} s): {where}'
    ledger.require(not wrongs, f'{text}; {wrongs} places in all')
    return replace(plan, setpoints={**plan.setpoints, 'block': possible})


def _prove_feed(
    ledger: Ledger, plan: PlanFiles, program: ProgramShapes, overrides: Overrides
) -> None:
    lines, contour = program.lines, program.contour
    blocks, period = plan.blocks, plan.period
    duration = np.asarray(blocks['duration'], dtype=float)
    chord = np.linalg.norm(np.diff(blocks['tip'], axis=0, prepend=blocks['tip'][:1]), axis=1)
    timed = np.isfinite(duration) & (duration > 0.0)
    feed = np.where(np.isnan(blocks['feed']), np.inf, blocks['feed'])
    # Rows that do not move at all are left out of the path, and take no time.
    turned = plan.flank_height * np.abs(np.diff(blocks['axis'], axis=0)).max(axis=1)
    turning = 1 + np.flatnonzero(timed[1:] & (chord[1:] < SLACK) & (turned > SLACK))
    if lines is not None:
        turning = turning[~lines.linear[turning]]
        length = np.linalg.norm(lines.step * lines.scale, axis=1)
        chord = np.where(lines.linear, length, chord)
    feed[timed] = chord[timed] / duration[timed]
    feed[np.asarray(blocks['rapid'], dtype=bool) | (chord < SLACK)] = np.inf
    feed[0] = feed[1]
    spent = np.zeros(len(feed))
    programmed = feed
    for a, b, share in overrides.spans(len(plan.position)):
        feed = scaled(programmed, share)
        position, block = plan.position[a : b + 1], plan.block[a : b + 1]
        tip = program.transform.forward(position)[0]
        if len(turning):
            spent += np.bincount(block[: b - a], minlength=len(feed)) * share
        speed = np.linalg.norm(np.diff(tip, axis=0), axis=1) / period
        before, after = np.sort(np.stack([block[:-1], block[1:]]), axis=0)
        if lines is not None:
            along = lines.speeds(position, tip, before, period)
            # Where the tip moves alone, one corner may be in coordinates, the other in poses.
            known = lines.known[before] | lines.known[after]
            speed = np.where(known, np.minimum(speed, along), speed)
            speed = np.where(lines.linear[before] | lines.linear[after], along, speed)
        allowed = _highest(feed, before, after)
        for i in np.flatnonzero(speed > allowed * ROUNDING):
            near = speed[i] * period + contour[before[i]]
            for vertex, row in ((before[i] - 1, before[i] - 1), (after[i], after[i] + 1)):
                if not 0 < row < len(feed):
                    continue
                ends = position[i : i + 2], tip[i : i + 2]
                gap = np.linalg.norm(ends[1] - blocks['tip'][vertex], axis=1)
                beside = slice(vertex, vertex + 2)
                if lines is not None and lines.known[vertex] and lines.linear[beside].any():
                    gap = lines.gaps(*ends, vertex)  # a turning head may swing the tip
                if gap.min() <= near:
                    allowed[i] = max(allowed[i], feed[row])
        speed = np.where(np.isfinite(allowed), speed, 0.0)
        ledger.judge('tip feed', speed, allowed, allowed=ROUNDING, slack=SLACK, first=a)
    if len(turning):
        shortest = duration[turning] / ROUNDING - 2.0 * period * max(overrides.largest, 1.0)
        allowed = np.maximum(spent[turning] * period, 1e-12)
        ledger.judge('rotation time', shortest, allowed, rows=turning)


def _highest(values: FloatArray, first: IntArray, last: IntArray) -> FloatArray:
    if not len(first):
        return np.zeros(0)
    low = int(first.min())
    some = np.append(values[low : int(last.max()) + 1], -np.inf)
    ends = np.stack([first - low, last - low + 1], axis=1).ravel()
    return np.asarray(np.maximum.reduceat(some, ends)[::2])


def _prove_columns(ledger: Ledger, plan: PlanFiles, machine: Machine) -> None:
    for a, b in spans(len(plan.position)):
        position = held(plan.position, a, b, 1, 1)
        central = (position[2:] - position[:-2]) / (2.0 * plan.period)
        second = np.diff(position, 2, axis=0) / plan.period**2
        # With jerk J, a velocity differs from its mean by J T^2 / 6, an acceleration by J T / 3.
        for name, mean, room in (
            ('velocity', central, plan.period**2 / 2.0),
            ('acceleration', second, plan.period),
        ):
            allowed = machine.max_jerk * room * ROUNDING
            gap = np.abs(plan.setpoints[name][a:b] - mean)
            for j, axis in enumerate(machine.axis_names):
                ledger.check(f'{name} column', gap[:, j], float(allowed[j]), axis, first=a)


def _prove_path(ledger: Ledger, plan: PlanFiles, program: ProgramShapes) -> None:
    for a, b in spans(len(plan.path['block'])):
        rows, q = plan.path['block'][a:b], plan.path['q'][a:b]
        tip, axis = program.transform.forward(q)
        deviation = measure_widely(program, tip, axis, rows, q)
        contour, _ = program.tolerances(deviation)
        ledger.judge(
            'contour deviation of path', deviation.contour, contour, slack=SLACK, rows=rows
        )


def with_beside(
    proof: Proof, machine: Machine, period: float, stretches: Sequence[FloatArray]
) -> Proof:
    """Add limits and travel of motion outside the program to a proof; ``stretches``: (K, n)."""
    if not stretches:
        return proof
    largest, faults = 0.0, []
    for k, q in enumerate(stretches, start=1):
        held = np.pad(q, ((3, 3), (0, 0)), mode='edge')
        uses = {}
        for order, (kind, _) in enumerate(DIFFERENCES, start=1):
            difference = np.abs(np.diff(held, order, axis=0)) / period**order
            use = (difference / limits_of_differences(machine, order, held)).max(axis=0)
            uses.update({(kind, j): float(share) for j, share in enumerate(use)})
        for j, load in machine.limits.loads.items():
            torque = torques_of(machine, j, held[:, j], period)
            uses[TORQUE, j] = float(torque.max()) / load.torque
        largest = max(largest, *uses.values())
        faults += [
            f'{kind} of {machine.axis_names[j]} uses {share:.2%} of its limit outside the program '
            f'(motion {k})'
            for (kind, j), share in uses.items()
            if not share <= ROUNDING
        ]
        beyond = np.maximum(machine.travel[:, 0] - q, q - machine.travel[:, 1]).max(axis=0)
        faults += [
            f'{name} exceeds its travel outside the program (motion {k})'
            for name, outside in zip(machine.axis_names, beyond, strict=True)
            if not outside <= SLACK
        ]
    count = sum(map(len, stretches))
    line = f'beside program {count} samples (approach, motion by hand), largest use {largest:.2%}'
    told = '\n'.join(text for text in (line, proof.beside) if text)
    return replace(proof, failures=(*proof.failures, *faults), beside=told)


def with_tool_error(proof: Proof, plan: PlanFiles, machine: Machine) -> Proof:
    told = plan.settings
    if told.get('tool_error') is None:
        return proof
    name, limit, height = told.get('compensation'), told['tool_error'], plan.flank_height
    model = compensated_model(name, machine) if name else None
    motion = ToolMotion(machine, plan.period, plan.position[0], model)
    velocity, tip, axis = plan.setpoints['velocity'], 0.0, 0.0
    for error in (
        *(motion.push(plan.position[a:b], velocity[a:b]) for a, b in spans(len(plan.position))),
        motion.settle(),
    ):
        tip, axis = max(tip, error.tip.max()), max(axis, error.axis.max() * height)
    line = (
        f'error at the tool by the drives of {machine.name}'
        f'{f", compensated by {name}" if name else ""}: tip {tip / MM:.4f} mm, axis '
        f'{axis / MM:.4f} mm at {height / MM:g} mm, limit {limit / MM:g} mm'
    )
    fault = () if max(tip, axis) <= ROUNDING * limit else (f'{line}: exceeded',)
    return replace(proof, failures=(*proof.failures, *fault), beside=line)
