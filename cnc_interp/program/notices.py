"""Notices: words of a program that had no effect or were simplified."""

from __future__ import annotations


class Notices:
    """Notices about harmless words, each one recorded once with its first line."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def once(self, key: str, line_number: int, text: str) -> None:
        """Record a notice, unless there already is one with this key."""
        if key not in self._texts:
            self._texts[key] = f'line {line_number}: {text}'

    def texts(self) -> tuple[str, ...]:
        """Return all notices in the order of the program."""
        return tuple(self._texts.values())
