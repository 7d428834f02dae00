"""The dialogs of programs: the folder with the programs opened last, and the editor."""

from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

from nicegui import events, ui

from cnc_interp.client.operator_client import Answer
from cnc_interp.page.contact import Command, key
from cnc_interp.page.desk import Desk
from cnc_interp.page.program_folder import LONGEST_EDITED

AGREED = 'overwrite'  #: Label of the save key if another program already has this name.


class FolderDialog:
    def __init__(self, desk: Desk, command: Command):
        self._desk, self._command = desk, command
        self._dialog = ui.dialog()

    def open(self) -> None:
        folder = self._desk.folder
        listed = folder.listed()
        by_name = {one.name: one.text() for one in listed}
        recent = [name for name in folder.recent() if name in by_name]
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label(f'programs in {folder.folder}').classes('title')
            with ui.element('div').classes('files'):
                for title, names in (('opened last', recent), ('all', list(by_name))):
                    if names:
                        ui.label(title).classes('heading')
                    for name in names:
                        self._row(title, name, by_name[name])
                if not listed:
                    ui.label('no programs here; load takes one from this browser')
            with ui.element('div').classes('ends'):
                key('close', 'close programs', self._dialog.close)
        self._dialog.open()

    def _row(self, title: str, name: str, told: str) -> None:
        mark = name if title == 'all' else f'{title} {name}'
        with ui.element('div').classes('file'):
            ui.label(name)
            ui.label(told).classes('small')
            key('load', f'load {mark}', partial(self._do, self._desk.load, name))
            key('queue', f'queue {mark}', partial(self._do, self._desk.queue, name))

    async def _do(self, take: Callable[[str, str], Awaitable[Answer]], name: str) -> None:
        self._dialog.close()
        await self._command(partial(self._desk.listed, take, name))


class EditorDialog:
    """An editor of the loaded program, with its rejected lines in red (``editor.js``)."""

    def __init__(self, desk: Desk, command: Command):
        self._desk, self._command = desk, command
        self._marked: tuple[int, ...] | None = None
        self._agreed = ''  # the name whose program may be replaced
        with (
            ui.dialog().props('persistent maximized') as self._dialog,
            ui.card().classes('editor'),
        ):
            with ui.element('div').classes('title'):
                self._name = ui.input(placeholder='name of the program').classes('grow')
                self._name.props('dense outlined data-mark="edited name"')
                check = key('check', 'check edited')
                self._save = key('save', 'save edited')
                key('close', 'close editor', self._dialog.close)
            self._told = ui.label().classes('small').props('data-mark="edited status"')
            ui.html(
                '<ol></ol><textarea data-mark="edited text" spellcheck="false" '
                'autocomplete="off" wrap="off"></textarea>',
                sanitize=False,
            ).classes('edited')
        for made, kind in ((check, 'check'), (self._save, 'save')):
            made.on('click', js_handler=f'() => editor.give("{kind}")')
        ui.on('edited', self._take)

    def open(self) -> None:
        job = self._desk.job
        text = '\n'.join(job.lines) if job is not None else ''
        if len(text) > LONGEST_EDITED or (job is not None and not job.lines):
            ui.notify('this program is too long for the editor of the page', type='warning')
            return
        self._name.set_value(job.name if job is not None else 'new.ngc')
        self._dialog.open()
        self._marked = None
        number = job.number if job is not None else 0
        ui.run_javascript(f'editor.open({number})')

    def show(self) -> None:
        """Mark the rejected lines of the last check."""
        job = self._desk.job
        if not self._dialog.value or job is None:
            return
        if self._marked != job.fault_lines:
            self._marked = job.fault_lines
            ui.run_javascript(f'editor.mark({list(job.fault_lines)})')
        self._told.set_text(job.status)
        self._told.classes(replace='small failed' if job.failed else 'small')

    async def _take(self, event: events.GenericEventArguments) -> None:
        kind, name, text = (str(event.args[word]) for word in ('kind', 'name', 'text'))
        if len(text) > LONGEST_EDITED or not name:
            ui.notify('give a name' if not name else 'the program is too long', type='warning')
            return
        if kind == 'save':
            await self._command(partial(self._keep, name, text))
        else:
            await self._command(partial(self._desk.load, name, text))

    async def _keep(self, name: str, text: str) -> Answer:
        other = self._desk.job is None or name != self._desk.job.name
        there = any(one.name == name for one in self._desk.folder.listed())
        if other and there and self._agreed != name:
            self._agreed = name
            self._save.set_text(AGREED)
            return Answer(False, f'{name} exists already: press overwrite, or change the name')
        self._agreed = ''
        self._save.set_text('save')
        return await self._desk.save(name, text)


class MacroKeys:
    """Keys for macros of the machine file; those that move the machine need confirmation."""

    def __init__(self, desk: Desk, give: Callable[[str], Awaitable[bool]]):
        assert desk.machine is not None
        self._give = give
        self.keys: list[Any] = []
        if not desk.machine.macros:
            return
        self._dialog = ui.dialog()
        with ui.element('div').classes('signals'):
            ui.label('macros').classes('small')
            for macro in desk.machine.macros:
                act = self._ask if macro.moves else self._run
                made = key(macro.name, f'macro {macro.name}', partial(act, macro))
                self.keys.append(made.classes('moves'))

    async def _ask(self, macro: Any) -> None:
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings'):
            ui.label(f'{macro.name}: the machine moves').classes('title')
            for line in macro.lines:
                ui.label(line).classes('line')
            with ui.element('div').classes('ends'):
                key('cancel', 'cancel macro', self._dialog.close, 'primary')
                go = partial(self._run, macro)
                key('go', 'go macro', go, 'positive').classes('moves')
        self._dialog.open()

    async def _run(self, macro: Any) -> None:
        if macro.moves:
            self._dialog.close()
        for line in macro.lines:
            if not await self._give(line):
                return
