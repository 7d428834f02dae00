"""The commands `cnc-interp cam iso-scallop` and `cnc-interp cam simulate`."""

import argparse
from pathlib import Path
from typing import Any

from cnc_interp.cam.strategies import STRATEGIES, StrategyOption
from cnc_interp.commands.parser import (
    Adds,
    command,
    flag,
    machine_option,
    number,
    option,
    positive,
)
from cnc_interp.core import HOUR


def add_cam_commands(commands: Any) -> None:
    told = '5-axis iso-scallop programs from surfaces, and the simulated surface'
    cam = commands.add_parser('cam', help=told, description=f'{told}.')
    inner = cam.add_subparsers(required=True, metavar='COMMAND')
    meanings = '; '.join(f'{name}: {one.meaning}' for name, one in STRATEGIES.items())
    first = next(iter(STRATEGIES))
    command(
        inner,
        iso_scallop_command,
        'cam iso-scallop examples/bumps.json --stepover 2 --run --out out/bumps',
        option('surface', 'surface file (JSON), or STEP (.step, .stp)', Path, 'SURFACE'),
        _face('faces of a STEP file, machined in this order', '+'),
        flag(
            '--ignore-neighbours',
            'do not end passes where the mill would enter other faces of a STEP file',
        ),
        option('--out', 'folder to write', Path, 'DIR', required=True),
        *_mill(),
        option('--strategy', f'{meanings} ({first})', choices=tuple(STRATEGIES), default=first),
        number('--scallop', 10.0, 'scallop height', 'UM'),
        number(
            '--reserve',
            0.0,
            'part of the scallop height that is reserved for smoothing and drives',
            'UM',
        ),
        *map(
            _strategy_option,
            dict.fromkeys(one for each in STRATEGIES.values() for one in each.options),
        ),
        option('--linking', 'order (zigzag)', choices=('zigzag', 'one-way'), default='zigzag'),
        option(
            '--format',
            'native B-splines of tip and axis, CL data, or G-code with rotary words (spline)',
            choices=('spline', 'cl', 'gcode'),
            default='spline',
        ),
        number('--chord', 0.2, 'chord tolerance of cl and gcode', 'UM'),
        number('--overrun', 0.5, 'length of the passes beyond the border'),
        number('--clearance', 2.0, 'lift between passes'),
        number('--feed', 3000.0, 'feedrate', 'MM_PER_MIN'),
        flag('--simulate', 'cut the surface with the program (N-buffer)'),
        flag(
            '--run',
            'plan the program, execute it on the simulated machine and also cut with that motion',
        ),
        *_cutting(),
        flag('--json', 'print the summary as JSON'),
    )
    simulate = command(
        inner,
        simulate_command,
        'cam simulate out/bumps/program.mpf --surface examples/bumps.json '
        '--spacing 0.02 --tiles out/tiles',
        option('motion', 'part program, or folder of a plan', Path, 'PROGRAM_OR_DIR'),
        option(
            '--surface',
            'surface file (JSON), or STEP (.step, .stp)',
            Path,
            'FILE',
            required=True,
        ),
        _face('face of a STEP file', 1),
        *_mill(),
        number('--scallop', 10.0, 'scallop height of the colour scale', 'UM'),
        flag('--executed', 'use the simulated motion of the drives instead of the setpoints'),
        option('--out --html', 'page to write', Path, 'FILE'),
        *_cutting(),
        option(
            '--tiles',
            'cut millions of needles in tiles; writes heights (Zarr) and a page that zooms; '
            'a second start continues',
            Path,
            'DIR',
        ),
        option(
            '--workers',
            'tiles that are cut at the same time (one for each processor)',
            int,
            'N',
        ),
        option('--scheduler', 'let the workers of `cluster` cut the tiles', metavar='ADDRESS'),
        flag('--json', 'print the figures as JSON'),
    )
    simulate.set_defaults(pool=tile_workers)


def _strategy_option(each: StrategyOption) -> Adds:
    name = f'--{each.name}'
    if each.default is False:
        return flag(name, each.meaning)
    return option(
        name,
        each.meaning,
        None if each.values else positive if each.positive else each.kind,
        each.metavar,
        default=each.default,
        choices=each.values or None,
        nargs=2 if isinstance(each.metavar, tuple) else None,
    )


def _mill() -> tuple[Adds, ...]:
    return (
        number('--tool-diameter', 13.0, 'diameter of the mill, 2 (R + r_c)'),
        number('--corner-radius', 1.5, 'corner radius r_c'),
    )


def _face(meaning: str, count: int | str) -> Adds:
    text = f'{meaning}; without it, all faces are listed if there are several'
    return option('--face', text, int, 'N', nargs=count)


def _cutting() -> tuple[Adds, ...]:
    return (
        option(
            '--direction',
            'feed direction on the surface, from its u lines (0 deg)',
            float,
            'DEG',
            default=0.0,
        ),
        *(
            option(
                f'--turn-{name.lower()}',
                f'turn of the surface on the table about {name} (0 deg)',
                float,
                'DEG',
                default=0.0,
            )
            for name in 'XYZ'
        ),
        number('--spacing', 0.1, 'distance of the needles'),
        number(
            '--margin', 2.0, 'distance from the border within which the figures ignore needles'
        ),
        machine_option(),
        option(
            '--compensate',
            'machine file whose drive models compensate the executed motion',
            metavar='M',
        ),
    )


def iso_scallop_command(options: argparse.Namespace) -> int:
    """Make a program of constant scallop height along parallel planes."""
    from cnc_interp.cam.make_program import make_program
    from cnc_interp.cam.request import CamRequest

    return make_program(CamRequest.of(vars(options)))


def simulate_command(options: argparse.Namespace) -> int:
    """Cut a surface with a program or a plan, and measure the heights that remain."""
    from cnc_interp.cam.make_program import simulate_motion
    from cnc_interp.cam.request import SimulateRequest

    return simulate_motion(SimulateRequest.of(vars(options)))


LONGEST = 24.0 * HOUR  #: Longest time of a tile [s].


def tile_workers(scheduler: str | None, workers: int) -> Any:
    """Return workers that have the kernel in memory, of a cluster or of this computer."""
    from cnc_interp.batch.batch_run import workers_of
    from cnc_interp.batch.processes import TILES_PRELOADED

    return workers_of(scheduler, workers, None, LONGEST, TILES_PRELOADED)
