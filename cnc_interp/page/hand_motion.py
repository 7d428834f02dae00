"""Motion by hand on a page: keys that move an axis while held, or by steps; input of positions.

A held key repeats a beat (``hand_motion.js``), which names the last server beat that the page has
heard. A beat that was delayed in transit is thus recognised and ignored.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import Jog
from cnc_interp_msgs.srv import MoveAxes
from nicegui import events, ui

from cnc_interp.client.alarms import Alarm
from cnc_interp.client.hand_move import POSE, pose_request
from cnc_interp.client.length_unit import LengthUnit
from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.client.setup_client import SetupClient, of_axes
from cnc_interp.core import MINUTE
from cnc_interp.machine.jog_motion import LEAST_SHARE
from cnc_interp.machine.slides import Slides
from cnc_interp.machine.tool_slide import along_tool
from cnc_interp.machine_model.machine import Machine
from cnc_interp.page.contact import VIEW_ONLY, Command, act_on_shown, asked, key
from cnc_interp.page.readings import ShownUnit

#: Arrow keys of the keyboard: axis and direction.
ARROWS = {
    'ArrowLeft': ('X', -1),
    'ArrowRight': ('X', 1),
    'ArrowDown': ('Y', -1),
    'ArrowUp': ('Y', 1),
    'PageDown': ('Z', -1),
    'PageUp': ('Z', 1),
}
CROSS = 'XYZ'  #: Axes whose keys form a cross; those of Z are beside it.
TOOL = 'tool'  #: Stands for motion along the tool, in place of the name of an axis.
HOLD = 'hold'  #: Choice in place of a step size: the axis moves while its key is held.
SPEED = 1  #: Index of the initial speed, from the slowest.
AT_END = 1e-6  #: An axis this near to the end of its travel counts as being at the end [m, rad].
FILLS = 0.7  #: Time for which a key that starts a rapid must be held [s].
STALE = 1.2  #: A beat is too late if it names a server beat older than this [s].
ALARMS = 'machine_node: jog'  #: Source of messages about motion by hand.
#: Messages if a held key was released by something other than its user.
EARLY = 'nothing moves yet: hold the key until it is filled'
LOST = 'the window or the pointer was lost: check the machine, then press again'


def beat_of(name: str, share: float, axes: tuple[str, ...]) -> Jog:
    """Return the beat to jog an axis, or along the tool; any other name stops the motion."""
    if name == TOOL:
        return Jog(tool=share)
    return Jog(axes=[name], shares=[share]) if name in axes else Jog()


def step_of(name: str, distance: float, speed: float) -> MoveAxes.Request:
    """Return the request to move an axis, or along the tool, by a distance [m, rad]."""
    if name == TOOL:
        return MoveAxes.Request(relative=True, speed=speed, tool=distance)
    return MoveAxes.Request(relative=True, speed=speed, axes=[name], values=[distance])


class JogPad:
    def __init__(
        self,
        machine: Machine,
        nodes: OperatorClient,
        may_move: Callable[[], bool],
        unit: ShownUnit,
        command: Command,
    ):
        self._machine, self._axes, self._names = machine, machine.axes, machine.axis_names
        self._nodes, self._may_move, self._unit, self._command = nodes, may_move, unit, command
        self._told = ''  # the last message about the held key
        self._step = HOLD
        self._shown: list[bool] = []  # which axes are homed
        self._alarm: Alarm | None = None  # the last one of motion by hand
        with ui.element('div').classes('jog') as self._pad:
            with ui.element('div').classes('top'):
                self._steps = ui.toggle([HOLD], value=HOLD, on_change=self._choose)
                look = 'dense no-caps unelevated color=blue-grey-9 data-mark="jog step"'
                self._steps.props(look)
                key('×', 'close jog', self.toggle).tooltip('close')
            crossed = [name for name in CROSS if name in self._names]
            with ui.element('div').classes('cross') as cross:
                for name in crossed:
                    for sign in (-1, 1):
                        self._key(name, sign, f'{name}{"+" if sign > 0 else "−"}')
            cross.set_visibility(bool(crossed))
            for name in (*(name for name in self._names if name not in crossed), TOOL):
                with ui.element('div').classes('pairs'):
                    self._key(name, -1)
                    ui.label(name).classes('name')
                    self._key(name, 1)
            with ui.element('div').classes('slide'):
                unit.label('speed, mm/min or °/min')
                self._speed = ui.toggle([''], value='')
                self._speed.props('dense no-caps unelevated color=blue-grey-9')
                self._speed.props('data-mark="jog speed"')
            self._homes = self._home_keys(tuple(machine.homing.switches))
        self._pad.props(f'data-step={HOLD}').set_visibility(False)
        self._offer(unit.now)
        unit.follow(self._offer)
        ui.on('jog', self._beat)

    def _offer(self, unit: LengthUnit) -> None:
        self._steps.set_options([HOLD, *unit.steps], value=HOLD)
        self._speed.set_options(list(unit.speeds), value=unit.speeds[SPEED])

    def _key(self, name: str, sign: int, text: str = '') -> None:
        text = text or ('+' if sign > 0 else '−')
        made = key(text, f'jog {name}{"+" if sign > 0 else "-"}').classes('moves')
        made.classes(f'{name.lower()}{"plus" if sign > 0 else "minus"}')
        pressed = f'(event) => jog.press(event, {json.dumps(name)}, {sign})'
        made.on('pointerdown', js_handler=pressed)
        made.on('click', lambda: self._move(name, sign))

    def _home_keys(self, switches: tuple[str, ...]) -> dict[str, Any]:
        keys: dict[str, Any] = {}
        if not switches:
            return keys
        with ui.element('div').classes('homes'):
            for name in ('', *switches):
                axes = (name,) if name else ()
                act = partial(self._home, axes)
                keys[name] = key(f'home {name or "all"}', f'home {name}', act).classes('moves')
        return keys

    async def _home(self, axes: tuple[str, ...]) -> None:
        await self._command(asked(self._nodes.ask, 'home', axes=list(axes)))

    def show(self, state: Any) -> None:
        alarms = self._nodes.alarms.newest_first
        alarm = next((one for one in alarms if one.source == ALARMS), None)
        if alarm is not None and alarm != self._alarm and self._pad.visible:
            ui.notify(alarm.message, type='warning')
        self._alarm = alarm
        if not self._homes or state is None or self._shown == list(state.homed):
            return
        self._shown = list(state.homed)
        known = dict(zip(self._names, state.homed, strict=True))
        for name, one in self._homes.items():
            done = known[name] if name else all(known.values())
            one.props(f'color={"blue-grey-8" if done else "warning"}')

    @property
    def speed(self) -> float:
        return min(map(self._share, self._names))

    def _size(self, name: str, text: str) -> float:
        return float(text) * (self._unit.now.size if name == TOOL else self._unit.now.of(name))

    def _share(self, name: str) -> float:
        """Return the chosen speed over the velocity limit of an axis, or along the tool [-]."""
        if name == TOOL:
            most = self._along_tool().limits.axes[0].max_velocity
        else:
            most = self._axes[self._names.index(name)].max_velocity
        speed = self._size(name, self._speed.value) / MINUTE
        return min(max(speed / most, LEAST_SHARE), 1.0)

    def _along_tool(self) -> Slides:
        state = self._nodes.state
        stands = np.zeros(len(self._names)) if state is None else np.array(state.positions)
        return along_tool(self._machine, stands)

    def _end(self, name: str, sign: int) -> str:
        """Return as text the end of travel that an axis has reached; empty if it can move on."""
        state = self._nodes.state
        if state is None or name not in (*self._names, TOOL):
            return ''
        if name == TOOL:
            left, at = self._along_tool().limits.axes[0].travel[int(sign > 0)], ''
        else:
            i = self._names.index(name)
            end = self._axes[i].travel[int(sign > 0)]
            left = end - state.commanded_positions[i]
            unit = self._unit.now.name if self._axes[i].linear else '°'
            at = f': {self._unit.now.shown(name, end)} {unit}'
        return '' if abs(left) > AT_END else f'{name} is at the end of its travel{at}'

    def toggle(self) -> None:
        self._pad.set_visibility(not self._pad.visible)

    def _choose(self, event: events.ValueChangeEventArguments) -> None:
        self._step = str(event.value)
        self._pad.props(f'data-step={self._step}')

    async def _move(self, name: str, sign: int) -> None:
        if self._step != HOLD:
            step = step_of(name, sign * self._size(name, self._step), self._share(name))
            await self._command(asked(self._nodes.ask, 'move_axes', step))

    def _beat(self, event: events.GenericEventArguments) -> None:
        """Forward a beat, unless it is old or this page is not in charge; a stop is never old."""
        name, sign, heard = (event.args[key] for key in ('name', 'sign', 'heard'))
        if not self._may_move():
            said = VIEW_ONLY if name else ''
        elif not name or (isinstance(heard, int | float) and time.monotonic() - heard <= STALE):
            known = name in (*self._names, TOOL)
            share = (1 if sign > 0 else -1) * self._share(name) if known else 0.0
            self._nodes.beat(beat_of(str(name), share, self._names))
            said = self._end(name, sign)
        else:
            return
        if said and said != self._told:
            ui.notify(said, type='warning')
        self._told = said


class NumberFields:
    def __init__(
        self, title: str, mark: str, names: Iterable[str], unit: ShownUnit, command: Command
    ):
        self._unit, self._command = unit, command
        with ui.element('div').classes(f'pose {mark}') as self._box:
            unit.label(title).classes('small wide')
            self._fields = {name: self._field(name, mark) for name in names}
        self._box.set_visibility(False)
        unit.follow(self._convert)

    def _field(self, name: str, mark: str) -> Any:
        field = ui.input().props('dense outlined inputmode=decimal autocomplete=off')
        suffix = self._unit.now.suffix(name)
        return field.props(f'prefix={name} data-mark="{mark} {name}" suffix="{suffix}"')

    def _convert(self, unit: LengthUnit) -> None:
        """Convert typed lengths to the new unit (12.5 mm to 0.492126 in); drop invalid text."""
        for name, field in self._fields.items():
            text = self._unit.texts.get(field.props['data-mark'], '').replace(',', '.')
            ratio = self._unit.before.of(name) / unit.of(name)
            try:
                text = text and f'{float(text) * ratio:.7g}'
            except ValueError:
                text = ''
            field.set_value(text)
            field.props(f'suffix="{unit.suffix(name)}"').update()

    def _reading_key(self, text: str, act: Callable[[dict[str, float]], Awaitable[None]]) -> Any:
        async def read() -> None:
            try:
                values = numbers({name: field.value for name, field in self._fields.items()})
            except ValueError as problem:
                ui.notify(str(problem), type='warning')
            else:
                await act(values)

        with self._box:
            made = key(text)
        act_on_shown(made, 'click', self._fields.values(), read)
        return made

    def toggle(self, other: NumberFields) -> None:
        self._box.set_visibility(not self._box.visible)
        other._box.set_visibility(False)


def numbers(texts: dict[str, str | None]) -> dict[str, float]:
    try:
        given = {name: (text or '').strip() for name, text in texts.items()}
        values = {name: float(text.replace(',', '.')) for name, text in given.items() if text}
    except ValueError:
        values = {}
    if not values or not all(map(math.isfinite, values.values())):
        raise ValueError('write numbers; a field that is empty stays as it is')
    return values


class PoseField(NumberFields):
    """Rapids to a pose or to the zero of an axis, started by a key that must be held."""

    def __init__(
        self,
        nodes: OperatorClient,
        speed: Callable[[], float],
        axes: Iterable[str],
        unit: ShownUnit,
        command: Command,
    ):
        title = 'go to a pose: tool tip from the zero of the machine file (mm), and tool axis'
        super().__init__(title, 'pose', POSE, unit, command)
        self._nodes, self._speed = nodes, speed
        with self._box:
            key('here', act=self._take_here)
        self._reading_key('go there', self._go).classes('moves')
        self._axes = tuple(axes)
        with self._box, ui.element('div').classes('zeros wide'):
            ui.label('go to zero as a rapid: hold the key').classes('small')
            for name in sorted(self._axes, key='Z'.__eq__):  # Z moves separately
                made = key(f'{name} 0', f'go to zero {name}').classes(f'moves held {name.lower()}')
                made.on(
                    'pointerdown', js_handler=f'(event) => jog.fill(event, {json.dumps(name)})'
                )
        ui.on('go_to_zero', self._go_to_zero)

    async def _go_to_zero(self, event: events.GenericEventArguments) -> None:
        name, heard = event.args['name'], event.args['heard']
        if name in self._axes and time.monotonic() - float(heard) <= STALE:
            await self._command(asked(self._nodes.give_line, f'G90 G0 {name}0'))

    def _take_here(self) -> None:
        if (state := self._nodes.state) is not None:
            texts = [self._unit.now.length(value) for value in state.tip]
            texts += [f'{value:z.5f}' for value in state.axis]
            for field, text in zip(self._fields.values(), texts, strict=True):
                field.set_value(text)

    async def _go(self, values: dict[str, float]) -> None:
        request = pose_request(values, self._speed(), self._unit.now.size)
        await self._command(asked(self._nodes.ask, 'move_axes', request))


class TouchOffField(NumberFields):
    def __init__(self, setup: SetupClient, axes: Iterable[str], unit: ShownUnit, command: Command):
        title = 'touch off: coordinates of this place in the program, mm or °'
        super().__init__(title, 'here', axes, unit, command)
        self._setup = setup
        self._reading_key('touch off', self._touch_off).classes('wide changes')

    async def _touch_off(self, values: dict[str, float]) -> None:
        """Set the active offset so that axes read these values; empty fields change nothing."""
        found = {name: value * self._unit.now.of(name) for name, value in values.items()}

        async def touched() -> Answer:
            answer = await asyncio.wrap_future(self._setup.ask('touch_off', **of_axes(found)))
            if answer.ok:
                ui.notify('touched off: the old and the new value are shown below the coordinates')
            return answer

        await self._command(touched)
