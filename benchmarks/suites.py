"""
Other people's programs as judges of the reader: LinuxCNC's interpreter tests, and Sinumerik's.

``PYTHONPATH=. python benchmarks/suites.py ../shared/suites`` reads every program of both suites
and prints a table: motions as expected, refused as expected, refused although it runs, accepted
although it is refused, or other motions. ``--all`` prints every case.
"""

from __future__ import annotations

import argparse
import csv
import importlib.util
import json
import re
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np

from cnc_interp.core import INCH, MM, InterpError
from cnc_interp.machine_model.machine import Machine
from cnc_interp.machine_model.transform import Transform
from cnc_interp.program import Blocks, JobSetup, Tool, read_program
from cnc_interp.program.job import WORK_OFFSETS
from cnc_interp.run.plan_writer import block_columns
from cnc_interp.settings.options import Settings

AGREES, MUST, REFUSED, ACCEPTED, WRONG, EMPTY = (
    'agrees', 'refused as it must be', 'refused, but runs', 'ACCEPTED, but is refused', 'WRONG',
    'no motion in it',
)  # fmt: skip
#: Positions of the Sinumerik suite agree within this [mm].
NEAR = 2e-3
#: Cases that are not as expected, with the reason.
EXCEPTIONS = {
    'ccomp-lathe-comp': 'lathe tools with an orientation, which a setup does not have',
    'crazy-paths': 'a contour that crosses itself: the cutter does not fit',
    'g72-missing-iteration': 'a cycle of lathes',
    **dict.fromkeys(
        (f'g84-g{plane}-g{level}' for plane in (18, 19) for level in (98, 99)),
        'LinuxCNC taps along the wrong axis',
    ),
    'oword-unwind': 'it ends with an error on LinuxCNC, too',
    'custom_vars': 'a variable that is set nowhere',
    'edge_cases': 'an axis ELX, which no machine here has',
    'simple': 'G2 without a centre',
}
AT_ZERO = {name: dict.fromkeys('XYZAC', 0.0) for name in WORK_OFFSETS}


def read(path: Path, machine: str, tools: dict[int, Tool], feed: float | None) -> Blocks:
    """Read a program on a machine whose zeros are all in one point."""
    plain = Machine.load(machine)
    plain = replace(plain, offsets=np.zeros_like(plain.offsets))
    settings = Settings(feedrate=feed)
    return read_program(path, Transform.of(plain), settings, JobSetup(AT_ZERO, tools)).blocks


def tools_of(table: Path) -> dict[int, Tool]:
    """
    Return a tool table of LinuxCNC in inches.

    Tools of a lathe are left out: Q1 to Q8 say beside which place of its nose the tool is
    measured, and G41 and G42 lead that place. No setup can hold it.
    """
    found = {}
    for line in table.read_text().splitlines() if table.exists() else ():
        word = dict(re.findall(r'([TZDQ])(-?[\d.]+)', line.split(';')[0].upper()))
        if 1 <= int(word.get('Q', 0)) <= 8:
            continue
        length, across = (float(word.get(letter, 0.0)) * INCH for letter in 'ZD')
        found[int(word['T'])] = Tool(length, across / 2.0)
    return found


def loaded(path: Path) -> ModuleType:
    """Return a script as a module."""
    spec = importlib.util.spec_from_file_location('judge', path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def linuxcnc(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield case, verdict and reason for LinuxCNC's own tests."""
    judge = loaded(folder / 'judge.py')
    for case in json.loads((folder / 'cases.json').read_text())['cases']:
        here = folder / 'cases' / case['id']
        program = here / 'program.ngc'
        text = re.sub(r'\(.*?\)|;.*', '', program.read_text(errors='replace')).upper()
        axes = 'AC' if re.search(r'\b[AC]\s*[-#\[\d]|\bA\s*EXISTS', text) else ''
        runs = case['outcome'] == 'reads'
        try:
            machine = 'xyzac' if axes else 'xyz'
            blocks = read(program, machine, tools_of(here / 'test.tbl'), None)
        except InterpError as problem:
            why = str(problem).splitlines()[0].split('program.ngc:')[-1]
            if 'no motion found' in why and runs:
                yield case['id'], AGREES if not case['motions'] else WRONG, EMPTY
            else:
                yield case['id'], REFUSED if runs else MUST, why
            continue
        if not runs:
            yield case['id'], ACCEPTED, case['error']
            continue
        columns = block_columns(blocks)
        faults, count = judge.compare((here / 'expected').read_text(), columns, axes)
        yield case['id'], WRONG if faults else AGREES, (faults or [f'{count} motions'])[0]


def sinumerik(folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield case, verdict and reason for the Sinumerik programs: their X, Y, Z in order."""
    for program in sorted((folder / 'cases').glob('*.mpf')):
        with program.with_suffix('.csv').open() as table:
            rows = list(csv.DictReader(table))
        places = []
        at = np.zeros(3)
        for row in rows:
            at = np.array([float(row.get(n) or v) for n, v in zip('XYZ', at, strict=True)])
            places.append(at)
        wanted = [p for i, p in enumerate(places) if not i or (p != places[i - 1]).any()]
        named = {n for n in 'ABC' if any(row.get(n) for row in rows)}
        machine = {'': 'xyz', 'A': 'xyza'}.get(''.join(sorted(named)), 'xyzac')
        try:
            blocks = read(program, machine, {}, 1000.0 * MM / 60.0)
        except InterpError as problem:
            why = str(problem).splitlines()[0].split('.mpf:')[-1]
            if len(wanted) < 2 and 'no motion found' in why:
                yield program.stem, AGREES, EMPTY
            else:
                yield program.stem, REFUSED, why
            continue
        tips = block_columns(blocks)['tip'] / MM
        row, missing = 0, None
        for place in wanted:
            while row < len(tips) and np.abs(tips[row] - place).max() > NEAR:
                row += 1
            if row == len(tips):
                if place.any() or missing is not None:  # the first row may stand before all motion
                    missing = place
                    break
                row = 0
        if missing is None and np.abs(tips[-1] - wanted[-1]).max() > NEAR:
            missing = tips[-1]
        reason = f'{len(wanted)} places' if missing is None else f'{missing} is not reached'
        yield program.stem, AGREES if missing is None else WRONG, reason


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path)
    parser.add_argument('--all', action='store_true', help='print every case')
    arguments = parser.parse_args()
    for name, cases in (('linuxcnc-interp', linuxcnc), ('cead-sinumerik', sinumerik)):
        found = list(cases(arguments.folder / name))
        print(f'\n{name}: {len(found)} cases')
        for verdict, count in Counter(verdict for _, verdict, _ in found).most_common():
            print(f'  {count:3d}  {verdict}')
        for case, verdict, why in found:
            if arguments.all or verdict not in (AGREES, MUST):
                because = f' ({EXCEPTIONS[case]})' if case in EXCEPTIONS else ''
                print(f'    {verdict}: {case}: {why}{because}')


if __name__ == '__main__':
    main()
