"""Figures of compensated geometric errors: tips, limits, cycle times and planning times.

    PYTHONPATH=. python benchmarks/geometric_errors.py 1000

makes a thousand random machines (``true_machines.py``), plans a short program on each machine with
and without its errors, and prints one line.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np
from true_machines import TrueMachine

from cnc_interp import Settings, check, plan_program, smooth_path
from cnc_interp.core import InterpError
from cnc_interp.kinematics.axis_path import evaluate
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.program.blocks import Blocks
from cnc_interp.program.reading import Program

POSES, PLACES = 200, 2000  #: Poses of a machine, and places on its path.
SETTINGS = Settings(compress=False)


@dataclass(frozen=True)
class Figures:
    error: float  #: Largest error of the tip at poses, without compensation [m].
    left: float  #: The same with it.
    left_on_path: float  #: With it, along a path between poses [m].
    time: float  #: Cycle time over that without errors [-].
    cost: float  #: Planning time of the same [s].
    cost_before: float  #: And without errors [s].
    faults: tuple[str, ...]  #: What the proof of the compensated plan has found.


def at_poses(true: TrueMachine, seed: int) -> tuple[float, float]:
    q = true.places_of_axes(np.random.default_rng([seed, 1]), POSES, 0.9)
    c = Transform.of(true.machine).errors.commanded(q)
    meant = true.tips(q, true=False)
    error, left = (np.linalg.norm(true.tips(at) - meant, axis=1).max() for at in (q, c))
    return float(error), float(left)


def on_path(true: TrueMachine, blocks: Blocks) -> float:
    """Compare true tips on the compensated path with the path that an ideal machine makes."""
    meant, path = (
        smooth_path(blocks, Transform.of(machine), SETTINGS)
        for machine in (true.ideal, true.machine)
    )
    s = np.linspace(0.0, path.s[-1], PLACES)
    tips = true.tips(evaluate(meant, s)[0], true=False)
    return float(np.linalg.norm(true.tips(evaluate(path, s)[0]) - tips, axis=1).max())


def figures(seed: int) -> Figures:
    true = TrueMachine(seed)
    for attempt in range(20):  # until lines between poses stay within reach
        blocks = true.blocks(np.random.default_rng([seed, 2, attempt]))
        try:
            plans = {}
            for compensates in (seed % 2, 1 - seed % 2):  # the first one is slower
                machine = (true.ideal, true.machine)[compensates]
                begin = process_time()
                plan = plan_program(Program(blocks), machine, SETTINGS)
                plans[compensates] = plan, process_time() - begin
        except InterpError:
            continue
        (ideal, cost_before), (plan, cost) = plans[0], plans[1]
        time, faults = plan.cycle_time / ideal.cycle_time, tuple(check(plan).failures)
        left = on_path(true, blocks)
        return Figures(*at_poses(true, seed), left, time, cost, cost_before, faults)
    raise InterpError(f'no program for machine {seed}')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('count', nargs='?', type=int, default=20, help='machines')
    count = parser.parse_args().count
    figures(0)  # compiles
    found = [figures(seed) for seed in range(count)]
    left = max(max(f.left, f.left_on_path) for f in found)
    share = max(max(f.left, f.left_on_path) / f.error for f in found)
    cost = sum(f.cost for f in found) / sum(f.cost_before for f in found)
    times = [f.time for f in found]
    print(
        f'{count} machines: errors {min(f.error for f in found) * 1e6:.0f} to '
        f'{max(f.error for f in found) * 1e6:.0f} um; compensated at most {left * 1e6:.3f} um, '
        f'{share:.2%} of the error; cycle time {min(times) - 1:+.3%} to {max(times) - 1:+.3%}; '
        f'planning {cost - 1:+.1%}; {sum(bool(f.faults) for f in found)} plans with faults'
    )
    for seed, f in enumerate(found):
        for fault in f.faults:
            print(f'machine {seed}: {fault}')


if __name__ == '__main__':
    main()
