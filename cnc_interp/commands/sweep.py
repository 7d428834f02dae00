"""`cnc-interp sweep`: a command with many values of its options; the fastest, and why."""

import argparse
import math
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import FAILED, FINE, command, count
from cnc_interp.core import HOUR, InterpError

FAULTS = 5  #: Most reasons why points do not move that are printed; the page has all.


def add_sweep_command(commands: Any, main: Callable[[Sequence[str]], int]) -> None:
    sweep = command(
        commands, 'sweep', lambda options: sweep_command(options, main, commands),
        'try many values of the options of `plan` or `cam iso-scallop`; tells the fastest and why',
        'cnc-interp sweep --vary place-x -50 0 50 --vary ratio 1.5 2 --out out/sweep -- plan '
        'part.ngc',
    )  # fmt: skip
    sweep.add_argument(
        '--vary', nargs='+', action='append', required=True, metavar=('OPTION', 'VALUE'),
        help='an option of the command, without its dashes, and its values; with --search the '
        'lowest and the highest',
    )  # fmt: skip
    text = 'search with at most N points, instead of all combinations'
    sweep.option('--search', text, count, 'N')
    sweep.option('--out', 'folder to write', Path, 'DIR', required=True)
    sweep.workers_option('commands that run at the same time')
    sweep.option('words', 'after --: the command, without --out', metavar='COMMAND', nargs='*')


def sweep_command(
    options: argparse.Namespace, main: Callable[[Sequence[str]], int], commands: Any
) -> int:
    from cnc_interp.batch import sweep as points
    from cnc_interp.batch.processes import Processes, total_memory
    from cnc_interp.core.progress_bar import ProgressBar

    ranges = [_range(words, options.search is not None) for words in options.vary]
    _check_options(commands, options.words, ranges)
    total = 1 + (options.search or math.prod(len(one.values) for one in ranges))
    bar = ProgressBar(sys.stderr)
    workers = Processes(options.workers, total_memory() / options.workers, HOUR)
    sweep = points.Sweep(
        main, options.words, options.out, workers,
        lambda done: bar.show('sweeping', min(1.0, done / total), f'{done} points'),
    )  # fmt: skip
    try:
        if options.search:
            sweep.search(ranges, options.search)
        else:
            sweep.grid(ranges)
    finally:
        bar.end(complete=False)
    points.write_table(sweep.found, options.out / 'sweep.csv')
    points.write_page(sweep.found, options.out / 'sweep.html')
    best = points.front(sweep.found)
    idle = [one.option for one in ranges if points.without_effect(sweep.found, one.option)]
    if len(idle) == len(ranges):
        best = []
    moves = sum(one.cycle_time is not None for one in sweep.found.values())
    print(f'points         {len(sweep.found)}, {moves} of them move')
    faults = Counter(one.fault for one in sweep.found.values() if one.fault)
    for fault, times in faults.most_common(FAULTS):
        print(f'no motion      {fault}{f" ({times} points)" if times > 1 else ""}')
    as_it_is = points.as_it_is(sweep.found)
    for title, point in (('as it is', as_it_is), *(('fastest', p) for p in best[:1])):
        one = sweep.found[point]
        if one.cycle_time is None:
            print(f'{title:<15}{one.fault}')
            continue
        told = [f'{one.cycle_time:.3f} s', points.lengths_text(one)]
        text = ', '.join(text for text in told if text)
        print(f'{title:<15}{text}; at a limit: {points.why(one)}')
    for name in idle:
        print(f'no effect      --{name}: all its values give the same motion, none is the best')
    if best:
        print(f'command        cnc-interp {shlex.join(best[0].command)}')
        print(f'files          {sweep.keep(best[0])}')
    print(f'page           {options.out / "sweep.html"}')
    return FINE if moves else FAILED


def _check_options(commands: Any, words: Sequence[str], ranges: Sequence[Any]) -> None:
    from cnc_interp.batch.sweep import SWEPT

    known = next((swept for swept in SWEPT if tuple(words[: len(swept)]) == swept), None)
    if known is None:
        return  # told by the sweep
    parser = commands.choices[known[0]]
    for word in known[1:]:
        parser = parser.of(word)
    for one in ranges:
        if fault := parser.unknown_option(f'--{one.option}'):
            raise InterpError(f'{parser.prog}: {fault}'.removeprefix('cnc-interp '))


def _range(words: Sequence[str], search: bool) -> Any:
    from cnc_interp.batch.sweep import Range

    name, *values = words
    name = name.lstrip('-')
    if not values:
        raise InterpError(f'--vary {name}: give values')
    if search:
        try:
            low, high = (float(value) for value in values)
        except ValueError:
            low, high = 1.0, 0.0
        if not low < high:
            raise InterpError(f'--vary {name}: a search needs the lowest and the highest value')
    return Range(name, tuple(values))
