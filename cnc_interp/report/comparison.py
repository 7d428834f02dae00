"""Two runs side by side: tables, and both feeds over path length and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from html import escape
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from cnc_interp.core.units import UM
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.proof.verdict import Proof
from cnc_interp.report.html import (
    AT_PLACE,
    BLUE,
    BUCKETS,
    ORANGE,
    add_curve,
    base_layout,
    drawing,
    feed_ceiling,
    rounded,
    section,
    table,
    with_axes,
)
from cnc_interp.report.series import Series, extremes


@dataclass(frozen=True)
class ExaminedPlan:
    """A plan with its name, its proof and the values to draw."""

    name: str  #: Name shown on the page.
    plan: PlanFiles  #: The plan.
    proof: Proof  #: Its proof.
    series: Series  #: Values to draw.


Figure = Callable[[ExaminedPlan], float]


def comparison_table(first: ExaminedPlan, second: ExaminedPlan) -> str:
    proven = ['yes' if run.proof.ok else 'no' for run in (first, second)]
    lines = [('proven', *proven, '')]
    for label, unit, pattern, figure in rows_of():
        one, two = figure(first), figure(second)
        change = f'{(two / one - 1.0) * 100.0:+.1f} %' if one > 0.0 and two > 0.0 else ''
        change = '=' if change in ('+0.0 %', '-0.0 %') else change
        texts = (f'{x:{pattern}}{unit}' if np.isfinite(x) else '&#8211;' for x in (one, two))
        lines.append((label, *texts, change))
    return table(('', escape(first.name), escape(second.name), 'change'), lines)


def rows_of() -> list[tuple[str, str, str, Figure]]:
    rows: list[tuple[str, str, str, Figure]] = [
        ('cycle time', ' s', '.3f', lambda run: run.proof.cycle_time),
        ('planning time', ' s', '.3g', _planning_time),
        ('path length', ' mm', ',.2f', lambda run: float(np.ptp(run.series.way))),
        ('blocks', '', ',', lambda run: run.proof.blocks),
        ('highest feed', ' mm/min', ',.0f', lambda run: float(run.series.feed.max())),
        ('mean feed', ' mm/min', ',.0f', _mean_feed),
    ]
    for error in ('contour error', 'orientation error'):
        rows.append((f'largest {error}', ' &#181;m', '.4g', partial(_largest, error)))
    return rows


def use_table(first: ExaminedPlan, second: ExaminedPlan) -> str:
    kinds = max(first.proof.kinds, second.proof.kinds, key=len)
    names = dict.fromkeys(first.series.axis_names + second.series.axis_names)
    lines = []
    for axis in names:
        uses = [run.proof.use_of(kind, axis) for kind in kinds for run in (first, second)]
        cells = (f'{x:.1%}' if np.isfinite(x) else '&#8211;' for x in uses)
        lines.append([escape(axis), *cells])
    return table(('largest use', *kinds), lines, span=2)


def comparison_figure(first: ExaminedPlan, second: ExaminedPlan) -> Any:
    """Draw both feeds over path length and over time."""
    figure = make_subplots(rows=2, cols=1, vertical_spacing=0.16)
    runs = ((first, {'color': BLUE, 'width': 1.6}), (second, {'color': ORANGE, 'width': 1.6}))
    for run, line in runs:
        series = run.series
        kept = extremes(series.feed, BUCKETS)
        hover = rounded(np.column_stack([series.time, series.way, series.line])[kept])
        for row, x in ((1, series.way), (2, series.time)):
            add_curve(
                figure, row, x[kept], series.feed[kept], escape(run.name), line, row == 1,
                legendgroup=line['color'], customdata=hover, hovertemplate=AT_PLACE,
            )  # fmt: skip
    for run, line in runs:
        figure.add_vline(
            run.proof.cycle_time, line={**line, 'width': 1.0, 'dash': 'dot'}, row=2, col=1
        )
    figure.update_xaxes(title_text='path length (mm)', row=1, col=1)
    figure.update_xaxes(title_text='time (s)', row=2, col=1)
    ceiling = max(feed_ceiling(run.series.feed, run.series.programmed_feed) for run, _ in runs)
    fastest = max(float(run.series.feed.max(initial=0.0)) for run, _ in runs)
    figure.update_yaxes(title_text='mm/min', range=[0.0, min(ceiling, 1.08 * fastest) or 1.0])
    figure.update_layout(base_layout(520))
    return with_axes(figure)


def _planning_time(run: ExaminedPlan) -> float:
    found = run.plan.summary.get('planning_time')
    return float(found) if isinstance(found, int | float) else np.nan


def _largest(error: str, run: ExaminedPlan) -> float:
    return run.proof.largest(error).value / UM


def _mean_feed(run: ExaminedPlan) -> float:
    return float(np.ptp(run.series.way)) / run.proof.cycle_time * 60.0


def comparison_section(first: ExaminedPlan, second: ExaminedPlan) -> str:
    text = (
        f'{escape(first.name)} and {escape(second.name)}; the rest of the page is about the '
        'first. The left number of each limit is that of the first run, the right one that of '
        'the second.'
    )
    tables = comparison_table(first, second) + use_table(first, second)
    content = f'<div class="pair">{tables}</div>' + drawing(comparison_figure(first, second))
    return section('Two runs', text, content)
