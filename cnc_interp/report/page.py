"""The HTML report of a plan: one page that opens from a file without a network."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from cnc_interp.core import UM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.proof.verdict import Proof
from cnc_interp.proof.verify import verify
from cnc_interp.report.corners import views_of
from cnc_interp.report.dense_blocks import read_segments
from cnc_interp.report.html import document, drawing, section, tiles
from cnc_interp.report.series import Series, series_of, tool_error_use, tool_errors
from cnc_interp.report.time_lost import time_section


@dataclass(frozen=True)
class ExaminedPlan:
    name: str  #: Its name where it is compared with another one.
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
    try:
        from cnc_interp.report.comparison import comparison_section
        from cnc_interp.report.corner_plots import corner_section
        from cnc_interp.report.dense_blocks import curves_section
        from cnc_interp.report.plots import PLOTS, tool_error_section
    except ImportError as fault:
        raise InterpError('the report needs plotly: pip install plotly') from fault
    names = _names(directory, compare or directory)
    run = ExaminedPlan.of(directory, machine, names[0])
    given, machine = machine, run.machine
    plan, proof, series = run.plan, run.proof, run.series
    segments = read_segments(directory)
    name = Path(str(plan.summary.get('program', 'plan'))).name
    body = [
        f'<h1>{escape(name)}<span class="badge{"" if proof.ok else " no"}">'
        f'{"" if proof.ok else "not "}proven</span></h1>',
        f'<p>machine {escape(machine.name)}, {"".join(machine.axis_names)}, '
        f'{proof.samples:,} setpoints every {proof.period * 1e3:g} ms</p>',
        tiles(_figures(plan, proof, series)),
        _faults(proof),
    ]
    if compare is not None:
        body.append(comparison_section(run, ExaminedPlan.of(compare, given, names[1])))
    errors = tool_errors(plan, machine) if machine.drives else None
    body.append(time_section(series, tool_error_use(plan, errors) if errors else None))
    for plot in PLOTS:
        text = plot.text.format(**vars(series))
        body.append(section(plot.heading, text, drawing(plot.draw(series))))
    if errors:
        body.append(tool_error_section(errors, plan.period))
    if segments is not None:
        if views := views_of(plan, segments):
            body.append(corner_section(views))
        body.append(curves_section(plan, segments))
    body.append(f'<footer>{escape(_versions(plan))}</footer>')
    out.parent.mkdir(parents=True, exist_ok=True)
    out.write_text(document(name, '\n'.join(body)), encoding='utf-8')


def _names(first: Path, second: Path) -> tuple[str, str]:
    short = (first.resolve().name, second.resolve().name)
    return short if short[0] != short[1] else (str(first), str(second))


def _figures(plan: PlanFiles, proof: Proof, series: Series) -> list[tuple[str, str]]:
    rows = [
        (f'{proof.cycle_time:.3f} s', 'cycle time'), (f'{proof.blocks:,}', 'blocks'),
        (f'{series.way[-1] - series.way[0]:,.1f} mm', 'path length'),
        (f'{series.feed.max():,.0f} mm/min', 'highest feed'),
    ]  # fmt: skip
    least: Any = plan.summary.get('time_bound')
    if isinstance(least, int | float):
        label = 'least time within these velocities and accelerations, without jerk limits'
        rows.insert(1, (f'{least:.3f} s', label))
    planning: Any = plan.summary.get('planning_time')
    if isinstance(planning, int | float) and planning > 0.0:
        times = proof.cycle_time / planning
        rows.append((f'{planning:.3g} s', f'planning; motion takes {times:,.3g} times as long'))
    for kind in proof.kinds:
        most = max((f for f in proof.findings if f.what == kind), key=lambda f: f.ratio)
        rows.append((f'{most.ratio:.1%}', f'largest {kind} use, axis {most.axis}'))
    for name in ('contour error', 'orientation error'):
        found = proof.largest(name)
        value, limit = found.value / UM, found.limit / UM
        rows.append((f'{value:.4g} &#181;m', f'largest {name}, allowed {limit:.4g} &#181;m'))
    return rows


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
