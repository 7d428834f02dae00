"""
Keys that act on what their page shows.

The server has a copy of the text in each field. What is sent into a connection that breaks is
gone, and then the copy is old. So a key that reads fields sends the texts in them when pressed.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable
from typing import Any

from nicegui import events, ui


def act_on_shown(
    element: Any, kind: str, fields: Iterable[Any], act: Callable[[], Awaitable[None]]
) -> None:
    """Have an element act on an event, after its fields have got the texts that the page shows."""

    async def acted(event: events.GenericEventArguments) -> None:
        shown = event.args if isinstance(event.args, dict) else {}
        for field in fields:
            text = shown.get(field.props['data-mark'])
            if isinstance(field, ui.input) and isinstance(text, str):
                field.set_value(text)
        await act()

    element.on(kind, acted, js_handler='() => emit(shown())')
