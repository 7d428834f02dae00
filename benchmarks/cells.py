"""
How fine the cells of the feed planner must be: cells, cycle time and cost; run by itself.

    PYTHONPATH=. python benchmarks/cells.py [--blocks 400]

The first blocks of dense public programs, as curves, are planned with the options of the planner
and with coarser ones. ``bend`` is the largest deviation of the derivatives inside a cell from a
line, ``cell time`` the longest wanted cell. Times are CPU time of one thread, kernels warm.
"""

from __future__ import annotations

import argparse
import time

from dense import read
from whole_plans import path_of

from cnc_interp.feedrate.planner_tuning import PlanOptions
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.machine_model.transform_port import Transform
from cnc_interp.settings.options import Settings

PROGRAMS = 'linuxcnc-stellabee', 'linuxcnc-impeller-xyzac', 'qtpyvcp-bezel', 'pycam-sample'
SHORTEST = PlanOptions().cell_time[0]
VARIANTS = {
    'as it is': PlanOptions(bound=False),
    'bend 0.0075': PlanOptions(bound=False, bend=0.0075),
    'bend 0.01': PlanOptions(bound=False, bend=0.01),
    'cell time 9 ms': PlanOptions(bound=False, cell_time=(SHORTEST, 9e-3)),
    'cell time 12 ms': PlanOptions(bound=False, cell_time=(SHORTEST, 12e-3)),
}


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--blocks', type=int, default=400)
    options = parser.parse_args()
    print('| program | options | cells a block | motion s | slower by | us a block |')
    print('|---' * 6 + '|')
    for name in PROGRAMS:
        machine, blocks, _, _ = read(name, options.blocks)
        path = path_of(blocks, Transform.of(machine), Settings())
        count, first = len(blocks) - 1, 0.0
        plan_path(path, machine, PlanOptions(bound=False))
        for label, variant in VARIANTS.items():
            begun = time.process_time()
            law = plan_path(path, machine, variant).law
            spent = time.process_time() - begun
            first = first or law.end_time
            print(
                f'| {name} | {label} | {len(law) / count:.1f} | {law.end_time:.4f} '
                f'| {law.end_time / first - 1.0:.1e} | {spent / count * 1e6:.0f} |',
                flush=True,
            )


if __name__ == '__main__':
    main()
