"""Machines in other forms: URDF, HAL files, and machine files from LinuxCNC's configuration."""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command, flag, option, write
from cnc_interp.core import InterpError

HAL_LIBRARY = Path('/usr/share/linuxcnc/hallib')  #: HAL files of LinuxCNC itself.


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
        'hal my_machine.yaml core_stepper.hal pinout.hal --out my_machine.hal',
        option('machine', 'bundled machine or YAML file', metavar='M'),
        option(
            'files',
            'HAL files of the LinuxCNC configuration, in the order of its INI file',
            Path,
            'FILE',
            nargs='+',
        ),
        option(
            '--joints',
            'letter of the axis of joint 0, 1, 2 ... (XYZ ...; default: as in the machine file)',
            metavar='LETTERS',
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


def hal_command(options: Namespace) -> int:
    """Write a HAL file with cnc_interp in the place of the motion controller of LinuxCNC."""
    from cnc_interp.machine.hal_file import hal_file
    from cnc_interp.machine_model.machine import Machine

    machine = Machine.load(options.machine)
    axes = machine.axis_names
    text = '\n'.join(_hal_file(file).read_text('utf-8', 'replace') for file in options.files)
    joints = (options.joints or ''.join(axes)).upper()
    made, left_out = hal_file(text, axes, joints, machine.signals)
    write(made, options.out)
    for line in left_out:
        print(f'not connected: {line}', file=sys.stderr)
    return FINE


def _hal_file(file: Path) -> Path:
    """Return where LinuxCNC finds it: here, or among its own files."""
    if file.suffix == '.tcl':
        raise InterpError(f'{file}: is Tcl, which is not read; give HAL files that do the same')
    own = HAL_LIBRARY / file.name.removeprefix('LIB:')
    return own if own.is_file() and not file.exists() else file


def import_ini_command(options: Namespace) -> int:
    """Write a machine file from the INI file of a LinuxCNC machine."""
    from cnc_interp.convert.linuxcnc_ini import machine_from_ini

    text, notes = machine_from_ini(options.file)
    write(text, options.out)
    for note in notes:
        print(f'assumed: {note}', file=sys.stderr)
    return FINE
