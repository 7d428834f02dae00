"""`cnc-interp convert`, `urdf`, `hal`, `import-ini`: programs, machines, HAL in other forms."""

import argparse
import sys
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command
from cnc_interp.core import MM
from cnc_interp.settings.command_line import settings_from


def add_convert_command(commands: Any) -> None:
    convert = command(
        commands, 'convert', convert_command,
        'write a program in another dialect',
        'cnc-interp convert examples/pyramid.apt --to siemens-bspline --out pyramid.mpf',
    )  # fmt: skip
    convert.program_options()
    convert.add_argument(
        '--to', choices=('siemens-bspline', 'gcode', 'cl'), required=True,
        help='the smooth path as native B-splines, or the program as G1 blocks or GOTO points',
    )  # fmt: skip
    convert.option('--out', 'file to write (the terminal)', Path, 'FILE')
    convert.add_argument(
        '--join', choices=('polynomial', 'parametrization'), default='polynomial',
        help='native curves continue their neighbours by a small polynomial on their second '
        'points, or by sliding the tool axis along their top curves (polynomial)',
    )  # fmt: skip
    convert.number('--fit-tolerance', 1e-5, 'how closely cubic curves follow the smooth path')


def convert_command(options: argparse.Namespace) -> int:
    from cnc_interp.convert.conversion import convert
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
    _write(made.text, options.out)
    if options.out is not None:
        print(f'program        {options.out}')
    tell(made.notes)
    return FINE


def add_machine_commands(commands: Any) -> None:
    urdf = command(
        commands, 'urdf', urdf_command,
        'write a machine as URDF, for robot_state_publisher, RViz and Foxglove',
        'cnc-interp urdf xyzac --out xyzac.urdf',
    )  # fmt: skip
    urdf.option('machine', 'bundled machine or YAML file', metavar='M')
    urdf.option('--out', 'file to write (default: print it)', Path, 'FILE')

    hal = command(
        commands, 'hal', hal_command,
        'write a HAL file with cnc_interp in the place of the motion controller of LinuxCNC',
        'cnc-interp hal my_machine.yaml core_stepper.hal pinout.hal --out my_machine.hal',
    )  # fmt: skip
    hal.option('machine', 'bundled machine or YAML file', metavar='M')
    text = 'HAL files of the LinuxCNC configuration, in the order of its INI file'
    hal.add_argument('files', type=Path, nargs='+', metavar='FILE', help=text)
    text = 'letter of the axis of joint 0, 1, 2 ... (XYZ ...; default: as in the machine file)'
    hal.add_argument('--joints', metavar='LETTERS', help=text)
    hal.option('--out', 'file to write (default: print it)', Path, 'FILE')

    ini = command(
        commands, 'import-ini', import_ini_command,
        'write a machine file from the INI file of a LinuxCNC machine',
        'cnc-interp import-ini my_mill.ini --out my_mill.yaml',
    )  # fmt: skip
    ini.option('file', 'INI file of LinuxCNC 2.8 or later', Path, 'FILE')
    ini.option('--out', 'machine file to write (default: print it)', Path, 'MACHINE')


def urdf_command(options: argparse.Namespace) -> int:
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.machine_model.machine import Machine

    _write(urdf_of(Machine.load(options.machine)), options.out)
    return FINE


def hal_command(options: argparse.Namespace) -> int:
    from cnc_interp.machine.hal_file import hal_file
    from cnc_interp.machine_model.machine import Machine

    machine = Machine.load(options.machine)
    axes = machine.axis_names
    text = '\n'.join(file.read_text(encoding='utf-8', errors='replace') for file in options.files)
    joints = (options.joints or ''.join(axes)).upper()
    made, left_out = hal_file(text, axes, joints, machine.signals)
    _write(made, options.out)
    for line in left_out:
        print(f'not connected: {line}', file=sys.stderr)
    return FINE


def import_ini_command(options: argparse.Namespace) -> int:
    from cnc_interp.convert.linuxcnc_ini import machine_from_ini

    text, notes = machine_from_ini(options.file)
    _write(text, options.out)
    for note in notes:
        print(f'assumed: {note}', file=sys.stderr)
    return FINE


def _write(text: str, file: Path | None) -> None:
    if file is None:
        print(text, end='')
    else:
        file.write_text(text, encoding='utf-8')
