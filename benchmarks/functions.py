"""
Cost of functions: blocks that each have S and M8 or M9, against the same blocks without them.

    PYTHONPATH=. python benchmarks/functions.py [--blocks 10000] [--rounds 5]

Measures the CPU seconds of reading, of the whole plan, and of the machine's cycle that executes
it. The variants alternate; the median of the rounds counts, after one round that loads the
kernels. The machine runs without its clock.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from cnc_interp.machine.playback import Playback
from cnc_interp.machine.simulated_drives import SimulatedDrives
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.signals import signals
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.reading import open_program
from cnc_interp.run.planning_chain import plan_to_files
from cnc_interp.settings.options import Settings

MACHINE = replace(Machine.load('xyz'), signals=signals({'signals': 'milling'}))
PERIODS = 20_000  #: Of the cycle in each round.


def text(blocks: int, functions: bool) -> str:
    lines = ['G21 G90 G94 S1000 M3', 'G0 X0 Y0 Z0', 'G1 F6000']
    for k in range(blocks):
        words = f' S{1000 + k % 500} M{8 + k % 2}' if functions else ''
        lines.append(f'X{(k + 1) * 0.1:.1f} Y{(k % 2) * 0.01:.2f}{words}')
    return '\n'.join([*lines, 'M30', ''])


def costs(program: str, folder: Path) -> dict[str, float]:
    """Return CPU seconds by stage, and how many functions there are."""
    settings, found = Settings(), {}
    geometry = Transform.of(MACHINE)
    file = folder.with_suffix('.ngc')
    file.write_text(program)
    begun = time.process_time()
    open_program(file, geometry, settings).read()
    found['reading'] = time.process_time() - begun
    begun = time.process_time()
    summary = plan_to_files(open_program(file, geometry, settings), MACHINE, folder)
    found['plan, reading and files included'] = time.process_time() - begun
    found['functions'] = float(sum(summary.get('functions', {}).values()))
    return found


def cycle_cost(machine: Machine) -> float:
    """Return CPU microseconds of a period at rest, in which the outputs are written."""
    period = Settings().interpolation_period
    stands = np.zeros(len(machine.axis_names))
    machine = machine.having(travel=np.tile([-np.inf, np.inf], (len(stands), 1)))
    drives = SimulatedDrives(machine, period, stands)
    playback = Playback(machine, period, drives, 1)
    playback.switch_on()
    playback.cycle.step()
    begun = time.process_time()
    for _ in range(PERIODS):
        playback.cycle.step()
    return (time.process_time() - begun) / PERIODS * 1e6


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--blocks', type=int, default=10_000)
    parser.add_argument('--rounds', type=int, default=5)
    options = parser.parse_args()
    kept: dict[str, dict[bool, list[float]]] = defaultdict(lambda: {False: [], True: []})
    with tempfile.TemporaryDirectory() as name:
        for turn in range(options.rounds + 1):
            for functions in (False, True):
                found = costs(text(options.blocks, functions), Path(name) / f'{turn}{functions}')
                machine = MACHINE if functions else Machine.load('xyz')
                found['period of the machine [us]'] = cycle_cost(machine)
                for stage, value in found.items():
                    kept[stage][functions] += [value] if turn else []
    print(f'| {options.blocks} blocks | without | with S and M8, M9 | ratio |')
    print('|---|---|---|---|')
    for stage, both in kept.items():
        without, given = median(both[False]), median(both[True])
        print(f'| {stage} | {without:.3f} | {given:.3f} | {given / max(without, 1e-9):.2f} |')


if __name__ == '__main__':
    main()
