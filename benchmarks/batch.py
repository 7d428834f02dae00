"""
A batch of all public programs on five machines: wall time, efficiency, and equal tables.

    python benchmarks/batch.py [--programs DIR] [--machines M ...] [--skip NAME ...]
    python benchmarks/batch.py --small N
    python benchmarks/batch.py --beside PROGRAM

The same tasks run in three batches: with one worker, with two workers, and with two workers of
which one is killed every five seconds. Printed are wall times, the processor time of all workers,
the efficiency of two workers (time with one worker divided by twice the time with two), and
whether the tables are equal byte for byte. ``--small N`` runs N small programs and prints the time
of each, and the memory of the main process halfway and at its largest. ``--beside PROGRAM`` runs
this program over ROS beside a batch with two workers, and prints its setpoints, underruns and the
least buffered motion.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
PUBLIC = ROOT.parent / 'shared' / 'programs'
MACHINES = ('xyzac', 'xyzbc', 'xyzac_trt', 'head_head', 'vmc')
KILL_EVERY = 5.0
LINE = 'G21 G90 G94 F3000\nTRAORI\nG0 X0 Y0 Z0 A10 C0\n{}\nM30\n'


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split('\n\n')[0])
    parser.add_argument('--programs', type=Path, default=PUBLIC)
    parser.add_argument('--machines', nargs='+', default=MACHINES)
    parser.add_argument('--small', type=int, default=0, metavar='N')
    parser.add_argument('--skip', nargs='*', default=(), help='programs that are left out')
    parser.add_argument('--beside', type=Path, metavar='PROGRAM')
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if options.beside:
            beside(options.beside, Path(folder))
        elif options.small:
            grow(Path(folder), options.small)
        else:
            compare(options, Path(folder))


def compare(options: argparse.Namespace, folder: Path) -> None:
    """Run the same batch three times."""
    programs = [p for p in sorted(options.programs.rglob('*')) if wanted(p, options.skip)]
    hashes = []
    alone = 0.0
    for name, workers, kills in (('one', 1, False), ('two', 2, False), ('killed', 2, True)):
        out = folder / name
        began = time.monotonic()
        count = run(programs, options.machines, out, workers, kills)
        took = time.monotonic() - began
        alone = alone or took
        table = (out / 'table.csv').read_bytes()
        hashes.append(hashlib.sha256(table).hexdigest()[:16])
        rows = list(csv.DictReader((out / 'table.csv').open()))
        costs = list(csv.DictReader((out / 'costs.csv').open()))
        seconds = [float(row['seconds']) for row in costs]
        verdicts = {v: sum(r['verdict'] == v for r in rows) for v in {r['verdict'] for r in rows}}
        print(
            f'{name:<7} {took:7.1f} s, {len(rows)} tasks {verdicts}, '
            f'processor {sum(float(row["processor_s"]) for row in costs):.1f} s, longest '
            f'{max(seconds):.1f} s, {count} kills, table {hashes[-1]}'
        )
        if name == 'two':
            print(f'        efficiency of two workers {alone / took / 2:.1%}')
    print('tables are equal' if len(set(hashes)) == 1 else 'TABLES DIFFER')


def wanted(path: Path, skip: tuple[str, ...]) -> bool:
    """Tell whether a file is a program that is not left out."""
    return path.is_file() and path.name != 'SOURCE' and not any(s in str(path) for s in skip)


def run(programs: list[Path], machines: list[str], out: Path, workers: int, kills: bool) -> int:
    """Run one batch; return the number of kills."""
    words = [sys.executable, '-m', 'cnc_interp', 'batch', *map(str, programs)]
    words += ['--machine', *machines, '--out', str(out), '--workers', str(workers)]
    words += ['--feed', '1000']
    process = subprocess.Popen(words, stdout=subprocess.DEVNULL, cwd=ROOT)
    killed = 0
    chance = random.Random(1)
    while True:
        try:
            process.wait(KILL_EVERY)
            return killed
        except subprocess.TimeoutExpired:
            found = workers_of(process.pid)
            if kills and found:
                os.kill(chance.choice(found), signal.SIGKILL)
                killed += 1


def workers_of(command: int) -> list[int]:
    """Return the processes that work for a command, children of its fork server."""
    parents = {}
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            name, _, rest = path.read_text().partition('(')[2].rpartition(')')
            parents[int(path.parent.name)] = name, int(rest.split()[1])
        except OSError:
            continue
    return [
        process
        for process, (name, parent) in parents.items()
        if name == 'cnc_batch' and parents.get(parent, ('', 0))[1] == command
    ]


def small_programs(folder: Path, count: int) -> Path:
    """Write programs of 20 random lines; return their folder."""
    programs = folder / 'programs'
    programs.mkdir()
    for k in range(count):
        chance = random.Random(k)
        points = '\n'.join(
            f'G1 X{chance.uniform(-20, 20):.3f} Y{chance.uniform(-20, 20):.3f}' for _ in range(20)
        )
        (programs / f'{k:05d}.ngc').write_text(LINE.format(points))
    return programs


def beside(program: Path, folder: Path) -> None:
    """Run a program over ROS while a batch goes on."""
    programs = small_programs(folder, 10_000)
    interp = [sys.executable, '-m', 'cnc_interp']
    batch = [*interp, 'batch', str(programs), '--out', str(folder / 'out'), '--workers', '2']
    with (folder / 'batch.txt').open('wb') as output:
        going = subprocess.Popen(batch, stdout=output, stderr=output, cwd=ROOT)
        try:
            while not list((folder / 'out').glob('results/[0-9a-f]*.json')):
                time.sleep(0.5)
            words = [*interp, 'run', str(program), '--json']
            done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
        finally:
            planned = len(list((folder / 'out').glob('results/[0-9a-f]*.json')))
            going.send_signal(signal.SIGINT)
            going.wait()
    result = json.loads(done.stdout)
    print(
        f'{program.name}: {result["samples"]} setpoints, {result["starvations"]} underruns, '
        f'buffer never below {1e3 * result["least_buffered_time"]:.0f} ms; the batch has planned '
        f'{planned} programs meanwhile'
    )


def grow(folder: Path, count: int) -> None:
    """Plan many small programs, and follow the memory of the command."""
    programs = small_programs(folder, count)
    words = [sys.executable, '-m', 'cnc_interp', 'batch', str(programs), '--out']
    began = time.monotonic()
    process = subprocess.Popen([*words, str(folder / 'out')], stdout=subprocess.DEVNULL, cwd=ROOT)
    seen: list[int] = []

    def watch() -> None:
        while process.poll() is None:
            for line in Path(f'/proc/{process.pid}/status').read_text().splitlines():
                if line.startswith('VmRSS'):
                    seen.append(int(line.split()[1]))
            time.sleep(1.0)

    thread = threading.Thread(target=watch)
    thread.start()
    process.wait()
    thread.join()
    took = time.monotonic() - began
    half = seen[len(seen) // 2] / 1e3
    print(
        f'{count} programs of 20 blocks: {took:.0f} s, {1e3 * took / count:.1f} ms each; memory '
        f'of the command {half:.0f} MB in the middle, {max(seen) / 1e3:.0f} MB at most'
    )


if __name__ == '__main__':
    main()
