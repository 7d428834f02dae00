"""Programs, machines and HAL in other forms; drives and run times of a machine measured."""

import sys
from argparse import Namespace
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FINE, command
from cnc_interp.core import MM, UM, InterpError
from cnc_interp.settings.command_line import add_settings, settings_from

HAL_LIBRARY = Path('/usr/share/linuxcnc/hallib')  #: HAL files of LinuxCNC itself.


def add_convert_command(commands: Any) -> None:
    example = 'convert examples/pyramid.apt --to siemens-bspline --out pyramid.mpf'
    convert = command(commands, convert_command, example)
    convert.program_options()
    convert.add_argument(
        '--to',
        choices=('siemens-bspline', 'gcode', 'cl'),
        required=True,
        help='the smooth path as native B-splines, or the program as G1 blocks or GOTO points',
    )
    convert.option('--out', 'file to write (the terminal)', Path, 'FILE')
    convert.add_argument(
        '--join',
        choices=('polynomial', 'parametrization'),
        default='polynomial',
        help='native curves continue their neighbours by a small polynomial on their second '
        'points, or by sliding the tool axis along their top curves (polynomial)',
    )
    convert.number('--fit-tolerance', 1e-5, 'how closely cubic curves follow the smooth path')


def convert_command(options: Namespace) -> int:
    """Write a program in another dialect."""
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
    urdf = command(commands, urdf_command, 'urdf xyzac --out xyzac.urdf')
    urdf.option('machine', 'bundled machine or YAML file', metavar='M')
    urdf.option('--out', 'file to write (default: print it)', Path, 'FILE')

    example = 'hal my_machine.yaml core_stepper.hal pinout.hal --out my_machine.hal'
    hal = command(commands, hal_command, example)
    hal.option('machine', 'bundled machine or YAML file', metavar='M')
    text = 'HAL files of the LinuxCNC configuration, in the order of its INI file'
    hal.add_argument('files', type=Path, nargs='+', metavar='FILE', help=text)
    text = 'letter of the axis of joint 0, 1, 2 ... (XYZ ...; default: as in the machine file)'
    hal.add_argument('--joints', metavar='LETTERS', help=text)
    hal.option('--out', 'file to write (default: print it)', Path, 'FILE')

    ini = command(commands, import_ini_command, 'import-ini my_mill.ini --out my_mill.yaml')
    ini.option('file', 'INI file of LinuxCNC 2.8 or later', Path, 'FILE')
    ini.option('--out', 'machine file to write (default: print it)', Path, 'MACHINE')


def urdf_command(options: Namespace) -> int:
    """Write a machine as URDF, for robot_state_publisher, RViz and Foxglove."""
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.machine_model.machine import Machine

    _write(urdf_of(Machine.load(options.machine)), options.out)
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
    _write(made, options.out)
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
    _write(text, options.out)
    for note in notes:
        print(f'assumed: {note}', file=sys.stderr)
    return FINE


def _write(text: str, file: Path | None) -> None:
    if file is None:
        print(text, end='')
    else:
        file.write_text(text, encoding='utf-8')


def add_identify_commands(commands: Any) -> None:
    excite = command(commands, excite_command, 'excite --machine xyzac_tired --out out/excite.ngc')
    excite.machine_option()
    excite.option('--out', 'program to write', Path, 'FILE', required=True)

    identify = command(commands, identify_command, 'identify out/excited --out my_machine.yaml')
    identify.option('bag', 'bag of a run of that program', Path, 'BAG')
    identify.option('--machine', 'another machine than the bag names', metavar='M')
    identify.option('--out', 'machine file to write', Path, 'FILE', required=True)
    identify.option('--html', 'page to write (default: FILE with .html)', Path, 'FILE')

    example = 'fit-limits part_blocks.csv part.nc --machine mine.yaml --out fitted.yaml'
    fit = command(commands, fit_limits_command, example)
    told = 'CSV file time_s,block and the program that ran; further pairs may follow'
    fit.add_argument('pairs', nargs='+', type=Path, metavar='TRACE PROGRAM', help=told)
    fit.machine_option()
    add_settings(fit, live=True)
    fit.option('--out', 'machine file to write', Path, 'FILE', required=True)
    fit.option('--html', 'page to write (default: FILE with .html)', Path, 'FILE')

    learn = command(commands, learn_command, 'learn out/bag --out out/learnt.npz')
    learn.option('bag', 'bag of a run with --compensate, with its feedback', Path, 'BAG')
    text = 'file to write, for `run PROGRAM --compensate MODEL --learnt FILE`'
    learn.add_argument('--out', type=Path, required=True, metavar='FILE', help=text)


