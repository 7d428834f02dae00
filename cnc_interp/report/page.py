"""One self-contained HTML page about a plan: it opens from a file, without any network."""

from __future__ import annotations

from html import escape
from pathlib import Path
from typing import Any

from cnc_interp.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.plan_files import PlanFiles, read_plan
from cnc_interp.proof import DIFFERENCES, Proof
from cnc_interp.report.series import Series, series_of
from cnc_interp.units import MM, UM
from cnc_interp.verify import verify

STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: #22303c;
  font: 14px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, Arial, sans-serif; }
main { max-width: 1240px; margin: 0 auto; padding: 28px 24px 48px; }
h1 { font-size: 22px; font-weight: 600; margin: 0; }
h1 + p { margin: 2px 0 20px; color: #5c6b78; }
h2 { font-size: 15px; font-weight: 600; margin: 0 0 2px; }
section { background: white; border: 1px solid #e1e6ea; border-radius: 6px;
  padding: 16px 18px 8px; margin-top: 16px; }
section > p { margin: 0 0 6px; color: #5c6b78; }
.badge { font-size: 13px; font-weight: 600; border-radius: 4px; padding: 2px 10px;
  margin-left: 10px; vertical-align: 3px; color: white; background: #2e7d4f; }
.badge.no { background: #c0392b; }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(206px, 1fr)); gap: 12px; }
.tile { background: white; border: 1px solid #e1e6ea; border-radius: 6px; padding: 10px 14px; }
.tile b { display: block; font-size: 20px; font-weight: 600; white-space: nowrap; }
.tile span { color: #5c6b78; font-size: 12.5px; }
.faults { border-color: #c0392b; }
.faults li { margin-bottom: 4px; }
footer { color: #7b8794; font-size: 12.5px; margin-top: 18px; }
"""

# Part programs are nobody's business: no button that would upload a chart.
CONTROLS = {
    'displaylogo': False,
    'responsive': True,
    'showSendToCloud': False,
    'modeBarButtonsToRemove': ['sendChartToCloud', 'sendDataToCloud'],
}


def write_report(directory: Path, out: Path, machine: Machine | None = None) -> None:
    """
    Write the report of a plan directory.

    Parameters
    ----------
    directory : Path
        Written by ``cnc-interp plan``.
    out : Path
        HTML file to write.
    machine : Machine, optional
        Needed where the summary does not name a machine that can be found.

    Raises
    ------
    InterpError
        If the files cannot be read, or plotly is not installed.

    """
    plan = read_plan(directory)
    used = machine or Machine.load(str(plan.summary.get('machine', '')))
    page = render(plan, used)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page, encoding='utf-8')
    except OSError as fault:
        raise InterpError(f'{out}: cannot be written ({fault.strerror})') from fault


def render(plan: PlanFiles, machine: Machine) -> str:
    """Make the page."""
    try:
        from plotly.offline import get_plotlyjs

        from cnc_interp.report import figures
    except ImportError as fault:
        raise InterpError('the report needs plotly: pip install plotly') from fault
    if plan.position.shape[1] != len(machine.axis_names):
        raise InterpError(f'the plan was not made for machine {machine.name}: give the right one')
    proof = verify(plan, machine)
    series = series_of(plan, machine)
    sections = (
        ('Tool path', 'Coloured by feedrate; short lines are tool axes. Drag to turn, scroll to '
         'zoom.', figures.path_figure(series)),
        ('Feedrate', 'Where the axes let it, the feed is the programmed one. Eq. 10 of the paper '
         'leaves out tangential acceleration and jerk, so the plan may pass it on a slope.',
         figures.feed_figure(series)),
        ('Use of the axis limits', 'By differences of the emitted positions at the interpolation '
         'period, in percent of each limit; the figure in the corner is the largest.',
         figures.axes_figure(series)),
        ('Deviation from the program', 'Of the tool tip, and of the point at flank height '
         f'{plan.flank_height / MM:g} mm on the tool axis.', figures.error_figure(series)),
    )  # fmt: skip
    title = escape(Path(str(plan.summary.get('program', 'plan'))).name)
    body = [
        f'<h1>{title}{_badge(proof)}</h1>',
        f'<p>machine {escape(machine.name)}, {"".join(machine.axis_names)}, '
        f'{proof.samples:,} setpoints every {proof.period * 1e3:g} ms</p>',
        f'<div class="tiles">{"".join(_tiles(plan, proof, series))}</div>',
        _faults(proof),
    ]
    for heading, text, figure in sections:
        drawing = figure.to_html(
            full_html=False, include_plotlyjs=False, default_width='100%',
            config=CONTROLS,
        )  # fmt: skip
        body.append(f'<section><h2>{heading}</h2><p>{text}</p>{drawing}</section>')
    body.append(f'<footer>{escape(_versions(plan))}</footer>')
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{title}</title><style>{STYLE}</style>'
        f'<script>{get_plotlyjs()}</script></head><body><main>'
        + '\n'.join(body)
        + '</main></body></html>\n'
    )


def _badge(proof: Proof) -> str:
    if proof.ok:
        return '<span class="badge">proven</span>'
    return '<span class="badge no">not proven</span>'


def _tiles(plan: PlanFiles, proof: Proof, series: Series) -> list[str]:
    """Write the figures at the head of the page."""
    rows = [
        (f'{proof.cycle_time:.3f} s', 'cycle time'),
        (f'{proof.blocks:,}', 'blocks'),
        (f'{series.way[-1] - series.way[0]:,.1f} mm', 'path length'),
        (f'{series.feed.max():,.0f} mm/min', 'highest feed'),
    ]
    planning: Any = plan.summary.get('planning_time')
    if isinstance(planning, int | float) and planning > 0.0:
        faster = proof.cycle_time / planning
        rows.append((f'{planning:.3g} s', f'planning, {faster:,.0f} times faster than the motion'))
    for kind, _ in DIFFERENCES:
        most = max((f for f in proof.findings if f.what == kind), key=lambda f: f.ratio)
        rows.append((f'{most.ratio:.1%}', f'largest {kind} use, axis {most.axis}'))
    for name in ('contour error', 'orientation error'):
        found = proof.largest(name)
        value, limit = found.value / UM, found.limit / UM
        rows.append((f'{value:.3g} &#181;m', f'largest {name}, allowed {limit:.4g} &#181;m'))
    return [f'<div class="tile"><b>{value}</b><span>{label}</span></div>' for value, label in rows]


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
