"""The field of a page in which its user chooses the line at which the next run starts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import events, ui

from cnc_interp.client.operator_client import Answer
from cnc_interp.client.page.shown import act_on_shown


class StartField:
    """Line, pass, and two keys. A line of the program's text is chosen by pressing it, too."""

    def __init__(
        self,
        choose: Callable[[int, int], Answer],
        command: Callable[[Callable[[], Awaitable[Answer]]], Awaitable[None]],
    ):
        self._choose, self._command = choose, command
        with ui.element('div').classes('start-field'):
            self._line = self._field('line', 'start line')
            self._pass = self._field('pass', 'start pass')
            self._pass.tooltip('which execution of the line, where loops or calls repeat it')
            here, top = self.keys = self._key('start here'), self._key('from the top')
            act_on_shown(here, 'click', (self._line, self._pass), self._take)
            top.on('click', lambda: self._give(0, 0))
        ui.on('pick_line', self._pick)

    @staticmethod
    def _field(text: str, mark: str) -> Any:
        field = ui.input(placeholder=text)
        return field.props(f'dense outlined inputmode=numeric autocomplete=off data-mark="{mark}"')

    @staticmethod
    def _key(text: str) -> Any:
        key = ui.button(text)
        return key.props(f'dense no-caps unelevated color=blue-grey-8 data-mark="{text}"')

    def clear(self) -> None:
        """Forget the line: another program is loaded."""
        self._fill('', '')

    def _fill(self, line: str, which: str) -> None:
        self._line.set_value(line)
        self._pass.set_value(which)

    def _pick(self, event: events.GenericEventArguments) -> None:
        """Take the line that was pressed in the text."""
        self._fill(str(event.args['line']), '')

    async def _take(self) -> None:
        """Choose what the fields say."""
        texts = [str(field.value or '').strip() for field in (self._line, self._pass)]
        if texts[0].isdecimal() and (texts[1].isdecimal() or not texts[1]):
            await self._give(int(texts[0]), int(texts[1] or 0))
        else:
            ui.notify('press a line of the program, or write its number', type='warning')

    async def _give(self, line: int, which: int) -> None:
        async def chosen() -> Answer:
            return self._choose(line, which)

        if not line:
            self.clear()
        await self._command(chosen)
