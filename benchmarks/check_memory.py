"""
Memory of `check` over the length of the motion.

    python benchmarks/check_memory.py [SETPOINTS ...] [--dense] [--compressed]

A 5-axis raster that ends where it begins is planned once. Its plan files are repeated until the
motion has about the requested number of setpoints of 1 ms (1, 5, 15 and 45 million), and checked.
The blocks of the raster are 10 mm long at F300. With --dense they are 0.4 mm long at F3000 and
planned as curves, so that program and path also grow with the motion. --compressed compresses the
plan files, as other writers may do. For each length a row shows setpoints, program rows, grid
points of the path, size of the plan files, and the largest memory, wall time and processor time of
`check`. 45 million setpoints need 8 GB of disk space.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
from numpy.typing import NDArray

LENGTHS = (1_000_000, 5_000_000, 15_000_000, 45_000_000)
#: Length of a block [mm], feed [mm/min] and number of blocks.
SPARSE, DENSE = (10.0, 300, 80), (0.4, 3000, 6000)
#: Rows of the raster: length, and distance between them [mm].
ROW, BESIDE = 100.0, 0.5
Columns = Mapping[str, NDArray[Any]]


def write_program(file: Path, step: float, feed: int, blocks: int) -> None:
    """Write a raster over a wave, tool axes within 20 deg of vertical, and the way back."""
    in_row, start = int(ROW / step), 'G0 X0 Y0 Z20 A10 C0\n'
    with file.open('w', encoding='ascii') as text:
        text.write(f'G21 G90 G94 F{feed}\nTRAORI\nG64 P0.02\n{start}')
        for k in range(blocks):
            row, along = divmod(k, in_row)
            x = step * (in_row - 1 - along if row % 2 else along)
            wave = abs(x % 40 - 20) / 20
            text.write(
                f'G1 X{x:.3f} Y{BESIDE * row:.3f} Z{3 * wave * wave:.4f} '
                f'A{10 + 5 * wave:.4f} C{20 * wave:.4f}\n'
            )
        text.write(f'G0 Z20\n{start}M30\n')


def columns_of(file: Path) -> Columns:
    """Return the columns of a file."""
    with np.load(file) as archive:
        return {name: archive[name] for name in archive.files}


def write(
    file: Path, columns: Columns, parts: Mapping[str, Iterable[NDArray[Any]]], method: int
) -> None:
    """Write columns of the shape and type of ``columns``, each from its parts."""
    with ZipFile(file, 'w', method, allowZip64=True) as archive:
        for name, column in columns.items():
            with archive.open(f'{name}.npy', 'w', force_zip64=True) as out:
                header = {
                    'descr': column.dtype.str,
                    'fortran_order': False,
                    'shape': column.shape,
                }
                np.lib.format.write_array_header_2_0(out, header)  # type: ignore[no-untyped-call]
                for part in parts[name]:
                    out.write(np.ascontiguousarray(part, dtype=column.dtype).tobytes())


def grown(column: NDArray[Any], shared: str, by: Any, times: int) -> Iterator[NDArray[Any]]:
    """Yield a column for each repetition, without its first or last row where both share it."""
    for k in range(times):
        first = 1 if shared == 'first' and k else 0
        last = len(column) - (shared == 'last' and k + 1 < times)
        yield column[first:last] if by is None else column[first:last] + k * by


def repeat(base: Path, plan: Path, times: int, method: int) -> tuple[int, int, int]:
    """Repeat a plan; return its numbers of setpoints, program rows and grid points."""
    plan.mkdir()
    setpoints, path, blocks = (
        columns_of(base / f'{name}.npz') for name in ('setpoints', 'path', 'blocks')
    )
    summary = json.loads((base / 'summary.json').read_text(encoding='utf-8'))
    rows, samples, period = (
        len(blocks['line']),
        len(setpoints['s']),
        summary['interpolation_period'],
    )
    # What a column grows by with each repetition. Where two meet, the program has the last row of
    # the first one, and the path the first point of the second one.
    more = {'block': rows - 1, 's': setpoints['s'][-1], 'time': samples * period}

    def repeated(columns: Columns, shared: str) -> int:
        shapes, parts = {}, {}
        for name, column in columns.items():
            along = int(name.startswith('cell'))
            shape = list(column.shape)
            both = bool(shared) and not along
            shape[along] = shape[along] * times - both * (times - 1)
            shapes[name] = np.broadcast_to(np.zeros(1, column.dtype), shape)
            if along:
                parts[name] = [lane for lane in column for _ in range(times)]
            else:
                parts[name] = grown(column, shared, more.get(name), times)
        file = {'time': 'setpoints', 'q': 'path', 'line': 'blocks'}
        write(
            plan / f'{next(v for k, v in file.items() if k in columns)}.npz', shapes, parts, method
        )
        return int(next(iter(shapes.values())).shape[0])

    counts = repeated(setpoints, ''), repeated(blocks, 'first'), repeated(path, 'last')
    of_motion = ('interpolation_period', 'flank_height', 'machine', 'program', 'settings')
    kept = {key: summary[key] for key in of_motion if key in summary}
    (plan / 'summary.json').write_text(json.dumps(kept), encoding='utf-8')
    return counts


def command(words: list[str]) -> tuple[float, float, float]:
    """Run a command; return its most memory [MB], its time and its processor time [s]."""
    started = time.monotonic()
    with subprocess.Popen(
        [sys.executable, '-m', 'cnc_interp', *words], stdout=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        said = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f'{said}\n{" ".join(words)}: exit code {child.returncode}')
    spent = usage.ru_utime + usage.ru_stime
    return usage.ru_maxrss / 1024, time.monotonic() - started, spent


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('setpoints', nargs='*', type=int, default=LENGTHS)
    parser.add_argument('--dense', action='store_true', help='blocks of 0.4 mm')
    parser.add_argument('--compressed', action='store_true', help='plan files are compressed')
    options = parser.parse_args()
    method = ZIP_DEFLATED if options.compressed else ZIP_STORED
    print('| setpoints | program rows | grid points | GB | most memory, MB | time, s | CPU, s |')
    print('|---|---|---|---|---|---|---|', flush=True)
    with tempfile.TemporaryDirectory() as name:
        program, base = Path(name) / 'raster.ngc', Path(name) / 'base'
        write_program(program, *(DENSE if options.dense else SPARSE))
        command(['plan', str(program), '--out', str(base)])
        with np.load(base / 'setpoints.npz') as archive:
            samples = len(archive['time'])
        for setpoints in options.setpoints:
            with tempfile.TemporaryDirectory() as folder:
                plan = Path(folder) / 'plan'
                counts = repeat(base, plan, max(1, round(setpoints / samples)), method)
                size = sum(file.stat().st_size for file in plan.iterdir()) / 1e9
                memory, seconds, spent = command(['check', str(plan)])
            figures = ' | '.join(f'{count:,}' for count in counts)
            print(f'| {figures} | {size:.2f} | {memory:.0f} | {seconds:.0f} | {spent:.0f} |')


if __name__ == '__main__':
    main()
