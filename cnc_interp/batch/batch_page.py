"""The table of a batch as a CSV file, and on a page where it can be sorted."""

import csv
import io
import json
from collections import Counter
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import Any

from cnc_interp.batch.task import BatchEntry, TaskOutcome, Verdict
from cnc_interp.core import HOUR
from cnc_interp.core.small_files import write_whole
from cnc_interp.report import html
from cnc_interp.run.program_times import times_table

Results = Sequence[tuple[BatchEntry, TaskOutcome]]
#: Columns of the table, with their units. All except the first two and ``cost`` are fields
#: of ``Row``.
COLUMNS = (
    'program',
    'machine',
    'verdict',
    'message',
    'blocks',
    'setpoints',
    'path_length_m',
    'cycle_time_s',
    'standstill_s',
    'time_bound_s',
    'cost',
    'velocity_use',
    'acceleration_use',
    'jerk_use',
    'torque_use',
    'contour_used',
    'orientation_used',
    'tools',
    'notices',
    'plan_hash',
)
#: Columns that differ in name from their field of ``Row``.
FIELDS = {
    'path_length_m': 'path_length',
    'cycle_time_s': 'cycle_time',
    'time_bound_s': 'time_bound',
    'standstill_s': 'standstill',
}
COSTS = ('program', 'machine', 'seconds', 'processor_s', 'memory_MB')


def rows_of(results: Results, rate: float | None) -> list[dict[str, Any]]:
    return [_row(job, outcome, rate) for job, outcome in results]


def _row(job: BatchEntry, outcome: TaskOutcome, rate: float | None) -> dict[str, Any]:
    row = outcome.row
    own = {
        'program': job.program,
        'machine': job.model.name,
        'verdict': str(row.verdict),
        'notices': '; '.join(row.notices),
        'tools': json.dumps(row.tools) if row.tools else '',
        'cost': rate * row.run_time / HOUR if rate and row.cycle_time else None,
    }
    return {
        name: own[name] if name in own else getattr(row, FIELDS.get(name, name))
        for name in COLUMNS
    }


def write_tables(results: Results, rate: float | None, folder: Path) -> list[Path]:
    """Write ``table.csv`` and ``costs.csv``; return them."""
    rows = rows_of(results, rate)
    table, costs = folder / 'table.csv', folder / 'costs.csv'
    write_whole(table, csv_text(COLUMNS, [list(row.values()) for row in rows]))
    spent = [
        (
            job.program,
            job.model.name,
            f'{cost.seconds:.3f}',
            f'{cost.processor:.3f}',
            f'{cost.memory / 1e6:.0f}',
        )
        for job, cost in ((job, outcome.cost) for job, outcome in results)
    ]
    write_whole(costs, csv_text(COSTS, spent))
    return [table, costs]


