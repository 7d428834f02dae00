"""
Measure, then write RESULTS.md and the table of docs/measured.

    python benchmarks/run.py                    # everything, about half an hour on one core
    python benchmarks/run.py --only speed       # one section; the others keep their figures
    python benchmarks/run.py --only optimum --missing # continue an interrupted run
    python benchmarks/run.py --only             # measure nothing, write only the tables

Figures are stored in ``out/benchmarks`` with their commit. Times are CPU seconds.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Callable, Iterator
from itertools import chain

import numpy as np
from active import largest_use, share_active
from figures import Figures, Stopwatch, forget, load, save
from growth import chain_cost, raster, topp3_cost
from optimum import ROUNDS, Optimum, solve
from paths import cases, dense_cases, stop_at_corners
from rivals import topp3, toppra_slowed
from strokes import line_path, stroke_time
from tables import write_tables

from cnc_interp.core import MM
from cnc_interp.feedrate.planning_windows import plan_path
from cnc_interp.machine_model.machine import Machine
from cnc_interp.problems import Problem, stretches
from cnc_interp.problems.paths import of_blocks


def closed_form(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Check planner and program against (32 L/J)^(1/3), a stroke on which jerk alone limits."""
    machine = Machine.load('xyzac')
    for length in (0.1 * MM, 1 * MM, 10 * MM):
        name = f'{length / MM:g} mm'
        if wanted(name):
            path = line_path(length)
            exact = (32 * length / machine.max_jerk[0]) ** (1 / 3)
            planned = plan_path(path, machine)
            yield (
                name,
                {
                    'exact': exact,
                    'optimum': solve(path, machine, planned).time / exact,
                    'ours': planned.law.end_time / exact,
                },
            )


def strokes(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Compare strokes of one axis with ruckig, which knows their time in closed form."""
    machine = Machine.load('xyzac')
    for length in 10.0 ** np.arange(-6, 2):
        name = f'{length / MM:g} mm'
        if wanted(name):
            planned = plan_path(line_path(length), machine)
            exact = stroke_time(length, machine)
            yield (
                name,
                {
                    'exact': exact,
                    'ours': planned.law.end_time / exact,
                    'use': largest_use(planned, machine),
                },
            )


def optimum_of(
    case: Problem, count: int = 500, slowed: float = 1.0, rounds: int = ROUNDS
) -> Optimum:
    """Solve every stretch between stops and add up."""
    parts = stretches(case.path)
    found = [solve(part, case.limits, None, count, slowed, rounds) for part in parts]
    return Optimum(
        time=sum(each.time for each in found),
        excess=max(each.excess for each in found),
        first_time=sum(each.first_time for each in found),
        first_excess=max(each.first_excess for each in found),
        first_converged=all(each.first_converged for each in found),
        converged=all(each.converged for each in found),
    )


def planning_cost(case: Problem) -> Figures:
    """Plan a path six times; the motion, and the CPU seconds of the fastest but the first."""
    planned, seconds = plan_path(case.path, case.limits), []
    for _ in range(5):
        watch = Stopwatch()
        plan_path(case.path, case.limits)
        seconds.append(watch.seconds())
    return {
        'blocks': None if case.blocks is None else len(case.blocks) - 1,
        'cells': len(case.path.s) - 1,
        'motion': planned.law.end_time - planned.law.time[0],
        'planning': min(seconds),
        'use': largest_use(planned, case.limits),
        'active': share_active(planned, case.limits),
    }


def planning(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Plan all paths."""
    for case in cases():
        if wanted(case.name):
            figures = planning_cost(case)
            yield case.name, {**figures, 'stops': finite(stop_at_corners(case))}


def first(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Find the first optimum on all paths, which knows the limits at its instants only."""
    for case in cases():
        if wanted(case.name):
            best = optimum_of(case, rounds=1)
            time = best.first_time if best.first_converged else None
            yield case.name, {'first': time, 'first_excess': best.first_excess}


def optimum(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Find the optimum on all paths, corrected between its instants."""
    for case in cases():
        if not wanted(case.name):
            continue
        best = optimum_of(case)
        yield (
            case.name,
            {
                'optimum': best.time if best.converged else None,
                'excess': best.excess,
            },
        )


def rivals(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Drive all paths in other ways."""
    for case in cases():
        if not wanted(case.name):
            continue
        try:
            second = topp3(case.path, case.limits)
            other, computing = second.time, second.computing
        except Exception as error:  # its solver's own exceptions: the table says that it gave up
            print(f'copp-py on {case.name}: {error}')
            other = computing = math.nan
        yield (
            case.name,
            {
                'topp3': finite(other),
                'topp3_computing': finite(computing),
                'slowed': finite(toppra_slowed(case.path, case.limits)),
            },
        )


def finite(value: float) -> float | None:
    """Return None for a figure that there is not."""
    return value if math.isfinite(value) else None


def trust(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Solve the two worst paths on a grid twice as fine and from a first guess half as fast."""
    ours, best = load('planning'), load('first')
    both = [name for name in best if name in ours and best[name]['first'] is not None]
    worst = sorted(both, key=lambda name: ours[name]['motion'] / best[name]['first'])[-2:]
    for case in cases():
        if case.name not in worst or not wanted(case.name):
            continue
        fine, slow = optimum_of(case, count=1000), optimum_of(case, slowed=2.0)
        yield (
            case.name,
            {
                'ours': plan_path(case.path, case.limits).law.end_time,
                'fine': fine.time if fine.converged else None,
                'fine_first': fine.first_time,
                'slow': slow.time if slow.converged else None,
            },
        )


def speed(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Plan dense 5-axis programs: blocks so short that each costs cells of its own."""
    machine = Machine.load('xyzac')
    raster_case = of_blocks('raster on a dome, 2,000 blocks of 1 mm', raster(2000), machine)
    for case in chain([raster_case], dense_cases(machine)):
        if wanted(case.name):
            yield case.name, planning_cost(case)


def growth(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Send longer and longer programs through the chain."""
    chain_cost(300)
    for count in (1000, 10_000, 100_000):
        if wanted(f'{count}'):
            yield f'{count}', chain_cost(count)


def million(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Send a million blocks through the chain."""
    chain_cost(300)
    if wanted('1000000'):
        yield '1000000', chain_cost(1_000_000)


def growth_topp3(wanted: Callable[[str], bool]) -> Iterator[tuple[str, Figures]]:
    """Plan longer and longer programs with copp-py."""
    for count in (100, 300, 1000, 3000):
        if wanted(f'{count}'):
            yield f'{count}', topp3_cost(count)


SECTIONS = {
    'strokes': strokes,
    'closed_form': closed_form,
    'planning': planning,
    'speed': speed,
    'growth': growth,
    'growth_topp3': growth_topp3,
    'first': first,
    'optimum': optimum,
    'rivals': rivals,
    'trust': trust,
    'million': million,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or '').strip().splitlines()[0])
    parser.add_argument(
        '--only',
        nargs='*',
        choices=SECTIONS,
        default=[name for name in SECTIONS if name != 'million'],
        help='what to measure; all but a million blocks by default',
    )
    parser.add_argument(
        '--missing', action='store_true', help='measure only what has no figures yet'
    )
    options = parser.parse_args()
    for section in options.only:
        if not options.missing:
            forget(section)
        held = set(load(section))
        for name, figures in SECTIONS[section](lambda name, held=held: name not in held):
            save(section, name, figures)
            print(section, name, figures, flush=True)
            write_tables()
    write_tables()


if __name__ == '__main__':
    main()
