"""
The lower bound of the time: how near the motion law is to it, and what the bound costs.

    PYTHONPATH=. python benchmarks/bound.py
    PYTHONPATH=. python benchmarks/bound.py --programs 4000 [--only NAME ...]

Run it alone on the computer. The second command takes the first blocks of the public programs. It
prints how many path cells are planned per second, bound included, and also plans for other
periods: "use" is the largest share of a limit in differences of the setpoints at 0.25, 1 and 4 ms.
Times are CPU times.
"""

from __future__ import annotations

import argparse
import sys
import time
from itertools import chain

import numpy as np
from dense import read
from paths import cases, dense_cases
from programs import CASES
from whole_plans import path_of

from cnc_interp.core import MS, FloatArray, InterpError
from cnc_interp.feedrate.limit_use import limits_at
from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import PlannedPiece, plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.problems import Problem
from cnc_interp.run.setpoints import BEFORE, Interpolator, largest_shares
from cnc_interp.settings.options import DEFAULT_MACHINE, Settings

#: How often each path is planned; the shortest time counts.
TIMES = 5
#: Periods at which the use of the limits is measured [s].
PERIODS = (0.25 * MS, 1.0 * MS, 4.0 * MS)


def fastest(case: Problem, bound: bool) -> tuple[float, PlannedPiece]:
    """Return the CPU time of planning a path [s], and the plan."""
    seconds = []
    for _ in range(TIMES):
        begun = time.process_time()
        piece = plan_path(case.path, case.limits, PlanOptions(bound=bound))
        seconds.append(time.process_time() - begun)
    return min(seconds), piece


def of_paths() -> None:
    """Print one line for each path."""
    heads = 'cells', 'law s', 'bound s', 'law/bound', 'its share'
    print(f'{"path":<42}' + ''.join(f'{head:>10}' for head in heads))
    alone = both = 0.0
    for case in chain(cases(), dense_cases(Machine.load(DEFAULT_MACHINE))):
        without, _ = fastest(case, False)
        seconds, piece = fastest(case, True)
        alone, both = alone + without, both + seconds
        least, law = piece.least_time, piece.law
        print(
            f'{case.name:<42}{len(law):>10}{law.end_time:>10.4f}{least:>10.4f}'
            f'{law.end_time / least:>10.3f}{1 - without / seconds:>10.1%}',
            flush=True,
        )
    print(f'share of the feed planner in all: {1 - alone / both:.1%}')


def largest_use(path: AxisPath, machine: Machine, period: float) -> float:
    """Plan for a period and return the largest use of a limit by differences of the setpoints."""
    options = PlanOptions(bound=False)
    piece, interpolator = (
        plan_path(path, limits_at(machine, period), options),
        Interpolator(period),
    )
    held: FloatArray = np.repeat(path.cell_left[0, :1], BEFORE, axis=0)
    most = 0.0
    end = np.repeat(path.cell_right[0, -1:], BEFORE, axis=0)
    for position in chain((part.position for part in interpolator.parts(piece)), (end,)):
        held = np.concatenate([held[-BEFORE:], position])
        most = max(most, float(largest_shares(held, machine.limits, period).max()))
    return most


def of_programs(most: int, names: list[str]) -> None:
    """Print one row of a table for each public program that can be read."""
    heads = 'blocks', 'cells', 'cells/s', "the bound's share", 'law / bound'
    uses = (f'use at {period / MS:g} ms' for period in PERIODS)
    print('| program | ' + ' | '.join([*heads, *uses]) + ' |')
    print('|---' + '|--:' * (len(heads) + len(PERIODS)) + '|')
    for name in names:
        try:
            machine, blocks, _, _ = read(name, most)
        except InterpError:
            continue
        path = path_of(blocks, Transform.of(machine), Settings())
        seconds = [np.inf, np.inf]
        for bound in (False, True, False, True):
            begun = time.process_time()
            piece = plan_path(path, machine, PlanOptions(bound=bound))
            seconds[bound] = min(seconds[bound], time.process_time() - begun)
        cells, law = len(piece.law), piece.law.end_time
        told = (f'{largest_use(path, machine, period):.2%}' for period in PERIODS)
        print(
            f'| {name} | {len(blocks) - 1:,} | {cells:,} | {cells / seconds[1]:,.0f} '
            f'| {1 - seconds[0] / seconds[1]:.1%} | {law / piece.least_time:.3f} | '
            + ' | '.join(told)
            + ' |',
            flush=True,
        )


def main() -> int:
    """Measure paths or programs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--programs', type=int, metavar='BLOCKS')
    parser.add_argument('--only', choices=sorted(CASES), nargs='+', default=sorted(CASES))
    options = parser.parse_args()
    if options.programs:
        of_programs(options.programs, options.only)
    else:
        of_paths()
    return 0


if __name__ == '__main__':
    sys.exit(main())
