"""The unit of lengths that one page shows."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nicegui import ui

from cnc_interp.client.length_unit import MILLIMETRES, LengthUnit


class ShownUnit:
    """The unit that counts now, and what on the page names it."""

    def __init__(self) -> None:
        self.now = MILLIMETRES
        self._followers: list[Callable[[LengthUnit], None]] = []

    def follow(self, act: Callable[[LengthUnit], None]) -> None:
        self._followers.append(act)

    def label(self, text: str) -> Any:
        label = ui.label(self.now.named(text))
        self.follow(lambda unit: label.set_text(unit.named(text)))
        return label

    def use(self, unit: LengthUnit) -> None:
        if unit is not self.now:
            self.now = unit
            for act in self._followers:
                act(unit)
