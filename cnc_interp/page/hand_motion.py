"""
Motion by hand on a page: keys that move an axis while they are held or by steps, and a pose.

The browser repeats a beat while a key is held (``hand_motion.js``), and each one becomes a beat of
topic ``jog``. It names the last beat of the server that the page has heard. So a beat that was on
its way for long is known, and does not count.
"""

from __future__ import annotations

import asyncio
import json
import math
import time
from collections.abc import Awaitable, Callable
from typing import Any

import numpy as np
from cnc_interp_msgs.msg import Jog
from cnc_interp_msgs.srv import MoveAxes
from nicegui import events, ui

from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.core.units import MM
from cnc_interp.machine.jog_motion import LEAST_SHARE, Slides
from cnc_interp.machine_model.machine import Axis, Machine
from cnc_interp.page.contact import act_on_shown

#: Arrow keys of the keyboard: axis and direction.
ARROWS = {
    'ArrowLeft': ('X', -1), 'ArrowRight': ('X', 1), 'ArrowDown': ('Y', -1), 'ArrowUp': ('Y', 1),
    'PageDown': ('Z', -1), 'PageUp': ('Z', 1),
}  # fmt: skip
#: Axes whose keys form a cross, with those of Z beside it.
CROSS = 'XYZ'
#: Name of the motion along the tool among the axes.
TOOL = 'tool'
#: Step of a key [mm, deg]; without one the axis moves while the key is held.
HOLD, STEPS = 'hold', ('0.01', '0.1', '1', '10')
#: Speeds along a linear axis or the tool [mm/min], of a rotary axis [deg/min]; the one at first.
SPEEDS, SPEED = ('100', '300', '1000', '3000', '10000'), '300'
#: An axis nearer than this to the end of its travel is there [m, rad].
AT_END = 1e-6
#: A beat that names an older beat of the server was on its way for too long [s].
STALE = 1.2


def beat_of(name: str, share: float, axes: tuple[str, ...]) -> Jog:
    """Return the beat that moves an axis, or along the tool; any other name stops."""
    if name == TOOL:
        return Jog(tool=share)
    return Jog(axes=[name], shares=[share]) if name in axes else Jog()


def step_of(name: str, distance: float, speed: float, axes: tuple[Axis, ...]) -> MoveAxes.Request:
    """Return the request that moves an axis, or along the tool, by a distance [mm, deg]."""
    request = MoveAxes.Request(relative=True, speed=speed)
    if name == TOOL:
        request.tool = distance * MM
    else:
        (axis,) = (axis for axis in axes if axis.name == name)
        request.axes, request.values = [name], [distance * axis.shown_size]
    return request


