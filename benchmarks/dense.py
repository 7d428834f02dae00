"""
Dense programs as curves and corner by corner: the tables of docs/how_it_works/dense_programs.md.

    PYTHONPATH=. python benchmarks/dense.py [--most N] [--only NAME ...]
    PYTHONPATH=. python benchmarks/dense.py --growth 1000 10000 100000

The generated programs are a dome spiral of 2,000 blocks of 0.5 mm, with and without round-off
noise, and one of 600 blocks of 0.2 mm. Their tool follows the surface normal, and both tolerances
are 0.01 mm. If a folder ``shared`` lies beside the repository, the first N blocks (5,000) of
public programs are added, with the machines and feeds of ``programs.py``, and tolerances as
programmed or 0.02 mm.

Each program is read, planned both ways into plan files, and proven in its own process. Deviations
are bounds in both directions (curve from blocks, blocks from curve), divided by the local
tolerance. Rates are blocks per CPU second of one thread.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from paths import dome
from programs import CASES, PROGRAMS, program_file
from whole_plans import Kept

from cnc_interp.core import MM, MM_PER_MIN, UM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import Blocks, open_program
from cnc_interp.proof.verify import verify_plan
from cnc_interp.run.path_chain import BATCH, batches
from cnc_interp.run.plan_writer import PlanWriter
from cnc_interp.run.planning_chain import Chain
from cnc_interp.settings.options import Settings

PUBLIC = (
    'linuxcnc-impeller-xyzac',
    'creo-finition-ncl',
    'pycam-sample',
    'linuxcnc-stellabee',
    'qtpyvcp-bezel',
    'cnclite-blend-mpf',
)
HEAD = (
    '| program | blocks | segments a block | contour / orientation bound over tolerance '
    '| corner by corner s | as curves s | at programmed feed s '
    '| blocks/s: reader / look-ahead / kinematics / feedrate / interpolator | whole chain '
    '| peak memory MB | check |'
)


def noisy(blocks: Blocks, size: float) -> Blocks:
    """Add round-off noise to the tool tips."""
    noise = np.random.default_rng(0).normal(0.0, size, blocks.tip.shape)
    return replace(blocks, tip=blocks.tip + noise)


def six_hundred() -> Blocks:
    """Make 600 blocks of 0.2 mm that last 4.8 s at the programmed feed."""
    blocks = dome(600, 0.2 * MM)
    return replace(blocks, feedrate=np.full(len(blocks), 1500.0 * MM_PER_MIN))


MADE: dict[str, Callable[[], Blocks]] = {
    'dome spiral': dome,
    'dome spiral, 1 um noise': lambda: noisy(dome(), 1.0 * UM),
    '600 blocks of 0.2 mm': six_hundred,
}


def read(name: str, most: int) -> tuple[Machine, Blocks, int, float]:
    """Return machine, blocks, how many the program has, and reading time a block [CPU s]."""
    if name in MADE:
        blocks = MADE[name]()
        return Machine.load('xyzac'), blocks, len(blocks) - 1, np.nan
    case = CASES[name]
    machine = Machine.load(case.machine)
    feed = None if case.feed is None else case.feed * MM_PER_MIN
    settings = Settings(feedrate=feed)
    for _ in range(2):  # kernels and file cache warm
        begin = time.process_time()
        stream = open_program(program_file(name), Transform.of(machine), settings, case.setup)
        blocks = stream.read().blocks
        spent = time.process_time() - begin
    return machine, blocks[: most + 1], len(blocks) - 1, spent / (len(blocks) - 1)


def programmed_time(blocks: Blocks) -> float:
    """Return the time at the programmed feed, rapids left out [s]."""
    way = np.linalg.norm(np.diff(blocks.tip, axis=0), axis=1)
    time = np.where(
        np.isfinite(blocks.duration[1:]), blocks.duration[1:], way / blocks.feedrate[1:]
    )
    return float(np.nansum(time))


def run(machine: Machine, blocks: Blocks, curves: bool, directory: Path) -> dict[str, Any]:
    """Plan blocks into plan files; return the summary."""
    settings = Settings(compress=curves)
    with PlanWriter(directory, machine, settings) as writer:
        chain = Chain(machine, settings, writer, time.process_time)
        writer.blocks(blocks)
        for batch in batches(blocks):
            chain.push(batch)
        chain.finish()
        return writer.finish('dense', chain.seconds)


def row_of(name: str, most: int) -> str:
    """Run a program both ways; return its row of the table."""
    machine, blocks, whole, reading = read(name, most)
    with tempfile.TemporaryDirectory() as folder:
        run(machine, blocks[:400], True, Path(folder))  # kernels warm
        made = run(machine, blocks, True, Path(folder))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        proof = verify_plan(Path(folder), machine)
        corners = run(machine, blocks, False, Path(folder))
    n, rooms = len(blocks) - 1, made['planning_time_by_room']
    per_block = [reading, *(spent / n for spent in rooms.values())]
    rates = ' / '.join('-' if np.isnan(x) else f'{1.0 / max(x, 1e-9):,.0f}' for x in per_block)
    used = made['tolerance_used']
    count = f'{n:,}' if n == whole else f'first {n:,} of {whole:,}'
    return (
        f'| {name} | {count} | {made["segments"] / n:.2f} '
        f'| {used["contour"]:.3f} / {used["orientation"]:.3f} '
        f'| {corners["cycle_time"]:.2f} | {made["cycle_time"]:.2f} '
        f'| {programmed_time(blocks):.2f} | {rates} | {1.0 / np.nansum(per_block):,.0f} '
        f'| {peak:.0f} | {"proven" if proof.ok else "NOT PROVEN"} |'
    )


def growth(counts: list[int]) -> Iterator[str]:
    """Run longer and longer dome spirals as curves; yield rows of a table."""
    yield '| blocks | motion s | chain us per block | peak memory MB |'
    yield '|---|---|---|---|'
    machine = Machine.load('xyzac')
    for count in counts:
        kept, motion = Kept(), 0.0
        chain = Chain(machine, Settings(), kept, time.process_time)
        for blocks in spirals(count):
            chain.push(blocks)
            motion = kept.pieces[-1].law.end_time if kept.pieces else motion
            for held in (kept.parts, kept.pieces, kept.samples):
                held.clear()
        chain.finish()
        spent = sum(chain.seconds.values()) / count / UM
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
        motion = kept.pieces[-1].law.end_time
        yield f'| {count:,} | {motion:.1f} | {spent:.0f} | {peak:.0f} |'


def spirals(count: int) -> Iterator[Blocks]:
    """Yield batches of blocks of 0.5 mm, to and fro on the dome spiral."""
    piece = dome()
    n = len(piece) - 1
    for first in range(0, count + 1, BATCH):
        k = np.arange(first, min(first + BATCH, count + 1)) % (2 * n)
        rows = np.where(k <= n, k, 2 * n - k)
        yield piece[rows]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--most', type=int, default=5000, help='blocks of a public program')
    parser.add_argument('--only', choices=[*MADE, *PUBLIC], nargs='+', default=[*MADE, *PUBLIC])
    parser.add_argument('--growth', type=int, nargs='+', help='numbers of blocks')
    parser.add_argument('--here', help='run one in this process')
    options = parser.parse_args()
    if options.growth:
        for row in growth(options.growth):
            print(row, flush=True)
        return
    if options.here:
        try:
            print(json.dumps(row_of(options.here, options.most)))
        except InterpError as refusal:
            print(json.dumps(f'| {options.here} | refused: {refusal} |' + ' |' * 9))
        return
    print(HEAD)
    print('|---' * 11 + '|')
    for name in options.only:
        if name in PUBLIC and not PROGRAMS.exists():
            continue
        command = [sys.executable, __file__, '--here', name, '--most', str(options.most)]
        done = subprocess.run(command, check=True, capture_output=True, text=True)
        print(json.loads(done.stdout.splitlines()[-1]), flush=True)


if __name__ == '__main__':
    main()
