"""Run all benchmarks, write RESULTS.md; ``--quick``: few paths, ``--million``: long programs."""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from active import share_active
from growth import chain_growth, topp3_growth
from optimum import Optimum, solve
from paths import Case, cases, stretches
from rivals import stop_at_corners, topp3, toppra_slowed

from cnc_interp.feedrate.window import plan_path
from cnc_interp.kinematics.axis_path import AxisPath
from cnc_interp.kinematics.machine import Machine
from cnc_interp.units import MM

RESULTS = Path(__file__).with_name('RESULTS.md')


def line_path(length: float) -> AxisPath:
    """Make a stroke of the X axis alone, without programmed feed."""
    jet = np.zeros((4, 2, 5))
    jet[0, :, 0], jet[1, :, 0] = (0.0, length), 1.0
    return AxisPath(
        s=np.array([0.0, length]),
        cell_left=jet[:, :1].copy(),
        cell_right=jet[:, 1:].copy(),
        tip=jet[0, :, :3].copy(),
        axis=np.tile([0.0, 0.0, 1.0], (2, 1)),
        cell_feed=np.array([np.inf]),
        cell_block=np.array([0]),
        stop=np.array([True, True]),
    )


def closed_form() -> Iterator[str]:
    """Check planner and program against (32 L/J)^(1/3), a stroke on which jerk alone limits."""
    machine = Machine.load('xyzac')
    yield '| stroke of X | closed form s | optimum / closed form | planned / closed form |'
    yield '|---|---|---|---|'
    for length in (0.1 * MM, 1 * MM, 10 * MM):
        path = line_path(length)
        exact = (32 * length / machine.max_jerk[0]) ** (1 / 3)
        planned = plan_path(path, machine)
        best = solve(path, machine, planned)
        ratios = f'{best.time / exact:.5f} | {planned.law.end_time / exact:.5f}'
        yield f'| {length / MM:g} mm | {exact:.4f} | {ratios} |'


def optimum_of(case: Case, count: int = 500, slowed: float = 1.0) -> Optimum:
    """Solve every stretch between stops and add up."""
    found = [solve(part, case.limits, None, count, slowed) for part in stretches(case.path)]
    return Optimum(
        time=sum(each.time for each in found),
        excess=max(each.excess for each in found),
        converged=all(each.converged for each in found),
        cells=sum(each.cells for each in found),
        speed=np.concatenate([each.speed for each in found]),
    )


def compare(case: Case) -> tuple[str, float, list[float]]:
    """Compare all planners on one path; returns its table row, the ratio, and other figures."""
    planned = plan_path(case.path, case.limits)
    ours = planned.law.end_time - planned.law.time[0]
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        plan_path(case.path, case.limits)
        seconds.append(time.perf_counter() - start)
    computing = min(seconds)
    best = optimum_of(case)
    ratio = ours / best.time if best.converged else math.nan
    try:
        second = topp3(case.path, case.limits)
        other, slower = second.time / best.time, second.computing / computing
    except Exception as error:  # its solver's own exceptions: the table says that it gave up
        print(f'copp-py on {case.name}: {error}')
        other = slower = math.nan
    active = share_active(planned, case.limits)
    figures = [
        other,
        toppra_slowed(case.path, case.limits) / ours,
        stop_at_corners(case) / ours,
        ours / computing,
        slower,
        active,
        best.excess,
    ]
    row = (
        f'| {case.name} | {best.time:.4f} | {ratio:.4f} | {best.excess:.1e} | {other:.4f} '
        f'| {figures[1]:.1f} | {figures[2]:.2f} | {figures[3]:.0f} | {slower:.0f} | {active:.0%} |'
    )
    return row.replace('nan', '-'), ratio, figures


