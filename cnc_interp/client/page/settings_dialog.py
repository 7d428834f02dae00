"""The dialog for the settings of a run; its fields are made from the declarations."""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

from nicegui import ui

from cnc_interp.client.page.shown import act_on_shown
from cnc_interp.core.errors import SettingsError
from cnc_interp.settings.choices import Settings
from cnc_interp.settings.declaration import Choice
from cnc_interp.settings.form import filled_in, offered, settings_filled_in


class SettingsDialog:
    """One field for each choice, its unit beside it."""

    def __init__(self, use: Callable[[Settings], Awaitable[None]]):
        self._use = use
        self._settings = Settings()
        self._fields: dict[str, Any] = {}
        self._dialog = ui.dialog()

    def open(self, settings: Settings) -> None:
        """
        Show settings to be changed.

        The fields are made anew: values set from here into old ones come a moment after the dialog
        is seen, and would overwrite what was typed at once.
        """
        self._settings = settings
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label('settings of the next run').classes('title')
            with ui.element('div').classes('fields'):
                texts = filled_in(settings)
                self._fields = {c.name: self._field(c, texts[c.name]) for c in offered()}
            with ui.element('div').classes('ends'):
                self._key('defaults').on('click', lambda: self.open(Settings()))
                self._key('cancel').on('click', self._dialog.close)
                act_on_shown(self._key('use'), 'click', self._fields.values(), self._accept)
        self._dialog.open()

    @staticmethod
    def _key(text: str) -> Any:
        return ui.button(text).props(f'dense no-caps unelevated data-mark="{text} settings"')

    @staticmethod
    def _field(choice: Choice, text: str) -> Any:
        """Make the field of a choice, its sentence before it."""
        ui.label(choice.sentence).classes('name')
        field: Any
        if choice.kind is bool:
            field = ui.switch(value=text == 'true')
        elif choice.values:
            field = ui.select(list(choice.values), value=text)
        else:
            field = ui.input(value=text).props(f'suffix="{choice.unit.name}"')
        return field.props(f'dense data-mark="setting {choice.name}"')

    async def _accept(self) -> None:
        """Hand the settings over, or say which field is wrong."""
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
