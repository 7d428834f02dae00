"""`cnc-interp plan`, `run` and `panel`: plan without ROS, run with ROS, operate from a page."""

from __future__ import annotations

import argparse
import json
import math
import os
import shutil
import signal
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cnc_interp.commands import parser
from cnc_interp.commands.parser import flag, option
from cnc_interp.core import HOUR, MM, InterpError
from cnc_interp.settings.command_line import settings_from

if TYPE_CHECKING:
    from cnc_interp.machine_model.machine import Machine

WIDEST = 100  #: Largest width of a drawing in text [characters].


def add_plan_command(commands: Any) -> None:
    parser.command(
        commands,
        plan_command,
        'plan examples/pyramid.apt --out out/pyramid',
        *parser.program_options(),
        option('--out', 'folder for the plan files', Path, 'DIR', required=True),
        flag('--look', 'draw the feed profile as text, even if the output is not a terminal'),
        flag('--save-stock', 'write the remaining stock as stock.stl among the plan files'),
        option(
            '--stock-stages',
            'write stock_stages.npz: the remaining stock at N places along the path',
            int,
            'N',
            default=0,
        ),
        *(
            option(
                f'--place-{axis.lower()}',
                f'shift of the clamped workpiece along {axis} from its usual place',
                float,
                'MM',
                default=0.0,
            )
            for axis in 'XYZ'
        ),
        option(
            '--limits',
            'guess limits that the files of an arm lack; every report names the guessed ones',
            choices=('known', 'guess'),
            default='known',
        ),
        option(
            '--turn',
            'turn of the clamped workpiece about Z; C counts from the turned workpiece',
            float,
            'DEG',
            default=0.0,
        ),
        parser.workers_option(
            'processes that share the planning of a long program, divided at its exact stops'
        ),
    )


def plan_command(options: argparse.Namespace) -> int:
    """Plan a program without ROS and write the plan files."""
    from cnc_interp import kernel_cache
    from cnc_interp.core.progress_bar import ProgressBar
    from cnc_interp.feedrate.planner_tuning import tool_warnings
    from cnc_interp.machine_model.transform_port import Transform
    from cnc_interp.program import open_program
    from cnc_interp.program.notices import tell
    from cnc_interp.run.plan_figures import excesses
    from cnc_interp.run.planning_chain import plan_to_files

    machine = machine_of(options)
    settings = settings_from(options)
    geometry = Transform.of(machine)
    tell([*machine.doubts(), *tool_warnings(machine, settings)])
    # At the very first plan, kernels of two stages are compiled at the same time.
    if not any(place.exists() for place in (kernel_cache.folder(), kernel_cache.BROUGHT)):
        get_context('fork').Process(target=_compile, args=(machine,), daemon=True).start()
    stream = open_program(options.program, geometry, settings)
    progress = ProgressBar(None if options.json else sys.stderr)
    read_as: tuple[str, ...] = ()
    try:
        told, workers = progress.of('planning'), options.workers
        drawn = options.save_stock, options.stock_stages
        summary = plan_to_files(stream, machine, options.out, settings, told, workers, *drawn)
        read_as = stream.read_as  # a refusal is one line
    finally:
        progress.end(complete=False)
        tell((*read_as, *stream.notices))
    if summary['cycle_time'] > HOUR:
        tell([f'the motion lasts {summary["cycle_time"] / HOUR:.4g} h; is the feed right?'])
    over = excesses(summary['largest_use'], summary['tolerance_used'], summary['tool_error'])
    if hits := summary.get('collision', {}).get('hits'):
        over.append(f'{len(hits)} hit{"s" * (len(hits) > 1)}')
    print(json.dumps(summary, indent=2) if options.json else describe(summary))
    if not options.json:
        if options.look or sys.stdout.isatty():
            print(sketch(options.out))
        print(f'plan files     {options.out}')
        print(
            f'NOT proven     {"; ".join(over)}'
            if over
            else 'proven         every setpoint keeps the limits, every curve the tolerances; '
            f'all of it: cnc-interp check {options.out}'
        )
    return parser.FAILED if over else parser.FINE


