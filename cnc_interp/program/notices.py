"""Notices: what a reader passed on or simplified, for the user to know."""

from __future__ import annotations


class Notices:
    """Harmless findings of a reader, each noted once with the line where it first stood."""

    def __init__(self) -> None:
        self._texts: dict[str, str] = {}

    def once(self, key: str, line_number: int, text: str) -> None:
        """Note ``text`` unless something was noted under ``key`` before."""
        if key not in self._texts:
            self._texts[key] = f'line {line_number}: {text}'

    def texts(self) -> tuple[str, ...]:
        """All notices in the order of the program."""
        return tuple(self._texts.values())
