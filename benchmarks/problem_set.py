"""
Times of the problem set: the independent optimum, our law, the bound; and scores of two laws.

    python benchmarks/problem_set.py             # writes cnc_interp/problems/times.csv
    python benchmarks/problem_set.py --missing   # continues an interrupted run
    python benchmarks/problem_set.py --laws      # prints the table of docs/measured
"""

from __future__ import annotations

import argparse
import csv
import math
import runpy
import statistics
from collections.abc import Callable
from pathlib import Path

import numpy as np
from figures import ROOT
from strokes import stroke_time

from cnc_interp import axis_motion, plan_path
from cnc_interp.core import PlanningError
from cnc_interp.problems import Problem, Score, known, paths, problems, score

PERIOD = 1e-3
TIMES = Path(paths.__file__).with_name('times.csv')
MOST_CELLS = 2000  #: Longer paths have no optimum: the solver's grid would be too coarse.


def best_time(case: Problem) -> float:
    """Return the optimum of IPOPT, of ruckig for strokes [s]; NaN if there is none."""
    if case.name.startswith('stroke'):
        return stroke_time(float(case.path.s[-1]), case.limits)
    from run import optimum_of

    if len(case.path.s) > MOST_CELLS or case.path.stop.sum() > 50:
        return math.nan
    found = optimum_of(case)
    return found.time if found.converged else math.nan


def planned(case: Problem) -> Score:
    """Score our law by its samples."""
    piece = plan_path(case.path, case.limits)
    time = np.arange(0.0, piece.law.end_time + PERIOD, PERIOD)
    q = axis_motion(piece.path, piece.law, time)[0]
    return score(case, q, PERIOD, piece.law.end_time)


def write_times(missing: bool) -> None:
    """Write the table after every path, the old figures where they are kept."""
    rows = []
    for case in problems():
        before = known(case.name)
        piece = plan_path(case.path, case.limits)
        best = before.optimum if missing and before.optimum > 0.0 else best_time(case)
        rows.append(
            [case.name, *(f'{x:.6f}' for x in (best, piece.law.end_time, piece.least_time))]
        )
        print(*rows[-1], flush=True)
        with TIMES.open('w', newline='', encoding='utf-8') as file:
            out = csv.writer(file, lineterminator='\n')
            out.writerow(['path', *paths.Known._fields])
            out.writerows(rows)
            if missing:
                done = {row[0] for row in rows}
                out.writerows(
                    [name, *(f'{x:.6f}' for x in times)]
                    for name, times in paths._table().items()
                    if name not in done
                )


def laws() -> None:
    """Print the scores of the laws: time over the optimum, over our time where there is none."""
    made: dict[str, Callable[[Problem], Score]] = {
        'jerk stage': planned,
        'trapezoid': runpy.run_path(str(ROOT / 'examples' / '13_feed_law.py'))['scored'],
    }
    ratios: dict[str, list[float]] = {law: [] for law in (*made, 'bound without jerk')}
    print(f'| path | optimum s | {" | ".join(ratios)} |\n|{"---|" * (2 + len(ratios))}')
    for case in problems():
        times = known(case.name)
        by = times.ours if math.isnan(times.optimum) else times.optimum
        cells = [case.name, '-' if math.isnan(times.optimum) else f'{by:.4f}']
        for law, of in made.items():
            try:
                found = of(case)
            except PlanningError:
                cells.append('refused')
                continue
            if not math.isnan(times.optimum):
                ratios[law].append(found.time / by)
            over = '' if found.kept else f', use {found.use:.2f}'
            cells.append(f'{found.time / by:.4f}{over}')
        if not math.isnan(times.optimum):
            ratios['bound without jerk'].append(times.bound / by)
        print(f'| {" | ".join([*cells, f"{times.bound / by:.3f}"])} |', flush=True)
    for law, of_paths in ratios.items():
        middle, most = statistics.median(of_paths), max(of_paths)
        print(f'{law}: {len(of_paths)} paths, median {middle:.4f}, largest {most:.4f}')


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument('--missing', action='store_true', help='solve only what has no figures')
    parser.add_argument('--laws', action='store_true', help='print the table of laws')
    options = parser.parse_args()
    laws() if options.laws else write_times(options.missing)


if __name__ == '__main__':
    main()
