"""A key of the page that turns something on and off; it is lit while that is on."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from nicegui import ui


class Switch:
    """The switch in one page."""

    def __init__(
        self, name: str, is_on: Callable[[], bool], turn: Callable[[bool], Awaitable[None]]
    ):
        self._is_on, self._turn, self._shown = is_on, turn, False
        self.key = ui.button(name, on_click=self._press, color='blue-grey-9').classes('switch')
        self.key.props(f'unelevated no-caps data-mark="{name}" aria-pressed=false')

    async def _press(self) -> None:
        await self._turn(not self._is_on())

    def show(self) -> None:
        """Light the key while it is on."""
        if self._is_on() != self._shown:
            self._shown = not self._shown
            self.key.props(
                f'color={"primary" if self._shown else "blue-grey-9"} '
                f'aria-pressed={"true" if self._shown else "false"}'
            )
