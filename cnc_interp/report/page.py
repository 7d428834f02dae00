"""The HTML report of a plan: one page that needs no server and no network."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from plotly.subplots import make_subplots

from cnc_interp.core import UM, FloatArray, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.proof.verdict import Finding, Proof
from cnc_interp.proof.verify import verify
from cnc_interp.report import html
from cnc_interp.report.corner_plots import corner_section
from cnc_interp.report.corners import curves_section, read_segments, views_of
from cnc_interp.report.html import drawing, section, tiles
from cnc_interp.report.plots import PLOTS, tool_error_section
from cnc_interp.report.series import (
    Series,
    extremes,
    series_of,
    time_lost,
    time_section,
    tool_error_use,
    tool_errors,
)

#: Names of the deviations of a path, with the findings of a proof that measure them: from the path
#: to the program, and from the program's vertices to the path.
DEVIATIONS = {
    'contour': (
        'deviation between path and program at the tool tip',
        ('contour deviation', 'contour deviation of path', 'vertex missed by tip'),
    ),
    'orientation': (
        'deviation between path and program at the flank height',
        ('orientation deviation', 'orientation deviation of path', 'vertex missed by top'),
    ),
}
NAMED = 3  #: Largest number of limits that the summary sentence names.

#: Rows of the table: label, unit, number format, and the figure of a plan.
ROWS: tuple[tuple[str, str, str, Callable[[ExaminedPlan], float]], ...] = (
    ('cycle time', ' s', '.3f', lambda run: run.proof.cycle_time),
    ('planning time', ' s', '.3g', lambda run: _planning_time(run)),
    ('path length', ' mm', ',.2f', lambda run: float(np.ptp(run.series.way))),
    ('pieces of path', '', ',', lambda run: run.proof.blocks),
    ('highest feed', ' mm/min', ',.0f', lambda run: float(run.series.feed.max())),
    (
        'mean feed',
        ' mm/min',
        ',.0f',
        lambda run: float(np.ptp(run.series.way)) / run.proof.cycle_time * 60.0,
    ),
    (
        'largest deviation of the tool tip',
        ' &#181;m',
        '.4g',
        lambda run: _deviation(run.proof, 'contour').value / UM,
    ),
    (
        'largest deviation at flank height',
        ' &#181;m',
        '.4g',
        lambda run: _deviation(run.proof, 'orientation').value / UM,
    ),
)


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
                figure,
                row,
                x[kept],
                series.feed[kept],
                escape(run.name),
                line,
                row == 1,
                legendgroup=line['color'],
                customdata=hover,
                hovertemplate=html.AT_PLACE,
            )
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


@dataclass(frozen=True)
class ExaminedPlan:
    name: str  #: Its name in a comparison.
    plan: PlanFiles
    machine: Machine
    proof: Proof
    series: Series  #: Values to draw.

    @staticmethod
    def of(directory: Path, machine: Machine | None, name: str) -> ExaminedPlan:
        plan = read_plan(directory).in_memory()
        machine = machine or Machine.load(str(plan.summary.get('machine', '')))
        if plan.position.shape[1] != len(machine.axis_names):
            why = f'the plan was not made for machine {machine.name}: give the right one'
            raise InterpError(why)
        return ExaminedPlan(name, plan, machine, verify(plan, machine), series_of(plan, machine))


def write_report(
    directory: Path, out: Path, machine: Machine | None = None, compare: Path | None = None
) -> None:
    names = _names(directory, compare or directory)
    run = ExaminedPlan.of(directory, machine, names[0])
    given, machine = machine, run.machine
    plan, proof, series = run.plan, run.proof, run.series
    segments = read_segments(directory)
    name = Path(str(plan.summary.get('program', 'plan'))).name
    errors = tool_errors(plan, machine) if machine.drives else None
    use = tool_error_use(plan, errors) if errors else None
    body = [
        f'<h1>{escape(name)}<span class="badge{"" if proof.ok else " no"}">'
        f'{"" if proof.ok else "not "}proven</span></h1>',
        f'<p>machine {escape(machine.name)}, {"".join(machine.axis_names)}, '
        f'{proof.samples:,} setpoints every {proof.period * 1e3:g} ms</p>',
        _answer(proof, series, use),
        f'<p>{escape(machine.guessed)}</p>' if machine.guessed else '',
        tiles(_figures(plan, proof, series)),
        _faults(proof),
    ]
    if compare is not None:
        body.append(comparison_section(run, ExaminedPlan.of(compare, given, names[1])))
    body.append(time_section(series, use))
    for plot in PLOTS:
        text = plot.text.format(**vars(series))
        body.append(section(plot.heading, text, drawing(plot.draw(series))))
    if plan.collision:
        from cnc_interp.report.clearances import clearance_section

        body.append(clearance_section(plan, machine, series))
    if plan.removal:
        from cnc_interp.report.stock import stock_section

        body.append(stock_section(plan))
    if errors:
        body.append(tool_error_section(errors, plan.period))
    if segments is not None:
        if views := views_of(plan, segments):
            body.append(corner_section(views))
        body.append(curves_section(plan, segments))
    body.append(f'<footer>{escape(_versions(plan))}</footer>')
    html.write(out, name, '\n'.join(body))


def _names(first: Path, second: Path) -> tuple[str, str]:
    short = (first.resolve().name, second.resolve().name)
    return short if short[0] != short[1] else (str(first), str(second))


def _figures(plan: PlanFiles, proof: Proof, series: Series) -> list[tuple[str, str]]:
    lines = len(np.unique(series.line[series.line > 0]))
    rows = [
        (f'{proof.cycle_time:.3f} s', 'cycle time'),
        (f'{lines:,}', f'lines of the program with motion, in {proof.blocks:,} pieces'),
        (f'{series.way[-1] - series.way[0]:,.1f} mm', 'path length'),
        (f'{series.feed.max():,.0f} mm/min', 'highest feed'),
    ]
    least: Any = plan.summary.get('time_bound')
    if isinstance(least, int | float):
        label = 'no motion within these velocities and accelerations takes less'
        rows.insert(1, (f'{least:.3f} s', label))
    planning: Any = plan.summary.get('planning_time')
    if isinstance(planning, int | float) and planning > 0.0:
        times = proof.cycle_time / planning
        rows.append((f'{planning:.3g} s', f'planning; motion takes {times:,.3g} times as long'))
    for kind in proof.kinds:
        most = max((f for f in proof.findings if f.what == kind), key=lambda f: f.ratio)
        rows.append((f'{most.ratio:.1%}', f'largest {kind} use, axis {most.axis}'))
    for name, (told, _) in DEVIATIONS.items():
        found = _deviation(proof, name)
        label = f'largest {told}; up to {found.limit / UM:.4g} &#181;m are allowed there'
        rows.append((f'{found.value / UM:.4g} &#181;m', label))
    return rows


def _answer(proof: Proof, series: Series, tool_error: FloatArray | None) -> str:
    """Return a sentence with the time, the limits that determine it, and the proof."""
    held = time_lost(series, tool_error).by_limit
    limits = sorted(((time, name) for name, (time, _) in held.items() if time > 0.0), reverse=True)
    whole = max(float(series.time[-1] - series.time[0]), 1e-9)
    told = ', '.join(f'{escape(name)} for {time / whole:.0%}' for time, name in limits[:NAMED])
    proven = (
        'Every setpoint keeps the limits of the machine, every curve the tolerances: proven.'
        if proof.ok
        else 'It is not proven; the reasons are below.'
    )
    return (
        f'<p class="answer"><b>{proof.cycle_time:.3f} s.</b> Of this time the motion is limited '
        f'by {told}. {proven}</p>'
    )


def _deviation(proof: Proof, name: str) -> Finding:
    """Return the deviation that uses most of its tolerance, in the words of `plan`."""
    found = [each for each in proof.findings if each.what in DEVIATIONS[name][1]]
    return max(found, key=lambda one: one.ratio if np.isfinite(one.ratio) else -1.0)


def _faults(proof: Proof) -> str:
    if proof.ok:
        return ''
    lines = ''.join(f'<li>{escape(line)}</li>' for line in proof.failures)
    return f'<section class="faults"><h2>Not proven</h2><ul>{lines}</ul></section>'


def _versions(plan: PlanFiles) -> str:
    versions: Any = plan.summary.get('versions', {})
    if not isinstance(versions, dict):
        return ''
    return ', '.join(f'{name} {version}' for name, version in versions.items())
