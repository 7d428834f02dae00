"""One self-contained HTML page about a plan: it opens from a file, without any network."""

from __future__ import annotations

import json
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM, UM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.proof.verdict import DIFFERENCES, Proof
from cnc_interp.proof.verify import verify
from cnc_interp.report.corners import CornerView, read_segments, views_of
from cnc_interp.report.series import Series, series_of
from cnc_interp.smoothing.segments import PathSegments

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
select { font: inherit; color: inherit; max-width: 100%; padding: 4px 8px; margin: 2px 0 8px;
  border: 1px solid #c3cad1; border-radius: 4px; background: white; }
.pair { display: grid; grid-template-columns: minmax(0, 1fr) minmax(0, 1fr); gap: 12px; }
@media (max-width: 860px) { .pair { grid-template-columns: minmax(0, 1fr); } }
.wide { overflow-x: auto; margin-bottom: 10px; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; width: 100%; }
.uses td:nth-child(odd) { font-weight: 600; padding-right: 18px; }
th, td { padding: 3px 14px 3px 0; border-bottom: 1px solid #e6eaee; text-align: right; }
th { font-weight: 600; } tbody th { font-weight: 400; }
th:first-child { text-align: left; color: #5c6b78; }
footer { color: #7b8794; font-size: 12.5px; margin-top: 18px; }
"""

# Part programs are nobody's business: no button that would upload a chart.
CONTROLS = {
    'displaylogo': False,
    'responsive': True,
    'showSendToCloud': False,
    'modeBarButtonsToRemove': ['sendChartToCloud', 'sendDataToCloud'],
}

# One scene for all corners: browsers allow a page only few of them.
CHOOSER = """
(function () {
  var corners = JSON.parse(document.getElementById('corner-data').textContent);
  var choice = document.getElementById('corner-choice');
  function show() {
    var corner = corners.figures[Number(choice.value)];
    ['space', 'profile'].forEach(function (part) {
      Plotly.react('corner-' + part, corner[part].data, corner[part].layout, corners.config);
    });
  }
  choice.addEventListener('change', show);
  show();
})();
"""


def write_report(
    directory: Path, out: Path, machine: Machine | None = None, compare: Path | None = None
) -> None:
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
    compare : Path, optional
        Another plan directory to set beside the first.

    Raises
    ------
    InterpError
        If the files cannot be read, or plotly is not installed.

    """
    plan = read_plan(directory)
    segments = read_segments(directory)
    other = None
    if compare is not None:
        other = Other(read_plan(compare), machine, _names(directory, compare))
    page = render(plan, machine or _machine_of(plan), segments, other)
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        out.write_text(page, encoding='utf-8')
    except OSError as fault:
        raise InterpError(f'{out}: cannot be written ({fault.strerror})') from fault


@dataclass(frozen=True)
class Other:
    """A second plan to compare with, its machine if given, and the names of both."""

    plan: PlanFiles
    machine: Machine | None
    names: tuple[str, str]


def render(
    plan: PlanFiles,
    machine: Machine,
    segments: PathSegments | None = None,
    other: Other | None = None,
) -> str:
    """Make the page."""
    try:
        from plotly.offline import get_plotlyjs

        from cnc_interp.report import figures
    except ImportError as fault:
        raise InterpError('the report needs plotly: pip install plotly') from fault
    proof, series = _examined(plan, machine)
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
        body.append(_section(heading, text, _drawing(figure)))
    if other is not None:
        # What was asked for stands first.
        body.insert(4, _comparison(plan, proof, series, other))
    if segments is not None and (views := views_of(plan, segments)):
        body.append(_corners(views))
    if segments is not None:
        body += _curves(plan, segments)
    body.append(f'<footer>{escape(_versions(plan))}</footer>')
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f'<title>{title}</title><style>{STYLE}</style>'
        f'<script>{get_plotlyjs()}</script></head><body><main>'
        + '\n'.join(body)
        + '</main></body></html>\n'
    )


def _machine_of(plan: PlanFiles) -> Machine:
    return Machine.load(str(plan.summary.get('machine', '')))


def _examined(plan: PlanFiles, machine: Machine) -> tuple[Proof, Series]:
    """Prove a plan and work out what is drawn of it."""
    if plan.position.shape[1] != len(machine.axis_names):
        raise InterpError(f'the plan was not made for machine {machine.name}: give the right one')
    return verify(plan, machine), series_of(plan, machine)


def _names(first: Path, second: Path) -> tuple[str, str]:
    """Name two plans by their directories, as shortly as they differ."""
    short = (first.resolve().name, second.resolve().name)
    return short if short[0] != short[1] else (str(first), str(second))


def _section(heading: str, text: str, content: str) -> str:
    return f'<section><h2>{heading}</h2><p>{text}</p>{content}</section>'


def _drawing(figure: Any) -> str:
    drawing: str = figure.to_html(
        full_html=False, include_plotlyjs=False, default_width='100%', config=CONTROLS
    )
    return drawing


def _comparison(plan: PlanFiles, proof: Proof, series: Series, other: Other) -> str:
    """Write the section that sets two runs side by side."""
    from cnc_interp.report.comparison import Run, comparison_figure, comparison_table, use_table

    first = Run(other.names[0], plan, proof, series)
    machine = other.machine or _machine_of(other.plan)
    second = Run(other.names[1], other.plan, *_examined(other.plan, machine))
    text = (
        f'{escape(first.name)} and {escape(second.name)}; the rest of the page is about the '
        'first. Of each limit the left figure is the first run, the right one the second.'
    )
    tables = comparison_table(first, second) + use_table(first, second)
    content = f'<div class="pair">{tables}</div>' + _drawing(comparison_figure(first, second))
    return _section('Two runs', text, content)


def _corners(views: list[CornerView]) -> str:
    """Write the section of the corners, drawn when they are chosen."""
    from cnc_interp.report.corner_figures import profile_figure, space_figure

    shown = [{'space': space_figure(v), 'profile': profile_figure(v)} for v in views]
    figures = [{part: json.loads(f.to_json()) for part, f in both.items()} for both in shown]
    # Nothing inside may look like the end of the script element.
    data = json.dumps({'config': CONTROLS, 'figures': figures}).replace('<', '\\u003c')
    slowest = min(range(len(views)), key=lambda i: views[i].slowest)
    options = ''.join(
        f'<option value="{i}"{" selected" if i == slowest else ""}>{escape(view.title)}</option>'
        for i, view in enumerate(views)
    )
    text = (
        'The corners that use most of their tolerance and those that are passed slowest. '
        'Coordinates from the programmed corner; the top curve of a small corner is drawn '
        'nearer, both curves to one scale. Deviations are those of the curve; setpoints may step '
        'over its peak. Shaded: the corner.'
    )
    return _section(
        'A corner, close up', text,
        f'<label>Corner <select id="corner-choice">{options}</select></label>'
        '<div class="pair"><div id="corner-space"></div><div id="corner-profile"></div></div>'
        f'<script type="application/json" id="corner-data">{data}</script>'
        f'<script>{CHOOSER}</script>',
    )  # fmt: skip


def _curves(plan: PlanFiles, segments: PathSegments) -> list[str]:
    """Write the section of the curves through dense blocks, if there are any."""
    from cnc_interp.report.curves import bounds_figure, close_figure, curves_of

    view = curves_of(plan, segments)
    if view is None:
        return []
    pair = f'<div>{_drawing(bounds_figure(view))}</div><div>{_drawing(close_figure(view))}</div>'
    return [_section('Dense blocks as curves', view.text, f'<div class="pair">{pair}</div>')]


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
        times = proof.cycle_time / planning
        rows.append((f'{planning:.3g} s', f'planning; motion takes {times:,.3g} times as long'))
    for kind, _ in DIFFERENCES:
        most = max((f for f in proof.findings if f.what == kind), key=lambda f: f.ratio)
        rows.append((f'{most.ratio:.1%}', f'largest {kind} use, axis {most.axis}'))
    for name in ('contour error', 'orientation error'):
        found = proof.largest(name)
        value, limit = found.value / UM, found.limit / UM
        rows.append((f'{value:.4g} &#181;m', f'largest {name}, allowed {limit:.4g} &#181;m'))
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
