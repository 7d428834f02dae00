"""One self-contained HTML page about iso-scallop passes and the simulated surface."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from cnc_interp.cam.heights import COLOURS, RANGE
from cnc_interp.cam.iso_scallop import IsoScallopPaths
from cnc_interp.cam.nbuffer import Heights
from cnc_interp.cam.simulation import Section
from cnc_interp.cam.spline_pass import Strips
from cnc_interp.core import DEG, MM, UM, FloatArray, norm
from cnc_interp.report import html

CELLS = 700  #: Largest number of cells of a map in each direction.
CURVES = 12  #: Number of tilt curves in a figure.


def map_figure(heights: Heights, scallop: float) -> Any:
    rows, columns = heights.height.shape
    skip = max(1, -(-max(rows, columns) // CELLS))
    base = heights.needles.base
    x = np.concatenate([[0.0], np.cumsum(norm(np.diff(base[:, columns // 2], axis=0)))]) / MM
    y = np.concatenate([[0.0], np.cumsum(norm(np.diff(base[rows // 2], axis=0)))]) / MM
    # Ridges are thinner than a cell, so a cell shows its height farthest from zero.
    shown = np.where(heights.cut, heights.height, np.nan) / UM
    shown = thinned(shown, skip)
    top = RANGE * scallop / UM
    figure = go.Figure(
        go.Heatmap(
            x=html.rounded(x[::skip]),
            y=html.rounded(y[::skip]),
            z=html.rounded(shown.T),
            zmin=-top,
            zmax=top,
            colorscale=COLOURS,
            colorbar={'title': {'text': 'height, &#181;m'}, 'thickness': 12},
            hovertemplate='%{x:.2f}, %{y:.2f} mm: %{z:.2f} um<extra></extra>',
        )
    )
    own = {'xaxis_constrain': 'domain', 'yaxis_scaleanchor': 'x', 'hovermode': 'closest'}
    titles = {'xaxis_title': 'along u (mm)', 'yaxis_title': 'along v (mm)'}
    return html.laid_out(figure, 560, **titles, **own)


def thinned(values: FloatArray, skip: int) -> FloatArray:
    """Reduce a map to cells of skip x skip values; a cell keeps the value farthest from zero."""
    if skip == 1:
        return values
    rows, columns = (-(-n // skip) * skip for n in values.shape)
    padded = np.full((rows, columns), np.nan)
    padded[: values.shape[0], : values.shape[1]] = values
    cells = padded.reshape(rows // skip, skip, columns // skip, skip).swapaxes(1, 2)
    flat = cells.reshape(rows // skip, columns // skip, -1)
    size = np.where(np.isnan(flat), -1.0, np.abs(flat))
    pick = np.argmax(size, axis=2)[:, :, None]
    return np.asarray(np.take_along_axis(flat, pick, axis=2)[:, :, 0])


def section_figure(section: Section, scallop: float) -> Any:
    row = section.height[len(section.height) // 2] / UM
    figure = go.Figure(
        go.Scatter(
            x=html.rounded(section.way / MM),
            y=html.rounded(row),
            name='height',
            line={'color': html.BLUE, 'width': 1.2},
        )
    )
    figure.add_hline(scallop / UM, line={'color': html.RED, 'width': 1.0, 'dash': 'dash'})
    titles = {'xaxis_title': 'across the passes (mm)', 'yaxis_title': 'height (&#181;m)'}
    return html.laid_out(figure, 300, showlegend=False, **titles)


def tilt_figure(paths: IsoScallopPaths) -> Any:
    figure = go.Figure()
    chosen = np.unique(np.linspace(0, len(paths.passes) - 1, CURVES).astype(int))
    for k in chosen:
        made = paths.passes[k]
        tilt = made.postures.tilt / DEG
        figure.add_trace(
            go.Scatter(
                x=html.rounded(made.s / made.curve.length),
                y=html.rounded(tilt),
                name=f'pass {k + 1}',
                line={'width': 1.5},
            )
        )
    return html.laid_out(figure, 380, xaxis_title='along the pass (-)', yaxis_title='tilt (deg)')


def path_figure(paths: Strips) -> Any:
    figure = go.Figure()
    gap = np.full((1, 3), np.nan)
    lines, axes = [], []
    for made in paths.passes:
        contact = made.postures.contact / MM
        lines += [contact, gap]
        for i in range(0, len(contact), 4):
            axes += [contact[i : i + 1], contact[i : i + 1] + 3.0 * made.postures.axis[i], gap]
    for points, name, style in (
        (np.vstack(lines), 'contact', {'color': html.BLUE, 'width': 3}),
        (np.vstack(axes), 'tool axis', {'color': '#9aa5b1', 'width': 1}),
    ):
        figure.add_scatter3d(
            **html.xyz(points), mode='lines', name=name, line=style, hoverinfo='skip'
        )
    figure.update_layout(html.base_layout(520), scene={'aspectmode': 'data'})
    return figure


def write_page(file: Path, title: str, facts: str, figures: list[tuple[str, str, Any]]) -> None:
    parts = [f'<h1>{escape(title)}</h1><section><pre>{escape(facts)}</pre></section>']
    for heading, text, figure in figures:
        parts.append(html.section(escape(heading), escape(text), html.drawing(figure)))
    html.write(file, title, ''.join(parts), f' pre {{ color: {html.INK}; }}')
