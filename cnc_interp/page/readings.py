"""Texts of a page: figures in shop-floor terms and in the page's unit of length, and messages."""

import math
from collections.abc import Callable
from html import escape
from itertools import cycle
from typing import Any

import numpy as np
from nicegui import ui

from cnc_interp.client.alarms import Alarm, AlarmList
from cnc_interp.client.length_unit import MILLIMETRES, LengthUnit
from cnc_interp.client.operator_client import MachineState
from cnc_interp.core import MS, UM
from cnc_interp.machine_model.machine import Machine
from cnc_interp.page.contact import key
from cnc_interp.page.desk import KINDS, SPAN, Desk, Moment
from cnc_interp.page.preview import Preview
from cnc_interp.program.job import JobSetup
from cnc_interp.wire.run_messages import state_of

NOTHING = '–'
AT_LINE_END = 2e-6  #: A tool tip this near to the end of its line counts as resting there [m].


def readings(desk: Desk, unit: LengthUnit) -> dict[str, str]:
    state, machine = desk.nodes.state, desk.machine
    silent = desk.nodes.silent
    words = {'state': 'no machine', 'why': f'waiting for {silent}' if silent else ''}
    if state is None or machine is None:
        return words
    words |= axis_words(state, machine, unit) | work_words(state, machine, desk.setup.setup, unit)
    words |= feed_words(desk, state, unit)
    job, override = desk.job, desk.nodes.override_of('feed_override')
    if job is not None and not desk.shows_run(state):
        words |= words_before_start(job.plan, override)
    else:
        plan, start = desk.plan_of(state), desk.start_position()
        words |= progress_words(state, plan, override, start, unit)
    words['state'] = 'no answer' if silent else state_of(state).value
    words['why'] = f'{silent} does not answer' if silent else why_text(desk, state, unit)
    words['buffer'] = f'{state.buffered_time / MS:.0f} ms'
    least = state.least_buffered_time
    words['least'] = NOTHING if math.isnan(least) else f'{least / MS:.0f} ms'
    words['missed'] = str(state.starvations)
    words['contour'] = f'{state.contour_error / UM:.1f} µm'
    words['largest contour'] = f'{state.largest_contour_error / UM:.1f} µm'
    without = desk.nodes.uncompensated
    words['uncompensated'] = NOTHING if without is None else f'{without / UM:.1f} µm'
    return words


def why_text(desk: Desk, state: MachineState, unit: LengthUnit) -> str:
    """Return the reason for the machine's state; after a single block also where it rests."""
    if (tool := desk.nodes.tool_wanted) is not None:
        return change_text(tool, desk.setup.setup, unit)
    off = desk.nodes.off_line_end
    if state.reason != MachineState.REASON_SINGLE_BLOCK or off is None:
        return str(state.message or desk.nodes.waits_for)
    where = f'rests at the end of line {state.line_number}'
    if off > AT_LINE_END:
        where = (
            f'rests {unit.length(off)} {unit.name} beside the end of line {state.line_number}, '
            'inside its rounded corner'
        )
    return f'single block: {where}; cycle start executes the next line'


def change_text(number: int, setup: JobSetup, unit: LengthUnit) -> str:
    """Return the operator's task at a tool change without a tool changer."""
    if not number:
        return 'take the tool out of the spindle, then press cycle start'
    tool = setup.tools.get(number)
    what = f'put tool {number} into the spindle'
    if tool is None:
        return (
            f'{what}, then press cycle start. Its length is not known: type it under '
            'offsets, touch the tool off, or measure it before a program uses it'
        )
    told = [tool.remark, f'length {unit.length(tool.worn.length)} {unit.name}']
    told += [f'pocket {tool.pocket}'] * bool(tool.pocket)
    return f'{what}: {", ".join(filter(None, told))}. Then press cycle start'


def axis_words(state: MachineState, machine: Machine, unit: LengthUnit) -> dict[str, str]:
    words = {
        f'axis {name}': unit.shown(name, value)
        for name, value in zip(machine.axis_names, state.positions, strict=False)
    }
    for name, tip, axis in zip('xyz', state.tip, state.axis, strict=True):
        words[f'tip {name}'] = unit.length(tip)
        words[f'tool {name}'] = f'{axis:+z.5f}'
    return words