def _compile(machine: Machine) -> None:
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_DFL)
    from cnc_interp.feedrate.planning_windows import plan_path
    from cnc_interp.nodes.kernel_warmup import path_without_kernels

    plan_path(path_without_kernels(machine), machine)


def machine_of(options: argparse.Namespace) -> Machine:
    """Return the machine; if the workpiece is shifted, write its file to the plan files."""
    from cnc_interp.machine_model.machine import (
        Machine,
        placed_machine,
        with_guessed_limits,
        without_topic,
    )

    shift = options.place_x, options.place_y, options.place_z
    if not all(math.isfinite(value) for value in (*shift, options.turn)):
        raise InterpError('--place-x, --place-y, --place-z, --turn: must be finite numbers')
    if options.limits == 'guess':
        return with_guessed_limits(options.machine, options.out / 'machine.yaml')
    if not any((*shift, options.turn)):
        return Machine.load(without_topic(options.machine, options.out / 'machine.yaml'))
    return placed_machine(options.machine, shift, options.turn, options.out / 'machine.yaml')


def describe(summary: dict[str, Any]) -> str:
    from cnc_interp.run.plan_figures import (
        bound_text,
        clearance_text,
        stock_text,
        tool_error_text,
        windows_text,
    )
    from cnc_interp.run.program_times import CHANGE, times_table

    notes = summary['start']['notes'] if summary['start'] else []
    switched = [(word, count) for word, count in summary['functions'].items() if count]
    lines = [
        f'program        {summary["program"]} on {summary["machine"]}',
        f'blocks         {summary["blocks"]} in {summary["segments"]} segments, '
        f'{summary["path_length"] / MM:.1f} mm',
        *(['functions      ' + '  '.join(f'{n} x {f}' for f, n in switched)] if switched else []),
        *(f'start          {text}' for text in notes),
        f'cycle time     {summary["cycle_time"]:.3f} s',
        *(
            [
                f'standstill     {rest:.3f} s for tool changes and the spindle, '
                f'{rest + summary["cycle_time"]:.3f} s with the motion'
            ]
            if (rest := summary['standstill'])
            else []
        ),
        *(times_table(summary['tools']) if summary['functions'].get(CHANGE) else []),
        f'planning time  {summary["planning_time"]:.3f} s '
        f'(the motion takes {summary["cycle_time"] / max(summary["planning_time"], 1e-9):.3g} '
        'times as long)',
    ]
    for name, use in summary['largest_use'].items():
        values = '  '.join(f'{axis} {ratio:6.1%}' for axis, ratio in use.items())
        lines.append(f'{name:<15}{values}')
    contour, orientation, height = (
        summary[key] / MM
        for key in ('contour_deviation_bound', 'orientation_deviation_bound', 'flank_height')
    )
    used, curves = summary['tolerance_used'], summary['curves']
    lines.append(
        f'deviation      at most contour {contour:.4f} mm, orientation {orientation:.4f} mm at '
        f'{height:g} mm; {used["contour"]:.0%} and {used["orientation"]:.0%} of the tolerances'
    )
    if error := summary['tool_error']:
        lines.append(tool_error_text(error, summary['flank_height']))
    if found := summary.get('collision'):
        lines.append(f'collision      {clearance_text(found)}')
        lines += [hit['text'] for hit in found['hits']]
        lines += [f'stock          {stock_text(found["stock"])}'] if 'stock' in found else []
    if curves['blocks']:
        lines.append(
            f'curves         {curves["blocks"]} blocks as {curves["spans"]} spans, '
            f'{curves["spans"] / curves["blocks"]:.2f} a block'
        )
    if text := bound_text(summary):
        lines.append(f'bound          {text}')
    if text := windows_text(summary['windows']):
        lines.append(f'windows        {text}')
    return '\n'.join(lines)


def sketch(directory: Path) -> str:
    from cnc_interp.report.sketch import EIGHTHS, feed_sketch

    try:
        EIGHTHS.encode(sys.stdout.encoding or 'ascii')
        unicode = os.environ.get('TERM') != 'dumb'
    except UnicodeEncodeError:
        unicode = False
    return feed_sketch(directory, min(shutil.get_terminal_size().columns, WIDEST), unicode)


