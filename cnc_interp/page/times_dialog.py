"""The dialog of times: those of the loaded program by tool, and the history of runs."""

from functools import partial

from nicegui import run, ui

from cnc_interp.client.operator_client import Answer
from cnc_interp.page.contact import Command, key
from cnc_interp.page.desk import Desk
from cnc_interp.run.program_times import times_table

SHOWN = 50  #: Runs that are listed, the latest first.
#: Columns of the list: heading, and column of the file.
COLUMNS = {
    'started': 'started',
    'program': 'program',
    'operator': 'operator',
    'outcome': 'outcome',
    'predicted [s]': 'predicted_s',
    'actual [s]': 'actual_s',
    'held [s]': 'held_s',
    'holds': 'holds',
    'alarms': 'alarms',
}


class TimesDialog:
    def __init__(self, desk: Desk, command: Command):
        self._desk, self._command = desk, command
        self._dialog = ui.dialog()

    async def open(self) -> None:
        desk = self._desk
        rows = await run.io_bound(desk.nodes.history.latest, SHOWN)
        plan = desk.job.plan if desk.job is not None else None
        self._dialog.clear()
        with self._dialog, ui.card().classes('settings wide'):
            ui.label('times').classes('title')
            if desk.job is not None and plan is not None:
                ui.label(f'{desk.job.name}: {plan.run_time:.1f} s').classes('heading')
                table = '\n'.join(times_table(plan.tools))
                ui.label(table).classes('line table').props('data-mark="times by tool"')
            ui.label('runs').classes('heading')
            with ui.element('div').classes('runs').props('data-mark="runs"'):
                for heading in COLUMNS:
                    ui.label(heading).classes('name')
                for row in rows:
                    for column in COLUMNS.values():
                        ui.label(row[column]).tooltip(row['message'])
            with ui.element('div').classes('ends'):
                name = ui.input('operator', value=desk.operator).props('dense data-mark="who"')
                act = partial(self._command, partial(self._set, name))
                key('set operator', act=act).classes('changes')
                ui.link('CSV', '/runs.csv').props('data-mark="runs.csv"')
                key('close', 'close times', self._dialog.close)
        self._dialog.open()

    async def _set(self, name: ui.input) -> Answer:
        self._desk.operator = str(name.value)[:80]
        return Answer(True, 'this operator is recorded with the next run')
