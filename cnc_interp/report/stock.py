"""The stock in the report: removal rates, and the remaining stock against the part."""

from __future__ import annotations

from typing import Any

import numpy as np
import plotly.graph_objects as go

from cnc_interp.core import MM, FloatArray
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.report import html

STEPS, SHORTEST = 400, 0.05  #: Most intervals for mean rates; shortest interval [s].


def removal_rates(plan: PlanFiles) -> tuple[FloatArray, FloatArray]:
    """Return the middles of intervals of time [s], and the removal rate in each [m3/s]."""
    s, time = np.asarray(plan.setpoints['s']), np.asarray(plan.setpoints['time'])
    begin, end, removed = (np.asarray(plan.removal[key]) for key in ('begin', 'end', 'removed'))
    here = end > s[0]  # earlier pieces were cut before the start
    sums = np.cumsum(removed[here])
    at = np.interp(np.column_stack([begin, end])[here], s, time).ravel()
    volume = np.column_stack([np.append(0.0, sums[:-1]), sums]).ravel()
    count = int(np.clip((time[-1] - time[0]) / SHORTEST, 1, STEPS))
    edges = np.linspace(time[0], time[-1], count + 1)
    found = np.interp(edges, np.maximum.accumulate(at), volume) if len(at) else np.zeros(count + 1)
    return 0.5 * (edges[:-1] + edges[1:]), np.diff(found) / np.diff(edges)


def stock_section(plan: PlanFiles) -> str:
    """Return the section of a plan whose scene has a stock; '' for other plans."""
    found: Any = plan.summary.get('collision')
    told = found.get('stock') if isinstance(found, dict) else None
    if not plan.removal or not isinstance(told, dict):
        return ''
    time, rate = removal_rates(plan)
    figure = go.Figure()
    figure.add_scatter(
        x=html.rounded(time),
        y=html.rounded(rate / MM**3),
        line={'color': html.BLUE, 'width': 1.6},
        hovertemplate='%{y:.1f} mm³/s<extra></extra>',
    )
    figure.update_xaxes(title_text='time (s)')
    figure.update_yaxes(title_text='removal rate (mm³/s)', rangemode='tozero')
    rows = [
        ('removed', f'{told["removed"] / MM**3:,.1f} of {told["volume"] / MM**3:,.1f} mm³'),
        ('highest rate', f'{rate.max() / MM**3:,.1f} mm³/s in {time[0] * 2.0:.3g} s'),
    ]
    rows += [
        (f'{name} against the part', f'{told[name] / MM:.3f} mm at most')
        for name in ('excess', 'gouge')
        if name in told
    ]
    text = f'The stock is cut on a grid of {told["grid"] / MM:g} mm.'
    content = html.drawing(html.laid_out(figure, 280)) + html.table(('stock', 'value'), rows)
    return html.section('Material removed', text, content + _rest(plan))


def _rest(plan: PlanFiles) -> str:
    """Return a drawing of the part, coloured by the excess material; '' without a part."""
    if not plan.rest:
        return ''
    place, excess = (np.asarray(plan.rest[key]) / MM for key in ('place', 'excess'))
    most = float(np.abs(excess).max()) or 1.0
    marker = {
        'size': 2.5,
        'color': html.rounded(excess),
        'colorscale': 'RdBu',
        'reversescale': True,
        'cmin': -most,
        'cmax': most,
        'colorbar': {'title': 'excess (mm)'},
    }
    figure = go.Figure()
    x, y, z = (html.rounded(column) for column in place.T)
    figure.add_scatter3d(
        x=x,
        y=y,
        z=z,
        mode='markers',
        marker=marker,
        hovertemplate='%{marker.color:.3f} mm<extra></extra>',
    )
    figure.update_scenes(aspectmode='data')
    return html.drawing(html.laid_out(figure, 480))
