"""
Programs over ROS, many times: underruns, memory, and the proof of what was executed.

    python benchmarks/live.py [--runs 10] [--period MS] PROGRAM[:MACHINE] ...

Every run is a `cnc-interp run --record` with the nodes as real processes; then `check` proves the
bag. "Memory" is the largest resident memory of any node, "least ready" the smallest buffered
motion, and "late" the largest lateness of the machine's clock in any run.
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

NODES = ('feedrate_node', 'lookahead_node', 'machine_node', 'program_node')


def memory_of_nodes() -> float:
    """Return the largest resident memory of any node that runs on this computer now [MB]."""
    most = 0.0
    for folder in Path('/proc').glob('[0-9]*'):
        try:
            if (folder / 'comm').read_text().strip() in NODES:
                found = re.search(r'VmHWM:\s+(\d+) kB', (folder / 'status').read_text())
                most = max(most, float(found[1]) / 1024 if found else 0.0)
        except OSError:
            continue  # it has ended meanwhile
    return most


class MemoryWatch:
    """Looks at the memory of the nodes twice a second, in a thread of its own."""

    def __init__(self) -> None:
        self.most = 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch)

    def _watch(self) -> None:
        while not self._end.wait(0.5):
            self.most = max(self.most, memory_of_nodes())

    def __enter__(self) -> MemoryWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()


def interp(*words: str) -> subprocess.CompletedProcess[str]:
    """Run a command of the package."""
    command = [sys.executable, '-m', 'cnc_interp', *words]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def main() -> None:
    """Print one row for each program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('programs', nargs='+')
    parser.add_argument('--runs', type=int, default=10)
    parser.add_argument('--period', default='1')
    options = parser.parse_args()
    print('| program | runs | to the end | proven | underruns | least ready, ms | memory, MB |')
    print('|---|---|---|---|---|---|---|')
    for word in options.programs:
        program, _, machine = word.partition(':')
        ended, proven, underruns, ready, memory = 0, 0, [], [], 0.0
        for _ in range(options.runs):
            with tempfile.TemporaryDirectory() as folder, MemoryWatch() as watch:
                bag = str(Path(folder) / 'bag')
                done = interp(
                    'run',
                    program,
                    '--machine',
                    machine or 'xyzac',
                    '--period',
                    options.period,
                    '--record',
                    bag,
                    '--json',
                )
                if done.returncode == 0:
                    ended += 1
                    told = json.loads(done.stdout)
                    underruns.append(told['starvations'])
                    ready.append(told['least_buffered_time'])
                else:
                    print(done.stdout, done.stderr[-400:])
                checked = interp('check', bag)
                proven += checked.returncode == 0
                if checked.returncode:
                    print(checked.stdout[-400:], checked.stderr[-400:])
            memory = max(memory, watch.most)
        print(
            f'| {Path(program).name} | {options.runs} | {ended} | {proven} | {underruns} | '
            f'{1e3 * min(ready, default=0.0):.0f} | {memory:.0f} |',
            flush=True,
        )


if __name__ == '__main__':
    main()
