"""
The programs of `shared/cases/rotary` on their machines: where the axes end, times, the proof.

    python benchmarks/rotary_cases.py [--cases ../shared/cases]

The rows are those of `test/corpus/cases.yaml` whose input lies in the folder `rotary`. The table
has the last position of each axis that the program names, the cycle time, the time to read and
plan the program, and whether the proof holds.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import yaml
from rotary_words import files_of
from whole_plans import plan_program

from cnc_interp.core import DEG, MM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings

ROOT = Path(__file__).resolve().parents[1]


def row(file: Path, machine: Machine, settings: Settings) -> str:
    """Plan and check one program; return its cells of the table."""
    try:
        for _ in range(2):  # the kernels are loaded the first time
            clock = time.perf_counter()
            program = read_text(file.read_text(), file.name, Transform.of(machine), settings)
            plan = plan_program(program, machine, settings)
            clock = time.perf_counter() - clock
    except InterpError as problem:
        return f'refused: {problem}'
    scale = np.where(machine.is_linear, MM, DEG)
    first, last = (plan.setpoints.position[k] / scale for k in (0, -1))
    moved = [
        f'{name} {a:.3f} to {b:.3f}'
        for name, a, b in zip(machine.axis_names, first, last, strict=True)
        if name not in 'XYZ' and abs(a) + abs(b) > 0.0
    ]
    proof = verify(files_of(plan), machine)
    seconds = float(plan.setpoints.time[-1])
    verdict = 'yes' if proof.ok else f'NO: {proof.failures[0]}'
    return f'{", ".join(moved) or "at 0"} | {seconds:.3f} | {clock:.2f} | {verdict}'


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--cases', type=Path, default=ROOT.parent / 'shared' / 'cases')
    folder = parser.parse_args().cases
    cases = yaml.safe_load((ROOT / 'test' / 'corpus' / 'cases.yaml').read_text())['cases']
    print('| program | machine | rotary axes, deg | time, s | planning, s | proven |')
    print('|---' * 6 + '|')
    for case in cases:
        if not case['input'].startswith('rotary/'):
            continue
        settings = Settings(compress='--no-compress' not in case.get('options', []))
        name = ' '.join([Path(case['input']).stem, *case.get('options', [])])
        for machine in case.get('machines', ['xyzac']):
            found = row(folder / case['input'], Machine.load(machine), settings)
            print(f'| {name} | {machine} | {found} |', flush=True)


if __name__ == '__main__':
    main()
