"""`cnc-interp convert`: a program in another dialect."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command, number, program_options
from cnc_interp.core.units import MM
from cnc_interp.settings.command_line import settings_from


def add_convert_command(commands: Any) -> None:
    """Declare `convert`."""
    convert = command(
        commands, 'convert', convert_command,
        'write a program in another dialect',
        'cnc-interp convert examples/pyramid.apt --to siemens-bspline --out pyramid.mpf',
    )  # fmt: skip
    program_options(convert)
    convert.add_argument(
        '--to', choices=('siemens-bspline', 'gcode', 'cl'), required=True,
        help='the smooth path as native B-splines, or the program as G1 blocks or GOTO points',
    )  # fmt: skip
    convert.add_argument('--out', type=Path, metavar='FILE', help='file to write (the terminal)')
    convert.add_argument(
        '--join', choices=('polynomial', 'parametrization'), default='polynomial',
        help='native curves continue their neighbours by a small polynomial on their second '
        'points, or by sliding the tool axis along their top curves (polynomial)',
    )  # fmt: skip
    number(convert, '--fit-tolerance', 1e-5, 'how closely cubic curves follow the smooth path')


def convert_command(options: argparse.Namespace) -> int:
    """Write a program in another dialect."""
    from cnc_interp.convert.dialects import convert
    from cnc_interp.machine_model.machine import Machine
    from cnc_interp.machine_model.transform import Transform
    from cnc_interp.program import read_program
    from cnc_interp.program.notices import tell

    machine = Machine.load(options.machine)
    settings = settings_from(options)
    program = read_program(options.program, Transform.of(machine), settings)
    tell(program.notices)
    tolerance = options.fit_tolerance * MM
    slide = options.join == 'parametrization'
    made = convert(program, machine, settings, options.to, tolerance, slide)
    if options.out is None:
        print(made.text, end='')
    else:
        options.out.write_text(made.text, encoding='utf-8')
        print(f'program        {options.out}')
    tell(made.notes)
    return FINE


def add_urdf_command(commands: Any) -> None:
    """Declare `urdf`."""
    urdf = command(
        commands, 'urdf', urdf_command,
        'write a machine as URDF, for robot_state_publisher, RViz and Foxglove',
        'cnc-interp urdf xyzac --out xyzac.urdf',
    )  # fmt: skip
    urdf.add_argument('machine', metavar='M', help='bundled machine or YAML file')
    urdf.add_argument('--out', type=Path, metavar='FILE', help='file to write (default: print it)')


def urdf_command(options: argparse.Namespace) -> int:
    """Write a machine as URDF."""
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.machine_model.machine import Machine

    text = urdf_of(Machine.load(options.machine))
    if options.out is None:
        print(text, end='')
    else:
        options.out.write_text(text, encoding='utf-8')
    return FINE
