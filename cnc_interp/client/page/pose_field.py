"""The fields of a page that move the tool to a pose in the workpiece frame."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable
from typing import Any

from cnc_interp_msgs.srv import MoveAxes
from nicegui import ui

from cnc_interp.client.operator_client import Answer, OperatorClient
from cnc_interp.client.page.shown import act_on_shown
from cnc_interp.core.units import MM

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
