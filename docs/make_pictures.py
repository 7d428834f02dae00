"""Draw the first picture of the README from a plan directory: the tool path and the five axes.

    cnc-interp plan examples/pyramid.apt --feed 3000 --out out/pyramid
    python docs/make_pictures.py out/pyramid

writes ``docs/pictures/five_axes.png``. Needs matplotlib (made with 3.11) beside the package.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from cnc_interp.core import DEG, MM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.plan_files import PlanFiles, read_plan
from cnc_interp.report.series import Series, extremes, series_of

PICTURES = Path(__file__).parent / 'pictures'
INK, QUIET, GRID, BLUE, ORANGE = '#22303c', '#9aa5b1', '#e6eaee', '#1f6fb2', '#e08a1e'
#: Tool axes that are drawn along the path, and points of a curve.
SPOKES, POINTS = 90, 3000
STYLE = {
    'font.family': 'DejaVu Sans',
    'font.size': 9,
    'text.color': INK,
    'axes.labelcolor': INK,
    'xtick.color': INK,
    'ytick.color': INK,
    'axes.edgecolor': '#c3cad1',
    'axes.grid': True,
    'grid.color': GRID,
    'axes.axisbelow': True,
    'axes.spines.top': False,
    'axes.spines.right': False,
    'legend.frameon': False,
}


def draw_path(series: Series, figure: Any, elevation: float, azimuth: float) -> None:
    """Draw the tool path coloured by feedrate, with the tool axes."""
    rows = extremes(series.feed, POINTS)
    tip, feed = series.tip[rows], series.feed[rows]
    axes = figure.add_axes((-0.04, 0.06, 0.56, 0.98), projection='3d')
    way = np.linspace(series.way[0], series.way[-1], SPOKES)
    feet = np.unique(np.searchsorted(series.way, way).clip(0, len(series.way) - 1))
    length = 0.28 * float(np.ptp(series.tip, axis=0).max())
    spokes = np.stack([series.tip[feet], series.tip[feet] + length * series.axis[feet]], axis=1)
    axes.add_collection3d(Line3DCollection(spokes, colors=QUIET, linewidths=0.8))
    pieces = Line3DCollection(
        np.stack([tip[:-1], tip[1:]], axis=1), cmap='viridis', linewidths=2.6, capstyle='round'
    )
    pieces.set_array(0.5 * (feed[1:] + feed[:-1]))
    pieces.set_clim(0.0, float(series.feed.max()))
    axes.add_collection3d(pieces)
    shown = np.concatenate([tip, spokes.reshape(-1, 3)])
    low, high = shown.min(axis=0), shown.max(axis=0)
    span = np.maximum(high - low, 0.05 * (high - low).max())
    axes.set(xlim=(low[0], low[0] + span[0]), ylim=(low[1], low[1] + span[1]))
    axes.set(zlim=(low[2], low[2] + span[2]), xlabel='x (mm)', ylabel='y (mm)', zlabel='z (mm)')
    axes.set_box_aspect(span, zoom=0.8)
    axes.view_init(elevation, azimuth)
    for side, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), span / span.max(), strict=True):
        side.set_pane_color('white')
        side.set_major_locator(MaxNLocator(nbins=5 if share > 0.3 else 2))
    bar = figure.colorbar(
        pieces, cax=figure.add_axes((0.07, 0.09, 0.34, 0.022)), orientation='horizontal'
    )
    bar.set_label('feedrate of the tool tip (mm/min); grey: tool axes')
    bar.outline.set_visible(False)


def draw_axes(plan: PlanFiles, series: Series, figure: Any) -> None:
    """Draw the position of every axis over time, and how much of its limits it uses."""
    count = len(series.axis_names)
    panels = figure.add_gridspec(
        count, 1, left=0.61, right=0.945, bottom=0.1, top=0.93, hspace=0.22
    ).subplots(sharex=True)
    for k, (panel, name, unit) in enumerate(
        zip(panels, series.axis_names, series.axis_units, strict=True)
    ):
        position = plan.position[:, k] / (MM if unit == 'mm' else DEG)
        use = 100.0 * np.abs(series.axis_use[:, :, k]).max(axis=0)
        rows = extremes(np.column_stack([position, use]), POINTS)
        beside = panel.twinx()
        beside.fill_between(series.time[rows], use[rows], color=ORANGE, alpha=0.28, lw=0)
        beside.set(ylim=(0, 105), yticks=[0, 100])
        beside.tick_params(axis='y', colors=ORANGE, labelsize=7)
        beside.grid(visible=False)
        panel.plot(series.time[rows], position[rows], color=BLUE, lw=1.6)
        panel.set_ylabel(f'{name} ({unit})')
        panel.set_zorder(beside.get_zorder() + 1)
        panel.patch.set_visible(False)
        panel.yaxis.set_major_locator(MaxNLocator(nbins=3))
    panels[0].set_title(
        'position of each axis, and the use of its busiest limit in % (orange)',
        fontsize=9,
    )
    panels[-1].set(xlabel='time (s)', xlim=(series.time[0], series.time[-1]))
    figure.align_ylabels(panels)


def main() -> None:
    """Read the arguments and draw."""
    parser = argparse.ArgumentParser(description='Draw the first picture of the README.')
    parser.add_argument('directory', type=Path, help='folder with plan files')
    parser.add_argument('--elevation', type=float, default=28.0, help='of the eye [deg]')
    parser.add_argument('--azimuth', type=float, default=-58.0, help='of the eye [deg]')
    options = parser.parse_args()
    plan = read_plan(options.directory).in_memory()
    series = series_of(plan, Machine.load(str(plan.summary['machine'])))
    mpl.use('agg')
    with mpl.rc_context(STYLE):
        figure = plt.figure(figsize=(10.4, 5.2))
        draw_path(series, figure, options.elevation, options.azimuth)
        draw_axes(plan, series, figure)
        figure.savefig(PICTURES / 'five_axes.png', dpi=130)


if __name__ == '__main__':
    main()
