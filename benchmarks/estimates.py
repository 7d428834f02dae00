"""
The time left that `plan` tells, against the time that it then took.

    PYTHONPATH=. python benchmarks/estimates.py [LINES]

Public programs are planned, long ones up to LINES lines (50,000). "Total" is the time so far and
the time left that is told, over the time in the end, after the first tenth of the work. All times
are CPU times of the one process.
"""

from __future__ import annotations

import sys
import time
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from programs import CASES, program_file

from cnc_interp.core.progress_bar import TimeLeft
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import open_program
from cnc_interp.run.chain import plan_to_files
from cnc_interp.settings.options import Settings

NAMES = 'linuxcnc-impeller-xyzac', 'qtpyvcp-bezel', 'linuxcnc-stellabee', 'pycam-sample'
#: Smallest part of the work after which estimates count [-].
FROM = 0.1


def row_of(name: str, lines: int, folder: Path) -> str:
    """Plan a program and return the row of the table."""
    machine, settings = Machine.load(CASES[name].machine), Settings()
    program = folder / program_file(name).name
    with program_file(name).open() as text, program.open('w') as part:
        part.writelines(islice(text, lines))
    estimate, told = TimeLeft(), []

    def note(share: float) -> None:
        now = time.process_time()
        left = estimate.after(now, share)
        if share >= FROM and left == left:
            told.append((now, left))

    begun = time.process_time()
    stream = open_program(program, Transform.of(machine), settings)
    plan_to_files(stream, machine, folder / name, settings, note)
    total = time.process_time() - begun
    of_total = np.array([(now - begun + left) / total for now, left in told])
    near = np.mean(np.abs(of_total - 1.0) <= 0.2)
    return (
        f'{name:<28}{total:>8.1f}{len(told):>10}{np.min(of_total):>10.2f}'
        f'{np.median(of_total):>10.2f}{np.max(of_total):>10.2f}{near:>14.0%}'
    )


def main() -> int:
    """Print one line for each program."""
    lines = int(sys.argv[1]) if len(sys.argv) > 1 else 50_000
    heads = 'CPU s', 'estimates', 'least', 'median', 'largest', 'within 20 %'
    print(
        f'{"program":<28}{heads[0]:>8}'
        + ''.join(f'{h:>10}' for h in heads[1:5])
        + f'{heads[5]:>14}'
    )
    with TemporaryDirectory() as folder:
        for name in NAMES:
            print(row_of(name, lines, Path(folder)), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
