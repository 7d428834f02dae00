"""Clearances in the report: the smallest distance over time and of each pair, and every hit."""

from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go

from cnc_interp.collision.drawing import rim_points
from cnc_interp.collision.hits import bodies_apart
from cnc_interp.collision.link_poses import pose_links
from cnc_interp.collision.path_clearance import space_of
from cnc_interp.collision.scene import Placed
from cnc_interp.collision.scene_file import read_scene
from cnc_interp.core import MM, FloatArray
from cnc_interp.machine_model.machine import Machine
from cnc_interp.proof.clearance import stock_is_cut, tools_at
from cnc_interp.proof.plan_files import PlanFiles
from cnc_interp.report import html
from cnc_interp.report.series import Series

PLACES, PAIRS, PICTURES = 400, 12, 12  #: Most setpoints, pairs and hits that are shown.


def clearance_section(plan: PlanFiles, machine: Machine, series: Series) -> str:
    """Return the section about clearances; '' if the plan has no scene or no clearance check."""
    file = Path(str(plan.settings.get('scene') or ''))
    if not plan.collision or not file.name:
        return ''
    placed = Placed.of(read_scene(file, str(plan.summary.get('setup') or '')), machine)
    rows = np.unique(np.linspace(0, len(plan.position) - 1, PLACES).astype(int))
    pairs = [pair for pair in placed.pairs if placed.scene.in_feed(*pair)]
    pairs = [pair for pair in pairs if not stock_is_cut(placed, *pair)]
    if not pairs:
        return ''
    apart = distances(placed, machine, plan, pairs, rows) / MM
    bodies = placed.scene.bodies
    names = [f'{bodies[a].name} and {bodies[b].name}' for a, b in pairs]
    text = (
        'The figure shows the distances between the bodies of the scene at {} setpoints; the '
        'check also covers the motion between them.'
    )
    content = html.drawing(_over_time(series, rows, apart, names))
    content += _table(placed, series, rows, apart, pairs, names)
    pictures = [
        html.drawing(_picture(placed, plan, int(row))) for row in _hits(placed, plan)[:PICTURES]
    ]
    content += ''.join(pictures)
    return html.section('Clearances', text.format(len(rows)), content)


def _hits(placed: Placed, plan: PlanFiles) -> list[int]:
    """Return the rows of hits, without hits of a stock that is cut along the path."""
    pair = placed.pieces.body[plan.collision['pair']]
    hits = np.flatnonzero(plan.collision['hit']).tolist()
    return [row for row in hits if not stock_is_cut(placed, *pair[row])]


def distances(
    placed: Placed, machine: Machine, plan: PlanFiles, pairs: list[tuple[int, int]], rows: Any
) -> FloatArray:
    """Return distances of pairs of bodies at setpoints, (rows, pairs) [m]; NaN if not there."""
    tool = tools_at(plan, machine.signals, placed.scene.first_tool, plan.block[rows])
    found, space = np.full((len(rows), len(pairs)), np.nan), space_of(placed)
    pose = np.empty((len(placed.names), 12))
    tables = [
        np.array([(p, q) for p in placed.roots(a) for q in placed.roots(b)]) for a, b in pairs
    ]
    owners = [placed.scene.bodies[a].tool or placed.scene.bodies[b].tool for a, b in pairs]
    for i, row in enumerate(rows):
        pose_links(placed.chain, plan.position[row], pose)
        for j, table in enumerate(tables):
            if owners[j] in (0, tool[i]):
                found[i, j] = bodies_apart(space, table, pose)
    return found


def _over_time(series: Series, rows: Any, apart: FloatArray, names: list[str]) -> Any:
    figure = go.Figure()
    least = np.where(np.isnan(apart), np.inf, apart)
    nearest = least.argmin(axis=1)
    figure.add_scatter(
        x=html.rounded(series.time[rows]),
        y=html.rounded(least.min(axis=1)),
        line={'color': html.BLUE, 'width': 1.6},
        text=[escape(names[k]) for k in nearest],
        hovertemplate='%{y:.3f} mm, %{text}<extra></extra>',
    )
    figure.update_xaxes(title_text='time (s)')
    figure.update_yaxes(title_text='smallest distance (mm)', rangemode='tozero')
    return html.laid_out(figure, 320)


def _table(
    placed: Placed,
    series: Series,
    rows: Any,
    apart: FloatArray,
    pairs: list[tuple[int, int]],
    names: list[str],
) -> str:
    least = np.nan_to_num(apart, nan=np.inf).min(axis=0)
    lines = []
    for k in np.argsort(least, kind='stable')[:PAIRS]:
        if not np.isfinite(least[k]):
            continue
        row = rows[int(np.nanargmin(apart[:, k]))]
        allowed = placed.clearance[pairs[k]] / MM
        at = f'{series.time[row]:.3f} s, line {series.line[row]}'
        lines.append((escape(names[k]), f'{least[k]:.3f} mm', f'{allowed:g} mm', at))
    return html.table(('pair', 'smallest distance', 'clearance', 'at'), lines)


def _picture(placed: Placed, plan: PlanFiles, row: int) -> Any:
    """Draw both pieces of a hit in the machine frame."""
    grid = np.asarray(plan.setpoints['s'])
    begin = float(plan.collision['begin'][row])
    at = int(np.clip(np.searchsorted(grid, begin), 0, len(grid) - 1))
    pose = np.empty((len(placed.names), 12))
    pose_links(placed.chain, plan.position[at], pose)
    pieces, figure = placed.pieces, go.Figure()
    names = [placed.piece_name(int(k)) for k in plan.collision['pair'][row]]
    for k, colour, name in zip(
        plan.collision['pair'][row], (html.RED, html.ORANGE), names, strict=True
    ):
        link = pose[pieces.link[k]]
        points = rim_points(
            pieces.disc[pieces.first[k] : pieces.first[k + 1]], pieces.along[k], pieces.round[k]
        )
        places = points @ link[:9].reshape(3, 3).T + link[9:]
        figure.add_mesh3d(
            **html.xyz(places / MM), alphahull=0, color=colour, opacity=0.6, name=escape(name)
        )
    line = int(plan.blocks['line'][plan.block[at]])
    figure.update_layout(
        html.base_layout(420),
        title={'text': f'line {line}: {escape(" and ".join(names))}', 'font': {'size': 13}},
        scene={'aspectmode': 'data'},
    )
    return figure
