"""Run every benchmark whose figures the documentation cites, one after the other.

    PYTHONPATH=. python benchmarks/all.py            # hours; each with the options that its page
                                                     # cites
    PYTHONPATH=. python benchmarks/all.py --small    # minutes: those that need neither ROS nor
                                                     # public programs, with few samples
    PYTHONPATH=. python benchmarks/all.py nbuffer    # only the named ones

Each benchmark runs in its own process and prints its own table. A summary of exit codes and times
follows.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

HERE = Path(__file__).parent
#: Folders from which the scripts import.
FOLDERS = '.', 'benchmarks', 'test/ros', 'test/page', 'test/unit'


class Benchmark(NamedTuple):
    """A script, its words for the figures of a page, and those of a small run, if it has one."""

    script: str
    page: str  #: That cites it, below ``docs``.
    words: str = ''
    small: str | None = None


ALL = (
    Benchmark('run', 'measured/README.md'),
    Benchmark('problem_set', 'measured/README.md', '--laws'),
    Benchmark('bound', 'measured/README.md', '--programs 4000'),
    Benchmark('stops', 'how_it_works/feedrate.md'),
    Benchmark('loads', 'how_it_works/feedrate.md'),
    Benchmark('dense', 'how_it_works/dense_programs.md'),
    Benchmark('paper_corners', 'how_it_works/corner_rounding.md'),
    Benchmark('sharp_turns', 'how_it_works/corner_rounding.md'),
    Benchmark('pole', 'how_it_works/corner_rounding.md', '', ''),
    Benchmark('nasty_programs', 'how_it_works/corner_rounding.md', '', '--count 4'),
    Benchmark('pole_programs', 'measured/README.md', '--count 200', '--count 2 --machines xyzac'),
    Benchmark('rotary_words', 'measured/README.md', '--count 100', '--count 2 --machines xyzac'),
    Benchmark('tilted_planes', 'how_it_works/tilted_planes.md'),
    Benchmark('compensated_paths', 'operate/programs.md', '', '--count 3'),
    Benchmark('collision', 'measured/README.md', '--scenes 2400', '--scenes 3'),
    Benchmark('arms', 'how_it_works/arms.md', ''),
    Benchmark('nbuffer', 'how_it_works/cam.md', '--tiles'),
    Benchmark('compensation', 'measured/drives.md'),
    Benchmark('learnt', 'measured/drives.md'),
    Benchmark('geometric_errors', 'geometric_errors.md', '1000', '3'),
    Benchmark('tool_error', 'measured/drives.md', 'examples/s_path.apt examples/pyramid.ngc'),
    Benchmark('identified', 'measured/drives.md'),
    Benchmark('trajectory', 'measured/drives.md', 'examples/pyramid.ngc'),
    Benchmark('hal', 'measured/drives.md', '--stops'),
    Benchmark('batch', 'measured/batch.md'),
    Benchmark('batch_cluster', 'measured/batch.md'),
    Benchmark('parallel', 'measured/batch.md'),
    Benchmark('programs', 'measured/programs_table.md'),
    Benchmark('run_times', 'measured/README.md'),
    Benchmark(
        'random_programs', 'measured/README.md', '--proof 1 --periods 0.25 1 4', '--count 2'
    ),
    Benchmark('mutated_files', 'measured/README.md', '', '--count 5 --kinds machine setup'),
    Benchmark('mutated_programs', 'measured/README.md', '', '--count 5'),
    Benchmark('linuxcnc_words', 'measured/README.md', '--count 2000'),
    Benchmark('check_memory', 'measured/README.md', '45000000', '20000'),
    Benchmark('start', 'measured/README.md'),
    Benchmark('operation', 'measured/README.md'),
    Benchmark('jog', 'measured/README.md', '--minutes 10 --reactions 12 --seed 3'),
    Benchmark('losses', 'measured/losses.md'),
    Benchmark('long_run', 'measured/README.md', '--blocks 1000000 --feed 3400 --busy 2'),
    Benchmark('page_load', 'measured/README.md', '--seconds 30 --rounds 3'),
    Benchmark('cpu_share', 'measured/README.md', '--seconds 25 --run'),
    Benchmark('mtconnect', 'measured/README.md', '--minutes 25'),
)


def run(benchmark: Benchmark, small: bool) -> tuple[int, float]:
    """Run one; return its exit code and time."""
    words = (benchmark.small or '') if small else benchmark.words
    command = [sys.executable, str(HERE / f'{benchmark.script}.py'), *words.split()]
    print(f'\n== {" ".join(["benchmarks/" + benchmark.script + ".py", words])}', flush=True)
    path = os.pathsep.join(str(HERE.parent / name) for name in FOLDERS)
    begun = time.monotonic()
    code = subprocess.run(command, env={**os.environ, 'PYTHONPATH': path}).returncode
    return code, time.monotonic() - begun


def main() -> int:
    """Run all, or those that are named."""
    parser = argparse.ArgumentParser(
        description='Run the benchmarks that the documentation cites.'
    )
    parser.add_argument('names', nargs='*', metavar='NAME', help='some of them')
    parser.add_argument('--small', action='store_true', help='few samples; without ROS')
    options = parser.parse_args()
    chosen = [
        one
        for one in ALL
        if (not options.names or one.script in options.names)
        and (not options.small or one.small is not None)
    ]
    done = {one.script: run(one, options.small) for one in chosen}
    print()
    for name, (code, seconds) in done.items():
        print(f'{name:20s} {"done" if code == 0 else f"exit code {code}"}, {seconds:.0f} s')
    return int(any(code for code, _ in done.values()))


if __name__ == '__main__':
    sys.exit(main())
