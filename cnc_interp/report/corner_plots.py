"""The close-up of a corner: both curves in space, and the profiles along them."""

import json
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from cnc_interp.core import FloatArray
from cnc_interp.report import html
from cnc_interp.report.corners import CornerView

HEIGHT = 640
TOP_COLOUR = '#2e7d4f'
TOOLS = 13  #: Number of tool axes drawn in one corner.
GAP = 1.1  #: Distance between the drawn curves, as a multiple of the corner size.
FEW = 60  #: Curves with fewer points than this are drawn with a marker at each point.

#: One scene serves all corners, because browsers limit the number of scenes of a page.
CHOOSER = html.BESIDE.joinpath('corner_choice.js').read_text(encoding='utf-8')


def space_figure(view: CornerView) -> Any:
    lowering = shift(view)
    moved = f', moved down {np.linalg.norm(lowering):.3g} mm' if lowering.any() else ''
    size = _size(view)
    rows = np.linspace(0, len(view.u) - 1, TOOLS).astype(int)
    ends = view.bottom[rows] + min(GAP * size, _height(view)) * view.axis[rows]
    gap = np.full((len(rows), 3), np.nan)
    tools = np.stack([view.bottom[rows], ends, gap], axis=1).reshape(-1, 3)
    corner = np.stack([view.bottom_polygon[0], view.vertex, view.bottom_polygon[-1]])
    figure = go.Figure()
    for points, name, style in (
        (corner, 'programmed', {'mode': 'lines', 'line': {'color': '#8d99a5', 'width': 3}}),
        (tools, 'tool axis', {'mode': 'lines', 'line': {'color': '#b9c2cb', 'width': 2}}),
        (view.bottom_polygon, 'control points, bottom', _dots(html.BLUE)),
        (view.bottom, 'bottom curve', {'mode': 'lines', 'line': {'color': html.BLUE, 'width': 6}}),
        (view.top_polygon - lowering, 'control points, top', _dots(TOP_COLOUR)),
        (
            view.top - lowering,
            f'top curve{moved}',
            {'mode': 'lines', 'line': {'color': TOP_COLOUR, 'width': 6}},
        ),
        (
            view.vertex[None],
            'programmed corner',
            {'mode': 'markers', 'marker': {'color': html.RED, 'size': 5, 'symbol': 'x'}},
        ),
    ):
        hover = {} if name != 'tool axis' else {'hoverinfo': 'skip'}
        place = html.xyz(points - view.vertex)
        figure.add_trace(go.Scatter3d(**place, name=name, **style, **hover))
    # Equal ranges on all axes give one scale, and everything stays in view.
    shown = np.concatenate([corner, ends, view.bottom_polygon, view.top_polygon - lowering])
    shown = shown - view.vertex
    middle = 0.5 * (shown.min(axis=0) + shown.max(axis=0))
    half = 0.52 * float(np.ptp(shown, axis=0).max())
    ranges = np.stack([middle - half, middle + half], axis=1).tolist()
    eye, ticks = {'x': 1.45, 'y': -1.97, 'z': 0.87}, ({'nticks': 5, 'range': x} for x in ranges)
    figure.update_layout(
        html.base_layout(HEIGHT),
        hovermode='closest',
        scene={'aspectmode': 'cube', **html.scene(ticks, eye, 0.1)},
        legend={'orientation': 'h', 'y': 0.0, 'x': 0.0, 'yanchor': 'bottom'},
        margin={'l': 0, 'r': 0, 't': 0, 'b': 0},
    )
    return figure


