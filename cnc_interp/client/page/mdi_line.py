"""The field of a page for lines by hand (MDI), with the lines given before."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from cnc_interp.client.mdi import LineHistory, modes_text
from cnc_interp.client.operator_client import Answer
from cnc_interp.client.page.readings import NOTHING
from cnc_interp.client.page.shown import act_on_shown


class MdiField:
    """The field in one page. Enter gives the line, up and down show those before."""

    def __init__(
        self,
        history: LineHistory,
        give: Callable[[str], Awaitable[Answer]],
        command: Callable[[Callable[[], Awaitable[Answer]]], Awaitable[None]],
    ):
        self._history, self._give, self._command = history, give, command
        self._age, self._busy = -1, False
        with ui.element('div').classes('mdi'):
            self._modes = ui.label(NOTHING).classes('small').props('data-mark="modes"')
            self.field = ui.input(placeholder='MDI: a line of G-code, Enter')
            self.field.props('dense outlined autocomplete=off spellcheck=false data-mark="mdi"')
            act_on_shown(self.field, 'keydown.enter', (self.field,), self._enter)
            self.field.on('keydown.up', lambda: self._recall(1))
            self.field.on('keydown.down', lambda: self._recall(-1))
            self._told = ui.label().classes('small').props('data-mark="mdi answer"')

    def show(self, whose: str, modes: Any) -> None:
        """Show whose modal state it is, and the ``ModalState``; None where it is not known."""
        text = f'{whose}: {NOTHING if modes is None or not modes.codes else modes_text(modes)}'
        if self._modes.text != text:
            self._modes.set_text(text)

    def _recall(self, step: int) -> None:
        """Show an older or a newer line."""
        self._age, line = self._history.at(self._age + step)
        self.field.set_value(line)

    async def _enter(self) -> None:
        """Give the line."""
        line = str(self.field.value or '').strip()
        if not line or self._busy:
            return

        async def given() -> Answer:
            self._history.add(line)
            self._age = -1
            self._tell(f'{line}: moving', failed=False)
            answer = await self._give(line)
            if answer.ok and str(self.field.value).strip() == line:
                self.field.set_value('')
            self._tell(answer.message if not answer.ok else f'{line}: done', not answer.ok)
            return answer

        self._busy = True
        try:
            await self._command(given)
        finally:
            self._busy = False

    def _tell(self, text: str, failed: bool) -> None:
        self._told.set_text(text)
        self._told.classes(add='failed' if failed else '', remove='' if failed else 'failed')
