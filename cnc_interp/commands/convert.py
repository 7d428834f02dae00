"""Programs in other dialects."""

from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command, number, option, program_options, write
from cnc_interp.core import MM
from cnc_interp.settings.command_line import settings_from


def add_convert_command(commands: Any) -> None:
    command(
        commands,
        convert_command,
        'convert examples/pyramid.apt --to siemens-bspline --out pyramid.mpf',
        *program_options(),
        option(
            '--to',
            'the smooth path as native B-splines, or the program as G1 blocks or GOTO points',
            choices=('siemens-bspline', 'gcode', 'cl'),
            required=True,
        ),
        option('--out', 'file to write (the terminal)', Path, 'FILE'),
        option(
            '--join',
            'how native curves continue their neighbours: a small polynomial is added to their '
            'second points, or the tool axis slides along their top curves (polynomial)',
            choices=('polynomial', 'parametrization'),
            default='polynomial',
        ),
        number('--fit-tolerance', 1e-5, 'how closely cubic curves follow the smooth path'),
    )


def convert_command(options: Namespace) -> int:
    """Write a program in another dialect."""
    from cnc_interp.convert.conversion import convert
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.machine_model.transform_port import Transform
    from cnc_interp.program import read_program
    from cnc_interp.program.notices import tell

    machine = Machine.load(options.machine)
    settings = settings_from(options)
    program = read_program(options.program, Transform.of(machine), settings)
    tell(program.notices)
    tolerance = options.fit_tolerance * MM
    slide = options.join == 'parametrization'
    made = convert(program, machine, settings, options.to, tolerance, slide)
    write(made.text, options.out)
    if options.out is not None:
        print(f'program        {options.out}')
    tell(made.notes)
    return FINE
