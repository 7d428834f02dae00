"""Settings as options of a command, and back."""

import argparse
from collections.abc import Callable
from typing import Any

from cnc_interp.core import SettingsError
from cnc_interp.settings.option_kinds import Choice, Stage, choices
from cnc_interp.settings.options import Settings


def add_settings(parser: argparse.ArgumentParser, live: bool = False) -> None:
    for choice in choices(Settings):
        if not (live and choice.stage is Stage.OFFLINE):
            _add(parser, choice)


def _add(parser: argparse.ArgumentParser, choice: Choice) -> None:
    name, told = f'--{choice.option}', choice.sentence
    more: dict[str, Any] = {'dest': choice.name, 'default': choice.default}
    if choice.kind is bool and not choice.default:
        parser.add_argument(name, action='store_true', help=told, **more)
        return
    if choice.kind is bool:
        help_text = f'{told} (--{choice.option})'
        parser.add_argument(name, action=argparse.BooleanOptionalAction, help=help_text, **more)
        return
    if choice.default is not None or choice.nothing:
        told = f'{told} ({choice.shown(choice.default)})'
    if choice.values:
        more['choices'] = choice.values
    else:
        more |= {'type': _reader(choice), 'metavar': choice.metavar}
    parser.add_argument(name, help=told, **more)


def _reader(choice: Choice) -> Callable[[str], Any]:
    def read(text: str) -> Any:
        try:
            return choice.from_shop(text)
        except SettingsError as problem:
            raise argparse.ArgumentTypeError(problem.reason) from None

    return read


def settings_from(options: argparse.Namespace) -> Settings:
    offered = (choice.name for choice in choices(Settings) if hasattr(options, choice.name))
    return Settings(**{name: getattr(options, name) for name in offered})


def command_words(settings: Settings) -> list[str]:
    """Return the options of the command line that give these settings; defaults are left out."""
    words = []
    for choice in choices(settings):
        value = getattr(settings, choice.name)
        if value == choice.default:
            continue
        if choice.kind is bool:
            words.append(f'--{choice.option}' if value else f'--no-{choice.option}')
        else:
            words.append(f'--{choice.option}={choice.shop_text(value)}')
    return words
