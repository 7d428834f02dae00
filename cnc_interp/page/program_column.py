"""The program column of a page: the text, the line of the next start, and lines by hand (MDI)."""

import asyncio
import json
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import LoadedProgram
from nicegui import ui

from cnc_interp.client.hand_move import LineHistory, modes_text
from cnc_interp.client.operator_client import Answer, MachineState
from cnc_interp.core import FloatArray
from cnc_interp.machine_model.transform import Transform
from cnc_interp.page.contact import Command, act_on_shown, key
from cnc_interp.page.desk import Job
from cnc_interp.page.readings import NOTHING
from cnc_interp.run.start_place import way_inside
from cnc_interp.settings.options import Settings
from cnc_interp.wire.run_messages import settings_from

POINTS = 25  #: Points drawn on a leg on which rotary axes turn: the tip then moves on a curve.
#: Parts of the way, and the corner of ``way_inside`` at which each ends.
LEGS = (('1 retract', 1), ('2 position', 3), ('3 plunge', 4))
#: Why a machine waits before it takes the way.
WAITS = (MachineState.REASON_APPROACH, MachineState.REASON_AWAY)
AWAY = 'the axes were moved away by hand'
BACK = 'cycle start moves the tool back and goes on: retract, position, plunge; reset gives up'
MOVES = 'cycle start moves the tool: retract, position, plunge; reset gives up'


@dataclass(frozen=True)
class StartChoice:
    line: int = 0  #: Line of the program; 0 for its top.
    which: int = 0  #: Execution of that line, from 1; 0 for the only one.
    refused: str = ''  #: Why there was no start there; empty before it was tried.

    @property
    def text(self) -> str:
        if not self.line or self.refused:
            return self.refused
        which = f', pass {self.which}' if self.which else ''
        return (
            f'the next run starts at line {self.line}{which}; '
            'cycle start shows the way there, nothing moves yet'
        )


@dataclass(frozen=True)
class WayThere:
    #: Name of each part, and the tool tip on it in W, shape (k, 3) [m].
    legs: tuple[tuple[str, FloatArray], ...]
    text: str  #: What the operator must know before it moves; empty once it moves.


class WayAhead:
    def __init__(self, transform: Transform):
        self._transform = transform
        self._known: tuple[str, list[float], list[float]] | None = None
        self._way: WayThere | None = None

    def at(self, state: MachineState, program: LoadedProgram | None) -> WayThere | None:
        if program is None or program.program_id != state.program_id:
            return None
        if state.reason not in WAITS:
            is_on_it = self._known is not None and self._known[0] == state.program_id
            if not is_on_it or self._way is None or state.sequence:
                return None
            if self._way.text:  # it has begun
                self._way = replace(self._way, text='')
            return self._way
        before = state.path_position <= 0.0
        ends = [*(program.start_positions if before else state.resume_positions)]
        if not ends or not state.resting:
            return None
        known = state.program_id, [*state.commanded_positions], ends
        if self._known != known or self._way is None or not self._way.text:
            self._known = known
            retract = settings_from(program.settings, Settings()).retract
            stands = np.array(state.commanded_positions)
            corners = way_inside(self._transform, stands, np.array(ends), retract)
            self._way = WayThere(self._legs(corners), told(program, before))
        return self._way

    def _legs(self, corners: FloatArray) -> tuple[tuple[str, FloatArray], ...]:
        """Return the tips on the way, leg by leg; what has no length is left out."""
        legs, first = [], 0
        for name, last in LEGS:
            part = corners[first : last + 1]
            knots = np.arange(len(part))
            at = np.linspace(0, len(part) - 1, (len(part) - 1) * (POINTS - 1) + 1)
            q = np.column_stack([np.interp(at, knots, column) for column in part.T])
            tips = self._transform.forward(q)[0]
            if np.abs(np.diff(tips, axis=0)).max() > 0.0:
                legs.append((name, tips))
            first = last
        return tuple(legs)


def told(program: LoadedProgram, before: bool) -> str:
    return '\n'.join((*program.start_notes, MOVES) if before else (AWAY, BACK))


class Listing:
    """The text of the program in one page; it follows the executed line until its user scrolls."""

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
    """Line, pass, and two keys. A line of the program's text is chosen by pressing it, too."""

    def __init__(self, choose: Callable[[int, int], Awaitable[Answer]], command: Command):
        self._choose, self._command = choose, command
        with ui.element('div').classes('start-field'):
            self._line = self._field('line', 'start line')
            self._pass = self._field('pass', 'start pass')
            self._pass.tooltip('which execution of the line, where loops or calls repeat it')
            here, top = self.keys = key('start here'), key('from the top')
            act_on_shown(here, 'click', (self._line, self._pass), self._take)
            top.on('click', lambda: self._give(0, 0))
        ui.on('pick_line', lambda event: self.fill(str(event.args['line'])))

    @staticmethod
    def _field(text: str, mark: str) -> Any:
        field = ui.input(placeholder=text)
        return field.props(f'dense outlined inputmode=numeric autocomplete=off data-mark="{mark}"')

    def fill(self, line: str = '') -> None:
        self._line.set_value(line)
        self._pass.set_value('')

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
    """The field in one page. Enter gives the line, up and down show those before."""

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

    async def give(self, line: str) -> None:
        """Have a line executed, as if it was entered here."""
        if not line or self._busy:
            return

        async def given() -> Answer:
            self._history.add(line)
            self._age = -1
            self._tell(f'{line}: moving', failed=False)
            answer = await asyncio.wrap_future(self._give(line))
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
        self._told.classes(replace='small failed' if failed else 'small')
