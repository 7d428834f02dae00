"""The page and the table of a sweep: time against error, what each option does, and why."""

from __future__ import annotations

import csv
import io
import shlex
from html import escape
from pathlib import Path
from typing import Any

from cnc_interp.batch.sweep_points import Found, Point, front
from cnc_interp.core.small_files import write_whole
from cnc_interp.core.units import UM
from cnc_interp.report.html import (
    BLUE,
    ORANGE,
    RED,
    base_layout,
    document,
    drawing,
    section,
    table,
    with_axes,
)

#: Limits that are named, of those at which an axis is for most of the time.
NAMED = 3
LOCAL_STYLE = 'td, th { text-align: left; } code { font-size: 12px; }'


def as_it_is(found: dict[Point, Found]) -> Point:
    """Return the point of the command without other values."""
    return next(point for point in found if not point.values)


def values_text(point: Point) -> str:
    """Return the values of a point in words."""
    return ', '.join(f'{name} {value}' for name, value in point.values) or 'as it is'


def lengths_text(one: Found) -> str:
    """Return scallop and error of a point in words."""
    told = (('scallop', one.scallop), ('error', one.error))
    return ', '.join(f'{name} {value / UM:.3f} um' for name, value in told if value is not None)


def why(one: Found) -> str:
    """Name the limits that hold a motion for most of its time."""
    shares = list((one.at_limit or {}).items())[:NAMED]
    return ', '.join(f'{name} {share:.0%}' for name, share in shares if share >= 0.005)


def write_table(found: dict[Point, Found], file: Path) -> None:
    """Write every point as CSV; times in s, errors in um."""
    names = list(dict.fromkeys(name for point in found for name, _ in point.values))
    text = io.StringIO()
    writer = csv.writer(text, lineterminator='\n')
    writer.writerow([*names, 'cycle_time_s', 'scallop_um', 'error_um', 'at_limit', 'fault'])
    for point, one in found.items():
        values = dict(point.values)
        lengths = [None if x is None else x / UM for x in (one.scallop, one.error)]
        writer.writerow([*(values.get(n) for n in names), one.cycle_time, *lengths, why(one),
                         one.fault])  # fmt: skip
    write_whole(file, text.getvalue())


def write_page(found: dict[Point, Found], file: Path) -> None:
    best, start = front(found), as_it_is(found)
    names = list(dict.fromkeys(name for point in found for name, _ in point.values))
    body = [
        f'<h1>{len(found)} points</h1><p><code>cnc-interp {escape(shlex.join(start.words))}</code>'
        '</p>',
        section(
            'Time and accuracy',
            'Every point that moves. Those of the line are best: no other point is at least as '
            'good in time, scallop and error.',
            drawing(_scatter(found, best, start)),
        ),
        section('The best', 'At a limit: share of the time in which an axis, or the feed, is at '
                'its limit. This is what holds the motion.', _table(found, best, start)),
        *(section(f'--{escape(name)}', 'Each point over this option.',
                  drawing(_over(found, name))) for name in names),
        _faults(found),
    ]  # fmt: skip
    write_whole(file, document('sweep', '\n'.join(body), LOCAL_STYLE))


def _moving(found: dict[Point, Found]) -> list[Point]:
    return [point for point, one in found.items() if one.cycle_time is not None]


def _scatter(found: dict[Point, Found], best: list[Point], start: Point) -> Any:
    from plotly import graph_objects as go

    scallops = any(one.scallop is not None for one in found.values())

    def height(one: Found) -> float:
        return ((one.scallop if scallops else one.error) or 0.0) / UM

    def trace(points: list[Point], name: str, **more: Any) -> Any:
        points = [point for point in points if found[point].cycle_time is not None]
        return go.Scatter(
            x=[found[p].cycle_time for p in points],
            y=[height(found[p]) for p in points],
            text=[f'{escape(values_text(p))}<br>{lengths_text(found[p])}<br>'
                  f'{escape(why(found[p]))}' for p in points],
            hovertemplate='%{x:.3f} s; %{text}<extra></extra>',
            name=name, **more,
        )  # fmt: skip

    moving = _moving(found)
    by_error = {
        'color': [(found[point].error or 0.0) / UM for point in moving], 'size': 9,
        'colorscale': 'Blues', 'line': {'color': BLUE, 'width': 1},
        'colorbar': {'title': {'text': 'error [um]'}},
    }  # fmt: skip
    plain = {'color': BLUE, 'opacity': 0.5}
    figure = go.Figure([
        trace(moving, 'all', mode='markers', marker=by_error if scallops else plain),
        trace(best, 'best', mode='lines+markers', line={'color': ORANGE, 'shape': 'hv'},
              marker={'symbol': 'circle-open', 'size': 13}),
        trace([start], 'as it is', mode='markers',
              marker={'color': RED, 'size': 11, 'symbol': 'x'}),
    ])  # fmt: skip
    figure.update_layout(**base_layout(420) | {'hovermode': 'closest'})
    figure.update_xaxes(title='cycle time [s]')
    title = 'highest ridge [um]' if scallops else 'largest error [um]'
    figure.update_yaxes(title=title, rangemode='tozero')
    return with_axes(figure)


def _over(found: dict[Point, Found], name: str) -> Any:
    from plotly import graph_objects as go

    points = [point for point in _moving(found) if name in dict(point.values)]
    figure = go.Figure(
        go.Scatter(
            x=[dict(point.values)[name] for point in points],
            y=[found[point].cycle_time for point in points],
            text=[values_text(point) for point in points],
            hovertemplate='%{text}<br>%{y:.3f} s<extra></extra>',
            mode='markers',
            marker={'color': BLUE, 'opacity': 0.5},
        )
    )
    figure.update_layout(**base_layout(260) | {'hovermode': 'closest'})
    figure.update_xaxes(title=f'--{name}')
    figure.update_yaxes(title='cycle time [s]')
    return with_axes(figure)


def _table(found: dict[Point, Found], best: list[Point], start: Point) -> str:
    rows = []
    for point in [*best, start] if start not in best else best:
        one = found[point]
        if one.cycle_time is None:
            continue
        lengths = ('' if x is None else f'{x / UM:.3f}' for x in (one.scallop, one.error))
        command = f'<code>cnc-interp {escape(shlex.join(point.command))}</code>'
        rows.append((escape(values_text(point)), f'{one.cycle_time:.3f}', *lengths,
                     escape(why(one)), command))  # fmt: skip
    heads = 'values', 'time [s]', 'scallop [um]', 'error [um]', 'at a limit', 'command'
    return table(heads, rows)


def _faults(found: dict[Point, Found]) -> str:
    lines = [f'<li>{escape(values_text(point))}: {escape(one.fault)}</li>'
             for point, one in found.items() if one.fault]  # fmt: skip
    if not lines:
        return ''
    return f'<section class="faults"><h2>Not possible</h2><ul>{"".join(lines)}</ul></section>'
