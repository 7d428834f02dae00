"""`cnc-interp batch` and `sweep`: compare many programs, machines or option values in a table."""

import argparse
import math
import os
import shlex
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from cnc_interp.commands.parser import (
    FAILED,
    FINE,
    command,
    count,
    flag,
    option,
    positive,
    workers_option,
)
from cnc_interp.core import HOUR, MINUTE, InterpError
from cnc_interp.settings.command_line import add_settings, settings_from
from cnc_interp.settings.options import DEFAULT_MACHINE

GIGABYTE = 1e9


def add_batch_commands(commands: Any) -> None:
    command(
        commands,
        batch_command,
        'batch programs/ --machine xyzac xyzbc --out out/batch',
        option('programs', 'folders and files of programs', Path, 'PROGRAM', nargs='+'),
        option(
            '--machine',
            f'bundled machines or YAML files ({DEFAULT_MACHINE})',
            metavar='M',
            nargs='+',
            default=[DEFAULT_MACHINE],
        ),
        option(
            '--out',
            'folder for table, page and results; a second start continues from them',
            Path,
            'DIR',
            required=True,
        ),
        workers_option('programs that are planned at the same time'),
        option('--scheduler', 'let the workers of `cluster` plan instead', metavar='ADDRESS'),
        flag('--keep-plans', 'keep the plan files in all programs in DIR/plans'),
        option('--rate', 'cost of one hour of the machine', positive, 'COST'),
        option(
            '--memory',
            'largest memory of a worker (that of the computer, divided among the workers)',
            positive,
            'GB',
        ),
        option(
            '--longest',
            'longest planning time of a program (60 min)',
            positive,
            'MIN',
            default=60.0,
        ),
        add_settings,
        flag('--json', 'print the counts as JSON'),
    )
    command(
        commands,
        cluster_command,
        'cluster --host 192.168.1.10, and elsewhere cnc-interp cluster --join '
        'tcp://192.168.1.10:8786',
        option(
            '--join',
            'add workers to a running scheduler',
            metavar='ADDRESS',
        ),
        option(
            '--workers',
            'programs that are planned here at the same time, 0: a scheduler only (one for '
            'each processor)',
            int,
            'N',
            default=len(os.sched_getaffinity(0)),
        ),
        option(
            '--host',
            'address of the scheduler; whoever reaches it can run any code here (127.0.0.1)',
            default='127.0.0.1',
        ),
        option('--port', 'its port, 0 for any (8786)', int, default=8786),
        option('--dashboard', 'port of its page (8787)', int, 'PORT', default=8787),
    )


def batch_command(options: argparse.Namespace) -> int:
    """Plan and prove many programs on one or more machines; write one table and one page."""
    import json

    from cnc_interp.batch.batch_page import write_page, write_tables
    from cnc_interp.batch.batch_run import Progress, Store, run_batch, workers_of
    from cnc_interp.batch.task import Jobs, TaskOutcome, Verdict
    from cnc_interp.core.progress_bar import ProgressBar

    plans = options.out / 'plans' if options.keep_plans else None
    jobs = Jobs(options.programs, options.machine, settings_from(options), plans)
    memory = options.memory * GIGABYTE if options.memory else None
    longest = options.longest * MINUTE
    workers = workers_of(options.scheduler, options.workers, memory, longest)

    def tell(progress: Progress) -> None:
        known = f', {progress.known} known from an earlier start' if progress.known else ''
        if progress.done == progress.known:
            bar.start('planning', f'{progress.total} programs{known}')
        bar.show('planning', progress.share, f'{progress.done} of {progress.total}{known}')

    with ProgressBar(None if options.json else sys.stderr) as bar:
        store = Store(options.out / 'results', TaskOutcome.of_json)
        results = run_batch(jobs, workers, store, tell, options.workers)
    files = write_tables(results, options.rate, options.out)
    write_page(results, options.rate, options.out / 'batch.html')
    counts = Counter(outcome.row.verdict for _, outcome in results)
    total = sum(outcome.row.run_time for _, outcome in results)
    if options.json:
        print(json.dumps({str(verdict): counts[verdict] for verdict in Verdict}))
    else:
        told = ', '.join(f'{counts[verdict]} {verdict}' for verdict in Verdict if counts[verdict])
        print(f'programs       {len(results)}: {told}')
        print(
            f'cycle time     {total:.1f} s in all'
            + (f', cost {total * options.rate / HOUR:.2f}' if options.rate else '')
        )
        print(f'page           {options.out / "batch.html"}')
        print(f'tables         {", ".join(str(file) for file in files)}')
    return FINE if counts[Verdict.PROVEN] == len(results) else FAILED


