"""The values that a report draws, in shop units, and the limits that slow the motion down."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from cnc_interp.core import MM, MM_PER_MIN, UM, BoolArray, FloatArray, IntArray
from cnc_interp.core.axis_limits import Limits
from cnc_interp.drives.tool_error import ToolError, tool_error
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.own_errors import in_nominal_axes
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.program_shapes import ProgramShapes, measure
from cnc_interp.proof.programmed_path import with_chords
from cnc_interp.report.html import section, table
from cnc_interp.run.setpoints import BEFORE, limit_shares, torque_shares

KINDS = ('velocity', 'acceleration', 'jerk')


@dataclass(frozen=True)
class Series:
    """The values to draw, one row per setpoint unless stated otherwise."""

    time: FloatArray  #: (K,): Time [s].
    way: FloatArray  #: (K,): Path length [mm].
    tip: FloatArray  #: (K, 3): Tool tip [mm].
    axis: FloatArray  #: (K, 3): Tool axis [-].
    #: (K,): Speed along the path, programmed feed, and the limit of Eq. 10 [mm/min].
    feed: FloatArray
    programmed_feed: FloatArray
    feed_limit: FloatArray
    #: (3, K, n_axes): Velocity, acceleration and jerk over their limits, signed [-].
    axis_use: FloatArray
    #: (3, K, n_axes): These limits at the positions of the axes [mm or deg, per s, s2, s3].
    axis_limits: FloatArray
    #: (K,): Torque over the largest torque [-], for axes with such a limit.
    torque_use: dict[int, FloatArray]
    largest_torque: dict[int, float]  #: Largest torques, by axis number [N or Nm].
    #: Names, and ``mm`` or ``deg``.
    axis_names: tuple[str, ...]
    axis_units: tuple[str, ...]
    #: (K,): Deviation of the tip and of the point at flank height [um].
    contour_error: FloatArray
    orientation_error: FloatArray
    #: (K,): Tolerances for these deviations [um].
    contour_tolerance: FloatArray
    orientation_tolerance: FloatArray
    line: IntArray  #: (K,): Line of the part program.
    vertices: FloatArray  #: (M, 3): Programmed tool tips [mm].
    flank_height: float  #: Height above the tip at which the orientation error is measured [mm].
    switched: dict[int, str]  #: Texts of functions, by setpoint number.


def series_of(plan: PlanFiles, machine: Machine) -> Series:
    plan = with_chords(plan, machine).in_memory()
    program = ProgramShapes.of(plan, machine)
    position = in_nominal_axes(plan, machine).position[:]
    tip, axis = program.transform.forward(position)
    deviation = measure(program, position, plan.block)
    contour, orientation = program.tolerances(deviation)
    s: FloatArray = plan.setpoints['s']
    grid: FloatArray = plan.path['s']
    limits = machine.limits.along(plan.position)
    shown = np.array([one.shown_size for one in machine.axes])
    cell: IntArray = np.clip(np.searchsorted(grid, s, 'right') - 1, 0, len(grid) - 2)
    return Series(
        time=plan.setpoints['time'],
        way=s / MM,
        tip=tip / MM,
        axis=axis,
        feed=np.abs(np.gradient(s, plan.period)) / MM_PER_MIN,
        programmed_feed=np.asarray(plan.path['programmed_feed'][cell], float) / MM_PER_MIN,
        feed_limit=_between(plan.path['feed_limit'], grid, cell, s) / MM_PER_MIN,
        axis_use=axis_use(plan, machine.limits),
        axis_limits=np.broadcast_to(limits / shown, (3, len(s), len(shown))),
        torque_use=torque_use(plan, machine),
        largest_torque={j: load.torque for j, load in machine.limits.loads.items()},
        axis_names=machine.axis_names,
        axis_units=tuple(one.shown_unit for one in machine.axes),
        contour_error=deviation.contour / UM,
        orientation_error=deviation.orientation / UM,
        contour_tolerance=contour / UM,
        orientation_tolerance=orientation / UM,
        line=np.asarray(plan.blocks['line'], dtype=np.int64)[plan.block],
        vertices=plan.blocks['tip'] / MM,
        flank_height=plan.flank_height / MM,
        switched=switched(plan, machine),
    )


def switched(plan: PlanFiles, machine: Machine) -> dict[int, str]:
    found, signals = plan.functions, machine.signals
    texts: dict[int, str] = {}
    acts = zip(found['sample'].tolist(), found['step'].tolist(), found['value'], strict=True)
    for sample, step, value in acts:
        text = signals.text(signals.steps[step].output, float(value))
        at = min(sample, len(plan.block) - 1)
        texts[at] = f'{texts[at]}<br>{text}' if at in texts else text
    return texts


def axis_use(plan: PlanFiles, limits: Limits) -> FloatArray:
    held = np.pad(plan.position, ((BEFORE, 1), (0, 0)), mode='edge')
    shares = limit_shares(held, limits, plan.period)
    # Velocity belongs to its later sample, acceleration and jerk to the sample before that.
    return np.stack([shares[0, :-1], shares[1, 1:], shares[2, 1:]])


def torque_use(plan: PlanFiles, machine: Machine) -> dict[int, FloatArray]:
    held = np.pad(plan.position, ((BEFORE, 1), (0, 0)), mode='edge')
    shares = torque_shares(held, machine.limits, plan.period)[1:]
    return {axis: shares[:, axis] for axis in machine.limits.loads}


def tool_errors(plan: PlanFiles, machine: Machine) -> tuple[ToolError, ToolError]:
    position, velocity = np.asarray(plan.position), np.asarray(plan.setpoints['velocity'])
    plain, compensated = (
        tool_error(machine, plan.period, position, velocity, model) for model in (None, machine)
    )
    return plain, compensated


def tool_error_use(plan: PlanFiles, errors: tuple[ToolError, ToolError]) -> FloatArray | None:
    """Return the error at the tool over the planned limit, (K,); None without a limit."""
    asked: Any = plan.summary.get('tool_error')
    if not asked:
        return None
    settings: Any = plan.summary.get('settings', {})
    error = errors[settings.get('compensation') is not None]
    largest = np.maximum(error.tip, error.axis * plan.flank_height) / asked['limit']
    return largest[: len(plan.position)]


def _between(column: FloatArray, grid: FloatArray, cell: IntArray, s: FloatArray) -> FloatArray:
    """Interpolate a column of the grid at s, shape (K,); infinite values stay infinite."""
    part = np.clip((s - grid[cell]) / (grid[cell + 1] - grid[cell]), 0.0, 1.0)
    left, right = np.asarray(column[cell], float), np.asarray(column[cell + 1], float)
    finite = np.isfinite(left) & np.isfinite(right)
    with np.errstate(invalid='ignore'):
        inner = left + part * (right - left)
    return np.where(finite, inner, np.where(part < 0.5, left, right))


def extremes(values: FloatArray, buckets: int) -> IntArray:
    """Choose rows that preserve a curve: the first row, minima and maxima of each bucket."""
    table = values.reshape(len(values), -1)
    count = len(table)
    if count <= buckets * (1 + 2 * table.shape[1]):
        return np.arange(count)
    size = -(-count // buckets)
    padded = np.pad(table, ((0, -count % size), (0, 0)), mode='edge')
    padded = padded.reshape(-1, size, table.shape[1])
    start = np.arange(len(padded)) * size
    kept = [start, np.array([count - 1])]
    for column in range(table.shape[1]):
        kept.append(start + np.argmin(padded[:, :, column], axis=1))
        kept.append(start + np.argmax(padded[:, :, column], axis=1))
    rows: IntArray = np.unique(np.minimum(np.concatenate(kept), count - 1))
    return rows


AT_LIMIT = 0.98  #: A limit counts as reached at this use and above [-].
#: The limit on the error of the drives counts as reached at this use and above, because a model
#: predicts the error [-].
NEAR_LIMIT = 0.9
LISTED = 12
NO_LIMIT = 'between limits'


def at_limits(use: FloatArray, axis_names: tuple[str, ...]) -> dict[str, BoolArray]:
    """Return when each axis is at each of its limits; ``use`` (3, K, n_axes) of ``axis_use``."""
    return {
        f'{axis} {kind}': np.abs(use[k, :, j]) > AT_LIMIT
        for k, kind in enumerate(KINDS)
        for j, axis in enumerate(axis_names)
    }


@dataclass(frozen=True)
class TimeLost:
    """Time lost compared with the programmed feed; rapids lose none."""

    total: float  #: Time lost in the whole motion [s].
    #: For each limit: time at it, and the time lost then [s]. Several limits at once share the
    #: lost time.
    by_limit: dict[str, tuple[float, float]]
    #: For each line: time on it, lost time, least feed [mm/min], and the limit that costs most.
    by_line: dict[int, tuple[float, float, float, str]]


def time_lost(series: Series, tool_error: FloatArray | None = None) -> TimeLost:
    """Attribute lost time to limits and lines; ``tool_error`` (K,) is over its limit [-]."""
    step = np.gradient(series.time) if len(series.time) > 1 else np.zeros(1)
    with np.errstate(divide='ignore'):
        share = 1.0 - series.feed / series.programmed_feed
    lost = step * np.clip(np.nan_to_num(share), 0.0, 1.0)
    lost[~np.isfinite(series.programmed_feed)] = 0.0
    holds = at_limits(series.axis_use, series.axis_names) | {
        f'{series.axis_names[j]} torque': np.abs(use) > AT_LIMIT
        for j, use in series.torque_use.items()
    }
    if tool_error is not None:
        holds['error at the tool'] = tool_error > NEAR_LIMIT
    holds['programmed feed'] = series.feed > AT_LIMIT * series.programmed_feed
    together = np.sum(list(holds.values()), axis=0)
    holds[NO_LIMIT] = together == 0
    costs = {name: lost * held / np.maximum(together, 1) for name, held in holds.items()}
    lines, row = np.unique(series.line, return_inverse=True)
    on_line = {name: np.bincount(row, cost) for name, cost in costs.items()}
    names, spent, gone = list(costs), np.bincount(row, step), np.bincount(row, lost)
    least = np.full(len(lines), np.inf)
    np.minimum.at(least, row, series.feed)
    worst = np.argmax(np.stack(list(on_line.values())), axis=0)
    return TimeLost(
        total=float(lost.sum()),
        by_limit={
            name: (float(step[held].sum()), float(costs[name].sum()))
            for name, held in holds.items()
        },
        by_line={
            int(line): (float(spent[i]), float(gone[i]), float(least[i]), names[worst[i]])
            for i, line in enumerate(lines)
        },
    )


def time_section(series: Series, tool_error: FloatArray | None = None) -> str:
    found = time_lost(series, tool_error)
    limits = sorted(found.by_limit.items(), key=lambda item: -item[1][1])
    rows = [(name, f'{held:.3f}', f'{lost:.3f}') for name, (held, lost) in limits if held > 0.0]
    slow = sorted(found.by_line.items(), key=lambda item: -item[1][1])[:LISTED]
    lines = [
        (str(line), f'{spent:.3f}', f'{lost:.3f}', f'{feed:,.0f}', name)
        for line, (spent, lost, feed, name) in slow
        if lost > 0.0
    ]
    both = table(('at the limit', 'time, s', 'lost, s'), rows) + table(
        ('line', 'time, s', 'lost, s', 'least feed, mm/min', 'mostly at'), lines
    )
    return section(
        'Where the time goes',
        f'The motion takes {found.total:.3f} s longer than its path at the programmed feed. The '
        'left table names the limits that cause this; limits that act together share the time. '
        'The right table names the lines that lose most.',
        f'<div class="pair">{both}</div>',
    )
