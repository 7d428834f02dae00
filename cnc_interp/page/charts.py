"""Live charts: feed against its limit, and the axes' use of their limits."""

import time
from itertools import cycle
from typing import Any

import numpy as np
from nicegui import ui

from cnc_interp.client.length_unit import LengthUnit
from cnc_interp.page.desk import KINDS, SPAN, Desk, Moment
from cnc_interp.page.readings import ShownUnit

INK, GRID = '#93a3af', '#26323b'
FEED, ASKED, LIMIT = '#4cc38a', '#e6edf3', '#f0a33c'
#: Colours of the axes in order. They repeat if a machine has more axes.
AXES = ('#5aa9e6', '#f0a33c', '#4cc38a', '#e06c9f', '#b48ef0', '#c9b458')
#: Limits on straight lines and rapids are far above the rest: the chart ends this much above
#: the feed and what is mostly programmed.
HEADROOM = 1.5


class Charts:
    def __init__(self, axis_names: tuple[str, ...], unit: ShownUnit):
        names = (('feed', FEED), ('programmed', ASKED), ('axes allow', LIMIT))
        self._unit = unit
        self._feed = chart('', names, None)
        self._entitle(unit.now)
        unit.follow(self._entitle)
        axes = tuple(zip(axis_names, cycle(AXES), strict=False))
        self._use = [chart(f'{kind} %', axes, 110) for kind in KINDS]

    def _entitle(self, unit: LengthUnit) -> None:
        self._feed.options['title']['text'] = unit.named('feed, mm/min')
        self._feed.update()

    def show(self, desk: Desk) -> None:
        now = time.monotonic()
        moments = [m for m in list(desk.history) if m.time >= now - SPAN]
        asked = [m.programmed for m in moments if np.isfinite(m.programmed)]
        plan = desk.job.plan if desk.job is not None else None
        planned = plan.usual_feed if plan is not None else 0.0
        usual = float(np.median(asked)) if asked else planned
        cutting = [m.feed for m in moments if m.programmed <= HEADROOM * usual]
        fast = cutting if usual > 0.0 else [m.feed for m in moments]
        ceiling = HEADROOM * max([usual, *fast], default=0.0)
        shown = self._unit.now.per_minute
        columns = [
            [shown(min(getattr(m, name), ceiling)) for m in moments]
            for name in ('feed', 'programmed', 'limit')
        ]
        draw(self._feed, moments, now, columns)
        for k, one in enumerate(self._use):
            count = moments[-1].use.shape[1] if moments else 0
            draw(one, moments, now, [[100.0 * m.use[k, j] for m in moments] for j in range(count)])


def chart(title: str, names: tuple[tuple[str, str], ...], top: float | None) -> Any:
    small = {'fontSize': 10, 'color': INK}
    axis = {'axisLabel': small, 'splitLine': {'lineStyle': {'color': GRID}}}
    options = {
        'animation': False,
        'title': {'text': title, 'left': 8, 'top': 4, 'textStyle': {**small, 'fontSize': 11}},
        'legend': {
            'left': 6, 'top': 18, 'icon': 'roundRect', 'itemWidth': 7, 'itemHeight': 7,
            'textStyle': small, 'itemGap': 7,
        },
        'grid': {'left': 40, 'right': 10, 'top': 44, 'bottom': 20},
        'xAxis': {**axis, 'type': 'value', 'min': -SPAN, 'max': 0},
        'yAxis': {**axis, 'type': 'value', 'min': 0, 'splitNumber': 3},
        'series': [
            {
                'name': name, 'type': 'line', 'showSymbol': False, 'data': [],
                'lineStyle': {'width': 1.4, 'color': colour}, 'itemStyle': {'color': colour},
            }
            for name, colour in names
        ],
    }  # fmt: skip
    if top is not None:
        options['yAxis']['max'] = top  # type: ignore[index]
    return ui.echart(options).classes('chart')


def draw(one: Any, moments: list[Moment], now: float, columns: list[list[float]]) -> None:
    times = [round(m.time - now, 1) for m in moments]
    values = ([round(y, 1) if y == y else None for y in column] for column in columns)
    series = [{'data': list(zip(times, column, strict=True))} for column in values]
    one.run_chart_method('setOption', {'series': series})
