"""`cnc-interp run` and `panel`: programs through the ROS 2 nodes, and the page to operate them."""

import argparse
import json
from pathlib import Path
from typing import Any

from cnc_interp.commands import parser


def add_run_command(commands: Any) -> None:
    run = parser.command(
        commands, 'run', run_command,
        'stream a program through the ROS 2 nodes to the machine',
        'cnc-interp run examples/pyramid.apt --out out/pyramid',
    )  # fmt: skip
    run.program_options(live=True)
    run.drives_option()
    run.add_argument(
        '--then', type=Path, action='append', default=[], metavar='PROGRAM',
        help='a further program, which waits for the end of the one before; may be repeated',
    )  # fmt: skip
    run.option('--out', 'write what the machine executed as plan files', Path, 'DIR')
    run.option('--record', 'record all messages of the run into a bag', Path, 'BAG')
    run.flag(
        '--pass-stops',
        'go on without cycle start: at M0, M1 and single blocks, and before the plunge of '
        '--from-line',
    )  # fmt: skip
    run.flag('--panel', 'the operator page beside it, until Ctrl-C')
    run.page_options()


def add_panel_command(commands: Any) -> None:
    panel = parser.command(
        commands, 'panel', panel_command,
        'serve the operator page: see the machine and operate it from a browser',
        'cnc-interp panel examples/pyramid.ngc',
    )  # fmt: skip
    panel.option('program', 'program to lay on the desk', Path, 'PROGRAM', nargs='?')
    panel.machine_option()
    panel.drives_option()
    panel.option('--setup', 'YAML file in which offsets and tools are kept', Path, 'FILE')
    panel.flag('--attach', 'join nodes that run already; start none')
    panel.nodes_options()
    panel.page_options()


def run_command(options: argparse.Namespace) -> int:
    from cnc_interp.processes.node_processes import load_nodes, process_start

    load_nodes()  # in another process, while this one imports the rest
    from cnc_interp.client.session import RunRequest, run_session

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
    from cnc_interp.page.command import run_panel

    run_panel(options)
    return parser.FINE