def excite_command(options: Namespace) -> int:
    """Write the part program that shows how the drives of a machine follow."""
    from cnc_interp.drives.identification import excitation
    from cnc_interp.machine_model.machine import Machine

    options.out.write_text(excitation(Machine.load(options.machine)), encoding='utf-8')
    return FINE


def identify_command(options: Namespace) -> int:
    """Fit the model of each drive to a recorded run, and write it into a machine file."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_feedback import recorded_feedback
    from cnc_interp.drives.identification import identify_axis, with_drives
    from cnc_interp.machine_model.machine import Machine, find_machine_file
    from cnc_interp.report.identified import identified_lines, write_identified

    with Bag(options.bag) as bag:
        if bag.parameters.get('machine_node.compensation'):
            raise InterpError(f'{options.bag}: was recorded with compensation; record one without')
        name = bag.machine(options.machine)
        run, machine = recorded_feedback(bag, name)
    found = {}
    for axis, letter in enumerate(machine.axis_names):
        print(f'fitting {letter}', flush=True)
        model = identify_axis(machine, axis, run.period, run.setpoint, run.rate, run.feedback)
        if model is not None:
            found[axis] = model
    if not found:
        raise InterpError(f'{options.bag}: no axis moved')
    for line in identified_lines(machine, found):
        print(line)
    text = with_drives(
        find_machine_file(name).read_text(encoding='utf-8'),
        machine,
        {**machine.drives, **{axis: each.drive for axis, each in found.items()}},
        {**machine.loads, **{axis: each.load for axis, each in found.items() if each.load}},
        {axis: each.half_width for axis, each in found.items()},
        options.bag.name,
    )
    options.out.write_text(text, encoding='utf-8')
    Machine.load(options.out)
    page = options.html or options.out.with_suffix('.html')
    write_identified(machine, found, run.period, page)
    print(f'machine file   {options.out}')
    print(f'page           {page}')
    return FINE


def fit_limits_command(options: Namespace) -> int:
    """Fit limits and times of a machine file to recorded runs, so that plans predict run times."""
    from cnc_interp.core.small_files import read_yaml
    from cnc_interp.machine_model.machine import Machine, find_machine_file
    from cnc_interp.report.identified import fitted_text, time_rows, value_text, write_fitted
    from cnc_interp.run.time_fit import Run, TimedProgram, TimeFit, Trace, measured_override

    if len(options.pairs) % 2:
        raise InterpError('each TRACE needs its PROGRAM after it')
    machine, settings = Machine.load(options.machine), settings_from(options)
    programs: dict[tuple[Path, float], TimedProgram] = {}
    runs = []
    for file, path in zip(options.pairs[::2], options.pairs[1::2], strict=True):
        trace = Trace.load(file)
        plain = programs.setdefault((path, 1.0), TimedProgram.load(path, machine, settings))
        override = measured_override(plain, trace)
        program = programs.setdefault((path, override), plain.overridden(override))
        runs.append(Run.of(program, trace))
        print(f'{file.name}: {len(runs[-1].windows)} windows, feed override {override:.1%}')
    found = TimeFit(machine, runs, lambda text: print(text, flush=True)).solve()
    for key, pair in found.values.items():
        print(f'  {key:50s} {value_text(*pair)}')
    for row in time_rows(runs, found):
        print('{}, lines {}: measured {} s, planned {} s, {}'.format(*row))
    content = read_yaml(find_machine_file(options.machine))
    text = fitted_text(content, found, [run.trace.name for run in runs])
    options.out.write_text(text, encoding='utf-8')
    Machine.load(options.out)
    page = options.html or options.out.with_suffix('.html')
    write_fitted(runs, found, page)
    print(f'machine file   {options.out}')
    print(f'page           {page}')
    return FINE


def learn_command(options: Namespace) -> int:
    """Learn from a recorded, compensated run how to follow the same program better."""
    from cnc_interp.client.bag import Bag
    from cnc_interp.client.recorded_feedback import recorded_lesson

    with Bag(options.bag) as bag:
        lesson = recorded_lesson(bag)
    lesson.motion.save(options.out)
    print('run   tip, largest   tip, mean')
    for number, (largest, mean) in enumerate(lesson.motion.error / UM, 1):
        print(f'{number:3d}   {largest:9.1f} um   {mean:6.2f} um')
    print(f'runs learnt    {len(lesson.motion.error)}')
    print(f'written        {options.out}')
    return FINE