def add_run_command(commands: Any) -> None:
    parser.command(
        commands,
        run_command,
        'run examples/pyramid.apt --out out/pyramid',
        *parser.program_options(live=True),
        parser.drives_option(),
        option(
            '--then',
            'a further program, which waits for the end of the previous one; may be repeated',
            Path,
            'PROGRAM',
            action='append',
            default=[],
        ),
        option('--out', 'write what the machine executed as plan files', Path, 'DIR'),
        option('--record', 'record all messages of the run into a bag', Path, 'BAG'),
        flag(
            '--pass-stops',
            'continue without cycle start: at M0, M1 and single blocks, before the plunge of '
            '--from-line, and with simulated drives at M6 without a tool changer',
        ),
        flag('--panel', 'show the operator page as well, until Ctrl-C'),
        *parser.page_options(),
    )


def add_panel_command(commands: Any) -> None:
    parser.command(
        commands,
        panel_command,
        'panel examples/pyramid.ngc',
        option(
            'program', 'program that the page loads', parser.program_file, 'PROGRAM', nargs='?'
        ),
        parser.machine_option(),
        parser.drives_option(),
        option('--setup', 'YAML file in which offsets and tools are kept', Path, 'FILE'),
        option('--scene', 'YAML file of bodies that must keep apart', Path, 'FILE'),
        option(
            '--programs',
            'folder whose programs the page lists, opens and saves (that of PROGRAM, or this one)',
            Path,
            'FOLDER',
        ),
        flag('--attach', 'use nodes that run already; do not start any'),
        *parser.nodes_options(),
        *parser.page_options(),
    )


def add_mtconnect_command(commands: Any) -> None:
    parser.command(
        commands,
        mtconnect_command,
        'mtconnect --port 5000 (beside run or panel; shows http://127.0.0.1:5000/probe)',
        option('--host', 'address of the agent (127.0.0.1)', default='127.0.0.1'),
        option('--port', 'its port, 0 for any free one (5000)', int, default=5000),
        *parser.nodes_options(),
    )


def mtconnect_command(options: argparse.Namespace) -> int:
    """Serve the state of the machine to MTConnect clients, without commanding it."""
    import importlib.util

    if importlib.util.find_spec('lxml') is None:
        raise InterpError(
            'the MTConnect agent needs lxml: start it with ./cnc, which installs it, or '
            'pip install -r requirements/mtconnect.txt'
        )
    from cnc_interp.mtconnect.command import run_agent

    run_agent(options)
    return parser.FINE


def run_command(options: argparse.Namespace) -> int:
    """Stream a program through the ROS 2 nodes to the machine."""
    from cnc_interp.processes.fork_server import load_nodes

    load_nodes()  # in another process, while this one imports the rest
    from cnc_interp.client.run_request import RunRequest
    from cnc_interp.client.session import run_session
    from cnc_interp.machine_model.machine import without_topic
    from cnc_interp.processes.node_processes import process_start
    from cnc_interp.processes.temporary_folder import TemporaryFolder

    with TemporaryFolder() as folder:
        options.machine = without_topic(
            options.machine, (options.out or Path(folder)) / 'machine.yaml'
        )
        beside = None
        if options.panel:
            from cnc_interp.page.command import PanelBeside

            beside = PanelBeside(options)
        results = run_session(RunRequest.from_options(options), beside, process_start())
    if options.json:
        found = [result.to_json() for result in results]
        print(json.dumps(found if options.then else found[0], indent=2))
    else:
        print('\n\n'.join(result.text() for result in results))
    sound = all(result.ok and not result.excesses for result in results)
    return parser.FINE if sound else parser.FAILED


def panel_command(options: argparse.Namespace) -> int:
    """Serve the operator page: see the machine and operate it from a browser."""
    from cnc_interp.page.command import run_panel

    run_panel(options)
    return parser.FINE
