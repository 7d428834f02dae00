"""
Dense programs as curves and corner by corner, as the table of docs/compressor.md.

    PYTHONPATH=. python benchmarks/dense.py [NAME ...]

Made ones: a dome spiral of 2,000 blocks of 0.5 mm, with and without round-off noise, 600 blocks
of 0.2 mm, the tool along the normal, F 3000, both tolerances 0.01 mm. Public ones, where a folder
``shared`` stands beside the repository: their first 2,000 blocks, at their own feed and 0.02 mm.
The whole chain in one process; deviations are the certified ones, over the tolerance.
"""

from __future__ import annotations

import resource
import sys
from dataclasses import replace

import numpy as np
from paths import SHARED, blocks_of

from cnc_interp.errors import InterpError
from cnc_interp.kinematics.machine import Machine
from cnc_interp.kinematics.transform import Transform
from cnc_interp.pipeline import BATCH, Chain, ChainOptions
from cnc_interp.program import Blocks, ReadOptions, read_program
from cnc_interp.smoothing.compression import Compression
from cnc_interp.smoothing.segments import PathSegments
from cnc_interp.units import MM, MM_PER_MIN, UM

PROGRAMS = {
    'impeller': 'linuxcnc-impeller-xyzac/impeller-7bl-xyzac.ngc',
    'creo-finition': 'creo-finition-ncl/finition.ncl',
    'pycam-sample': 'pycam-sample/test_pycam.ngc',
    'stellabee': 'linuxcnc-stellabee/stellabee1.ngc',
    'bezel': 'qtpyvcp-bezel/bezel_fast.ngc',
    'cnclite-blend': 'cnclite-blend-mpf/gCodeTransitionTs10.MPF',
}
#: Blocks of a public program that are run.
MOST = 2000


def spiral(count: int, block: float, noise: float = 0.0) -> Blocks:
    """Make a spiral of pitch 2 mm over a dome of radius 80 mm, the tool along its normal."""
    radius, pitch = 80.0 * MM, 2.0 * MM / (2.0 * np.pi)
    # chords are a little longer than the arc in the plane
    way = 225.0 * MM + np.arange(count) * block
    turn = np.sqrt(2.0 * way / pitch)
    r = pitch * turn
    tip = np.column_stack([r * np.cos(turn), r * np.sin(turn), np.sqrt(radius**2 - r**2)])
    axis = tip / radius
    tip = tip - [0.0, 0.0, radius]
    tip += np.random.default_rng(0).normal(0.0, 1.0, tip.shape) * noise
    return blocks_of(tip, axis, 3000.0 * MM_PER_MIN, 10.0 * UM)


def cases(names: list[str]) -> list[tuple[str, Machine, Blocks]]:
    """Collect the programs."""
    xyzac = Machine.load('xyzac')
    made = {
        'dome spiral': spiral(2001, 0.5 * MM),
        'dome spiral, 1 um noise': spiral(2001, 0.5 * MM, 1.0 * UM),
        '600 blocks of 0.2 mm': spiral(601, 0.2 * MM),
    }
    found = [(name, xyzac, blocks) for name, blocks in made.items()]
    for name, file in PROGRAMS.items():
        path = SHARED / 'programs' / file
        if not path.exists():
            continue
        options = ReadOptions(feedrate=1000.0 * MM_PER_MIN)
        blocks = read_program(path, Transform.of(xyzac), options).blocks[: MOST + 1]
        # in the middle of the table, whatever the zero was
        middle = 0.5 * (blocks.tip.min(axis=0) + blocks.tip.max(axis=0))
        moved = replace(blocks, tip=blocks.tip - middle, rotary=np.full((len(blocks), 2), np.nan))
        found.append((name, xyzac, moved))
    return [case for case in found if not names or case[0] in names]


def programmed_time(blocks: Blocks) -> float:
    """Return the time at the programmed feed, rapids left out [s]."""
    way = np.linalg.norm(np.diff(blocks.tip, axis=0), axis=1)
    time = np.where(
        np.isfinite(blocks.duration[1:]), blocks.duration[1:], way / blocks.feedrate[1:]
    )
    return float(np.nansum(time))


def run(machine: Machine, blocks: Blocks, curves: bool) -> tuple[Chain, PathSegments]:
    """Send blocks through the whole chain."""
    chain = Chain(machine, ChainOptions(compression=Compression(enabled=curves)))
    for first in range(0, len(blocks), BATCH):
        chain.push(blocks[first : first + BATCH])
    chain.finish()
    return chain, PathSegments.concatenate(chain.segments)


def row_of(name: str, machine: Machine, blocks: Blocks) -> str:
    """Run a program both ways; return its row of the table."""
    corners, _ = run(machine, blocks, curves=False)
    chain, segments = run(machine, blocks, curves=True)
    tolerance = blocks.contour_tolerance[1:].min(), blocks.orientation_tolerance[1:].min()
    off = segments.deviation.max(axis=0) / tolerance
    n, seconds = len(blocks) - 1, chain.seconds
    speeds = ' / '.join(f'{n / max(seconds[room], 1e-9):,.0f}' for room in seconds)
    times = [each.pieces[-1].law.end_time for each in (corners, chain)]
    return (
        f'| {name} | {n} | {len(segments)} | {off[0]:.3f} / {off[1]:.3f} | {times[0]:.2f} '
        f'| {times[1]:.2f} | {programmed_time(blocks):.2f} | {speeds} '
        f'| {n / sum(seconds.values()):,.0f} |'
    )


def main() -> None:
    """Print the table."""
    run(Machine.load('xyzac'), spiral(300, 0.5 * MM), curves=True)  # compile
    print(
        '| program | blocks | segments | contour / orientation bound over tolerance '
        '| corner by corner s | as curves s | at programmed feed s '
        '| blocks/s: look-ahead / kinematics / feedrate / interpolator | whole chain |'
    )
    print('|---|' + '---|' * 8)
    for name, machine, blocks in cases(sys.argv[1:]):
        try:
            print(row_of(name, machine, blocks), flush=True)
        except InterpError as refusal:
            print(f'| {name} | {len(blocks) - 1} | refused: {refusal} |' + ' |' * 6, flush=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f'\npeak memory {peak:.0f} MB, all results kept')


if __name__ == '__main__':
    main()
