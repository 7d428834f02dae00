"""Options that several commands share; those of settings follow from the declarations."""

from __future__ import annotations

import argparse
import difflib
import math
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from cnc_interp.machine.drive_kinds import CHOICE, KINDS
from cnc_interp.settings.command_line import add_settings
from cnc_interp.settings.options import DEFAULT_MACHINE

#: Exit codes: done, a failed run or an unproven plan, bad input.
FINE, FAILED, BAD_INPUT = 0, 1, 2


def program_file(text: str) -> Path:
    """Return the path of a program; examples in help texts are found from every folder."""
    file = Path(text)
    if file.parts[:1] != ('examples',) or file.exists():
        return file
    from cnc_interp.core.small_files import config_directory

    bundled = config_directory().parent / file
    return bundled if bundled.is_file() else file


class CommandParser(argparse.ArgumentParser):
    """A parser that reports mistakes in one line, with the option that may be meant."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse the arguments; reject an unknown option and suggest the nearest known one."""
        found, rest = super().parse_known_args(args, namespace)
        unknown = next((word for word in rest if word.startswith('--') and word != '--'), None)
        if unknown is not None:
            self.error(self.unknown_option(unknown.partition('=')[0]))
        return found, rest

    def unknown_option(self, name: str) -> str:
        if any(option.startswith(name) for option in self._option_string_actions):
            return ''
        near = difflib.get_close_matches(name, self._option_string_actions, 1)
        hint = f'did you mean {near[0]}?' if near else f'see {self.prog} --help'
        return f'unknown option {name}; {hint}'

    def of(self, command: str) -> CommandParser:
        for action in self._actions:
            if isinstance(action, argparse._SubParsersAction):
                found: CommandParser = action.choices.get(command, self)
                return found
        return self

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f'{self.prog}: {message}\n')


#: A function that adds an option, an argument, or the options of settings to a parser.
Adds = Callable[[argparse.ArgumentParser], object]


def option(name: str, meaning: str, kind: Any = None, metavar: Any = None, **more: Any) -> Adds:
    """Return a function that adds an option, or an argument if its name has no dashes."""
    names = name.split()
    return lambda to: to.add_argument(*names, help=meaning, type=kind, metavar=metavar, **more)


def flag(name: str, meaning: str) -> Adds:
    return lambda to: to.add_argument(name, action='store_true', help=meaning)


def number(name: str, default: float, meaning: str, unit: str = 'MM') -> Adds:
    text = f'{meaning} ({default:g} {unit.lower().replace("_per_", "/")})'
    return option(name, text, positive, unit, default=default)


def workers_option(meaning: str) -> Adds:
    here = len(os.sched_getaffinity(0))
    return option('--workers', f'{meaning} (one for each processor)', count, 'N', default=here)


def machine_option() -> Adds:
    text = f'bundled machine or YAML file ({DEFAULT_MACHINE})'
    return option('--machine', text, metavar='M', default=DEFAULT_MACHINE)


def program_options(live: bool = False) -> tuple[Adds, ...]:
    return (
        option('program', 'G-code or CL data file', program_file, 'PROGRAM'),
        machine_option(),
        partial(add_settings, live=live),
        flag('--json', 'print the summary as JSON'),
    )


def nodes_options() -> tuple[Adds, ...]:
    return (
        option('--namespace', 'ROS namespace of the nodes (/)', metavar='NS', default='/'),
        option('--domain', 'ROS domain (ROS_DOMAIN_ID)', int, 'N'),
    )


def drives_option() -> Adds:
    text = f'drives of the machine, with their parameters of machine_node. {CHOICE} (simulated)'
    return option('--drives', text, drives, 'KIND[,PARAMETER=VALUE ...]', default={})


def page_options() -> tuple[Adds, ...]:
    text = (
        'file with the token that commands from the page need (default: a random token is printed)'
    )
    return (
        option('--host', 'address of the operator page (127.0.0.1)', default='127.0.0.1'),
        option('--port', 'its port, 0 for any free one (8650)', int, default=8650),
        option('--token-file', text, Path, 'FILE'),
    )


def command(commands: Any, function: Any, example: str, *options: Adds) -> CommandParser:
    """Add a command with the name of its function and its docstring as description."""
    name = function.__name__.removesuffix('_command').replace('_', '-')
    told = str(function.__doc__)
    purpose = told[0].lower() + told[1:].rstrip('.')
    added: CommandParser = commands.add_parser(
        name, help=purpose, description=told, epilog=f'example: cnc-interp {example}'
    )
    added.set_defaults(command=function)
    for add in options:
        add(added)
    return added


def drives(text: str) -> dict[str, str]:
    name, *pairs = text.split(',')
    if name not in KINDS:
        raise argparse.ArgumentTypeError(f'{name!r} is unknown; choose {", ".join(KINDS)}')
    known = {each.name: each for each in KINDS[name].parameters}
    given = {'drives': name}
    for pair in pairs:
        key, _, value = (part.strip() for part in pair.partition('='))
        if key not in known or not value or set(value) & set('\'"'):
            raise argparse.ArgumentTypeError(
                f'{pair!r} is no parameter of {name} drives ({", ".join(known) or "none"})'
            )
        given[key] = known[key].value_text(value)
    return given


def positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f'must be a positive number, not {text!r}')
    return value


def count(text: str) -> int:
    try:
        value = int(text)
    except ValueError:
        value = 0
    if value < 1:
        raise argparse.ArgumentTypeError(f'must be a whole number, 1 or more, not {text!r}')
    return value


def write(text: str, file: Path | None) -> None:
    """Write the output of a command to a file, or to the terminal."""
    if file is None:
        print(text, end='')
    else:
        file.write_text(text, encoding='utf-8')
