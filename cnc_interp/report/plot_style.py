"""Colours, axes and layout that all figures share."""

from __future__ import annotations

from typing import Any

import numpy as np

from cnc_interp.core.arrays import FloatArray

INK, GRID = '#22303c', '#e6eaee'
BLUE, ORANGE, RED = '#1f6fb2', '#e08a1e', '#c0392b'
FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif'
#: Buckets of thinned curves over the whole width; each keeps its extremes.
BUCKETS = 600
#: Largest ratio of the upper end of a feed axis to the feed: Eq. 10 is infinite on lines.
HEADROOM = 1.45


def base_layout(height: int) -> dict[str, Any]:
    """Return the layout that all figures share, of a height [px]."""
    return {
        'height': height,
        'template': 'none',
        'font': {'family': FONT, 'size': 12, 'color': INK},
        'paper_bgcolor': 'white',
        'plot_bgcolor': 'white',
        'margin': {'l': 70, 'r': 16, 't': 34, 'b': 46},
        'legend': {'orientation': 'h', 'x': 0.0, 'y': 1.0, 'yanchor': 'bottom'},
        'hovermode': 'x',
        'hoverlabel': {'font': {'family': FONT, 'size': 12}},
    }


def with_axes(figure: Any) -> Any:
    """Give a flat figure the axes that all figures share."""
    quiet = {'gridcolor': GRID, 'zerolinecolor': '#c3cad1', 'linecolor': '#c3cad1'}
    figure.update_xaxes(**quiet, ticks='outside', tickcolor='#c3cad1', title_standoff=6)
    figure.update_yaxes(**quiet, title_standoff=8)
    return figure


def xyz(points: FloatArray) -> dict[str, Any]:
    """Return points as the coordinates of a trace in space."""
    return {name: rounded(column) for name, column in zip('xyz', points.T, strict=True)}


def rounded(values: FloatArray) -> Any:
    """Return values, or columns of them, as lists with as many digits as a screen can show."""
    columns = np.atleast_2d(values.T)
    spread = np.ptp(np.where(np.isfinite(columns), columns, 0.0), axis=1)
    digits = np.clip(np.ceil(5.0 - np.log10(np.maximum(spread, 1e-9))), 0, 9).astype(int)
    kept = [np.round(column, most) for column, most in zip(columns, digits, strict=True)]
    return np.stack(kept, axis=-1).reshape(values.shape).tolist()
