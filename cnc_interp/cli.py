"""The `cnc-interp` command: words of the shop floor in, one clear line per mistake out."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path

from cnc_interp import __version__
from cnc_interp.cam.command import add_cam_commands
from cnc_interp.client.bag_command import add_bag_commands, check_bag, is_bag, report_bag
from cnc_interp.command_options import command, number, page_options, program_options
from cnc_interp.core.errors import InterpError
from cnc_interp.core.units import MM
from cnc_interp.settings.command_line import settings_from

FINE, FAILED, BAD_INPUT = 0, 1, 2
#: Text is not drawn wider than this [characters].
WIDEST = 100


def main(arguments: Sequence[str] | None = None) -> int:
    """
    Run the command line.

    Returns
    -------
    int
        0 fine, 1 a failed run or an unproven plan, 2 bad input.

    """
    options = parser().parse_args(arguments)
    try:
        return int(options.command(options))
    except InterpError as problem:
        print(f'cnc-interp: {problem}', file=sys.stderr)
        return BAD_INPUT
    except OSError as problem:
        if isinstance(problem, BrokenPipeError):
            sys.stderr.close()
            return FINE
        print(f'cnc-interp: {problem.filename}: {problem.strerror}', file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print('cnc-interp: interrupted', file=sys.stderr)
        return 130


def parser() -> argparse.ArgumentParser:
    """Declare every command and option."""
    top = argparse.ArgumentParser(
        prog='cnc-interp',
        description='5-axis CNC interpolator: smooth, plan and run part programs, every setpoint '
        'proven.',
    )
    top.add_argument('--version', action='version', version=f'cnc-interp {__version__}')
    commands = top.add_subparsers(required=True, metavar='COMMAND')

    run = command(
        commands, 'run', run_command,
        'stream a program through the ROS 2 nodes to the simulated machine',
        'cnc-interp run examples/pyramid.apt --out out/pyramid',
    )  # fmt: skip
    program_options(run)
    run.add_argument(
        '--then', type=Path, action='append', default=[], metavar='PROGRAM',
        help='a further program, which waits for the end of the one before; may be repeated',
    )  # fmt: skip
    run.add_argument(
        '--out', type=Path, metavar='DIR', help='write what the machine received as plan files'
    )
    run.add_argument(
        '--record', type=Path, metavar='BAG', help='record all messages of the run into a bag'
    )
    run.add_argument(
        '--panel', action='store_true', help='the operator page beside it, until Ctrl-C'
    )
    page_options(run)

    plan = command(
        commands, 'plan', plan_command,
        'plan a program without ROS and write the plan files',
        'cnc-interp plan examples/pyramid.apt --out out/pyramid',
    )  # fmt: skip
    program_options(plan)
    plan.add_argument(
        '--out', type=Path, metavar='DIR', required=True, help='folder for the plan files'
    )
    plan.add_argument(
        '--look', action='store_true',
        help='draw the feed profile in text, as a terminal always gets it',
    )  # fmt: skip

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
    number(convert, '--fit-tolerance', 1e-5, 'how closely cubic curves follow the smooth path')

    check = command(
        commands, 'check', check_command,
        'prove every setpoint of a plan or a recorded run against limits and tolerances',
        'cnc-interp check out/pyramid',
    )  # fmt: skip
    check.add_argument(
        'directory', type=Path, metavar='DIR', help='folder with plan files, or a bag'
    )
    check.add_argument('--machine', metavar='M', help='another machine than the plan names')
    check.add_argument('--json', action='store_true', help='print the proof as JSON')

    report = command(
        commands, 'report', report_command,
        'write one self-contained HTML page about a plan or a recorded run',
        'cnc-interp report out/pyramid --html out/pyramid.html',
    )  # fmt: skip
    report.add_argument(
        'directory', type=Path, metavar='DIR', help='folder with plan files, or a bag'
    )
    report.add_argument('--machine', metavar='M', help='another machine than the plan names')
    report.add_argument(
        '--html', type=Path, metavar='FILE', help='page to write (default: DIR/report.html)'
    )
    report.add_argument(
        '--compare', type=Path, metavar='DIR2', help='another plan to set beside the first'
    )

    panel = command(
        commands, 'panel', panel_command,
        'serve the operator page: see the machine and operate it from a browser',
        'cnc-interp panel examples/pyramid.ngc',
    )  # fmt: skip
    panel.add_argument(
        'program', type=Path, nargs='?', metavar='PROGRAM', help='program to lay on the desk'
    )
    panel.add_argument(
        '--machine', default='xyzac', metavar='M', help='machine to simulate (xyzac)'
    )
    panel.add_argument(
        '--attach', action='store_true', help='join nodes that run already; start none'
    )
    panel.add_argument(
        '--namespace', default='/', metavar='NS', help='ROS namespace of the nodes (/)'
    )
    panel.add_argument('--domain', type=int, metavar='N', help='ROS domain (ROS_DOMAIN_ID)')
    page_options(panel)

    urdf = command(
        commands, 'urdf', urdf_command,
        'write a machine as URDF, for robot_state_publisher, RViz and Foxglove',
        'cnc-interp urdf xyzac --out xyzac.urdf',
    )  # fmt: skip
    urdf.add_argument('machine', metavar='M', help='bundled machine or YAML file')
    urdf.add_argument('--out', type=Path, metavar='FILE', help='file to write (default: print it)')
    add_bag_commands(commands)
    add_cam_commands(commands)
    return top


def plan_command(options: argparse.Namespace) -> int:
    """Plan a program and write the plan files."""
    from cnc_interp.core.progress_bar import ProgressBar
    from cnc_interp.kinematics.machine import Machine
    from cnc_interp.kinematics.transform import Transform
    from cnc_interp.program import open_program
    from cnc_interp.run.chain import describe, plan_to_files

    machine = Machine.load(options.machine)
    settings = settings_from(options)
    geometry = Transform.of(machine)
    stream = open_program(options.program, geometry, settings)
    progress = ProgressBar(None if options.json else sys.stderr)
    try:
        summary = plan_to_files(stream, machine, options.out, settings, progress.of('planning'))
    finally:
        progress.end(complete=False)
        tell(stream.notices)
    print(json.dumps(summary, indent=2) if options.json else describe(summary))
    if not options.json:
        if options.look or sys.stdout.isatty():
            print(sketch(options.out))
        print(f'plan files     {options.out}')
    return FINE


def sketch(directory: Path) -> str:
    """Draw the feed profile of a plan with what the output can show."""
    from cnc_interp.report.sketch import EIGHTHS, feed_sketch

    try:
        EIGHTHS.encode(sys.stdout.encoding or 'ascii')
        unicode = os.environ.get('TERM') != 'dumb'
    except UnicodeEncodeError:
        unicode = False
    return feed_sketch(directory, min(shutil.get_terminal_size().columns, WIDEST), unicode)


def convert_command(options: argparse.Namespace) -> int:
    """Write a program in another dialect."""
    from cnc_interp.convert import convert
    from cnc_interp.kinematics.machine import Machine
    from cnc_interp.kinematics.transform import Transform
    from cnc_interp.program import read_program

    machine = Machine.load(options.machine)
    settings = settings_from(options)
    program = read_program(options.program, Transform.of(machine), settings)
    tell(program.notices)
    tolerance = options.fit_tolerance * MM
    made = convert(program, machine, settings, options.to, tolerance)
    if options.out is None:
        print(made.text, end='')
    else:
        options.out.write_text(made.text, encoding='utf-8')
        print(f'program        {options.out}')
    tell(made.notes)
    return FINE


def check_command(options: argparse.Namespace) -> int:
    """Prove a plan."""
    from cnc_interp.kinematics.machine import Machine
    from cnc_interp.proof.plan_files import read_plan
    from cnc_interp.proof.verify import verify_plan

    if is_bag(options.directory):
        proof = check_bag(options.directory, options.machine or '')
    else:
        name = options.machine or read_plan(options.directory).summary.get('machine', '')
        proof = verify_plan(options.directory, Machine.load(name))
    print(json.dumps(proof.to_json(), indent=2) if options.json else proof.text())
    return FINE if proof.ok else FAILED


def report_command(options: argparse.Namespace) -> int:
    """Write the HTML page of a plan."""
    from cnc_interp.kinematics.machine import Machine
    from cnc_interp.report import write_report

    page = options.html or options.directory / 'report.html'
    if is_bag(options.directory):
        if options.compare:
            raise InterpError('--compare sets two folders of plan files side by side, not bags')
        report_bag(options.directory, page, options.machine or '')
    else:
        machine = Machine.load(options.machine) if options.machine else None
        write_report(options.directory, page, machine, options.compare)
    print(f'report         {page}')
    return FINE


def panel_command(options: argparse.Namespace) -> int:
    """Serve the operator page."""
    from cnc_interp.client.page.command import PanelRequest, run_panel

    run_panel(PanelRequest.from_options(options))
    return FINE


def urdf_command(options: argparse.Namespace) -> int:
    """Write a machine as URDF."""
    from cnc_interp.description.urdf import urdf_of
    from cnc_interp.kinematics.machine import Machine

    text = urdf_of(Machine.load(options.machine))
    if options.out is None:
        print(text, end='')
    else:
        options.out.write_text(text, encoding='utf-8')
    return FINE


def run_command(options: argparse.Namespace) -> int:
    """Stream one or more programs through the nodes."""
    from cnc_interp.client.session import RunRequest, run_session

    beside = None
    if options.panel:
        from cnc_interp.client.page.command import PanelBeside, PanelRequest

        beside = PanelBeside(PanelRequest.from_options(options))
    results = run_session(RunRequest.from_options(options), beside)
    if options.json:
        found = [result.to_json() for result in results]
        print(json.dumps(found if options.then else found[0], indent=2))
    else:
        print('\n\n'.join(result.text() for result in results))
    return FINE if all(result.ok for result in results) else FAILED


def tell(notices: Sequence[str]) -> None:
    """Print what the reader noticed."""
    for notice in notices:
        print(f'note: {notice}', file=sys.stderr)


if __name__ == '__main__':
    sys.exit(main())