def shift(view: CornerView) -> FloatArray:
    """Return the displacement of the top curve; at true height a corner would be two dots."""
    size = _size(view)
    middle = view.axis[len(view.axis) // 2]
    return np.asarray(max(0.0, _height(view) - GAP * size) * middle)


def profile_figure(view: CornerView) -> Any:
    asked = f'{view.programmed:,.0f} mm/min' if np.isfinite(view.programmed) else 'rapid'
    figure = make_subplots(
        rows=3,
        cols=1,
        vertical_spacing=0.13,
        row_heights=[0.26, 0.3, 0.44],
        subplot_titles=(
            'u<sub>top</sub> = u<sub>bottom</sub>; connection added to the top curve'
            if view.in_step
            else 'parametrization u<sub>top</sub> = f(u)',
            'third derivative of the tool axis (Eq. 11)',
            f'feed against Eq. 10, programmed: {asked}',
        ),
    )
    shape, unit = (
        (1e3 * view.connection, '|E|, nm')
        if view.in_step
        else (view.top_u - view.u, 'f(u) &#8722; u')
    )
    _draw(figure, 1, view.u, shape, 'parametrization', {'color': TOP_COLOUR, 'width': 1.8})
    _draw(figure, 2, view.way, view.turn, 'third derivative', {'color': html.BLUE, 'width': 1.8})
    ceiling = html.feed_ceiling(view.feed, view.programmed_feed, 2.0)
    for name, values, line in (
        ('limit of the axes (Eq. 10)', view.feed_limit, {'color': html.ORANGE, 'width': 1.4}),
        ('programmed', view.programmed_feed, {'color': html.INK, 'width': 1.2, 'dash': 'dot'}),
        ('planned', view.feed, {'color': html.BLUE, 'width': 1.8}),
    ):
        _draw(figure, 3, view.feed_way, np.minimum(values, 20.0 * ceiling), name, line, shown=True)
    figure.update_annotations(font={'size': 12.5}, x=0.0, xanchor='left')
    window = [float(view.feed_way[0]), float(view.feed_way[-1])]
    # A long straight cell of the grid may exceed the window.
    span = view.ends[1] - view.ends[0]
    window = [max(window[0], view.ends[0] - 1.5 * span), min(window[1], view.ends[1] + 1.5 * span)]
    figure.update_xaxes(title_text='u', range=[0.0, 1.0], row=1, col=1)
    for row in (2, 3):
        shade = {'fillcolor': '#eef3f8', 'line_width': 0, 'layer': 'below'}
        figure.add_vrect(*view.ends, **shade, row=row, col=1)
        figure.update_xaxes(range=window, row=row, col=1)
    figure.update_xaxes(title_text='path length from the middle of the corner (mm)', row=3, col=1)
    if np.ptp(shape) < 1e-12:
        figure.update_yaxes(range=[-1.0, 1.0], row=1, col=1)
    figure.update_yaxes(title_text=unit, row=1, col=1)
    figure.update_yaxes(title_text='1/mm<sup>3</sup>', rangemode='tozero', row=2, col=1)
    figure.update_yaxes(title_text='mm/min', range=[0.0, ceiling * 1.02], row=3, col=1)
    return html.laid_out(
        figure,
        HEIGHT,
        legend={'orientation': 'h', 'x': 0.0, 'y': -0.1, 'yanchor': 'top'},
        margin={'l': 74, 'r': 14, 't': 56, 'b': 70},
    )


def _draw(
    figure: Any, row: int, x: FloatArray, y: FloatArray, name: str, line: Any, shown: bool = False
) -> None:
    html.add_curve(
        figure,
        row,
        x,
        y,
        name,
        line,
        shown,
        mode='lines+markers' if len(x) < FEW and shown else 'lines',
        marker={'size': 4},
        hovertemplate='%{y:.4g}',
    )


def _dots(colour: str) -> dict[str, Any]:
    return {
        'mode': 'lines+markers',
        'line': {'color': colour, 'width': 1.5, 'dash': 'dash'},
        'marker': {'color': 'white', 'size': 4, 'line': {'color': colour, 'width': 1.5}},
    }


def _size(view: CornerView) -> float:
    both = (view.bottom_polygon, view.top_polygon)
    return max(float(np.ptp(points, axis=0).max()) for points in both)


def _height(view: CornerView) -> float:
    """Return the distance of both curves at the corner's entry [mm]."""
    return float(np.linalg.norm(view.top_polygon[0] - view.bottom_polygon[0]))


def corner_section(views: list[CornerView]) -> str:
    shown = [{'space': space_figure(v), 'profile': profile_figure(v)} for v in views]
    figures = [{part: json.loads(f.to_json()) for part, f in both.items()} for both in shown]
    data = html.packed(json.dumps(figures), 'corner-data')
    slowest = min(range(len(views)), key=lambda i: views[i].slowest)
    options = ''.join(
        f'<option value="{i}"{" selected" if i == slowest else ""}>{escape(view.title)}</option>'
        for i, view in enumerate(views)
    )
    text = (
        'The corners that use most of their tolerance, and the slowest ones. The programmed '
        'corner is the origin. Both curves have one scale; the top curve of a small corner is '
        'drawn closer. Deviations are those of the curve; setpoints may miss its peak. The '
        'corner is shaded.'
    )
    return html.section(
        'A corner, close up',
        text,
        f'<label>Corner <select id="corner-choice">{options}</select></label>'
        '<div class="pair"><div id="corner-space"></div><div id="corner-profile"></div></div>'
        f'{data}<script>{CHOOSER.replace("CONTROLS", html.CONTROLS)}</script>',
    )
