"""The messages of a page: what is new, a key that clears it, and the history with an export."""

from __future__ import annotations

from nicegui import ui

from cnc_interp.client.alarms import Alarm, AlarmList
from cnc_interp.client.page.readings import alarms_html, history_text

#: Messages shown beside the program.
SHOWN = 30


class Messages:
    """The messages in one page."""

    def __init__(self, alarms: AlarmList):
        self._alarms = alarms
        self._shown: list[Alarm] | None = None
        with ui.dialog() as self._dialog, ui.card().classes('settings'):
            ui.label('messages, the newest first').classes('title')
            self._history = ui.html('', sanitize=False).classes('history')
            with ui.element('div').classes('ends'):
                self._key('save', self._save)
                self._key('close', self._dialog.close)
        with ui.element('div').classes('title messages'):
            ui.html('<h2>messages</h2>', sanitize=False).classes('grow')
            self._key('history', self._open)
            self._key('clear', alarms.clear)
        self._list = ui.html('', sanitize=False).classes('alarms')

    @staticmethod
    def _key(text: str, act: object) -> None:
        key = ui.button(text, on_click=act)
        key.props(f'dense no-caps unelevated color=blue-grey-8 data-mark="{text} messages"')

    def _open(self) -> None:
        """Show everything that is kept."""
        self._history.set_content(alarms_html(self._alarms.history) or '<p>none</p>')
        self._dialog.open()

    def _save(self) -> None:
        """Let the user keep the history as a file."""
        ui.download(history_text(self._alarms.history).encode(), 'cnc_interp_messages.txt')

    def show(self) -> None:
        """Show what is new."""
        alarms = self._alarms.newest_first[:SHOWN]
        if alarms != self._shown:
            self._shown = alarms
            self._list.set_content(alarms_html(alarms))
