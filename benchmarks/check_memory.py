"""
Most memory of `plan` and `check` over the length of the motion.

    python benchmarks/check_memory.py [SETPOINTS ...] [--dense]

A 5-axis raster is planned and checked until the motion has about so many setpoints of 1 ms
(1, 5, 15 and 45 million). Its blocks are 10 mm long at F300; with --dense they are 0.4 mm long at
F3000 and run as curves, so program and path grow with the motion, too. Prints a row for each
length: setpoints, program rows, grid points of the path, size of the plan files, and for both
commands the most memory that their process held, and their time. 45 million setpoints need 13 GB
on the disk.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from zipfile import ZipFile

import numpy as np

LENGTHS = (1_000_000, 5_000_000, 15_000_000, 45_000_000)
#: Length of a block [mm], feed [mm/min] and setpoints for each block.
SPARSE, DENSE = (10.0, 300, 1850.0), (0.4, 3000, 13.4)
#: Rows of the raster: length, and distance between them [mm].
ROW, BESIDE = 100.0, 0.5


def write_program(file: Path, blocks: int, step: float, feed: int) -> None:
    """Write a raster over a wave, tool axes within 20 deg of vertical."""
    in_row = int(ROW / step)
    with file.open('w', encoding='ascii') as text:
        text.write(f'G21 G90 G94 F{feed}\nTRAORI\nG64 P0.02\nG0 X0 Y0 Z20 A10 C0\n')
        for k in range(blocks):
            row, along = divmod(k, in_row)
            x = step * (in_row - 1 - along if row % 2 else along)
            wave = abs(x % 40 - 20) / 20
            text.write(
                f'G1 X{x:.3f} Y{BESIDE * (row % 200):.3f} Z{3 * wave * wave:.4f} '
                f'A{10 + 5 * wave:.4f} C{20 * wave:.4f}\n'
            )
        text.write('M30\n')


def most_memory(words: list[str]) -> tuple[float, float]:
    """Run a command; return the most memory of its process [MB] and its time [s]."""
    started = time.monotonic()
    with subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', *words], stdout=subprocess.DEVNULL
    ) as child:
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f'{" ".join(words)}: exit code {child.returncode}')
    return usage.ru_maxrss / 1024, time.monotonic() - started


def rows_in(file: Path, column: str) -> int:
    """Return the number of rows of a column."""
    with ZipFile(file) as archive, archive.open(f'{column}.npy') as content:
        np.lib.format.read_magic(content)  # type: ignore[no-untyped-call]
        shape = np.lib.format.read_array_header_2_0(content)[0]  # type: ignore[no-untyped-call]
    return int(shape[0])


def measure(setpoints: int, dense: bool, folder: Path) -> str:
    """Plan and check a motion of about so many setpoints; return a row of the table."""
    step, feed, each = DENSE if dense else SPARSE
    program, plan = folder / 'raster.ngc', folder / 'plan'
    write_program(program, round(setpoints / each), step, feed)
    planned, planning = most_memory(['plan', str(program), '--out', str(plan)])
    checked, checking = most_memory(['check', str(plan)])
    summary = json.loads((plan / 'summary.json').read_text(encoding='utf-8'))
    size = sum(file.stat().st_size for file in plan.iterdir()) / 1e9
    return (
        f'| {summary["samples"]:,} | {rows_in(plan / "blocks.npz", "line"):,} '
        f'| {rows_in(plan / "path.npz", "s"):,} | {size:.2f} | {planned:.0f} | {planning:.0f} '
        f'| {checked:.0f} | {checking:.0f} |'
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('setpoints', nargs='*', type=int, default=LENGTHS)
    parser.add_argument('--dense', action='store_true', help='blocks of 0.4 mm')
    options = parser.parse_args()
    print('| setpoints | rows | grid points | GB | plan, MB | plan, s | check, MB | check, s |')
    print('|---|---|---|---|---|---|---|---|', flush=True)
    for setpoints in options.setpoints:
        with tempfile.TemporaryDirectory() as folder:
            print(measure(setpoints, options.dense, Path(folder)), flush=True)


if __name__ == '__main__':
    main()
