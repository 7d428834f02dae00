"""Numbers as words of the shop floor: what the read-outs of the page say."""

from __future__ import annotations

import math
from html import escape

from cnc_interp.client.alarms import Alarm
from cnc_interp.client.operator_client import MachineState
from cnc_interp.client.page.desk import Desk, Job
from cnc_interp.client.page.preview import Preview
from cnc_interp.core.units import MM, MM_PER_MIN, MS, UM
from cnc_interp.kinematics.machine import Machine
from cnc_interp.wire.machine_report import state_of

NOTHING = '–'
#: Lines of the program shown around the one that is executed.
BEFORE, AFTER = 9, 22


def readings(desk: Desk) -> dict[str, str]:
    """Return the text of every read-out by its name; what is unknown is a dash."""
    state, machine = desk.nodes.state, desk.machine
    silent = desk.nodes.silent
    words = {'state': 'no machine', 'why': f'waiting for {silent}' if silent else ''}
    if state is None or machine is None:
        return words
    words |= axis_words(state, machine) | feed_words(desk, state)
    words |= progress_words(state, desk.plan_of(state), desk.nodes.override)
    words['state'] = 'no answer' if silent else state_of(state).value
    words['why'] = f'{silent} does not answer' if silent else state.message
    words['buffer'] = f'{state.buffered_time / MS:.0f} ms'
    least = state.least_buffered_time
    words['least'] = NOTHING if math.isnan(least) else f'{least / MS:.0f} ms'
    words['missed'] = str(state.starvations)
    words['contour'] = f'{state.contour_error / UM:.1f} µm'
    return words


def axis_words(state: MachineState, machine: Machine) -> dict[str, str]:
    """Return machine axes, tool tip and tool axis."""
    words = {
        f'axis {axis.name}': axis.position_text(value)
        for axis, value in zip(machine.axes, state.positions, strict=False)
    }
    for name, tip, axis in zip('xyz', state.tip, state.axis, strict=True):
        words[f'tip {name}'] = f'{tip / MM:.3f}'
        words[f'tool {name}'] = f'{axis:+.5f}'
    return words


def feed_words(desk: Desk, state: MachineState) -> dict[str, str]:
    """Return actual and programmed feed and the override."""
    programmed, _ = desk.feeds(state)
    asked = f'{programmed / MM_PER_MIN:.0f}' if math.isfinite(programmed) else NOTHING
    return {
        'feed': f'{state.feedrate / MM_PER_MIN:.0f}',
        'programmed': asked,
        'override': f'{desk.nodes.override:.0%}',
    }


def progress_words(state: MachineState, plan: Preview | None, override: float) -> dict[str, str]:
    """Return line, progress and times; the time left assumes the override to stay."""
    words = {'line': str(state.line_number) if state.line_number else NOTHING}
    words['progress'] = words['left'] = NOTHING
    if plan is not None:
        words['progress'] = f'{progress(state, plan):.1%}'
        left = plan.cycle_time - plan.at(max(0.0, state.path_position))[2]
        words['left'] = clock(left / override) if override > 0.0 else NOTHING
    words['elapsed'] = clock(state.samples * state.interpolation_period)
    return words


def progress(state: MachineState, plan: Preview | None) -> float:
    """Return the share of the path that is executed."""
    if plan is None:
        return 0.0
    return 1.0 if state.completed else min(1.0, max(0.0, state.path_position / plan.length))


def clock(seconds: float) -> str:
    """Write a time as minutes and seconds, with hours where there are any."""
    minutes, rest = divmod(max(0.0, seconds), 60.0)
    hours, minutes = divmod(int(minutes), 60)
    return f'{hours}:{minutes:02d}:{rest:04.1f}' if hours else f'{minutes}:{rest:04.1f}'


def program_html(job: Job | None, line: int) -> str:
    """Return the lines around the one being executed, which is marked."""
    if job is None:
        return '<p>no program loaded</p>'
    if not job.lines:
        return '<p>the text is too long to be shown</p>'
    first = max(0, min(line - 1 - BEFORE, len(job.lines) - BEFORE - AFTER))
    rows = []
    for k in range(first, min(first + BEFORE + AFTER, len(job.lines))):
        mark = ' class="now"' if k == line - 1 else ''
        rows.append(f'<li{mark}><i>{k + 1}</i>{escape(job.lines[k][:200]) or "&nbsp;"}</li>')
    return f'<ol>{"".join(rows)}</ol>'


def alarms_html(alarms: list[Alarm]) -> str:
    """Return alarms as paragraphs."""
    return ''.join(
        f'<p class="{alarm.level}">{alarm.time} {escape(alarm.source)}: {escape(alarm.message)}'
        + (f' <b>({alarm.count} times)</b></p>' if alarm.count > 1 else '</p>')
        for alarm in alarms
    )
