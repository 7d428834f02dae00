"""The figures of every report, in plotly, and the list of them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cnc_interp.core import ARCSEC, UM, FloatArray
from cnc_interp.drives.tool_error import ToolError
from cnc_interp.report import html
from cnc_interp.report.series import KINDS, Series, extremes

#: Buckets of the small figures of the axes, and of the tool path in space.
SMALL_BUCKETS, SPACE_BUCKETS = 250, 2500
TOOL_LINES = 160  #: Number of tool axes in the figure of the tool path.
MOST_SWITCHES = 2000  #: If there are more marks of functions, they are thinned.


def path_figure(series: Series) -> Any:
    kept = extremes(series.feed, SPACE_BUCKETS)
    tip, feed = series.tip[kept], series.feed[kept]
    figure = go.Figure()
    programmed = series.vertices[_every(len(series.vertices), 8000)]
    for points, name, line in (
        (programmed, 'program', {'color': '#c3cad1', 'width': 1}),
        (_tool_lines(series), 'tool axis', {'color': '#9aa5b1', 'width': 2}),
    ):
        place = html.xyz(points)
        figure.add_scatter3d(**place, mode='lines', line=line, name=name, hoverinfo='skip')
    figure.add_trace(
        go.Scatter3d(
            **html.xyz(tip),
            mode='lines',
            name='tool path',
            showlegend=False,
            line={
                'color': feed,
                'width': 5,
                'colorscale': 'Viridis',
                'cmin': 0.0,
                'cmax': feed_span(series)[0],
                'colorbar': {'title': {'text': feed_span(series)[1]}, 'thickness': 12, 'len': 0.7},
            },
            customdata=html.rounded(np.column_stack([feed, series.time[kept], series.line[kept]])),
            hovertemplate='x %{x:.3f}  y %{y:.3f}  z %{z:.3f} mm<br>%{customdata[0]:.0f} mm/min '
            'at %{customdata[1]:.3f} s, line %{customdata[2]:.0f}<extra></extra>',
        )
    )
    # The longest side is 1, so that flat and slender paths fill the view equally.
    shown = np.concatenate([tip, series.vertices, _tool_lines(series)])
    span = np.nanmax(shown, axis=0) - np.nanmin(shown, axis=0)
    shape = np.maximum(span / (float(span.max()) or 1.0), 0.08)
    eye, ticks = {'x': 0.85, 'y': -1.05, 'z': 0.75}, ({'nticks': 3 + int(5 * x)} for x in shape)
    ratio = dict(zip('xyz', shape.tolist(), strict=True))
    figure.update_layout(
        html.base_layout(600),
        scene={'aspectmode': 'manual', 'aspectratio': ratio, **html.scene(ticks, eye, 0.06)},
        legend={'orientation': 'h', 'y': 1.0, 'x': 0.0},
        margin={'l': 0, 'r': 0, 't': 10, 'b': 0},
    )
    return figure


def feed_span(series: Series) -> tuple[float, str]:
    """Choose the colour scale of the feedrate so that short rapids do not dominate it."""
    fastest = float(series.feed.max(initial=0.0))
    usual = float(np.percentile(series.feed, 95.0))
    if 0.0 < usual < 0.5 * fastest:
        return 1.1 * usual, 'feed, mm/min<br>(faster: as top)'
    return fastest or 1.0, 'feed, mm/min'


def feed_figure(series: Series) -> Any:
    figure = make_subplots(rows=2, cols=1, vertical_spacing=0.16)
    ceiling = html.feed_ceiling(series.feed, series.programmed_feed)
    limit = np.minimum(series.feed_limit, ceiling)
    asked = np.minimum(series.programmed_feed, ceiling)
    rows = extremes(np.column_stack([series.feed, limit, asked]), html.BUCKETS)
    place = {
        'customdata': html.rounded(np.column_stack([series.time, series.way, series.line])[rows]),
        'hovertemplate': html.AT_PLACE,
    }
    plain = {'hovertemplate': '%{y:.0f} mm/min'}
    for row, x in ((1, series.way), (2, series.time)):
        for name, y, line, hover in (
            ('limit of the axes (Eq. 10)', limit, {'color': html.ORANGE, 'width': 1.2}, plain),
            ('programmed', asked, {'color': html.INK, 'width': 1.2, 'dash': 'dot'}, plain),
            ('planned', series.feed, {'color': html.BLUE, 'width': 1.8}, place),
        ):
            more = {'legendgroup': name, **hover}
            html.add_curve(figure, row, x[rows], y[rows], name, line, row == 1, **more)
    if series.switched:
        at = list(series.switched)[:: 1 + len(series.switched) // MOST_SWITCHES]
        figure.add_scatter(
            x=html.rounded(series.time[at]),
            y=[0.0] * len(at),
            name='functions',
            mode='markers',
            marker={'symbol': 'triangle-up', 'color': html.INK, 'size': 9},
            cliponaxis=False,
            row=2,
            col=1,
            text=[f'{series.switched[k]}<br>line {series.line[k]}' for k in at],
            hovertemplate='%{text}, %{x:.3f} s<extra></extra>',
        )
    figure.update_xaxes(title_text='path length (mm)', row=1, col=1)
    figure.update_xaxes(title_text='time (s)', range=[0.0, series.time[-1]], row=2, col=1)
    figure.update_yaxes(title_text='mm/min', range=[0.0, ceiling * 1.02])
    return html.laid_out(figure, 560)


def axes_figure(series: Series) -> Any:
    names, kinds = series.axis_names, list(KINDS) + ['torque'] * bool(series.torque_use)
    figure = make_subplots(
        rows=len(names),
        cols=len(kinds),
        shared_xaxes=True,
        shared_yaxes=True,
        vertical_spacing=0.025,
        horizontal_spacing=0.02,
        column_titles=kinds,
    )
    most = 1.0
    for j, name in enumerate(names):
        unit = series.axis_units[j]
        curves = [
            (use[:, j], limit[:, j], f'{unit}/s{"" if k == 0 else k + 1}')
            for k, (use, limit) in enumerate(zip(series.axis_use, series.axis_limits, strict=True))
        ]
        if j in series.torque_use:
            use = series.torque_use[j]
            limit = np.full_like(use, series.largest_torque[j])
            curves.append((use, limit, 'N' if unit == 'mm' else 'Nm'))
        for k, (use, limit, of) in enumerate(curves):
            _draw_use(figure, series, (j, k), f'{name} {kinds[k]}', use, limit, of)
            most = max(most, float(np.abs(use).max(initial=0.0)))
        figure.update_yaxes(title_text=f'<b>{name}</b>  %', row=j + 1, col=1)
    span = 112.0 * min(3.0, most)
    figure.update_yaxes(range=[-span, span], tickvals=[-100, 0, 100])
    for k in range(len(kinds)):
        figure.update_xaxes(title_text='time (s)', row=len(names), col=k + 1)
    return html.laid_out(figure, 150 * len(names) + 90, hovermode='closest', margin={'t': 64})


def _draw_use(
    figure: Any,
    series: Series,
    place: tuple[int, int],
    name: str,
    use: FloatArray,
    limit: FloatArray,
    unit: str,
) -> None:
    row, col = place[0] + 1, place[1] + 1
    rows = extremes(use, SMALL_BUCKETS)
    figure.add_scatter(
        x=html.rounded(series.time[rows]),
        y=html.rounded(100.0 * use[rows]),
        name=name,
        line={'color': html.BLUE, 'width': 1.0},
        showlegend=False,
        row=row,
        col=col,
        customdata=html.rounded(np.column_stack([limit[rows], series.line[rows]])),
        hovertemplate=f'{name.split()[0]}: %{{y:.1f}} % of %{{customdata[0]:.4g}} {unit}'
        '<br>%{x:.3f} s, line %{customdata[1]:.0f}<extra></extra>',
    )
    for level in (-100.0, 100.0):
        line = {'color': html.RED, 'width': 0.8, 'dash': 'dot'}
        figure.add_hline(level, line=line, row=row, col=col)
    largest = float(np.abs(use).max(initial=0.0))
    figure.add_annotation(
        text=f'{100.0 * largest:.1f} %',
        xref='x domain',
        yref='y domain',
        x=0.995,
        y=0.98,
        showarrow=False,
        font={'size': 11, 'color': html.RED if largest > 1.001 else html.INK},
        bgcolor='rgba(255,255,255,0.75)',
        row=row,
        col=col,
    )


def error_figure(series: Series) -> Any:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.1)
    for row, name, error, tolerance in (
        (1, 'contour', series.contour_error, series.contour_tolerance),
        (2, 'orientation', series.orientation_error, series.orientation_tolerance),
    ):
        rows = extremes(np.column_stack([error, tolerance]), html.BUCKETS)
        place = {
            'customdata': html.rounded(np.column_stack([series.time, series.line])[rows]),
            'hovertemplate': '%{y:.3f} um at %{customdata[0]:.3f} s, line %{customdata[1]:.0f}',
        }
        for label, y, line, hover in (
            ('error', error, {'color': html.BLUE, 'width': 1.2}, place),
            (
                'tolerance',
                tolerance,
                {'color': html.RED, 'width': 1.2, 'dash': 'dash'},
                {'hovertemplate': '%{y:.3f}'},
            ),
        ):
            html.add_curve(
                figure,
                row,
                series.way[rows],
                y[rows],
                label,
                line,
                row == 1,
                legendgroup=label,
                **hover,
            )
        top = 1.15 * float(max(error.max(initial=0.0), tolerance.max(initial=0.0)))
        figure.update_yaxes(title_text=f'{name} (&#181;m)', range=[0.0, top], row=row, col=1)
    figure.update_xaxes(title_text='path length (mm)', row=2, col=1)
    return html.laid_out(figure, 420)


def _every(count: int, most: int) -> Any:
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(int))


def _tool_lines(series: Series) -> FloatArray:
    way = np.linspace(series.way[0], series.way[-1], TOOL_LINES)
    rows = np.unique(np.searchsorted(series.way, way).clip(0, len(series.way) - 1))
    length = 0.09 * float(np.ptp(series.tip, axis=0).max(initial=0.0)) or 10.0
    gap = np.full((len(rows), 3), np.nan)
    ends = series.tip[rows] + length * series.axis[rows]
    lines: FloatArray = np.stack([series.tip[rows], ends, gap], axis=1).reshape(-1, 3)
    return lines


@dataclass(frozen=True)
class Plot:
    heading: str  #: Heading of the section.
    text: str  #: Text above the figure, with fields of ``Series`` in braces.
    draw: Callable[[Series], Any]  #: Returns the figure.


#: The figures of every report, in order. A new figure needs a function above and a row here.
PLOTS = (
    Plot(
        'Tool path',
        'The colour is the feedrate; short lines are tool axes. Drag to turn, scroll to zoom.',
        path_figure,
    ),
    Plot(
        'Feedrate',
        'The feed is the programmed one where the axes allow it. Eq. 10 of the paper neglects '
        'tangential acceleration and jerk, so the planned feed may exceed it where it changes.',
        feed_figure,
    ),
    Plot(
        'Use of the axis limits',
        'Differences of the emitted positions at the interpolation period give the use of each '
        'limit, in percent. The number in the corner is the largest value.',
        axes_figure,
    ),
    Plot(
        'Deviation from the program',
        'The upper figure shows the deviation of the tool tip, the lower one that of the point '
        'on the tool axis at the flank height of {flank_height:g} mm.',
        error_figure,
    ),
)


def tool_error_section(errors: tuple[ToolError, ToolError], period: float) -> str:
    plain, compensated = errors
    return html.section(
        'Error at the tool',
        'The drives of the machine file were simulated. The figure shows how far the tip is from '
        'the commanded path, and the tool axis from the commanded one. '
        f'As they are: {_largest(plain)}. '
        f'Compensated: {_largest(compensated)}.',
        html.drawing(_figure(plain, compensated, period)),
    )


def _largest(error: ToolError) -> str:
    tip, axis = error.tip / UM, error.axis / ARCSEC
    return (
        f'tip {tip.max():.1f} &#181;m at most, {tip.mean():.2f} &#181;m in the mean, '
        f'axis {axis.max():.1f}&Prime; at most, {axis.mean():.2f}&Prime; in the mean'
    )


def _figure(plain: ToolError, compensated: ToolError, period: float) -> Any:
    figure = make_subplots(rows=2, cols=1, shared_xaxes=True, vertical_spacing=0.06)
    for name, error, colour in (
        ('as they are', plain, html.ORANGE),
        ('compensated', compensated, html.BLUE),
    ):
        line = {'color': colour, 'width': 1.2}
        for row, curve in ((1, error.tip / UM), (2, error.axis / ARCSEC)):
            kept = extremes(curve, html.BUCKETS)
            time = kept * period
            html.add_curve(figure, row, time, curve[kept], name, line, row == 1, mode='lines')
    figure.update_xaxes(title_text='time [s]', row=2, col=1)
    figure.update_yaxes(title_text='tip [µm]', row=1, col=1)
    figure.update_yaxes(title_text='axis [arcsec]', row=2, col=1)
    return html.laid_out(figure, 400)
