"""Which limit holds the motion, on which lines, and what that costs."""

from dataclasses import dataclass

import numpy as np

from cnc_interp.core import BoolArray, FloatArray
from cnc_interp.report.html import section, table
from cnc_interp.report.series import KINDS, Series

AT_LIMIT = 0.98  #: A limit is reached from this share on [-].
NEAR_LIMIT = 0.9  #: An error of the drives, which is planned by a model, from this share on [-].
LISTED = 12
NO_LIMIT = 'between limits'


def at_limits(use: FloatArray, axis_names: tuple[str, ...]) -> dict[str, BoolArray]:
    """Tell when each axis is at each of its limits; ``use`` (3, K, n_axes) of ``axis_use``."""
    return {
        f'{axis} {kind}': np.abs(use[k, :, j]) > AT_LIMIT
        for k, kind in enumerate(KINDS)
        for j, axis in enumerate(axis_names)
    }


@dataclass(frozen=True)
class TimeLost:
    """Time beyond that at the programmed feed; rapids lose none."""

    total: float  #: Of the whole motion [s].
    #: By limit: time at it, and the part of the lost time then [s]. What several limits hold
    #: together is shared by them.
    by_limit: dict[str, tuple[float, float]]
    #: By line: time on it, lost time, least feed [mm/min], and the limit that costs most there.
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
        f'Lost are {found.total:.3f} s: what the motion takes beyond its path at the programmed '
        'feed. Left, the limits that hold it then; what several hold together is shared. Right, '
        'the lines that lose most.',
        f'<div class="pair">{both}</div>',
    )
