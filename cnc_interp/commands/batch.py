"""`cnc-interp batch`: many programs on many machines, planned and proven; one table, one page."""

import argparse
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from cnc_interp.commands import parser
from cnc_interp.core import HOUR, MINUTE
from cnc_interp.settings.command_line import add_settings, settings_from
from cnc_interp.settings.options import DEFAULT_MACHINE

GIGABYTE = 1e9


def add_batch_commands(commands: Any) -> None:
    batch = parser.command(
        commands, 'batch', batch_command,
        'plan and prove many programs on one or more machines; writes one table and one page',
        'cnc-interp batch programs/ --machine xyzac xyzbc --out out/batch',
    )  # fmt: skip
    batch.option('programs', 'folders and files of programs', Path, 'PROGRAM', nargs='+')
    text = f'bundled machines or YAML files ({DEFAULT_MACHINE})'
    batch.add_argument('--machine', nargs='+', default=[DEFAULT_MACHINE], metavar='M', help=text)
    text = 'folder for table, page and results; a second start goes on from them'
    batch.add_argument('--out', type=Path, metavar='DIR', required=True, help=text)
    batch.workers_option('programs that are planned at the same time')
    batch.option('--scheduler', 'let the workers of `cluster` plan instead', metavar='ADDRESS')
    batch.flag('--keep-plans', 'keep the plan files of all, in DIR/plans')
    batch.option('--rate', 'what an hour of the machine costs', parser.positive, 'COST')
    text = 'most memory of a worker (that of the computer, shared among them)'
    batch.option('--memory', text, parser.positive, 'GB')
    text = 'longest planning time of a program (60 min)'
    batch.option('--longest', text, parser.positive, 'MIN', default=60.0)
    add_settings(batch)
    batch.flag('--json', 'print the counts as JSON')

    cluster = parser.command(
        commands, 'cluster', cluster_command,
        'plan batches on several computers: a scheduler and workers, or further workers',
        'cnc-interp cluster --host 192.168.1.10, and elsewhere cnc-interp cluster --join '
        'tcp://192.168.1.10:8786',
    )  # fmt: skip
    cluster.option('--join', 'work for the scheduler there, start none here', metavar='ADDRESS')
    cluster.option(
        '--workers',
        'programs that are planned here at the same time, 0: a scheduler only (one for '
        'each processor)', int, 'N', default=len(os.sched_getaffinity(0)),
    )  # fmt: skip
    text = 'address of the scheduler; whoever reaches it can run any code here (127.0.0.1)'
    cluster.add_argument('--host', default='127.0.0.1', help=text)
    cluster.option('--port', 'its port, 0 for any (8786)', int, default=8786)
    cluster.option('--dashboard', 'port of its page (8787)', int, 'PORT', default=8787)


def batch_command(options: argparse.Namespace) -> int:
    import json

    from cnc_interp.batch.batch_page import write_page, write_tables
    from cnc_interp.batch.batch_run import Progress, Store, run_batch, workers_of
    from cnc_interp.batch.task import Jobs, Verdict
    from cnc_interp.core.progress_bar import ProgressBar

    plans = options.out / 'plans' if options.keep_plans else None
    jobs = Jobs(options.programs, options.machine, settings_from(options), plans)
    memory = options.memory * GIGABYTE if options.memory else None
    longest = options.longest * MINUTE
    workers = workers_of(options.scheduler, options.workers, memory, longest)
    bar = ProgressBar(None if options.json else sys.stderr)

    def tell(progress: Progress) -> None:
        known = f', {progress.known} known before' if progress.known else ''
        bar.show('planning', progress.share, f'{progress.done} of {progress.total}{known}')

    try:
        store = Store(options.out / 'results')
        results = run_batch(jobs, workers, store, tell, options.workers)
    finally:
        bar.end(complete=False)
    files = write_tables(results, options.rate, options.out)
    write_page(results, options.rate, options.out / 'batch.html')
    counts = Counter(outcome.row.verdict for _, outcome in results)
    total = sum(outcome.row.run_time for _, outcome in results)
    if options.json:
        print(json.dumps({str(verdict): counts[verdict] for verdict in Verdict}))
    else:
        told = ', '.join(f'{counts[verdict]} {verdict}' for verdict in Verdict if counts[verdict])
        print(f'programs       {len(results)}: {told}')
        print(f'cycle time     {total:.1f} s of all'
              + (f', cost {total * options.rate / HOUR:.2f}' if options.rate else ''))  # fmt: skip
        print(f'page           {options.out / "batch.html"}')
        print(f'tables         {", ".join(str(file) for file in files)}')
    return parser.FINE if counts[Verdict.PROVEN] == len(results) else parser.FAILED


def cluster_command(options: argparse.Namespace) -> int:
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
    return parser.FINE