class JogPad:
    """The pad in one page."""

    def __init__(
        self,
        machine: Machine,
        nodes: OperatorClient,
        may_move: Callable[[], bool],
        command: Callable[[Callable[[], Awaitable[Answer]]], Awaitable[None]],
    ):
        self._machine, self._axes, self._names = machine, machine.axes, machine.axis_names
        self._told = ''  # the end of travel that was told last
        self._nodes, self._may_move, self._command = nodes, may_move, command
        self._step = HOLD
        self._shown: list[bool] = []  # which axes are homed
        with ui.element('div').classes('jog') as self._pad:
            steps = ui.toggle([HOLD, *STEPS], value=HOLD, on_change=self._choose)
            steps.props('dense no-caps unelevated color=blue-grey-9 data-mark="jog step"')
            crossed = [name for name in CROSS if name in self._names]
            with ui.element('div').classes('cross'):
                for name in crossed:
                    for sign in (-1, 1):
                        self._key(name, sign, f'{name}{"+" if sign > 0 else "−"}')
            for name in (*(name for name in self._names if name not in crossed), TOOL):
                with ui.element('div').classes('pairs'):
                    self._key(name, -1)
                    ui.label(name).classes('name')
                    self._key(name, 1)
            with ui.element('div').classes('slide'):
                ui.label('speed, mm/min or °/min')
                self._speed = ui.toggle(list(SPEEDS), value=SPEED)
                self._speed.props('dense no-caps unelevated color=blue-grey-9')
                self._speed.props('data-mark="jog speed"')
            self._homes = self._home_keys(tuple(machine.homing.switches))
        self._pad.props(f'data-step={HOLD}').set_visibility(False)
        ui.on('jog', self._beat)

    def _key(self, name: str, sign: int, text: str = '') -> None:
        """Make one key."""
        text = text or ('+' if sign > 0 else '−')
        key = ui.button(text, color='blue-grey-8').classes('moves')
        key.classes(f'{name.lower()}{"plus" if sign > 0 else "minus"}')
        key.props(f'dense unelevated no-caps data-mark="jog {name}{"+" if sign > 0 else "-"}"')
        key.on(
            'pointerdown',
            js_handler=f'(event) => jog.press(event, {json.dumps(name)}, {sign})',
        )
        key.on('click', lambda: self._move(name, sign))

    def _home_keys(self, switches: tuple[str, ...]) -> dict[str, Any]:
        """Make a key that homes all axes with a switch, and one for each of them."""
        if not switches:
            return {}
        keys = {}
        with ui.element('div').classes('homes'):
            for name in ('', *switches):
                key = ui.button(f'home {name}' if name else 'home all', color='blue-grey-8')
                key.classes('moves').props(f'dense unelevated no-caps data-mark="home {name}"')
                key.on('click', lambda name=name: self._home((name,) if name else ()))
                keys[name] = key
        return keys

    async def _home(self, axes: tuple[str, ...]) -> None:
        """Home axes, all where none is named."""

        async def homed() -> Answer:
            return await asyncio.wrap_future(self._nodes.home(axes))

        await self._command(homed)

    def show(self, state: Any) -> None:
        """Show by the colour of their keys which axes must still be homed."""
        if not self._homes or state is None or self._shown == list(state.homed):
            return
        self._shown = list(state.homed)
        known = dict(zip(self._names, state.homed, strict=True))
        for name, key in self._homes.items():
            done = known[name] if name else all(known.values())
            key.props(f'color={"blue-grey-8" if done else "warning"}')

    @property
    def speed(self) -> float:
        """The share of the largest velocities with which no axis passes the chosen speed [-]."""
        return min(map(self._share, self._names))

    def _share(self, name: str) -> float:
        """Return the share of an axis' largest velocity, or of that along the tool [-]."""
        speed = float(self._speed.value) / 60.0
        if name == TOOL:
            share = speed * MM / float(self._along_tool().limits[0, 0])
        else:
            axis = self._axes[self._names.index(name)]
            share = speed * axis.shown_size / axis.max_velocity
        return min(max(share, LEAST_SHARE), 1.0)

    def _along_tool(self) -> Slides:
        """Return the motion along the tool from where the axes stand."""
        state = self._nodes.state
        stands = np.zeros(len(self._names)) if state is None else np.array(state.positions)
        return Slides.along_tool(self._machine, stands)

    def _end(self, name: str, sign: int) -> str:
        """Return at which end of its travel an axis stands, in words; empty if it can go on."""
        state = self._nodes.state
        if state is None or name not in (*self._names, TOOL):
            return ''
        if name == TOOL:
            left, at = float(self._along_tool().travel[int(sign > 0)]), ''
        else:
            i = self._names.index(name)
            axis = self._axes[i]
            end = axis.travel[int(sign > 0)]
            left = end - state.commanded_positions[i]
            at = f': {axis.position_text(end)} {axis.shown_unit}'
        return '' if abs(left) > AT_END else f'{name} is at the end of its travel{at}'

    def toggle(self) -> None:
        """Show the pad, or hide it."""
        self._pad.set_visibility(not self._pad.visible)

    def _choose(self, event: events.ValueChangeEventArguments) -> None:
        """Take the step over."""
        self._step = str(event.value)
        self._pad.props(f'data-step={self._step}')

    async def _move(self, name: str, sign: int) -> None:
        """Move by a step."""
        if self._step == HOLD:
            return
        speed = self._share(name)
        request = step_of(name, sign * float(self._step), speed, self._axes)

        async def moved() -> Answer:
            return await asyncio.wrap_future(self._nodes.move_axes(request))

        await self._command(moved)

    def _beat(self, event: events.GenericEventArguments) -> None:
        """Pass a beat on, unless it is old or this page does not command; a stop is never old."""
        name, sign, heard = (event.args[key] for key in ('name', 'sign', 'heard'))
        is_fresh = isinstance(heard, int | float) and time.monotonic() - heard <= STALE
        if self._may_move() and (is_fresh or not name):
            known = name in (*self._names, TOOL)
            share = (1 if sign > 0 else -1) * self._share(name) if known else 0.0
            self._nodes.beat(beat_of(str(name), share, self._names))
            end = self._end(name, sign)
            if end and end != self._told:
                ui.notify(end, type='warning')
            self._told = end


TIP, AXIS = 'XYZ', 'IJK'


def pose_request(texts: dict[str, str], speed: float) -> MoveAxes.Request:
    """Return the request that moves the tool to a pose; an empty field stays as it is."""
    values = {name: float(text.replace(',', '.')) for name, text in texts.items() if text}
    if not values or not all(map(math.isfinite, values.values())):
        raise ValueError('write numbers')
    request = MoveAxes.Request(speed=speed)
    request.tip = [values.get(name, math.nan) * MM for name in TIP]
    if set(values) & set(AXIS):
        request.axis = [values.get(name, 0.0) for name in AXIS]
    return request


class PoseField:
    """The fields in one page."""

    def __init__(
        self,
        nodes: OperatorClient,
        speed: Callable[[], float],
        command: Callable[[Callable[[], Awaitable[Answer]]], Awaitable[None]],
    ):
        self._nodes, self._speed, self._command = nodes, speed, command
        self._fields: dict[str, Any] = {}
        with ui.element('div').classes('pose') as self._box:
            ui.label('go to a pose: tool tip in the workpiece, mm; tool axis').classes(
                'small wide'
            )
            for name in TIP + AXIS:
                field = ui.input()
                field.props(f'dense outlined inputmode=decimal autocomplete=off prefix={name}')
                self._fields[name] = field.props(f'data-mark="pose {name}"')
            self._key('here').on('click', self._take_here)
            go = self._key('go there').classes('moves')
            act_on_shown(go, 'click', self._fields.values(), self._go)
        self._box.set_visibility(False)

    @staticmethod
    def _key(text: str) -> Any:
        key = ui.button(text, color='blue-grey-8')
        return key.props(f'dense unelevated no-caps data-mark="{text}"')

    def toggle(self) -> None:
        """Show the fields, or hide them."""
        self._box.set_visibility(not self._box.visible)

    def _take_here(self) -> None:
        """Write where the tool is."""
        if (state := self._nodes.state) is not None:
            texts = [f'{value / MM:z.3f}' for value in state.tip]
            texts += [f'{value:z.5f}' for value in state.axis]
            for field, text in zip(self._fields.values(), texts, strict=True):
                field.set_value(text)

    async def _go(self) -> None:
        """Move to what the fields say."""
        texts = {name: str(field.value or '').strip() for name, field in self._fields.items()}
        try:
            request = pose_request(texts, self._speed())
        except ValueError:
            ui.notify('write numbers; a field that is empty stays as it is', type='warning')
            return

        async def moved() -> Answer:
            return await asyncio.wrap_future(self._nodes.move_axes(request))

        await self._command(moved)
