"""Settings as names and texts in SI, the form in which messages and files carry them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from cnc_interp.core.errors import SettingsError
from cnc_interp.settings.choices import Settings
from cnc_interp.settings.declaration import Value, choices


def texts_of(settings: Settings) -> dict[str, str]:
    """Return every choice as exact text."""
    return {c.name: c.text(getattr(settings, c.name)) for c in choices(settings)}


def changed(settings: Settings) -> list[str]:
    """Return the names of the choices that differ from their defaults."""
    return [c.name for c in choices(settings) if getattr(settings, c.name) != c.default]


def values_of(settings: Settings) -> dict[str, Value]:
    """Return every choice as a value that JSON can hold; a path becomes text."""
    found = {choice.name: getattr(settings, choice.name) for choice in choices(settings)}
    return {k: str(v.resolve()) if hasattr(v, 'resolve') else v for k, v in found.items()}


def with_texts(
    settings: Settings, texts: Iterable[tuple[str, str]], need_units: bool = False
) -> Settings:
    """
    Return settings with some choices replaced.

    Parameters
    ----------
    settings : Settings
        The choices where no text is given.
    texts : iterable of (str, str)
        Names of choices and their values as text; a number without a unit is in SI.
    need_units : bool
        Refuse a number without its unit, because a person wrote it.

    Raises
    ------
    SettingsError
        If a name is unknown or given twice, or a value is not possible; names the choice.

    """
    known = {choice.name: choice for choice in choices(settings)}
    given: dict[str, Any] = {}
    for name, text in texts:
        if name not in known:
            raise SettingsError(name, f'this choice is unknown; known: {", ".join(known)}')
        if name in given:
            raise SettingsError(name, 'this choice is given twice; give it once')
        given[name] = known[name].from_text(text, need_units)
    return replace(settings, **given)
