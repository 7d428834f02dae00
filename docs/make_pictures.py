"""
Draw the pictures of the README from a plan directory.

    cnc-interp plan examples/pyramid.apt --out out/pyramid
    python docs/make_pictures.py out/pyramid --name pyramid

writes ``docs/pictures/pyramid_path.png`` and ``docs/pictures/pyramid_feed.png``. Needs matplotlib
(made with 3.11) beside the package; nothing else in the project uses it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Line3DCollection

from cnc_interp.kinematics.machine import Machine
from cnc_interp.proof.plan_files import read_plan
from cnc_interp.report.figures import TOOL_LINES, feed_ceiling, feed_span
from cnc_interp.report.series import Series, extremes, series_of

PICTURES = Path(__file__).parent / 'pictures'
INK, QUIET, GRID, BLUE, ORANGE = '#22303c', '#9aa5b1', '#e6eaee', '#1f6fb2', '#e08a1e'
STYLE = {
    'font.family': 'DejaVu Sans', 'font.size': 9, 'text.color': INK, 'axes.labelcolor': INK,
    'xtick.color': INK, 'ytick.color': INK, 'axes.edgecolor': '#c3cad1', 'axes.grid': True,
    'grid.color': GRID, 'axes.axisbelow': True, 'axes.spines.top': False,
    'axes.spines.right': False, 'legend.frameon': False,
}  # fmt: skip


def draw_path(series: Series, file: Path, elevation: float, azimuth: float) -> None:
    """Draw the tool path coloured by feedrate, with some tool axes."""
    rows = extremes(series.feed, 3000)
    tip, feed = series.tip[rows], series.feed[rows]
    figure = plt.figure(figsize=(7.2, 4.2))
    axes = figure.add_axes((-0.07, -0.12, 1.0, 1.3), projection='3d')
    way = np.linspace(series.way[0], series.way[-1], TOOL_LINES // 2)
    feet = np.unique(np.searchsorted(series.way, way).clip(0, len(series.way) - 1))
    length = 0.09 * float(np.ptp(series.tip, axis=0).max())
    spokes = np.stack([series.tip[feet], series.tip[feet] + length * series.axis[feet]], axis=1)
    axes.add_collection3d(Line3DCollection(spokes, colors=QUIET, linewidths=0.7))
    top, title = feed_span(series)
    pieces = Line3DCollection(
        np.stack([tip[:-1], tip[1:]], axis=1), cmap='viridis', linewidths=2.2, capstyle='round'
    )
    pieces.set_array(0.5 * (feed[1:] + feed[:-1]))
    pieces.set_clim(0.0, top)
    axes.add_collection3d(pieces)
    shown = np.concatenate([tip, spokes.reshape(-1, 3)])
    low, high = shown.min(axis=0), shown.max(axis=0)
    span = np.maximum(high - low, 0.05 * (high - low).max())
    axes.set(xlim=(low[0], low[0] + span[0]), ylim=(low[1], low[1] + span[1]))
    axes.set(zlim=(low[2], low[2] + span[2]), xlabel='x (mm)', ylabel='y (mm)', zlabel='z (mm)')
    axes.set_box_aspect(span, zoom=0.98 - 0.25 * span[2] / span.max())
    axes.view_init(elevation, azimuth)
    for side, share in zip((axes.xaxis, axes.yaxis, axes.zaxis), span / span.max(), strict=True):
        side.set_pane_color('white')
        side.set_major_locator(MaxNLocator(nbins=5 if share > 0.3 else 1))
    bar = figure.colorbar(pieces, cax=figure.add_axes((0.9, 0.22, 0.018, 0.56)))
    bar.set_label(title.replace('<br>', ' '))
    bar.outline.set_visible(False)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def draw_feed(series: Series, file: Path) -> None:
    """Draw the feed over time beside the programmed one and Eq. 10, and the use of the axes."""
    figure, (upper, lower) = plt.subplots(
        2, 1, figsize=(7.2, 4.2), sharex=True, height_ratios=(3, 2), layout='constrained'
    )
    ceiling = feed_ceiling(series)
    columns = [series.feed, series.feed_limit, series.programmed_feed]
    table = np.minimum(np.column_stack(columns), ceiling)
    rows = extremes(table, 1500)
    time = series.time[rows]
    upper.plot(time, table[rows, 1], color=ORANGE, lw=1.0, label='limit of the axes (Eq. 10)')
    upper.plot(time, table[rows, 2], color=INK, lw=1.0, ls=':', label='programmed')
    upper.plot(time, table[rows, 0], color=BLUE, lw=1.8, label='planned')
    upper.set(ylabel='feed (mm/min)', ylim=(0, 1.02 * ceiling))
    upper.legend(loc='upper right', ncols=3, fontsize=8)
    use = np.abs(series.axis_use).max(axis=2).T
    rows = extremes(use, 1500)
    for k, (name, color) in enumerate((('velocity', BLUE), ('acceleration', '#2e7d4f'))):
        lower.plot(series.time[rows], 100 * use[rows, k], color=color, lw=1.0, label=name)
    lower.plot(series.time[rows], 100 * use[rows, 2], color='#8e44ad', lw=0.8, label='jerk')
    lower.axhline(100, color='#c0392b', lw=0.8, ls='--')
    lower.set(ylabel='busiest axis (%)', xlabel='time (s)', ylim=(0, 138), yticks=[0, 50, 100])
    lower.set_xlim(series.time[0], series.time[-1])
    lower.legend(loc='upper right', ncols=3, fontsize=8)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main() -> None:
    """Read the arguments and draw."""
    parser = argparse.ArgumentParser(description='Draw the pictures of the README.')
    parser.add_argument('directory', type=Path, help='folder with plan files')
    parser.add_argument('--name', help='beginning of the file names (default: the folder)')
    parser.add_argument('--machine', help='machine (default: the one of the plan)')
    parser.add_argument('--elevation', type=float, default=32.0, help='of the eye [deg]')
    parser.add_argument('--azimuth', type=float, default=-58.0, help='of the eye [deg]')
    options = parser.parse_args()
    plan = read_plan(options.directory)
    machine = Machine.load(options.machine or str(plan.summary['machine']))
    series = series_of(plan, machine)
    PICTURES.mkdir(exist_ok=True)
    name = options.name or options.directory.resolve().name
    mpl.use('agg')
    with mpl.rc_context(STYLE):
        draw_path(series, PICTURES / f'{name}_path.png', options.elevation, options.azimuth)
        draw_feed(series, PICTURES / f'{name}_feed.png')


if __name__ == '__main__':
    main()
