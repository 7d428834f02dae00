"""The dialogs of a page: keyboard, settings of the next run, offsets and tools, probing."""

import asyncio
import math
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from itertools import starmap
from typing import Any

from nicegui import ui

from cnc_interp.client.operator_client import Answer
from cnc_interp.client.setup_client import (
    SetupClient,
    of_axes,
    offset_row,
    position_of,
    whole_tool,
)
from cnc_interp.core import SettingsError
from cnc_interp.page.contact import Command, act_on_shown, key
from cnc_interp.page.readings import ShownUnit
from cnc_interp.page.tool_rows import ToolRows
from cnc_interp.program.job import ROTATION, WORK_OFFSETS, Tool
from cnc_interp.settings.option_kinds import Choice
from cnc_interp.settings.options import Settings, filled_in, offered, settings_filled_in

#: For each shortcut: the browser's name of the key, its label, the key of the page, and its effect
#: if the key of the page does not show it.
KEYBOARD = (
    ('F1', 'F1', 'EMERGENCY STOP', ''),
    ('Escape', 'Esc', 'feed hold', ''),
    ('R', 'Shift + R', 'cycle start', ''),
    ('-', '-', 'slower', 'feed override 5 % less'),
    ('+', '+', 'faster', 'feed override 5 % more'),
    ('0', '0', '100%', 'feed override 100 %'),
    ('7', '7', 'rapid 25%', 'rapid override 25 %'),
    ('8', '8', 'rapid 50%', 'rapid override 50 %'),
    ('9', '9', 'rapid 100%', 'rapid override 100 %'),
    ('s', 'S', 'single block', 'single block on or off'),
    ('o', 'O', 'optional stop', 'optional stop (M1) on or off'),
    ('b', 'B', 'block delete', 'block delete on or off: leaves out lines that begin with a slash'),
    ('j', 'J', 'jog', 'show or hide the keys that move an axis'),
    (
        'p',
        'P',
        'pose',
        'show or hide the fields for going to a tool pose or to the zero of an axis',
    ),
    ('?', '?', 'keyboard', 'show or hide this list'),
)
MARKS = {name: mark for name, _, mark, _ in KEYBOARD}


def keyboard_list() -> Any:
    with ui.dialog() as dialog, ui.card().classes('settings'):
        ui.label('keyboard').classes('title')
        with ui.element('div').classes('map'):
            for _, printed, mark, meaning in KEYBOARD:
                ui.html(f'<kbd>{printed}</kbd>', sanitize=False)
                ui.label(meaning or mark)
            ui.html('<kbd>← → ↑ ↓ PgUp PgDn</kbd>', sanitize=False)
            ui.label('X, Y, Z while the key is held and the jog keys are shown')
            ui.html('<kbd>Enter ↑ ↓</kbd>', sanitize=False)
            ui.label('in the MDI field: execute the line; recall earlier lines')
        ui.label(
            'Space and Enter never press a key that moves the machine or changes an offset. '
            'Enter executes the line in the MDI field.'
        ).classes('small')
    return dialog


#: Titles of the groups of settings, with the names in each; the last group holds all others.
GROUPS = {
    'tolerances': (
        'contour_tolerance',
        'orientation_tolerance',
        'flank_height',
        'force_tolerances',
    ),
    'how the program is read': (
        'feedrate',
        'skip_blocks',
        'dialect',
        'units',
        'numbers',
        'arc_centres',
        'interpolation',
        'rotary_sense',
        'most_jumps',
        'setup',
    ),
    'smoothing': (),
}


def grouped() -> dict[str, list[Choice]]:
    known = {choice.name: choice for choice in offered()}
    found = {title: [known.pop(name) for name in names] for title, names in GROUPS.items()}
    found['smoothing'] += known.values()
    return found


class SettingsDialog:
    def __init__(self, use: Callable[[Settings], Awaitable[None]]):
        self._use = use
        self._settings = Settings()
        self._fields: dict[str, Any] = {}
        self._dialog = ui.dialog()

    def open(self, settings: Settings) -> None:
        """Show settings in new fields, because updating old fields would overwrite typed text."""
        self._settings = settings
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label('settings of the next run').classes('title')
            with ui.element('div').classes('fields'):
                texts = filled_in(settings)
                self._fields = {}
                for title, choices in grouped().items():
                    ui.label(title).classes('heading')
                    self._fields |= {c.name: self._field(c, texts[c.name]) for c in choices}
            with ui.element('div').classes('ends'):
                key('defaults', 'defaults settings', lambda: self.open(Settings()), 'primary')
                key('cancel', 'cancel settings', self._dialog.close, 'primary')
                use = key('use', 'use settings', colour='primary')
                act_on_shown(use, 'click', self._fields.values(), self._accept)
        self._dialog.open()

    @staticmethod
    def _field(choice: Choice, text: str) -> Any:
        with ui.element('div'):
            ui.label(choice.name.replace('_', ' '))
            ui.label(choice.sentence).classes('small')
        field: Any
        if choice.kind is bool:
            field = ui.switch(value=text == 'true')
        elif choice.values:
            field = ui.select(list(choice.values), value=text)
        else:
            field = ui.input(value=text).props(f'suffix="{choice.unit.name}"')
        return field.props(f'dense data-mark="setting {choice.name}"')

    async def _accept(self) -> None:
        values = {name: field.value for name, field in self._fields.items()}
        texts = {k: str(v).lower() if isinstance(v, bool) else v or '' for k, v in values.items()}
        try:
            settings = settings_filled_in(self._settings, texts)
        except SettingsError as problem:
            sentence = next(c.sentence for c in offered() if c.name == problem.name)
            ui.notify(f'{sentence}: {problem.reason}', type='negative')
            return
        self._dialog.close()
        await self._use(settings)


