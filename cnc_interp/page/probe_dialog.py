"""The dialog of the probing cycles: choose one, start it, and accept or discard its result."""

import asyncio
from functools import partial
from typing import Any

from nicegui import ui

from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.client.setup_client import Proposal, SetupClient
from cnc_interp.core import InterpError
from cnc_interp.page.contact import Command, act_on_shown, key
from cnc_interp.page.readings import ShownUnit
from cnc_interp.program.motion.probing import Cycle, cycles

_BALL = '<circle cx="{}" cy="{}" r="6" fill="#e8c34a"/>'
_WAY = '<path d="M{} {}L{} {}" stroke="#e8c34a" stroke-width="2" stroke-dasharray="4 3"/>'
_PART = '<{} fill="none" stroke="currentColor" stroke-width="2"/>'
#: Pictures of the cycles, 120 by 80: the part, the ball at its start, and its paths.
_PICTURES = {
    'surface': _PART.format('path d="M10 60H110"') + _WAY.format(60, 16, 60, 54),
    'edge': _PART.format('path d="M80 10V70"') + _WAY.format(20, 40, 74, 40),
    'bore': _PART.format('circle cx="60" cy="40" r="34"')
    + _WAY.format(32, 40, 88, 40)
    + _WAY.format(60, 12, 60, 68),
    'boss': _PART.format('circle cx="60" cy="40" r="20"')
    + _WAY.format(8, 40, 34, 40)
    + _WAY.format(112, 40, 86, 40)
    + _WAY.format(60, 2, 60, 14)
    + _WAY.format(60, 78, 60, 66),
    'angle': _PART.format('path d="M10 56L110 36"')
    + _WAY.format(30, 14, 30, 46)
    + _WAY.format(86, 14, 86, 35),
    'tool': _PART.format('path d="M40 66H80M60 66V72"') + _WAY.format(60, 16, 60, 60),
}
_BEGINS = {
    'surface': (60, 12),
    'edge': (20, 40),
    'bore': (60, 40),
    'boss': (60, 40),
    'angle': (30, 10),
    'tool': (60, 12),
}


class ProbeDialog:
    """Dialog to choose a cycle, enter its values, and start it at the current position."""

    def __init__(
        self, nodes: OperatorClient, setup: SetupClient, unit: ShownUnit, command: Command
    ):
        self._nodes, self._setup, self._unit, self._command = nodes, setup, unit, command
        self._dialog = ui.dialog()
        self._fields: dict[str, Any] = {}

    def open(self, name: str = 'surface') -> None:
        """Show a cycle in new fields, as ``SettingsDialog`` does."""
        cycle = cycles()[name]
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label('find with the probe').classes('title')
            with ui.element('div').classes('ends'):
                for other in cycles():
                    colour = 'primary' if other == name else 'blue-grey-8'
                    key(other, f'probe {other}', partial(self.open, other), colour)
            picture = _PICTURES[name] + _BALL.format(*_BEGINS[name])
            ui.html(f'<svg viewBox="0 0 120 80" width="180">{picture}</svg>', sanitize=False)
            ui.label(f'{cycle.text}. The cycle starts from the current position').classes('small')
            with ui.element('div').classes('fields'):
                for told in cycle.parameters:
                    ui.label(told.text).classes('name')
                    field = ui.input(value=f'{told.default:g}').props(f'suffix="{told.unit}"')
                    field.props(f'dense data-mark="probe {told.name}"')
                    self._fields[told.name] = field
            with ui.element('div').classes('ends'):
                key('close', 'close probe', self._dialog.close, 'primary')
                start = key('start', 'start probe', colour='primary').classes('moves')
                fields = [self._fields[told.name] for told in cycle.parameters]
                act_on_shown(start, 'click', fields, lambda: self._run(cycle))
        self._dialog.open()

    async def _run(self, cycle: Cycle) -> None:
        values = {}
        for told in cycle.parameters:
            text = str(self._fields[told.name].value or '').replace(',', '.')
            try:
                values[told.name] = float(text)
            except ValueError:
                ui.notify(f'{told.text}: write a number, not {text!r}', type='negative')
                return
        try:
            line = cycle.line(values)
        except InterpError as problem:
            ui.notify(str(problem), type='negative')
            return
        self._dialog.close()
        await self._command(partial(self._find, cycle.name, line))

    async def _find(self, name: str, line: str) -> Answer:
        """Run the cycle; its result is set only after the user has confirmed it."""
        answer = await asyncio.wrap_future(self._nodes.give_line(line, proposes=True))
        if answer.ok and answer.response is not None:
            self._report(name, answer.response)
        return answer

    def _report(self, name: str, result: Any) -> None:
        found = self._setup.proposal(result.proposed)
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label(f'{name}: found').classes('title')
            texts = found.texts(self._setup.setup, self._unit.now) or ['nothing changes']
            for text in texts:
                ui.label(text).props('data-mark="found"')
            for notice in result.notices:  # of a line of the cycle
                ui.label(notice.split(': ', 1)[-1]).classes('small')
            with ui.element('div').classes('ends'):
                key('leave as it is', 'leave found', self._dialog.close, 'primary')
                take = partial(self._command, partial(self._take, found))
                key('set', 'set found', take, 'primary').classes('changes')
        self._dialog.open()

    async def _take(self, found: Proposal) -> Answer:
        self._dialog.close()
        return await self._setup.take(found)
