"""
A long program planned by one process and by several: processor time, wall time, same plan.

    python benchmarks/parallel.py [PROGRAM ...] [--machine M] [--workers N] [--strokes N]

Without a program, a drilling program of ``--strokes`` holes with exact stops (G61) is planned.
Printed are the stretches between stops and the share of the longest; then, for 1 and N processes,
the wall time, the processor time of this process and of the others, and the hash of the plan
files.

On two otherwise idle processors, planning takes at least the processor time of this process, and
at least half of that of all processes.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import resource
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from cnc_interp.core import MM_PER_MIN
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program import open_program
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

FILES = ('blocks.npz', 'segments.npz', 'path.npz', 'setpoints.npz')
#: A processor that is shared with others counts in full.
PROCESSORS = 2


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('programs', type=Path, nargs='*')
    parser.add_argument('--machine', default='xyzac')
    parser.add_argument('--workers', type=int, default=2, metavar='N')
    parser.add_argument('--strokes', type=int, default=500, metavar='N')
    options = parser.parse_args()
    machine = Machine.load(options.machine)
    with tempfile.TemporaryDirectory() as folder:
        programs = options.programs or [drilling(options.strokes, Path(folder))]
        for program in programs:
            compare(program, machine, options.workers, Path(folder))


def drilling(holes: int, folder: Path) -> Path:
    """Write a drilling program; each stroke ends at an exact stop."""
    chance = random.Random(1)
    lines = ['G21 G90 G94 G61', 'G0 X0 Y0 Z20']
    for _ in range(holes):
        x, y = chance.uniform(-80, 80), chance.uniform(-60, 60)
        lines += [f'G0 X{x:.3f} Y{y:.3f}', 'Z2', 'G1 Z-5 F500', 'G0 Z20']
    file = folder / f'{holes} holes.ngc'
    file.write_text('\n'.join([*lines, 'M30', '']))
    return file


def compare(program: Path, machine: Machine, workers: int, folder: Path) -> None:
    """Plan a program with one process and with several."""
    settings = replace(Settings(), feedrate=1000 * MM_PER_MIN)
    # The first plan loads libraries and kernels.
    plan(drilling(2, folder), machine, settings, 1, folder / 'warm')
    alone = 0.0
    for processes in (1, workers):
        out = folder / f'{processes}'
        wall, own, others = plan(program, machine, settings, processes, out)
        if processes == 1:
            stops = np.flatnonzero(np.load(out / 'path.npz')['stop'])
            cells = np.diff(stops)
            print(
                f'{program.name}: {len(cells)} stretches, the longest has '
                f'{cells.max() / cells.sum():.1%} of the cells'
            )
            alone = own
        least = max(own, (own + others) / PROCESSORS)
        digest = hashlib.sha256(b''.join((out / name).read_bytes() for name in FILES))
        print(
            f'  {processes} processes  wall {wall:6.1f} s  processor {own:6.1f} s here, '
            f'{others:6.1f} s others; {alone / least:4.2f} times as fast on {PROCESSORS} free '
            f'processors  plan {digest.hexdigest()[:16]}  (load {os.getloadavg()[0]:.0f})',
            flush=True,
        )


def plan(
    program: Path, machine: Machine, settings: Settings, processes: int, out: Path
) -> tuple[float, float, float]:
    """Plan; return wall time, and processor time of this process and of its children [s]."""
    before, began = used(), time.monotonic()
    stream = open_program(program, Transform.of(machine), settings)
    plan_to_files(stream, machine, out, settings, processes=processes)
    after = used()
    return time.monotonic() - began, after[0] - before[0], after[1] - before[1]


def used() -> tuple[float, float]:
    """Return the processor time of this process and of its ended children [s]."""
    both = [resource.getrusage(w) for w in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return both[0].ru_utime + both[0].ru_stime, both[1].ru_utime + both[1].ru_stime


if __name__ == '__main__':
    main()