class SetupDialog:
    def __init__(
        self,
        setup: SetupClient,
        unit: ShownUnit,
        command: Command,
        give_line: Callable[[str], Awaitable[bool]],
    ):
        self._setup, self._unit, self._command = setup, unit, command
        self.give_line = give_line
        self._dialog = ui.dialog()
        self._fields: dict[str, Any] = {}
        self._known: dict[str, tuple[str, float]] = {}  # text of a field, and its value in SI
        unit.follow(lambda _: self.show_again())

    def open(self) -> None:
        table = self._setup.table
        if table is None:
            ui.notify('program_node does not answer yet', type='warning')
            return
        self._dialog.clear()
        self._fields, self._known = {}, {}
        axes = list(table.axes)
        fields = f'repeat({len(axes) + 1}, minmax(4em, 1fr))'
        columns = f'grid-template-columns: 4.5em {fields} auto auto auto'
        with self._dialog, ui.card().classes('setup'):
            self._title('offsets [mm, deg]')
            with ui.element('div').classes('rows').style(columns):
                for text in ('', *axes, ROTATION, '', '', ''):
                    ui.label(text).classes('name')
                for name in (*WORK_OFFSETS, 'G92'):
                    self._offset_row(name, axes)
            self._tools = ToolRows(self._setup.setup, self._unit.now, self)
            place = table.file or 'program_node only, until it ends'
            ui.label(f'kept in {place}').classes('small')
            if table.change:
                told = ui.label(f'last change by {table.changed_by} [mm, deg]: {table.change}')
                told.classes('small').props('data-mark="setup change"')
            with ui.element('div').classes('ends'):
                key('close', 'close setup', self._dialog.close)
        self._dialog.open()

    def show_again(self) -> None:
        if self._dialog.value:  # unless its user has closed it meanwhile
            self.open()

    # Building -----------------------------------------------------------------------------------

    def _title(self, text: str) -> None:
        ui.label(self._unit.now.named(text)).classes('title')

    def field(self, mark: str, text: str, value: float | None = None, counts: str = '') -> None:
        field = ui.input(value=text, placeholder=counts).props(f'dense data-mark="{mark}"')
        self._fields[mark] = field
        if value is not None:
            self._known[mark] = text, value

    def reading_key(self, text: str, mark: str, act: Callable[[], Awaitable[None]]) -> None:
        made = key(text, mark).classes('changes')
        act_on_shown(made, 'click', self._fields.values(), act)

    def _offset_row(self, name: str, axes: list[str]) -> None:
        setup = self._setup.setup
        position, counts = position_of(setup, name), offset_row(self._setup.table, setup, name)
        active = name == setup.offset or (name == 'G92' and setup.g92_on)
        ui.label(f'{name} ●' if active else name).classes('value')
        letters = axes if name == 'G92' else [*axes, ROTATION]
        for letter in letters:
            value = position.get(letter)
            text = '' if value is None else self._unit.now.shown(letter, value)
            usual = self._unit.now.shown(letter, counts[letter])
            self.field(f'{name} {letter}', text, value, usual)
        if name == 'G92':
            ui.label('')
        self.reading_key('set', f'set {name}', partial(self._set_offset, name, letters))
        ask = partial(self.ask, 'set_offset', offset=name)
        key('clear', f'clear {name}', partial(ask, clear=True)).classes('changes')
        if name == 'G92':
            ui.label('')
        else:
            key('use', f'use {name}', partial(ask, activate=True)).classes('changes')

    # Commands -----------------------------------------------------------------------------------

    def text_of(self, mark: str) -> str:
        return str(self._fields[mark].value or '').strip()

    async def take_tools(self, tools: Mapping[int, Tool]) -> None:
        async def taken() -> Answer:
            answer = await self._setup.ask_each(starmap(whole_tool, tools.items()))
            await shown_by(lambda: tools.items() <= self._setup.setup.tools.items())
            self.show_again()
            return answer

        await self._command(taken)

    async def ask(self, service: str, **request: Any) -> None:
        before = self._setup.table

        async def asked() -> Answer:
            answer = await asyncio.wrap_future(self._setup.ask(service, **request))
            await shown_by(lambda: not answer.ok or self._setup.table is not before)
            if answer.ok:
                ui.notify(f'[mm, deg] {answer.message}')
                self.show_again()
            return answer

        await self._command(asked)

    def _value(self, mark: str, unit: float) -> float | None:
        text = (self._fields[mark].value or '').strip()
        if not text:
            return None
        known, value = self._known.get(mark, ('', 0.0))
        if text == known:  # shown with fewer digits than it has
            return value
        number = float(text.replace(',', '.'))
        if not math.isfinite(number):
            raise ValueError
        return number * unit

    def values(self, marks: dict[str, tuple[str, float]]) -> dict[str, float] | None:
        """Return the values of non-empty fields; None, with a message, if one is invalid."""
        found = {}
        for name, (mark, unit) in marks.items():
            try:
                value = self._value(mark, unit)
            except ValueError:
                text = f'{mark}: write a number, not {self._fields[mark].value!r}'
                ui.notify(text, type='negative')
                return None
            if value is not None:
                found[name] = value
        return found

    async def _set_offset(self, name: str, axes: list[str]) -> None:
        """Set an offset to the values of its fields; an empty field removes the value."""
        values = self.values({k: (f'{name} {k}', self._unit.now.of(k)) for k in axes})
        if values is not None:
            await self.ask('set_offset', offset=name, clear=True, **of_axes(values))


async def shown_by(table_is_new: Callable[[], bool]) -> None:
    """Wait briefly for the new table; it arrives after the answer, on another topic."""
    for _ in range(20):
        if table_is_new():
            break
        await asyncio.sleep(0.05)