def comparison(quick: bool) -> Iterator[str]:
    """Compare on all paths; the table and what it comes to."""
    yield (
        '| path | optimum s | ours / optimum | largest excess of the optimum | TOPP3 / optimum '
        '| toppra slowed / ours | stop at corners / ours | motion / our planning time '
        '| TOPP3 / our planning time | limit active |'
    )
    yield '|---|' + '---|' * 9
    ratios, figures, kept = [], [], []
    for case in cases(quick):
        row, ratio, more = compare(case)
        yield row
        ratios.append(ratio)
        figures.append(more)
        kept.append(case)
    solved = np.array(ratios)[np.isfinite(ratios)]
    middle = np.nanmedian(np.array(figures), axis=0)
    yield ''
    yield f'* {len(ratios)} paths, {len(solved)} with a converged optimum.'
    yield (
        f'* **Cycle time / optimum: median {np.median(solved):.4f}, largest {solved.max():.4f}**, '
        f'smallest {solved.min():.4f}.'
    )
    yield (
        f'* Medians of the others: TOPP3 / optimum {middle[0]:.4f}, toppra slowed / ours '
        f'{middle[1]:.1f}, stop at corners / ours {middle[2]:.2f}, motion / planning time '
        f'{middle[3]:.0f}, TOPP3 / our planning time {middle[4]:.0f}, samples with an active '
        f'limit {middle[5]:.0%}.'
    )
    yield ''
    yield from trust(kept, ratios)


def trust(kept: list[Case], ratios: list[float]) -> Iterator[str]:
    """Solve the two worst paths on a finer grid and from a first guess half as fast."""
    worst = np.argsort(np.nan_to_num(ratios, nan=0.0))[::-1][:2]
    yield '| the two worst | ours / optimum | grid twice as fine | its excess | slow start |'
    yield '|---|---|---|---|---|'
    for i in worst:
        case = kept[i]
        ours = plan_path(case.path, case.limits).law.end_time
        fine, slow = optimum_of(case, count=1000), optimum_of(case, slowed=2.0)
        yield (
            f'| {case.name} | {ratios[i]:.4f} | {ours / fine.time:.4f}'
            f'{"" if fine.converged else " (not converged)"} | {fine.excess:.1e} '
            f'| {ours / slow.time:.4f}{"" if slow.converged else " (not converged)"} |'
        )


def growing(counts: tuple[int, ...], copp_counts: tuple[int, ...]) -> Iterator[str]:
    """Tabulate computing time over the number of blocks."""
    yield '| blocks | motion s | chain s | feed planning s | blocks/s | motion / feed planning |'
    yield '|---|---|---|---|---|---|'
    for count, spent in chain_growth(counts):
        whole = sum(spent.values()) - spent['motion']
        feed = spent['feedrate']
        yield (
            f'| {count:,} | {spent["motion"]:.1f} | {whole:.2f} | {feed:.2f} '
            f'| {count / whole:,.0f} | {spent["motion"] / feed:.0f} |'
        )
    yield ''
    yield '| blocks | copp-py TOPP3-SOCP, one round, s | its cycle time s |'
    yield '|---|---|---|'
    for count, seconds, lasts in topp3_growth(copp_counts, 60.0):
        yield f'| {count:,} | {seconds:.2f} | {lasts:.2f} |'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--quick', action='store_true', help='seven paths, short programs')
    parser.add_argument(
        '--million', action='store_true', help='programs of 10^5 and 10^6 blocks too'
    )
    options = parser.parse_args()
    counts = (1000, 10_000)
    if options.million:
        counts = (*counts, 100_000, 1_000_000)
    lines: list[str] = []

    def section(title: str, text: Iterator[str]) -> None:
        for line in (f'## {title}', ''):
            lines.append(line)
            print(line, flush=True)
        for line in text:
            lines.append(line)
            print(line, flush=True)
            if not options.quick:
                RESULTS.write_text('\n'.join(lines).rstrip() + '\n', encoding='utf-8')
        lines.append('')

    lines += [
        '# Results',
        '',
        'Made by `benchmarks/run.py` on one core of a 2-core container.',
        '',
    ]
    lines += ['What the columns mean: `README.md` in this folder.', '']
    section('The optimum against a closed form', closed_form())
    section('Cycle time', comparison(options.quick))
    section('Growth', growing(counts, (100, 300, 1000, 3000)))


if __name__ == '__main__':
    main()
