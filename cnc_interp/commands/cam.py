"""The commands `cnc-interp cam iso-scallop` and `cnc-interp cam simulate`."""

import argparse
from pathlib import Path
from typing import Any

from cnc_interp.cam.strategies import STRATEGIES, StrategyOption
from cnc_interp.commands.parser import (
    CommandParser,
    command,
    positive,
)
from cnc_interp.core import HOUR


def add_cam_commands(commands: Any) -> None:
    told = '5-axis iso-scallop programs from surfaces, and the simulated surface'
    cam = commands.add_parser('cam', help=told, description=f'{told}.')
    inner = cam.add_subparsers(required=True, metavar='COMMAND')
    example = 'cam iso-scallop examples/bumps.json --stepover 2 --run --out out/bumps'
    make = command(inner, iso_scallop_command, example)
    make.option('surface', 'surface file (JSON), or STEP (.step, .stp)', Path, 'SURFACE')
    _face(make, several=True)
    text = 'do not end passes where the mill would enter other faces of a STEP file'
    make.flag('--ignore-neighbours', text)
    make.option('--out', 'folder to write', Path, 'DIR', required=True)
    _mill(make)
    meanings = '; '.join(f'{name}: {one.meaning}' for name, one in STRATEGIES.items())
    first = next(iter(STRATEGIES))
    make.add_argument(
        '--strategy', choices=tuple(STRATEGIES), default=first, help=f'{meanings} ({first})'
    )
    make.number('--scallop', 10.0, 'scallop height', 'UM')
    text = 'part of the scallop height for smoothing and drives: passes leave the rest'
    make.number('--reserve', 0.0, text, 'UM')
    for option in dict.fromkeys(one for each in STRATEGIES.values() for one in each.options):
        _strategy_option(make, option)
    make.option('--linking', 'order (zigzag)', choices=('zigzag', 'one-way'), default='zigzag')
    text = 'native B-splines of tip and axis, CL data, or G-code with rotary words (spline)'
    make.add_argument('--format', choices=('spline', 'cl', 'gcode'), default='spline', help=text)
    make.number('--chord', 0.2, 'chord tolerance of cl and gcode', 'UM')
    make.number('--overrun', 0.5, 'length of the passes beyond the border')
    make.number('--clearance', 2.0, 'lift between passes')
    make.number('--feed', 3000.0, 'feedrate', 'MM_PER_MIN')
    make.flag('--simulate', 'cut the surface with the program (N-buffer)')
    text = 'plan the program, execute it on the simulated machine and cut with that too'
    make.flag('--run', text)
    _cutting(make)
    make.flag('--json', 'print the summary as JSON')

    simulate = command(
        inner,
        simulate_command,
        'cam simulate out/bumps/program.mpf --surface examples/bumps.json '
        '--spacing 0.02 --tiles out/tiles',
    )
    simulate.option('motion', 'part program, or folder of a plan', Path, 'PROGRAM_OR_DIR')
    text = 'surface file (JSON), or STEP (.step, .stp)'
    simulate.option('--surface', text, Path, 'FILE', required=True)
    _face(simulate)
    _mill(simulate)
    simulate.number('--scallop', 10.0, 'scallop height of the colour scale', 'UM')
    simulate.flag('--executed', 'take the motion of the drives, not the setpoints')
    simulate.add_argument('--out', '--html', type=Path, metavar='FILE', help='page to write')
    _cutting(simulate)
    simulate.option(
        '--tiles',
        'cut the needles in tiles, for millions of them; writes heights (Zarr) and a page '
        'that zooms; a second start goes on',
        Path,
        'DIR',
    )
    text = 'tiles that are cut at the same time (one for each processor)'
    simulate.option('--workers', text, int, 'N')
    text = 'let the workers of `cluster` cut the tiles'
    simulate.option('--scheduler', text, metavar='ADDRESS')
    simulate.add_argument(
        '--device',
        choices=('cpu', 'warp-cpu', 'cuda'),
        default='cpu',
        help='what cuts: numba on the processor, or Warp there or on a graphics card (cpu)',
    )
    simulate.set_defaults(pool=tile_workers)
    simulate.flag('--json', 'print the figures as JSON')


def _strategy_option(added: CommandParser, option: StrategyOption) -> None:
    name = f'--{option.name}'
    if option.default is False:
        added.flag(name, option.meaning)
        return
    pair = isinstance(option.metavar, tuple)
    kind: Any = None if option.values else positive if option.positive else option.kind
    added.add_argument(
        name,
        help=option.meaning,
        default=option.default,
        type=kind,
        choices=option.values or None,
        metavar=option.metavar,
        nargs=2 if pair else None,
    )


def _mill(added: CommandParser) -> None:
    added.number('--tool-diameter', 13.0, 'diameter of the mill, 2 (R + r_c)')
    added.number('--corner-radius', 1.5, 'corner radius r_c')


def _face(added: CommandParser, several: bool = False) -> None:
    text = 'faces of a STEP file, machined in this order' if several else 'face of a STEP file'
    text = f'{text}; without it, all faces are listed if there are several'
    added.add_argument('--face', type=int, metavar='N', nargs='+' if several else 1, help=text)


def _cutting(added: CommandParser) -> None:
    text = 'feed direction on the surface, from its u lines (0 deg)'
    added.option('--direction', text, float, 'DEG', default=0.0)
    for name in 'XYZ':
        added.add_argument(
            f'--turn-{name.lower()}',
            type=float,
            default=0.0,
            metavar='DEG',
            help=f'turn of the surface about {name} as it stands on the table (0 deg)',
        )
    added.number('--spacing', 0.1, 'distance of the needles')
    added.number('--margin', 2.0, 'distance from the border for the figures')
    added.machine_option()
    text = 'machine whose drives are the model that is compensated in the executed motion'
    added.add_argument('--compensate', metavar='M', help=text)


def iso_scallop_command(options: argparse.Namespace) -> int:
    """Make a program of constant scallop height along parallel planes."""
    from cnc_interp.cam.make_program import make_program
    from cnc_interp.cam.request import CamRequest

    return make_program(CamRequest.of(vars(options)))


def simulate_command(options: argparse.Namespace) -> int:
    """Cut a surface with a program or a plan and measure what is left."""
    from cnc_interp.cam.make_program import simulate_motion
    from cnc_interp.cam.request import SimulateRequest

    return simulate_motion(SimulateRequest.of(vars(options)))


LONGEST = 24.0 * HOUR  #: Longest time of a tile [s].


def tile_workers(scheduler: str | None, workers: int) -> Any:
    """Return workers that have the kernel in memory, of a cluster or of this computer."""
    from cnc_interp.batch.batch_run import workers_of
    from cnc_interp.batch.processes import TILES_PRELOADED

    return workers_of(scheduler, workers, None, LONGEST, TILES_PRELOADED)
