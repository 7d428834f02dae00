"""Fields of numbers over the view: a tool pose to go to, and what the axes read (touch-off)."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from nicegui import ui

from cnc_interp.client.hand_move import POSE, pose_request
from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.client.setup_client import SetupClient, of_axes
from cnc_interp.page.contact import Command, act_on_shown, asked, key
from cnc_interp.page.shown_unit import ShownUnit


class NumberFields:
    """Fields with a title, which cover nothing but the view."""

    def __init__(
        self, title: str, mark: str, names: Iterable[str], unit: ShownUnit, command: Command
    ):
        self._unit, self._command = unit, command
        with ui.element('div').classes(f'pose {mark}') as self._box:
            unit.label(title).classes('small wide')
            self._fields = {name: self._field(name, mark) for name in names}
        self._box.set_visibility(False)

    @staticmethod
    def _field(name: str, mark: str) -> Any:
        field = ui.input().props('dense outlined inputmode=decimal autocomplete=off')
        return field.props(f'prefix={name} data-mark="{mark} {name}"')

    def _reading_key(self, text: str, act: Callable[[dict[str, float]], Awaitable[None]]) -> Any:
        """Make a key that acts on the numbers in the fields."""

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
        """Show the fields in the place of others, or hide them."""
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
    """Tool tip and tool axis to go to."""

    def __init__(
        self,
        nodes: OperatorClient,
        speed: Callable[[], float],
        unit: ShownUnit,
        command: Command,
    ):
        title = 'go to a pose: tool tip in the workpiece, mm; tool axis'
        super().__init__(title, 'pose', POSE, unit, command)
        self._nodes, self._speed = nodes, speed
        with self._box:
            key('here', act=self._take_here)
        self._reading_key('go there', self._go).classes('moves')

    def _take_here(self) -> None:
        if (state := self._nodes.state) is not None:
            texts = [self._unit.now.length(value) for value in state.tip]
            texts += [f'{value:z.5f}' for value in state.axis]
            for field, text in zip(self._fields.values(), texts, strict=True):
                field.set_value(text)

    async def _go(self, values: dict[str, float]) -> None:
        request = pose_request(values, self._speed(), self._unit.now.size)
        await self._command(asked(self._nodes.move_axes, request))


class TouchOffField(NumberFields):
    """What the axes read where they stand."""

    def __init__(self, setup: SetupClient, axes: Iterable[str], unit: ShownUnit, command: Command):
        title = 'touch off: here reads, in the active offset, mm or °'
        super().__init__(title, 'here', axes, unit, command)
        self._setup = setup
        self._reading_key('touch off', self._touch_off).classes('wide')

    async def _touch_off(self, values: dict[str, float]) -> None:
        """Set the active offset; what is empty stays as it is."""
        found = {name: value * self._unit.now.of(name) for name, value in values.items()}

        async def touched() -> Answer:
            answer = await asyncio.wrap_future(self._setup.ask('touch_off', **of_axes(found)))
            if answer.ok:
                ui.notify(answer.message.partition(': ')[2])
            return answer

        await self._command(touched)