def work_words(
    state: MachineState, machine: Machine, setup: JobSetup, unit: LengthUnit
) -> dict[str, str]:
    """Return the program coordinates as text, and their name."""
    names = (*machine.program_names, *machine.extra_names)
    reads = list(state.program_positions) or [math.nan] * len(names)
    words = {
        f'work {name}': unit.shown(name, value) if math.isfinite(value) else NOTHING
        for name, value in zip(names, reads, strict=False)
    }
    tool = f'tool {setup.tool}' if setup.tool else 'no tool'
    words['setup'] = f'{state.coordinates}, {tool}' if state.coordinates else NOTHING
    return words


def feed_words(desk: Desk, state: MachineState, unit: LengthUnit) -> dict[str, str]:
    programmed, _ = desk.feeds(state)
    return {
        'feed': unit.feed(state.feedrate),
        'programmed': unit.feed(programmed) if math.isfinite(programmed) else NOTHING,
        'spindle': spindle_text(state),
    }


def spindle_text(state: MachineState) -> str:
    """Return the speed of the spindle, and with an encoder also its angle."""
    if not state.spindle_speed and math.isnan(state.spindle_angle):
        return NOTHING
    turn = state.spindle_angle % 1  # NaN without an encoder
    angle = '' if math.isnan(turn) else f', {360.0 * turn:.0f}°'
    return f'{state.spindle_speed:.0f} rev/min{angle}'


def progress_words(
    state: MachineState,
    plan: Preview | None,
    override: float,
    start: float = 0.0,
    unit: LengthUnit = MILLIMETRES,
) -> dict[str, str]:
    """Return line, progress and times, assuming that the override stays as it is."""
    words = {'line': str(state.line_number) if state.line_number else NOTHING}
    words['progress'] = words['left'] = words['to go'] = NOTHING
    if plan is not None:
        s = state.path_position
        place = plan.at(start if s <= 0.0 else s)
        words['progress'] = f'{progress(state, plan):.1%}'
        words['left'] = time_at(plan.cycle_time - place.time, override)
        words['to go'] = unit.length(-s if s < 0.0 else max(0.0, place.block_end - s))
    words['elapsed'] = clock(state.samples * state.interpolation_period)
    return words


def words_before_start(plan: Preview | None, override: float) -> dict[str, str]:
    words = dict.fromkeys(('line', 'progress', 'to go', 'elapsed', 'left'), NOTHING)
    if plan is not None:
        words['left'] = time_at(plan.cycle_time, override)
    return words


def time_at(seconds: float, override: float) -> str:
    return clock(seconds / override) if override > 0.0 else NOTHING


def progress(state: MachineState, plan: Preview | None) -> float:
    if plan is None:
        return 0.0
    return 1.0 if state.completed else min(1.0, max(0.0, state.path_position / plan.length))


