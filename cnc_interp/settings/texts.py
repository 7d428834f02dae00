"""Settings as texts: in SI, as messages and files carry them; in shop units, as a form does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from cnc_interp.core.errors import SettingsError
from cnc_interp.settings.choices import Settings
from cnc_interp.settings.declaration import Choice, Stage, Value, choices


def texts_of(settings: Settings) -> dict[str, str]:
    return {c.name: c.text(getattr(settings, c.name)) for c in choices(settings)}


def changed(settings: Settings) -> list[str]:
    return [c.name for c in choices(settings) if getattr(settings, c.name) != c.default]


def values_of(settings: Settings) -> dict[str, Value]:
    """Return every choice as a value that JSON can hold; a path becomes text."""
    found = {choice.name: getattr(settings, choice.name) for choice in choices(settings)}
    return {k: str(v.resolve()) if hasattr(v, 'resolve') else v for k, v in found.items()}


def with_texts(
    settings: Settings, texts: Iterable[tuple[str, str]], need_units: bool = False
) -> Settings:
    """Return settings with some choices replaced by texts; a number without a unit is in SI.

    ``need_units`` refuses such a number, because a person wrote it. Raises SettingsError.
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


def offered() -> tuple[Choice, ...]:
    """Return the choices on the page: of reading and smoothing, not the period."""
    found = choices(Settings, Stage.READING, Stage.SMOOTHING)
    return tuple(choice for choice in found if not choice.for_comparison)


def filled_in(settings: Settings) -> dict[str, str]:
    """Return the contents of the fields, in shop units."""
    return {choice.name: choice.shop_text(getattr(settings, choice.name)) for choice in offered()}


def settings_filled_in(settings: Settings, texts: Mapping[str, str]) -> Settings:
    """Return settings with the fields of the form, in shop units; raises SettingsError."""
    return replace(settings, **{c.name: c.from_shop(texts[c.name]) for c in offered()})