def cluster_command(options: argparse.Namespace) -> int:
    """Plan batches on several computers: a scheduler and workers, or further workers."""
    from cnc_interp.batch.batch_run import dask_workers
    from cnc_interp.core import InterpError

    if options.workers < (1 if options.join else 0):
        raise InterpError('--workers must be 1 or more')
    cluster = dask_workers()

    def say(text: str) -> None:
        print(text, flush=True)

    if options.join:
        cluster.join(options.join, options.workers, say)
    else:
        cluster.serve(options.host, options.port, options.dashboard, options.workers, say)
    return FINE


FAULTS = 5  #: Largest number of printed reasons why points have no motion; the page lists all.


def add_sweep_command(commands: Any, main: Callable[[Sequence[str]], int]) -> None:
    sweep = command(
        commands,
        sweep_command,
        'sweep --vary place-x -50 0 50 --vary ratio 1.5 2 --out out/sweep -- plan part.ngc',
        option(
            '--vary',
            'an option of the command, without its dashes, and its values; with --search its '
            'lowest and highest value',
            metavar=('OPTION', 'VALUE'),
            nargs='+',
            action='append',
            required=True,
        ),
        option(
            '--search', 'search with at most N points, instead of all combinations', count, 'N'
        ),
        option('--out', 'folder to write', Path, 'DIR', required=True),
        workers_option('commands that run at the same time'),
        option('words', 'after --: the command, without --out', metavar='COMMAND', nargs='*'),
    )
    sweep.set_defaults(main=main, commands=commands)


def sweep_command(options: argparse.Namespace) -> int:
    """Try many values of options of `plan` or `cam iso-scallop`; report the fastest and why."""
    from cnc_interp.batch import sweep as points
    from cnc_interp.batch.processes import Processes, total_memory
    from cnc_interp.core.progress_bar import ProgressBar

    ranges = [_range(words, options.search is not None) for words in options.vary]
    _check_options(options.commands, options.words, ranges)
    total = 1 + (options.search or math.prod(len(one.values) for one in ranges))
    workers, begun = Processes(options.workers, total_memory() / options.workers, HOUR), False

    def tell(done: int, known: int) -> None:
        nonlocal begun
        before = f', {known} known from an earlier start' if known else ''
        if not begun:
            begun = True
            bar.start('sweeping', f'{total} points{before}')
        share = min(1.0, done / max(1, total - known))
        bar.show('sweeping', share, f'{done + known} of {total}{before}')

    sweep = points.Sweep(
        options.main,
        options.words,
        options.out,
        workers,
        tell,
    )
    with ProgressBar(sys.stderr) as bar:
        if options.search:
            sweep.search(ranges, options.search)
        else:
            sweep.grid(ranges)
    points.write_table(sweep.found, options.out / 'sweep.csv')
    points.write_page(sweep.found, options.out / 'sweep.html')
    best = points.front(sweep.found)
    idle = [one.option for one in ranges if points.without_effect(sweep.found, one.option)]
    if len(idle) == len(ranges):
        best = []
    moves = sum(one.cycle_time is not None for one in sweep.found.values())
    print(f'points         {len(sweep.found)}, {moves} of them give a motion')
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
        return  # the sweep reports the mistake
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