def clock(seconds: float) -> str:
    minutes, rest = divmod(max(0.0, seconds), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f'{hours}:{minutes:02d}:{rest:04.1f}' if hours else f'{minutes}:{rest:04.1f}'


def alarms_html(alarms: list[Alarm]) -> str:
    return ''.join(
        f'<p class="{alarm.level}">{alarm.time} {escape(alarm.message)}'
        + (f' <b>({alarm.count} times)</b></p>' if alarm.count > 1 else '</p>')
        for alarm in alarms
    )


def history_text(alarms: list[Alarm]) -> str:
    return ''.join(
        f'{alarm.time}  {alarm.level:<8}{alarm.source}: {alarm.message}  ({alarm.count})\n'
        for alarm in reversed(alarms)
    )


WEIGHTS = ('error', 'warning', 'notice')  #: Levels of messages, most urgent first.
SHOWN = 30  #: Messages shown beside the program.


class Messages:
    def __init__(self, alarms: AlarmList):
        self._alarms = alarms
        self._shown: list[Alarm] | None = None
        with ui.dialog() as self._dialog, ui.card().classes('settings'):
            ui.label('messages, the newest first').classes('title')
            self._history = ui.html('', sanitize=False).classes('history')
            with ui.element('div').classes('ends'):
                key('save', 'save messages', self._save)
                key('close', 'close messages', self._dialog.close)
        with ui.element('div').classes('title messages'):
            ui.label('messages').classes('heading grow')
            key('history', 'history messages', self._open)
            key('clear', 'clear messages', alarms.clear)
        self._list = ui.html('', sanitize=False).classes('alarms')

    def _open(self) -> None:
        self._history.set_content(alarms_html(self._alarms.history) or '<p>none</p>')
        self._dialog.open()

    def _save(self) -> None:
        ui.download(history_text(self._alarms.history).encode(), 'cnc_interp_messages.txt')

    def show(self) -> None:
        alarms = sorted(self._alarms.newest_first, key=lambda a: WEIGHTS.index(a.level))[:SHOWN]
        if alarms != self._shown:
            self._shown = alarms
            self._list.set_content(alarms_html(alarms))


class ShownUnit:
    def __init__(self) -> None:
        self.now = self.before = MILLIMETRES
        #: Texts of the page's fields when the unit was chosen, by their marks.
        self.texts: dict[str, str] = {}
        self._followers: list[Callable[[LengthUnit], None]] = []

    def follow(self, act: Callable[[LengthUnit], None]) -> None:
        self._followers.append(act)

    def label(self, text: str) -> Any:
        label = ui.label(self.now.named(text))
        self.follow(lambda unit: label.set_text(unit.named(text)))
        return label

    def use(self, unit: LengthUnit, texts: dict[str, str]) -> None:
        if unit is not self.now:
            self.before, self.now, self.texts = self.now, unit, texts
            for act in self._followers:
                act(unit)


INK, GRID = '#93a3af', '#26323b'
FEED, ASKED, LIMIT = '#4cc38a', '#e6edf3', '#f0a33c'
#: Colours of the axes in order. They repeat if a machine has more axes.
AXES = ('#5aa9e6', '#f0a33c', '#4cc38a', '#e06c9f', '#b48ef0', '#c9b458')
#: Limits on straight lines and rapids are far above the rest, so the chart ends at this multiple
#: of the feed and the usual programmed feed [-].
HEADROOM = 1.5


class Charts:
    def __init__(self, axis_names: tuple[str, ...], unit: ShownUnit):
        names = (('feed', FEED), ('programmed', ASKED), ('limit', LIMIT))
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
        kept = list(desk.history)
        now = kept[-1].time if kept else 0.0
        moments = [m for m in kept if m.time >= now - SPAN]
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
            'left': 6,
            'top': 18,
            'icon': 'roundRect',
            'itemWidth': 7,
            'itemHeight': 7,
            'textStyle': small,
            'itemGap': 7,
        },
        'grid': {'left': 40, 'right': 10, 'top': 44, 'bottom': 20},
        'xAxis': {**axis, 'type': 'value', 'min': -SPAN, 'max': 0, 'interval': 10},
        'yAxis': {**axis, 'type': 'value', 'min': 0, 'splitNumber': 3},
        'series': [
            {
                'name': name,
                'type': 'line',
                'showSymbol': False,
                'data': [],
                'lineStyle': {'width': 1.4, 'color': colour},
                'itemStyle': {'color': colour},
            }
            for name, colour in names
        ],
    }
    if top is not None:
        options['yAxis'] |= {'max': top, 'axisLabel': {**small, 'showMaxLabel': False}}  # type: ignore[operator]
    return ui.echart(options).classes('chart')


def draw(one: Any, moments: list[Moment], now: float, columns: list[list[float]]) -> None:
    times = [round(m.time - now, 1) for m in moments]
    values = ([round(y, 1) if y == y else None for y in column] for column in columns)
    series = [{'data': list(zip(times, column, strict=True))} for column in values]
    one.run_chart_method('setOption', {'series': series})