def csv_text(names: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow(names)
    writer.writerows(rows)
    return text.getvalue()


MOST_ROWS = 5000  #: Largest number of rows shown; the table file contains all.
#: Columns of the page: heading, column of the table, and how a number is written.
SHOWN = (
    ('program', 'program', ''),
    ('machine', 'machine', ''),
    ('verdict', 'verdict', ''),
    ('cycle time [s]', 'cycle_time_s', ',.3f'),
    ('bound [s]', 'time_bound_s', ',.3f'),
    ('cost', 'cost', ',.2f'),
    ('path [m]', 'path_length_m', ',.2f'),
    ('blocks', 'blocks', ',d'),
    ('velocity', 'velocity_use', '.1%'),
    ('acceleration', 'acceleration_use', '.1%'),
    ('jerk', 'jerk_use', '.1%'),
    ('torque', 'torque_use', '.1%'),
    ('contour', 'contour_used', '.1%'),
    ('orientation', 'orientation_used', '.1%'),
)
LOCAL_STYLE = Path(__file__).with_name('table.css').read_text(encoding='utf-8')
SCRIPT = Path(__file__).with_name('table.js').read_text(encoding='utf-8')


def write_page(results: Results, rate: float | None, file: Path) -> None:
    rows = rows_of(results, rate)
    counts = Counter(outcome.row.verdict for _, outcome in results)
    good = counts[Verdict.PROVEN] == len(rows)
    badge = '<span class="badge">all proven</span>' if good else ''
    shown = [one for one in SHOWN if any(row[one[1]] is not None for row in rows)]
    body = [
        f'<h1>{len(rows):,} plans{badge}</h1>',
        f'<p>{len({row["program"] for row in rows}):,} programs, '
        f'machines {escape(", ".join(dict.fromkeys(row["machine"] for row in rows)))}</p>',
        html.tiles(_figures(rows, counts)),
        _time_section(rows),
        html.section(
            'Plans',
            'Press a heading to sort. Each use is the largest proven for any axis.'
            + (
                f' Only {MOST_ROWS:,} rows are shown; table.csv has all.'
                if len(rows) > MOST_ROWS
                else ''
            ),
            f'<input id="find" placeholder="find">{_table(rows[:MOST_ROWS], shown)}',
        ),
    ]
    page = '\n'.join([*body, f'<script>{SCRIPT}</script>'])
    html.write(file, f'{len(rows)} plans', page, LOCAL_STYLE)


def _figures(rows: list[dict[str, Any]], counts: Counter[Verdict]) -> list[tuple[str, str]]:
    figures = [(f'{counts[verdict]:,}', str(verdict)) for verdict in Verdict if counts[verdict]]
    total = sum(row['cycle_time_s'] or 0.0 for row in rows)
    shown = f'{total / HOUR:,.2f} h' if total > HOUR else f'{total:,.1f} s'
    figures.append((shown, 'cycle time of all'))
    if any(row['cost'] is not None for row in rows):
        figures.append((f'{sum(row["cost"] or 0.0 for row in rows):,.2f}', 'cost of all'))
    return figures


def _time_section(rows: list[dict[str, Any]]) -> str:
    """Plot cycle times against their lower bounds; return '' if no row has a bound."""
    from plotly import graph_objects as go

    known = [row for row in rows if row['time_bound_s']]
    if not known:
        return ''
    figure = go.Figure()
    for proven, colour, name in ((True, html.BLUE, 'proven'), (False, html.RED, 'not proven')):
        some = [row for row in known if (row['verdict'] == Verdict.PROVEN) is proven]
        if not some:
            continue
        figure.add_scatter(
            x=[row['time_bound_s'] for row in some],
            y=[row['cycle_time_s'] / row['time_bound_s'] for row in some],
            text=[f'{escape(row["program"])} on {escape(row["machine"])}' for row in some],
            mode='markers',
            marker={'color': colour, 'size': 7, 'opacity': 0.7},
            name=name,
            hovertemplate='%{text}<br>bound %{x:.3f} s, %{y:.3f} times as long<extra></extra>',
        )
    titles = {
        'xaxis_title': 'lower bound of the time, without jerk limits [s]',
        'xaxis_type': 'log',
        'yaxis_title': 'cycle time / lower bound [-]',
    }
    return html.section(
        'Cycle times',
        'The least time is that of any motion within the feeds, velocities and accelerations. '
        'Time above it is due to the jerk limits.',
        html.drawing(html.laid_out(figure, 320, hovermode='closest', **titles)),
    )


def _table(rows: list[dict[str, Any]], shown: list[tuple[str, str, str]]) -> str:
    heads = ''.join(f'<th data-sort>{escape(heading)}</th>' for heading, _, _ in shown)
    lines = []
    for row in rows:
        # Without figures, the reason takes their columns.
        some = shown if row['cycle_time_s'] is not None else shown[:3]
        cells = ''.join(_cell(row, column, form, len(shown) - 2) for _, column, form in some)
        colour = '' if row['verdict'] == Verdict.PROVEN else ' class="red"'
        lines.append(f'<tr{colour}>{cells}</tr>')
    return (
        f'<div class="wide"><table><thead><tr>{heads}</tr></thead>'
        f'<tbody id="rows">{"".join(lines)}</tbody></table></div>'
    )


def _cell(row: dict[str, Any], column: str, form: str, wide: int) -> str:
    value = row[column]
    if value is None:
        return '<td></td>'
    if form:
        return f'<td data-value="{value}">{value:{form}}</td>'
    more, span = '', ''
    if column == 'verdict':
        told = escape(row['message'].replace(f'{row["program"]}:', 'line '))
        more = f'<small>{told}</small>' if told else ''
        span = f' colspan="{wide}"' if row['cycle_time_s'] is None else ''
    elif column == 'program' and row['notices']:
        more = f'<details><summary>notices</summary>{escape(row["notices"])}</details>'
    if column == 'program' and row['tools']:
        table = escape('\n'.join(times_table(json.loads(row['tools']))))
        more += f'<details><summary>times by tool</summary><pre>{table}</pre></details>'
    return f'<td{span}>{escape(value)}{more}</td>'
