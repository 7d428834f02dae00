"""
Kills processes that edit the setup of the machine at random moments; reads the file after each.

    python benchmarks/setup_kills.py [--kills 100] [--seed 1]

Each process writes the number of its edit into two offsets and a tool, as fast as the disk allows,
and tells each edit that has come back. After the kill the file must be whole: all three values of
one edit, the last one that was told or the one under way. The log must name it.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
from multiprocessing.connection import Connection
from pathlib import Path

from cnc_interp.core import MM
from cnc_interp.program.job import JobSetup, SetupChange, Tool
from cnc_interp.program.setup_table import SetupTable

#: Largest number of edits between two kills; they take milliseconds.
MOST = 40


def edit(file: Path, first: int, told: Connection) -> None:
    """Edit without end."""
    table = SetupTable(file)
    for k in range(first, sys.maxsize):
        position = {'X': k * MM, 'Y': -k * MM}
        changes = [SetupChange('work_offsets', position, name) for name in ('G54', 'G59.3')]
        table.apply([*changes, SetupChange('tools', Tool(k * MM, remark=f'{k}'), 1)], f'edit {k}')
        told.send(k)


def number_in(file: Path) -> int:
    """Return the number of the edit in the file; all of its values must be there."""
    setup = JobSetup.load(file)
    k = round(setup.tools[1].length / MM)
    wanted = {'X': k * MM, 'Y': -k * MM}
    for name in ('G54', 'G59.3'):
        found = setup.work_offsets[name]
        assert all(abs(found[letter] - wanted[letter]) < 1e-12 for letter in 'XY'), (k, found)
    assert setup.tools[1].remark == f'{k}'
    return k


def main() -> int:
    """Kill, read, count."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument('--kills', type=int, default=100)
    options.add_argument('--seed', type=int, default=1)
    given = options.parse_args()
    rng, before, during, last = random.Random(given.seed), 0, 0, 0
    start = multiprocessing.get_context('fork')
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'setup.yaml'
        for _ in range(given.kills):
            hear, told = start.Pipe(duplex=False)
            process = start.Process(target=edit, args=(file, last + 1, told))
            process.start()
            told.close()
            first = last + 1
            while last < first + rng.randrange(MOST):
                last = hear.recv()
            time.sleep(rng.uniform(0.0, 0.02))  # into the middle of an edit
            assert process.pid is not None
            os.kill(process.pid, signal.SIGKILL)
            process.join()
            try:
                while True:
                    last = hear.recv()
            except EOFError:
                pass
            found = number_in(file)
            assert found in (last, last + 1), (found, last)
            log = file.with_name('setup.yaml.log').read_text(encoding='utf-8').splitlines()
            assert any(f'\tedit {found}\t' in line for line in log[-2:]), log[-2:]
            before, during = before + (found == last), during + (found == last + 1)
            last = found
    print(f'{given.kills} kills in {last} edits: the file was whole {given.kills} times')
    print(f'  {before} times without the edit under way, {during} times with it')
    return 0


if __name__ == '__main__':
    sys.exit(main())
