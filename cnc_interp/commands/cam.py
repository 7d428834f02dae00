"""The commands `cnc-interp cam iso-scallop` and `cnc-interp cam simulate`."""

import argparse
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import command, flag, machine_option, number, option, positive
from cnc_interp.core.units import HOUR


def add_cam_commands(commands: Any) -> None:
    cam = commands.add_parser(
        'cam',
        help='5-axis iso-scallop programs from surfaces, and the simulated surface',
        description='5-axis iso-scallop programs from surfaces, and the simulated surface.',
    )
    inner = cam.add_subparsers(required=True, metavar='COMMAND')
    make = command(
        inner, 'iso-scallop', _iso_scallop,
        'make a program of constant scallop height along parallel planes',
        'cnc-interp cam iso-scallop examples/bumps.json --stepover 2 --run --out out/bumps',
    )  # fmt: skip
    option(make, 'surface', 'surface file (JSON), or STEP (.step, .stp)', Path, 'SURFACE')
    _face(make, several=True)
    flag(
        make, '--ignore-neighbours',
        'do not end passes where the mill would enter other faces of a STEP file',
    )  # fmt: skip
    option(make, '--out', 'folder to write', Path, 'DIR', required=True)
    _mill(make)
    make.add_argument(
        '--strategy', choices=('planes', 'classical'), default='planes',
        help='along parallel planes with a variable tilt, or, to compare, the classical '
        'iso-scallop path: constant tilt, a ball mill keeps its axis (planes)',
    )  # fmt: skip
    number(make, '--scallop', 10.0, 'scallop height', 'UM')
    number(
        make, '--reserve', 0.0,
        'part of the scallop height for smoothing and drives: passes leave the rest', 'UM',
    )  # fmt: skip
    option(
        make, '--stepover',
        'distance of the guiding planes; without it the largest that --tilt allows, pass '
        'by pass', positive, 'MM',
    )  # fmt: skip
    number(make, '--tilt', 3.0, 'tilt of a constant start, and the smallest for the largest '
           'stepover', 'DEG')  # fmt: skip
    make.add_argument(
        '--tilt-limits', type=positive, nargs=2, default=(0.5, 60.0), metavar=('LOW', 'HIGH'),
        help='smallest and largest tilt (0.5 60 deg)',
    )  # fmt: skip
    option(
        make, '--freedom',
        'the angle that sets the width of a strip (tilt)', choices=('tilt', 'yaw'), default='tilt',
    )  # fmt: skip
    option(make, '--yaw', 'yaw (0 deg)', float, 'DEG', default=0.0)
    make.add_argument(
        '--start', choices=('width', 'tilt'), default='width',
        help='first pass with constant width, or with constant tilt as in the paper (width)',
    )  # fmt: skip
    flag(
        make, '--no-restart',
        'never start afresh: the recursion of the paper, and an error where it ends',
    )  # fmt: skip
    option(make, '--points', 'scallop points along a pass (one per 0.8 mm)', int, 'N')
    option(make, '--linking', 'order (zigzag)', choices=('zigzag', 'one-way'), default='zigzag')
    make.add_argument(
        '--format', choices=('spline', 'cl', 'gcode'), default='spline',
        help='native B-splines of tip and axis, CL data, or G-code with rotary words (spline)',
    )  # fmt: skip
    number(make, '--chord', 0.2, 'chord tolerance of cl and gcode', 'UM')
    number(make, '--overrun', 0.5, 'length of the passes beyond the border')
    number(make, '--clearance', 2.0, 'lift between passes')
    number(make, '--feed', 3000.0, 'feedrate', 'MM_PER_MIN')
    flag(make, '--simulate', 'cut the surface with the program (N-buffer)')
    flag(
        make, '--run',
        'plan the program, execute it on the simulated machine and cut with that too',
    )  # fmt: skip
    _cutting(make)
    flag(make, '--json', 'print the summary as JSON')

    simulate = command(
        inner, 'simulate', _simulate,
        'cut a surface with a program or a plan and measure what is left',
        'cnc-interp cam simulate out/bumps/program.mpf --surface examples/bumps.json '
        '--spacing 0.02 --tiles out/tiles',
    )  # fmt: skip
    option(simulate, 'motion', 'part program, or folder of a plan', Path, 'PROGRAM_OR_DIR')
    option(
        simulate, '--surface',
        'surface file (JSON), or STEP (.step, .stp)', Path, 'FILE', required=True,
    )  # fmt: skip
    _face(simulate)
    _mill(simulate)
    number(simulate, '--scallop', 10.0, 'scallop height of the colour scale', 'UM')
    flag(simulate, '--executed', 'take the motion of the drives, not the setpoints')
    simulate.add_argument('--out', '--html', type=Path, metavar='FILE', help='page to write')
    _cutting(simulate)
    option(
        simulate, '--tiles',
        'cut the needles in tiles, for millions of them; writes heights (Zarr) and a page '
        'that zooms; a second start goes on', Path, 'DIR',
    )  # fmt: skip
    text = 'tiles that are cut at the same time (one for each processor)'
    option(simulate, '--workers', text, int, 'N')
    text = 'let the workers of `cluster` cut the tiles'
    option(simulate, '--scheduler', text, metavar='ADDRESS')
    simulate.add_argument(
        '--device', choices=('cpu', 'warp-cpu', 'cuda'), default='cpu',
        help='what cuts: numba on the processor, or Warp there or on a graphics card (cpu)',
    )  # fmt: skip
    simulate.set_defaults(pool=tile_workers)
    flag(simulate, '--json', 'print the figures as JSON')


def _mill(added: argparse.ArgumentParser) -> None:
    number(added, '--tool-diameter', 13.0, 'diameter of the mill, 2 (R + r_c)')
    number(added, '--corner-radius', 1.5, 'corner radius r_c')


def _face(added: argparse.ArgumentParser, several: bool = False) -> None:
    text = 'faces of a STEP file, machined in this order' if several else 'face of a STEP file'
    added.add_argument(
        '--face', type=int, metavar='N', nargs='+' if several else 1,
        help=f'{text}; without it, all faces are listed if there are several',
    )  # fmt: skip


def _cutting(added: argparse.ArgumentParser) -> None:
    option(
        added, '--direction',
        'feed direction on the surface, from its u lines (0 deg)', float, 'DEG', default=0.0,
    )  # fmt: skip
    for name in 'XYZ':
        added.add_argument(
            f'--turn-{name.lower()}', type=float, default=0.0, metavar='DEG',
            help=f'turn of the surface about {name} as it stands on the table (0 deg)',
        )  # fmt: skip
    number(added, '--spacing', 0.1, 'distance of the needles')
    number(added, '--margin', 2.0, 'distance from the border for the figures')
    machine_option(added)
    added.add_argument(
        '--compensate', metavar='M',
        help='machine whose drives are the model that is compensated in the executed motion',
    )  # fmt: skip


def _iso_scallop(options: argparse.Namespace) -> int:
    from cnc_interp.cam.make_program import make_program

    return make_program(options)


def _simulate(options: argparse.Namespace) -> int:
    from cnc_interp.cam.make_program import simulate_motion

    return simulate_motion(options)


LONGEST = 24.0 * HOUR  #: Longest time of a tile [s].


def tile_workers(scheduler: str | None, workers: int) -> Any:
    """Return workers that have the kernel in memory, of a cluster or of this computer."""
    from cnc_interp.batch.batch_run import workers_of
    from cnc_interp.batch.processes import TILES_PRELOADED

    return workers_of(scheduler, workers, None, LONGEST, TILES_PRELOADED)
