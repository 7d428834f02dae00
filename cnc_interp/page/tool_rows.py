"""The tool table in the dialog of offsets and tools: rows, files, and touched lengths."""

from functools import partial
from typing import Any

from nicegui import events, ui

from cnc_interp.client.length_unit import LengthUnit
from cnc_interp.core import InterpError
from cnc_interp.core.small_files import LONGEST_YAML
from cnc_interp.page.contact import key
from cnc_interp.program.job import MOST_TOOL, TOOL_SIZES, TOOL_TEXTS, JobSetup, Tool
from cnc_interp.program.tool_files import csv_text, tbl_text, tools_of_text

#: Titles of the columns of lengths.
SIZES = {name: name.removesuffix('_radius').replace('_', ' ') for name in TOOL_SIZES}
TOUCH = 'touch Z'  #: Mark of the field for the Z coordinate at which a tool touches.


class ToolRows:
    def __init__(self, setup: JobSetup, unit: LengthUnit, dialog: Any):  # the dialog around it

        self._setup, self._unit, self._dialog = setup, unit, dialog
        ui.label(f'tools [{unit.name}]').classes('title')
        with ui.element('div').classes('rows tools'):
            for text in ('number', *SIZES.values(), 'pocket', *TOOL_TEXTS, '', '', '', ''):
                ui.label(text).classes('name')
            for number in sorted(setup.tools):
                self._row(number, setup.tools[number])
            self._row(None, None)
        with ui.element('div').classes('keyrow'):
            ui.label(f'the tip of the tool in the spindle is now at Z [{unit.name}]')
            dialog.field(TOUCH, '0')
            ui.label('in the program: press "length from here" in the row of the tool').classes(
                'small'
            )
        with ui.element('div').classes('keyrow'):
            self._upload = ui.upload(
                on_upload=self._take_file, auto_upload=True, max_file_size=LONGEST_YAML
            ).classes('hidden tool-file')
            pick = partial(self._upload.run_method, 'pickFiles')
            key('import tool.tbl or CSV', 'import tools', pick).classes('changes')
            for text, mark, write in (
                ('export CSV', 'csv', csv_text),
                ('export tool.tbl', 'tbl', tbl_text),
            ):
                told = write(setup.tools, unit.size).encode()
                key(text, f'export {mark}', partial(ui.download, told, f'tool.{mark}'))
            empty = key('no tool in the spindle', 'load tool 0', partial(self._load, 0))
            empty.classes('changes')

    def _row(self, number: int | None, tool: Tool | None) -> None:
        dialog, mark = self._dialog, 'new tool' if number is None else f'tool {number}'
        if number is None:
            dialog.field(f'{mark} number', '')
        else:
            there = number == self._setup.tool
            ui.label(f'{number} ●' if there else f'{number}').classes('value')
        for name in SIZES:
            value = None if tool is None else getattr(tool, name)
            shown = '' if value is None else self._unit.length(value)
            dialog.field(f'{mark} {name}', shown, value)
        pocket = '' if tool is None or not tool.pocket else f'{tool.pocket}'
        dialog.field(f'{mark} pocket', pocket)
        for name in TOOL_TEXTS:
            dialog.field(f'{mark} {name}', '' if tool is None else getattr(tool, name))
        dialog.reading_key('set', f'set {mark}', partial(self._set, mark, number))
        if number is None:
            for _ in range(3):
                ui.label('')
            return
        dialog.reading_key('length from here', f'touch {mark}', partial(self._touch, number))
        remove = partial(dialog.ask, 'set_tool', number=number, remove=True)
        key('remove', f'remove {mark}', remove).classes('changes')
        key('in the spindle', f'load {mark}', partial(self._load, number)).classes('changes')

    async def _set(self, mark: str, number: int | None) -> None:
        marks = {name: (f'{mark} {name}', self._unit.size) for name in SIZES}
        marks['pocket'] = f'{mark} pocket', 1.0
        if number is None:
            marks['number'] = f'{mark} number', 1.0
        values: dict[str, Any] | None = self._dialog.values(marks)
        if values is None:
            return
        for name in {'pocket', 'number'} & set(values):
            values[name] = round(min(max(values[name], 0.0), 10.0 * MOST_TOOL))
        number = values.pop('number', 0) if number is None else number
        values |= {name: self._dialog.text_of(f'{mark} {name}') for name in TOOL_TEXTS}
        await self._dialog.ask('set_tool', number=number, fields=list(values), **values)

    async def _touch(self, number: int) -> None:
        """Set the length of a tool so that Z now reads the value of the field (G10 L10)."""
        found = self._dialog.values({'Z': (TOUCH, self._unit.size)})
        if found is not None:
            unit = 'G21' if self._unit.digits == 3 else 'G20'
            height = found.get('Z', 0.0) / self._unit.size
            await self._dialog.give_line(f'{unit} G10 L10 P{number} Z{height:.6g}')
            self._dialog.show_again()

    async def _load(self, number: int) -> None:
        await self._dialog.ask('set_tool', number=number, load=True)

    async def _take_file(self, event: events.UploadEventArguments) -> None:
        text = (await event.file.read()).decode('utf-8-sig', errors='replace')
        try:
            tools = tools_of_text(text, self._unit.size)
        except InterpError as problem:
            ui.notify(f'{event.file.name}: {problem}', type='negative')
            return
        await self._dialog.take_tools(tools)
