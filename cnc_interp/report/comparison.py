"""Two runs side by side: tables, and both feeds over path length and time."""

from collections.abc import Callable
from html import escape
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from cnc_interp.core import UM
from cnc_interp.report import html
from cnc_interp.report.page import ExaminedPlan
from cnc_interp.report.series import extremes

#: Rows of the table: label, unit, number format, and the figure of a plan.
ROWS: tuple[tuple[str, str, str, Callable[[ExaminedPlan], float]], ...] = (
    ('cycle time', ' s', '.3f', lambda run: run.proof.cycle_time),
    ('planning time', ' s', '.3g', lambda run: _planning_time(run)),
    ('path length', ' mm', ',.2f', lambda run: float(np.ptp(run.series.way))),
    ('blocks', '', ',', lambda run: run.proof.blocks),
    ('highest feed', ' mm/min', ',.0f', lambda run: float(run.series.feed.max())),
    ('mean feed', ' mm/min', ',.0f',
     lambda run: float(np.ptp(run.series.way)) / run.proof.cycle_time * 60.0),
    ('largest contour error', ' &#181;m', '.4g',
     lambda run: run.proof.largest('contour error').value / UM),
    ('largest orientation error', ' &#181;m', '.4g',
     lambda run: run.proof.largest('orientation error').value / UM),
)  # fmt: skip


def comparison_table(first: ExaminedPlan, second: ExaminedPlan) -> str:
    proven = ['yes' if run.proof.ok else 'no' for run in (first, second)]
    lines = [('proven', *proven, '')]
    for label, unit, pattern, figure in ROWS:
        one, two = figure(first), figure(second)
        change = f'{(two / one - 1.0) * 100.0:+.1f} %' if one > 0.0 and two > 0.0 else ''
        change = '=' if change in ('+0.0 %', '-0.0 %') else change
        texts = (f'{x:{pattern}}{unit}' if np.isfinite(x) else '&#8211;' for x in (one, two))
        lines.append((label, *texts, change))
    return html.table(('', escape(first.name), escape(second.name), 'change'), lines)


def use_table(first: ExaminedPlan, second: ExaminedPlan) -> str:
    kinds = max(first.proof.kinds, second.proof.kinds, key=len)
    names = dict.fromkeys(first.series.axis_names + second.series.axis_names)
    lines = []
    for axis in names:
        uses = [run.proof.use_of(kind, axis) for kind in kinds for run in (first, second)]
        cells = (f'{x:.1%}' if np.isfinite(x) else '&#8211;' for x in uses)
        lines.append([escape(axis), *cells])
    return html.table(('largest use', *kinds), lines, span=2)


def comparison_figure(first: ExaminedPlan, second: ExaminedPlan) -> Any:
    figure = make_subplots(rows=2, cols=1, vertical_spacing=0.16)
    runs = (
        (first, {'color': html.BLUE, 'width': 1.6}),
        (second, {'color': html.ORANGE, 'width': 1.6}),
    )
    for run, line in runs:
        series = run.series
        kept = extremes(series.feed, html.BUCKETS)
        hover = html.rounded(np.column_stack([series.time, series.way, series.line])[kept])
        for row, x in ((1, series.way), (2, series.time)):
            html.add_curve(
                figure, row, x[kept], series.feed[kept], escape(run.name), line, row == 1,
                legendgroup=line['color'], customdata=hover, hovertemplate=html.AT_PLACE,
            )  # fmt: skip
    for run, line in runs:
        dotted = {**line, 'width': 1.0, 'dash': 'dot'}
        figure.add_vline(run.proof.cycle_time, line=dotted, row=2, col=1)
    figure.update_xaxes(title_text='path length (mm)', row=1, col=1)
    figure.update_xaxes(title_text='time (s)', row=2, col=1)
    drawn = [run.series for run, _ in runs]
    ceiling = max(html.feed_ceiling(one.feed, one.programmed_feed) for one in drawn)
    fastest = max(float(run.series.feed.max(initial=0.0)) for run, _ in runs)
    figure.update_yaxes(title_text='mm/min', range=[0.0, min(ceiling, 1.08 * fastest) or 1.0])
    return html.laid_out(figure, 520)


def _planning_time(run: ExaminedPlan) -> float:
    found = run.plan.summary.get('planning_time')
    return float(found) if isinstance(found, int | float) else np.nan


def comparison_section(first: ExaminedPlan, second: ExaminedPlan) -> str:
    text = (
        f'{escape(first.name)} and {escape(second.name)}; the rest of the page is about the '
        'first. The left number of each limit is that of the first run, the right one that of '
        'the second.'
    )
    tables = comparison_table(first, second) + use_table(first, second)
    content = f'<div class="pair">{tables}</div>' + html.drawing(comparison_figure(first, second))
    return html.section('Two runs', text, content)
