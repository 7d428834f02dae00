"""Machines in other forms: URDF, HAL files, and machine files from LinuxCNC's configuration."""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command, flag, option, write
from cnc_interp.core import InterpError


def add_machine_commands(commands: Any) -> None:
    command(
        commands,
        urdf_command,
        'urdf xyzac --out xyzac.urdf',
        option('machine', 'bundled machine or YAML file', metavar='M'),
        option(
            '--scene',
            'scene whose bodies are drawn instead of simple shapes; STL files beside --out hold '
            'them',
            Path,
            'FILE',
        ),
        flag('--frames', 'links and joints only, without shapes: markers_node draws the bodies'),
        option('--out', 'file to write (default: print it)', Path, 'FILE'),
    )
    command(
        commands,
        hal_command,
        'hal my_machine.yaml my_machine.ini --out my_machine.hal',
        option('machine', 'bundled machine or YAML file', metavar='M'),
        option(
            'files',
            'INI file of the LinuxCNC configuration, or its HAL files in their order',
            Path,
            'FILE',
            nargs='+',
        ),
        option(
            '--joints',
            'letter of the axis of joint 0, 1, 2 ... (XYYZ ...; default: as in the INI file, or '
            'as in the machine file)',
            metavar='LETTERS',
        ),
        option(
            '--units',
            'unit of lengths in the HAL files (default: as in the INI file, or mm)',
            choices=('mm', 'inch'),
        ),
        option('--out', 'file to write (default: print it)', Path, 'FILE'),
    )
    command(
        commands,
        import_ini_command,
        'import-ini my_mill.ini --out my_mill.yaml',
        option('file', 'INI file of LinuxCNC 2.8 or later', Path, 'FILE'),
        option('--out', 'machine file to write (default: print it)', Path, 'MACHINE'),
    )
    machine = commands.add_parser('machine', help='make a machine file by questions')
    command(
        machine.add_subparsers(required=True, metavar='COMMAND'),
        new_command,
        'machine new my_machine.yaml',
        option('file', 'machine file to write', Path, 'FILE'),
    )


def urdf_command(options: Namespace) -> int:
    """Write a machine as URDF, for robot_state_publisher, RViz and Foxglove."""
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.machine_model.machine import Machine

    machine, scene = Machine.load(options.machine), options.scene
    if scene is None:
        write(urdf_of(machine, frames_only=options.frames), options.out)
        return FINE
    if options.out is None:
        raise InterpError('--scene writes STL files beside the URDF: give --out FILE, too')
    from cnc_interp.collision.drawing import drawn_bodies
    from cnc_interp.collision.scene_file import read_scene

    read = read_scene(scene)
    bodies = [body for body in drawn_bodies(read, machine) if body.tool in (0, read.first_tool)]
    folder = options.out.resolve().with_suffix('.meshes')
    folder.mkdir(parents=True, exist_ok=True)
    files = [folder / f'{k}.stl' for k in range(len(bodies))]
    for body, file in zip(bodies, files, strict=True):
        file.write_bytes(body.stl())
    write(urdf_of(machine, bodies, [file.as_uri() for file in files]), options.out)
    return FINE


def new_command(options: Namespace) -> int:
    """Ask for layout, axes and limits of a machine, write its file and show it."""
    import yaml

    from cnc_interp.convert.machine_questions import ask_machine, shown
    from cnc_interp.machine_model.machine import Machine

    if options.file.exists():
        raise InterpError(f'{options.file} exists; give the name of a new file')
    print('Press Enter to accept the value in brackets.')
    try:
        content = ask_machine(input, print)
    except EOFError:
        raise InterpError(
            'the answers ended before the last question; nothing is written'
        ) from None
    write(yaml.safe_dump(content, sort_keys=False, default_flow_style=None), options.file)
    print('\n'.join(['', *shown(Machine.load(options.file))]))
    print(f'\nSee it: cnc-interp urdf {options.file} --out {options.file.with_suffix(".urdf")}')
    return FINE


def hal_command(options: Namespace) -> int:
    """Write a HAL file with cnc_interp in the place of the motion controller of LinuxCNC."""
    from cnc_interp.convert.linuxcnc_files import hal_lines, read_ini
    from cnc_interp.convert.linuxcnc_hal import hal_file
    from cnc_interp.convert.linuxcnc_wiring import wiring_of
    from cnc_interp.machine_model.machine import Machine

    machine, files = Machine.load(options.machine), options.files
    ini = next((read_ini(file) for file in files if file.suffix == '.ini'), None)
    wiring, told = wiring_of(machine, ini, options.joints, options.units)
    made, left_out = hal_file(
        '\n'.join(hal_lines(files, ini)), machine.axis_names, wiring, machine.signals
    )
    write(made, options.out)
    for line in (*told, *(f'not connected: {line}' for line in left_out)):
        print(line, file=sys.stderr)
    return FINE


def import_ini_command(options: Namespace) -> int:
    """Write a machine file from the INI file of a LinuxCNC machine."""
    from cnc_interp.convert.linuxcnc_ini import machine_from_ini

    text, assumed, ignored = machine_from_ini(options.file)
    write(text, options.out)
    lines = [f'assumed: {line}' for line in assumed] + [f'ignored: {line}' for line in ignored]
    for line in lines:
        print(line, file=sys.stderr)
    return FINE
