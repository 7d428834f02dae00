"""Settings as the fields of a form, in units of the shop floor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from cnc_interp.settings.choices import Settings
from cnc_interp.settings.declaration import Choice, Stage, choices


def offered() -> tuple[Choice, ...]:
    """Return the choices on the page: of reading and smoothing, not the period."""
    found = choices(Settings, Stage.READING, Stage.SMOOTHING)
    return tuple(choice for choice in found if not choice.for_comparison)


def filled_in(settings: Settings) -> dict[str, str]:
    """Return the contents of the fields, in shop units."""
    return {choice.name: choice.shop_text(getattr(settings, choice.name)) for choice in offered()}


def settings_filled_in(settings: Settings, texts: Mapping[str, str]) -> Settings:
    """
    Return settings with the contents of the fields.

    Parameters
    ----------
    settings : Settings
        The choices that the dialog does not offer.
    texts : mapping of str to str
        Contents of the fields by name of the choice, in units of the shop floor.

    Raises
    ------
    SettingsError
        If a field holds no value of its choice; names the choice.

    """
    return replace(settings, **{c.name: c.from_shop(texts[c.name]) for c in offered()})
