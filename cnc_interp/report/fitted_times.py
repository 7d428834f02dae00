"""The page about fitted limits: values, measured and planned times, measured and planned feed."""

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from cnc_interp.core import MM_PER_MIN
from cnc_interp.machine_model.machine_entries import STOPS
from cnc_interp.report import html
from cnc_interp.report.series import extremes
from cnc_interp.run.time_fit import Fitted, Run


def value_text(value: float, half_width: float) -> str:
    return f'{value:.4g}' + (f' +- {half_width:.2g}' if np.isfinite(half_width) else '')


def time_rows(runs: Sequence[Run], found: Fitted) -> Iterator[tuple[str, str, str, str, str]]:
    """Yield trace, lines, measured and planned time of the motion between two functions."""
    for run, motion in zip(runs, found.motions, strict=True):
        measured, planned = run.measured, run.planned(motion)
        for first, last in run.stretches():
            lines = run.trace.line[[run.windows[first, 0], run.windows[last, 1]]]
            both = measured[first : last + 1].sum(), planned[first : last + 1].sum()
            yield (
                run.trace.name, f'{lines[0]} to {lines[1]}', f'{both[0]:.2f}', f'{both[1]:.2f}',
                f'{both[1] / both[0] - 1.0:+.2%}',
            )  # fmt: skip


def fitted_text(content: Mapping[str, Any], found: Fitted, names: Sequence[str]) -> str:
    """Return the text of a machine file with what was found, and its intervals as a comment."""
    whole: dict[str, Any] = dict(content)
    for key, (value, _) in found.values.items():
        *path, last = key.split('.')
        place = whole
        for part in path:
            place[part] = dict(place.get(part) or {})
            place = place[part]
        place[last] = float(f'{value:.6g}')
    assert found.machine.pace is not None
    whole['look_ahead'][STOPS] = found.machine.pace.stops_at_rapids
    told = [f'#   {key}: {value_text(*pair)}' for key, pair in found.values.items()]
    head = [f'# Fitted to {", ".join(names)}; intervals of 95 %:', *told]
    return '\n'.join([*head, yaml.safe_dump(whole, sort_keys=False, default_flow_style=None)])


def write_fitted(runs: Sequence[Run], found: Fitted, out: Path) -> None:
    values = [(escape(key), value_text(*pair)) for key, pair in found.values.items()]
    heads = 'record', 'lines', 'measured, s', 'planned, s', 'off'
    tables = html.table(('key of the machine file', 'value'), values) + html.table(
        heads, ([escape(cell) for cell in row] for row in time_rows(runs, found))
    )
    text = 'Values with intervals of 95 %, and times of the motion between two functions.'
    sections = [html.section('Fit', text, f'<div class="pair">{tables}</div>')]
    for run, motion in zip(runs, found.motions, strict=True):
        sections.append(html.section(
            escape(run.trace.name),
            'Feed that the control told, and feed of the plan, which begins with each stretch.',
            html.drawing(_feeds(run, motion)),
        ))  # fmt: skip
    out.parent.mkdir(parents=True, exist_ok=True)
    title = 'Run times of a machine'
    body = f'<h1>{title}</h1>' + ''.join(sections)
    out.write_text(html.document(title, body), encoding='utf-8')


def _feeds(run: Run, motion: Any) -> Any:
    from plotly.subplots import make_subplots

    figure = make_subplots(rows=1, cols=1)
    told = run.trace.feed
    kept = extremes(told[:, 1], html.BUCKETS) if len(told) else np.zeros(0, dtype=int)
    measured = {'color': html.BLUE, 'width': 1.2}
    time, feed = told[kept, 0], told[kept, 1] / MM_PER_MIN
    html.add_curve(figure, 1, time, feed, 'measured', measured, mode='lines')
    end = np.cumsum(motion.duration)
    for number, (first, last) in enumerate(run.stretches()):
        events = run.windows[first, 0], run.windows[last, 1]
        begin, finish = motion.until(run.trace.line[list(events)])
        rows = np.flatnonzero((end > begin) & (end <= finish))
        if not len(rows):
            continue
        rows = rows[extremes(motion.speed[rows], html.BUCKETS)]
        html.add_curve(
            figure, 1, end[rows] - motion.duration[rows] - begin + run.trace.time[events[0]],
            motion.speed[rows] / MM_PER_MIN, 'planned',
            {'color': html.ORANGE, 'width': 1.2, 'dash': 'dot'}, number == 0, mode='lines',
        )  # fmt: skip
    figure.update_xaxes(title_text='time [s]')
    figure.update_yaxes(title_text='feed [mm/min]')
    return html.laid_out(figure, 420)
