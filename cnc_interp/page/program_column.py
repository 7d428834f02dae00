"""The program column of a page: the text, the line of the next start, and lines by hand (MDI)."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from functools import partial
from typing import Any

from nicegui import ui

from cnc_interp.client.hand_move import LineHistory, modes_text
from cnc_interp.client.operator_client import Answer
from cnc_interp.page.contact import Command, act_on_shown, key
from cnc_interp.page.desk import Job
from cnc_interp.page.readings import NOTHING


class Listing:
    """The text of the program on a page; it follows the executed line until the user scrolls."""

    def __init__(self) -> None:
        self._number = -1
        self._marked: tuple[int, tuple[int, ...], int] = (0, (), 0)
        find = ui.input(placeholder='find in the program, Enter for the next')
        find.props('dense outlined autocomplete=off spellcheck=false data-mark="find"')
        find.on('keydown.enter', js_handler='(event) => listing.find(event.target.value)')
        ui.html('<ol></ol>', sanitize=False).classes('lines').props('tabindex=0 data-mark="lines"')
        follow = key('to the line').classes('to-line')
        follow.on('click', js_handler='() => listing.follow()')

    def show(self, job: Job | None, line: int, start: int) -> None:
        number = job.number if job is not None else 0
        marked = line, job.fault_lines if job is not None else (), start
        if number != self._number:
            ui.run_javascript(f'listing.load({number})')
        if (number, marked) != (self._number, self._marked):
            ui.run_javascript(f'listing.mark({", ".join(map(json.dumps, marked))})')
        self._number, self._marked = number, marked

    def show_again(self) -> None:
        self._number = -1


class StartField:
    """Fields for line and pass, and two keys. Pressing a line of the text also chooses it."""

    def __init__(self, choose: Callable[[int, int], Awaitable[Answer]], command: Command):
        self._choose, self._command = choose, command
        with ui.element('div').classes('start-field'):
            self._line = self._field('line', 'start line')
            self._pass = self._field('pass', 'start pass')
            self._pass.tooltip('which execution of the line, if loops or calls repeat it')
            here, top = self.keys = key('start here'), key('from the top')
            act_on_shown(here, 'click', (self._line, self._pass), self._take)
            top.on('click', lambda: self._give(0, 0))
        ui.on('pick_line', lambda event: self.fill(int(event.args['line'])))

    @staticmethod
    def _field(text: str, mark: str) -> Any:
        field = ui.input(placeholder=text)
        return field.props(f'dense outlined inputmode=numeric autocomplete=off data-mark="{mark}"')

    def fill(self, line: int = 0, which: int = 0) -> None:
        self._line.set_value(str(line or ''))
        self._pass.set_value(str(which or ''))

    async def _take(self) -> None:
        texts = [str(field.value or '').strip() for field in (self._line, self._pass)]
        if texts[0].isdecimal() and (texts[1].isdecimal() or not texts[1]):
            await self._give(int(texts[0]), int(texts[1] or 0))
        else:
            ui.notify('press a line of the program, or write its number', type='warning')

    async def _give(self, line: int, which: int) -> None:
        if not line:
            self.fill()
        await self._command(partial(self._choose, line, which))


class MdiField:
    """The MDI field of a page. Enter sends the line; up and down recall earlier lines."""

    def __init__(
        self, history: LineHistory, give: Callable[[str], Future[Answer]], command: Command
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
        text = f'{whose}: {NOTHING if modes is None or not modes.codes else modes_text(modes)}'
        if self._modes.text != text:
            self._modes.set_text(text)

    def _recall(self, step: int) -> None:
        self._age, line = self._history.at(self._age + step)
        self.field.set_value(line)

    async def _enter(self) -> None:
        await self.give(str(self.field.value or '').strip())

    async def give(self, line: str) -> bool:
        """Execute a line as if it had been entered here; return whether it was executed."""
        if not line or self._busy:
            return False
        done = False

        async def given() -> Answer:
            self._history.add(line)
            self._age = -1
            self._tell(f'{line}: moving', failed=False)
            answer = await asyncio.wrap_future(self._give(line))
            if answer.ok and str(self.field.value).strip() == line:
                self.field.set_value('')
            nonlocal done
            done = answer.ok
            self._tell(answer.message if not answer.ok else f'{line}: done', not answer.ok)
            return answer

        self._busy = True
        try:
            await self._command(given)
        finally:
            self._busy = False
        return done

    def _tell(self, text: str, failed: bool) -> None:
        self._told.set_text(text)
        self._told.classes(replace='small failed' if failed else 'small')
