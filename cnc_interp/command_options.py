"""
What a command may be given: the words and units of the shop, made options of the library.

Commands are declared where they are done, all in the ways that are here.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from cnc_interp.core.units import DEG, MM, MM_PER_MIN, MS


def command(
    commands: Any, name: str, function: Any, purpose: str, example: str
) -> argparse.ArgumentParser:
    """Add one command with an example in its help."""
    added: argparse.ArgumentParser = commands.add_parser(
        name,
        help=purpose,
        description=purpose[0].upper() + purpose[1:] + '.',
        epilog=f'example: {example}',
    )
    added.set_defaults(command=function)
    return added


def program_options(added: argparse.ArgumentParser) -> None:
    """Add the options that `run` and `plan` share."""
    added.add_argument('program', type=Path, metavar='PROGRAM', help='G-code or CL data file')
    added.add_argument(
        '--machine', default='xyzac', metavar='M', help='bundled machine or YAML file (xyzac)'
    )
    number(added, '--contour-tolerance', 0.02, 'largest deviation of the tool tip')
    number(added, '--orientation-tolerance', 0.02, 'largest deviation at flank height')
    number(added, '--flank-height', 30.0, 'height at which orientation is measured')
    added.add_argument(
        '--force-tolerances', action='store_true', help='ignore the tolerances of the program'
    )
    added.add_argument(
        '--feed', type=positive, metavar='MM_PER_MIN', help='feedrate where the program has no F'
    )
    added.add_argument(
        '--setup', type=Path, metavar='FILE',
        help='YAML file with work offsets, tool lengths and reference points',
    )  # fmt: skip
    added.add_argument(
        '--rotary-sense', choices=('programmed', 'shortest'), default='programmed',
        help='rotary words as programmed, or the shortest way there (programmed)',
    )  # fmt: skip
    added.add_argument(
        '--skip-blocks', action='store_true', help='leave out lines that begin with a slash'
    )
    added.add_argument(
        '--ratio', type=ratio, metavar='L2/L1',
        help='shape of the corners, 1.2 to 4, or auto: chosen for each (auto)',
    )  # fmt: skip
    added.add_argument(
        '--parametrization', choices=('exact', 'linear', 'paper'), default='exact',
        help='how the orientation of a corner joins its lines (exact)',
    )  # fmt: skip
    added.add_argument(
        '--top', choices=('in_step', 'tolerance'), default='in_step',
        help='how the top curve of a corner is placed (in_step)',
    )  # fmt: skip
    added.add_argument(
        '--septic', action='store_true', help='continue the third derivative of the tool axis too'
    )
    added.add_argument(
        '--compress', action=argparse.BooleanOptionalAction, default=True,
        help='make curves of dense blocks, or round every corner (--compress)',
    )  # fmt: skip
    number(added, '--longest-block', 5.0, 'longer blocks stay straight lines')
    number(added, '--corner-angle', 35.0, 'a sharper turn of dense blocks is a corner', 'DEG')
    added.add_argument(
        '--tolerance-share', type=share, default=0.98, metavar='SHARE',
        help='part of the tolerances that curves through dense blocks may use (0.98)',
    )  # fmt: skip
    number(added, '--period', 1.0, 'interpolation period', 'MS')
    added.add_argument('--json', action='store_true', help='print the summary as JSON')


def page_options(added: argparse.ArgumentParser) -> None:
    """Add the options of the operator page."""
    added.add_argument(
        '--host', default='127.0.0.1', help='address of the operator page (127.0.0.1)'
    )
    added.add_argument(
        '--port', type=int, default=8650, help='its port, 0 for any free one (8650)'
    )
    added.add_argument(
        '--token', default='', help='what commands from the page need (default: a random one)'
    )


def number(
    added: argparse.ArgumentParser, name: str, default: float, meaning: str, unit: str = 'MM'
) -> None:
    """Add a positive number."""
    text = f'{meaning} ({default:g} {unit.lower().replace("_per_", "/")})'
    added.add_argument(name, type=positive, default=default, metavar=unit, help=text)


def positive(text: str) -> float:
    """Read a positive number."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not (math.isfinite(value) and value > 0.0):
        raise argparse.ArgumentTypeError(f'must be a positive number, not {text!r}')
    return value


def ratio(text: str) -> float | None:
    """Read the shape of the corners: a number, or `auto` as None."""
    try:
        return None if text == 'auto' else positive(text)
    except argparse.ArgumentTypeError as problem:
        raise argparse.ArgumentTypeError(f"{problem}, or 'auto'") from None


def share(text: str) -> float:
    """Read a share, more than 0 and at most 1."""
    value = positive(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f'must be at most 1, not {text!r}')
    return value


def chain_options(options: argparse.Namespace) -> Any:
    """Turn the shop's units into the options of the chain."""
    from cnc_interp.run.chain import ChainOptions

    return ChainOptions(
        flank_height=options.flank_height * MM,
        ratio=options.ratio,
        parametrization=options.parametrization,
        top=options.top,
        septic=options.septic,
        period=options.period * MS,
        compression=compression_of(options),
    )


def compression_of(options: argparse.Namespace) -> Any:
    """Turn the shop's units into how dense blocks become curves."""
    from cnc_interp.smoothing.dense.compression import Compression

    return Compression(
        enabled=options.compress,
        longest_block=options.longest_block * MM,
        corner_angle=options.corner_angle * DEG,
        tolerance_share=options.tolerance_share,
    )


def read_options(options: argparse.Namespace) -> Any:
    """Turn the shop's units into the reader's options."""
    from cnc_interp.program import JobSetup, ReadOptions

    return ReadOptions(
        contour_tolerance=options.contour_tolerance * MM,
        orientation_tolerance=options.orientation_tolerance * MM,
        force_tolerances=options.force_tolerances,
        flank_height=options.flank_height * MM,
        feedrate=None if options.feed is None else options.feed * MM_PER_MIN,
        rotary_sense=options.rotary_sense,
        skip_blocks=options.skip_blocks,
        setup=JobSetup.load(options.setup) if options.setup else JobSetup(),
    )
