"""
Every interpolation period: the same programs planned and proven from 0.25 to 4 ms.

    python benchmarks/periods.py [--count 40] [PROGRAM ...]

Random 5-axis programs with rotary words (half of them with tool-tip control) and the files named.
Every plan is proven at its own period. "Time" is the cycle time against that at 1 ms: the period
itself changes it by less than a period for every stop of the program. "Use" is the largest share
of a limit that differences of setpoints take.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from rotary_words import files_of, random_program
from whole_plans import plan_program

from cnc_interp.core import MS, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import read_text
from cnc_interp.proof.verify import verify
from cnc_interp.settings.options import Settings

PERIODS = (0.25, 0.5, 1.0, 2.0, 4.0)  # [ms]


def main() -> None:
    """Print one row for each period."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('programs', nargs='*')
    parser.add_argument('--machine', default='xyzac')
    parser.add_argument('--count', type=int, default=40)
    options = parser.parse_args()
    machine = Machine.load(options.machine)
    transform = Transform.of(machine)
    texts = {Path(name).name: Path(name).read_text() for name in options.programs}
    for seed in range(options.count):
        rng = np.random.default_rng([17, seed])
        texts[f'random {seed}.ngc'] = random_program(rng, machine, tcp=seed % 2 == 0)
    times: dict[float, dict[str, float]] = {}
    print('| period, ms | programs | refused | not proven | time, median | time, most | use, % |')
    print('|---|---|---|---|---|---|---|')
    for period in sorted(PERIODS, key=lambda each: each != 1.0):
        refused, unproven, use, times[period] = 0, 0, 0.0, {}
        for name, text in texts.items():
            settings = Settings(interpolation_period=period * MS, feedrate=2000.0 / 60e3)
            try:
                program = read_text(text, name, transform, settings)
                plan = plan_program(program, machine, settings)
            except InterpError as problem:
                refused += 1
                print(f'{name} refused at {period} ms: {problem}')
                continue
            proof = verify(files_of(plan), machine)
            if not proof.ok:
                unproven += 1
                print(f'{name} not proven at {period} ms: {proof.failures[0]}')
            times[period][name] = proof.cycle_time
            position = plan.setpoints.position
            held = np.concatenate(
                [position[:1].repeat(3, 0), position, position[-1:].repeat(3, 0)]
            )
            for order, row in enumerate(
                (machine.max_velocity, machine.max_acceleration, machine.max_jerk), start=1
            ):
                difference = np.abs(np.diff(held, order, axis=0)) / (period * MS) ** order
                use = max(use, float((difference / row).max()))
        ratios = [time / times[1.0][name] for name, time in times[period].items()]
        print(
            f'| {period:g} | {len(texts)} | {refused} | {unproven} | {np.median(ratios):.4f} | '
            f'{max(ratios):.4f} | {100 * use:.2f} |',
            flush=True,
        )


if __name__ == '__main__':
    main()
